"""Records of raw data: noise of any covariance, missing channels, loads that move.

Correlated noise and a missing channel do not commute: what is left of a covariance is whitened by a root of its own,
one for each pattern of channels that occurs. A moving load gives every sample its own matrices.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError

from ..whitening import LEAVES, Cholesky, Noise, Whitener, whitener
from .augmented import Augmented, augment
from .record import Record


def measured(systems: Augmented | Sequence[Augmented], y: ArrayLike, noise: Noise | None = None) -> Record:
    """Record of raw data over systems that are not whitened.

    Parameters
    ----------
    systems : Augmented, or one for each sample
        In the units of the sensors; those of a moving load from `moving`.
    y : array, shape (samples, sensors)
        NaN where nothing was measured.
    noise : array or Cholesky, optional
        Std (sensors,), covariance (sensors, sensors), which may be singular, or a Cholesky factor of it; default 1.

    Raises
    ------
    InputError
        Data that do not fit the systems or the range of a singular covariance, inf in the data, or no noise.
    """
    each = [systems] if isinstance(systems, Augmented) else list(systems)
    y, first = np.array(y, float), each[0]
    if y.ndim != 2 or y.shape[1] != first.m or len(each) not in (1, len(y)):
        raise InputError("the data do not fit the system", where="state-space path", found=f"shape {y.shape}",
                         expected=f"({'samples' if len(each) == 1 else len(each)}, {first.m})")  # fmt: skip
    if np.any(np.isinf(y)):
        raise InputError("inf in the data", where="state-space path", expected="finite numbers, NaN where missing",
                         hint="declare clipped samples as missing")  # fmt: skip
    noise = np.ones(first.m) if noise is None else noise
    whitener(noise, first.m)  # judged as a whole, whatever is missing
    patterns, pattern = np.ones((1, first.m), bool), np.zeros(len(y), np.intp)
    if np.isnan(y).any():
        patterns, places = np.unique(~np.isnan(y), axis=0, return_inverse=True)
        pattern = np.asarray(places).reshape(-1)
    roots, data = [_root(noise, there) for there in patterns], np.zeros(y.shape)
    for i, (there, root) in enumerate(zip(patterns, roots, strict=True)):
        own = pattern == i
        data[own, : root.shape[0]] = _white(noise, there, root, y[own])
    # a fixed system has one kind for each pattern, a moving one for each sample
    at = np.arange(len(patterns)) if len(each) == 1 else pattern
    parts = each * len(patterns) if len(each) == 1 else each
    kind = pattern if len(each) == 1 else np.arange(len(y))
    C, D = (np.zeros((len(at), first.m, width)) for width in (first.n, first.p))
    for j, one in enumerate(parts):
        root = roots[at[j]]
        C[j, : len(root)], D[j, : len(root)] = root @ one.C, root @ one.D
    total = int(np.array([len(root) for root in roots])[pattern].sum())
    F, G = np.array([one.F for one in parts]), np.array([one.G for one in parts])
    return Record(F, G, C, D, np.ascontiguousarray(first.E), kind.astype(np.int32), data, first.free, total)


def moving(
    A: NDArray, B: NDArray, C: NDArray, D: NDArray, samples: int, penalty: str = "identity", *,
    leak: float | None = None, from_zero: bool = False, unknown_start: bool | int = False,
) -> list[Augmented]:  # fmt: skip
    """One augmented system for each sample; B and D may be led by time, other parameters as in `augment`."""
    options = {"leak": leak, "from_zero": from_zero, "unknown_start": unknown_start}
    Bs, Ds = (np.broadcast_to(M, (samples, *M.shape[-2:])) for M in (B, D))
    return [augment(A, b, C, d, penalty, **options) for b, d in zip(Bs, Ds, strict=True)]  # type: ignore[arg-type]


def _root(noise: Noise, there: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Whitening matrix (kept, sensors) of the channels that are there, zero in the columns of those that are not."""
    root = np.zeros((0, len(there)))
    if there.any():
        own = _part(noise, there).apply(np.eye(int(there.sum())), 0)
        root = np.zeros((len(own), len(there)))
        root[:, there] = own
    return root


def _white(noise: Noise, there: NDArray[np.bool_], root: NDArray, y: NDArray) -> NDArray[np.float64]:
    """Whitened data (samples, kept) of one pattern."""
    if there.any():
        share = _part(noise, there).outside(y[:, there], axis=1)
        if share > LEAVES:
            raise InputError(
                "the data leave the range of the singular noise covariance", where="noise",
                found=f"a share of {share:.3g} of their norm outside it", expected=f"at most {LEAVES:g}",
                hint="give the covariance of the data as they are, or invert the readings before interpolation",
            )  # fmt: skip
    return np.where(there, y, 0.0) @ root.T


def _part(noise: Noise, there: NDArray[np.bool_]) -> Whitener:
    """Whitener of some channels."""
    if isinstance(noise, Cholesky):
        # rows of a factor are a root of their covariance; their QR makes it triangular, without squares
        lower = np.asarray(np.linalg.qr(np.asarray(noise.factor, float)[there].T, mode="r")).T
        return whitener(Cholesky(lower * np.where(np.diag(lower) < 0, -1.0, 1.0)), int(there.sum()))
    values = np.asarray(noise, float)
    return whitener(values[there] if values.ndim == 1 else values[np.ix_(there, there)], int(there.sum()))
