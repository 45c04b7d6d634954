"""Who is wrong where sensors contradict each other: hypotheses of one wrong sensor, or of two exchanged.

Without a prior one factorisation of all sensors gives what is left when one is dropped, or two are exchanged.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .leave_one_out import FLOOR, SEEN, LeftOut, SensorLines, left_out, limit_of_one, precision_of, predicted

Array = NDArray[Any]
Real = NDArray[np.float64]

SCREEN = 0.5  # of the limit, from which a closer look is taken
LOST = 200.0  # times the variance that is expected, from which no error of a model in use explains it: some 40 %
CLEARLY = 2.0  # times that variance, from which a closer look is taken
MARGIN = 0.4  # of the limit, by which the best explanation leaves less than the next
MOST = 24  # sensors beyond which swaps are not tried
FIRM = 1e-6  # of the precision of two sensors alone: below, their exchange is solved anew


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
        Of the lines that it believes, where it is known: see `precision_of`.
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
        return left_out(self.lines, self.delta) if known is None else predicted(self.lines, self.delta, *known)

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
    many = limit_of_one(pairs, lines.spare) / limit_of_one(m, lines.spare)  # a chance for each exchange

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

    K, dims, *_ = precision_of(lines, lines.noise, None)
    diagonal = np.einsum("kii->ki", K).real
    own = np.divide(np.abs(K @ lines.y) ** 2, diagonal[..., None], out=np.zeros(lines.y.shape),
                    where=diagonal[..., None] * lines.noise[..., None] > SEEN)  # fmt: skip
    total = np.einsum("kis,kij,kjs->k", lines.y.conj(), K, lines.y).real
    rest = np.maximum(total[:, None] - own.sum(axis=2), 0.0)
    left = (dims - 1) * lines.y.shape[2]
    level = np.min(np.median(rest, axis=0)) / gammaincinv(left, 0.5)
    return replace(lines, noise=lines.noise * max(float(level), 1e-20))
