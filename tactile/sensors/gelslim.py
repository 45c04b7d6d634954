"""Inverse finite elements on a pad that is observed at every node of its surface: F = K U.

After D. Ma, E. Donlon, S. Dong & A. Rodriguez, "Dense tactile force estimation using GelSlim and inverse FEM", IEEE
ICRA (2019), arXiv:1810.04621: markers are interpolated onto the nodes, the normal motion comes from a known indenter
(or is measured), projection is corrected, and one product with the stiffness gives the force at every node. What the
markers do not reach is taken to be free of load, never extrapolated.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from loadid.guards import collect
from loadid.results.facts import provenance
from structures.advice import Advice, Spelling
from structures.errors import InputError, digest, positive
from structures.flags import Flag

from ..closed.contact import Indenter
from ..pad.stiffness import Completion, surface_stiffness
from ..results import guards
from ..results.forcemap import ForceFacts, ForceMap
from ..results.guards import away, completed, contact, typical
from ..vision.interpolation import Interpolation
from .fixed import CLEAR, TOUCH, not_built_for_depth, paired, readings_of
from .inversion import Answer, RegionSolver, fused
from .multilayer import observed, windows
from .observation import DepthMap, Wrench
from .posing import StrainWatch, channels, neighbours, of_pad, supported

if TYPE_CHECKING:
    from ..pad.pad import Pad
    from ..vision.eye import Eye


Array = NDArray[np.float64]
ROUNDS = 20  # in which nodes that would be pulled are let go of an indenter
PASSES = 3  # of projection correction, where the normal motion follows from the solution


class GelSlim:
    """Nodal contact forces by F = K U from markers and a normal motion that is known at every node.

    Parameters
    ----------
    pad : Pad
        One layer of standard bricks as in the paper (its map is wrong by half, W115), or better.
    markers, noise, axes, slope, eye
        As in `MultilayerPad`.
    depth : DepthMap, optional
        A map of the kind that will be measured.
    interpolation : {"local", "linear"}
        Of markers onto nodes, as `tactile.Interpolation`.
    no_pull, friction
        Constraints: least squares on K^-1 F = U under them, in the region of contact.
    support : array, optional
        Nodes of the surface that may be loaded: a mask (P,) or their numbers. The others carry nothing, whatever moves.
    allow : sequence of str
        Guard codes whose refusal was overridden on the way here (that of the eye); they stand in every result.

    Raises
    ------
    InputError
        Fewer than three markers, settings that do not fit.
    """

    name = "inverse FEM, F = K U"

    def __init__(
        self,
        pad: Pad,
        markers: ArrayLike | None = None,
        *,
        noise: Any = None,
        axes: str = "XY",
        depth: DepthMap | None = None,
        slope: ArrayLike | None = None,
        interpolation: str = "local",
        no_pull: bool = False,
        friction: float | None = None,
        support: ArrayLike | None = None,
        allow: Sequence[str] = (),
        eye: Eye | None = None,
    ) -> None:
        self.pad, self.eye, self.allow, self.interpolation = pad, eye, tuple(allow), interpolation
        self.no_pull = bool(no_pull)
        self.friction = None if friction is None else positive("the friction coefficient", friction, where="friction")
        self.markers = observed(markers, noise, axes, slope, eye)
        places = self.markers.points
        if places.shape[1] == 3 and np.any(places[:, 2] < pad.thickness * (1 - 1e-6)):
            raise InputError(
                "F = K U takes markers on the surface", where="GelSlim, markers", found="markers under it",
                expected="(N, 2), or z = the thickness", hint="MultilayerPad and GelForce take markers at any depth",
            )  # fmt: skip
        self.depth = None if depth is None else windows(pad, depth, None)
        self.geometry = of_pad(pad, "nodal")
        self.K = surface_stiffness(pad)
        self._loads = channels(pad.points, "nodal")
        self._offset = np.zeros((len(self.markers), len(axes)))
        self._rest: Any = 0.0
        kept = supported(support, pad.points)
        self._may = np.ones(pad.points, bool)
        if kept is not None:
            self._may = np.isin(np.arange(pad.points), kept // 3)
        self._completions: dict[bytes, Completion] = {}
        self._noted: dict[int, Flag | None] = {}
        self._interpolations: dict[bytes, Interpolation] = {}
        self._solver: RegionSolver | None = None
        self._strain = StrainWatch(pad)

    def __repr__(self) -> str:
        return f"<GelSlim: {len(self.markers)} markers, {self.pad!r}>"

    # -- doing --------------------------------------------------------------------------------------------------------
    def estimate(
        self,
        found: ArrayLike,
        depth: DepthMap | None = None,
        *,
        indenter: Indenter | None = None,
        wrench: Wrench | None = None,
    ) -> ForceMap:
        """Nodal forces of one frame.

        Parameters
        ----------
        found : array (N, 2 or 3), or an image
            Motion of the markers (m), NaN where one is lost.
        depth : DepthMap, optional
            Measured normal motion.
        indenter : Sphere or Cylinder, optional
            Completes the normal motion where it touches; nodes that it would have to pull are let go. Elsewhere the
            surface carries no normal load.
        wrench : Wrench, optional
            Of a force/torque sensor.

        Returns
        -------
        ForceMap
            Nodal forces (N).

        Raises
        ------
        InputError
            If neither markers, depth nor an indenter give the normal motion, or readings do not fit.
        """
        motion, flags = self._motion(found, depth)
        seen = np.asarray(np.isfinite(motion).all(axis=1))
        field = self._interpolation(seen)
        z, how = self._normal(motion, seen, field, depth, indenter)
        known, U, completion = self._solved(motion, seen, field, z, how)
        answer = self._answer(known, U, completion, field, seen, how)
        flags = [*flags, self._moved(motion, answer, completion)]
        return self._map(answer, U, completion, flags, seen, field, how, wrench)

    def stream(self, frames: Iterable[Any], depths: Iterable[DepthMap] | None = None) -> Iterator[ForceMap]:
        """Force maps of frames, one after another, as they come."""
        if depths is None:
            yield from (self.estimate(frame) for frame in frames)
        else:
            yield from (self.estimate(f, d) for f, d in paired(frames, depths))

    def zero(self, frames: Sequence[Any], depths: Sequence[DepthMap] | None = None) -> Self:
        """Take the mean motion of unloaded frames as zero. Returns the sensor."""
        self._offset = np.zeros_like(self._offset)
        listed = [self._motion(f, None if depths is None else depths[i])[0] for i, f in enumerate(frames)]
        if not listed:
            raise InputError("no frames to take zero from", where="zero", found="none", expected="unloaded frames")
        stack = np.array(listed)
        self._offset = _mean(stack)
        if self.depth is not None and depths is not None:
            self._rest = _mean(np.array([self.depth.readings(d) for d in depths]))
        return self

    # -- steps --------------------------------------------------------------------------------------------------------
    def _motion(self, found: ArrayLike, depth: DepthMap | None) -> tuple[Array, list[Flag | None]]:
        seen, flags = readings_of(found, self.markers, self.eye, depth)
        return seen.reshape(len(self.markers), -1) - self._offset, flags

    def _interpolation(self, seen: NDArray[np.bool_]) -> Interpolation:
        key = seen.tobytes()
        if key not in self._interpolations:
            if len(self._interpolations) > 32:
                self._interpolations.clear()
                self._noted.clear()
            points = self.markers.points[seen, :2]
            self._interpolations[key] = Interpolation(points, self.pad.nodes2d, self.interpolation)
        return self._interpolations[key]

    def _normal(
        self, motion: Array, seen: NDArray, field: Interpolation, depth: DepthMap | None, indenter: Indenter | None
    ) -> tuple[Array, str]:
        """Normal motion at the nodes (P,), NaN where it is not given, and where it comes from."""
        if depth is not None:
            if self.depth is None:
                raise not_built_for_depth()
            z = np.full(self.pad.points, np.nan)
            z[self._deep] = self.depth.readings(depth) - self._rest
            return z, "measured"
        if self.markers.axes == "XYZ":
            return np.where(field.inside, field.W @ motion[seen, 2], np.nan), "tracked"
        if indenter is not None:
            z, inside = indenter.normal(self.pad.nodes2d)
            return np.where(inside, z, np.nan), "completed"
        raise InputError(
            "the normal motion is not known", where="estimate", found="in-plane markers alone",
            expected=Advice(
                Spelling("depth= a measured map, indenter= a known shape", "depth maps (--depth)"),
                ", or markers tracked along ", Spelling("X, Y and Z", "x, y and z"),
            ),
            hint=Advice(Spelling("MultilayerPad", "--sensor multilayer"), " inverts in-plane markers alone"),
        )  # fmt: skip

    def _solved(
        self, motion: Array, seen: NDArray, field: Interpolation, z: Array, how: str
    ) -> tuple[NDArray, Array, Completion]:
        """What is known (P, 3), its values, and the completion; nodes that an indenter would pull are let go."""
        known = np.column_stack([field.inside, field.inside, np.isfinite(z)]) & self._may[:, None]
        values = np.column_stack([field.W @ motion[seen, 0], field.W @ motion[seen, 1], np.where(known[:, 2], z, 0.0)])
        slope = self.markers.slope
        for _ in range(ROUNDS):
            completion = self._completion(known)
            U = values[known]
            for _ in range(PASSES):
                if slope is None:
                    break
                lifted = completion.displacements(U).reshape(-1, 3)[:, 2]
                at = self._at_markers @ lifted
                corrected = motion[seen, :2] - slope[seen] * at[seen, None]
                values[:, :2] = field.W @ corrected
                U = values[known]
            force = completion.forces(U).reshape(-1, 3)[:, 2]
            partial = known[:, 2] & ~known[:, 2].all()
            pulled = partial & (force > 1e-9 * np.abs(force).max()) & (how == "completed")
            if not pulled.any():
                break
            known[pulled, 2] = False
        return known, U, completion

    @property
    def _deep(self) -> NDArray[np.intp]:
        """Nodes at which depth is measured."""
        assert self.depth is not None
        return np.flatnonzero(~self.pad.edge)[self.depth.seen]

    @cached_property
    def _at_markers(self) -> Any:
        """Rows of the normal motion of the markers from that of the nodes."""
        return sparse.csr_array(self.pad.from_surface(self.markers.points))[2::3][:, 2::3]

    def _completion(self, known: NDArray[np.bool_]) -> Completion:
        key = known.tobytes()
        if key not in self._completions:
            if len(self._completions) > 32:
                self._completions.clear()
            self._completions[key] = Completion.of(self.pad, known, self.K)
        return self._completions[key]

    def _answer(
        self, known: NDArray, U: Array, completion: Completion, field: Interpolation, seen: NDArray, how: str
    ) -> Answer:
        """Forces with their std: the noise of the markers is carried through interpolation and stiffness."""
        half = sparse.csr_array(self._half(field, seen, how)[known.ravel()])
        moved = completion.stiffness @ half
        R = self.geometry["resultant"]
        felt = np.asarray(R[:, completion.known] @ moved)
        reach = np.zeros((R.shape[1], 6))
        reach[completion.known] = np.asarray(moved @ felt.T)
        return Answer(completion.forces(U), completion.spread(half), felt @ felt.T, reach)

    def _half(self, field: Interpolation, seen: NDArray, how: str) -> sparse.csr_array:
        """Factor (3 P, r) of the covariance of the motion of the nodes."""
        noise, unit = self.markers.noise[seen], np.eye(3)
        tracked = range(3 if how == "tracked" else 2)  # a measured normal motion brings its own noise, not the markers'
        parts = [sparse.kron(field.W @ sparse.diags_array(noise[:, k]), unit[:, [k]]) for k in tracked]
        if how == "measured" and self.depth is not None:
            spread = np.zeros(self.pad.points)
            spread[self._deep] = self.depth.averaging.std(self.depth.template.noise)
            parts.append(sparse.kron(sparse.diags_array(spread), unit[:, [2]]))
        return sparse.hstack(parts).tocsr()

    # -- the answer ---------------------------------------------------------------------------------------------------
    @property
    def constrained(self) -> bool:
        """Whether the map may not pull, or not leave its friction cone."""
        return self.no_pull or self.friction is not None

    def _pressed(self, answer: Answer, U: Array, completion: Completion, wrench: Wrench | None) -> tuple[Answer, Any]:
        spread = np.sqrt(np.median(self.markers.noise**2))
        if self._solver is None:
            inside = sparse.diags_array(self._may.astype(float))
            order = inside @ neighbours(self.geometry["cells"], self.geometry["coordinates"]).astype(float) @ inside
            n = 3 * self.pad.points
            self._solver = RegionSolver(
                self.pad.compliance / spread,
                np.full(n, 1e-6 * self._scale / spread),
                self.geometry["resultant"],
                order,
                self.friction,
            )
        pressure, std = -answer.load[2::3], answer.std[2::3]
        touched = (pressure > TOUCH * pressure.max()) & (pressure > CLEAR * std) & self._may
        found = self._solver.solve(completion.displacements(U) / spread, touched, wrench, answer)
        return Answer(found.load, found.std, found.wrench, answer.reach), guards.stopped(found.converged, found.steps)

    def _moved(self, motion: Array, answer: Answer, completion: Completion) -> Flag | None:
        """W611 of the motion of the markers and the forces found."""
        places, noise, nodes = self.markers.points[:, :2], self.markers.noise[:, :2], self.pad.nodes2d

        def alone(field: Array) -> Array:
            moved = np.column_stack([np.broadcast_to(field, nodes.shape), np.zeros(len(nodes))])
            return completion.forces(moved.ravel()[completion.known])

        shift = typical(motion[:, :2], noise)
        local = answer.load - alone(shift) if shift.any() else answer.load

        def explained(near: NDArray[np.bool_]) -> Array:
            U = self.pad.displacements(local * np.repeat(near, 3)).ravel()
            return np.asarray(self._seen @ U).reshape(len(places), -1)[:, :2]

        touched = contact(local, answer.std)
        found = away(motion[:, :2], explained, touched, nodes, places, noise, self.pad.thickness)
        force = np.zeros(3) if found is None else self.geometry["resultant"][:3] @ alone(found.field(nodes))
        return guards.moved(found, force, None if self.eye is None else self.eye.pixel)

    @cached_property
    def _seen(self) -> Any:
        """Rows of what is read of the markers from the motion of the nodes."""
        return self.markers.rows(sparse.csr_array(self.pad.from_surface(self.markers.points)))

    def _correlated(self, field: Interpolation) -> Flag | None:
        """W605, found once for every set of markers that are seen."""
        key = id(field)
        if key not in self._noted:
            self._noted[key] = field.flag()
        return self._noted[key]

    @cached_property
    def _fingerprint(self) -> str:
        K = self.pad.structure.K_free
        return digest("pad", K.data, self.pad.nodes2d)

    @property
    def _scale(self) -> float:
        return float(np.linalg.norm(self.pad.compliance, ord=1))

    def _map(
        self, answer: Answer, U: Array, completion: Completion, flags: list[Flag | None], seen: NDArray,
        field: Interpolation, how: str, wrench: Wrench | None,
    ) -> ForceMap:  # fmt: skip
        stopped = None
        if self.constrained:
            answer, stopped = self._pressed(answer, U, completion, wrench)
        elif wrench is not None:
            answer = fused(answer, self.geometry["resultant"], wrench)
        provided = {"x": "tracked", "y": "tracked", "z": how}
        lost = int(np.sum(~seen)) * len(self.markers.axes)
        own = [
            *self.pad.flags, *flags, stopped, completed(provided), self._correlated(field),
            self._strain.check(answer.load.reshape(-1, 3)),
            guards.lost(lost, self.markers.readings_count),
        ]  # fmt: skip
        return ForceMap(
            load=answer.load,
            std=answer.std,
            labels=[c.label for c in self._loads],
            units=[c.unit for c in self._loads],
            flags=collect(own),
            allowed=self.allow,
            geometry={**self.geometry, "resultant_covariance": answer.wrench},
            facts=ForceFacts(
                path="F = K U",
                m=self.markers.readings_count - lost,
                n=len(answer.load),
                lost=lost,
                free_of_load=int(completion.others.size),
                outside_hull=int(np.sum(~field.inside)),
                provided=provided,
            ),
            provenance=provenance(
                self.name,
                settings={"pad": repr(self.pad), "no_pull": self.no_pull, "friction": self.friction},
                inputs={},
                model=self._fingerprint,
                prior="none: the map is a product of the stiffness with what was observed",
            ),
        )


def _mean(values: Array) -> Array:
    """Mean over the first axis of what is finite; zero where nothing is."""
    known = np.isfinite(values)
    return np.asarray(np.where(known, values, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1))
