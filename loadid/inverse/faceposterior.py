"""Posterior under constraints: Gaussian on the active face, for one frame or for frames with faces of their own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

from .posterior import DensePosterior


class FacePosterior(DensePosterior):
    """Gaussian posterior in the directions that the active constraints leave free.

    An active-set approximation: a load held by a constraint has std 0, which says that a small change of the data
    leaves it held, not that it is known. `loadid.inverse.constrained.ConstrainedPath.sample` draws from what the
    constraints leave.
    """

    approximation = "active-set approximation"


class FramesPosterior:
    """Posteriors of frames, each on its own face, with independent noise.

    Parameters
    ----------
    each : sequence of DensePosterior
    """

    kind = "frames"
    approximation = FacePosterior.approximation

    def __init__(self, each: Sequence[DensePosterior]) -> None:
        self.each = tuple(each)
        self.frames, self.frame_shape = len(self.each), self.each[0].shape
        self.shape = (self.frames, *self.frame_shape)

    @property
    def std(self) -> NDArray[np.float64]:
        """Standard deviation, in the shape of the load, (frames,) + that of one frame."""
        return np.stack([p.std for p in self.each])

    @property
    def noise_std(self) -> NDArray[np.float64] | None:
        """Standard deviation from the noise alone."""
        parts = [p.noise_std for p in self.each]
        return None if any(p is None for p in parts) else np.stack([p for p in parts if p is not None])

    def variance(self, w: NDArray) -> NDArray[np.float64]:
        """Variance of ``sum(w * load)``; `w` has the shape of the load, (k,) may stand in front."""
        return np.sum([p.variance(x) for p, x in self._frames(w)], axis=0)

    def noise_variance(self, w: NDArray) -> NDArray[np.float64] | None:
        """Variance of ``sum(w * load)`` from the noise alone."""
        parts = [p.noise_variance(x) for p, x in self._frames(w)]
        return None if any(v is None for v in parts) else np.sum([v for v in parts if v is not None], axis=0)

    def _frames(self, w: NDArray) -> list[tuple[DensePosterior, NDArray]]:
        w = np.asarray(w, float)
        if w.shape[max(w.ndim - len(self.shape), 0) :] != self.shape:
            raise InputError("the weights do not fit the load", where="w", found=f"shape {w.shape}",
                             expected=f"shape {self.shape}")  # fmt: skip
        return list(zip(self.each, np.moveaxis(w, w.ndim - len(self.shape), 0), strict=True))

    def bias_weights(self, w: NDArray) -> NDArray[np.float64] | None:
        """Not known under constraints."""

    def to_arrays(self) -> dict[str, object]:
        """Plain arrays, for a result file."""
        return {"kind": self.kind, "frames": {str(i): p.to_arrays() for i, p in enumerate(self.each)}}

    @classmethod
    def from_arrays(cls, tree: dict) -> FramesPosterior:
        """Inverse of `to_arrays`."""
        each = [tree["frames"][str(i)] for i in range(len(tree["frames"]))]
        passed = [None if p.get("passed") is None else np.asarray(p["passed"]) for p in each]
        return cls([
            FacePosterior(np.asarray(p["factor"]), tuple(p["shape"]), passed=f)
            for p, f in zip(each, passed, strict=True)
        ])  # fmt: skip
