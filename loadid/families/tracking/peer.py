"""filterpy in the place of our engine: the same filter with full covariances, slower, and written by others."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.values import reals

from ...inverse.kalman.filterpy import FilterpyEngine
from ...inverse.kalman.model import FilterModel
from ...inverse.kalman.squareroot import SquareRoot


class Peer:
    """Steps and blocks as those of `Engine`; it believes every number and has no settled gain.

    Parameters
    ----------
    model : FilterModel
    """

    loop = said = None
    rival = None

    def __init__(self, model: FilterModel) -> None:
        self.model, self.core, self.inner = model, SquareRoot(model), FilterpyEngine(model)
        self.phase = "warm-up"
        self.counts: Counter[str] = Counter()
        self.taken = np.zeros(model.m)

    def step(self, y: ArrayLike) -> tuple[NDArray, NDArray]:
        """Loads and their std (p,) of one sample (m,), NaN where a channel is missing.

        Raises
        ------
        InputError
            No sample of this width, or infinite: it is not counted.
        """
        sample = self.core.sample(reals(y, where="sample", what="a sample that is no row of real numbers"))
        found = self.inner.step(sample)
        self.phase, self.taken = "transient", sample
        self.counts["samples"] += 1
        self.counts["missing"] += int(np.sum(~np.isfinite(sample)))
        return found

    def block(
        self, Y: NDArray, load: NDArray, std: NDArray, e: NDArray | None = None, taken_as: NDArray | None = None
    ) -> None:
        """Fill loads and std (samples, p) of a block (samples, m); normalised innovations where `e` is given."""
        for k, y in enumerate(Y):
            load[k], std[k] = self.step(y)
            if e is not None:
                e[k] = self.inner.normalised

    def to_tree(self) -> dict[str, Any]:
        """Everything that changes, as plain arrays and numbers."""
        return {"phase": self.phase, "counts": dict(self.counts), "inner": self.inner.to_tree()}

    def restore(self, tree: dict[str, Any]) -> None:
        """Go on from what `to_tree` gave."""
        self.phase = str(tree["phase"])
        self.counts = Counter({str(k): int(v) for k, v in tree["counts"].items()})
        self.inner.restore(tree["inner"])
