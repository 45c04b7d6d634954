"""A load prior of local variance, learned by evidence, beside the best stationary one; and which of the two to use.

    g = 2 a g(-1) - a^2 g(-2) + w,   a = exp(-sqrt(3) / memory),   w ~ N(0, v),   v = Phi b + floor

Phi holds triangular bumps; memory 0 is a white load. Variances climb by ``v <- v (sum phi rho^2 / sum phi Q)^s``, from
the two halves of their score (`gaussian.local_variance`): D. MacKay's rule, Neural Comput. 4 (1992) 415, at s = 1;
never down at s = 1/2 (D. Wipf & S. Nagarajan, IEEE J. Sel. Top. Signal Process. 4 (2010) 317); 1.6 for bumps, where
seven updates reach what .8 reaches after fourteen (the demo and six impacts). The variances of the noise, of an unknown
start, and of an error of the model in proportion to the energy of the response, ``R_k = r + misfit^2 p_k``, are learned
by the same rule.

Raw evidence prefers the local prior on nearly all records, as it has hundreds of numbers more. The stationary one that
it is compared with has a memory too, up to 30 samples; its gain is counted for each bump that is in use, and asked to
be the larger, the larger the share of the record is over which the load acts; and every load has to rest over half of
the record, its variance a hundredth of the largest or less. Nor may bumps of a memory longer than a pulse be likelier.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from structures.errors import InputError

from .gaussian.gains import feedback
from .gaussian.local_variance import Smoother, SmootherPass, Variances, smoothed
from .gaussian.passes import forward
from .gaussian.record import WhitenedRecord
from .gaussian.roots import Array
from .nuisances import Marginal, Nuisances, linearised
from .posterior import Posterior, WidenedPosterior

HALF, STRIDE = 8, 4  # samples: half-width of a bump, distance of two
POWER = 1.6  # of the update of bumps
MOST, TRIED = 8, 6  # updates of bumps, and those after which memories are compared
GUESSED, SETTLED = 3, 8  # updates of constant variances: from each guess of the noise, and from the best so far
GAIN = 0.5  # ln evidence of an update below which it is the last
ENERGY = 16  # samples to each side over which the energy of the response is averaged
LEAST = 1e-14  # of the largest variance that is kept
FARTHEST = 1e6  # factor of one update
NOISELESS = 1e-8  # least variance of a learned noise, over the mean square of its channel: the filter's digits
MEMORIES = (0.0, 2.0, 3.5, 6.0, 12.0, 30.0)  # samples
FIRST = 3  # which of them is tried first
ASKED = 15.0  # gain for each bump in use, over the share of the record in use, that is no chance
RESTS, QUIET = 0.5, 1e-2  # share of the record over which every load of impacts rests: variance over its largest
LONGEST, SLOWER = 12.0, 10.0  # samples: memory of a pulse; ln evidence by which a longer one tells that it is none
CHANCE = 4.0  # std of such a correlation
COLOURED = 0.35  # correlation of a residual from sample to sample above which the noise is not white
LEAST_MISFIT = 0.01  # from which it is learned
UNLIKELY, UNKNOWN = 1e-4, 0.05  # odds of errors of the model, and misfit beside them, at which it is contradicted
TINY = np.finfo(float).tiny


class Evident(Protocol):
    """Anything with an evidence."""

    @property
    def evidence(self) -> float:
        """Log likelihood of the whitened data."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Judgement:
    """Whether a local variance is asked for, by what was learned beside the best constant one.

    Parameters
    ----------
    evidence : float
        Log likelihood of the whitened data, without `misfit`.
    memory : float
        In samples.
    stationary : Evident
        The best load of constant variance.
    compared : array, shape (samples, p)
        Variances of the load, of that evidence.
    correlation : float
        Of the residual from one sample to the next, where the response is small, in the worst channel; 0 by chance.
    misfit : float
        Error of the model in parts of the response.
    bumps : int
        Variances that were learned beyond the stationary ones.
    updates : int
        Smoother passes, all memories together.
    slower : float
        Log likelihood that bumps of a longer memory than a pulse has have beyond these; -inf where none were tried.
    errors : Marginal, optional
        Errors of the model, linearised about the load.
    """

    evidence: float
    memory: float
    stationary: Evident
    compared: Array
    correlation: float
    misfit: float
    bumps: int
    updates: int
    slower: float = -np.inf
    errors: Marginal | None = None

    @property
    def contradicted(self) -> bool:
        """Whether the data tell errors of the model that its prior does not expect, or that are of no kind it knows."""
        return self.errors is not None and (self.errors.odds < UNLIKELY or self.misfit > UNKNOWN)

    @property
    def participation(self) -> Array:
        """Share of the record over which the variance of each load is spread, (p,)."""
        v = self.compared / np.maximum(self.compared.max(axis=0), TINY)
        return np.asarray(v.sum(axis=0) ** 2 / (len(v) * np.maximum(np.sum(v**2, axis=0), TINY)))

    @property
    def gain(self) -> float:
        """Log evidence beyond the stationary prior, for each bump in use."""
        return (self.evidence - self.stationary.evidence) / (self.bumps * float(self.participation.mean()))

    @property
    def rest(self) -> float:
        """Share of the record over which the load that rests least has next to no variance."""
        return float(np.mean(self.compared < QUIET * self.compared.max(axis=0), axis=0).min())

    @property
    def rests(self) -> bool:
        """Whether the load rests for the larger part, by no chance."""
        return self.gain > ASKED * float(self.participation.mean()) and self.rest > RESTS

    @property
    def asked_for(self) -> bool:
        """Whether the data ask for it: a load that rests, no memory beyond a pulse that is likelier, white noise.

        Pulses are none where bumps that last longer are far likelier: two that each fall before they rise stand for a
        step, of which accelerometers see no more.
        """
        pulses = self.memory <= LONGEST and self.slower < SLOWER
        return self.rests and pulses and self.correlation < COLOURED


@dataclass(frozen=True, eq=False, kw_only=True)
class StationaryPrior:
    """The best load of constant variance.

    Parameters
    ----------
    evidence : float
        Log likelihood of the whitened data.
    memory : float
        In samples.
    record : WhitenedRecord
        With the memory as states.
    given : Variances
    noise : array, shape (m,)
        Variances of the noise of the whitened channels.
    """

    evidence: float
    memory: float
    record: WhitenedRecord
    given: Variances
    noise: Array

    @property
    def data(self) -> int:
        """Number of data."""
        return self.record.data

    @cached_property
    def smoother(self) -> Smoother:
        """Of its record and variances."""
        return Smoother(self.record, self.given)

    def posterior(self, errors: Marginal | None = None) -> tuple[Array, Posterior, Array]:
        """Mean of the load (samples, p), its posterior with these errors of the model, and the mean first state."""
        _, load, _, _, first = self.smoother.means(self.record.y)
        own = LocalVariancePosterior(self.smoother)
        return load, own if errors is None else WidenedPosterior(own, errors.spread), self.given.start @ first

    def resolved(self, load: Array) -> Array:
        """What would be estimated from the noise-free response of a load (samples, p)."""
        r = self.record
        response = forward(r, feedback(r, r.E), np.ascontiguousarray(load, float), np.zeros(r.n))[2]
        return self.smoother.means(response)[1]

    def unexplained(self) -> float:
        """Sum of the squares of the whitened data that neither the load nor the errors of the model explain."""
        e = self.smoother.means(self.record.y)[3]
        shown = np.any(self.record.C != 0, axis=2) | np.any(self.record.D != 0, axis=2)
        return float(np.sum(np.where(shown[self.record.kind], self.given.noise * e, 0.0) ** 2))

    def freedom(self) -> float:
        """Effective degrees of freedom of the load."""
        return float(np.sum(self.given.load * self.smoother.rho_variance))


@dataclass(frozen=True, eq=False, kw_only=True)
class LocalPrior(StationaryPrior, Judgement):
    """A load whose variance changes with time, learned from the data.

    Parameters
    ----------
    evidence, memory, record, given, noise
        As in `StationaryPrior`; the evidence is that without `misfit`, to be compared.
    stationary, compared, correlation, misfit, bumps, updates, errors
        As in `Judgement`.
    fit : Fit
        As it was learned.
    """

    fit: Fit


def errors_told(prior: StationaryPrior, nuisances: Nuisances) -> Marginal:
    """Errors of the model, linearised about the load of a prior, as far as the data do not rule them out.

    The load is not moved by what the data tell of them: errors of no kind that the prior knows (modes that the model
    leaves out) are told as such that it knows, and take the load with them, far beyond the band.

    Parameters
    ----------
    prior : StationaryPrior
    nuisances : Nuisances
        Of the problem whose record it was learned from, without memory.
    """
    smoother = prior.smoother
    _, load, _, _, first = smoother.means(prior.record.y)

    def solve(data: Array) -> tuple[Array, Array]:
        _, pulled, _, weighed, _ = smoother.means(data)
        return weighed, pulled

    return linearised(nuisances, load, prior.given.start @ first, solve, prior.record.y, prior.given.noise)


def with_errors(prior: LocalPrior, nuisances: Nuisances) -> LocalPrior:
    """The prior with errors of the model in its band: see `errors_told`."""
    smoother = prior.smoother
    found = replace(prior, errors=errors_told(prior, nuisances))
    vars(found)["smoother"] = smoother  # the record and the variances are the same
    return found


def local_prior(record: WhitenedRecord, *, stated: bool = False) -> LocalPrior:
    """Learn both priors from a record of a load without penalty (E = 0), of a model without errors.

    Parameters
    ----------
    record : WhitenedRecord
        Its free states start with a variance each, which is learned.
    stated : bool
        The noise is stated: its whitened variance stays 1.
    """

    def move(old: Fit, before: float, memory: float) -> Fit:
        return _moved(old, record, before, memory)

    still, top = _stationary(record, stated)
    seed = _moved(still[top], record, MEMORIES[top], MEMORIES[top])
    seed.b[:], seed.floor = 0.45 * seed.floor, 0.1 * seed.floor
    seed.climb(TRIED)
    local = searched(seed, top, TRIED, POWER, move)
    most = max(LONGEST, MEMORIES[top])  # bumps beside a longer memory are pulses cut out of a slow load
    best, slower = best_of(local, most)
    chosen = local[best]
    last = chosen.climb(MOST)
    chosen.weigh(last)
    given = chosen.variances()
    return LocalPrior(
        evidence=chosen.evidence, memory=MEMORIES[best], record=chosen.record, given=given, noise=chosen.r,
        stationary=_as_prior(still[top], MEMORIES[top]), compared=given.load, correlation=chosen.correlation(last),
        misfit=0.0, bumps=chosen.b.size, fit=chosen, slower=slower,
        updates=sum(one.updates for one in (*still.values(), *local.values())),
    )  # fmt: skip


def stationary_prior(record: WhitenedRecord, *, stated: bool = False) -> StationaryPrior:
    """The best load of constant variance alone, learned as by `local_prior`."""
    still, top = _stationary(record, stated)
    return _as_prior(still[top], MEMORIES[top])


def with_misfit(prior: LocalPrior) -> LocalPrior:
    """The prior with an error of the model in proportion to the response, learned beside its variances."""
    fit = prior.fit.on(prior.record)  # with the energy of the response at these variances
    fit.misfit2 = LEAST_MISFIT**2
    fit.climb(MOST, missing=True)
    return replace(prior, given=fit.variances(), noise=fit.r, misfit=float(np.sqrt(fit.misfit2)), fit=fit,
                   updates=prior.updates + fit.updates)  # fmt: skip


class LocalVariancePosterior:
    """Covariance of a load whose prior variance changes with time, never formed.

    Parameters
    ----------
    smoother : Smoother
        Its data are not used.
    """

    kind = "local variance"

    def __init__(self, smoother: Smoother) -> None:
        self._smoother = smoother
        self.shape = smoother.record.samples, smoother.record.p

    @cached_property
    def std(self) -> Array:
        """Standard deviation, shape (samples, loads)."""
        return np.asarray(np.sqrt(self._smoother.variance))

    def variance(self, w: Array) -> Array:
        """Variance of ``sum(w * load)``; `w` is (samples, loads) or (k, samples, loads)."""
        w = np.asarray(w, float)
        if w.shape[-2:] != self.shape or w.ndim > 3:
            raise InputError("the weights do not fit the load", where="w", found=f"shape {w.shape}",
                             expected=f"shape {self.shape}, or a stack of such")  # fmt: skip
        if w.ndim == 3:
            return np.array([self.variance(one) for one in w])
        return np.asarray(max(float(np.sum(w * self._smoother.covariance_times(w))), 0.0))

    def to_arrays(self) -> dict[str, object]:
        """Plain arrays, for a result file."""
        r, given = self._smoother.record, self._smoother.given
        return {
            "kind": self.kind, "F": r.F, "G": r.G, "C": r.C, "D": r.D, "E": r.E, "samples": r.kind, "free": r.free,
            "data": r.data, "v": given.load, "noise": given.noise, "start": given.start,
        }  # fmt: skip

    @classmethod
    def from_arrays(cls, tree: dict[str, Any]) -> LocalVariancePosterior:
        """From what `to_arrays` gave."""
        F, G, C, D, E = (np.asarray(tree[name], float) for name in "FGCDE")
        kind = np.asarray(tree["samples"]).astype(np.int32)
        free = np.asarray(tree["free"]).astype(int).reshape(-1)
        record = WhitenedRecord(F, G, C, D, E, kind, np.zeros((len(kind), C.shape[1])), free, int(tree["data"]))
        return cls(Smoother(record, Variances(*(np.asarray(tree[name], float) for name in ("v", "noise", "start")))))


def best_of(local: Mapping[int, Evident], most: float) -> tuple[int, float]:
    """Number of the likeliest memory up to `most`, and the ln evidence that a longer one has beyond it."""
    best = max((i for i in local if MEMORIES[i] <= most), key=lambda i: local[i].evidence)
    beyond = max((one.evidence for i, one in local.items() if MEMORIES[i] > most), default=-np.inf)
    return best, beyond - local[best].evidence


# -- inside ------------------------------------------------------------------------------------------------------------
def with_memory(record: WhitenedRecord, memory: float) -> WhitenedRecord:
    """Record of a load with this memory in samples; of a white one as it is."""
    if not memory:
        return record
    n, p, kinds = record.n, record.p, len(record.F)
    a = float(np.exp(-np.sqrt(3) / memory))
    E = np.hstack([2 * a * np.eye(p), -(a**2) * np.eye(p)])
    F = np.zeros((kinds, n + 2 * p, n + 2 * p))
    F[:, :n, :n], F[:, :n, n:], F[:, n:, n:] = record.F, record.G @ E, np.vstack([E, np.eye(p, 2 * p)])
    G = np.concatenate([record.G, np.broadcast_to(np.eye(2 * p, p), (kinds, 2 * p, p))], axis=1)
    return WhitenedRecord(
        F, np.ascontiguousarray(G), np.concatenate([record.C, record.D @ E], axis=2), np.ascontiguousarray(record.D),
        np.hstack([np.zeros((p, n)), E]), record.kind, record.y, record.free, record.data,
    )  # fmt: skip


def input_variance(memory: float) -> float:
    """Variance of the white input of a load of variance one."""
    a2 = float(np.exp(-2 * np.sqrt(3) / memory)) if memory else 0.0
    return (1 - a2) ** 3 / (1 + a2)


def bumps(samples: int) -> Any:
    """Triangles (samples, count), sparse."""
    from scipy.sparse import csr_array

    centres, offsets = np.arange(-STRIDE, samples + STRIDE, STRIDE), np.arange(-HALF + 1, HALF)
    at = centres + offsets[:, None]
    height = np.broadcast_to(1 - np.abs(offsets[:, None]) / HALF, at.shape)
    column = np.broadcast_to(np.arange(len(centres)), at.shape)
    inside = (at >= 0) & (at < samples)
    return csr_array((height[inside], (at[inside], column[inside])), shape=(samples, len(centres)))


class Fit:
    """The variances while they are learned.

    Parameters
    ----------
    record : WhitenedRecord
    stated : bool

    Attributes
    ----------
    b, floor, r : array, shapes (bumps, p), (p,), (m,)
    square : array, shape (m,)
        Mean squares of the channels.
    start : array, shape (n,)
        Variances of the first state.
    misfit2 : float
    evidence : float
        Of the last pass.
    updates : int
    """

    def __init__(self, record: WhitenedRecord, stated: bool) -> None:
        self.record, self.stated = record, stated
        shown = np.any(record.C != 0, axis=2) | np.any(record.D != 0, axis=2)
        self.there = shown[record.kind]
        self.phi = bumps(record.samples)
        self.b, self.floor = np.zeros((self.phi.shape[1], record.p)), np.ones(record.p)
        self.r, self.start = np.ones(record.m), np.zeros(record.n)
        self.square = np.sum(record.y**2, axis=0) / np.maximum(self.there.sum(axis=0), 1)
        self.misfit2, self.power = 0.0, np.zeros((record.samples, record.m))
        self.updates, self.evidence = 0, -np.inf

    def variances(self) -> Variances:
        """As a smoother takes them."""
        noise = np.where(self.there, self.r + self.misfit2 * self.power, 1.0)
        return Variances(self.phi @ self.b + self.floor, noise, np.diag(self.start))

    def on(self, record: WhitenedRecord) -> Fit:
        """The same variances, to go on with on another record of the same data."""
        new = Fit(record, self.stated)
        new.b, new.floor, new.r, new.start = self.b.copy(), self.floor.copy(), self.r.copy(), self.start.copy()
        new.misfit2, new.power = self.misfit2, self.power
        return new

    def climb(self, most: int, power: float = POWER, missing: bool = False) -> SmootherPass:
        """Update until the evidence gains no more; the last pass, whose variances are kept."""
        before = -np.inf
        for step in range(most + 1):
            s = smoothed(self.record, self.variances())
            self.evidence = s.evidence if np.isfinite(s.evidence) else -np.inf
            if step == most or (not self.evidence - before >= GAIN and step > 2):
                break
            before = self.evidence
            if missing:
                self.weigh(s)
            self._update(s, power)
            self.updates += 1
        return s

    def weigh(self, s: SmootherPass) -> None:
        """Energy of the response as a pass has it."""
        response = np.where(self.there, self.record.y - self.variances().noise * s.e, 0.0)
        window = np.full(2 * ENERGY + 1, 1 / (2 * ENERGY + 1))
        self.power = np.array([np.convolve(one, window)[ENERGY:-ENERGY] for one in (response**2).T]).T

    def correlation(self, s: SmootherPass) -> float:
        """Of the residual from sample to sample, by what is left in the quiet: there no error of the model is seen."""
        return quiet_correlation(self.r * s.e, self.power, self.r, self.there)

    def _update(self, s: SmootherPass, power: float) -> None:
        rho2, e2 = s.rho**2, np.where(self.there, s.e**2, 0.0)
        known = np.where(self.there, s.e_variance, 0.0)
        self.b *= ratio(self.phi.T @ rho2, self.phi.T @ s.rho_variance, power)
        self.floor *= ratio(rho2.sum(axis=0), s.rho_variance.sum(axis=0), power)
        power = min(power, 1.0)
        least = LEAST * (self.b.max(axis=0) + self.floor)
        self.b[self.b < least] = 0.0
        self.floor = np.maximum(self.floor, least)
        if self.misfit2 > 0.0:
            self.misfit2 *= float(ratio(np.sum(self.power * e2), np.sum(self.power * known), power))
        if not self.stated:
            self.r *= ratio(e2.sum(axis=0), known.sum(axis=0), power)
            self.r = np.maximum(self.r, np.maximum(NOISELESS * self.square, TINY))
        self.start *= ratio(s.start**2, np.diag(s.start_information), power)


def quiet_correlation(rest: Array, power: Array, r: Array, there: Array | None = None) -> float:
    """Correlation from sample to sample of residuals (samples, m), where the response is small; the worst channel's.

    Parameters
    ----------
    rest, power : array, shape (samples, m)
        Residual and energy of the response.
    r : array, shape (m,)
        Variances of the noise.
    there : array, shape (samples, m), optional
        Which data there are.
    """
    worst, there = 0.0, np.ones(rest.shape, bool) if there is None else there
    for c in range(rest.shape[1]):
        u = np.where(there[:, c], 1 / (r[c] + power[:, c]), 0.0)
        e = rest[:, c] * np.sqrt(u)
        own = float(np.sum(e[1:] * e[:-1])) / max(float(np.sum(e**2)), TINY)
        few = float(np.sum(u) / np.sqrt(max(np.sum(u**2), TINY)))  # root of how many samples that is
        worst = max(worst, own if own * few > CHANCE else 0.0)
    return worst


def ratio(up: Any, down: Any, power: float) -> Any:
    """Factor of an update, at most `FARTHEST`: expectations that cancelled to nothing tell no more."""
    up, down = np.maximum(up, 0.0), np.maximum(down, TINY)
    return (np.minimum(up, FARTHEST * down) / down) ** power


def _sizes(record: WhitenedRecord) -> tuple[Array, Array]:
    """Energies of the responses (m, p) and of the states (n,) that unit white inputs reach over the record."""
    kind = int(np.argmax(np.abs(record.C).sum(axis=(1, 2)) + np.abs(record.D).sum(axis=(1, 2))))
    F, C, D = record.F[kind], record.C[kind], record.D[kind]
    out, states = np.empty((record.m, record.p)), np.zeros(record.n)
    for j in range(record.p):
        g = record.G[kind][:, j : j + 1]
        X, step, length = g @ g.T, F, 1
        while length < record.samples:
            X, step, length = X + step @ X @ step.T, step @ step, 2 * length
        out[:, j] = np.einsum("mi,ik,mk->m", C, X, C) + D[:, j] ** 2
        states += np.diag(X)
    return out, states


def _constant(record: WhitenedRecord, stated: bool) -> Fit:
    """Best constant variances of a load with the first memory, from two guesses of the noise."""
    whole = with_memory(record, MEMORIES[FIRST])
    sizes, states = _sizes(whole)
    fits, shares = [], (1.0,) if stated else (0.1, 1e-3)
    for share in shares:
        one = Fit(whole, stated)
        one.floor = np.maximum(one.square.sum() / np.maximum(sizes.sum(axis=0), TINY) / record.p, TINY)
        one.start[record.free] = states[record.free] * one.floor.mean()
        one.r = np.ones(record.m) if stated else np.maximum(share * one.square, TINY)
        one.climb(GUESSED, 1.0)
        fits.append(one)
    best = max(fits, key=lambda one: one.evidence)
    best.climb(SETTLED, 1.0)
    best.updates = sum(one.updates for one in fits)
    return best


def _stationary(record: WhitenedRecord, stated: bool) -> tuple[dict[int, Fit], int]:
    """Constant variances by number of their memory, and the number of the best."""
    still = searched(
        _constant(record, stated), FIRST, SETTLED, 1.0, lambda old, before, memory: _moved(old, record, before, memory)
    )
    return still, max(still, key=lambda i: still[i].evidence)


def _as_prior(fit: Fit, memory: float) -> StationaryPrior:
    """What was learned of a constant variance."""
    return StationaryPrior(evidence=fit.evidence, memory=memory, record=fit.record, given=fit.variances(), noise=fit.r)


def _moved(old: Fit, record: WhitenedRecord, before: float, memory: float) -> Fit:
    """The same variances of the load with another memory."""
    new = Fit(with_memory(record, memory), old.stated)
    part = input_variance(memory) / input_variance(before)
    new.b, new.floor, new.r = old.b * part, old.floor * part, old.r.copy()
    new.start[: record.n] = old.start[: record.n]
    return new


def searched(first: Any, at: int, most: int, power: float, moved: Callable[[Any, float, float], Any]) -> dict[int, Any]:
    """Fits by number of their memory, from `at` on to the side on which the evidence rises, until it falls."""
    fits = {at: first}
    for step in (-1, 1):
        i = at + step
        while 0 <= i < len(MEMORIES):
            before = fits[i - step]
            fits[i] = moved(before, MEMORIES[i - step], MEMORIES[i])
            fits[i].climb(most, power)
            if fits[i].evidence < before.evidence:
                break
            i += step
        if max(fits.values(), key=lambda one: one.evidence) is not first:
            break
    return fits
