"""Loads with a variance of their own at every sample: what an impact is, and no stationary prior can say.

    xi_{k+1} = F xi_k + G w_k,   y_k = C xi_k + D w_k + e_k,   g_k = E xi_k + w_k,   w_jk ~ N(0, v_jk)

For given variances this is the record of `record.WhitenedRecord` with another prior: one covariance recursion forward,
one backward pass, exact, gaps and unknown starts included. With ``e = S^-1 nu - K' r`` and ``r_ = C' e + F' r``
(the disturbance smoother of de Jong, Biometrika 76 (1989) 85) the score of every variance is a by-product:

    d ll / d v_jk = (rho^2 - Q)/2,   rho = D' e + G' r,   Q = diag D' S^-1 D + (G - K D)' N (G - K D)

and ``v <- v (sum phi rho^2 / sum phi Q)^s`` climbs: with s = 1/2 never down (it is MacKay's and Neal's relevance
update in the parametrization of Wipf & Nagarajan, IEEE J. Sel. Top. Signal Process. 4 (2010) 317), with s = .8 faster.
The variances of the noise, of an unknown start and of what the model misses in proportion to the response are updated
by the same rule, each from its own pair of sums.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from .compiled import Compiled, multiply, multiply_by_transposed
from .record import WhitenedRecord
from .roots import Array


# -- the smoother of given variances -----------------------------------------------------------------------------------
@Compiled
def _times(rows: Array, columns: Array, values: Array, X: Array, out: Array) -> None:
    """Put F X into `out`, F by its entries."""
    out[:] = 0.0
    for i in range(len(rows)):
        a = values[i]
        to, of = rows[i], columns[i]
        for j in range(X.shape[1]):
            out[to, j] += a * X[of, j]


@Compiled
def _congruence(rows: Array, columns: Array, values: Array, X: Array, half: Array, turned: Array, out: Array) -> None:
    """Put F X F^T into `out`, X symmetric."""
    _times(rows, columns, values, X, half)
    for i in range(X.shape[0]):
        for j in range(X.shape[0]):
            turned[i, j] = half[j, i]
    _times(rows, columns, values, turned, out)


@Compiled
def _inverse(S: Array, L: Array, out: Array) -> float:
    """Put the inverse of S into `out`; ln det S, infinite where S is not positive."""
    m, logdet = S.shape[0], 0.0
    for i in range(m):
        for j in range(i + 1):
            total = S[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i == j:
                if not total > 0.0:
                    return np.inf
                L[i, i] = np.sqrt(total)
                logdet += np.log(total)
            else:
                L[i, j] = total / L[j, j]
    for c in range(m):
        for i in range(m):
            total = 1.0 if i == c else 0.0
            for k in range(i):
                total -= L[i, k] * out[k, c]
            out[i, c] = total / L[i, i]
        for i in range(m - 1, -1, -1):
            total = out[i, c]
            for k in range(i + 1, m):
                total -= L[k, i] * out[k, c]
            out[i, c] = total / L[i, i]
    return logdet


@Compiled
def _dot(a: Array, b: Array) -> float:
    """Sum of products."""
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@Compiled
def _add_outer(left: Array, right: Array, factor: float, out: Array) -> None:
    """Add ``factor left' right`` to the lower triangle of `out`."""
    for i in range(out.shape[0]):
        for a in range(left.shape[0]):
            one = factor * left[a, i]
            for b in range(i + 1):
                out[i, b] += one * right[a, b]


@Compiled
def _mirror(lower: Array, out: Array) -> None:
    """Put the symmetric matrix of a lower triangle into `out`."""
    for i in range(len(out)):
        for b in range(i + 1):
            out[i, b] = lower[i, b]
            out[b, i] = lower[i, b]


@Compiled
def _ahead(
    rows: Array, columns: Array, values: Array, Gt: Array, C: Array, D: Array, E: Array, kind: Array, v: Array,
    R: Array, P: Array, gains: Array, inverses: Array, reads: Array,
) -> float:  # fmt: skip
    """Fill K', S^-1 and E P of every sample; sum of ln det S."""
    n, p, m, q = P.shape[0], Gt.shape[1], C.shape[1], E.shape[0]
    T, cross, fed, L, S = np.empty((m, n)), np.empty((m, n)), np.empty((p, n)), np.zeros((m, m)), np.empty((m, m))
    half, turned, moved = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    logdet = 0.0
    for k in range(len(kind)):
        j = kind[k]
        multiply(C[j], P, T)
        multiply_by_transposed(T, C[j], S)
        for a in range(m):
            for b in range(m):
                for c in range(p):
                    S[a, b] += D[j, a, c] * v[k, c] * D[j, b, c]
            S[a, a] += R[k, a]
        logdet += _inverse(S, L, inverses[k])
        cross[:] = 0.0
        for i in range(len(rows)):
            for a in range(m):
                cross[a, rows[i]] += values[j, i] * T[a, columns[i]]
        for c in range(p):
            for i in range(n):
                fed[c, i] = v[k, c] * Gt[j, c, i]
        for a in range(m):
            for c in range(p):
                for i in range(n):
                    cross[a, i] += D[j, a, c] * fed[c, i]
        multiply(inverses[k], cross, gains[k])
        if q > 0:
            multiply(E, P, reads[k])
        _congruence(rows, columns, values[j], P, half, turned, moved)
        _add_outer(fed, Gt[j], 1.0, moved)
        _add_outer(gains[k], cross, -1.0, moved)
        _mirror(moved, P)
    return logdet


@Compiled
def _means(
    rows: Array, columns: Array, values: Array, Gt: Array, C: Array, D: Array, E: Array, kind: Array, y: Array,
    v: Array, gains: Array, inverses: Array, reads: Array, e: Array, rho: Array, load: Array, r: Array,
) -> float:  # fmt: skip
    """Fill e, rho and loads of data y, and with r what pulls the start; sum of nu' S^-1 nu."""
    n, p, m, q = len(r), Gt.shape[1], C.shape[1], E.shape[0]
    x, moved, nu, squares = np.zeros(n), np.empty(n), np.empty(m), 0.0
    for k in range(len(kind)):
        j = kind[k]
        for a in range(m):
            nu[a] = y[k, a] - _dot(C[j, a], x)
        for c in range(q):
            load[k, c] = _dot(E[c], x)
        for a in range(m):
            e[k, a] = 0.0
            for b in range(m):
                e[k, a] += inverses[k, a, b] * nu[b]
            squares += nu[a] * e[k, a]
        moved[:] = 0.0
        for i in range(len(rows)):
            moved[rows[i]] += values[j, i] * x[columns[i]]
        x[:] = moved
        for a in range(m):
            for i in range(n):
                x[i] += gains[k, a, i] * nu[a]
    r[:] = 0.0
    for k in range(len(kind) - 1, -1, -1):
        j = kind[k]
        for a in range(m):
            e[k, a] -= _dot(gains[k, a], r)
        for c in range(p):
            rho[k, c] = _dot(Gt[j, c], r)
            for a in range(m):
                rho[k, c] += D[j, a, c] * e[k, a]
        moved[:] = 0.0
        for i in range(len(rows)):
            moved[columns[i]] += values[j, i] * r[rows[i]]
        r[:] = moved
        for a in range(m):
            for i in range(n):
                r[i] += C[j, a, i] * e[k, a]
        for c in range(p):
            own = v[k, c] * rho[k, c]
            load[k, c] = own if q == 0 else load[k, c] + own + _dot(reads[k, c], r)
    return squares


@Compiled
def _information(
    rows: Array, columns: Array, values: Array, Gt: Array, C: Array, D: Array, kind: Array, v: Array, gains: Array,
    inverses: Array, reads: Array, Q: Array, noise: Array, variance: Array, N: Array,
) -> None:  # fmt: skip
    """Fill the variances of rho and e, and those of the loads, begun with E P E', where asked for; N ends at the start."""
    n, p, m, q = len(N), Gt.shape[1], C.shape[1], reads.shape[1]
    W, NW, NK, U, Z = np.empty((p, n)), np.empty((p, n)), np.empty((m, n)), np.empty((m, n)), np.empty((m, m))
    half, turned, moved = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    cross, told, alone = np.empty(n), np.empty((1, n)), np.empty((m, p))
    asked = len(variance) > 0
    for k in range(len(kind) - 1, -1, -1):
        j, K = kind[k], gains[k]
        for c in range(p):
            for i in range(n):
                W[c, i] = Gt[j, c, i]
            for a in range(m):
                for i in range(n):
                    W[c, i] -= D[j, a, c] * K[a, i]
        multiply(W, N, NW)
        multiply(K, N, NK)
        multiply_by_transposed(NK, K, Z)
        Z += inverses[k]
        multiply(inverses[k], D[j], alone)
        for a in range(m):
            noise[k, a] = Z[a, a]
        for c in range(p):
            Q[k, c] = _dot(NW[c], W[c])
            for a in range(m):
                Q[k, c] += D[j, a, c] * alone[a, c]
        U[:] = 0.0
        for i in range(len(rows)):
            for a in range(m):
                U[a, columns[i]] -= values[j, i] * NK[a, rows[i]]
        for a in range(m):
            for b in range(m):
                for i in range(n):
                    U[a, i] += 0.5 * Z[b, a] * C[j, b, i]
        _congruence(columns, rows, values[j], N, half, turned, moved)
        _add_outer(U, C[j], 1.0, moved)
        _add_outer(C[j], U, 1.0, moved)
        _mirror(moved, N)
        for c in range(p if asked else 0):
            variance[k, c] += v[k, c] - v[k, c] * Q[k, c] * v[k, c]
            if q > 0:  # what state and input share, and what the data tell of the state
                cross[:] = 0.0
                for i in range(len(rows)):
                    cross[columns[i]] += values[j, i] * NW[c, rows[i]]
                for a in range(m):
                    one = alone[a, c] - _dot(K[a], NW[c])
                    for i in range(n):
                        cross[i] += one * C[j, a, i]
                multiply(reads[k, c : c + 1], N, told)
                variance[k, c] -= _dot(told[0], reads[k, c]) + 2.0 * v[k, c] * _dot(cross, reads[k, c])


@dataclass(frozen=True, eq=False)
class Variances:
    """What a fit believes before the data.

    Parameters
    ----------
    load : array, shape (samples, p)
        Of the white inputs.
    noise : array, shape (samples, m)
        Of the whitened data.
    start : array, shape (n, n)
        Covariance of the first state.
    """

    load: Array
    noise: Array
    start: Array


@dataclass(frozen=True, eq=False)
class Smoothed:
    """One pass with given variances: log likelihood, loads, and the two halves of the score of every variance.

    Parameters
    ----------
    evidence : float
        Log likelihood of the whitened data.
    load : array, shape (samples, p)
    rho, spread : array, shape (samples, p)
        ``d evidence / d v = (rho^2 - spread) / 2``.
    e, known : array, shape (samples, m)
        The same of the noise; the smoothed noise is ``R e``.
    pull, told : array, shapes (n,), (n, n)
        The same of the start.
    """

    evidence: float
    load: Array
    rho: Array
    spread: Array
    e: Array
    known: Array
    pull: Array
    told: Array


class Smoother:
    """The exact smoother of a record with given variances; other data cost one pass each.

    Parameters
    ----------
    record : WhitenedRecord
    given : Variances
    """

    def __init__(self, record: WhitenedRecord, given: Variances, loads: bool = True) -> None:
        self.record, self.given = record, given
        (rows, columns), values = record.entries
        n, m, samples = record.n, record.m, record.samples
        self._E = np.ascontiguousarray(record.E if loads and np.any(record.E) else record.E[:0])
        self._v = np.ascontiguousarray(given.load, float)
        self._gains, self._inverses = np.empty((samples, m, n)), np.empty((samples, m, m))
        self._reads = np.empty((samples, len(self._E), n))
        Gt = np.ascontiguousarray(np.swapaxes(record.G, 1, 2))
        self._system = rows, columns, values, Gt, np.ascontiguousarray(record.C), np.ascontiguousarray(record.D)
        self._logdet = _ahead(
            *self._system, self._E, record.kind, self._v, np.ascontiguousarray(given.noise, float),
            np.array(given.start, float), self._gains, self._inverses, self._reads,
        )  # fmt: skip

    def means(self, y: Array) -> tuple[float, Array, Array, Array, Array]:
        """``sum nu' S^-1 nu``, loads, rho, e and the pull on the start, of data (samples, m)."""
        r = self.record
        e, rho, load, pull = np.empty((r.samples, r.m)), np.empty(self._v.shape), np.empty(self._v.shape), np.empty(r.n)
        squares = _means(
            *self._system, self._E, r.kind, np.ascontiguousarray(y), self._v, self._gains, self._inverses,
            self._reads, e, rho, load, pull,
        )  # fmt: skip
        return float(squares), load, rho, e, pull

    def evidence(self, squares: float) -> float:
        """Log likelihood of data with this ``sum nu' S^-1 nu``."""
        return -0.5 * (self._logdet + squares + self.record.data * np.log(2 * np.pi))

    def information(self, variance: Array | None = None) -> tuple[Array, Array, Array]:
        """Variances of rho and e, and the information on the start; fills those of the loads where asked."""
        r = self.record
        spread, known, N = np.empty(self._v.shape), np.empty((r.samples, r.m)), np.zeros((r.n, r.n))
        if variance is not None:
            variance[:] = np.einsum("kci,ci->kc", self._reads, self._E) if len(self._E) else 0.0
        _information(
            *self._system, r.kind, self._v, self._gains, self._inverses, self._reads, spread, known,
            self._v[:0] if variance is None else variance, N,
        )  # fmt: skip
        return spread, known, N

    def smooth(self) -> Smoothed:
        """Everything that an update asks."""
        total, load, rho, e, pull = self.means(self.record.y)
        Q, known, N = self.information()
        return Smoothed(self.evidence(total), load, rho, Q, e, known, pull, N)

    @cached_property
    def variance(self) -> Array:
        """Of the loads (samples, p)."""
        out = np.empty(self._v.shape)
        self.information(out)
        return np.maximum(out, 0.0)


# -- the variances by evidence -----------------------------------------------------------------------------------------
HALF, STRIDE = 8, 4  # samples: half-width of a bump, distance of two
POWER = 0.8  # of the multiplicative update
MOST, GAIN = 60, 0.1  # updates; ln evidence of one below which it is the last
ENERGY = 16  # samples over which the energy of the response is averaged for what the model misses
LEAST = 1e-14  # of the largest variance that is kept


@dataclass(frozen=True, eq=False)
class LocalVariance:
    """A load whose variance changes with time, learned from the data.

    Parameters
    ----------
    v : array, shape (samples, p)
        Variance of the white inputs.
    noise : array, shape (m,)
        Variances of the noise of the whitened channels.
    misfit : float
        Error of the model, in parts of the response.
    length : float
        Memory of the load in samples, 0 if none.
    evidence, stationary : float
        Log likelihood with this prior and with the best of a constant variance, both without `misfit`.
    bumps : int
        Numbers that the prior has beyond the stationary one.
    updates : int
    smoother : Smoother
        With the final variances, on the final record.
    smoothed : Smoothed
    """

    v: Array
    noise: Array
    misfit: float
    length: float
    evidence: float
    stationary: float
    bumps: int
    updates: int
    smoother: Smoother
    smoothed: Smoothed

    @property
    def load(self) -> Array:
        """Mean (samples, p)."""
        return self.smoothed.load

    @property
    def variance(self) -> Array:
        """Of the loads (samples, p)."""
        return self.smoother.variance

    @property
    def participation(self) -> Array:
        """Share of the record over which the variance of each load is spread, (p,)."""
        total = self.v.sum(axis=0)
        return total**2 / (len(self.v) * np.maximum(np.sum(self.v**2, axis=0), np.finfo(float).tiny))

    @property
    def gain(self) -> float:
        """Gain of the log evidence over the stationary prior, for each bump."""
        return (self.evidence - self.stationary) / self.bumps


def with_memory(record: WhitenedRecord, length: float) -> WhitenedRecord:
    """Record of a load ``g_k = 2 a g_{k-1} - a^2 g_{k-2} + w_k``, ``a = exp(-sqrt(3) / length)``, Matern-3/2 sampled."""
    if not length:
        return record
    n, p, kinds = record.n, record.p, len(record.F)
    a = float(np.exp(-np.sqrt(3) / length))
    E = np.hstack([2 * a * np.eye(p), -(a**2) * np.eye(p)])
    low = np.vstack([E, np.eye(p, 2 * p)])
    F = np.zeros((kinds, n + 2 * p, n + 2 * p))
    F[:, :n, :n], F[:, :n, n:], F[:, n:, n:] = record.F, record.G @ E, low
    G = np.concatenate([record.G, np.broadcast_to(np.eye(2 * p, p), (kinds, 2 * p, p))], axis=1)
    C = np.concatenate([record.C, record.D @ E], axis=2)
    return replace(record, F=F, G=np.ascontiguousarray(G), C=np.ascontiguousarray(C),
                   E=np.hstack([np.zeros((p, n)), E]))  # fmt: skip


def bumps(samples: int, half: int = HALF, stride: int = STRIDE) -> Any:
    """Triangles (samples, count), sparse."""
    from scipy.sparse import csr_array

    centres = np.arange(0, samples + stride - 1, stride)
    offsets = np.arange(-half + 1, half)
    at = centres[None, :] + offsets[:, None]
    height = np.broadcast_to(1 - np.abs(offsets[:, None]) / half, at.shape)
    column = np.broadcast_to(np.arange(len(centres)), at.shape)
    inside = (at >= 0) & (at < samples)
    return csr_array((height[inside], (at[inside], column[inside])), shape=(samples, len(centres)))


class _Fit:
    """The numbers of the prior while they are learned."""

    def __init__(self, record: WhitenedRecord, stated: bool) -> None:
        self.record, self.stated = record, stated
        shown = np.any(record.C != 0, axis=2) | np.any(record.D != 0, axis=2)
        self.there = shown[record.kind]
        self.phi = bumps(record.samples)
        self.columns = np.ascontiguousarray(self.phi.sum(axis=0))
        self.a = np.zeros((self.phi.shape[1], record.p))
        self.b, self.r = np.ones(record.p), np.ones(record.m)
        self.eps2, self.power = 0.0, np.zeros((record.samples, record.m))
        self.p0 = np.zeros(record.n)
        self.passes, self.value = 0, -np.inf

    def variances(self) -> Variances:
        v = self.phi @ self.a + self.b
        noise = np.where(self.there, self.r + self.eps2 * self.power, 1.0)
        return Variances(v, noise, np.diag(self.p0))

    def pass_(self) -> Smoothed:
        return Smoother(self.record, self.variances(), loads=False).smooth()

    def update(self, s: Smoothed, power: float) -> None:
        rho2 = s.rho**2
        self.a *= _ratio(self.phi.T @ rho2, self.phi.T @ s.spread, power)
        self.b *= _ratio(rho2.sum(axis=0), s.spread.sum(axis=0), power)
        top = float((self.a.max(axis=0) + self.b).max())
        self.a[self.a < LEAST * top] = 0.0
        self.b = np.maximum(self.b, LEAST * top)
        e2, known = np.where(self.there, s.e**2, 0.0), np.where(self.there, s.known, 0.0)
        if self.eps2 > 0.0:
            self.eps2 *= float(_ratio(np.sum(self.power * e2), np.sum(self.power * known), power))
        if not self.stated:
            self.r *= _ratio(e2.sum(axis=0), known.sum(axis=0), power)
        self.p0 *= _ratio(s.pull**2, np.diag(s.told), power)

    def missed(self, s: Smoothed) -> None:
        """Energy of the response as it is now."""
        response = np.where(self.there, self.record.y - self.variances().noise * s.e, 0.0)
        window = np.ones(2 * ENERGY + 1) / (2 * ENERGY + 1)
        self.power = np.maximum(np.apply_along_axis(np.convolve, 0, response**2, window, "same"), 0.0)

    def climb(self, most: int, power: float = POWER, missing: bool = False, gain: float = GAIN) -> Smoothed:
        """Update until the evidence gains no more; what it was at the end."""
        best = -np.inf
        for step in range(most + 1):
            s = self.pass_()
            self.passes += 1
            if step == most or (s.evidence - best < gain and step > 2):
                break
            best = s.evidence
            if missing:
                self.missed(s)
            self.update(s, power)
        self.value = s.evidence
        return s


def _ratio(up: Any, down: Any, power: float) -> Any:
    return (np.maximum(up, 0.0) / np.maximum(down, np.finfo(float).tiny)) ** power


def _sizes(record: WhitenedRecord) -> tuple[Array, Array]:
    """Energy of the responses (m, p) to unit white loads, mean over the record, and its state covariance diagonal."""
    full = int(np.argmax(np.abs(record.C).sum(axis=(1, 2)) + np.abs(record.D).sum(axis=(1, 2))))
    F, C, D = record.F[full], record.C[full], record.D[full]
    out, diagonal = np.empty((record.m, record.p)), np.zeros(record.n)
    for j in range(record.p):
        g = record.G[full][:, j : j + 1]
        X, step, length = g @ g.T, F, 1
        while length < record.samples:
            X, step, length = X + step @ X @ step.T, step @ step, 2 * length
        out[:, j] = np.einsum("mi,ik,mk->m", C, X, C) + D[:, j] ** 2
        diagonal += np.diag(X)
    return out, diagonal


TRIED = 12  # updates after which lengths are compared


def _input(length: float) -> float:
    """Variance of the white input of a load of variance one."""
    a2 = float(np.exp(-2 * np.sqrt(3) / length)) if length else 0.0
    return (1 - a2) ** 3 / (1 + a2)


def _constant(record: WhitenedRecord, stated: bool, length: float) -> _Fit:
    """Best constant variances of a load with this memory, from two guesses of the noise."""
    whole = with_memory(record, length)
    sizes, states = _sizes(whole)
    best = None
    for share in (1.0,) if stated else (0.1, 1e-3):
        one = _Fit(whole, stated)
        power = np.sum(record.y**2, axis=0) / np.maximum(one.there.sum(axis=0), 1)
        one.b = np.maximum(np.mean(power[:, None] / np.maximum(sizes, 1e-300), axis=0) / record.p, 1e-300)
        one.p0[record.free] = states[record.free] * one.b.mean()
        one.r = np.ones(record.m) if stated else share * power
        one.climb(MOST, 1.0)
        best = one if best is None or one.value > best.value else best
    assert best is not None
    return best


def _moved(old: _Fit, record: WhitenedRecord, before: float, length: float) -> _Fit:
    """The same prior with another memory."""
    new = _Fit(with_memory(record, length), old.stated)
    part = _input(length) / _input(before)
    new.a, new.b, new.r, new.eps2 = old.a * part, old.b * part, old.r.copy(), old.eps2
    new.p0[: record.n] = old.p0[: record.n]
    return new


MEMORIES = (0.0, 2.0, 3.5, 6.0, 12.0, 30.0)  # samples; those beyond SHORT are asked of the stationary prior alone
SHORT = 3


def _searched(first: _Fit, record: WhitenedRecord, at: int, last: int, **how: Any) -> dict[int, _Fit]:
    """Fits of the memories from `at` on, downhill in both directions until the evidence falls."""
    fits = {at: first}
    for step in (-1, 1):
        i = at + step
        while 0 <= i <= last:
            before = fits[i - step]
            fits[i] = _moved(before, record, MEMORIES[i - step], MEMORIES[i])
            fits[i].climb(**how)
            if fits[i].value < before.value:
                break
            i += step
        if max(fits.values(), key=lambda one: one.value) is not first:
            break
    return fits


def fit(record: WhitenedRecord, *, stated: bool = False, misfit: bool = True, verbose: bool = False) -> LocalVariance:
    still = _searched(_constant(record, stated, MEMORIES[SHORT]), record, SHORT, len(MEMORIES) - 1, most=MOST, power=1.0)
    top = max(still, key=lambda i: still[i].value)
    at = min(top, SHORT)
    seed = _moved(still[at], record, MEMORIES[at], MEMORIES[at])
    seed.a[:], seed.b = 0.45 * seed.b, 0.1 * seed.b
    seed.climb(TRIED)
    local = _searched(seed, record, at, SHORT, most=TRIED)
    best = max(local, key=lambda i: local[i].value)
    chosen = local[best]
    s = chosen.climb(MOST)
    value, passes = chosen.value, [sum(f.passes for f in still.values()), sum(f.passes for f in local.values())]
    if misfit:
        chosen.eps2 = 1e-4
        chosen.missed(s)
        chosen.climb(MOST, missing=True)
    passes.append(sum(f.passes for f in local.values())-passes[-1])
    if verbose:
        print("  ",{MEMORIES[i]: round(still[i].value,1) for i in still},{MEMORIES[i]: round(local[i].value,1) for i in local},passes)
    smoother = Smoother(chosen.record, chosen.variances())
    out = LocalVariance(
        smoother.given.load, chosen.r, float(np.sqrt(chosen.eps2)), MEMORIES[best], value, still[top].value,
        chosen.a.size, sum(passes), smoother, smoother.smooth(),
    )  # fmt: skip
    sm = Smoother(still[top].record, still[top].variances())
    object.__setattr__(out, "stat", (still[top].value, MEMORIES[top], still[top], sm.smooth(), sm))
    return out
