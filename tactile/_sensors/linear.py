"""What the linear sensors share: readings in, force map out; lambda chosen once, then one product per frame."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from loadid._families.static import StaticInversion
from loadid._guards import collect
from loadid._inverse.problem import NoiseSourceLike
from loadid._results.estimate import LoadEstimate
from loadid._results.facts import provenance
from loadid.settings import Noise
from structures._flags import Flag, codes
from structures._threads import one_thread
from structures.errors import InputError

from .. import _guards as guards
from .._arrays import Array, Mask
from .._pad.tolerances import Tolerances
from .._results.forcemap import ForceFacts, ForceMap, curved_normals
from .discs import keep
from .fixed import QuickMap
from .gaussian import Errors, GaussianProblem, ModelError, around
from .image import ImageMotion
from .inversion import Inverse, Pressed, prepare
from .local import ContactFit
from .marked import FEWEST, ContactLaw, MarkedSensor, spelled_before
from .observation import DepthMap, Depths, Markers, Wrench, stacked
from .posing import (
    PadModel,
    calibrated,
    channels,
    chosen_on,
    constrained,
    constraints,
    cut,
    estimated,
    fewer,
    neighbours,
    resultant_covariance,
    together,
)
from .prior import ContactPrior
from .rigid import whole_motion
from .strength import STEP, PressStrength

if TYPE_CHECKING:
    from loadid._families.frozen import Calibration
    from loadid._inverse.choice import Choice

    from ..vision._eye import Eye


SCALED = 6  # maps at other lambdas that are kept
SHARED = 3000  # loads from which a second thread gains anything
AROUND = 0.2  # thicknesses about a node within which a load is taken to be of one size


def exact(transfer: Array, parts: Sequence[Any]) -> Sequence[ModelError]:
    """No errors of a model that is taken to be exact."""
    return ()


@dataclass(frozen=True, eq=False)
class PressedBody:
    """What is pressed (a pad, layer or half-space), and how loads on it move its markers.

    `transfer` takes points (n, 2 or 3) and a function that combines rows of their motion, and returns the rows (rows,
    loads); `geometry` is as `tactile._sensors.posing` makes it; thickness in m, None for a half-space; `basis` is for
    penalties between neighbours, `flags` what was found of the body, `about` goes into the provenance; `errors` takes
    the transfer matrix and its parts and gives what the model may be wrong by, some of it within `tolerances`.
    """

    body: Any
    thickness: float | None
    transfer: Callable[[Array, Callable[[Any], Any]], Array]
    geometry: dict[str, Any]
    basis: Any = None
    flags: Sequence[Flag] = ()
    about: Mapping[str, Any] = field(default_factory=dict)
    errors: Callable[[Array, Sequence[Any]], Sequence[ModelError]] = exact
    tolerances: Tolerances = Tolerances()  # noqa: RUF009  (frozen)


class LinearSensor(MarkedSensor):
    """A tactile sensor whose readings are a linear function of the load on its surface.

    Build one of its kinds: `MultilayerPad`, `GelForce`.

    Parameters
    ----------
    body : PressedBody
    markers, eye, depth
        As `MarkedSensor`.
    penalty, choice, noise_source, contact, allow
        See `tactile._sensors.marked.InversionSettings`.
    """

    @spelled_before("markers", "contact")
    def __init__(
        self,
        body: PressedBody,
        markers: Markers | ArrayLike | None = None,
        *,
        eye: Eye | None = None,
        depth: Depths | None = None,
        penalty: Any = "identity",
        choice: Any = None,
        noise_source: NoiseSourceLike = None,
        contact: ContactLaw | None = None,
        image: ImageMotion | None = None,
        allow: Sequence[str] = (),
    ) -> None:
        super().__init__(markers, eye, depth, contact or ContactLaw())
        self.pressed_body, self.geometry = body, body.geometry
        parts: list[tuple[Array, Callable[[Any], Any]]] = [(self.markers.points, self.markers.rows)]
        sensors = list(self.markers.channels)
        if depth is not None:
            parts.append((depth.samples, depth.rows))
            sensors += depth.channels
        rows = [body.transfer(at, pick) for at, pick in parts]
        points, basis = len(self.geometry["coordinates"]), body.basis
        self.loads = channels(points, self.geometry["kind"])
        kept = self.contact.loads(points)
        self.kept = np.arange(3 * points) if kept is None else kept
        self._whole = kept is None
        H, resultant = stacked(rows), self.geometry["resultant"]
        whole = H
        if kept is not None:
            penalty, basis = cut(penalty, basis, kept), None
            H, resultant = H[:, kept], resultant[:, kept]
        self.resultant = resultant
        told = f"{body.body!r}, {len(self.markers)} markers in {self.markers.axes}, {len(sensors)} readings"
        self.model = PadModel(H, sensors, [self.loads[i] for i in self.kept], basis, body.flags, told)
        self.prior = penalty if isinstance(penalty, ContactPrior) else None
        self.model_errors = Errors(partial(body.errors, whole, parts), columns=self.kept)
        self.problem: GaussianProblem | None = None
        if self.prior is None:
            self.family = StaticInversion(
                self.model, penalty=penalty, choice=choice, noise=Noise(source=noise_source), allow=list(allow)
            )
        else:
            self.problem = self._posed(self.prior, image)
            self.family = self.problem.family(choice, noise_source, allow)
        self._quick: dict[bool, QuickMap] = {}
        self._scaled: dict[int, QuickMap] = {}
        self._before: list[Array] = []  # readings of the calibration, where they are whole
        self._strength: PressStrength | None = None
        self._fits: dict[bool, ContactFit] = {}

    def __repr__(self) -> str:
        rows, loads = self.model.H.shape
        return f"<{type(self).__name__}: {len(self.markers)} markers, {rows} readings, {loads} loads>"

    def _posed(self, prior: ContactPrior, image: ImageMotion | None) -> GaussianProblem:
        """The problem of all readings under a contact prior."""
        places = self.geometry["coordinates"][self.kept[::3] // 3]

        return GaussianProblem(
            self.model.H, self.model.sensors, np.array([s.noise for s in self.model.sensors], float),
            prior.on(places, self._thick), None if image is None else image.over(self.markers, self.depth),
            self.model_errors, self.resultant, around(places, AROUND * self._thick),
        )  # fmt: skip

    # -- doing --------------------------------------------------------------------------------------------------------
    def estimate(self, found: ArrayLike, depth: DepthMap | None = None, *, wrench: Wrench | None = None) -> ForceMap:
        """Force map of one frame.

        Parameters
        ----------
        found : array (N, 2 or 3), or an image (H, W[, 3])
            Motion of the markers (m), NaN where one is lost; or a frame, where the sensor has an eye.
        depth : DepthMap, optional
            Measured normal motion.
        wrench : Wrench, optional
            Of a force/torque sensor: met exactly, or weighed by its std.

        Returns
        -------
        ForceMap
            With lambda frozen (`calibrate`, or ``choice`` a number) one product, or a warm-started solver under
            constraints; else lambda is chosen on this frame and everything is diagnosed. Under a contact prior the
            lambda of a calibration is scaled to the size of each press by its evidence; a number is kept.

        Notes
        -----
        Under a contact prior loads are fitted about the contacts of the frame: 0.5 to 6 s of one core for 1849 nodes
        and 520 markers, the longer the more contacts explain it. `follow` is for frames in a loop.

        Raises
        ------
        InputError
            Readings that do not fit; fewer than three markers left; a depth map for which the sensor was not built.
        NotIdentifiable
            What neither readings nor penalty determine.
        """
        y, flags = self._of_frame(found, depth, wrench)
        return self.explained(y, flags, wrench)

    def explained(self, y: Array, flags: Sequence[Flag | None] = (), wrench: Wrench | None = None) -> ForceMap:
        """Force map of readings (m,), NaN where one is lost, with what was found on the way to them."""
        found = list(flags)
        with alone(len(self.kept)):
            if self.frozen:
                return self._mapped(self._scaled_map(y), y, wrench, found)
            return self._thorough(y, wrench, found) if self.problem is None else self._chosen(y, wrench, found)

    def answered(
        self, load: Array, std: Array, wrench: Array, facts: ForceFacts, *, flags: Sequence[Flag | None],
        provenance: Mapping[str, Any],
    ) -> ForceMap:  # fmt: skip
        """Force map of loads (n,) that something else found of readings, their std and the covariance of the wrench."""
        whole = self._scattered(load)
        return ForceMap(
            load=whole, std=self._scattered(std), labels=self._labels, units=self._units, facts=facts,
            flags=collect([*self.model.flags, *flags, *self._own(whole, facts)]), allowed=self.family.allow,
            certificate=self.model.certificate, geometry={**self.geometry, "resultant_covariance": wrench},
            provenance=dict(provenance),
        )  # fmt: skip

    def follow(self, found: ArrayLike, depth: DepthMap | None = None) -> ForceMap:
        """Force map of one of many frames, as `estimate`; with lambda frozen by the one product alone.

        Under a contact prior `estimate` fits loads about the contacts, which takes some seconds on a large pad;
        without them bands are wider, and markers in the plane tell hardly more than shear.

        Raises
        ------
        InputError, NotIdentifiable
            As `estimate`.
        """
        if not self.frozen or self.problem is None:
            return self.estimate(found, depth)
        y, flags = self._of_frame(found, depth, None)
        with alone(len(self.kept)):
            return self._mapped(self._quick_map(self._deep(y)), y, None, flags, quick=True)

    def prepare(self) -> None:
        """Map a frame at rest, so that the first of a loop takes no longer than the others (`tactile.live` does).

        Raises
        ------
        InputError
            Where lambda is not fixed yet.
        """
        noise = [float(s.noise or 0.0) for s in self.model.sensors]
        still = np.random.default_rng(0).standard_normal(len(noise)) * noise
        with alone(len(self.kept)):
            frozen = self._quick_map(True)
            if frozen.image is not None:
                frozen.image.prepare()
            self._mapped(frozen, still, None, [], quick=True)

    def calibrate(
        self,
        frames: Sequence[Any],
        depths: Sequence[DepthMap] | None = None,
        *,
        wrenches: Sequence[Wrench] | None = None,
    ) -> Calibration:
        """Choose one lambda over calibration presses, and freeze it.

        Where no frame is whole, what is seen in all of them decides: a dot that is broken for good costs that dot.

        Parameters
        ----------
        frames, depths : sequence
            As `estimate` takes them.
        wrenches : sequence of Wrench, optional
            What a force sensor or weights say of each press: of the rules the one is taken whose forces are nearest.
            Under a contact prior.

        Raises
        ------
        InputError
            Without frames, if too few markers are seen in all of them, wrenches that do not go with the frames, or
            rules that lie decades apart where no wrench tells which is right.
        """
        listed = self._listed(frames, depths)
        for y in listed:
            self._require_depth(y)
        whole = [y for y in listed if np.all(np.isfinite(y))]
        listed = whole or listed
        seen: Mask = np.zeros(len(self.model.sensors), bool)
        if listed:
            seen = np.asarray(np.isfinite(np.array(listed)).all(axis=0))
        if np.sum(seen[: self.markers.readings_count]) < FEWEST * len(self.markers.axes):
            raise InputError(
                "no frames to calibrate with", where="calibrate", found=f"{len(listed)} frames",
                expected="presses in which the same markers are seen", hint="press where few markers vanish",
            )  # fmt: skip
        found = [self._steady(y)[seen] for y in listed]
        off = None if wrenches is None else self._off(seen, listed, wrenches, len(frames))
        before = self.family.calibration, self.family.choice
        self.family.calibration = None
        if isinstance(self.family.choice, int | float):
            self.family.choice = None  # presses tell more than the number that was given
        try:
            family = self.family if whole else fewer(self.family, self._named(seen))
            told = calibrated(family, found) if self.problem is None else together(family, found, off)
        except Exception:
            self.family.calibration, self.family.choice = before
            raise
        self.family.calibration = told
        self._quick, self._scaled, self._strength = {}, {}, None
        self._before = found if whole else []
        self.__dict__.pop("_provenance", None)
        return self.family.calibration

    def _off(
        self, seen: Mask, listed: Sequence[Array], wrenches: Sequence[Wrench], count: int
    ) -> Callable[[float], float]:
        """How far the forces of calibration presses are from measured ones at a lambda (N)."""
        if self.problem is None or len(wrenches) != count or len(listed) != count:
            raise InputError(
                "the wrenches do not go with the frames", where="calibrate, wrenches", found=f"{len(wrenches)}",
                expected=f"one for each of {count} whole frames, under a contact prior",
            )  # fmt: skip
        problem = self.problem.on(seen)
        y = np.array([self._steady(v)[seen] for v in listed]) / problem.noise
        known = np.array([w.force for w in wrenches])

        def off(lam: float) -> float:
            inverse = problem.inverse(lam, "")
            found = y @ (inverse.resultant[:3] @ inverse.matrix).T
            return float(np.linalg.norm(found - known))

        return off

    def choice_on(self, y: Array) -> Choice:
        """Lambda of readings (m,) or (frames, m) under a contact prior, of those that all frames have."""
        frames = np.array([self._steady(v) for v in np.atleast_2d(y)])
        seen = np.asarray(np.isfinite(frames).all(axis=0))
        family = self.family if seen.all() else fewer(self.family, self._named(seen))
        return chosen_on(family, frames[0, seen] if len(frames) == 1 else frames[:, seen])

    def pressed(self, y: Array) -> Pressed:
        """Load of readings (m,) that only presses, within its friction cone if there is one, in the region of contact.

        Raises
        ------
        InputError
            Where lambda is not fixed.
        """
        return self._quick_map(with_depth=True).pressed(y)

    # -- what it is ---------------------------------------------------------------------------------------------------
    @property
    def codes(self) -> set[str]:
        """Short codes of what the guards found when the sensor was built."""
        return codes(self.model.flags)

    @property
    def E(self) -> float:
        """Young's modulus that the sensor was built with (Pa)."""
        return float(self.pressed_body.body.E)

    @property
    def thickness(self) -> float | None:
        """Thickness of what is pressed (m); None for a half-space."""
        return self.pressed_body.thickness

    @property
    def frozen(self) -> bool:
        """Whether lambda is fixed: estimates are then quick, and comparable from frame to frame."""
        return self.family.calibration is not None or isinstance(self.family.choice, int | float)

    @property
    def inverse(self) -> Inverse:
        """The frozen inverse of all readings.

        Raises
        ------
        InputError
            Where lambda is not fixed yet.
        """
        return self._quick_map(with_depth=True).inverse

    def provided(self, depth: bool) -> dict[str, str]:
        """Where each component of the motion comes from."""
        z = "tracked" if self.markers.axes == "XYZ" else "measured" if depth else "completed"
        return {"x": "tracked", "y": "tracked", "z": z}

    # -- steps --------------------------------------------------------------------------------------------------------
    def _quick_map(self, with_depth: bool) -> QuickMap:
        if with_depth not in self._quick:
            self._quick[with_depth] = self._new_map(with_depth)
        return self._quick[with_depth]

    def _scaled_map(self, y: Array) -> QuickMap:
        """The map of readings (m,) at the lambda of the calibration, scaled to the size of their press."""
        usual = self._quick_map(self._deep(y))
        if self.problem is None or not self._before or not self._deep(y):
            return usual
        if self._strength is None:
            self._strength = PressStrength.of(self.problem.covariance, [usual.told(v) for v in self._before])
        steps = self._strength.steps(usual.told(self._steady(y)))
        if steps == 0:
            return usual
        if steps not in self._scaled:
            keep(self._scaled, steps, self._new_map(with_depth=True, scale=STEP**steps), SCALED)
        return self._scaled[steps]

    def _new_map(self, with_depth: bool, choice: Choice | None = None, scale: float = 1.0) -> QuickMap:
        nodes, places = self.kept[::3] // 3, self.geometry["coordinates"]
        linked = neighbours(self.geometry["cells"], places)
        rows = slice(None) if with_depth else slice(self.markers.readings_count)
        return QuickMap(
            self.family if with_depth else fewer(self.family, [s.label for s in self.markers.channels]),
            self.resultant,
            places[nodes],
            linked[nodes][:, nodes],
            self.markers.points[:, :2],
            len(self.markers.axes),
            self._thick,
            np.asarray(self.geometry["about"], float),
            self.contact,
            None if self.problem is None else self.problem.on(rows),
            choice,
            self._contacts(with_depth),
            self.markers.axes == "XYZ" or (with_depth and self.depth is not None),
            self._normals,
            scale,
        )

    def _contacts(self, with_depth: bool) -> ContactFit | None:
        """Fits loads about contacts under a contact prior, with a depth map or without; made once."""
        if self.problem is None:
            return None
        if with_depth not in self._fits:
            problem = self.problem.on(slice(None) if with_depth else slice(self.markers.readings_count))
            motion = problem.motion
            moved = np.zeros((len(problem.noise), 0)) if motion is None else motion.columns * motion.std
            places = self.geometry["coordinates"][self.kept[::3] // 3]
            self._fits[with_depth] = ContactFit(problem, places, self._thick, moved / problem.noise[:, None])
        return self._fits[with_depth]

    def _deep(self, y: Array) -> bool:
        """Whether readings (m,) hold those of a depth map, or none are expected."""
        return self.depth is None or bool(np.isfinite(y[self.markers.readings_count :]).any())

    def _chosen(self, y: Array, wrench: Wrench | None, flags: list[Flag | None]) -> ForceMap:
        """The map at a lambda that is chosen on this frame, under a contact prior."""
        seen = np.isfinite(y)
        choice = self.choice_on(y)
        found = self._mapped(self._new_map(self._deep(y), choice), y, wrench, flags)
        rest = y - self.model.H @ found.load[self._columns]
        if found.facts.image is not None and self.problem is not None and self.problem.motion is not None:
            rest = rest - self.problem.motion.columns[:, : len(found.facts.image)] @ found.facts.image
        channels = [c for c, there in zip(self.model.sensors, seen, strict=True) if there]
        return replace(
            found, choice=choice, response=y[seen], residual=rest[seen], sensors=[c.label for c in channels],
            sensor_units=[c.unit for c in channels],
        )  # fmt: skip

    def _steady(self, y: Array) -> Array:
        """Readings (m,) without the shift that most of them share, where the image may move."""
        motion = None if self.problem is None else self.problem.motion
        return y if motion is None else y - motion.columns @ motion.typical(y)

    def _mapped(
        self, frozen: QuickMap, y: Array, wrench: Wrench | None, flags: list[Flag | None], quick: bool = False
    ) -> ForceMap:
        """The map at the lambda of a frozen inverse."""
        count, depth = self.markers.readings_count, self._deep(y)
        found = frozen(y if depth else y[:count], wrench, quick)
        facts = replace(found.facts, provided=self.provided(depth and self.depth is not None))
        if found.image is not None:
            image = found.image
            facts = replace(facts, image=tuple(map(float, image.values)), image_std=tuple(map(float, image.std)))
        if found.image is None:
            spread = found.std / max(1.0, found.facts["misfit"])  # a motion of all markers widens the band
            moved = self._moved(y, found.load, spread, slice(None) if depth else slice(count), lambda: frozen.inverse)
        else:
            moved = guards.moved(found.image, None if self.eye is None else self.eye.pixel)
            flags = [*flags, guards.unpressed(self.resultant[:3] @ found.load, found.wrench[:3, :3])]
        load, std = self._scattered(found.load), self._scattered(found.std)
        noise = {} if found.noise is None else {"noise_std": self._scattered(found.noise)}
        return ForceMap(
            load=load,
            std=std,
            labels=self._labels,
            units=self._units,
            flags=collect([*self.model.flags, *flags, *found.flags, moved, *self._own(load, facts)]),
            allowed=self.family.allow,
            certificate=self.model.certificate,
            geometry={**self.geometry, "resultant_covariance": found.wrench, **noise},
            facts=facts,
            provenance=self._provenance,
        )

    def _thorough(self, y: Array, wrench: Wrench | None, flags: list[Flag | None]) -> ForceMap:
        """The map at a lambda that is chosen on this frame, with everything that the static family tells."""
        seen = np.isfinite(y)
        held = constraints(len(self.kept), self.contact, self.resultant, wrench, self._normals)
        family = self.family if seen.all() else fewer(self.family, self._named(seen))
        found = estimated(constrained(family, held), y[seen])
        measured = self.depth is not None and bool(seen[self.markers.readings_count :].any())
        facts = ForceFacts.of({**found.facts, "lost": int(np.sum(~seen)), "provided": self.provided(measured)})
        kept = {f.name: getattr(found, f.name) for f in fields(LoadEstimate)}
        if not self._whole:  # posterior and diagnosis are those of the loads that may act
            kept |= {"posterior": None, "bias": None, "diagnosis": None}
        load = self._scattered(found.load)
        covariance = resultant_covariance(found.posterior, self.resultant)
        if found.bias is not None and wrench is None:  # what the penalty takes is in the band
            taken = self.resultant @ found.bias
            covariance = covariance + np.outer(taken, taken)
        assert found.choice is not None
        lam = found.choice.lam
        moved = self._moved(y, found.load, found.std, seen, lambda: prepare(family, self.resultant, lam))
        own = {
            "load": load,
            "std": self._scattered(found.std),
            "labels": self._labels,
            "units": self._units,
            "flags": collect([*found.flags, *flags, moved, *self._own(load, facts)]),
            "geometry": {**self.geometry, "resultant_covariance": covariance},
            "facts": facts,
        }
        return ForceMap(**{**kept, **own})

    def _moved(self, y: Array, load: Array, std: Array, rows: Any, inverse: Callable[[], Inverse]) -> Flag | None:
        """W611 of readings (m,) and the loads (n,) found; `inverse`, of `rows`, is asked where most markers moved."""
        markers, count = self.markers, self.markers.readings_count
        places, shape = markers.points[:, :2], (len(markers), len(markers.axes))

        def alone(motion: Callable[[Array], Array]) -> Array:
            only = np.zeros(len(y))
            only[:count].reshape(shape)[:, :2] = motion(places)
            maps = inverse()
            return np.asarray(maps.matrix @ (only[rows] / maps.noise).astype(maps.matrix.dtype, copy=False), float)

        return whole_motion(
            y[:count].reshape(shape)[:, :2], load, std, markers, self.geometry["coordinates"][self.kept[::3] // 3, :2],
            self._thick, alone, lambda g: np.asarray(self.model.H[:count] @ g).reshape(shape)[:, :2], self.resultant,
            None if self.eye is None else self.eye.pixel,
        )  # fmt: skip

    @cached_property
    def _normals(self) -> Array | None:
        """Outward normals (P, 3) at the nodes that may be loaded, of a curved surface."""
        found = curved_normals(self.geometry["coordinates"], self.geometry["cells"])
        return None if found is None else found[self.kept[::3] // 3]

    @cached_property
    def _thick(self) -> float:
        """Thickness (m); of a half-space a sixth of the side."""
        return self.thickness or float(np.ptp(self.geometry["coordinates"][:, :2])) / 6

    def _named(self, seen: Mask) -> list[str]:
        """Labels of the readings that are there."""
        return [s.label for s, there in zip(self.model.sensors, seen, strict=True) if there]

    def _own(self, load: Array, facts: ForceFacts) -> list[Flag | None]:
        """What is found in every map."""
        lost = guards.lost(facts["lost"], facts["m"] + facts["lost"])
        return [guards.completed(dict(facts.provided or {})), lost, *self._checked(load)]

    def _checked(self, load: Array) -> list[Flag | None]:
        """What a kind of sensor finds in a map (3 P,) beyond that."""
        return []

    def _scattered(self, values: Array) -> Array:
        """Values of the loads that may act among all of the surface."""
        if self._whole:
            return values
        out = np.zeros(len(self.loads))
        out[self.kept] = values
        return out

    @property
    def _columns(self) -> Any:
        """Which of the loads of the surface are unknowns."""
        return slice(None) if self._whole else self.kept

    @property
    def _penalty(self) -> str | None:
        if self.prior is not None:
            return repr(self.prior)
        return self.family.penalty if isinstance(self.family.penalty, str | None) else "matrix"

    @property
    def _expected(self) -> str:
        if self.prior is not None:
            return "presses anywhere, of any radius between two"
        return "white prior on the load of every node" if self.family.L is None else "smooth load"

    @cached_property
    def _labels(self) -> tuple[str, ...]:
        return tuple(c.label for c in self.loads)

    @cached_property
    def _units(self) -> tuple[str, ...]:
        return tuple(c.unit for c in self.loads)

    @cached_property
    def _provenance(self) -> dict[str, Any]:
        family = self.family
        return provenance(
            self.name,
            settings={
                **self.pressed_body.about,
                "penalty": self._penalty,
                "no_pull": self.contact.no_pull,
                "friction": self.contact.friction,
                "calibration": None if family.calibration is None else str(family.calibration),
            },
            inputs={},
            model=self.model.fingerprint,
            prior=self._expected,
        )


def alone(loads: int) -> AbstractContextManager[None]:
    """One thread for the matrices of so many loads, where these are too small to be shared."""
    return one_thread() if loads < SHARED else nullcontext()
