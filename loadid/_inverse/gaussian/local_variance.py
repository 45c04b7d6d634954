"""Loads with a variance of their own at every sample: what an impact is, and no stationary prior can say.

    xi_{k+1} = F xi_k + G w_k,   y_k = C xi_k + D w_k + e_k,   g_k = E xi_k + w_k,   w_jk ~ N(0, v_jk)

For given variances this is the record of `record.WhitenedRecord` under another prior: one covariance recursion forward,
one backward pass, exact, gaps and unknown starts included. With ``e = S^-1 nu - K' r`` and ``r_ = C' e + F' r`` (the
disturbance smoother of P. de Jong, Biometrika 76 (1989) 85) the score of every variance is a by-product:

    d ll / d v_jk = (rho^2 - Q) / 2,   rho = D' e + G' r,   Q = diag [D' S^-1 D + (G - K D)' N (G - K D)]

and those of the noise and of the start likewise. `loadid._inverse.local_prior` learns the variances by it. Rows of K',
T' and G' lie together in memory, so that every inner loop is a sum of rows; F goes by its entries, few in modal form.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from .compiled import Compiled, dot, multiply, multiply_by_transposed
from .gains import gains
from .passes import solve
from .posterior import columns
from .record import WhitenedRecord
from .roots import Array


@Compiled
def _times(rows: Array, columns: Array, values: Array, X: Array, out: Array) -> None:
    """Put F X into `out`, F by its entries: those of a row that follow each other are taken together, up to four."""
    out[:] = 0.0
    i, count, n = 0, len(rows), X.shape[1]
    while i < count:
        to, alike = rows[i], 1
        while alike < 4 and i + alike < count and rows[i + alike] == to:
            alike += 1
        if alike == 4:
            a, b, c, d = values[i], values[i + 1], values[i + 2], values[i + 3]
            p, q, r, s = columns[i], columns[i + 1], columns[i + 2], columns[i + 3]
            for j in range(n):
                out[to, j] += (a * X[p, j] + b * X[q, j]) + (c * X[r, j] + d * X[s, j])
        elif alike >= 2:
            a, b, p, q, alike = values[i], values[i + 1], columns[i], columns[i + 1], 2
            for j in range(n):
                out[to, j] += a * X[p, j] + b * X[q, j]
        else:
            a, p = values[i], columns[i]
            for j in range(n):
                out[to, j] += a * X[p, j]
        i += alike


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
        for a in range(m):
            for i in range(len(rows)):
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
            nu[a] = y[k, a] - dot(C[j, a], x)
        for c in range(q):
            load[k, c] = dot(E[c], x)
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
            e[k, a] -= dot(gains[k, a], r)
        for c in range(p):
            rho[k, c] = dot(Gt[j, c], r)
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
            load[k, c] = own if q == 0 else load[k, c] + own + dot(reads[k, c], r)
    return squares


@Compiled
def _information(
    rows: Array, columns: Array, values: Array, Gt: Array, C: Array, D: Array, kind: Array, v: Array, gains: Array,
    inverses: Array, reads: Array, Q: Array, noise: Array, variance: Array, N: Array,
) -> None:  # fmt: skip
    """Fill variances of rho, e and, begun with E P E', of the loads where asked for; N ends as that of the start."""
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
            Q[k, c] = dot(NW[c], W[c])
            for a in range(m):
                Q[k, c] += D[j, a, c] * alone[a, c]
        U[:] = 0.0
        for a in range(m):
            for i in range(len(rows)):
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
                    one = alone[a, c] - dot(K[a], NW[c])
                    for i in range(n):
                        cross[i] += one * C[j, a, i]
                multiply(reads[k, c : c + 1], N, told)
                variance[k, c] -= dot(told[0], reads[k, c]) + 2.0 * v[k, c] * dot(cross, reads[k, c])


@Compiled
def _prior_of(
    F: Array, G: Array, C: Array, D: Array, E: Array, kind: Array, v: Array, start: Array, w: Array, load: Array,
    response: Array,
) -> None:  # fmt: skip
    """Fill prior covariance times weights w: of the loads, and of the responses with them."""
    n, p, m = F.shape[1], G.shape[2], C.shape[1]
    r, moved, u = np.zeros(n), np.empty(n), np.empty((len(kind), p))
    for k in range(len(kind) - 1, -1, -1):
        j = kind[k]
        for c in range(p):
            u[k, c] = w[k, c]
            for i in range(n):
                u[k, c] += G[j, i, c] * r[i]
            u[k, c] *= v[k, c]
        moved[:] = 0.0
        for i in range(n):
            for b in range(n):
                moved[b] += F[j, i, b] * r[i]
            for c in range(p):
                moved[i] += E[c, i] * w[k, c]
        r[:] = moved
    moved[:] = 0.0
    for i in range(n):
        moved[i] = dot(start[i], r)
    r[:] = moved
    for k in range(len(kind)):
        j = kind[k]
        for c in range(p):
            load[k, c] = u[k, c] + dot(E[c], r)
        for a in range(m):
            response[k, a] = dot(C[j, a], r) + dot(D[j, a], u[k])
        for i in range(n):
            moved[i] = dot(F[j, i], r) + dot(G[j, i], u[k])
        r[:] = moved


@dataclass(frozen=True, eq=False)
class Variances:
    """What is believed before the data.

    Parameters
    ----------
    load : array, shape (samples, p)
        Of the white inputs w.
    noise : array, shape (samples, m)
        Of the whitened data; 1 where nothing was measured.
    start : array, shape (n, n)
        Covariance of the first state.
    """

    load: Array
    noise: Array
    start: Array


@dataclass(frozen=True, eq=False)
class SmootherPass:
    """One pass with given variances: log likelihood, loads, and the two halves of the score of every variance.

    Parameters
    ----------
    evidence : float
        Log likelihood of the whitened data.
    load : array, shape (samples, p)
    rho : array, shape (samples, p)
        ``d evidence / d v = (rho^2 - rho_variance) / 2``.
    e : array, shape (samples, m)
        The same of the noise; the smoothed noise is its variance times e.
    start : array, shape (n,)
        The same of the first state.
    information : callable
        Gives `rho_variance` (samples, p), `e_variance` (samples, m) and `start_information` (n, n), when they are
        asked for.
    """

    evidence: float
    load: Array
    rho: Array
    e: Array
    start: Array
    information: Callable[[], tuple[Array, Array, Array]]

    @cached_property
    def _told(self) -> tuple[Array, Array, Array]:
        return self.information()

    @property
    def rho_variance(self) -> Array:
        """Of rho, (samples, p)."""
        return self._told[0]

    @property
    def e_variance(self) -> Array:
        """Of e, (samples, m)."""
        return self._told[1]

    @property
    def start_information(self) -> Array:
        """Of the first state, (n, n)."""
        return self._told[2]


def smoothed(record: WhitenedRecord, given: Variances) -> SmootherPass:
    """One pass for the score of the variances, its loads without a memory of theirs.

    Where nothing changes with time it is that of a least-squares problem (`gains`), a small part of the work.
    """
    still = not given.start.any() and not any(np.ptp(x, axis=0).any() for x in (given.load, given.noise, record.kind))
    if still and 2 * record.m + record.p < record.n and record.samples > 1:
        return _stationary(record, given.load[0], given.noise[0])
    return Smoother(record, given, loads=False).smooth()


def _stationary(record: WhitenedRecord, v: Array, r: Array) -> SmootherPass:
    """With variances v (p,) of the inputs and r (m,) of the noise, from rest."""
    s, q = np.sqrt(v), 1 / np.sqrt(r)
    unit = replace(
        record, G=record.G * s, C=record.C * q[:, None], D=q[:, None] * record.D * s, E=np.zeros_like(record.E),
        y=record.y * q, free=record.free[:0],
    )  # fmt: skip
    held = gains(unit, 1.0)
    solved = solve(unit, held)
    rest = unit.y - solved.response
    shown = np.any(record.C[record.kind[0]] != 0, axis=1) | np.any(record.D[record.kind[0]] != 0, axis=1)
    logdet = held.logdet + record.samples * float(np.sum(np.log(r[shown])))
    squares = float(np.sum(rest**2) + np.sum(solved.inputs**2))

    def information() -> tuple[Array, Array, Array]:
        """What the data tell: unit variances less those that are left."""
        of_inputs, of_response = np.ones((record.samples, record.p)), np.ones((record.samples, record.m))
        for inputs, _, response, _ in columns(unit, held):
            of_inputs[-len(inputs) :] -= np.cumsum(inputs**2, axis=0)
            of_response[-len(inputs) :] -= np.cumsum(response**2, axis=0)
        return of_inputs / v, of_response * q**2, np.zeros((record.n, record.n))

    return SmootherPass(
        -0.5 * (logdet + squares + record.data * np.log(2 * np.pi)), solved.inputs * s, solved.inputs / s, rest * q,
        np.zeros(record.n), information,
    )  # fmt: skip


class Smoother:
    """The exact smoother of a record with given variances: one covariance pass, then two passes for any data.

    Parameters
    ----------
    record : WhitenedRecord
    given : Variances
    loads : bool
        Whether loads with a memory are asked for, and not only the score.
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
        """``sum nu' S^-1 nu``, loads, rho, e, and r of the first state, of whitened data (samples, m)."""
        r = self.record
        e, rho, load, first = (
            np.empty((r.samples, r.m)),
            np.empty(self._v.shape),
            np.empty(self._v.shape),
            np.empty(r.n),
        )
        squares = _means(
            *self._system, self._E, r.kind, np.ascontiguousarray(y), self._v, self._gains, self._inverses,
            self._reads, e, rho, load, first,
        )  # fmt: skip
        return float(squares), load, rho, e, first

    def smooth(self) -> SmootherPass:
        """Everything that an update of the variances asks."""
        squares, load, rho, e, first = self.means(self.record.y)
        evidence = -0.5 * (self._logdet + squares + self.record.data * np.log(2 * np.pi))
        return SmootherPass(evidence, load, rho, e, first, partial(self._information, self._v[:0]))

    @cached_property
    def _known(self) -> tuple[Array, Array]:
        out = np.einsum("kci,ci->kc", self._reads, self._E) if len(self._E) else np.zeros(self._v.shape)
        rho = self._information(out)[0]
        return np.maximum(out, 0.0), rho

    @property
    def variance(self) -> Array:
        """Of the loads (samples, p)."""
        return self._known[0]

    @property
    def rho_variance(self) -> Array:
        """Of rho (samples, p)."""
        return self._known[1]

    def covariance_times(self, w: Array) -> Array:
        """Posterior covariance of the loads times weights (samples, p)."""
        r = self.record
        load, response = np.empty(self._v.shape), np.empty((r.samples, r.m))
        _prior_of(
            r.F, r.G, r.C, r.D, np.ascontiguousarray(r.E), r.kind, self._v, np.ascontiguousarray(self.given.start),
            np.ascontiguousarray(w, float), load, response,
        )  # fmt: skip
        return load - self.means(response)[1]

    def _information(self, variance: Array) -> tuple[Array, Array, Array]:
        """Variances of rho and e, and the information on the first state; adds to those of the loads where asked."""
        r, (rows, columns, values, *rest) = self.record, self._system
        by_column = np.argsort(columns, kind="stable")
        system = rows[by_column], columns[by_column], np.ascontiguousarray(values[:, by_column]), *rest
        rho, e, N = np.empty(self._v.shape), np.empty((r.samples, r.m)), np.zeros((r.n, r.n))
        _information(
            *system, r.kind, self._v, self._gains, self._inverses, self._reads, rho, e, variance, N
        )  # fmt: skip
        return rho, e, N
