"""Poly-reference least-squares complex frequency estimator: poles of FRFs at every order, and those that stay.

P. Guillaume, P. Verboven, S. Vanlanduit, H. Van der Auweraer, B. Peeters, "A poly-reference implementation of the
least-squares complex frequency-domain estimator", IMAC XXI (2003); B. Peeters, H. Van der Auweraer, P. Guillaume,
J. Leuridan, "The PolyMAX frequency-domain method", Shock and Vibration 11 (2004) 395-409.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

ROUND = 0.75  # share of the unit circle that the band takes: poles beyond its ends have room there
REFERENCES = 6  # more of them are compressed to so many before poles are looked for
ORDERS = 100  # poles of the highest order, where nobody says
STABLE_FREQUENCY, STABLE_DAMPING, STABLE_MAC = 0.01, 0.05, 0.95  # from one order to the next
NEAR = 0.5  # distance of two poles over the sum of their decay rates, up to which they may be one
DAMPED = 0.25  # damping ratio above which nothing is a mode of a structure
STAYS = 0.4  # share of the orders since it first came that a pole is found at ...
LASTS = 0.15  # ... and share of all orders that these are, at least
CALM = 0.5  # share of its poles that are stable in frequency
SAME = 0.25  # distance, as of `NEAR`, of two tracks that take turns and are one


@dataclass(frozen=True, eq=False)
class Stabilisation:
    """Poles of every order, and the tracks that they make.

    Parameters
    ----------
    order : int array (poles,)
        Order of the polynomial that has the pole.
    poles : array (poles,), complex
        In rad/s; those that decay, in the band and up to a sixth of it beyond its ends.
    participation : array (poles, references), complex
        Of unit norm.
    stable : int array (poles,)
        0 new, 1 its frequency stays within 1 % of one of the order before, 2 its damping within 5 % too, 3 its
        participation as well (MAC 0.95).
    track : int array (poles,)
        Which chosen pole it belongs to; -1 for none.
    unstable, outside : int
        Poles that grow, and poles of no positive frequency or damped beyond 25 %, over all orders: left out.
    """

    order: NDArray[np.int64]
    poles: Complex
    participation: Complex
    stable: NDArray[np.int64]
    track: NDArray[np.int64]
    unstable: int
    outside: int

    @property
    def frequencies(self) -> Real:
        """Natural frequencies (Hz) of all poles."""
        return np.asarray(np.abs(self.poles) / (2 * np.pi))

    @property
    def damping(self) -> Real:
        """Damping ratios of all poles."""
        return np.asarray(-self.poles.real / np.abs(self.poles))

    @property
    def chosen(self) -> tuple[Complex, Complex]:
        """Pole and participation of every track, the middle one of its members; ascending in frequency."""
        found = []
        for k in range(int(self.track.max(initial=-1)) + 1):
            own = np.flatnonzero(self.track == k)
            own = own[len(own) // 3 :]  # low orders are biased by what they have no poles for
            middle = _middle(self.poles[own])
            found.append((middle, self.participation[own[int(np.argmin(np.abs(self.poles[own] - middle)))]]))
        found.sort(key=lambda one: abs(one[0]))
        width = self.participation.shape[1]
        return np.array([p for p, _ in found], complex), np.array([v for _, v in found], complex).reshape(-1, width)


def compressed(H: Complex, w: Real, f: Real, order: int) -> tuple[Complex, float, float]:
    """Triangle whose leading blocks are the least-squares problems of the denominators of every order.

    Parameters
    ----------
    H : array (lines, outputs, references), complex
    w : array (lines, outputs)
        Weight of every row of the error.
    f : array (lines,)
        Hz.
    order : int
        Highest order.

    Returns
    -------
    R : array ((order + 1) references, (order + 1) references)
        Highest power first.
    centre, step : float
        ``z = exp(2 pi i (f - centre) step)``.

    Notes
    -----
    Right matrix fraction ``H_o A(z) = B_o(z)`` with complex coefficients, every output's numerator eliminated by QR
    and never squared; one triangle is kept from output to output. Numerators have the highest order at all orders, so
    that the blocks nest.
    """
    width = max(float(f[-1] - f[0]), np.finfo(float).tiny)
    centre, step = float(f[0] + f[-1]) / 2, ROUND / width
    powers = np.exp(2j * np.pi * np.outer((f - centre) * step, np.arange(order, -1, -1)))
    size = (order + 1) * H.shape[2]
    R = np.zeros((0, size), complex)
    for o in range(H.shape[1]):
        rows = w[:, o, None] * powers
        Q = linalg.qr(rows, mode="economic")[0]
        Y = (rows[:, :, None] * H[:, o, None, :]).reshape(len(f), size)
        Y -= Q @ (Q.conj().T @ Y)
        R = linalg.qr(np.vstack([R, Y]), mode="r")[0][:size]
    full = np.zeros((size, size), complex)
    full[: len(R)] = R
    return full, centre, step


def poles_at(R: Complex, order: int, references: int, centre: float, step: float) -> tuple[Complex, Complex]:
    """Poles (rad/s) of one order, and their participation (poles, references), of unit norm.

    The lowest coefficient is the unit matrix: poles that the data do not ask for then grow with time.
    """
    n = order * references
    A = linalg.lstsq(R[: n + references, :n], -R[: n + references, n : n + references], lapack_driver="gelsy")[0]
    # A_k z^k + ... + A_1 z + 1, transposed: eigenvectors are the left null vectors, as a reversed companion in 1/z
    companion = np.zeros((n, n), complex)
    blocks = A.reshape(order, references, references)[::-1]  # A_1 ... A_k
    companion[:references] = np.concatenate([-b.T for b in blocks], axis=1)
    companion[references:, :-references] = np.eye(n - references)
    values, vectors = linalg.eig(companion)
    kept = np.abs(values) > 1e-9
    values, v = values[kept], vectors[:references, kept]
    # the block that is largest: a leading one of a small power is rounding
    if order > 1:
        last = vectors[-references:, kept]
        larger = np.linalg.norm(last, axis=0) > np.linalg.norm(v, axis=0)
        v = np.where(larger, last, v)
    poles = np.log(1 / values) / step + 2j * np.pi * centre
    size = np.linalg.norm(v, axis=0)
    return poles, (v / np.where(size > 0, size, 1.0)).T


def stabilisation(H: Complex, w: Real, f: Real, order: int) -> Stabilisation:
    """Poles of all orders up to one, each held against the order before, and tracked from order to order.

    Parameters
    ----------
    H, w, f, order
        As for `compressed`.

    Notes
    -----
    A track takes at each order the pole nearest to its last one, within half the sum of their decay rates, and each
    pole goes to one track. A track is chosen that is found at 40 % of the orders since it began, at 15 % of all orders,
    and stable in frequency at half of its own. That lets poles of noise through: the fit of the modes
    (`structures._testing.modalfit`) drops those that explain nothing.
    """
    references = H.shape[2]
    R, centre, step = compressed(H, w, f, order)
    found: list[tuple[int, Complex, Complex]] = []
    unstable = outside = 0
    for n in range(1, order + 1):
        poles, v = poles_at(R, n, references, centre, step)
        decays = poles.real < 0
        inside = (poles.imag > 0) & (-poles.real <= DAMPED * np.abs(poles))
        unstable += int(np.sum(~decays))
        outside += int(np.sum(decays & ~inside))
        rank = np.argsort(poles.imag)
        rank = rank[(decays & inside)[rank]]
        found.append((n, poles[rank], v[rank]))
    orders = np.concatenate([np.full(len(p), n) for n, p, _ in found])
    poles, v = np.concatenate([p for _, p, _ in found]), np.concatenate([v for *_, v in found])
    stable = np.concatenate([_stable(*found[max(i - 1, 0)][1:], *found[i][1:], i) for i in range(order)])
    return Stabilisation(orders, poles, v, stable, _tracks(orders, poles, v, stable, order), unstable, outside)


def _stable(before: Complex, old: Complex, poles: Complex, v: Complex, i: int) -> NDArray[np.int64]:
    """How far each pole is that of the order before: 0 to 3."""
    out = np.zeros(len(poles), int)
    if i == 0 or not len(before):
        return out
    for k, p in enumerate(poles):
        j = int(np.argmin(np.abs(before - p)))
        q = before[j]
        if abs(abs(q) - abs(p)) > STABLE_FREQUENCY * abs(p):
            continue
        out[k] = 1
        if abs(q.real / abs(q) - p.real / abs(p)) > STABLE_DAMPING * abs(p.real / abs(p)):
            continue
        out[k] = 2 + (abs(np.vdot(old[j], v[k])) ** 2 >= STABLE_MAC)
    return out


def _tracks(
    orders: NDArray[np.int64], poles: Complex, v: Complex, stable: NDArray[np.int64], order: int
) -> NDArray[np.int64]:
    """Track of every pole, -1 where its track is not chosen; tracks are numbered by frequency."""
    from scipy.optimize import linear_sum_assignment

    tracks: list[list[int]] = []
    for n in range(1, order + 1):
        own = np.flatnonzero(orders == n)
        taken: set[int] = set()
        if tracks and len(own):
            last = np.array([t[-1] for t in tracks])
            p, q = poles[last][:, None], poles[own][None, :]
            cost = np.abs(p - q) / (np.abs(p.real) + np.abs(q.real))
            cost = cost + 0.5 * (1 - np.abs(v[last].conj() @ v[own].T) ** 2)
            for a, b in zip(*linear_sum_assignment(np.minimum(cost, 1e3)), strict=True):
                if cost[a, b] < NEAR:
                    tracks[a].append(int(own[b]))
                    taken.add(int(own[b]))
        tracks += [[int(k)] for k in own if int(k) not in taken]
    kept = []
    for t in _merged(tracks, orders, poles):
        since = order + 1 - orders[t[0]]
        lasting = len(t) >= STAYS * since and len(t) >= max(3.0, LASTS * order)
        if lasting and np.mean(stable[t] >= 1) >= CALM:
            kept.append(t)
    kept.sort(key=lambda t: float(np.median(poles[t].imag)))
    out = np.full(len(poles), -1)
    for k, t in enumerate(kept):
        out[t] = k
    return out


def _merged(tracks: list[list[int]], orders: NDArray[np.int64], poles: Complex) -> list[list[int]]:
    """Tracks, those that lie together and take turns joined."""
    out: list[list[int]] = []
    middles: list[complex] = []
    for t in sorted(tracks, key=len, reverse=True):
        p = _middle(poles[t])
        for k, (other, q) in enumerate(zip(out, middles, strict=True)):
            if abs(p - q) >= SAME * (abs(p.real) + abs(q.real)):
                continue
            had = set(orders[other].tolist())
            if len(had.intersection(orders[t].tolist())) < 0.5 * len(t):
                other.extend(one for one in t if int(orders[one]) not in had)
                other.sort(key=lambda one: int(orders[one]))
                middles[k] = _middle(poles[other])
                break
        else:
            out.append(list(t))
            middles.append(p)
    return out


def _middle(poles: Complex) -> complex:
    return complex(np.median(poles.real), np.median(poles.imag))
