"""Smoothers of a filtered record: every sample with all data, by two ways that agree.

`rts` (Rauch, Tung & Striebel, AIAA J. 3 (1965) 1445) in root form works where the predicted covariance is regular:

    [ F L   LQ ]        [ A   0 ]
    [ L     0  ]   =    [ B   D ]  Q,    G = B A^-1,    L_s L_s^T = D D^T + G L_s+ L_s+^T G^T.

`bryson_frazier` (Bierman, Automatica 9 (1973) 503) inverts no covariance of the state: it carries what the later
innovations say back as a root. It serves models with states that are known exactly, such as a structure at rest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

from .present import Present
from .roots import backward, forward, lower
from .squareroot import Filtered, Innovation, Kept, SquareRoot

Progress = Callable[[float, str], None] | None
SINGULAR = 1e-11  # of a state's predicted std: the part that is new to those before it


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Loads with all data: load, std (samples, p), states x (samples, n)."""

    load: NDArray[np.float64]
    std: NDArray[np.float64]
    x: NDArray[np.float64]


def smooth(filtered: Filtered, *, progress: Progress = None) -> Smoothed:
    """`rts`, or `bryson_frazier` where a predicted covariance is singular.

    Parameters
    ----------
    filtered : Filtered
        With ``keep=True``.
    progress : callable, optional

    Raises
    ------
    InputError
        States that were not kept.
    """
    try:
        return rts(filtered, progress=progress)
    except np.linalg.LinAlgError:
        return bryson_frazier(filtered, progress=progress)


def rts(filtered: Filtered, *, progress: Progress = None) -> Smoothed:
    """Rauch-Tung-Striebel smoother in root form.

    Raises
    ------
    InputError
        States that were not kept.
    numpy.linalg.LinAlgError
        A singular predicted covariance.
    """
    kept, parts, Cp = _kept(filtered), _parts(filtered), filtered.model.Cp
    out = _empty(filtered)
    x, L = kept.x[-1], kept.L[-1]
    for k in range(len(kept.x) - 1, -1, -1):
        if k < len(kept.x) - 1:
            part, n = parts(k), len(x)
            q = part.LQ.shape[1]
            wide = np.zeros((2 * n, max(n + q, 2 * n)))
            wide[:n, :n], wide[:n, n : n + q], wide[n:, :n] = part.F @ kept.L[k], part.LQ, kept.L[k]
            made = lower(wide)
            A, B, D = made[:n, :n], made[n:, :n], made[n:, n:]
            if np.any(np.abs(np.diag(A)) <= SINGULAR * np.linalg.norm(A, axis=1)):
                raise np.linalg.LinAlgError("the predicted covariance is singular")
            G = backward(A, B.T).T
            x = kept.x[k] + G @ (x - part.moved(kept.x[k], filtered.Y[k]))
            L = lower(D, G @ L)
        out.x[k] = x
        out.load[k], out.std[k] = _read(Cp, x, L)
        _tell(progress, 1 - k / len(kept.x))
    return out


def bryson_frazier(filtered: Filtered, *, progress: Progress = None) -> Smoothed:
    """Modified Bryson-Frazier smoother, its information kept as a root.

    Raises
    ------
    InputError
        States that were not kept.
    """
    kept, parts, model = _kept(filtered), _parts(filtered), filtered.model
    out = _empty(filtered)
    told, root = np.zeros(model.n), np.zeros((model.n, 0))  # lambda; Lambda = root root^T
    for k in range(len(kept.x) - 1, -1, -1):
        L = kept.L[k]
        out.x[k] = kept.x[k] - L @ (L.T @ told)
        out.load[k], out.std[k] = _read(model.Cp, out.x[k], left_over(L, root))
        if k:
            told, root = back(told, root, kept.innovations[k], parts(k).H, parts(k - 1).F)
        _tell(progress, 1 - k / len(kept.x))
    return out


def left_over(L: NDArray, root: NDArray) -> NDArray[np.float64]:
    """Root of ``P - P Lambda P`` with ``P = L L^T``, ``Lambda = root root^T``."""
    U, s, _ = np.linalg.svd(L.T @ root, full_matrices=True)
    left = np.ones(len(U))
    left[: len(s)] = np.sqrt(np.maximum((1 - s) * (1 + s), 0.0))
    return L @ (U * left)


def back(told: NDArray, root: NDArray, said: Innovation, H: NDArray, F: NDArray) -> tuple[NDArray, NDArray]:
    """What a sample and all later ones tell the one before it: H of its channels, F that led to it."""
    white_H, white = forward(said.root, H), forward(said.root, said.e[said.present])
    told = F.T @ (told - white_H.T @ (said.gain.T @ told) - white_H.T @ white)
    return told, lower(F.T @ white_H.T, F.T @ (root - white_H.T @ (said.gain.T @ root)))


def _kept(filtered: Filtered) -> Kept:
    if filtered.kept is None:
        raise InputError("the states were not kept", where="smoother", found="a record filtered without them",
                         expected="filter(model, Y, keep=True)")  # fmt: skip
    return filtered.kept


def _parts(filtered: Filtered) -> Callable[[int], Present]:
    """Matrices of each sample."""
    core, there = SquareRoot(filtered.model), np.isfinite(filtered.Y)
    return lambda k: core.seen(there[k])


def _empty(filtered: Filtered) -> Smoothed:
    N, p = filtered.load.shape
    return Smoothed(np.empty((N, p)), np.empty((N, p)), np.empty((N, filtered.model.n)))


def _read(Cp: NDArray, x: NDArray, L: NDArray) -> tuple[NDArray, NDArray]:
    return Cp @ x, np.linalg.norm(Cp @ L, axis=1)


def _tell(progress: Progress, share: float) -> None:
    if progress is not None:
        progress(min(share, 1.0), "smoothing")
