"""Penalties and spatial priors of loads over a basis, from what it knows of its geometry.

With the root W of the spatial precision, ``W^T W = (mass + length^2 L^T L) / mean measure``, the penalty of a field
over places and time is ``|(L_t x W) g|^2``: its prior covariance is the Kronecker product of one in time and one in
space. In the variables ``u = W g`` it is that of loads without a spatial prior, so that every solver in time serves:
nothing of the size of places times samples is formed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._advice import Advice, Option
from structures.errors import InputError, positive, reals

from .._inverse import penalties

DENSE = 2000  # points up to which the matrix that makes tractions of nodal forces is kept with the result


def geometry(basis: Any) -> dict[str, Any]:
    """Geometry of a `structures.bases.Basis`.

    Returns
    -------
    dict
        ``coordinates`` (P, dim), ``cells``, ``components``, ``kind``, ``measures`` (P,), ``extents`` of patches,
        ``resultant`` (R, loads), ``resultant_labels``, and for nodal forces ``traction`` (loads, loads).
    """
    cells = getattr(basis, "cells", None)
    return {
        "coordinates": np.asarray(basis.coordinates, float),
        "cells": None if cells is None or not len(cells) else np.asarray(cells, int),
        "components": list(basis.components),
        "kind": basis.kind,
        "extents": getattr(basis, "extents", None),
        "measures": None if basis.measures is None else np.asarray(basis.measures, float),
        "resultant": np.asarray(basis.resultant(), float),
        "resultant_labels": list(basis.resultant_labels),
        "traction": traction(basis),
    }


def traction(basis: Any) -> NDArray[np.float64] | None:
    """Matrix (loads, loads) from nodal forces to tractions; None where loads are tractions already, or too many."""
    if basis.kind != "nodal" or basis.mass is None or basis.points > DENSE:
        return None
    return np.asarray(basis.to_traction(np.eye(basis.points * len(basis.components))).T)


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
            "a polynomial basis is smooth by itself", where="penalty", found=repr(penalty),
            expected="'identity', which penalises the size of its coefficients",
            hint="raise or lower the degree to let through more or less detail",
        )  # fmt: skip
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
            "the load basis does not know which loads are neighbours", where="penalty", found=repr(penalty),
            expected="a basis with cells or edges",
            hint=Advice(Option("penalty", "identity"), ", or a matrix of your own (inverse.penalties)"),
        )  # fmt: skip
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

    return np.asarray(splu(basis.mass.tocsc()).solve(np.ascontiguousarray(L.T)).T)


def _each(L: NDArray[np.float64] | None, components: int) -> NDArray[np.float64] | None:
    return L if L is None or components == 1 else _dense(penalties.components(L, components))


def _dense(L: Any) -> NDArray[np.float64]:
    return np.asarray(L.toarray() if hasattr(L, "toarray") else L, float)


Array = NDArray[np.float64]
SPACES = ("gradient", "laplacian")


def root(space: str | ArrayLike | None, length: float | None, loads: int, basis: Any, rank: int) -> Array | None:
    """Root W (loads, loads) of the spatial precision, upper triangular; None where there is no spatial prior.

    Parameters
    ----------
    space : {"gradient", "laplacian"}, array (rows, loads) or None
        What is held small beside the size of the field; a matrix is taken as it is, with the identity for the size.
    length : float, optional
        Length (m) below which detail costs more than size: ``integral of g^2 + length^2 |grad g|^2``, or with the
        fourth power and the Laplacian. Default: the distance at which as many points as the sensors tell apart would
        fill the loaded region. A weight without unit for a matrix (default 1), and where the places are not known.
    loads, rank : int
        Loads, and how many of them the sensors tell apart.
    basis : Basis or None

    Raises
    ------
    InputError
        An unknown prior, a length that is not positive, or what `smoothness.matrix` refuses.
    """
    if space is None:
        if length is not None:
            raise InputError("a length belongs to a spatial prior", where="length", found=length,
                             expected="space='gradient' or 'laplacian' with it")  # fmt: skip
        return None
    if isinstance(space, str) and space not in SPACES:
        raise InputError("unknown spatial prior", where="space", found=repr(space),
                         expected=f"{', '.join(SPACES)}, a matrix (rows, {loads}), or None")  # fmt: skip
    scale = spacing(basis, rank) if length is None else positive("length", length, where="space", unit="m")
    if isinstance(space, str):
        L, degree = matrix(space, loads, basis), penalties.order(space)
    else:
        L, degree = _own(space, loads), 1
    assert L is not None  # neither prior is the identity
    size, level = _measure(space, loads, basis)
    upper = np.linalg.qr(level * np.vstack([size, scale**degree * L]), mode="r")
    return np.asarray(upper * np.sign(np.diag(upper))[:, None], float)


def additive(
    space: str | ArrayLike, length: float | None, ratio: float, loads: int, basis: Any, rank: int
) -> tuple[Array, Array]:
    """Coordinates in which ``|(L_t x S) g|^2 + ratio^2 |W g|^2`` falls apart, S the size of the field and W its `root`.

    Returns
    -------
    T : array (loads, loads)
        Loads ``g = T u``.
    size : array (loads,)
        The penalty is the sum over u of ``|L_t u_j|^2 + size_j^2 |u_j|^2``: S T has orthonormal columns, and W T
        orthogonal ones of length size / ratio.
    """
    from scipy.linalg import solve_triangular

    W = root(space, length, loads, basis, rank)
    assert W is not None  # there is a spatial prior
    size, level = _measure(space, loads, basis)
    S = level * np.asarray(np.linalg.qr(size, mode="r"), float)
    back = np.asarray(solve_triangular(S, np.eye(loads)), float)
    _, lengths, axes = np.linalg.svd(W @ back)
    return back @ axes.T, ratio * lengths


def spatial_words(space: str | ArrayLike | None, length: float | None) -> str:
    """The prior in words."""
    if space is None:
        return "loads independent of each other"
    what = f"the {space} of the field" if isinstance(space, str) else "a penalty of the user over the loads"
    return f"{what} held small" + ("" if length is None else f", length {length:.3g}")


def spacing(basis: Any, rank: int) -> float:
    """Distance (m) at which `rank` points would fill the loaded region; 1 where the places are not known."""
    if basis is None or basis.measures is None:
        return 1.0
    places = np.asarray(basis.coordinates, float)
    spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    dim = int(np.sum(spread > 1e-9 * spread[0])) if spread[0] > 0 else 1
    return float((np.sum(basis.measures) / max(rank / len(basis.components), 1.0)) ** (1 / dim))


def _own(space: ArrayLike, loads: int) -> Array:
    L = np.atleast_2d(reals(space, what="the spatial prior is no matrix of real numbers", where="space"))
    if L.ndim != 2 or L.shape[1] != loads or not np.all(np.isfinite(L)):
        raise InputError("the spatial prior does not fit the loads", where="space", found=f"shape {L.shape}",
                         expected=f"finite, (rows, {loads})")  # fmt: skip
    return L


def _measure(space: str | ArrayLike, loads: int, basis: Any) -> tuple[Array, float]:
    """Root of the size of a field, and the factor with which it counts as that of its coefficients, on average."""
    size = _size(basis, loads) if isinstance(space, str) else np.eye(loads)
    return size, float(np.sqrt(loads) / np.linalg.norm(size))


def _size(basis: Any, loads: int) -> Array:
    """Root of the Gram matrix of the load functions, or of tractions where the loads are nodal forces: ``int g^2``."""
    if basis is None or basis.mass is None:
        return np.eye(loads)
    lower = np.linalg.cholesky(np.asarray(basis.mass.toarray(), float))
    if basis.kind == "nodal":
        from scipy.linalg import solve_triangular

        one = solve_triangular(lower, np.eye(len(lower)), lower=True)  # tractions are M^-1 f: int = f^T M^-1 f
    else:
        one = lower.T
    count = len(basis.components)
    return one if count == 1 else np.kron(one, np.eye(count))
