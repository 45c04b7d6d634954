"""Loads some samples late: what was measured meanwhile is added where the gain was settled all the while."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...inverse.kalman.lag import FixedLag


class Late:
    """The last samples of a filter.

    Later innovations are added to a load as far as the gain stayed settled after it (`loadid.inverse.kalman.lag`);
    around gaps, gates and starts the answer is that of its own time, with its std.

    Parameters
    ----------
    fixed : FixedLag
    load, std : array, shape (p,)
        Before the first sample: the prior.
    """

    def __init__(self, fixed: FixedLag, load: NDArray, std: NDArray) -> None:
        p, m = len(load), fixed.taps.shape[2]
        self.fixed, lag = fixed, fixed.lag
        self.loads, self.stds = np.tile(load, (lag, 1)), np.tile(std, (lag, 1))
        self.news, self.calm = np.zeros((lag, m)), np.zeros(lag, bool)
        assert self.loads.shape == (lag, p)

    def block(self, load: NDArray, std: NDArray, e: NDArray) -> tuple[NDArray, NDArray]:
        """Loads and std (samples, p) of `lag` samples ago, for filtered loads, std and innovations (samples, m).

        An innovation that is not finite says that the gain was not the settled one.
        """
        lag, count = self.fixed.lag, len(load)
        loads, stds = np.concatenate([self.loads, load]), np.concatenate([self.stds, std])
        calm = np.concatenate([self.calm, np.isfinite(e).all(axis=1)])
        news = np.where(calm[:, None], np.concatenate([self.news, np.where(np.isfinite(e), e, 0.0)]), 0.0)
        late, after = loads[:count].copy(), calm[:count].copy()
        seen = np.zeros(count, int)
        for j in range(1, lag + 1):
            after &= calm[j : j + count]
            late[after] += news[j : j + count][after] @ self.fixed.taps[j - 1].T
            seen[after] = j
        spread = np.where(seen[:, None] > 0, self.fixed.std[seen], stds[:count])
        self.loads, self.stds, self.news, self.calm = loads[count:], stds[count:], news[count:], calm[count:]
        return late, spread

    def succeed(self, old: Late) -> None:
        """Go on with the loads of another model as they stand; nothing later is added to them."""
        self.loads, self.stds = old.loads, old.stds

    def to_tree(self) -> dict[str, Any]:
        """Everything that changes, as plain arrays."""
        return {"loads": self.loads, "stds": self.stds, "news": self.news, "calm": self.calm.astype(float)}

    def restore(self, tree: dict[str, Any]) -> None:
        """Go on from what `to_tree` gave."""
        self.loads, self.stds, self.news = (np.asarray(tree[k], float) for k in ("loads", "stds", "news"))
        self.calm = np.asarray(tree["calm"]) > 0.5
