"""The linear inverse problem in arrays: whitened operator and data, penalty."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import plain

from .whitening import LEAVES, Cholesky, Noise, Whitener, whiten, whitener

__all__ = ["Cholesky", "LinearProblem", "whiten", "whitener"]


@dataclass(frozen=True)
class LinearProblem:
    """Whitened problem ``min |H g - y|^2 + lambda^2 |L g|^2``, for one vector of data or for frames with one lambda.

    Parameters
    ----------
    H : array, shape (m, n)
        Operator.
    y : array, shape (m,) or (m, frames)
        Data.
    L : array, shape (rows, n), optional
        Penalty matrix; None is the identity.
    layout : tuple of int
        Shape of the data, (samples, sensors) or (frames, sensors), for residuals.
    shape : tuple of int
        Shape of the load of one frame.
    dropped : float
        Share of the operator, by its norm, outside the range of a singular noise covariance; whitening dropped it.
    """

    H: NDArray
    y: NDArray
    L: NDArray | None
    layout: tuple[int, ...]
    shape: tuple[int, ...]
    dropped: float = 0.0

    @property
    def frames(self) -> int | None:
        """Number of frames; None for a single vector of data."""
        return self.y.shape[1] if self.y.ndim == 2 else None

    @property
    def load_shape(self) -> tuple[int, ...]:
        """Shape of the load: `shape`, with the frames in front where there are any."""
        return self.shape if self.frames is None else (self.frames, *self.shape)

    @classmethod
    def whitened(
        cls,
        H: ArrayLike,
        y: ArrayLike,
        noise: Noise | None = None,
        L: Any = None,
        shape: tuple[int, ...] | None = None,
    ) -> LinearProblem:
        """Whiten an operator and its data by the noise of the sensors.

        Parameters
        ----------
        H : array, shape (..., sensors, unknowns)
            Leading axes (samples) share the same sensor noise.
        y : array, shape (..., sensors) or (frames, ..., sensors)
            Data, or frames of data.
        noise : array or Cholesky, optional
            Std per sensor (sensors,), covariance (sensors, sensors), or a Cholesky factor of it. A singular covariance
            (of interpolated readings) is whitened on its range.
        L : array or sparse matrix, shape (rows, unknowns), optional
            Penalty.
        shape : tuple, optional
            Shape of the load of one frame.

        Raises
        ------
        InputError
            Shapes that do not fit, NaN, noise that is no covariance, or data outside the range of a singular one.
        """
        H, y = np.asarray(plain(H)), np.asarray(plain(y))
        framed = H.ndim >= 2 and y.ndim == H.ndim and y.shape[1:] == H.shape[:-1]
        if not framed and (H.ndim < 2 or H.shape[:-1] != y.shape):
            raise InputError(
                "operator and data do not fit",
                where="inverse problem",
                found=f"H {H.shape}, y {y.shape}",
                expected="H (..., sensors, unknowns) with y (..., sensors), or y (frames, ..., sensors)",
                hint="frames come first, then sensors",
            )
        if 0 in H.shape or 0 in y.shape:
            raise InputError("nothing to invert", where="inverse problem", found=f"H {H.shape}, y {y.shape}",
                             expected="at least one sensor, one unknown and one frame")  # fmt: skip
        if not (np.all(np.isfinite(H)) and np.all(np.isfinite(y))):
            raise InputError(
                "NaN or inf in the operator or the data",
                where="inverse problem",
                expected="finite numbers",
                hint="leave out or repair the samples",
            )
        n = H.shape[-1]
        L, dropped = _penalty(L, n), 0.0
        if noise is not None:
            white = whitener(noise, H.shape[-2])
            _refuse_outside(white, y)
            dropped = white.outside(H, axis=-2)
            H, y = white.apply(H, axis=-2), white.apply(y, axis=-1)
        data = y.reshape(len(y), -1).T if framed else y.reshape(-1)
        return cls(H.reshape(-1, n), data, L, y.shape, shape or (n,), dropped)


def _penalty(L: Any, n: int) -> NDArray[np.float64] | None:
    """Penalty as a dense matrix that fits."""
    if L is None:
        return None
    L = np.asarray(plain(L.toarray() if hasattr(L, "toarray") else L), float)
    if not (L.ndim == 2 and L.shape[1] == n and np.all(np.isfinite(L))):
        raise InputError(
            "the penalty matrix does not fit the unknowns",
            where="penalty",
            found=f"shape {L.shape}, or NaN",
            expected=f"finite, shape (rows, {n})",
        )
    return L


def _refuse_outside(white: Whitener, y: NDArray) -> None:
    """Data with a part that the noise cannot reach are not what the covariance says that they are."""
    share = white.outside(y, axis=-1)
    if share > LEAVES:
        raise InputError(
            "the data leave the range of the singular noise covariance",
            where="noise",
            found=f"a share of {share:.3g} of their norm outside it",
            expected=f"at most {LEAVES:g}: interpolated readings lie in the range of the interpolation",
            hint="give the covariance of the data as they are, or invert the readings before interpolation",
        )
