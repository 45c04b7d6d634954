"""Sensors that contradict the others: every sensor predicted from the rest, exactly, and what is wrong with it.

Whitened data of lines (one line of a static problem, many of a spectrum) are ``y = H g + n``. The precision of the
data once the loads are integrated out, ``K = W Z (1 + tau E)^-1 Z^H W``, holds every leave-one-out residual: that of
sensor i is ``(K y)_i / K_ii`` with variance ``1 / K_ii`` (Cook & Weisberg, Residuals and Influence in Regression,
1982). One factorisation gives them all, and without a prior what is left when one is dropped, or two are exchanged.

A model is wrong by some per cent, always, and a wrong gain is wrong by as much on every line. So the variance of a
sensor is that of its noise and ``delta^2`` of its response, and what stands for the error of the model is counted as
one value, not as many as there are lines. `delta` is a floor: the misfit of the others raises it where they show more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Real = NDArray[np.float64]

FLOOR = 0.03  # relative error that every model is taken to have
BELIEF = 4.0  # values that this floor is worth beside those of the spare sensors
LEVEL = 0.002  # chance that a sound record accuses a sensor, over all sensors
SCREEN = 0.5  # of the limit, from which a closer look is taken
LOST = 200.0  # times the variance that is expected, from which no error of a model in use explains it: some 40 %
CLEARLY = 2.0  # times that variance, from which a closer look is taken
MARGIN = 0.4  # of the limit, by which the best explanation leaves less than the next
MOST = 24  # sensors beyond which swaps are not tried
TINY = 1e-12  # gain of a sensor that reads nothing
SEEN = 1e-9  # of the precision of a sensor alone: below, the others say nothing about it
FIRM = 1e-6  # of the precision of two sensors alone: below, their exchange is solved anew


@dataclass(frozen=True, eq=False)
class SensorLines:
    """What sensors read, and what each load makes them read.

    Parameters
    ----------
    H : array, shape (lines, sensors, loads)
    y : array, shape (lines, sensors, snapshots)
    noise : array, shape (lines, sensors)
        Variance of the noise of y; where it is not known, of the same shape over the sensors.
    size : array, shape (lines, sensors)
        Variance of y that errors of the model are measured by.
    known : bool
        The noise is known.
    worth : float
        Independent real values of one snapshot of one line.
    spread : array, shape (loads, loads), optional
        Covariance of the loads up to a factor; None: any load is as likely as any other.
    free : array, shape (loads, k), optional
        Loads that the prior does not hold, beside `spread`.
    """

    H: Array
    y: Array
    noise: Real
    size: Real
    known: bool
    worth: float
    spread: Real | None = None
    free: Real | None = None

    @property
    def sensors(self) -> int:
        """Number of them."""
        return int(self.y.shape[1])

    @property
    def spare(self) -> int:
        """Sensors beyond what fixes the loads without any prior."""
        held = self.H.shape[2] if self.spread is None else 0 if self.free is None else self.free.shape[1]
        return self.sensors - held

    def of(self, keep: Sequence[int]) -> SensorLines:
        """The lines of some sensors."""
        k = list(keep)
        return replace(self, H=self.H[:, k], y=self.y[:, k], noise=self.noise[:, k], size=self.size[:, k])

    def on(self, pick: NDArray[np.bool_]) -> SensorLines:
        """Some of the lines."""
        return replace(self, H=self.H[pick], y=self.y[pick], noise=self.noise[pick], size=self.size[pick])

    def swapped(self, i: int, j: int) -> SensorLines:
        """As if the plugs of two sensors were exchanged: channels stay as they are, and read the other's place."""
        order = list(range(self.sensors))
        order[i], order[j] = j, i
        return replace(self, H=self.H[:, order])


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Every sensor beside its prediction from all others.

    Parameters
    ----------
    rest : array, shape (lines, sensors, snapshots)
        Reading less prediction.
    precision : array, shape (lines, sensors)
        Inverse variance of `rest`; 0 where the others say nothing.
    misfit : float
        Of all sensors together, whitened.
    scale : float
        Factor on the variance that the misfit shows, on all lines or on those where errors of the model count.
    limit : array, shape (sensors,)
        Misfit of each sensor that chance and errors of the model leave, where the variance is as stated.
    excess : array, shape (sensors,)
        Misfit of each over that limit, at the variance that the others show; beyond 1 a sensor stands out.
    tau : float
        Variance of the loads over that of their prior.
    cost : float
        -2 log evidence of the readings under that prior; 0 without one.
    K : array, shape (lines, sensors, sensors)
        Precision of the readings with the loads integrated out.
    dims : int
        Its rank.
    silent : array, shape (sensors,)
        Misfit over its limit that each would have if it read nothing where the others predict what they do: below 1
        they do not determine it, and hardly anything that is wrong with it can be seen.
    """

    rest: Array
    precision: Real
    misfit: float
    scale: float
    limit: Real
    excess: Real
    tau: float
    cost: float
    K: Array
    dims: int
    silent: Real


def left_out(lines: SensorLines, delta: float, tau: float | None = None) -> LeftOut:
    """Predict every sensor from all others, where errors of the model are `delta` of the response.

    Parameters
    ----------
    tau : float, optional
        Variance of the loads over that of their prior; default the likeliest.
    """
    return _predicted(lines, delta, *_precision(lines, lines.noise + delta**2 * lines.size, tau))


def _predicted(lines: SensorLines, delta: float, K: Array, dims: int, tau: float, cost: float) -> LeftOut:
    """Every sensor from all others, with the precision of the readings, its rank, and what it was chosen by."""
    variance = lines.noise + delta**2 * lines.size
    diagonal = np.einsum("kii->ki", K).real
    told = diagonal * variance > SEEN
    precision = np.where(told, diagonal, 0.0)
    Ky = K @ lines.y
    rest = np.divide(Ky, diagonal[..., None], out=np.zeros(Ky.shape, Ky.dtype),
                     where=np.broadcast_to(told[..., None], Ky.shape))  # fmt: skip
    errors, weights = delta**2 * lines.size, np.abs(K) ** 2
    # share of the variance of a prediction that is error of the model, not noise
    share = np.einsum("kij,kj->ki", weights, errors) / np.maximum(np.einsum("kij,kj->ki", weights, variance), 1e-300)
    per_line = lines.worth * lines.y.shape[2]
    own = lines.worth * precision * np.sum(np.abs(rest) ** 2, axis=2)
    whole = lines.worth * np.sum((lines.y.conj() * Ky).real, axis=(1, 2))
    count, misfit = per_line * np.sum(told, axis=0), own.sum(axis=0)
    wrong = np.minimum(per_line * np.sum(np.where(told, share, 0.0), axis=0), count)
    left = np.maximum(per_line * len(K) * dims - count, 0.0)
    limit = _limit(count, left, wrong, dims, lines.sensors)
    others = np.maximum(whole[:, None] - own, 0.0)
    scale = _scale(others, per_line * (dims - told), share, lines.known)
    excess = np.divide(misfit, scale * limit, out=np.zeros(len(misfit)), where=limit > 0)
    mean = np.mean(share, axis=1, keepdims=True)
    total = float(_scale(whole[:, None], np.full((len(K), 1), per_line * dims), mean, lines.known)[0])
    due = lines.worth * np.sum(precision * np.sum(np.abs(lines.y - rest) ** 2, axis=2), axis=0)
    silent = np.divide(due, limit, out=np.zeros(len(due)), where=limit > 0)
    return LeftOut(rest, precision, max(float(whole.sum()), 0.0), total, limit, excess, tau, cost,
                   K, dims, silent)  # fmt: skip


def _scale(misfit: Real, freedom: Real, share: Real, known: bool) -> Real:
    """Factor on the variance that misfits (lines, k) show: on all lines, or more where errors of the model count."""
    found = [(BELIEF + np.sum(w * misfit, axis=0)) / (BELIEF + np.sum(w * freedom, axis=0)) for w in (1.0, share)]
    return np.asarray(np.maximum(*found) if not known else np.maximum(np.maximum(*found), 1.0))


def _limit(count: Real, freedom: Real, wrong: Real, dims: int, sensors: int) -> Real:
    """Misfit of one sensor that chance exceeds once in `LEVEL`: of `count` values of noise, or of one model error.

    An error of the model shared by all values weighs as many as it fills, with the chance of one.
    """
    from scipy.special import fdtri

    level = 1 - LEVEL / sensors
    noise = count * fdtri(np.maximum(count, 1.0), freedom + BELIEF, level)
    one = _limit_of_one(sensors, dims)
    return np.asarray(np.where(count > 0, np.maximum(noise, count - wrong + one * wrong), 0.0))


def _limit_of_one(hypotheses: int, dims: int) -> float:
    """Square of one error of the model, over its expectation, that one of so many hypotheses exceeds by chance."""
    from scipy.special import fdtri

    return float(fdtri(1.0, BELIEF + max(dims - 1, 0), 1 - LEVEL / hypotheses))


def unlikely(lines: SensorLines, gain: float) -> bool:
    """Whether a gain is further from one than that of a sound model is by chance once in `LEVEL`, over all sensors."""
    from scipy.special import ndtri

    reach = -FLOOR * ndtri(0.5 * LEVEL / lines.sensors)
    return bool(abs(gain) < TINY or abs(np.log(abs(gain))) > reach)


def _precision(lines: SensorLines, variance: Real, tau: float | None) -> tuple[Array, int, float, float]:
    """Precision K of the data with the loads integrated out, (lines, sensors, sensors), its rank, tau, and the cost."""
    W = 1 / np.sqrt(variance)
    H = W[..., None] * lines.H
    flat = H if lines.spread is None else H @ (np.zeros((H.shape[2], 0)) if lines.free is None else lines.free)
    held = flat.shape[2]
    m = lines.sensors
    if held >= m:
        return np.zeros((len(H), m, m), H.dtype), 0, 0.0, 0.0
    Z = np.linalg.qr(flat, mode="complete")[0][..., held:] if held else np.broadcast_to(np.eye(m), (len(H), m, m))
    if lines.spread is None:
        P, tau, cost = Z @ Z.conj().swapaxes(1, 2), 0.0, 0.0
    else:
        one, tau, cost = _under_prior(Z[0], H[0], W[0, :, None] * lines.y[0], lines.spread, lines.known, tau)
        P = one[None]
    return W[..., None] * P * W[:, None], m - held, tau, cost


def _under_prior(
    Z: Real, H: Real, y: Real, spread: Real, known: bool, at: float | None
) -> tuple[NDArray[np.float64], float, float]:
    """Precision of whitened readings (sensors, frames), at the size of the loads that makes them likeliest."""
    M = Z.T @ H
    e, V = np.linalg.eigh(M @ spread @ M.T)
    e, z2 = np.maximum(e, 0.0), np.sum((V.T @ Z.T @ y) ** 2, axis=1)
    frames, top = y.shape[1], max(float(e.max(initial=0.0)), 1e-300)
    tau = np.concatenate([[0.0], np.geomspace(1e-3, 1e9, 73)]) / top if at is None else np.array([at])
    v = 1 + tau[:, None] * e
    chi2, logs = np.sum(z2 / v, axis=1), frames * np.sum(np.log(v), axis=1)
    cost = (chi2 if known else (BELIEF + frames * len(e)) * np.log(BELIEF + chi2)) + logs
    k = int(np.argmin(cost))
    return np.asarray(Z @ (V / v[k]) @ V.T @ Z.T), float(tau[k]), float(cost[k])


# -- who it is ---------------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Suspicion:
    """What explains readings that contradict each other.

    Parameters
    ----------
    sensors : tuple of int
        One that is wrong, two that are exchanged; several where one of them is, and the data cannot say which; none
        where no single sensor explains it.
    swap : bool
    excess : float
        By how much the sensors contradict each other, over the limit.
    without : float
        The same with the explanation; below 1.
    other : float
        The same with the next best explanation.
    delta : float
        Relative error of the model that this takes for given.
    scale : float
        Factor on the variance that the rest shows.
    found : LeftOut or None
        Of all sensors, where one is wrong.
    """

    sensors: tuple[int, ...]
    swap: bool
    excess: float
    without: float
    other: float
    delta: float
    scale: float = 1.0
    found: LeftOut | None = None


@dataclass(frozen=True, eq=False)
class Explanation:
    """One hypothesis: these sensors are wrong, or exchanged; what it leaves of the misfit.

    Parameters
    ----------
    sensors : tuple of int
    swap : bool
    all_lines : SensorLines
        Those that were read.
    delta : float
        Relative error of the model.
    known_misfit : float, optional
        What it leaves, whitened.
    precision : tuple, optional
        Of the lines that it believes, where it is known: see `_precision`.
    """

    sensors: tuple[int, ...]
    swap: bool
    all_lines: SensorLines
    delta: float
    known_misfit: float | None = None
    precision: tuple[Array, int, float, float] | None = None

    @cached_property
    def lines(self) -> SensorLines:
        """The lines that it believes."""
        if self.swap:
            return self.all_lines.swapped(*self.sensors)
        return self.all_lines.of([k for k in range(self.all_lines.sensors) if k not in self.sensors])

    @cached_property
    def left(self) -> LeftOut:
        """What it leaves of every sensor: solved only where its misfit is one that counts."""
        known = self.precision
        return left_out(self.lines, self.delta) if known is None else _predicted(self.lines, self.delta, *known)

    @property
    def misfit(self) -> float:
        """What it leaves, whitened."""
        return self.left.misfit if self.known_misfit is None else self.known_misfit

    def over(self, misfit: float, limit: float) -> float:
        """How much more than this leaves a misfit is, over what chance makes of it."""
        return (misfit - self.misfit) / (self.left.scale * limit) if limit > 0 else 0.0

    @property
    def unfit(self) -> float:
        """Below 1 where none of the sensors that are left stands out."""
        return float(self.left.excess.max())


def prepared(lines: SensorLines) -> SensorLines | None:
    """The lines with the level of their noise, if there is a sensor to spare."""
    if lines.spare < 1 or lines.sensors < 3 or (not lines.known and lines.spare < 2):
        return None
    return lines if lines.known or len(lines.y) == 1 else _with_noise(lines)


def suspect(lines: SensorLines, whole: LeftOut | None = None) -> Suspicion | None:
    """Who is wrong of `prepared` lines; None where all sensors agree within noise and errors of the model."""
    whole = left_out(lines, FLOOR) if whole is None else whole
    if whole.excess.max() <= SCREEN and whole.scale <= CLEARLY:
        return None
    return _weighed(lines, FLOOR, whole)


def _weighed(lines: SensorLines, delta: float, whole: LeftOut) -> Suspicion | None:
    """Hypotheses at one error of the model: all is well, a sensor is wrong, two are exchanged."""
    m = lines.sensors
    told = [_without(lines, delta, whole, i) for i in range(m)] + (_exchanges(lines, delta, whole) if m <= MOST else [])
    pairs = max(1, m * (m - 1) // 2)
    many = _limit_of_one(pairs, lines.spare) / _limit_of_one(m, lines.spare)  # a chance for each exchange

    def limit(e: Explanation) -> float:
        return float(max(whole.limit[i] for i in e.sensors)) * (many if e.swap else 1.0)

    gain = [_gained(lines, delta, whole, e, limit(e)) for e in told]
    order = np.argsort(gain)[::-1]
    best = told[order[0]]
    stands = float(gain[order[0]])
    if best.unfit > 1 or stands <= 1:
        return (
            Suspicion((), False, whole.scale / LOST, best.left.scale / LOST, np.inf, delta)
            if (whole.scale > LOST and best.left.scale > LOST)
            else None
        )
    # how much worse each other explanation is than the best, in terms of the best
    worse = [best.over(_again(e.lines, delta, best, e.misfit), limit(best)) for e in told]
    if not best.swap and (swaps := [k for k, e in enumerate(told) if e.swap and worse[k] <= MARGIN and e.unfit <= 1]):
        best = told[min(swaps, key=lambda k: worse[k])]
    if best.swap:
        other = min((w for w, e in zip(worse, told, strict=True) if e is not best and e.swap), default=np.inf)
        return Suspicion(best.sensors, True, stands, best.unfit, float(other), delta)
    other = min((w for w, e in zip(worse, told, strict=True) if e is not best), default=np.inf)
    alike = {e.sensors[0] for w, e in zip(worse, told, strict=True) if not e.swap and w <= MARGIN}
    if lines.spare < 2:
        alike = set(range(m))
    return Suspicion(tuple(sorted(alike | set(best.sensors))), False, stands, best.unfit, float(other), delta,
                     best.left.scale, left_out(lines, delta, best.left.tau))  # fmt: skip


def _without(lines: SensorLines, delta: float, whole: LeftOut, i: int) -> Explanation:
    """Sensor i is wrong: without a prior, what the others leave is the Schur complement of its precision."""
    if lines.spread is not None:
        return Explanation((i,), False, lines, delta)
    own, across = whole.K[:, i, i].real, np.delete(whole.K[:, :, i], i, axis=1)
    inverse = np.divide(1.0, own, out=np.zeros(len(own)), where=whole.precision[:, i] > 0)
    K = np.delete(np.delete(whole.K, i, axis=1), i, axis=2)
    K -= (inverse[:, None] * across)[:, :, None] * across[:, None].conj()
    misfit = whole.misfit - lines.worth * float(np.sum(own * np.sum(np.abs(whole.rest[:, i]) ** 2, axis=1)))
    return Explanation((i,), False, lines, delta, max(misfit, 0.0), (K, max(whole.dims - 1, 0), 0.0, 0.0))


def _exchanges(lines: SensorLines, delta: float, whole: LeftOut) -> list[Explanation]:
    """Every two sensors exchanged.

    Without a prior, two whitened sensors have the block B of the whole precision ``P = I - Q Q^H``. Predicted from all
    others they are ``p = z - B^-1 (P z)`` with covariance ``B^-1 - I``; each then reads the place of the other.
    """
    pairs = list(combinations(range(lines.sensors), 2))
    if lines.spread is not None:
        return [Explanation(pair, True, lines, delta) for pair in pairs]
    # one sensor at a time: there may be many lines
    misfit = np.concatenate([_of_exchanges(lines, delta, whole, i) for i in range(lines.sensors - 1)])
    left = [None if np.isnan(x) else float(x) for x in misfit]
    return [Explanation(pair, True, lines, delta, x) for pair, x in zip(pairs, left, strict=True)]


def _of_exchanges(lines: SensorLines, delta: float, whole: LeftOut, i: int) -> Real:
    """Misfit that exchanges of sensor i with each after it leave; NaN where all others say nothing of the two."""
    w = 1 / np.sqrt(lines.noise + delta**2 * lines.size)
    both = np.array([(i, j) for j in range(i + 1, lines.sensors)])
    of_two = w[:, both]  # (lines, pairs, 2)
    B = whole.K[:, both[:, :, None], both[:, None]] / (of_two[..., None] * of_two[..., None, :])
    z = of_two[..., None] * lines.y[:, both]  # (lines, pairs, 2, snapshots)
    r = (whole.K @ lines.y)[:, both] / of_two[..., None]
    a, b, c = B[..., 0, 0].real, B[..., 1, 1].real, B[..., 0, 1]
    determinant = a * b - np.abs(c) ** 2
    firm = np.all(determinant > FIRM * np.maximum(a + b, FIRM), axis=0)
    safe = np.where(firm, determinant, 1.0)[..., None, None]
    inverse = np.stack([np.stack([b + 0j, -c], -1), np.stack([-c.conj(), a + 0j], -1)], -2) / safe
    gone = inverse @ r
    ratio = of_two / of_two[..., ::-1]
    off = z - ratio[..., None] * (z - gone)[..., ::-1, :]
    S = np.eye(2) + ratio[..., None] * (inverse - np.eye(2))[..., ::-1, ::-1] * ratio[..., None, :]
    a, b, c = S[..., 0, 0].real, S[..., 1, 1].real, S[..., 0, 1]
    back = np.stack([b[..., None] * off[..., 0, :] - c[..., None] * off[..., 1, :],
                     a[..., None] * off[..., 1, :] - c.conj()[..., None] * off[..., 0, :]], -2)  # fmt: skip
    back = back / np.where(firm, a * b - np.abs(c) ** 2, 1.0)[..., None, None]
    moved = np.sum((off.conj() * back).real - (r.conj() * gone).real, axis=(0, 2, 3))
    return np.where(firm, np.maximum(whole.misfit + lines.worth * moved, 0.0), np.nan)


def _gained(lines: SensorLines, delta: float, whole: LeftOut, e: Explanation, limit: float) -> float:
    """What an explanation gains over all being well, over the limit of chance.

    Under a prior both may choose the size of the loads: the rest pays for the one that all sensors ask for.
    """
    if lines.spread is None or limit <= 0:
        return e.over(whole.misfit, limit) if whole.misfit > e.misfit else 0.0
    if e.swap:
        return min(e.over(_again(lines, delta, e, whole.misfit), limit), (whole.cost - e.left.cost) / limit)
    (i,) = e.sensors
    paid = left_out(e.lines, delta, whole.tau).cost - e.left.cost
    return float(min(e.over(_again(lines, delta, e, whole.misfit), limit), whole.excess[i] + paid / limit))


def _again(lines: SensorLines, delta: float, e: Explanation, left: float) -> float:
    """Misfit of these lines at the size of the loads of an explanation; `left` without a prior."""
    return left if lines.spread is None else left_out(lines, delta, e.left.tau).misfit


def _with_noise(lines: SensorLines) -> SensorLines:
    """The level of an unknown noise: what the median line leaves, without the sensor that disturbs most."""
    from scipy.special import gammaincinv

    K, dims, *_ = _precision(lines, lines.noise, None)
    diagonal = np.einsum("kii->ki", K).real
    own = np.divide(np.abs(K @ lines.y) ** 2, diagonal[..., None], out=np.zeros(lines.y.shape),
                    where=diagonal[..., None] * lines.noise[..., None] > SEEN)  # fmt: skip
    total = np.einsum("kis,kij,kjs->k", lines.y.conj(), K, lines.y).real
    rest = np.maximum(total[:, None] - own.sum(axis=2), 0.0)
    left = (dims - 1) * lines.y.shape[2]
    level = np.min(np.median(rest, axis=0)) / gammaincinv(left, 0.5)
    return replace(lines, noise=lines.noise * max(float(level), 1e-20))


# -- what it is --------------------------------------------------------------------------------------------------------
UNITS = (9.80665, 1e3, 1e6, 1e2, 10.0, np.sqrt(2.0), 0.0254, 4.4482216, 2 * np.pi, 180 / np.pi)
NEAR = 4.0  # errors of the gain within which it is a factor of units ...
BEYOND = 0.03  # ... and of the gain
FOLLOWS = 0.8  # correlation with the prediction, from which a sensor follows it
DEAD = 0.2  # of the gain, below which a sensor does not follow
QUIET = 0.3  # of the prediction, below which a sensor is dead
EXPLAINED = 0.35  # of the misfit that a gain or a delay may leave
SLOW = 0.8  # of the misfit on slow lines: an offset or a drift
MATTERS = 0.2  # of the reading, from which a slow misfit is told
CONSTANT = 0.9  # of the slow misfit that a constant explains


@dataclass(frozen=True)
class LineFault:
    """What is wrong with one sensor.

    Parameters
    ----------
    kind : str
        ``gain, unit, polarity, delay, dead, offset, drift`` or ``other``.
    size : float
        Gain over what it should be, delay in samples, offset in the unit of the sensor; 0 where nothing is to be said.
    std : float
        Of the size.
    gain : float
        Gain, for whatever else is wrong.
    """

    kind: str
    size: float
    std: float
    gain: float = 1.0


@dataclass(frozen=True, eq=False)
class LineTimes:
    """What lines have to do with time.

    Parameters
    ----------
    phase : array, shape (lines,)
        Angle per sample of delay.
    constant : array, shape (lines,), complex, or None
        Transform of a constant of one, where the lines hold it.
    slow : array of bool, shape (lines,)
        Lines of what an offset or a drift is made of.
    longest : float
        Delay, samples, up to which one is sought.
    """

    phase: Real
    constant: Array | None
    slow: NDArray[np.bool_]
    longest: float


def told_apart(lines: SensorLines, suspicion: Suspicion, clock: LineTimes | None) -> tuple[int, LineFault] | None:
    """The sensor that is wrong, and its fault: of several suspects the one whose fault is one that sensors have."""
    if suspicion.found is None or not suspicion.sensors:
        return None
    faults = {i: _named(lines, suspicion, suspicion.found, i, clock) for i in suspicion.sensors}
    for usual in (("polarity", "unit", "dead", "delay"), ("polarity", "unit", "dead", "delay", "gain", "offset")):
        left = {i: f for i, f in faults.items() if f.kind in usual}
        if len(faults) == 1:
            return next(iter(faults.items()))
        if len(left) == 1 and lines.spare > 1:
            return next(iter(left.items()))
    return None


def drifting(lines: SensorLines, clock: LineTimes) -> tuple[Suspicion, int, LineFault] | None:
    """A sensor with an offset or a drift, which few of the `prepared` lines hold: these are asked alone."""
    if clock.slow.sum() < 2:
        return None
    slow = lines.on(clock.slow)
    found = suspect(slow)
    if found is None or found.swap or len(found.sensors) != 1 or found.found is None:
        return None
    (i,) = found.sensors
    alone = replace(clock, phase=clock.phase[clock.slow], constant=None, slow=np.ones(int(clock.slow.sum()), bool))
    fault = _named(slow, found, found.found, i, alone)
    if fault.kind in ("gain", "unit", "polarity", "dead", "delay"):
        return found, i, fault
    rest = found.found.rest[:, i]
    if np.sum(np.abs(rest) ** 2) < MATTERS**2 * np.sum(np.abs(lines.y[:, i]) ** 2):
        return None
    return found, i, _slow(rest, None if clock.constant is None else clock.constant[clock.slow])


def _named(lines: SensorLines, suspicion: Suspicion, found: LeftOut, i: int, clock: LineTimes | None) -> LineFault:
    """The fault of a sensor that is wrong."""
    y, p = lines.y[:, i], lines.y[:, i] - found.rest[:, i]
    told, own = found.precision[:, i] > 0, lines.noise[:, i] + suspicion.delta**2 * lines.size[:, i]
    spread = np.divide(1.0, found.precision[:, i], out=np.full(len(y), np.inf), where=told)
    # the variance of the sensor is taken as that of one that follows the prediction
    ratio = min(1.0, float(np.sum(np.abs(p[told]) ** 2) / max(np.sum(np.abs(y[told]) ** 2), 1e-300)))
    w = lines.worth / np.maximum(spread - (1 - ratio) * own, 1e-12 * spread)[:, None]
    size = float(np.sum(w * np.abs(p) ** 2))
    chance = float(np.sqrt(suspicion.scale))
    if size <= 0:
        return LineFault("other", 0.0, 0.0)
    gain = float(np.sum(w * (p.conj() * y).real)) / size
    # a gain is known to what noise and errors of the model leave of it
    std = chance * float(np.sqrt(1 / size + suspicion.delta**2 * max(1.0, gain**2)))
    before = float(np.sum(w * np.abs(y - p) ** 2))
    after = float(np.sum(w * np.abs(y - gain * p) ** 2))
    late = None if clock is None else _delayed(y, p, w, clock)
    if late is not None and late[2] < EXPLAINED * after and 1 / 3 < abs(late[1]) < 3:
        return LineFault("delay", late[0], late[3] * chance, late[1])
    power = float(np.sum(w * np.abs(y) ** 2))
    follows = np.size(y) > 3 and gain**2 * size > FOLLOWS**2 * power
    if abs(gain) < DEAD and power < QUIET**2 * size + np.size(y) * lines.worth * chance**2 and not follows:
        return LineFault("dead", 0.0, std, gain)
    if clock is None and lines.y.shape[2] > 3 and (steady := _constant(y, p, w, after)) is not None:
        return steady
    if after > EXPLAINED * before and clock is not None and clock.constant is not None:
        energy = np.sum(np.abs(y - p) ** 2, axis=1)
        if np.sum(energy[clock.slow]) > SLOW * np.sum(energy):
            return _slow(y - p, clock.constant)
    if after > EXPLAINED * before and not follows:
        return LineFault("other", 0.0, 0.0, gain)
    return _of_gain(gain, std)


def _of_gain(gain: float, std: float) -> LineFault:
    """A gain as polarity, as a mistaken unit, or as what it is."""
    room = max(NEAR * std, BEYOND) * max(1.0, abs(gain)) if abs(gain) >= 1 else max(NEAR * std, BEYOND * abs(gain))
    if abs(gain + 1) <= max(NEAR * std, 0.25):
        return LineFault("polarity", gain, std, gain)
    near = [f for u in UNITS for f in (u, 1 / u, -u, -1 / u) if abs(f - gain) <= min(room, 0.15 * abs(f))]
    if near and (abs(gain) > 1.2 or abs(gain) < 0.8):
        return LineFault("unit", min(near, key=lambda f: abs(f - gain)), std, gain)
    return LineFault("gain", gain, std, gain)


def _delayed(y: Array, p: Array, w: Real, clock: LineTimes) -> tuple[float, float, float, float] | None:
    """Delay, its gain, what it leaves, its std: the best of a fine grid, refined by a parabola."""
    step = 0.125
    lags = np.arange(-clock.longest, clock.longest + step / 2, step)
    c = np.sum(w * p.conj() * y, axis=1)
    used = np.flatnonzero(np.abs(c) > 0)
    if not len(used):
        return None
    like = np.array([np.sum(c[used] * np.exp(1j * clock.phase[used] * lag)).real for lag in lags])
    size, own = float(np.sum(w * np.abs(p) ** 2)), float(np.sum(w * np.abs(y) ** 2))
    k = int(np.argmax(like))
    if k in (0, len(lags) - 1) or abs(lags[k]) < 0.2:
        return None
    bend = like[k - 1] - 2 * like[k] + like[k + 1]
    lag = lags[k] + (0.5 * step * (like[k - 1] - like[k + 1]) / bend if bend < 0 else 0.0)
    std = float(np.sqrt(1 / max(np.sum(w * np.abs(clock.phase[:, None] * p) ** 2), 1e-300)))
    return float(lag), float(like[k] / size), own - float(like[k]) ** 2 / size, std


def _slow(rest: Array, constant: Array | None) -> LineFault:
    """An offset, or a drift: whether the transform of a constant explains what is left on slow lines."""
    if constant is None:
        return LineFault("drift", 0.0, 0.0)
    c = constant[:, None]
    offset = float(np.sum((c.conj() * rest).real) / np.sum(np.abs(c) ** 2))
    left = float(np.sum(np.abs(rest - offset * c) ** 2))
    return (
        LineFault("offset", offset, 0.0)
        if left < (1 - CONSTANT) * np.sum(np.abs(rest) ** 2)
        else LineFault("drift", 0.0, 0.0)
    )


def _constant(y: Array, p: Array, w: Real, after: float) -> LineFault | None:
    """An offset over frames."""
    offset = float(np.sum(w * (y - p)) / np.sum(w))
    left = float(np.sum(w * (y - p - offset) ** 2))
    return LineFault("offset", offset, float(np.sqrt(1 / np.sum(w) / y.shape[1]))) if left < 0.5 * after else None
