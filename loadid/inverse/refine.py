"""Whether a finer load basis shows more: how many modes are above the noise before and after refining it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError


@dataclass(frozen=True)
class Refinement:
    """Two load bases for the same region and sensors.

    Parameters
    ----------
    coarse, fine : int
        Number of loads of each.
    before, after : int
        Modes above the noise in each.
    eta : float
        Noise, relative to the largest singular value.
    """

    coarse: int
    fine: int
    before: int
    after: int
    eta: float

    @property
    def gained(self) -> int:
        """Modes that refining added above the noise."""
        return self.after - self.before


def refinement(coarse: ArrayLike, fine: ArrayLike, eta: float, *, loads: tuple[int, int] | None = None) -> Refinement:
    """Compare two bases by their operators or their singular values.

    Parameters
    ----------
    coarse, fine : array, shape (m, n) or (r,)
        Whitened operators, or their singular values.
    eta : float
        Noise relative to the largest singular value, between 0 and 1.
    loads : (int, int), optional
        Number of loads, where singular values are given and are fewer.

    Raises
    ------
    InputError
        If `eta` is not between 0 and 1, or the second basis is not the larger one.
    """
    if not 0 < eta < 1:
        raise InputError("no relative noise level", where="eta", found=eta, expected="between 0 and 1")
    (a, s), (b, t) = _values(coarse), _values(fine)
    a, b = loads or (a, b)
    if b <= a:
        raise InputError("the second basis is not finer", where="refinement", found=f"{a} and {b} loads",
                         expected="more loads in the second")  # fmt: skip
    return Refinement(a, b, int(np.sum(s > eta * s.max())), int(np.sum(t > eta * t.max())), float(eta))


def against_half(H: ArrayLike, eta: float, *, components: int = 1, edges: ArrayLike | None = None) -> Refinement:
    """Compare a basis with the one of half its size in which neighbouring loads are merged.

    The merged loads are orthonormal combinations, so that their singular values lie below those of the full basis.

    Parameters
    ----------
    H : array, shape (m, n)
        Whitened operator.
    eta : float
        Noise relative to the largest singular value.
    components : int
        Directions of each point: load index = point * components + component.
    edges : array, shape (E, 2), optional
        Pairs of neighbouring points; default the next one in order.

    Raises
    ------
    InputError
        If there are fewer than two points, or no whole number of them.
    """
    H = np.asarray(H, float)
    points, odd = divmod(H.shape[1], components)
    if odd or points < 2:
        raise InputError(
            "these loads cannot be merged in pairs",
            where="refinement",
            found=f"{H.shape[1]} loads of {components} components",
            expected="two points or more",
        )
    pairs = np.column_stack([np.arange(points - 1), np.arange(1, points)]) if edges is None else np.asarray(edges, int)
    group = _matched(points, pairs)
    size = np.bincount(group)
    merged = np.zeros((len(H), len(size), components))
    for point, g in enumerate(group):
        merged[:, g] += H.reshape(len(H), points, components)[:, point]
    merged /= np.sqrt(size)[:, None]
    return refinement(merged.reshape(len(H), -1), H, eta)


def _matched(points: int, edges: NDArray) -> NDArray[np.int64]:
    """Group of each point: neighbours in pairs, as many as can be found in order."""
    partner = np.full(points, -1)
    for a, b in edges:
        if a != b and partner[a] < 0 and partner[b] < 0:
            partner[a], partner[b] = b, a
    first = np.where(partner < 0, np.arange(points), np.minimum(np.arange(points), partner))
    return np.unique(first, return_inverse=True)[1]


def _values(A: ArrayLike) -> tuple[int, NDArray[np.float64]]:
    A = np.asarray(A, float)
    if A.ndim not in (1, 2) or A.size == 0 or not np.all(np.isfinite(A)):
        raise InputError("no operator and no singular values", where="refinement", found=f"shape {A.shape}, or NaN",
                         expected="finite, (m, n) or (r,)")  # fmt: skip
    return A.shape[-1], np.linalg.svdvals(A) if A.ndim == 2 else np.abs(A)
