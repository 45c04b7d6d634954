"""A map brought to its real sensor by a few records with known force: gain, offset, bias and noise, with their errors.

What a map m says of a record is taken to be off by a gain, by what the error of the measured bias does to it, and by
errors of the size that it states: ``x = (1 + g) m + D^T u + e``. Gains have a wide prior, u is of unit variance: D is
the bias' own error, carried through the map. Least squares over the records of known force, with the priors as rows,
gives g and u and how far they are off (the covariance of least squares where errors go along: C. R. Rao, Linear
Statistical Inference and Its Applications, 2nd ed., 1973, section 4a). These errors are shared by all that the map says
afterwards, and go into its std.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

Array = NDArray[np.float64]

TRUST = 0.5  # std of a gain before any record is seen
WITHIN = 0.975  # quantile at which a band of a measured std is as wide as one of a known std
BEFORE = 5.0  # squared errors, as large as stated, that count beside those of the records


@dataclass(frozen=True, eq=False)
class Adaptation:
    """What records with known force told.

    Parameters
    ----------
    gain, offset : array (outputs,)
        What outputs are multiplied with, and what is added to them then, SI.
    bias : array (sensors,)
        Readings without load, SI.
    spread : float
        What the std is multiplied with.
    records : int
    by_gain : array (k, outputs)
        Errors of the gains, each of unit std and shared by all outputs: of outputs of 1.
    fixed : array (k, outputs)
        The same errors of outputs of 0.
    """

    gain: Array
    offset: Array
    bias: Array
    spread: float
    records: int
    by_gain: Array
    fixed: Array

    @classmethod
    def none(cls, outputs: int, bias: Array, through: Array | None = None) -> Self:
        """Nothing was told but a bias, whose errors (k, outputs) went through the map."""
        fixed = np.zeros((0, outputs)) if through is None else through
        return cls(np.ones(outputs), np.zeros(outputs), bias, 1.0, 0, np.zeros_like(fixed), fixed)

    @classmethod
    def from_arrays(cls, tree: Mapping[str, Any]) -> Self:
        """Inverse of `vars`."""
        return cls(**{**tree, "spread": float(tree["spread"]), "records": int(tree["records"])})

    def shared(self, mean: Array) -> Array:
        """Errors (..., k, outputs) of unit std that outputs (..., outputs) of the map share."""
        return self.spread * (self.fixed + mean[..., None, :] * self.by_gain)


@dataclass(frozen=True, eq=False)
class Told:
    """Numbers that are known of one record.

    Parameters
    ----------
    mean : array ([samples,] outputs)
        What the map says.
    sums : array (k, outputs) or None
        What the numbers are of the outputs' means over time; None where they are the outputs.
    known, std : array
        The numbers, and the std that the map states for them.
    factor : array (j, outputs) or None
        Of the correlation of errors of one sample, where they go along.
    together : float
        Samples that err together.
    """

    mean: Array
    sums: Array | None
    known: Array
    std: Array
    factor: Array | None
    together: float

    @property
    def size(self) -> Array:
        """The std of the numbers, flat."""
        return np.maximum(np.ravel(self.std), np.finfo(float).tiny)

    @property
    def said(self) -> Array:
        """The numbers by the map, flat."""
        return np.ravel(self.mean if self.sums is None else self.sums @ self._middle)

    def columns(self, groups: Sequence[NDArray[np.int_]], through: Array) -> Array:
        """What gains of the groups and errors of the bias (k, outputs) do to the numbers (numbers, groups + k)."""
        mean = self.mean if self.sums is None else self._middle
        rows = mean.reshape(-1, mean.shape[-1])
        parts = np.zeros((len(rows), len(groups), rows.shape[1]))
        for g, members in enumerate(groups):
            parts[:, g, members] = rows[:, members]
        found = np.concatenate([parts, np.broadcast_to(through, (len(rows), *through.shape))], axis=1)
        if self.sums is not None:
            return np.asarray((found[0] @ self.sums.T).T)
        return found.transpose(0, 2, 1).reshape(-1, found.shape[1])

    def spread(self, rows: Array) -> Array:
        """Errors of sums ``rows (q, numbers) @ numbers`` as a factor (q, j): its square is their covariance."""
        wide = np.sqrt(self.together)
        if self.factor is None or self.sums is not None:
            return np.asarray(wide * rows * self.size)
        at = rows.reshape(len(rows), -1, self.factor.shape[1]) * self.std.reshape(-1, self.factor.shape[1])
        return np.asarray(wide * (at @ self.factor.T).reshape(len(rows), -1))

    @property
    def _middle(self) -> Array:
        return np.asarray(self.mean.reshape(-1, self.mean.shape[-1]).mean(axis=0))


def adapted(found: Sequence[Told], groups: Sequence[NDArray[np.int_]], plain: Adaptation) -> Adaptation:
    """Gains, offset and noise by records with known force.

    Parameters
    ----------
    found : sequence of Told
    groups : sequence of array of int
        Outputs of each group: one gain each, if the records tell it; else it stays.
    plain : Adaptation
        Of the bias alone.
    """
    through = plain.fixed
    columns = [t.columns(groups, through) / t.size[:, None] for t in found]
    size = sum(np.sum(c[:, : len(groups)] ** 2, axis=0) / t.together for t, c in zip(found, columns, strict=True))
    told = [int(g) for g in np.flatnonzero(size > TRUST**-2)]
    kept = np.array([*told, *range(len(groups), len(groups) + len(through))], int)
    before = np.concatenate([np.full(len(told), 1 / TRUST), np.ones(len(through))])
    x, F, spread = _fitted(found, [c[:, kept] for c in columns], before)
    gain, by_gain = plain.gain.copy(), np.zeros((len(F), len(plain.gain)))
    for j, g in enumerate(told):
        gain[groups[g]] += x[j]
        by_gain[:, groups[g]] = F[:, j, None]
    n = len(told)
    return Adaptation(gain, through.T @ x[n:], plain.bias, spread, len(found), by_gain, F[:, n:] @ through)


def _fitted(found: Sequence[Told], columns: Sequence[Array], before: Array) -> tuple[Array, Array, float]:
    """Unknowns of priors 1/before, a factor F of their covariance F^T F, and the std of errors over the stated one."""
    off = [(t.known.ravel() - t.said) / t.size for t in found]
    weights = [np.full(len(o), t.together**-0.5) for t, o in zip(found, off, strict=True)]
    weight, count = np.concatenate(weights), sum(map(len, off))
    # samples that err together count as one of them
    Q, R = np.linalg.qr(np.vstack([weight[:, None] * np.vstack(columns), np.diag(before)]))
    back = np.linalg.lstsq(R, Q.T, rcond=None)[0]  # R^-1 Q^T: of weighted numbers, and of the priors
    x = back[:, :count] @ (weight * np.concatenate(off))
    parts = np.split(back[:, :count] * weight, np.cumsum([len(o) for o in off])[:-1].tolist(), axis=1)
    errors = [t.spread(part / t.size) for t, part in zip(found, parts, strict=True)]
    F = np.linalg.qr(np.hstack([*errors, back[:, count:]]).T).R
    free = max(1 - float(np.sum(Q[:count] ** 2)) / count, 0.1)
    # samples of one record err together: each record counts once
    sizes = [float(np.mean((o - c @ x) ** 2)) / free for o, c in zip(off, columns, strict=True)]
    spread = float(np.sqrt((BEFORE + sum(sizes)) / (BEFORE + len(sizes))))
    apart = sum(max(1.0, len(o) / t.together) for t, o in zip(found, off, strict=True))
    wider = float(stdtrit(BEFORE + apart, WITHIN)) / NormalDist().inv_cdf(WITHIN)  # of Student's t: it was measured
    if any(t.sums is not None for t in found):  # sums that are off by less do not tell that loads are
        return x, F, max(spread * wider, 1.0)
    return x, F, spread * wider


def bias_of(unloaded: Sequence[Array], scale: Array, *, history: bool) -> tuple[Array, Array]:
    """Readings without load (sensors,) and how far their mean is off (sensors,), of frames or of records.

    Parameters
    ----------
    unloaded : sequence of array (frames, sensors) or (1, samples, sensors)
    scale : array (sensors,)
        Std of the noise of each sensor; scatter that is larger counts in its place.
    history : bool
        Records scatter as wholes; frames one by one.
    """
    parts = [v.reshape(-1, v.shape[-1]) for v in unloaded]
    means = np.stack([p.mean(axis=0) for p in parts]) if history else np.vstack(parts)
    each = scale / np.sqrt(np.mean([len(p) for p in parts])) if history else scale
    more = 1.0
    if len(means) > 1:
        more = max(1.0, float(np.sqrt(np.mean(np.var(means, axis=0, ddof=1) / each**2))))
    return means.mean(axis=0), more * each / np.sqrt(len(means))
