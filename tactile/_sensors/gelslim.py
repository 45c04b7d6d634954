"""Inverse finite elements on a pad that is observed at every node of its surface: F = K U.

After D. Ma, E. Donlon, S. Dong & A. Rodriguez, "Dense tactile force estimation using GelSlim and inverse FEM", IEEE
ICRA (2019), arXiv:1810.04621: markers are interpolated onto the nodes, the normal motion comes from a known indenter
(or is measured), projection is corrected, and one product with the stiffness gives the force at every node. What the
markers do not reach is taken to be free of load, never extrapolated.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from loadid._guards import collect
from loadid._results.facts import provenance
from structures._advice import Advice, Spelling
from structures._flags import Flag
from structures.errors import InputError, digest

from .. import _guards as guards
from .._arrays import Array, Index, Mask, settled_depth
from .._closed.contact import Indenter
from .._pad.stiffness import Completion, surface_stiffness
from .._results.forcemap import ForceFacts, ForceMap, curved_normals
from ..vision._interpolation import Interpolation
from .fixed import CLEAR, TOUCH
from .inversion import Answer, RegionSolver, fused
from .marked import ContactLaw, MarkedSensor, not_built_for_depth, spelled_before
from .multilayer import windows
from .observation import DepthMap, Markers, Wrench
from .posing import StrainWatch, channels, neighbours, of_pad
from .rigid import whole_motion

if TYPE_CHECKING:
    from .._pad.pad import Pad
    from ..vision._eye import Eye


ROUNDS = 20  # in which nodes that would be pulled are let go of an indenter
PASSES = 3  # of projection correction, where the normal motion follows from the solution
KEPT = 32  # interpolations and completions
T = TypeVar("T")


class GelSlim(MarkedSensor):
    """Nodal contact forces by F = K U from markers and a normal motion that is known at every node.

    Parameters
    ----------
    pad : Pad
        One layer of standard bricks as in the paper (its map is wrong by half, W115), or better.
    markers, eye
        As in `MultilayerPad`.
    depth : DepthMap, optional
        A map of the kind that will be measured.
    interpolation : {"local", "linear"}
        Of markers onto nodes, as `tactile.Interpolation`.
    contact : ContactLaw, optional
        Constraints make it least squares on K^-1 F = U under them, in the region of contact; nodes outside the support
        carry nothing, whatever moves.
    allow : sequence of str
        Guard codes whose refusal was overridden on the way here (that of the eye); they stand in every result.

    Raises
    ------
    InputError
        Fewer than three markers, settings that do not fit.
    """

    name = "inverse FEM, F = K U"

    @spelled_before("markers", "contact")
    def __init__(
        self,
        pad: Pad,
        markers: Markers | ArrayLike | None = None,
        *,
        depth: DepthMap | None = None,
        interpolation: str = "local",
        contact: ContactLaw | None = None,
        allow: Sequence[str] = (),
        eye: Eye | None = None,
    ) -> None:
        windowed = None if depth is None else windows(pad, depth, None)
        super().__init__(markers, eye, windowed, contact or ContactLaw())
        self.pad, self.allow, self.interpolation = pad, tuple(allow), interpolation
        places = self.markers.points
        if places.shape[1] == 3 and np.any(places[:, 2] < pad.thickness * (1 - 1e-6)):
            raise InputError(
                "F = K U takes markers on the surface", where="GelSlim, markers", found="markers under it",
                expected="(N, 2), or z = the thickness", hint="MultilayerPad and GelForce take markers at any depth",
            )  # fmt: skip
        self.geometry = of_pad(pad, "nodal")
        self.K = surface_stiffness(pad)
        self._loads = channels(pad.points, "nodal")
        kept = self.contact.loads(pad.points)
        self._may = np.ones(pad.points, bool)
        if kept is not None:
            self._may = np.isin(np.arange(pad.points), kept // 3)
        self._completions: dict[bytes, Completion] = {}
        self._interpolations: dict[bytes, Interpolation] = {}
        self._solver: RegionSolver | None = None
        self._strain = StrainWatch(pad)

    def __repr__(self) -> str:
        return f"<GelSlim: {len(self.markers)} markers, {self.pad!r}>"

    def with_noise(self, noise: ArrayLike) -> GelSlim:
        """The sensor with another noise of its markers; what does not depend on it is shared, not made again.

        Its strain is watched over its own frames.

        Parameters
        ----------
        noise : float or array
            Std of the motion of the markers (m), as `Markers` takes it.

        Returns
        -------
        GelSlim
            Its forces are those of this sensor, their std follows the noise.

        Raises
        ------
        InputError
            A noise that does not fit the markers.
        """
        m = self.markers
        _ = self._seen, self._at_markers, self._fingerprint  # the copy has them then
        other = copy.copy(self)
        other.markers = Markers(m.points, noise, axes=m.axes, slope=m.slope)
        other._solver, other._strain = None, StrainWatch(self.pad)
        return other

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
        y, flags = self._of_frame(found, depth, wrench)
        motion = y[: self.markers.readings_count].reshape(len(self.markers), -1)
        seen = np.asarray(np.isfinite(motion).all(axis=1))
        field = self._interpolation(seen)
        z, how = self._normal(motion, seen, field, None if depth is None else y[motion.size :], indenter)
        known, U, completion = self._solved(motion, seen, field, z, how)
        answer = self._answer(known, U, completion, field, seen, how)
        flags = [*flags, self._moved(motion, answer, completion)]
        return self._map(answer, U, completion, flags, seen, field, how, wrench)

    # -- steps --------------------------------------------------------------------------------------------------------
    def _gel(self) -> Pad:
        return self.pad

    def _interpolation(self, seen: Mask) -> Interpolation:
        points = self.markers.points[seen, :2]
        return _kept(
            self._interpolations, seen.tobytes(), lambda: Interpolation(points, self.pad.nodes2d, self.interpolation)
        )

    def _normal(
        self, motion: Array, seen: Mask, field: Interpolation, deep: Array | None, indenter: Indenter | None
    ) -> tuple[Array, str]:
        """Normal motion at the nodes (P,), NaN where it is not given, and where it comes from."""
        if deep is not None:
            if self.depth is None:
                raise not_built_for_depth()
            z = np.full(self.pad.points, np.nan)
            z[self._deep] = deep
            return z, "measured"
        if self.markers.axes == "XYZ":
            return np.where(field.inside, field.W @ motion[seen, 2], np.nan), "tracked"
        if indenter is not None:
            z, inside = indenter.normal(self.pad.nodes2d)
            settled_depth(float(z.min()), 0.0, self.pad.thickness)
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
        self, motion: Array, seen: Mask, field: Interpolation, z: Array, how: str
    ) -> tuple[Mask, Array, Completion]:
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
    def _deep(self) -> Index:
        """Nodes at which depth is measured."""
        assert self.depth is not None
        return np.flatnonzero(~self.pad.edge)[self.depth.inside]

    @cached_property
    def _at_markers(self) -> Any:
        """Rows of the normal motion of the markers from that of the nodes."""
        return sparse.csr_array(self.pad.from_surface(self.markers.points))[2::3][:, 2::3]

    def _completion(self, known: Mask) -> Completion:
        return _kept(self._completions, known.tobytes(), lambda: Completion.of(self.pad, known, self.K))

    def _answer(
        self, known: Mask, U: Array, completion: Completion, field: Interpolation, seen: Mask, how: str
    ) -> Answer:
        """Forces with their std: the noise of the markers is carried through interpolation and stiffness."""
        half = sparse.csr_array(self._half(field, seen, how)[known.ravel()])
        moved = completion.stiffness @ half
        R = self.geometry["resultant"]
        felt = np.asarray(R[:, completion.known] @ moved)
        reach = np.zeros((R.shape[1], 6))
        reach[completion.known] = np.asarray(moved @ felt.T)
        return Answer(completion.forces(U), completion.spread(half), felt @ felt.T, reach)

    def _half(self, field: Interpolation, seen: Mask, how: str) -> sparse.csr_array:
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
    def _pressed(self, answer: Answer, U: Array, completion: Completion, wrench: Wrench | None) -> tuple[Answer, Any]:
        spread = np.sqrt(np.median(self.markers.noise**2))
        if self._solver is None:
            inside = sparse.diags_array(self._may.astype(float))
            order = inside @ neighbours(self.geometry["cells"], self.geometry["coordinates"]).astype(float) @ inside
            n = 3 * self.pad.points
            prior = np.full(n, 1e-6 * float(np.linalg.norm(self.pad.compliance, ord=1)) / spread)
            H, resultant = self.pad.compliance / spread, self.geometry["resultant"]
            normals = curved_normals(self.geometry["coordinates"], self.geometry["cells"])
            self._solver = RegionSolver(H, prior, resultant, order, self.contact.friction, normals)
        pressure, std = -answer.load[2::3], answer.std[2::3]
        touched = (pressure > TOUCH * pressure.max()) & (pressure > CLEAR * std) & self._may
        found = self._solver.solve(completion.displacements(U) / spread, touched, wrench, answer)
        return Answer(found.load, found.std, found.wrench, answer.reach), guards.stopped(found.converged, found.steps)

    def _moved(self, motion: Array, answer: Answer, completion: Completion) -> Flag | None:
        """W611 of the motion of the markers and the forces found."""
        nodes = self.pad.nodes2d

        def alone(field: Callable[[Array], Array]) -> Array:
            moved = np.column_stack([field(nodes), np.zeros(len(nodes))])
            return completion.forces(moved.ravel()[completion.known])

        def explained(load: Array) -> Array:
            U = self.pad.displacements(load).ravel()
            return np.asarray(self._seen @ U).reshape(len(motion), -1)[:, :2]

        return whole_motion(
            motion[:, :2], answer.load, answer.std, self.markers, nodes, self.pad.thickness, alone, explained,
            self.geometry["resultant"], None if self.eye is None else self.eye.pixel,
        )  # fmt: skip

    @cached_property
    def _seen(self) -> Any:
        """Rows of what is read of the markers from the motion of the nodes."""
        return self.markers.rows(sparse.csr_array(self.pad.from_surface(self.markers.points)))

    @cached_property
    def _fingerprint(self) -> str:
        K = self.pad.structure.K_free
        return digest("pad", K.data, self.pad.nodes2d)

    def _map(
        self, answer: Answer, U: Array, completion: Completion, flags: list[Flag | None], seen: Mask,
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
            *self.pad.flags, *flags, stopped, guards.completed(provided), field.correlated,
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
                settings={"pad": repr(self.pad), "no_pull": self.contact.no_pull, "friction": self.contact.friction},
                inputs={},
                model=self._fingerprint,
                prior="none: the map is a product of the stiffness with what was observed",
            ),
        )


def _kept(store: dict[bytes, T], key: bytes, make: Callable[[], T]) -> T:
    """What was made before for a key, or now; the same under threads, which may empty the store in between."""
    found = store.get(key)
    if found is None:
        found = make()
        if len(store) > KEPT:
            store.clear()
        store[key] = found
    return found
