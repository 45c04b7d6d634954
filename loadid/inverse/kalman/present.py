"""A model as the channels that are there see it: rows of missing ones deleted, correlated noise decorrelated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

from .model import FilterModel
from .roots import backward, forward, lower

IMPOSSIBLE = 1e-7  # by which a correlation may exceed one, or leave the range of the process noise


@dataclass(frozen=True, eq=False)
class Present:
    """``x_{k+1} = F x_k + T y_k + w_k``, ``y_k = H x_k + v_k`` of the channels that are there, w and v uncorrelated.

    Parameters
    ----------
    mask : array of bool, shape (m,)
    F : array, shape (n, n)
    LQ : array, shape (n, q)
    H : array, shape (present, n)
    LR : array, shape (present, present)
    T : array, shape (n, present), or None
        What a sample tells of the process noise that moved it; None where the two are not correlated.
    """

    mask: NDArray[np.bool_]
    F: NDArray[np.float64]
    LQ: NDArray[np.float64]
    H: NDArray[np.float64]
    LR: NDArray[np.float64]
    T: NDArray[np.float64] | None

    def moved(self, x: NDArray, y: NDArray | None) -> NDArray[np.float64]:
        """Mean one sample later; y (m,) the data of this one."""
        ahead = self.F @ x
        return ahead if self.T is None or y is None else ahead + self.T @ y[self.mask]


def present(model: FilterModel, mask: NDArray[np.bool_]) -> Present:
    """The model for one set of channels.

    With ``S = E[w v^T]``: ``F - S R^-1 H``, ``Q - S R^-1 S^T`` and the known input ``S R^-1 y`` (Kailath, Sayed &
    Hassibi, Linear Estimation, 2000, ch. 9). The difference is taken inside the root: ``S = LQ C LR^T`` with C a matrix
    of correlations, and ``Q - S R^-1 S^T = LQ (I - C C^T) LQ^T``.

    Raises
    ------
    InputError
        S that no pair of noises has, or that belongs to a channel without noise.
    """
    H = np.ascontiguousarray(model.H[mask])
    LR = lower(model.LR[mask])
    if model.S is None or not mask.any():
        return Present(mask, model.F, model.LQ, H, LR, None)
    if not np.all(np.diag(LR)):
        raise InputError("a channel without noise cannot be correlated with the process noise", where="FilterModel.LR",
                         found="a singular root", expected="a positive definite covariance of the noise")  # fmt: skip
    white = forward(LR, model.S[:, mask].T)  # LR^-1 S^T
    size = np.linalg.norm(model.LQ, axis=1)
    size[size == 0] = 1.0
    C = np.linalg.lstsq(model.LQ / size[:, None], white.T / size[:, None], rcond=None)[0]
    U, s, _ = np.linalg.svd(C)
    miss = float(np.max(np.abs((model.LQ @ C - white.T) / size[:, None]), initial=0.0))
    if miss > IMPOSSIBLE or s.max(initial=0.0) > 1 + IMPOSSIBLE:
        raise InputError("S is the covariance of no pair of noises with these Q and R", where="FilterModel.S",
                         found=f"largest correlation {s.max(initial=0.0):.3g}, outside the range of Q by {miss:.1g}",
                         expected="correlations of at most 1, within the range of Q")  # fmt: skip
    left = np.ones(len(U))
    left[: len(s)] = np.sqrt(np.maximum((1 - s) * (1 + s), 0.0))
    T = backward(LR, white).T
    return Present(mask, model.F - T @ H, model.LQ @ (U * left), H, LR, np.ascontiguousarray(T))
