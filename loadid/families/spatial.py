"""Spatial priors of a load field: how rough it may be from place to place, as a change of variables.

With the root W of the spatial precision, ``W^T W = (mass + length^2 L^T L) / mean measure``, the penalty of a field
over places and time is ``|(L_t x W) g|^2``: its prior covariance is the Kronecker product of one in time and one in
space. In the variables ``u = W g`` it is that of loads without a spatial prior, so that every solver in time serves:
nothing of the size of places times samples is formed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import positive, reals

from ..inverse import penalties
from . import smoothness

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
        L, degree = smoothness.matrix(space, loads, basis), penalties.order(space)
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


def words(space: str | ArrayLike | None, length: float | None) -> str:
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
