"""What the linear sensors share: readings in, force map out; lambda chosen once, then one product per frame."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import fields
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loadid.families.static import StaticInversion
from loadid.guards import collect
from loadid.inverse.noise_source import NoiseSourceLike
from loadid.results.archive import provenance
from loadid.results.estimate import LoadEstimate
from loadid.settings import Noise
from structures.errors import InputError, positive
from structures.flags import Flag, codes

from ..results import guards
from ..results.forcemap import ForceMap
from ..results.guards import away, completed, contact, typical
from .fixed import QuickMap, not_built_for_depth, paired, readings_of
from .inversion import Inverse, Pressed, prepare
from .observation import DepthMap, Depths, Markers, Wrench, stacked
from .posing import (
    PadModel,
    calibrated,
    channels,
    constrained,
    constraints,
    cut,
    estimated,
    fewer,
    neighbours,
    resultant_covariance,
    supported,
)

if TYPE_CHECKING:
    from loadid.families.frozen import Calibration

    from ..vision.eye import Eye


Array = NDArray[np.float64]
FEWEST = 3  # markers of a frame


class Settings(TypedDict, total=False):
    """Settings of every linear sensor.

    Attributes
    ----------
    penalty : str or matrix
        ``identity`` (ridge; point-like contacts), ``gradient`` or ``laplacian`` (smooth ones), as `StaticInversion`;
        None for plain least squares.
    choice : str, float or None
        Rule for lambda, or a relative lambda; `calibrate` freezes it. None takes UPRE at the noise of the markers, or
        GCV where the data show that this is not all there is (errors of the mesh, a level that is too low).
    noise_source : NoiseSource, str or (str, str)
        Where the noise level comes from, as in `loadid.StaticInversion`.
    no_pull : bool
        Pressures are not negative.
    friction : float
        Coefficient of friction: tractions stay in their cone.
    support : array
        Nodes of the surface that may be loaded: a mask (P,) or their numbers. The others carry nothing.
    allow : sequence of str
        Guard codes whose refusal is overridden.
    """

    penalty: Any
    choice: Any
    noise_source: NoiseSourceLike
    no_pull: bool
    friction: float | None
    support: ArrayLike | None
    allow: Sequence[str]


class LinearSensor:
    """A tactile sensor whose readings are a linear function of the load on its surface.

    Build one of its kinds: `MultilayerPad`, `GelForce`.

    Parameters
    ----------
    markers : Markers
    transfer : callable
        Takes points (n, 2 or 3) and a function that combines rows of their motion; returns the rows (rows, loads).
    geometry : dict
        As `tactile.sensors.posing` makes it.
    body : Pad, Layer or HalfSpace
        What is pressed: its E, and its thickness where it has one.
    basis : Basis, optional
        For penalties between neighbours.
    depth : Depths, optional
        Windows of a depth map that is measured beside the markers.
    flags : sequence of Flag
        What was found of the body.
    eye : Eye, optional
        Turns images into motion.
    about : dict, optional
        What goes into the provenance.
    penalty, choice, noise_source, no_pull, friction, support, allow
        See `Settings`.
    """

    name = "tactile sensor"

    def __init__(
        self,
        markers: Markers,
        transfer: Callable[[Array, Callable[[Any], Any]], Array],
        geometry: dict[str, Any],
        *,
        body: Any,
        basis: Any = None,
        depth: Depths | None = None,
        flags: Sequence[Flag] = (),
        eye: Eye | None = None,
        about: dict[str, Any] | None = None,
        penalty: Any = "identity",
        choice: Any = None,
        noise_source: NoiseSourceLike = None,
        no_pull: bool = False,
        friction: float | None = None,
        support: ArrayLike | None = None,
        allow: Sequence[str] = (),
    ) -> None:
        self.markers, self.geometry, self.depth, self.eye, self.body = markers, geometry, depth, eye, body
        self.no_pull = bool(no_pull)
        self.friction = None if friction is None else positive("the friction coefficient", friction, where="friction")
        rows, sensors = [transfer(markers.points, markers.rows)], list(markers.channels)
        if depth is not None:
            rows.append(transfer(depth.samples, depth.rows))
            sensors += depth.channels
        points = len(geometry["coordinates"])
        self.loads = channels(points, geometry["kind"])
        kept = supported(support, points)
        self.kept = np.arange(3 * points) if kept is None else kept
        self._whole = kept is None
        H, resultant = stacked(rows), geometry["resultant"]
        if kept is not None:
            penalty, basis = cut(penalty, basis, kept), None
            H, resultant = H[:, kept], resultant[:, kept]
        self.resultant = resultant
        self.model = PadModel(H, sensors, [self.loads[i] for i in self.kept], basis, flags)
        self.family = StaticInversion(
            self.model, penalty=penalty, choice=choice, noise=Noise(source=noise_source), allow=list(allow)
        )
        self._about = about or {}
        self._offset = np.zeros(len(sensors))
        self._quick: dict[bool, QuickMap] = {}

    def __repr__(self) -> str:
        rows, loads = self.model.H.shape
        return f"<{type(self).__name__}: {len(self.markers)} markers, {rows} readings, {loads} loads>"

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
            constraints; else lambda is chosen on this frame and everything is diagnosed.

        Raises
        ------
        InputError
            Readings that do not fit; fewer than three markers left; a depth map for which the sensor was not built.
        NotIdentifiable
            What neither readings nor penalty determine.
        """
        y, flags = self._readings(found, depth)
        count = self.markers.readings_count
        left = int(np.sum(np.isfinite(y[:count]))) // len(self.markers.axes)
        if left < FEWEST:
            raise InputError(
                "too few markers are left in this frame",
                where="frame",
                found=left,
                expected=f"at least {FEWEST}",
                hint="look at the image: light, focus, occlusion",
            )
        return self._at_once(y, wrench, flags) if self.frozen else self._thorough(y, wrench, flags)

    def stream(self, frames: Iterable[Any], depths: Iterable[DepthMap] | None = None) -> Iterator[ForceMap]:
        """Force maps of frames, one after another, as they come."""
        if depths is None:
            yield from (self.estimate(frame) for frame in frames)
        else:
            yield from (self.estimate(frame, depth) for frame, depth in paired(frames, depths))

    def zero(self, frames: Sequence[Any], depths: Sequence[DepthMap] | None = None) -> Self:
        """Take the mean of unloaded frames as zero. Returns the sensor.

        Raises
        ------
        InputError
            Without frames.
        """
        self._offset = np.zeros(len(self.model.sensors))
        listed = [self.readings(f, None if depths is None else depths[i]) for i, f in enumerate(frames)]
        if not listed:
            raise InputError("no frames to take zero from", where="zero", found="none", expected="unloaded frames")
        stack = np.array(listed)
        seen = np.isfinite(stack).sum(axis=0)
        total = np.where(np.isfinite(stack), stack, 0.0).sum(axis=0)
        self._offset = np.where(seen > 0, total / np.maximum(seen, 1), 0.0)
        return self

    def calibrate(self, frames: Sequence[Any], depths: Sequence[DepthMap] | None = None) -> Calibration:
        """Choose one lambda over calibration presses, and freeze it.

        Where no frame is whole, what is seen in all of them decides: a dot that is broken for good costs that dot.

        Raises
        ------
        InputError
            Without frames, or if too few markers are seen in all of them.
        """
        listed = [self.readings(f, None if depths is None else depths[i]) for i, f in enumerate(frames)]
        whole = [y for y in listed if np.all(np.isfinite(y))]
        listed = whole or listed
        seen: NDArray[np.bool_] = np.zeros(len(self.model.sensors), bool)
        if listed:
            seen = np.asarray(np.isfinite(np.array(listed)).all(axis=0))
        if np.sum(seen[: self.markers.readings_count]) < FEWEST * len(self.markers.axes):
            raise InputError(
                "no frames to calibrate with",
                where="calibrate",
                found=f"{len(listed)} frames",
                expected="presses in which the same markers are seen",
                hint="press where few markers vanish",
            )
        self._quick = {}
        self.__dict__.pop("_provenance", None)
        self.family.calibration = None
        if isinstance(self.family.choice, int | float):
            self.family.choice = None  # presses tell more than the number that was given
        family = self.family if whole else fewer(self.family, self._named(seen))
        self.family.calibration = calibrated(family, [y[seen] for y in listed])
        return self.family.calibration

    def readings(self, found: ArrayLike, depth: DepthMap | None = None) -> Array:
        """Readings (m,) of a frame in the order of ``sensor.model.sensors``, zero taken off; NaN where lost."""
        return self._readings(found, depth)[0]

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
        return float(self.body.E)

    @property
    def thickness(self) -> float | None:
        """Thickness of what is pressed (m); None for a half-space."""
        return getattr(self.body, "thickness", None) or getattr(self.body, "h", None)

    @property
    def constrained(self) -> bool:
        """Whether the map may not pull, or not leave its friction cone."""
        return self.no_pull or self.friction is not None

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
    def _readings(self, found: ArrayLike, depth: DepthMap | None) -> tuple[Array, list[Flag | None]]:
        """Readings in the order of the model, NaN where there is none, and what was found on the way."""
        seen, flags = readings_of(found, self.markers, self.eye, depth)
        parts = [seen]
        if self.depth is not None:
            rows = len(self.depth.points)
            parts.append(np.full(rows, np.nan) if depth is None else self.depth.readings(depth))
        elif depth is not None and self.eye is None:
            raise not_built_for_depth()
        return np.concatenate(parts) - self._offset, flags

    def _quick_map(self, with_depth: bool) -> QuickMap:
        if with_depth not in self._quick:
            nodes = self.kept[::3] // 3
            places = self.geometry["coordinates"]
            linked = neighbours(self.geometry["cells"], places)
            self._quick[with_depth] = QuickMap(
                self.family if with_depth else fewer(self.family, [s.label for s in self.markers.channels]),
                self.resultant,
                places[nodes],
                linked[nodes][:, nodes],
                self.markers.points[:, :2],
                len(self.markers.axes),
                self._thick,
                np.asarray(self.geometry["about"], float),
                self.no_pull,
                self.friction,
            )
        return self._quick[with_depth]

    def _at_once(self, y: Array, wrench: Wrench | None, flags: list[Flag | None]) -> ForceMap:
        """The map at the frozen lambda."""
        count = self.markers.readings_count
        depth = self.depth is None or bool(np.isfinite(y[count:]).any())
        quick = self._quick_map(depth)
        found = quick(y if depth else y[:count], wrench)
        facts = {**found.facts, "provided": self.provided(depth and self.depth is not None)}
        spread = found.std / max(1.0, found.facts["misfit"])  # a motion of all markers widens the band
        moved = self._moved(y, found.load, spread, slice(None) if depth else slice(count), lambda: quick.inverse)
        load, std = self._scattered(found.load), self._scattered(found.std)
        return ForceMap(
            load=load,
            std=std,
            labels=self._labels,
            units=self._units,
            flags=collect([*self.model.flags, *flags, *found.flags, moved, *self._own(load, facts)]),
            allowed=self.family.allow,
            certificate=self.model.certificate,
            geometry={**self.geometry, "resultant_covariance": found.wrench},
            facts=facts,
            provenance=self._provenance,
        )

    def _thorough(self, y: Array, wrench: Wrench | None, flags: list[Flag | None]) -> ForceMap:
        """The map at a lambda that is chosen on this frame, with everything that the static family tells."""
        seen = np.isfinite(y)
        held = constraints(len(self.kept), self.no_pull, self.friction, self.resultant, wrench)
        family = self.family if seen.all() else fewer(self.family, self._named(seen))
        found = estimated(constrained(family, held), y[seen])
        measured = self.depth is not None and bool(seen[self.markers.readings_count :].any())
        facts = {**found.facts, "lost": int(np.sum(~seen)), "provided": self.provided(measured)}
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
            "geometry": {
                **self.geometry,
                "resultant_covariance": covariance,
            },
            "facts": facts,
        }
        return ForceMap(**{**kept, **own})

    def _moved(self, y: Array, load: Array, std: Array, rows: Any, inverse: Callable[[], Inverse]) -> Flag | None:
        """W611 of readings (m,) and the loads (n,) found; `inverse`, of `rows`, is asked where most markers moved."""
        markers, count = self.markers, self.markers.readings_count
        places, noise, shape = markers.points[:, :2], markers.noise[:, :2], (len(markers), len(markers.axes))
        motion = y[:count].reshape(shape)[:, :2]

        def alone(field: Array) -> Array:
            only = np.zeros(len(y))
            only[:count].reshape(shape)[:, :2] = field
            maps = inverse()
            return np.asarray(maps.matrix @ (only[rows] / maps.spread))

        shift = typical(motion, noise)
        local = load - alone(shift) if shift.any() else load

        def explained(near: NDArray[np.bool_]) -> Array:
            return np.asarray(self.model.H[:count] @ (local * np.repeat(near, 3))).reshape(shape)[:, :2]

        nodes = self.geometry["coordinates"][self.kept[::3] // 3, :2]
        found = away(motion, explained, contact(local, std), nodes, places, noise, self._thick)
        force = np.zeros(3) if found is None else self.resultant[:3] @ alone(found.field(places))
        return guards.moved(found, force, None if self.eye is None else self.eye.pixel)

    @cached_property
    def _thick(self) -> float:
        """Thickness (m); of a half-space a sixth of the side."""
        return self.thickness or float(np.ptp(self.geometry["coordinates"][:, :2])) / 6

    def _named(self, seen: NDArray) -> list[str]:
        """Labels of the readings that are there."""
        return [s.label for s, there in zip(self.model.sensors, seen, strict=True) if there]

    def _own(self, load: Array, facts: dict[str, Any]) -> list[Flag | None]:
        """What is found in every map."""
        lost = guards.lost(facts["lost"], facts["m"] + facts["lost"])
        return [completed(facts["provided"]), lost, *self._checked(load)]

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
                **self._about,
                "penalty": family.penalty if isinstance(family.penalty, str | None) else "matrix",
                "no_pull": self.no_pull,
                "friction": self.friction,
                "calibration": None if family.calibration is None else str(family.calibration),
            },
            inputs={},
            model=self.model.fingerprint,
            prior="white prior on the load of every node" if family.L is None else "smooth load",
        )
