"""How the errors of a map go along: between the loads of one frame, and from sample to sample of a history."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from .calibration import quantile

Array = NDArray[np.float64]

MOST = 2_000_000  # numbers of the correlation of a history; beyond them it is not kept


@dataclass(frozen=True, eq=False)
class StaticPosterior:
    """Covariance of a static load: correlation W^T W, the same in every frame, and errors that all frames share.

    Parameters
    ----------
    W : array (k, outputs)
    own : array ([frames,] outputs)
        Std without what is shared.
    shared : array ([frames,] j, outputs)
        Errors of unit std.
    """

    W: Array
    own: Array
    shared: Array

    def variance(self, w: Array) -> Array:
        """Of weights (..., [frames,] outputs); frames err independently but for what they share."""
        w = np.asarray(w, float)
        along = np.sum(((w * self.own) @ self.W.T) ** 2, axis=-1)
        beside = np.einsum("...o,...jo->...j", w, self.shared)
        if self.own.ndim > 1:
            along, beside = np.sum(along, axis=-1), np.sum(beside, axis=-2)
        return np.asarray(along + np.sum(beside**2, axis=-1))

    @property
    def std(self) -> Array:
        """Of each load, the shape of the load."""
        return np.asarray(np.hypot(self.own, np.linalg.norm(self.shared, axis=-2)))

    def to_arrays(self) -> dict[str, Any]:
        """What a file keeps."""
        return {"kind": "correlated", **vars(self)}

    @classmethod
    def from_arrays(cls, tree: Mapping[str, Any]) -> Self:
        """Inverse of `to_arrays`."""
        return cls(*(np.asarray(tree[name], float) for name in ("W", "own", "shared")))


@dataclass(frozen=True, eq=False)
class HistoryPosterior:
    """Covariance of a history: its std, how errors go along over some lags, and errors that all samples share.

    Parameters
    ----------
    along : array (lags, outputs, outputs)
        Correlation of the error of a first output with that of a second one so many samples later.
    own : array (samples, outputs)
        Std without what is shared.
    shared : array (samples, j, outputs)
        Errors of unit std.
    sums : float
        What the std of weights on more than one sample is multiplied with.
    """

    along: Array
    own: Array
    shared: Array
    sums: float = 1.0

    def variance(self, w: Array) -> Array:
        """Of weights (..., samples, outputs)."""
        from scipy.signal import fftconvolve

        w = np.asarray(w, float)
        lags, both = len(self.along), np.concatenate([self.along[:0:-1].transpose(0, 2, 1), self.along])
        each = np.moveaxis(w * self.own, -2, 0)  # samples first
        kernel = both.reshape(len(both), *(1,) * (each.ndim - 2), *both.shape[1:])
        spread = fftconvolve(each[..., None], kernel, axes=0)[lags - 1 : lags - 1 + len(each)].sum(axis=-2)
        several = np.count_nonzero(np.any(w != 0, axis=-1), axis=-1) > 1
        own = np.maximum(np.sum(each * spread, axis=(0, -1)), 0.0) * np.where(several, self.sums**2, 1.0)
        beside = np.einsum("...so,sjo->...j", w, self.shared)
        return np.asarray(own + np.sum(beside**2, axis=-1))

    @property
    def std(self) -> Array:
        """Of each load and sample."""
        return np.asarray(np.hypot(self.own, np.linalg.norm(self.shared, axis=-2)))

    def to_arrays(self) -> dict[str, Any]:
        """What a file keeps."""
        return {"kind": "correlated over time", **vars(self)}

    @classmethod
    def from_arrays(cls, tree: Mapping[str, Any]) -> Self:
        """Inverse of `to_arrays`."""
        along, own, shared = (np.asarray(tree[name], float) for name in ("along", "own", "shared"))
        return cls(along, own, shared, float(tree["sums"]))


def over_time(ratio: Array) -> Array | None:
    """Correlation (samples, outputs, outputs) of errors over their std (draws, samples, outputs), lag by lag.

    Sums over pairs of samples are divided by the length of the record, so that no variance is negative (M. Priestley,
    Spectral Analysis and Time Series, 1981, section 5.3). None where it is too much to keep.
    """
    draws, samples, outputs = ratio.shape
    if samples * outputs**2 > MOST:
        return None
    lines = np.fft.rfft(ratio / np.sqrt(np.maximum(np.mean(ratio**2, axis=(0, 1)), 1e-300)), 2 * samples, axis=1)
    power = np.einsum("kfa,kfb->fab", lines.conj(), lines)
    return np.asarray(np.fft.irfft(power, axis=0)[:samples] / (draws * samples))


def of_sums(off: Array, std: Array, along: Array, coverage: float) -> float:
    """What the band of a sum over a whole record is multiplied with, at least 1, to hold it as often as it says.

    Parameters
    ----------
    off, std : array (draws, samples, outputs)
        Errors of draws kept apart, and their std.
    along : array (lags, outputs, outputs)
    coverage : float
    """
    ratio = []
    for error, size in zip(off, std, strict=True):
        each = np.eye(size.shape[1])[:, None, :] * np.ones((1, len(size), 1))
        spread = np.sqrt(HistoryPosterior(along, size, np.zeros((len(size), 0, size.shape[1]))).variance(each))
        ratio.append(np.abs(error.sum(axis=0)) / np.maximum(spread, 1e-300))
    return max(1.0, quantile(np.ravel(ratio), coverage) / NormalDist().inv_cdf(0.5 + coverage / 2))
