"""The answer of every tactile sensor: a force map, a load estimate that knows its surface; of one frame or of many."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from loadid._results.estimate import Axis, LoadEstimate
from loadid._results.facts import Facts, fact
from structures._elements.surfaces import at_nodes
from structures._flags import Flag
from structures._system.factor import SparseLU
from structures.errors import InputError

from .._arrays import Array, Index, Mask, shaped
from .contacts import CLEAR as CLEAR
from .contacts import SHARE, Contact, Vector, apart, whole
from .report import write_report

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


LEVEL = 1e-6  # of its side, to which a flat surface is flat
PROVIDED = ("tracked", "measured", "completed")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ForceFacts(Facts):
    """Facts of a force map; in a record of several frames, what differs between them is a tuple of all.

    Readings that are `lost`; `strays`, markers that contradict the others; `misfit`, the residual of the markers over
    their noise; nodes `free_of_load` and `outside_hull` of the markers; `provided`, as `ForceMap.provided`; motion of
    the whole `image` that was taken out, shift along x and y (m), turn (rad), stretch and offsets (m), and its std.
    """

    lost: int | tuple[int, ...] | None = fact()
    strays: int | tuple[int, ...] | None = fact()
    misfit: float | tuple[float, ...] | None = fact()
    lambda_rule: str | tuple[str, ...] | None = fact()
    free_of_load: int | tuple[int, ...] | None = fact()
    outside_hull: int | tuple[int, ...] | None = fact()
    provided: Mapping[str, str] | None = fact()
    image: tuple[float, ...] | tuple[tuple[float, ...], ...] | None = fact()
    image_std: tuple[float, ...] | tuple[tuple[float, ...], ...] | None = fact()


def curved_normals(places: Array, cells: Index | None) -> Array | None:
    """Outward unit normals of a curved surface at its nodes (P, 3); None of a flat one, whose normal is Z."""
    if cells is None or np.ptp(places[:, 2]) <= LEVEL * np.ptp(places[:, 0]):
        return None
    return at_nodes(places, cells)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ForceMap(LoadEstimate):
    """A contact force field on the surface of a pad, with its uncertainty.

    A `loadid.LoadEstimate`: ``load`` and ``std`` hold tractions (Pa, ``geometry["kind"] == "hats"``) or nodal forces
    (N, ``"nodal"``), node by node, components X, Y, Z: (3 P,) for one frame or (frames, 3 P). Tractions act on the
    pad; a pressure is ``-t_z``. ``geometry`` holds also the boundary mass, the centre for moments and the covariance
    of the resultant.
    """

    facts: ForceFacts = field(default_factory=ForceFacts)

    kind_of_facts: ClassVar[type[Facts]] = ForceFacts

    def __repr__(self) -> str:
        *frames, loads = self.load.shape
        told = f"{frames[0]} frames" if frames else "no surface" if self.geometry is None else f"{self.resultant()}"
        return f"<{type(self).__name__}, {loads // 3} nodes, {told}; {len(self.flags)} flags>"

    @property
    def provided(self) -> Mapping[str, str]:
        """Where each component of the motion came from: ``tracked``, ``measured``, ``completed`` or ``unknown``."""
        return dict(self.facts.provided or {})

    @property
    def single(self) -> bool:
        """Whether this is one frame."""
        return self.load.ndim == 1

    @property
    def strongest(self) -> int:
        """Frame of the largest force, from 0."""
        return int(np.argmax(np.linalg.norm(np.atleast_2d(self.resultant().value), axis=1)))

    def chosen(self, frame: int | None = None) -> int:
        """The frame asked for, from 0, or the strongest.

        Raises
        ------
        InputError
            If it is not there.
        """
        count = 1 if self.single else len(self.load)
        if frame is None:
            return self.strongest
        if not -count <= frame < count:
            raise InputError("there is no such frame", where="frame", found=frame, expected=f"0 to {count - 1}")
        return frame % count

    def frame_name(self, k: int) -> str:
        """``frame 7`` or ``1.25 s``; nothing of a single frame."""
        if self.axis is None:
            return ""
        value = self.axis.values[k]
        return f"{value:.3g} s" if self.axis.name == "time" else f"frame {value:.0f}"

    @property
    def nodes(self) -> Array:
        """Places of the nodes (P, 3) in m."""
        return np.asarray(self._geometry["coordinates"], float)

    @property
    def cells(self) -> Index | None:
        """Nodes of each cell of the surface (cells, corners); None of points without cells."""
        cells = self._geometry.get("cells")
        return None if cells is None else np.asarray(cells, np.intp)

    @property
    def areas(self) -> Array:
        """Tributary areas (P,) in m^2."""
        return np.asarray(self._geometry["measures"], float)

    def frame(self, index: int) -> Self:
        """One frame of a sequence."""
        if self.single:
            return self
        cut: dict[str, Any] = {
            n: None if getattr(self, n) is None else getattr(self, n)[index]
            for n in ("load", "std", "response", "residual")
        }
        spread = self._covariance if self._covariance.ndim == 2 else self._covariance[index]
        noise = self._geometry.get("noise_std")
        own = {} if noise is None else {"noise_std": noise if np.ndim(noise) == 1 else noise[index]}
        return replace(self, axis=None, geometry={**self._geometry, "resultant_covariance": spread, **own}, **cut)

    def forces(self) -> Array:
        """Consistent nodal forces (..., P, 3) in N."""
        g = self._vectors(self.load)
        if self._geometry["kind"] == "nodal":
            return g
        return self._apply(lambda column: np.asarray(self._mass @ column), g)

    def traction(self) -> Array:
        """Tractions at the nodes (..., P, 3) in Pa: of nodal forces by the boundary mass (or tributary areas)."""
        g = self._vectors(self.load)
        if self._geometry["kind"] != "nodal":
            return g
        if self._solve is None:
            return g / self.areas[:, None]
        return self._apply(self._solve, g)

    def pressure(self) -> Array:
        """Pressure along the normal of the surface at the nodes (..., P) in Pa, positive where the pad is pressed."""
        return self.pressure_of(self.traction())

    def pressure_of(self, traction: Array) -> Array:
        """Pressure (..., P) of tractions (..., P, 3) on this surface, both in Pa: along Z where it is flat."""
        n = self.normals
        return -traction[..., 2] if n is None else -np.sum(traction * n, axis=-1)

    @cached_property
    def normals(self) -> Array | None:
        """Outward unit normals of a curved surface at its nodes (P, 3); None of a flat one, whose normal is Z."""
        return curved_normals(self.nodes, self.cells)

    def pressure_std(self) -> Array:
        """Std of the pressure at the nodes (..., P) in Pa; of nodal forces over the areas of their nodes."""
        return self._normal_std(self.std)

    def pressure_noise(self) -> Array:
        """Std of the pressure at the nodes (..., P) in Pa by noise alone, without what is unseen or the model's error.

        A pressure that is clear of it is none of noise, however little its band says of its size.
        """
        known = self._geometry.get("noise_std")
        return self._normal_std(self.std if known is None else np.broadcast_to(known, self.std.shape))

    def _normal_std(self, std: NDArray[Any]) -> Array:
        each, n = self._vectors(std), self.normals
        spread = each[..., 2] if n is None else np.sqrt(np.sum((each * n) ** 2, axis=-1))
        return np.asarray(spread / self.areas if self._geometry["kind"] == "nodal" else spread)

    def resultant(self) -> Vector:
        """Force on the pad, (..., 3) in N, with its std."""
        return self._wrench(slice(0, 3), "N")

    def torque(self, about: ArrayLike | None = None) -> Vector:
        """Moment of the load, (..., 3) in N m, about the centre of the loaded surface or another point (x, y, z)."""
        if about is None:
            return self._wrench(slice(3, 6), "N m")
        point = shaped(about, (3,), where="torque, about", what="no point", hint="(x, y, z) in m")
        arm = np.asarray(self._geometry["about"], float) - point
        cross = np.array([[0, -arm[2], arm[1]], [arm[2], 0, -arm[0]], [-arm[1], arm[0], 0]])
        turn = np.hstack([cross, np.eye(3)])
        values = self._rows() @ turn.T
        return Vector(values, _spread(turn @ self._covariance @ turn.T, values), "N m")

    def contact(self, share: float = SHARE) -> Contact:
        """Where the pad is touched: pressure above `share` of its peak and clear of its noise. One frame.

        Raises
        ------
        InputError
            For a sequence (ask ``frame(i)``), or a share outside 0 to 1.
        """
        return whole(self, share)

    def contacts(self, share: float = SHARE) -> tuple[Contact, ...]:
        """Each region that the pad is touched in, the strongest first: as `contact`, of nodes that hang together.

        A region counts where its pressure, summed up, stands so clear of its noise that a map of noise alone has none
        in 999 of 1000 frames. The forces of all regions add up to the resultant.

        Raises
        ------
        InputError
            As `contact`.
        """
        return apart(self, share)

    def sums(self, nodes: Mask) -> Array:
        """Rows (3, 3 P) that make the force (N) on some nodes, a mask (P,), of the load."""
        weight = np.asarray(nodes, float)
        if self._geometry["kind"] != "nodal":
            weight = np.asarray(self._mass.T @ weight)
        return np.kron(weight, np.eye(3))

    def plot(
        self,
        kind: str = "map",
        *,
        truth: ArrayLike | None = None,
        ax: Axes | None = None,
        path: str | os.PathLike[str] | None = None,
        show: bool = False,
    ) -> Figure:
        """Picture: ``"map"`` (pressure, shear, std; force and torque of a sequence below), or as `LoadEstimate.plot`.

        Parameters
        ----------
        kind : str
        truth : array (P, 3) or (frames, P, 3), optional
            Known tractions (Pa), for ``"map"``.
        ax, path, show
            As `LoadEstimate.plot`.
        """
        if kind != "map":
            return super().plot(kind, truth=truth, ax=ax, path=path, show=show)
        from loadid._plots.style import save

        from .pictures import map_figure, sequence_figure

        figure = map_figure(self, truth=truth) if self.single else sequence_figure(self, truth=truth)
        if path is not None:
            save(figure, path)
        if show:
            from matplotlib import pyplot

            pyplot.show()
        return figure

    def report(self, path: str | os.PathLike[str], *, truth: ArrayLike | None = None) -> None:
        """Write one self-contained HTML page."""
        write_report(self, path, truth=truth)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Self:
        """Read a result file.

        Raises
        ------
        InputError
            If the file is missing, of another kind, damaged, or no force map.
        """
        found = LoadEstimate.read(path)
        if found.geometry is None or "resultant_covariance" not in found.geometry:
            raise InputError(
                "this result is no force map", where=str(path), found="a load estimate",
                expected="what a tactile sensor saved", hint="loadid.LoadEstimate.read reads it",
            )  # fmt: skip
        return cls(**{f.name: getattr(found, f.name) for f in fields(LoadEstimate)})

    # -- inside -------------------------------------------------------------------------------------------------------
    @property
    def _geometry(self) -> Mapping[str, Any]:
        assert self.geometry is not None
        return self.geometry

    @cached_property
    def _mass(self) -> sparse.csr_array:
        g = self._geometry
        count = len(g["measures"])
        return sparse.csr_array((g["mass_data"], g["mass_indices"], g["mass_indptr"]), shape=(count, count))

    @cached_property
    def _solve(self) -> Any:
        return SparseLU(self._mass).solve if "mass_data" in self._geometry else None

    @property
    def _covariance(self) -> Array:
        return np.asarray(self._geometry["resultant_covariance"], float)

    def _vectors(self, values: NDArray[Any]) -> Array:
        return values.reshape(*values.shape[:-1], -1, 3)

    def _apply(self, act: Any, g: Array) -> Array:
        flat = np.ascontiguousarray(np.moveaxis(g, -2, 0).reshape(g.shape[-2], -1))
        done = np.asarray(act(flat)).reshape(g.shape[-2], *g.shape[:-2], 3)
        return np.moveaxis(done, 0, -2)

    def _rows(self) -> Array:
        return np.asarray(self.load @ np.asarray(self._geometry["resultant"], float).T)

    def _wrench(self, part: slice, unit: str) -> Vector:
        values = self._rows()[..., part]
        return Vector(values, _spread(self._covariance[..., part, part], values), unit)


def _spread(covariance: Array, values: Array) -> Array:
    variance = np.diagonal(covariance, axis1=-2, axis2=-1)
    return np.broadcast_to(np.sqrt(np.maximum(variance, 0.0)), values.shape)


def record(
    maps: Iterable[ForceMap], *, numbers: Sequence[int] | None = None, times: ArrayLike | None = None
) -> ForceMap:
    """One force map of the single frames of a sensor, in their order; ``load`` and ``std`` are (frames, 3 P).

    The axis counts the frames by `numbers` (from 1), or is time by `times` (s), ascending. What differs between frames
    in ``facts`` is a list; of a finding that several frames share the strongest is kept, with their number. Posterior
    and residuals stay with the frames. Refused: no frames, sequences among them, frames of different sensors.
    """
    frames = list(maps)
    if not frames:
        raise InputError("no frames to record", where="record", found="none", expected="force maps of single frames")
    first = frames[0]
    for k, frame in enumerate(frames):
        _require_alike(frame, first, k)
    known = list(range(1, len(frames) + 1)) if numbers is None else [int(n) for n in numbers]
    assert first.geometry is not None
    spread = np.array([f.geometry["resultant_covariance"] for f in frames if f.geometry is not None])
    noise = np.array([f.geometry.get("noise_std", f.std) for f in frames if f.geometry is not None])
    return ForceMap(
        load=np.array([f.load for f in frames]),
        std=np.array([f.std for f in frames]),
        bias=_all([f.bias for f in frames]),
        labels=first.labels,
        units=first.units,
        axis=_axis(len(frames), known, times),
        flags=shared([f.flags for f in frames], known),
        allowed=first.allowed,
        certificate=first.certificate,
        choice=first.choice if all(f.choice is first.choice for f in frames) else None,
        provenance=first.provenance,
        geometry={**first.geometry, "resultant_covariance": spread, "noise_std": noise},
        facts=_facts([f.facts for f in frames]),
    )


def shared(flags: Sequence[Iterable[Flag]], numbers: Sequence[int]) -> tuple[Flag, ...]:
    """Every code of the flags of numbered frames once: the finding with the largest number, and in which frames."""
    found: dict[str, list[tuple[int, Flag]]] = {}
    for number, of_frame in zip(numbers, flags, strict=True):
        for flag in of_frame:
            found.setdefault(flag.code, []).append((number, flag))
    return tuple(_one(listed, len(flags)) for listed in found.values())


def _one(listed: list[tuple[int, Flag]], total: int) -> Flag:
    number, strongest = max(listed, key=lambda pair: _size(pair[1]))
    frames = sorted({n for n, _ in listed})
    if total == 1 or (len(frames) == total and len({f.message for _, f in listed}) == 1):
        return strongest
    same = len({f.message for _, f in listed}) == 1
    most = f"from frame {frames[0]}" if same else f"most in frame {number}"
    where = f"in {len(frames)} of {total} frames, {most}"
    return replace(strongest, message=f"{strongest.message} ({where})")


def _size(flag: Flag) -> float:
    value = flag.evidence.value
    return 0.0 if isinstance(value, str) else abs(float(value))


def _require_alike(frame: ForceMap, first: ForceMap, k: int) -> None:
    if not frame.single:
        raise InputError("a sequence among single frames", where=f"record, frame {k + 1}", found=frame.load.shape,
                         expected="(3 P,)", hint="force.frame(i) gives one")  # fmt: skip
    same = frame.labels == first.labels and frame.units == first.units and np.array_equal(frame.nodes, first.nodes)
    if not same:
        raise InputError("frames of different sensors", where=f"record, frame {k + 1}",
                         found=f"{len(frame.labels)} loads in {frame.units[0]}",
                         expected=f"{len(first.labels)} in {first.units[0]}, on the nodes of frame 1")  # fmt: skip


def _axis(count: int, numbers: list[int], times: ArrayLike | None) -> Axis:
    where, what = "record" if times is None else "record, times", "the axis does not fit the frames"
    values = shaped(numbers if times is None else times, (count,), where=where, what=what)
    if not np.all(np.diff(values) > 0):
        raise InputError(what, where=where, found="values that do not grow", expected=f"{count} numbers, ascending")
    return Axis("frame", "", values) if times is None else Axis("time", "s", values)


def _all(arrays: list[Any]) -> Any:
    return None if any(a is None for a in arrays) else np.array(arrays)


def _facts(listed: list[ForceFacts]) -> ForceFacts:
    """What all frames share as it is, the rest as a list."""
    out: dict[str, Any] = {}
    for name in dict.fromkeys(key for facts in listed for key in facts):
        values = [facts.get(name) for facts in listed]  # as files hold them
        out[name] = values[0] if all(_equal(v, values[0]) for v in values) else values
    provided = _provided([dict(facts.provided or {}) for facts in listed])
    return ForceFacts.of({**out, "provided": provided, "frames": len(listed)})


def _provided(listed: list[dict[str, str]]) -> dict[str, str]:
    """Of each component the least that any frame can say: completed, then measured, then tracked."""
    axes = dict.fromkeys(axis for one in listed for axis in one)
    return {axis: max((one[axis] for one in listed if axis in one), key=PROVIDED.index) for axis in axes}


def _equal(a: Any, b: Any) -> bool:
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return np.array_equal(a, b)
    return bool(a == b)
