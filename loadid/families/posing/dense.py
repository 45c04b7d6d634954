"""The dense path: the block Toeplitz matrix and its (generalised) SVD, with everything that a factorisation tells."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError

from ...inverse import diagnose, penalties
from ...inverse.nonnegative.solver import NonNegativeRecord
from ...inverse.problem import LinearProblem
from ...inverse.svd import SVDPath
from ...inverse.toeplitz import toeplitz
from ...inverse.whitening import whiten
from ..data import Data
from ..noise import Noise
from .posed import Posed, Settings, by_prediction

DENSE = 2000  # unknowns of a matrix that fits a desk


def dense(h: NDArray, values: NDArray, noise: Noise, data: Data, settings: Settings) -> Posed:
    """Problem of impulse responses (samples, sensors, loads) of all sensors of the model.

    Raises
    ------
    InputError
        A record too long for a matrix, or with missing samples.
    """
    settings.refuse_special("dense")
    samples, loads = len(values), h.shape[2]
    n = samples * loads
    if n > 2 * DENSE:
        raise InputError(
            "the record is too long for the dense path",
            where="penalty" if not settings.named else "path",
            found=f"{n} unknowns",
            expected=f"at most {2 * DENSE}",
            hint="use a named penalty with lambda > 0 and path='auto', or a window",
        )
    if data.missing.any():
        raise InputError(
            "the dense path takes no missing samples", where="record", found=data.gaps, expected="complete channels",
            hint="use a named penalty, method='tikhonov', lambda > 0 and path='auto'",
        )  # fmt: skip
    used = h[:, data.rows]
    T = toeplitz(used)
    L = None if settings.penalty is None else penalties.matrix(settings.penalty, samples, loads)
    if (sizes := settings.sizes(loads)) is not None:
        L = np.vstack([np.eye(n) if L is None else L, np.kron(np.eye(samples), np.diag(sizes))])
    path = SVDPath(LinearProblem.whitened(T, values, noise.level, L, (samples, loads)), truncated=settings.truncated)
    full = None
    if len(data.rows) < h.shape[1]:
        scale = np.sqrt(np.mean(h**2, axis=(0, 2)))
        full = diagnose.layout(np.linalg.svd(toeplitz(h / scale[:, None]).reshape(-1, n), compute_uv=False), n)

    def predict(g: NDArray) -> NDArray:
        return (T.reshape(-1, n) @ g.reshape(-1)).reshape(values.shape)

    kappa, _, _ = diagnose.layout(path.singular_values, n)
    layout = kappa, path.rank, max(n - path.rank, 0)
    penalty = settings.penalty

    def pushing(signed: ArrayLike | None) -> NonNegativeRecord:
        if not isinstance(penalty, str):
            raise InputError("signs take a named penalty", where="penalty", found="a matrix or None",
                             expected=f"one of {penalties.names()}")  # fmt: skip
        return NonNegativeRecord.convolved(
            whiten(used, noise.level, 1), whiten(values, noise.level, 1), penalty, signed=signed
        )

    compare = by_prediction(values, predict)
    return Posed(path, noise, compare, values, "dense SVD", used, layout, full, n, path, pushing)
