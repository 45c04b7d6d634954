"""Penalties of static loads: which matrix a name stands for, given what the load basis knows of its geometry."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.advice import Advice, Option
from structures.errors import InputError

from ..inverse import penalties

FIELD = {"gradient": "gradient of the load field", "laplacian": "curvature (Laplacian) of the load field"}
DIFFERENCES = {1: "differences of neighbouring loads", 2: "second differences of the loads"}  # by their order


def words(penalty: str | ArrayLike | None, basis: Any) -> str:
    """The prior in words."""
    if penalty is None:
        return "none: plain least squares"
    if not isinstance(penalty, str):
        return "a penalty of the user"
    if penalty == "identity":
        return "loads of zero mean and equal variance, independent of each other"
    if penalty in FIELD and basis is not None:
        return f"a small {FIELD[penalty]}; its mean is left to the data"
    order = penalties.order(penalty)
    what = DIFFERENCES.get(order, f"differences of order {order} of the loads")
    return f"small {what}, in their order; their mean is left to the data"


def matrix(penalty: str | ArrayLike | None, loads: int, basis: Any) -> NDArray[np.float64] | None:
    """Penalty matrix over the loads; None stands for the identity, or for no penalty.

    Parameters
    ----------
    penalty : str, array (rows, loads) or None
    loads : int
    basis : Basis or None
        Where it knows places, ``gradient`` and ``laplacian`` act on the load field there: on tractions, also where the
        loads are nodal forces, so that the prior does not change with the mesh. Without a basis they are differences in
        the order of the loads.

    Raises
    ------
    InputError
        A matrix that does not fit, too few loads, or a basis that is smooth by itself.
    """
    if penalty is None or (isinstance(penalty, str) and penalties.order(penalty) == 0):
        return None
    if not isinstance(penalty, str) or basis is None or penalty not in FIELD:
        if isinstance(penalty, str) and basis is not None and len(basis.components) > 1:
            return _each(penalties.matrix(penalty, basis.points), len(basis.components))
        return penalties.matrix(penalty, loads)
    if basis.kind == "polynomials":
        raise InputError(
            "a polynomial basis is smooth by itself",
            where="penalty",
            found=repr(penalty),
            expected="'identity', which penalises the size of its coefficients",
            hint="raise or lower the degree to let through more or less detail",
        )
    L = _field(penalty, basis)
    if basis.kind == "nodal" and basis.mass is not None:
        L = _on_tractions(L, basis)
    return _each(L, len(basis.components))


def _field(penalty: str, basis: Any) -> NDArray[np.float64]:
    """Gradient or Laplacian of one component over the places of a basis."""
    places = np.asarray(basis.coordinates, float)
    if len(places) < 2 or not places.shape[-1] or not np.any(np.ptp(places, axis=0)):
        raise InputError(
            "the load basis does not know where its loads are",
            where="penalty",
            found=f"{len(places)} points without different places",
            expected="a basis of two or more places",
            hint="give the structure coordinates= (files.load takes them), or use penalty='first_difference' in the "
            "order of the loads, or 'identity'",
        )
    along = _along(places)
    if along is not None:
        order, L = np.argsort(along), np.zeros((len(places) - penalties.order(penalty), len(places)))
        L[:, order] = _dense(penalties.line(len(places), penalty, np.diff(along[order])))
        return L
    if basis.cells is not None and len(basis.cells):
        return _dense(penalties.surface(places, basis.cells, penalty))
    edges = np.asarray(basis.edges, int)
    if not len(edges):
        raise InputError(
            "the load basis does not know which loads are neighbours",
            where="penalty",
            found=repr(penalty),
            expected="a basis with cells or edges",
            hint=Advice(Option("penalty", "identity"), ", or a matrix of your own (inverse.penalties)"),
        )
    lengths = np.linalg.norm(places[edges[:, 0]] - places[edges[:, 1]], axis=1)
    return _dense(penalties.graph(len(places), edges, 1 / lengths**2, penalty))


def _along(places: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Coordinate along a straight line of places; None where they fill a surface."""
    if places.ndim == 1 or places.shape[1] == 1:
        return places.reshape(-1)
    spread = places - places.mean(axis=0)
    size, axes = np.linalg.svd(spread, full_matrices=False)[1:]
    return spread @ axes[0] if size[1] <= 1e-9 * size[0] else None


def _on_tractions(L: NDArray[np.float64], basis: Any) -> NDArray[np.float64]:
    """L M^-1: nodal forces become tractions before they are differenced."""
    from scipy.sparse.linalg import splu

    return splu(basis.mass.tocsc()).solve(np.ascontiguousarray(L.T)).T


def _each(L: NDArray[np.float64] | None, components: int) -> NDArray[np.float64] | None:
    return L if L is None or components == 1 else _dense(penalties.components(L, components))


def _dense(L: Any) -> NDArray[np.float64]:
    return np.asarray(L.toarray() if hasattr(L, "toarray") else L, float)
