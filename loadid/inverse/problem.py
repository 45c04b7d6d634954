"""The linear inverse problem in arrays: whitened operator and data, penalty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError


@dataclass(frozen=True)
class LinearProblem:
    """Whitened problem ``min |H g - y|^2 + lambda^2 |L g|^2``.

    Parameters
    ----------
    H : array, shape (m, n)
        Operator.
    y : array, shape (m,)
        Data.
    L : array, shape (rows, n), optional
        Penalty matrix; None is the identity.
    layout : tuple of int
        Shape of the data, (samples, sensors), for residuals.
    shape : tuple of int
        Shape of the load.
    """

    H: NDArray
    y: NDArray
    L: NDArray | None
    layout: tuple[int, ...]
    shape: tuple[int, ...]

    @classmethod
    def whitened(
        cls,
        H: ArrayLike,
        y: ArrayLike,
        noise: ArrayLike | None = None,
        L: NDArray | None = None,
        shape: tuple[int, ...] | None = None,
    ) -> LinearProblem:
        """Whiten an operator and its data by the noise of the sensors.

        Parameters
        ----------
        H : array, shape (..., sensors, unknowns)
            Leading axes (samples) share the same sensor noise.
        y : array, shape (..., sensors)
            Data.
        noise : array, optional
            Std per sensor (sensors,), or covariance (sensors, sensors).
        L : array, optional
            Penalty.
        shape : tuple, optional
            Shape of the load.

        Raises
        ------
        InputError
            Shapes that do not fit, NaN, or a covariance that is not positive definite.
        """
        H, y = np.asarray(H), np.asarray(y)
        if H.shape[:-1] != y.shape:
            raise InputError(
                "operator and data do not fit",
                where="inverse problem",
                found=f"H {H.shape}, y {y.shape}",
                expected="H (..., sensors, unknowns) with y (..., sensors)",
            )
        if not (np.all(np.isfinite(H)) and np.all(np.isfinite(y))):
            raise InputError(
                "NaN or inf in the operator or the data",
                where="inverse problem",
                expected="finite numbers",
                hint="leave out or repair the samples",
            )
        if L is not None and not (np.ndim(L) == 2 and np.shape(L)[1] == H.shape[-1] and np.all(np.isfinite(L))):
            raise InputError(
                "the penalty matrix does not fit the unknowns",
                where="penalty",
                found=f"shape {np.shape(L)}, or NaN",
                expected=f"finite, shape (rows, {H.shape[-1]})",
            )
        Hw, yw = whiten(H, noise, axis=-2), whiten(y[..., None], noise, axis=-2)[..., 0]
        n = H.shape[-1]
        return cls(Hw.reshape(-1, n), yw.reshape(-1), L, y.shape, shape or (n,))


def whiten(values: NDArray, noise: ArrayLike | None, axis: int) -> NDArray:
    """``R^(-1/2) values`` along the sensor axis, for a std per sensor or a covariance R (by its Cholesky factor).

    Raises
    ------
    InputError
        If the noise does not fit the sensors or is not positive (definite).
    """
    if noise is None:
        return values
    noise = np.asarray(noise, float)
    sensors = values.shape[axis]
    if noise.shape not in {(sensors,), (sensors, sensors)} or not np.all(np.isfinite(noise)):
        raise InputError(
            "the noise does not fit the sensors",
            where="noise",
            found=f"shape {noise.shape}",
            expected=f"finite, shape ({sensors},) or ({sensors}, {sensors})",
        )
    moved = np.moveaxis(values, axis, -1)
    if noise.ndim == 1:
        if np.any(noise <= 0):
            raise InputError("a noise std must be positive", where="noise", found=noise.tolist(), expected="> 0")
        return np.moveaxis(moved / noise, -1, axis)
    if not np.allclose(noise, noise.T, rtol=1e-8, atol=0):
        raise InputError("the noise covariance is not symmetric", where="noise", expected="R = R^T")
    try:
        factor = np.linalg.cholesky(noise)
    except np.linalg.LinAlgError:
        raise InputError(
            "the noise covariance is not positive definite",
            where="noise",
            found=f"smallest eigenvalue {np.linalg.eigvalsh(noise)[0]:.3g}",
            expected="> 0",
            hint="drop a channel that is a combination of others",
        ) from None
    from scipy.linalg import solve_triangular

    flat = moved.reshape(-1, sensors).T
    return np.moveaxis(solve_triangular(factor, flat, lower=True).T.reshape(moved.shape), -1, axis)
