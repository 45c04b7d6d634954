"""The past of a stream for pictures, in bounded memory: neighbouring pieces are joined where it grows long."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

BINS = 1024


class History:
    """Mean, extremes and band of every load over time.

    Parameters
    ----------
    labels, units : sequence of str
        Of the loads.
    width : float
        Of the band, in std.
    """

    def __init__(self, labels: list[str], units: list[str], width: float = 1.96) -> None:
        self.labels, self.units, self.width = labels, units, width
        self.size = 1  # samples of a bin
        self._bins: list[NDArray[np.float64]] = []  # (4, loads): mean, lowest, highest of the band, std
        self._times: list[float] = []
        self._open: list[tuple[NDArray, NDArray, NDArray]] = []
        self._count = 0

    def add(self, times: NDArray, load: NDArray, std: NDArray) -> None:
        """More samples: times (samples,), loads and stds (samples, loads)."""
        self._open.append((times, load, std))
        self._count += len(times)
        if self._count < self.size:
            return
        times, load, std = (np.concatenate(parts) for parts in zip(*self._open, strict=True))
        whole = len(times) // self.size * self.size
        self._open, self._count = [(times[whole:], load[whole:], std[whole:])], len(times) - whole
        shape = (-1, self.size, load.shape[1])
        p, s = load[:whole].reshape(shape), std[:whole].reshape(shape)
        low, high = (p - self.width * s).min(axis=1), (p + self.width * s).max(axis=1)
        self._bins.extend(np.stack([p.mean(axis=1), low, high, s.mean(axis=1)], axis=1))
        self._times.extend(times[:whole].reshape(-1, self.size).mean(axis=1).tolist())
        while len(self._bins) > BINS:
            self._join()

    def __len__(self) -> int:
        return len(self._bins)

    @property
    def times(self) -> NDArray[np.float64]:
        """Middle of every bin (bins,)."""
        return np.array(self._times)

    @property
    def bins(self) -> NDArray[np.float64]:
        """Mean, lower and upper end of the band, mean std (bins, 4, loads)."""
        return np.array(self._bins).reshape(-1, 4, len(self.labels))

    def _join(self) -> None:
        """Bins of twice the size; an odd last one goes on as samples of its mean."""
        bins, times = self.bins, self.times
        even = len(bins) // 2 * 2
        if even < len(bins):
            p, s = bins[even, 0], bins[even, 3]
            self._open.insert(0, tuple(np.repeat(a, self.size, axis=0) for a in (times[even:], p[None], s[None])))  # type: ignore[arg-type]
            self._count += self.size
        pairs = bins[:even].reshape(-1, 2, *bins.shape[1:])
        mean = pairs.mean(axis=1)
        mean[:, 1], mean[:, 2] = pairs[:, :, 1].min(axis=1), pairs[:, :, 2].max(axis=1)
        self._bins, self._times = list(mean), times[:even].reshape(-1, 2).mean(axis=1).tolist()
        self.size *= 2
