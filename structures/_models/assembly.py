"""How a forward model is put together: rows of sensors, columns of loads, its reduction, and what its file keeps."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from .._channels import Channel, named
from .._system.damping import Damping, loss_factor
from .._system.loads import Load, sparse_matrix
from .._system.structure import Structure
from ..bases._basis import Basis
from ..errors import InputError, finite, one_of, positive, whole
from . import krylov
from .reduction import DENSE, Modes, ReducedModel, modal_damping, modes, static_residual


def placed(given: Sequence[Any], method: str, where: str, other: str = "") -> tuple[Channel, ...]:
    """Sensors or loads as channels: each has the `method` (or the `other`) that gives its row or column.

    Raises
    ------
    InputError
        If there is none, one is something else, or two share a label.
    """
    if isinstance(given, Channel | str) or not hasattr(given, "__iter__"):
        given = [given]
    items = list(given)
    wrong = [x for x in items if not (isinstance(x, Channel) and (hasattr(x, method) or (other and hasattr(x, other))))]
    if wrong or not items:
        raise InputError(
            f"no {where[:-1]}" if items else f"no {where}",
            where=where,
            found=repr(wrong[0]) if wrong else "an empty list",
            expected=f"objects of structures.{where}",
            hint='[sensors.Accelerometer("12+Z")]' if where == "sensors" else '[loads.Point("12+Z")]',
        )
    return named(items, len(items), "", where)


def rows(structure: Structure, sensors: Sequence[Any]) -> sparse.csr_array:
    """Rows of the sensors over the free DOFs, sparse (sensors, n_free), one dense row at a time.

    Raises
    ------
    InputError
        If a row holds NaN or infinity.
    """
    parts = [(np.flatnonzero(values), values) for values in (s.row(structure) for s in sensors)]
    starts = np.cumsum([0, *(len(at) for at, _ in parts)])
    entries = np.concatenate([values[at] for at, values in parts])
    every = sparse.csr_array(
        (entries, np.concatenate([at for at, _ in parts]), starts), shape=(len(parts), structure.n)
    )
    _finite(every.data)
    return every[:, structure.free].tocsr()


def columns(structure: Structure, loads: Any) -> Any:
    """Load columns: sparse (n_free, loads), or dense (samples, n_free, loads) where one moves.

    Raises
    ------
    InputError
        If a column holds NaN or infinity, a load acts on a supported DOF alone, or loads that move differ in length.
    """
    found = _columns(structure, loads)
    _finite(found.data if sparse.issparse(found) else found)
    return found


def _columns(structure: Any, loads: Any) -> Any:
    free = structure.free
    if isinstance(loads, Basis):
        return loads.columns(structure)[free].tocsc()
    fixed = [x for x in loads if isinstance(x, Load) and not hasattr(x, "columns")]
    still = sparse_matrix(structure, fixed)  # names every load on a supported DOF at once
    if len(fixed) == len(loads):
        return still[free].tocsc()
    parts = [
        (load.columns if hasattr(load, "columns") else load.column)(structure)[..., free]  # the one that it has
        for load in loads
    ]
    lengths = {len(part) for part in parts if part.ndim == 2}
    if not lengths:
        return sparse.csc_array(np.array(parts).T)
    if len(lengths) > 1:
        raise InputError(
            "loads that move differ in length",
            where="loads",
            found=sorted(lengths),
            expected="one length",
            hint="give every path the samples of the record",
        )
    length = lengths.pop()
    return np.stack([np.broadcast_to(part, (length, free.size)) for part in parts], axis=-1)


def _finite(values: NDArray[Any]) -> None:
    """A row or a column that holds NaN is named at once, not found in a result."""
    what = "a sensor row or a load column holds NaN or infinity"
    finite(values, what, where="ForwardModel", hint="check the places and the fibres of sensors and loads")


DEFAULT_MODES = 60  # of a large structure
BAND_FACTOR = 2.5  # modes up to this multiple of the band: with the residual, a per cent of error on the worst lines
BLIND = 1e-9  # share of a rigid mode in a row or column that is rounding
KINDS = ("modes", "krylov")


def settled(structure: Structure, count: Any, residual: Any, band: Any, reduction: Any) -> dict[str, Any]:
    """The settings of a reduction, checked: ``modes``, ``residual``, ``band`` (Hz) and ``reduction``.

    Raises
    ------
    InputError
        If one is none, or a Krylov basis lacks its band.
    """
    size = structure.free.size
    if count is not None and not 1 <= (whole(count) or 0) <= size:
        raise InputError(
            "no such number of modes",
            where="modes",
            found=repr(count),
            expected=f"1..{size}",
            hint="leave modes out: band= in Hz chooses them",
        )
    one_of(
        "no such reduction", reduction, KINDS, where="reduction", hint="leave it out: modes and their static residual"
    )
    if reduction == "krylov" and (band is None or count is not None):
        raise InputError(
            "a Krylov basis is made for a band, not for a number of modes",
            where="reduction='krylov'",
            found=f"band={band}, modes={count}",
            expected="band= in Hz, no modes=",
            hint="pass the highest frequency of interest as band=",
        )
    return {
        "modes": None if count is None else int(count),
        "residual": bool(residual),
        "band": None if band is None else positive("band", band, where="ForwardModel", unit="Hz"),
        "reduction": reduction,
    }


def needs(settings: Mapping[str, Any], reduction: str, what: str) -> None:
    """Refuse what only the other reduction has."""
    if settings["reduction"] != reduction:
        raise InputError(
            f"the model is reduced by {settings['reduction']}: it has no {what}",
            where="ForwardModel",
            found=f"reduction={settings['reduction']!r}",
            expected=f"reduction={reduction!r}",
            hint="build the model with it" + (", and with band=" if reduction == "krylov" else ""),
        )


def within(settings: Mapping[str, Any], f: NDArray[Any]) -> None:
    """Refuse lines above the band of a Krylov basis: nothing is known of its error there."""
    band = settings["band"]
    if settings["reduction"] == "krylov" and len(f) and f.max() > band * (1 + 1e-9):
        raise InputError(
            "a line lies above the band of the Krylov basis",
            where="frequencies",
            found=f"{f.max():.6g} Hz",
            expected=f"at most {band:g} Hz",
            hint="build the model with a higher band=",
        )


def wanted(size: int, settings: Mapping[str, Any]) -> int:
    """Number of modes, of `size`, to begin with."""
    return settings["modes"] or (size if size <= DENSE else min(DEFAULT_MODES, size))


def retained(structure: Structure, settings: Mapping[str, Any]) -> Modes:
    """As many modes as were asked for, or as the band needs."""
    n = structure.free.size
    k, band = wanted(n, settings), settings["band"]
    found = modes(structure, k)
    while band is not None and settings["modes"] is None and k < n:
        if found.frequencies[-1] >= BAND_FACTOR * band:
            k = int(np.searchsorted(found.frequencies, BAND_FACTOR * band)) + 1
            return Modes(found.lam[:k], found.phi[:, :k], min(found.rigid, k), found.shift, found.factor)
        k = min(2 * k, n)
        found = modes(structure, k)
    return found


def reduced(
    structure: Structure,
    shapes: Modes,
    S: Any,
    B: Any,
    readings: tuple[NDArray[np.int64], NDArray[np.float64]],
    static: Callable[[], NDArray[Any]] | None,
) -> ReducedModel:
    """The small model that modes, or the Ritz pairs in their place, make of a structure.

    Parameters
    ----------
    structure : Structure
    shapes : Modes
    S : sparse (sensors, n_free)
    B : sparse (n_free, loads), or array (samples, n_free, loads) where a load moves
    readings : derivative, corner
        As in `ReducedModel`.
    static : callable or None
        ``S K^-1 B`` of a supported structure under loads that stay; None where no residual is wanted.
    """
    moving = not sparse.issparse(B)
    modal_S = S @ shapes.phi
    modal_B = np.einsum("nk,tnp->tkp", shapes.phi, B, optimize=True) if moving else np.asarray(B.T @ shapes.phi).T
    # A strain gauge sees no rigid motion, a self-balanced load drives none: zero, not rounding.
    r = shapes.rigid
    modal_S[:, :r][np.abs(modal_S[:, :r]) < BLIND * np.abs(modal_S).max(axis=1, keepdims=True)] = 0.0
    modal_B[..., :r, :][np.abs(modal_B[..., :r, :]) < BLIND * np.abs(modal_B).max(axis=-2, keepdims=True)] = 0.0
    residual = None
    if static is not None and len(shapes.lam) < structure.free.size:
        if moving:
            full = shapes.factor.solve(S.T.toarray()).T
            residual = np.einsum("sn,tnp->tsp", full, B) - (modal_S / (shapes.lam - shapes.shift)) @ modal_B
        else:
            residual = static_residual(shapes, S, B, modal_S, modal_B, static() if shapes.shift == 0 else None)
    damping, loss = modal_damping(structure, shapes), loss_factor(structure.damping)
    return ReducedModel(shapes.lam, damping, modal_S, modal_B, residual, *readings, loss)


def described(settings: Mapping[str, Any], size: int, shapes: Modes | None, basis: krylov.Krylov | None) -> str:
    """What a model retains, in words; `shapes` and `basis` where they are known already."""
    band = settings["band"]
    if settings["reduction"] == "krylov":
        known = "" if basis is None else f", {basis.projection.theta.size} vectors, error {basis.estimate:.1e}"
        return f"Krylov basis to {band:g} Hz{known}"
    rest = " + static residual" if settings["residual"] else ""
    if settings["modes"] is None and band and size > DENSE and shapes is None:
        return f"modes up to {BAND_FACTOR:g} x {band:g} Hz{rest}"
    k = len(shapes.lam) if shapes is not None else wanted(size, settings)
    return f"all {size} modes" if k == size else f"{k} of {size} modes{rest}"


# -- what a file keeps; `structures.files._modelfile` reads it ---------------------------------------------------------
def kept(structure: Structure, sensors: Sequence[Any], loads: Any) -> dict[str, Any]:
    """A structure, the rows of its sensors and the columns of its loads, which stay in place: arrays and texts."""
    every = np.array([sensor.row(structure) for sensor in sensors])
    drawn = loads.columns(structure) if isinstance(loads, Basis) else sparse_matrix(structure, loads)
    matrices = (("K", structure.K), ("M", structure.M), ("C", structure.C))
    return {
        "matrices": {name: _parts(m) for name, m in matrices if m is not None},
        "terms": {name: _parts(m) for name, m in structure.terms.items()},
        "dofs": [str(dof) for dof in structure.dofs],
        "supports": [str(dof) for dof in structure.supports],
        "coordinates": structure.coordinates,
        "damping": _damping(structure.damping),
        "parameters": dict(structure.parameters),
        "rows": _parts(sparse.csr_array(every)),
        "columns": _parts(sparse.csr_array(drawn.T)),
        "derivatives": [int(getattr(sensor, "derivative", 0)) for sensor in sensors],
    }


def _parts(matrix: sparse.csr_array) -> dict[str, Any]:
    """A sparse matrix as arrays."""
    return {"data": matrix.data, "indices": matrix.indices, "starts": matrix.indptr, "shape": list(matrix.shape)}


def _damping(damping: Damping | None) -> dict[str, Any] | None:
    if damping is None:
        return None
    own = {f.name: getattr(damping, f.name) for f in fields(damping)}
    return {"kind": type(damping).__name__, **{k: list(v) if isinstance(v, tuple) else v for k, v in own.items()}}
