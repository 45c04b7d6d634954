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

    kind = "face"
    approximation = "active-set approximation"

    def bias_weights(self, w: NDArray) -> None:
        """Not known under constraints: another load lies on another face."""


class FramesPosterior:
    """Posteriors of frames, each with a face or a lambda of its own, with independent noise.

    Parameters
    ----------
    each : sequence of DensePosterior
    """

    kind = "frames"

    def __init__(self, each: Sequence[DensePosterior]) -> None:
        self.each = tuple(each)
        self.frames, self.frame_shape = len(self.each), self.each[0].shape
        self.shape = (self.frames, *self.frame_shape)

    @property
    def approximation(self) -> str | None:
        """What it approximates; None where the frames are Gaussian as they stand."""
        return next((p.approximation for p in self.each if isinstance(p, FacePosterior)), None)

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
        """``(R - I)^T w`` in the shape of `w`, frame by frame; None under constraints."""
        parts = [p.bias_weights(x) for p, x in self._frames(w)]
        known = [v for v in parts if v is not None]
        return np.stack(known, axis=np.ndim(w) - len(self.shape)) if len(known) == len(parts) else None

    def to_arrays(self) -> dict[str, object]:
        """Plain arrays, for a result file."""
        return {"kind": self.kind, "frames": {str(i): p.to_arrays() for i, p in enumerate(self.each)}}

    @classmethod
    def from_arrays(cls, tree: dict) -> FramesPosterior:
        """Inverse of `to_arrays`."""
        return cls([dense(tree["frames"][str(i)]) for i in range(len(tree["frames"]))])


def dense(tree: dict) -> DensePosterior:
    """A dense posterior, or one on a face, from its arrays."""
    passed, dual = (None if tree.get(k) is None else np.asarray(tree[k]) for k in ("passed", "dual"))
    made = FacePosterior if tree["kind"] == FacePosterior.kind else DensePosterior
    return made(
        np.asarray(tree["factor"]),
        tuple(tree["shape"]),
        passed=passed,
        dual=dual,
        orthogonal=bool(tree.get("orthogonal", False)),
        frames=tree.get("frames"),
    )  # files from before these were kept hold the factor and the shape only
