"""The same filter elsewhere: on filterpy's KalmanFilter, there and back.

filterpy has no correlated noise of one sample, no missing channels and no steady start of its own: the correlation is
taken out first (`present`), a channel that is missing is left out of the H and R that a call is given, and the first
sample is an update without prediction.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, plain, reals

from .model import FilterModel, Present, SquareRoot, present
from .roots import Array

SLACK = 1e-9  # of the largest variance: negative eigenvalues beyond it are no rounding


@dataclass(frozen=True, eq=False)
class Tracked:
    """What filterpy made of a record: loads (samples, p) with their std, NIS and log-likelihood of each sample."""

    load: Array
    std: Array
    nis: Array
    loglik: Array


class FilterpyEngine:
    """filterpy's filter on our model, asked as `Engine` is; it believes every number and has no settled gain.

    Parameters
    ----------
    model : FilterModel

    Attributes
    ----------
    kf : filterpy.kalman.KalmanFilter
        With the state of the last sample.
    """

    loop = roots = innovation = rival = None

    def __init__(self, model: FilterModel) -> None:
        self.model, self.core, self.kf = model, SquareRoot(model), to_filterpy(model)
        self._parts: dict[bytes, Present] = {}
        self._last: tuple[Present, Array] | None = None
        self.normalised = np.full(model.m, np.nan)  # innovation of the last sample over its std, NaN where missing
        self.phase, self.taken = "warm-up", np.zeros(model.m)
        self.counts: Counter[str] = Counter()

    def step(self, y: ArrayLike) -> tuple[Array, Array]:
        """Loads (p,) and their std after a sample (m,); NaN marks a missing channel.

        Raises
        ------
        InputError
            No sample of this width, or infinite: it is not counted.
        """
        sample = self.core.sample(reals(y, where="sample", what="a sample that is no row of real numbers"))
        if self._last is not None:
            before, told = self._last
            Q = before.LQ @ before.LQ.T
            self.kf.predict(u=None if before.T is None else told, B=before.T, F=before.F, Q=Q)
        part = self._part(np.isfinite(sample))
        heard = sample[part.mask]
        self.normalised = np.full(self.model.m, np.nan)
        if len(heard):
            self.kf.update(heard, R=part.LR @ part.LR.T, H=part.H)
            self.normalised[part.mask] = self.kf.y / np.sqrt(np.diag(self.kf.S))
        else:
            self.kf.update(None)
        self._last = (part, heard)
        self.phase, self.taken = "transient", sample
        self.counts["samples"] += 1
        self.counts["missing"] += self.model.m - len(heard)
        P = self.model.Cp @ self.kf.P @ self.model.Cp.T
        return self.model.Cp @ self.kf.x, np.sqrt(np.maximum(np.diag(P), 0))

    def block(
        self, Y: Array, load: Array, std: Array, e: Array | None = None, taken_as: Array | None = None,
        settled: NDArray[np.bool_] | None = None,
    ) -> None:  # fmt: skip
        """Fill loads and std (samples, p) of a block (samples, m); normalised innovations where `e` is given."""
        for k, y in enumerate(Y):
            load[k], std[k] = self.step(y)
            if e is not None:
                e[k] = self.normalised

    def track(self, Y: ArrayLike, progress: Callable[[float, str], None] | None = None) -> Tracked:
        """Every sample of a record (samples, m).

        Raises
        ------
        InputError
            As `step`.
        """
        Y = np.asarray(plain(Y), float)
        p, N = self.model.p, len(Y)
        load, std, nis, loglik = np.empty((N, p)), np.empty((N, p)), np.zeros(N), np.zeros(N)
        for k, y in enumerate(Y):
            load[k], std[k] = self.step(y)
            if self._last is not None and len(self._last[1]):
                nis[k], loglik[k] = self._said()
            if progress and k % 1000 == 0:
                progress(k / N, "filterpy")
        return Tracked(load, std, nis, loglik)

    def to_tree(self) -> dict[str, Any]:
        """Everything that changes, as plain arrays and numbers."""
        last = None if self._last is None else {"mask": self._last[0].mask, "y": self._last[1]}
        inner = {"x": np.array(self.kf.x), "P": np.array(self.kf.P), "last": last}
        return {"phase": self.phase, "counts": dict(self.counts), "inner": inner}

    def restore(self, tree: dict[str, Any]) -> None:
        """Go on from what `to_tree` gave."""
        self.phase, inner = str(tree["phase"]), tree["inner"]
        self.counts = Counter({str(k): int(v) for k, v in tree["counts"].items()})
        self.kf.x, self.kf.P = np.array(inner["x"], float), np.array(inner["P"], float)
        last = inner["last"]
        self._last = None if last is None else (self._part(np.array(last["mask"], bool)), np.array(last["y"], float))

    def _said(self) -> tuple[float, float]:
        """NIS and log-likelihood of the last update, from its innovation and that innovation's covariance."""
        c = np.linalg.cholesky(self.kf.S)
        e = np.linalg.solve(c, self.kf.y)
        nis = float(e @ e)
        return nis, -0.5 * (nis + 2 * float(np.log(np.diag(c)).sum()) + len(e) * float(np.log(2 * np.pi)))

    def _part(self, mask: NDArray[np.bool_]) -> Present:
        key = mask.tobytes()
        if key not in self._parts:
            self._parts[key] = present(self.model, mask)
        return self._parts[key]


def to_filterpy(model: FilterModel) -> Any:
    """A ``filterpy.kalman.KalmanFilter`` with the matrices of a model, before its first update.

    Start with ``update``, then ``predict`` and ``update`` in turn. Where the noises are correlated, F and Q are those
    without the correlation and B holds what a sample tells of the noise that moved it: ``predict(u=y)`` with the sample
    of before. A missing channel is skipped by ``update(y[ok], R=kf.R[ok][:, ok], H=kf.H[ok])``.
    """
    from filterpy.kalman import KalmanFilter

    whole = present(model, np.ones(model.m, bool))
    kf = KalmanFilter(dim_x=model.n, dim_z=model.m, dim_u=0 if whole.T is None else model.m)
    kf.x, kf.P = model.x0.copy(), model.L0 @ model.L0.T
    kf.F, kf.Q = whole.F.copy(), whole.LQ @ whole.LQ.T
    kf.H, kf.R = model.H.copy(), model.LR @ model.LR.T
    kf.B = None if whole.T is None else whole.T.copy()
    return kf


def from_filterpy(kf: Any, loads: ArrayLike, *, nx: int | None = None, sample_input: bool = False) -> FilterModel:
    """The model of a filterpy filter.

    Parameters
    ----------
    kf : filterpy.kalman.KalmanFilter
        Before an update: its x and P are the start.
    loads : array (p, n)
        Reads the loads off its state.
    nx : int, optional
        States of the structure; all but the last p by default.
    sample_input : bool
        Its B is the one of `to_filterpy`: it takes the last sample, and stands for correlated noises.

    Raises
    ------
    InputError
        A fading memory, an input, or a correlation M (that of the noise into a sample with the noise of that sample,
        which is another one than ours); a covariance that is none.
    """
    F, H, Q, R, P = (np.array(getattr(kf, name), float) for name in ("F", "H", "Q", "R", "P"))
    _refuse(kf, sample_input)
    S = None
    if sample_input and kf.B is not None:
        T = np.array(kf.B, float)
        S = T @ R
        F, Q = F + T @ H, Q + S @ T.T
    Cp = np.atleast_2d(np.asarray(loads, float))
    return FilterModel(
        F=F, LQ=_root(Q, "Q"), H=H, LR=_cholesky(R), Cp=Cp, x0=np.ravel(np.asarray(kf.x, float)), L0=_root(P, "P"),
        nx=len(F) - len(Cp) if nx is None else nx, S=S,
    )  # fmt: skip


def _refuse(kf: Any, sample_input: bool) -> None:
    """What filterpy can and this model cannot."""
    for wrong, what in (
        (abs(float(getattr(kf, "alpha", 1.0)) - 1.0) > 1e-12, "a fading memory (alpha)"),
        (bool(np.any(getattr(kf, "M", 0))), "correlated noises (M) of two times"),
        (kf.B is not None and not sample_input, "an input (B)"),
    ):
        if wrong:
            raise InputError(
                "the filter does what this model cannot", where="from_filterpy", found=what,
                expected="F, H, Q, R, x and P alone", hint="sample_input=True where B is the one of to_filterpy",
            )  # fmt: skip


def _root(C: Array, name: str) -> Array:
    """Root of a covariance that may be singular."""
    w, V = np.linalg.eigh((C + C.T) / 2)
    if not np.all(np.isfinite(w)) or w[0] < -SLACK * max(w[-1], 0):
        raise InputError("no covariance", where=name, found=f"an eigenvalue of {w[0]:.3g}", expected="none below 0")
    return np.asarray(V * np.sqrt(np.maximum(w, 0)))


def _cholesky(R: Array) -> Array:
    try:
        return np.asarray(np.linalg.cholesky(R), float)
    except np.linalg.LinAlgError:
        raise InputError("no covariance of sensors", where="R", found="a singular or indefinite matrix",
                         expected="positive definite", hint="every channel has some noise") from None  # fmt: skip
