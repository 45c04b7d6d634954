"""What the linear sensors share: readings in, force map out; lambda chosen once, then one product per frame."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loadid.estimate import LoadEstimate
from loadid.families.static import StaticInversion
from loadid.flags import collect
from loadid.provenance import provenance
from structures.arrays import MatrixModel
from structures.errors import InputError
from structures.flags import Flag, codes

from .choosing import calibrated, estimated
from .forcemap import ForceMap
from .frame import not_built_for_depth, readings_of
from .guards import maps as guards
from .guards.labels import completed
from .inversion import Inverse, prepare
from .observation import Depths, Markers, stacked
from .reading import DepthMap, Wrench
from .region import Pressed, RegionSolver
from .surface import channels, neighbours

if TYPE_CHECKING:
    from loadid.families.calibration import Calibration

    from .eye import Eye

Array = NDArray[np.float64]
TOUCH = 0.05  # of the peak pressure of the unconstrained map: where the constrained one looks for contact
CLEAR = 2.0  # stds of the unconstrained map
MANY = 12  # markers from which one can be told to contradict the others
STRAYS = 20  # of them that are left out, at most


class PadModel(MatrixModel):
    """A transfer matrix on the surface of a pad, with the basis of its loads where there is one."""

    def __init__(self, H: Array, sensors: Sequence[Any], loads: Sequence[Any], basis: Any, flags: tuple) -> None:
        super().__init__(H, sensors=sensors, loads=loads)
        self.basis, self.flags = basis, flags


class LinearSensor:
    """A tactile sensor whose readings are a linear function of the load on its surface.

    Subclasses say how markers move under the load (`rows`), on which surface (`geometry`), and what is known of each
    component. Build one of those: `MultilayerPad`, `GelForce`.

    Parameters
    ----------
    markers : Markers
    transfer : callable
        Takes points (n, 2 or 3) and a function that combines rows of their motion; returns the rows (rows, loads).
    geometry : dict
        As `tactile.surface` makes it.
    depth : Depths, optional
        Windows of a depth map that is measured beside the markers.
    """

    name = "tactile sensor"

    def __init__(
        self,
        markers: Markers,
        transfer: Callable[[Array, Callable[[Any], Any]], Array],
        geometry: dict[str, Any],
        *,
        basis: Any = None,
        depth: Depths | None = None,
        penalty: Any = "identity",
        choice: Any = None,
        noise_source: str | None = None,
        no_pull: bool = False,
        friction: float | None = None,
        support: ArrayLike | None = None,
        allow: Sequence[str] = (),
        flags: Sequence[Flag] = (),
        eye: Eye | None = None,
        settings: dict[str, Any] | None = None,
    ) -> None:
        self.markers, self.geometry, self.depth, self.eye = markers, geometry, depth, eye
        self.no_pull, self.friction = bool(no_pull), _friction(friction)
        self._settings = settings or {}
        rows, sensors = [transfer(markers.points, markers.rows)], list(markers.channels)
        if depth is not None:
            rows.append(transfer(depth.samples, depth.rows))
            sensors += depth.channels
        points = len(geometry["coordinates"])
        self.labels = channels(points, geometry["kind"])
        self.kept = supported(support, points)
        H, loads = stacked(rows), self.labels
        if self.kept is not None:
            penalty, basis = _cut(penalty, basis, self.kept), None
            H, loads = H[:, self.kept], [loads[i] for i in self.kept]
        self.resultant = geometry["resultant"] if self.kept is None else geometry["resultant"][:, self.kept]
        self.model = PadModel(H, sensors, loads, basis, tuple(flags))
        self.family = StaticInversion(
            self.model, penalty=penalty, choice=choice, noise_source=noise_source, allow=list(allow)
        )
        self._offset = np.zeros(len(sensors))
        self._inverses: dict[bool, Inverse] = {}
        self._solver: RegionSolver | None = None
        self._found: dict[Inverse, Flag | None] = {}

    def __repr__(self) -> str:
        rows, loads = self.model.H.shape
        return f"<{type(self).__name__}: {len(self.markers)} markers, {rows} readings, {loads} loads>"

    # -- doing --------------------------------------------------------------------------------------------------------
    def estimate(
        self,
        found: ArrayLike,
        depth: DepthMap | None = None,
        *,
        wrench: Wrench | None = None,
    ) -> ForceMap:
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
            Readings that do not fit; a depth map for which the sensor was not built.
        NotIdentifiable
            What neither readings nor penalty determine.
        """
        y, flags = self._readings(found, depth)
        if self.frozen:
            return self._quick(y, wrench, flags)
        return self._thorough(y, wrench, flags)

    def stream(self, frames: Iterable[Any], depths: Iterable[DepthMap] | None = None) -> Iterator[ForceMap]:
        """Force maps of frames, one after another, as they come."""
        if depths is None:
            for frame in frames:
                yield self.estimate(frame)
        else:
            for frame, depth in zip(frames, depths, strict=False):
                yield self.estimate(frame, depth)

    def zero(self, frames: Sequence[Any], depths: Sequence[DepthMap] | None = None) -> Self:
        """Take the mean of unloaded frames as zero. Returns the sensor."""
        self._offset = np.zeros(len(self.model.sensors))
        listed = [self._readings(f, None if depths is None else depths[i])[0] for i, f in enumerate(frames)]
        if not listed:
            raise InputError("no frames to take zero from", where="zero", found="none", expected="unloaded frames")
        stack = np.array(listed)
        seen = np.isfinite(stack).sum(axis=0)
        total = np.where(np.isfinite(stack), stack, 0.0).sum(axis=0)
        self._offset = np.where(seen > 0, total / np.maximum(seen, 1), 0.0)
        return self

    def calibrate(self, frames: Sequence[Any], depths: Sequence[DepthMap] | None = None) -> Calibration:
        """Choose one lambda over calibration presses, and freeze it.

        Frames with lost markers tell on what the others see: they are filled from them first, which changes nothing in
        the choice but the count.
        """
        listed = [self._readings(f, None if depths is None else depths[i])[0] for i, f in enumerate(frames)]
        whole = [y for y in listed if np.all(np.isfinite(y))]
        if not whole:
            raise InputError("no whole frame to calibrate with", where="calibrate",
                             found=f"{len(listed)} frames, each with lost readings",
                             expected="a press in which every marker is seen")  # fmt: skip
        self._inverses, self._solver = {}, None
        return calibrated(self.family, whole)

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
        inverse = self._frozen(with_depth=True)
        answer = inverse(y)
        return self._constrained(inverse, y, answer.load, answer.std, None)

    @property
    def codes(self) -> set[str]:
        """Short codes of what the guards found when the sensor was built."""
        return codes(self.model.flags)

    @property
    def E(self) -> float:
        """Young's modulus that the sensor was built with (Pa)."""
        body = getattr(self, "pad", None) or self.ground  # type: ignore[attr-defined]
        return float(body.E)

    @property
    def frozen(self) -> bool:
        """Whether lambda is fixed: estimates are then quick, and comparable from frame to frame."""
        family = self.family
        return family.calibration is not None or isinstance(family.choice, int | float)

    @property
    def inverse(self) -> Inverse:
        """The frozen inverse of all readings.

        Raises
        ------
        InputError
            Where lambda is not fixed yet.
        """
        return self._frozen(with_depth=True)

    # -- readings -----------------------------------------------------------------------------------------------------
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

    # -- the quick way ------------------------------------------------------------------------------------------------
    def _frozen(self, with_depth: bool) -> Inverse:
        if with_depth not in self._inverses:
            family = self.family
            if not with_depth:
                family = _without(family, [s.label for s in self.markers.channels])
            lam = family.calibration.lam if family.calibration is not None else family.choice
            if not isinstance(lam, int | float):
                raise InputError("lambda is not fixed yet", where="sensor", found=f"choice={lam!r}",
                                 expected="a calibration, or a relative lambda",
                                 hint="sensor.calibrate([press, press, ...])")  # fmt: skip
            rule = "given" if family.calibration is None else family.calibration.rule
            self._inverses[with_depth] = prepare(family, self.resultant, float(lam), rule)
        return self._inverses[with_depth]

    def _quick(self, y: Array, wrench: Wrench | None, flags: list[Flag | None]) -> ForceMap:
        count = self.markers.readings_count
        depths = self.depth is None or bool(np.isfinite(y[count:]).any())
        inverse = self._frozen(depths)
        used, strays = self._without_strays(inverse, y if depths else y[:count])
        answer = inverse(used, None if self.constrained else wrench)
        load, std, covariance, solver = answer.load, answer.std, answer.wrench, "frozen inverse"
        if self.constrained:
            found = self._constrained(inverse, used, load, std, wrench)
            load, std, covariance = found.load, found.std, found.wrench
            solver = f"active sets on the contact region, {found.steps} steps"
            flags = [*flags, guards.stopped(found.converged, found.steps)]
        else:
            hidden = inverse.hidden(load)
            flags = [*flags, guards.taken(hidden, inverse.resultant @ load, covariance)]
            if wrench is None:  # what the penalty takes is in the band of the resultant
                covariance = covariance + np.outer(hidden, hidden)
        flags = [*flags, self._unseen(inverse)]
        lost = int(np.sum(~np.isfinite(used)))
        facts = {
            "path": solver,
            "m": len(used) - lost,
            "n": len(load),
            "lost": lost,
            "strays": strays,
            "lambda": inverse.lam,
            "lambda_rule": inverse.rule,
            "provided": self.provided(depths and self.depth is not None),
        }
        return self._map(load, std, covariance, facts, flags, response=None)

    def _unseen(self, inverse: Inverse) -> Flag | None:
        """What of a plain press would be found; asked once for every inverse."""
        if inverse not in self._found:
            places = self.geometry["coordinates"][self._nodes]
            about = self.geometry["about"]
            reach = self.thickness if self.thickness is not None else float(np.ptp(places[:, :2])) / 6
            press = np.zeros((len(places), 3))
            press[:, 2] = -np.exp(-np.sum((places[:, :2] - about[:2]) ** 2, axis=1) / reach**2)
            self._found[inverse] = guards.unseen(inverse.recovery(press.ravel()))
        return self._found[inverse]

    @property
    def thickness(self) -> float | None:
        """Thickness of what is pressed (m); None for a half-space."""
        body = getattr(self, "pad", None) or getattr(self, "ground", None)
        return getattr(body, "thickness", None) or getattr(body, "h", None)

    @property
    def _nodes(self) -> NDArray[np.intp]:
        """Nodes that may be loaded."""
        count = len(self.geometry["coordinates"])
        return np.arange(count) if self.kept is None else self.kept[::3] // 3

    def _without_strays(self, inverse: Inverse, y: Array) -> tuple[Array, int]:
        """Readings without those of markers that contradict all others: a dot taken for its neighbour."""
        count, axes = len(self.markers), len(self.markers.axes)
        if count < MANY:
            return y, 0
        found = 0
        while found < STRAYS and (stray := inverse.stray(y, count, axes)) is not None:
            found += 1
            y = y.copy()
            y[stray * axes : (stray + 1) * axes] = np.nan
        return y, found

    @property
    def constrained(self) -> bool:
        """Whether the map may not pull, or not leave its friction cone."""
        return self.no_pull or self.friction is not None

    def _constrained(self, inverse: Inverse, y: Array, load: Array, std: Array, wrench: Wrench | None) -> Pressed:
        """The map under constraints, looked for where the unconstrained one presses."""
        if self._solver is None or self._solver.H.shape[0] != len(y):
            spread = inverse.spread[:, None]
            self._solver = RegionSolver(
                self.model.H[: len(y)] / spread,
                inverse.lam * inverse.scale * self._weights,
                inverse.resultant,
                self._neighbours,
                self.friction,
            )
        pressure, spread = -load[2::3], std[2::3]
        peak = float(pressure.max())
        touched = (pressure > TOUCH * peak) & (pressure > CLEAR * spread)
        return self._solver.solve(y / inverse.spread, touched, wrench)

    @property
    def _neighbours(self) -> Any:
        found = neighbours(self.geometry["cells"], self.geometry["coordinates"])
        return found[self._nodes][:, self._nodes]

    @property
    def _weights(self) -> Array:
        """Weight of every load in the penalty.

        Raises
        ------
        InputError
            For penalties that couple loads: constrained maps at frame rate take the identity.
        """
        if self.family.L is not None:
            raise InputError("constrained maps at a fixed lambda take the identity as their penalty",
                             where="penalty", found=self.family.penalty, expected="'identity'",
                             hint="leave lambda to be chosen per frame, or leave the constraints out")  # fmt: skip
        return np.ones(self.model.H.shape[1])

    # -- the thorough way ---------------------------------------------------------------------------------------------
    def _thorough(self, y: Array, wrench: Wrench | None, flags: list[Flag | None]) -> ForceMap:
        labels = [s.label for s in self.model.sensors]
        seen = np.isfinite(y)
        count = self.markers.readings_count
        if np.sum(seen[:count]) < 3 * len(self.markers.axes):
            raise InputError("too few markers are left in this frame", where="frame",
                             found=int(np.sum(seen[:count])) // len(self.markers.axes), expected="at least 3",
                             hint="look at the image: light, focus, occlusion")  # fmt: skip
        family = _with(self.family, self._constraints(wrench))
        readings = {name: float(v) for name, v, s in zip(labels, y, seen, strict=True) if s}
        found = estimated(family, readings if not seen.all() else y)
        covariance = _covariance(found.posterior, self.resultant)
        facts = {
            **found.facts,
            "lost": int(np.sum(~seen)),
            "provided": self.provided(self.depth is not None and bool(seen[count:].any())),
        }
        return self._map(found.load, found.std, covariance, facts, flags, response=found.response, found=found)

    def _constraints(self, wrench: Wrench | None) -> list[Any]:
        from loadid.inverse.constraints import Bounds, FrictionCone, Resultant

        n = self.model.H.shape[1]
        triples = np.arange(n).reshape(-1, 3)
        out: list[Any] = []
        if self.friction is not None:
            normals = np.tile([0.0, 0.0, -1.0], (len(triples), 1))
            out.append(FrictionCone(self.friction, triples, normals=normals))
        elif self.no_pull:
            out.append(Bounds(upper=0.0, loads=triples[:, 2]))
        if wrench is not None:
            rows = self.resultant[: len(wrench.value)]
            spread = None if wrench.std is None else wrench.std**2
            out.append(Resultant(rows, wrench.value, covariance=spread))
        return out

    # -- the answer ---------------------------------------------------------------------------------------------------
    def provided(self, depth: bool) -> dict[str, str]:
        """Where each component of the motion comes from."""
        z = "tracked" if self.markers.axes == "XYZ" else "measured" if depth else "completed"
        return {"x": "tracked", "y": "tracked", "z": z}

    def _map(
        self,
        load: Array,
        std: Array,
        covariance: Array,
        facts: dict[str, Any],
        flags: Sequence[Flag | None],
        response: Array | None,
        found: LoadEstimate | None = None,
    ) -> ForceMap:
        geometry = {**self.geometry, "resultant_covariance": covariance}
        own = [
            *flags,
            completed(facts["provided"]),
            guards.lost(facts["lost"], facts["m"] + facts["lost"]),
            *self._checked(self._scattered(load)),
        ]
        if found is not None:
            kept = {f.name: getattr(found, f.name) for f in fields(LoadEstimate)}
            named = {"labels": self._labels[0], "units": self._labels[1]}
            if self.kept is not None:  # the posterior is that of the loads that may act
                kept |= {"posterior": None, "bias": None, "diagnosis": None}
            own = [*found.flags, *own]
            whole = {"load": self._scattered(load), "std": self._scattered(std), "flags": collect(own)}
            return ForceMap(**{**kept, **named, **whole, "geometry": geometry, "facts": facts})
        return ForceMap(
            load=self._scattered(load),
            std=self._scattered(std),
            labels=self._labels[0],
            units=self._labels[1],
            flags=collect([*self.model.flags, *own]),
            allowed=self.family.allow,
            certificate=self.model.certificate,
            geometry=geometry,
            facts=facts,
            provenance=self._provenance,
        )

    def _checked(self, load: Array) -> list[Flag | None]:
        """What a sensor finds in a map beyond what all of them do."""
        return []

    @property
    def _labels(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        if not hasattr(self, "_named"):
            self._named = tuple(c.label for c in self.labels), tuple(c.unit for c in self.labels)
        return self._named

    def _scattered(self, values: Array) -> Array:
        """Values of the loads that may act among all of the surface."""
        if self.kept is None:
            return values
        out = np.zeros(len(self.labels))
        out[self.kept] = values
        return out

    @property
    def _provenance(self) -> dict[str, Any]:
        if not hasattr(self, "_origin"):
            self._origin = provenance(
                self.name,
                settings={
                    **self._settings,
                    "penalty": self.family.penalty if isinstance(self.family.penalty, str | None) else "matrix",
                    "no_pull": self.no_pull,
                    "friction": self.friction,
                    "calibration": None if self.family.calibration is None else str(self.family.calibration),
                },
                inputs={},
                model=self.model.fingerprint,
                prior="white prior on the load of every node" if self.family.L is None else "smooth load",
            )
        return self._origin


def _friction(value: float | None) -> float | None:
    if value is None:
        return None
    from structures.values import positive

    return float(positive("the friction coefficient", value, where="friction"))


def supported(support: ArrayLike | None, points: int) -> NDArray[np.intp] | None:
    """Loads (3 k,) at the nodes of a support: a mask (P,) or node numbers; None is all.

    Raises
    ------
    InputError
        If it does not fit, or is empty.
    """
    if support is None:
        return None
    given = np.asarray(support)
    nodes = np.flatnonzero(given) if given.dtype == bool else np.unique(given)
    fits = given.shape == (points,) if given.dtype == bool else given.dtype.kind in "iu" and np.all(nodes < points)
    if not fits or nodes.size == 0:
        raise InputError("the support does not fit the surface", where="support", found=f"{given.dtype} {given.shape}",
                         expected=f"a mask ({points},) or numbers of nodes, not empty")  # fmt: skip
    return (3 * nodes[:, None] + np.arange(3)).ravel()


def _cut(penalty: Any, basis: Any, kept: NDArray[np.intp]) -> Any:
    """A penalty on the loads that may act."""
    from loadid.families import smoothness

    if penalty is None or (isinstance(penalty, str) and penalty == "identity"):
        return penalty
    L: Any = smoothness.matrix(penalty, len(basis), basis)
    dense = np.asarray(L.toarray() if hasattr(L, "toarray") else L)[:, kept]
    return dense[np.any(dense != 0, axis=1)]


def _settings(family: StaticInversion) -> dict[str, Any]:
    return {
        "penalty": family.penalty,
        "choice": family.choice,
        "noise": family.noise,
        "noise_source": family.noise_source,
        "allow": list(family.allow),
    }


def _with(family: StaticInversion, constraints: list[Any]) -> StaticInversion:
    """The same family under constraints."""
    return family if not constraints else StaticInversion(family.model, constraints=constraints, **_settings(family))


def _without(family: StaticInversion, sensors: list[str]) -> StaticInversion:
    """The same family on fewer sensors, at the same relative lambda."""
    other = StaticInversion(family.model, sensors=sensors, **_settings(family))
    other.calibration = family.calibration
    return other


def _covariance(posterior: Any, R: Array) -> Array:
    """Covariance (6, 6) of the resultant from variances of sums of its rows."""
    if posterior is None:
        return np.zeros((6, 6))
    alone = np.array([float(posterior.variance(r)) for r in R])
    out = np.diag(alone)
    for i in range(6):
        for j in range(i):
            # rows of forces and moments differ in size: scaled, so that neither drowns the other
            a, b = (R[k] / np.sqrt(alone[k]) if alone[k] > 0 else R[k] for k in (i, j))
            both = (float(posterior.variance(a + b)) - float(posterior.variance(a - b))) / 4
            out[i, j] = out[j, i] = both * np.sqrt(max(alone[i], 0.0) * max(alone[j], 0.0))
    return out
