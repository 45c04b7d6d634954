"""What a finite-element model is, before anybody trusts it: mass, frequencies, free motions, and what does not fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from ..._models.reduction import modes
from ...errors import InputError, NotIdentifiable

if TYPE_CHECKING:
    from ._model import FeModel

Array = NDArray[np.float64]
SPEED = (150.0, 25_000.0)  # m/s of waves: rubber is below, diamond at 12 000 with what a mesh adds
DENSEST = 22_600.0  # kg/m^3
ALIKE = 0.01  # relative difference of the masses along X, Y and Z that consistent and lumped matrices do not have
RESISTED = 0.5  # share of rows that a rigid translation must not load
EXTRA = 6  # rigid-body modes of one part


@dataclass(frozen=True)
class FeSummary:
    """What was imported, in numbers and in words.

    Parameters
    ----------
    source : str
        Names of the files.
    dofs, nodes, parts : int
        Degrees of freedom, nodes with a place, parts that nothing connects.
    mass : float or None
        kg, by the translations of M.
    centre : tuple of float or None
        Centre of mass (m).
    size : tuple of float or None
        Extent along X, Y and Z (m).
    speed : float or None
        Speed (m/s) of waves that the elements have, within a factor of some two: a check of the units.
    rigid : int or None
        Rigid-body modes.
    frequencies : tuple of float
        Hz, the first elastic ones.
    remarks : tuple of str
        What does not fit.
    notes : tuple of str
        What was passed over or done while reading.
    """

    source: str
    dofs: int
    nodes: int
    parts: int
    mass: float | None
    centre: tuple[float, ...] | None
    size: tuple[float, ...] | None
    speed: float | None
    rigid: int | None
    frequencies: tuple[float, ...]
    remarks: tuple[str, ...]
    notes: tuple[str, ...]

    def __str__(self) -> str:
        """All of it, a line each."""
        lines = [f"{self.source}: {self.dofs} DOFs, {self.nodes} nodes with a place"]
        if self.mass is not None:
            centre = "" if self.centre is None else ", centre at ({:.4g}, {:.4g}, {:.4g}) m".format(*self.centre)
            lines.append(f"  mass {self.mass:.4g} kg{centre}")
        if self.size is not None:
            speed = "" if self.speed is None else f"; waves of some {self.speed:.2g} m/s (steel 5000, plastics 1500)"
            lines.append("  size {:.4g} x {:.4g} x {:.4g} m".format(*self.size) + speed)
        if self.rigid is not None:
            lines.append(f"  rigid-body modes: {self.rigid}")
        if self.frequencies:
            lines.append("  natural frequencies " + ", ".join(f"{f:.4g}" for f in self.frequencies) + " Hz")
        lines += [f"  does not fit: {r}" for r in self.remarks]
        return "\n".join([*lines, *(f"  note: {n}" for n in self.notes)])


def summary(model: FeModel, frequencies: int | Sequence[float] = 10) -> FeSummary:
    """Summary of a model; see `FeModel.summary`."""
    remarks: list[str] = []
    parts, mass, centre, speed = 1, None, None, None
    if model.K is not None:
        parts = _parts(model.K)
        remarks += _shape_of(model)
        if parts > 1:
            remarks.append(f"{parts} parts that nothing connects: merge coincident nodes, or tie the parts")
    if model.M is not None:
        mass, centre, told = _mass(model)
        remarks += told
        speed = _speed(model)
        remarks += _units(model, mass, speed)
    rigid, found, told = _frequencies(model, frequencies)
    size = tuple(np.ptp(model.places, axis=0).tolist()) if len(model.places) else None
    return FeSummary(
        model.source, len(model.labels) if model.K is not None else _shaped(model), len(model.nodes), parts, mass,
        centre, size, speed, rigid, found, (*remarks, *told), model.notes,
    )  # fmt: skip


def _shaped(model: FeModel) -> int:
    return 0 if model.modes is None else len(model.modes.labels)


def _parts(K: sparse.csr_array) -> int:
    """Connected parts, rows without any stiffness aside."""
    used = np.flatnonzero(np.asarray(abs(K).sum(axis=1)).ravel() > 0)
    return int(connected_components(K[used][:, used], directed=False)[0]) if used.size else 0


def _shape_of(model: FeModel) -> list[str]:
    """What is wrong with the matrices themselves."""
    out = []
    for name, A in model.matrices.items():
        skew, largest = abs(A - A.T), float(np.abs(A.data).max(initial=0.0))
        if skew.nnz and skew.max() > 1e-6 * largest:
            out.append(f"{name} is not symmetric: entries differ by {skew.max() / largest:.2g} of the largest")
        below = np.flatnonzero(A.diagonal() < 0)
        if below.size:
            node, code = model.labels[below[0]]
            word = {"K": "stiffness", "M": "mass", "C": "damping"}[name]
            out.append(f"negative {word} at {below.size} DOFs, first at node {node}, direction {code}")
    strange = np.setdiff1d(model.labels[:, 0], model.nodes)
    if len(model.nodes) and len(strange):
        out.append(f"{len(strange)} nodes of the matrices have no place, first {strange[0]}: internal nodes of "
                   "elements, or the nodes of another model")  # fmt: skip
    resisted = _resisted(model)
    if resisted > RESISTED:
        out.append(f"{100 * resisted:.0f} % of the rows of K resist a rigid translation: the labels of the rows, or "
                   "their order, are not those of K")  # fmt: skip
    return out


def _resisted(model: FeModel) -> float:
    """Largest share, over the axes, of translational rows that a rigid translation along it loads."""
    K, code = model.K, model.labels[:, 1]
    assert K is not None
    worst, rows = 0.0, (code >= 1) & (code <= 3)
    for axis in (1, 2, 3):
        moved = (code == axis).astype(float)
        force, scale = np.abs(K @ moved), abs(K) @ moved
        own = rows & (scale > 0)
        if own.any():
            worst = max(worst, float(np.mean(force[own] > 1e-5 * scale[own])))
    return worst


def _mass(model: FeModel) -> tuple[float | None, tuple[float, ...] | None, list[str]]:
    """Mass and its centre, by the translations; and whether these agree."""
    M, code = model.M, model.labels[:, 1]
    assert M is not None
    per = {axis: M @ (code == axis).astype(float) for axis in (1, 2, 3) if np.any(code == axis)}
    if not per:
        return None, None, []
    total = {axis: float(inertia[code == axis].sum()) for axis, inertia in per.items()}
    out = []
    low, high = min(total.values()), max(total.values())
    if high > 0 and high - low > ALIKE * high:
        told = ", ".join(f"{'XYZ'[a - 1]} {m:.4g} kg" for a, m in total.items())
        out.append(f"the mass differs along the axes: {told} (single directions that are held, or wrong labels)")
    if low <= 0:
        out.append(f"a mass of {low:.3g} kg")
    axis = max(total, key=lambda a: total[a])
    places = _places(model)
    centre = None
    if places is not None and total[axis] > 0:
        own = code == axis
        centre = tuple((per[axis][own] @ places[own] / total[axis]).tolist())
    return high, centre, out


def _places(model: FeModel) -> Array | None:
    """Place of every row (m)."""
    known = model.coordinates
    if known is None:
        return None
    return known[np.unique(model.labels[:, 0], return_inverse=True)[1].ravel()]


def _speed(model: FeModel) -> float | None:
    """Median over the nodes of the fastest wave that their rows tell: omega of the row alone, times the next node."""
    places, K, M = _places(model), model.K, model.M
    if places is None or K is None or M is None:
        return None
    code = model.labels[:, 1]
    rows = np.flatnonzero((code >= 1) & (code <= 3) & (M.diagonal() > 0) & (K.diagonal() > 0))
    if not rows.size:
        return None
    coo = K.tocoo()
    i, j = coo.coords
    length = np.linalg.norm(places[i] - places[j], axis=1)
    nearest = np.full(K.shape[0], np.inf)
    np.minimum.at(nearest, i[length > 0], length[length > 0])
    rate = np.sqrt(K.diagonal()[rows] / M.diagonal()[rows]) * nearest[rows]
    kept = np.isfinite(rate)
    if not kept.any():
        return None
    nodes, index = np.unique(model.labels[rows[kept], 0], return_inverse=True)
    fastest = np.zeros(len(nodes))
    np.maximum.at(fastest, index.ravel(), rate[kept])
    return float(np.median(fastest))


def _units(model: FeModel, mass: float | None, speed: float | None) -> list[str]:
    """Units that cannot be what they say."""
    out = []
    if speed is not None and not SPEED[0] < speed < SPEED[1]:
        out.append(f"waves of some {speed:.2g} m/s are those of no structural material (steel 5000, plastics 1500): "
                   "the units of length, force or mass are others")  # fmt: skip
    if mass and len(model.places) and np.all(np.ptp(model.places, axis=0) > 0):
        density = mass / float(np.prod(np.ptp(model.places, axis=0)))
        if density > DENSEST:
            out.append(f"{mass:.3g} kg within its box are {density:.3g} kg/m^3, denser than osmium: "
                       "the unit of mass is another")  # fmt: skip
    return out


def _frequencies(model: FeModel, wanted: int | Sequence[float]) -> tuple[int | None, tuple[float, ...], list[str]]:
    """Rigid-body modes and elastic frequencies; and why there are none."""
    if not isinstance(wanted, int):
        f = np.asarray(wanted, float)
        if not f.size:
            return None, (), []
        return int(np.sum(f == 0)), tuple(f[f > 0][:10].tolist()), []
    if model.K is None or model.M is None:
        known = () if model.modes is None else tuple(model.modes.frequencies[:wanted].tolist())
        return None, known, []
    try:
        structure: Any = model.structure()
        found = modes(structure, min(wanted + EXTRA, structure.free.size))
    except (InputError, NotIdentifiable) as error:
        told = error.what if isinstance(error, InputError | NotIdentifiable) else str(error)
        return None, (), [f"no frequencies: {told}"]
    return found.rigid, tuple(found.frequencies[found.rigid :][:wanted].tolist()), []
