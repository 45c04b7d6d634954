"""What is known of the error of a load: its covariance as the solver has it, also on an active face."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from importlib import import_module
from typing import Any, Protocol, runtime_checkable

import numpy as np

from structures._testing.spectra import multiplicity
from structures.errors import InputError

from . import Array, Numbers


@runtime_checkable
class Posterior(Protocol):
    """Covariance of a load estimate."""

    @property
    def std(self) -> Array:
        """Standard deviation, in the shape of the load."""
        ...

    def variance(self, w: Array) -> Array:
        """Variance of ``sum(w * load)``; `w` has the shape of the load, or (k,) + that shape."""
        ...

    def to_arrays(self) -> dict[str, object]:
        """Plain arrays, for a result file."""
        ...


class DensePosterior:
    """Covariance ``factor @ factor.T`` of the flattened load, by the precision of noise and prior together.

    An improper prior, flat along the null space of the penalty, needs no special case: there the data alone decide.

    Parameters
    ----------
    factor : array, shape (unknowns, modes)
    shape : tuple
        Shape of the load of one frame.
    passed : array, shape (modes,), optional
        Filter factors: the share of each mode's variance that is noise; the rest is prior. None: not known.
    dual : array, shape (unknowns, modes), optional
        ``dual.T @ factor`` is the identity; needed where there are fewer modes than unknowns that are not orthogonal.
    orthogonal : bool
        The columns of `factor` are at right angles: their dual needs no solve.
    frames : int, optional
        Frames of data with the same posterior and independent noise; the load is then (frames,) + shape.
    """

    kind = "dense"
    approximation: str | None = None  # what it approximates

    def __init__(
        self,
        factor: Array,
        shape: tuple[int, ...],
        *,
        passed: Array | None = None,
        dual: Array | None = None,
        orthogonal: bool = False,
        frames: int | None = None,
    ) -> None:
        self.factor, self.passed, self.dual, self.orthogonal = factor, passed, dual, orthogonal
        self.resolved = passed  # filter factors of the estimate
        self.frame_shape = tuple(int(i) for i in shape)
        self.frames = None if frames is None else int(frames)
        self.shape = self.frame_shape if frames is None else (int(frames), *self.frame_shape)
        self._lu: tuple[Array, Array] | None = None

    @property
    def std(self) -> Array:
        """Standard deviation, in the shape of the load."""
        return self._spread(np.sum(self.factor**2, axis=1))

    @property
    def noise_std(self) -> Array | None:
        """Standard deviation from the noise alone, in the shape of the load; None where the shares are not known."""
        return None if self.passed is None else self._spread(self.factor**2 @ self.passed)

    def variance(self, w: Array) -> Array:
        """Variance of ``sum(w * load)``; `w` has the shape of the load, (k,) + that shape, or that of one frame."""
        return self._variance(w, 1.0)

    def noise_variance(self, w: Array) -> Array | None:
        """Variance of ``sum(w * load)`` from the noise alone; None where the shares are not known."""
        return None if self.passed is None else self._variance(w, self.passed)

    def bias_weights(self, w: Array) -> Array | None:
        """``(R - I)^T w`` in the shape of `w`: the bias of ``sum(w * estimate)`` is the sum of these times the load.

        If no load exceeds a limit the bias stays below the limit times the sum of their moduli; if the norm of the load
        stays below a limit, below the limit times their norm. None where the resolution R is not known.
        """
        full = self.factor.shape[0] == self.factor.shape[1]
        if self.resolved is None or not (full or self.orthogonal or self.dual is not None):
            return None
        modal, _ = self._modal(w)
        if full:
            lost = -self._undo(modal * (1 - self.resolved))
        else:
            lost = self._undo(modal * self.resolved) - np.asarray(w, float).reshape(*modal.shape[:-1], -1)
        return lost.reshape(np.shape(w))

    def to_arrays(self) -> dict[str, object]:
        """Plain arrays, for a result file."""
        tree: dict[str, object] = {"kind": self.kind, "factor": self.factor, "shape": list(self.frame_shape)}
        extra = {"passed": self.passed, "dual": self.dual, "orthogonal": self.orthogonal or None, "frames": self.frames}
        return tree | {name: value for name, value in extra.items() if value is not None}

    def _spread(self, variance: Array) -> Array:
        return np.broadcast_to(np.sqrt(variance).reshape(self.frame_shape), self.shape)

    def _variance(self, w: Array, weight: Array | float) -> Array:
        modal, framed = self._modal(w)
        return np.asarray(np.sum(modal**2 * weight, axis=(-2, -1) if framed else -1))  # frames have independent noise

    def _modal(self, w: Array) -> tuple[Array, bool]:
        """``factor.T @ w`` on the last axis, and whether the axis before it holds frames."""
        w = np.asarray(w, float)
        for shape in (self.shape, self.frame_shape):
            lead = w.shape[: max(w.ndim - len(shape), 0)]
            alone = shape is not self.shape  # a stack of one-frame weights could be mistaken for frames
            if w.shape[len(lead) :] == shape and not (alone and lead):
                framed = self.frames is not None and shape is self.shape
                axes = (*lead, shape[0]) if framed else lead
                return w.reshape(*axes, -1) @ self.factor, framed
        raise InputError(
            "the weights do not fit the load", where="w", found=f"shape {w.shape}",
            expected=f"shape {self.shape}" + (f", or {self.frame_shape} for one frame" if self.frames else ""),
        )  # fmt: skip

    def _undo(self, modal: Array) -> Array:
        """Dual of the factor times modal values on the last axis."""
        if self.dual is not None:
            return modal @ self.dual.T
        length = np.linalg.norm(self.factor, axis=0)
        if self.orthogonal:
            return np.asarray((modal / length**2) @ self.factor.T)
        from scipy.linalg import lu_factor, lu_solve

        if self._lu is None:  # factored once, columns scaled to equal length
            self._lu = lu_factor((self.factor / length).T)
        flat = (modal / length).reshape(-1, modal.shape[-1]).T
        return np.asarray(lu_solve(self._lu, flat).T.reshape(modal.shape))


class SpectralPosterior:
    """Covariance that is stationary in time: one small matrix for each line of a padded spectrum.

    Parameters
    ----------
    lines : array, shape (lines, loads, loads)
        Covariance of the load spectrum over the padded length, for noise that fills the record.
    samples, padded : int
        Length of the record and of the padded transform.
    """

    kind = "spectral"

    def __init__(self, lines: Numbers, samples: int, padded: int) -> None:
        self.lines, self.samples, self.padded = lines, int(samples), int(padded)

    @property
    def std(self) -> Array:
        """Standard deviation, shape (samples, loads): the same at every sample."""
        diagonal = np.einsum("kii->ki", self.lines).real
        level = np.sqrt(multiplicity(self.padded) @ diagonal / (self.padded * self.samples))
        return np.tile(level, (self.samples, 1))

    def variance(self, w: Array) -> Array:
        """Variance of ``sum(w * load)``; `w` is (samples, loads) or (k, samples, loads)."""
        W = np.fft.rfft(np.asarray(w, float), self.padded, axis=-2)
        quadratic = np.einsum("...ki,kij,...kj->...k", W.conj(), self.lines, W).real
        return np.asarray(quadratic @ multiplicity(self.padded) / (self.padded * self.samples))

    @property
    def noise_std(self) -> None:
        """Not known: the lines hold noise and prior together."""

    def noise_variance(self, w: Array) -> None:
        """Not known: the lines hold noise and prior together."""

    def bias_weights(self, w: Array) -> None:
        """Not known: the lines do not hold the resolution."""

    def to_arrays(self) -> dict[str, object]:
        """Plain arrays, for a result file."""
        return {"kind": self.kind, "lines": self.lines, "samples": self.samples, "padded": self.padded}


ELSEWHERE = {  # kind -> module and class that reads it
    "acting": (".support", "ActingPosterior"),
    "correlated": (".._learning.posterior", "StaticPosterior"),
    "correlated over time": (".._learning.posterior", "HistoryPosterior"),
    "convolved": (".convolved.posterior", "ConvolvedPosterior"),
    "drawn": (".marginal", "DrawnPosterior"),
    "marginal": (".marginal", "MarginalPosterior"),
    "local variance, lines": (".convolved.local_lines", "LocalLinesPosterior"),
    "local variance": (".local_prior", "LocalVariancePosterior"),
    "mapped": (".gaussian.posterior", "MappedPosterior"),
    "statespace": (".gaussian.posterior", "StateSpacePosterior"),
    "statespace, sized": (".gaussian.sized", "SizedPosterior"),
    "support": (".sparse.path", "SupportPosterior"),
}


def from_arrays(tree: dict[str, Any]) -> Posterior:
    """Posterior from what `to_arrays` gave.

    Raises
    ------
    InputError
        If the kind is unknown.
    """
    if tree.get("kind") in (DensePosterior.kind, FacePosterior.kind):
        return dense(tree)
    if tree.get("kind") == FramesPosterior.kind:
        return FramesPosterior.from_arrays(tree)
    if tree.get("kind") == SpectralPosterior.kind:
        return SpectralPosterior(np.asarray(tree["lines"]), tree["samples"], tree["padded"])
    if tree.get("kind") == WidenedPosterior.kind:
        return WidenedPosterior(from_arrays(tree["own"]), np.asarray(tree["spread"], float))
    if tree.get("kind") in ELSEWHERE:
        module, name = ELSEWHERE[tree["kind"]]
        found: Posterior = getattr(import_module(module, __package__), name).from_arrays(tree)
        return found
    raise InputError("unknown kind of posterior", where="result file", found=tree.get("kind"),
                     expected="a kind that this version knows")  # fmt: skip


class FacePosterior(DensePosterior):
    """Gaussian posterior in the directions that the active constraints leave free.

    An active-set approximation: a load held by a constraint has std 0, which says that a small change of the data
    leaves it held, not that it is known. `loadid._inverse.constrained.path.ConstrainedPath.sample` draws from what the
    constraints leave.
    """

    kind = "face"
    approximation = "active-set approximation"

    def bias_weights(self, w: Array) -> None:
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
        return next((p.approximation for p in self.each if p.approximation), None)

    @property
    def std(self) -> Array:
        """Standard deviation, in the shape of the load, (frames,) + that of one frame."""
        return np.stack([p.std for p in self.each])

    @property
    def noise_std(self) -> Array | None:
        """Standard deviation from the noise alone."""
        parts = [p.noise_std for p in self.each]
        return None if any(p is None for p in parts) else np.stack([p for p in parts if p is not None])

    def variance(self, w: Array) -> Array:
        """Variance of ``sum(w * load)``; `w` has the shape of the load, (k,) may stand in front."""
        return np.asarray(np.sum([p.variance(x) for p, x in self._frames(w)], axis=0))

    def noise_variance(self, w: Array) -> Array | None:
        """Variance of ``sum(w * load)`` from the noise alone."""
        parts = [p.noise_variance(x) for p, x in self._frames(w)]
        return None if any(v is None for v in parts) else np.sum([v for v in parts if v is not None], axis=0)

    def _frames(self, w: Array) -> list[tuple[DensePosterior, Array]]:
        w = np.asarray(w, float)
        if w.shape[max(w.ndim - len(self.shape), 0) :] != self.shape:
            raise InputError("the weights do not fit the load", where="w", found=f"shape {w.shape}",
                             expected=f"shape {self.shape}")  # fmt: skip
        return list(zip(self.each, np.moveaxis(w, w.ndim - len(self.shape), 0), strict=True))

    def bias_weights(self, w: Array) -> Array | None:
        """``(R - I)^T w`` in the shape of `w`, frame by frame; None under constraints."""
        parts = [p.bias_weights(x) for p, x in self._frames(w)]
        known = [v for v in parts if v is not None]
        return np.stack(known, axis=np.ndim(w) - len(self.shape)) if len(known) == len(parts) else None

    def to_arrays(self) -> dict[str, object]:
        """Plain arrays, for a result file."""
        return {"kind": self.kind, "frames": {str(i): p.to_arrays() for i, p in enumerate(self.each)}}

    @classmethod
    def from_arrays(cls, tree: dict[str, Any]) -> FramesPosterior:
        """Inverse of `to_arrays`."""
        each = [from_arrays(tree["frames"][str(i)]) for i in range(len(tree["frames"]))]
        return cls([p for p in each if isinstance(p, DensePosterior)])


class WidenedPosterior:
    """A posterior, and loads whose outer products are added: what errors of the model do, over the whole load at once.

    Parameters
    ----------
    own : Posterior
    spread : array, shape (k,) + that of the load
    """

    kind = "widened"

    def __init__(self, own: Posterior, spread: Array) -> None:
        self.own, self.spread = own, np.asarray(spread, float)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the load."""
        return self.spread.shape[1:]

    @cached_property
    def std(self) -> Array:
        """Standard deviation, in the shape of the load."""
        return np.asarray(np.sqrt(self.own.std**2 + np.sum(self.spread**2, axis=0)))

    def variance(self, w: Array) -> Array:
        """Variance of ``sum(w * load)``; `w` has the shape of the load, or (k,) + that shape."""
        w = np.asarray(w, float)
        own = np.asarray(self.own.variance(w))
        axes = tuple(range(1, self.spread.ndim))
        moved = np.tensordot(w, self.spread, (tuple(range(w.ndim - len(axes), w.ndim)), axes))
        return np.asarray(own + np.sum(moved**2, axis=-1))

    def to_arrays(self) -> dict[str, object]:
        """Plain arrays, for a result file."""
        return {"kind": self.kind, "own": self.own.to_arrays(), "spread": self.spread}


def dense(tree: dict[str, Any]) -> DensePosterior:
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
