"""What is believed of a load before the data: a Gaussian process that a few states carry from sample to sample.

=============  ===================================  ======================================================
prior          covariance over a lag t              states
=============  ===================================  ======================================================
random walk    none: it never settles               the load (the augmented Kalman filter)
white          ``sd^2`` at t = 0                    the load
OU             ``sd^2 exp(-t / length)``            the load
Matern 3/2     ``a = sqrt(3) t / length``:          the load, its rate
               ``sd^2 (1 + a) exp(-a)``
Matern 5/2     ``a = sqrt(5) t / length``:          the load, its rate, its curvature
               ``sd^2 (1 + a + a^2/3) exp(-a)``
periodic       ``sd^2 exp(-2 sin^2(pi t / period)   two for each harmonic
               / length^2)``, times
               ``exp(-t / decay)``
=============  ===================================  ======================================================

The states z have a variance of one where the process has a variance, and H carries the units of the load: multiplying
a load by a factor changes H alone.

References
----------
J. Hartikainen, S. Sarkka, "Kalman filtering and smoothing solutions to temporal Gaussian process regression models",
IEEE MLSP (2010); A. Solin, S. Sarkka, "Explicit link between periodic covariance functions and state space models",
AISTATS (2014); E. Lourens et al., Mech. Syst. Signal Process. 27 (2012) 446-460 for the random walk.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError, positive, shown

from ._inverse.gaussian.roots import Array, step

__all__ = ["OU", "Continuous", "Discrete", "Matern32", "Matern52", "Periodic", "RandomWalk", "Sum", "White"]

WIDE = 1e4  # seconds^(1/2) of a walk before the first sample: three years; wider costs digits of what follows
MISSING = 1e-6  # share of the variance that may lie beyond the harmonics that are kept
HARMONICS = 64  # most that a periodic prior takes of itself


def _fixed(*rows: Sequence[float]) -> Array:
    """Read-only array."""
    array = np.array(rows)
    array.setflags(write=False)
    return array


@dataclass(frozen=True, eq=False)
class Discrete:
    """A load from sample to sample: ``z_{k+1} = F z_k + LQ e_k``, load ``H z``, ``z_0 = L0 e``, all e white of one.

    Parameters
    ----------
    F : array, shape (s, s)
    LQ : array, shape (s, q)
    H : array, shape (1, s)
    L0 : array, shape (s, r)
    """

    F: Array
    LQ: Array
    H: Array
    L0: Array


@dataclass(frozen=True, eq=False)
class Continuous:
    """The same states in continuous time: ``dz = F z dt + b dW``, load ``H z``, ``z_0 = L0 e``.

    Parameters
    ----------
    F : array, shape (s, s)
        1/s.
    b : array, shape (s, q)
        Root of the density of the white noise.
    H : array, shape (1, s)
    L0 : array, shape (s, r)
    """

    F: Array
    b: Array
    H: Array
    L0: Array


@runtime_checkable
class Prior(Protocol):
    """What the augmented model asks of a prior."""

    @property
    def sd(self) -> float:
        """Standard deviation of the load in the long run; infinite for a walk."""

    @property
    def words(self) -> str:
        """The prior in words, for reports."""

    def scaled(self, factor: float) -> Self:
        """The prior of the load times a factor."""

    def discrete(self, dt: float) -> Discrete:
        """From sample to sample, `dt` in s."""

    def continuous(self) -> Continuous:
        """In continuous time."""


@dataclass(frozen=True)
class RandomWalk:
    """A load that wanders without bound: each step adds a white increment.

    Parameters
    ----------
    rate : float
        Std that a second adds, in load units per root second; papers state the variance of a step, ``rate^2 dt``.
    start : float, optional
        Std of the load before the first sample; so wide that the data decide, by default.
    """

    rate: float
    start: float | None = None

    def __post_init__(self) -> None:
        _settle(self, "rate")
        if self.start is not None:
            _settle(self, "start")

    @property
    def sd(self) -> float:
        """Infinite."""
        return math.inf

    @property
    def words(self) -> str:
        """In words."""
        return f"a random walk in time that a second moves by {self.rate:.3g}"

    def scaled(self, factor: float) -> RandomWalk:
        """The walk of the load times a factor."""
        return RandomWalk(self.rate * factor, None if self.start is None else self.start * factor)

    def discrete(self, dt: float) -> Discrete:
        """From sample to sample."""
        known = self.continuous()
        return Discrete(np.eye(1), np.full((1, 1), math.sqrt(_step(dt))), known.H, known.L0)

    def continuous(self) -> Continuous:
        """Brownian motion; the state is the load over its rate."""
        start = WIDE if self.start is None else self.start / self.rate
        return Continuous(np.zeros((1, 1)), np.eye(1), np.full((1, 1), self.rate), np.full((1, 1), start))


@dataclass(frozen=True)
class White:
    """A load without memory: independent from sample to sample.

    Parameters
    ----------
    sd : float
        Std. Infinite: nothing is said of the load, as the filter of Gillijns and De Moor (Automatica 43 (2007) 934)
        has it; `augment` then takes one that is far beyond what the sensors resolve.
    """

    sd: float

    def __post_init__(self) -> None:
        if self.sd != math.inf:
            _settle(self, "sd")

    @property
    def words(self) -> str:
        """In words."""
        return "nothing: every sample on its own" if self.sd == math.inf else f"white in time, std {self.sd:.3g}"

    def scaled(self, factor: float) -> White:
        """The prior of the load times a factor."""
        return White(self.sd * factor)

    def discrete(self, dt: float) -> Discrete:
        """From sample to sample; a new load each time."""
        _step(dt)
        if self.sd == math.inf:
            raise InputError("an infinite std has no numbers", where="White", found="sd=inf", expected="a finite std",
                             hint="augment() settles one that the sensors cannot tell from it")  # fmt: skip
        one = np.eye(1)
        return Discrete(np.zeros((1, 1)), one, np.full((1, 1), self.sd), one)

    def continuous(self) -> Continuous:
        """Refused: its variance would be spread over all frequencies."""
        raise InputError("a white load exists from sample to sample only", where="White", found="continuous time",
                         expected="hold='foh' or 'zoh'", hint="OU(sd, length) is rough, and has a length")  # fmt: skip


@dataclass(frozen=True)
class Companion:
    """A load whose highest derivative is driven by white noise and that forgets within a length.

    Parameters
    ----------
    sd : float
        Std of the load.
    length : float
        Correlation length in s.
    """

    sd: float
    length: float

    _pole: ClassVar[float]  # times the length
    _density: ClassVar[float]  # of the noise, at a pole and a std of one
    _unit: ClassVar[Array]  # companion matrix at a pole of one
    _root: ClassVar[Array]  # of the stationary covariance, derivatives in multiples of the pole

    def __post_init__(self) -> None:
        _settle(self, "sd", "length")

    def scaled(self, factor: float) -> Self:
        """The prior of the load times a factor."""
        return replace(self, sd=self.sd * factor)

    @property
    def rate(self) -> float:
        """The pole, 1/s: derivatives are counted in it."""
        return self._pole / self.length

    @property
    def _H(self) -> Array:
        return self.sd * np.eye(1, len(self._unit))

    def continuous(self) -> Continuous:
        """Companion form, in multiples of the std and of the pole."""
        b = np.zeros((len(self._unit), 1))
        b[-1] = math.sqrt(self._density * self.rate)
        return Continuous(self.rate * self._unit, b, self._H, self._root)

    def discrete(self, dt: float) -> Discrete:
        """From sample to sample: closed transition, noise by quadrature (see `roots.step`)."""
        a = self.rate * _step(dt)
        b = np.zeros((len(self._unit), 1))
        b[-1] = math.sqrt(self._density)
        return Discrete(self._transition(a), step(self._unit, b, a)[1], self._H, self._root)

    def _transition(self, a: float) -> Array:
        raise NotImplementedError


class OU(Companion):
    """Ornstein-Uhlenbeck, Matern 1/2: rough, and always tame. Correlation ``exp(-t / length)``."""

    _pole, _density = 1.0, 2.0
    _unit, _root = _fixed([-1.0]), _fixed([1.0])

    @property
    def words(self) -> str:
        """In words."""
        return f"an Ornstein-Uhlenbeck process (rough), std {self.sd:.3g}, length {self.length:.3g} s"

    def _transition(self, a: float) -> Array:
        return np.full((1, 1), math.exp(-a))


class Matern32(Companion):
    """Matern 3/2: a load with a rate. Correlation ``(1 + a) exp(-a)``, ``a = sqrt(3) t / length``."""

    _pole, _density = math.sqrt(3.0), 4.0
    _unit, _root = _fixed([0.0, 1.0], [-1.0, -2.0]), _fixed([1.0, 0.0], [0.0, 1.0])

    @property
    def words(self) -> str:
        """In words."""
        return f"a Matern-3/2 process (smooth once), std {self.sd:.3g}, length {self.length:.3g} s"

    def _transition(self, a: float) -> Array:
        return math.exp(-a) * np.array([[1 + a, a], [-a, 1 - a]])


class Matern52(Companion):
    """Matern 5/2: a load with a curvature. Correlation ``(1 + a + a^2/3) exp(-a)``, ``a = sqrt(5) t / length``."""

    _pole, _density = math.sqrt(5.0), 16.0 / 3.0
    _unit = _fixed([0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, -3.0, -3.0])
    # covariance [[1, 0, -1/3], [0, 1/3, 0], [-1/3, 0, 1]]
    _root = _fixed([1.0, 0.0, 0.0], [0.0, math.sqrt(1 / 3), 0.0], [-1 / 3, 0.0, math.sqrt(8) / 3])

    @property
    def words(self) -> str:
        """In words."""
        return f"a Matern-5/2 process (smooth twice), std {self.sd:.3g}, length {self.length:.3g} s"

    def _transition(self, a: float) -> Array:
        rows = [
            [1 + a + a**2 / 2, a * (1 + a), a**2 / 2],
            [-(a**2) / 2, 1 + a - a**2, a * (1 - a / 2)],
            [a * (a / 2 - 1), a * (a - 3), 1 - 2 * a + a**2 / 2],
        ]
        return math.exp(-a) * np.array(rows)


@dataclass(frozen=True)
class Periodic:
    """A load that repeats: a constant and harmonics, whose amplitudes stay or, with a decay, wander.

    Parameters
    ----------
    sd : float
        Std of the load.
    period : float
        In s.
    length : float
        How far a period is smooth: 2 is nearly a sine, 0.5 has edges; no unit.
    decay : float, optional
        Correlation length of the amplitudes in s; without it they are constants, and no filter of them settles.
    harmonics : int, optional
        How many; by default as many as hold all but a millionth of the variance.
    constant : bool
        With the mean of a period among the parts.
    """

    sd: float
    period: float
    length: float
    decay: float | None = None
    harmonics: int | None = None
    constant: bool = True

    def __post_init__(self) -> None:
        _settle(self, "sd", "period", "length", *(["decay"] if self.decay is not None else []))
        if self.harmonics is None:
            return
        whole = not isinstance(self.harmonics, bool) and isinstance(self.harmonics, int | np.integer)
        if not whole or self.harmonics < 1:
            raise InputError("no number of harmonics", where="Periodic.harmonics", found=shown(self.harmonics),
                             expected="an integer of at least 1")  # fmt: skip

    @property
    def words(self) -> str:
        """In words."""
        held = "" if self.decay is None else f" whose amplitudes hold for {self.decay:.3g} s"
        return f"{self.orders[-1]} harmonics of {1 / self.period:.4g} Hz{held}, std {self.sd:.3g}"

    def scaled(self, factor: float) -> Periodic:
        """The prior of the load times a factor."""
        return replace(self, sd=self.sd * factor)

    @cached_property
    def orders(self) -> NDArray[np.int64]:
        """Orders of the harmonics, 0 for the constant."""
        last = self.harmonics
        if last is None:
            missing = 1 - np.cumsum(self._shares(HARMONICS))
            enough = np.flatnonzero(missing <= MISSING)
            if len(enough) == 0:
                raise InputError("the period has too many harmonics", where="Periodic.length", found=self.length,
                                 expected=f"a length that {HARMONICS} harmonics resolve",
                                 hint="name harmonics=, or choose a larger length")  # fmt: skip
            last = max(1, int(enough[0]))
        return np.arange(0 if self.constant else 1, last + 1)

    @property
    def amplitudes(self) -> Array:
        """Std of every part of `orders`."""
        return self.sd * np.sqrt(self._shares(int(self.orders[-1])))[self.orders]

    def _shares(self, last: int) -> Array:
        """Shares of the variance of the orders 0 .. `last`: ``exp(-1/l^2) I_j(1/l^2)``, twice from the first on."""
        from scipy.special import ive

        shares = np.asarray(ive(np.arange(last + 1), self.length**-2))
        shares[1:] *= 2
        return shares

    def discrete(self, dt: float) -> Discrete:
        """From sample to sample; a harmonic above the Nyquist frequency is refused."""
        dt = _step(dt)
        if 2 * int(self.orders[-1]) * dt >= self.period:
            raise InputError("harmonics above the Nyquist frequency cannot be told from those below", where="Periodic",
                             found=f"order {self.orders[-1]} of {1 / self.period:.4g} Hz",
                             expected=f"below {0.5 / dt:.4g} Hz", hint="name fewer harmonics=")  # fmt: skip
        decay = math.inf if self.decay is None else self.decay
        turns = self._turns(np.exp(2j * np.pi * self.orders * dt / self.period - dt / decay).astype(complex))
        kicks = math.sqrt(-math.expm1(-2 * dt / decay)) * np.eye(len(turns), len(turns) if self.decay else 0)
        return Discrete(turns, kicks, self._read, np.eye(len(turns)))

    def continuous(self) -> Continuous:
        """Oscillators, damped where there is a decay."""
        rate = 0.0 if self.decay is None else 1 / self.decay
        turns = self._turns((2j * np.pi * self.orders / self.period - rate).astype(complex))
        kicks = math.sqrt(2 * rate) * np.eye(len(turns), len(turns) if self.decay else 0)
        return Continuous(turns, kicks, self._read, np.eye(len(turns)))

    def _turns(self, values: NDArray[np.complex128]) -> Array:
        """Complex numbers as plane rotations, the constant as a number."""
        parts = [np.array([[v.real, -v.imag], [v.imag, v.real]]) for v in values]
        return diagonal([part[:1, :1] if order == 0 else part for order, part in zip(self.orders, parts, strict=True)])

    @property
    def _read(self) -> Array:
        rows = zip(self.orders, self.amplitudes, strict=True)
        return np.array([[x for order, q in rows for x in ([q] if order == 0 else [q, 0.0])]])


@dataclass(frozen=True)
class Sum:
    """Independent parts of one load, added.

    Walks, and what an undamped periodic part has of a constant, move together: data cannot separate them, so they are
    carried as one walk, which is the same process.

    Parameters
    ----------
    parts : sequence of priors
    """

    parts: tuple[Prior, ...]

    def __post_init__(self) -> None:
        try:
            parts = tuple(self.parts)
        except TypeError:
            parts = ()
        if not parts or not all(isinstance(part, Prior) for part in parts):
            raise InputError("no parts to add", where="Sum", found=shown(self.parts), expected="a sequence of priors",
                             hint="Sum([Matern32(100, 0.1), RandomWalk(5)])")  # fmt: skip
        object.__setattr__(self, "parts", parts)

    @property
    def sd(self) -> float:
        """Root of the sum of the variances."""
        return math.hypot(*(part.sd for part in self.parts))

    @property
    def words(self) -> str:
        """In words."""
        return " plus ".join(part.words for part in self.parts)

    def scaled(self, factor: float) -> Sum:
        """The prior of the load times a factor."""
        return Sum(tuple(part.scaled(factor) for part in self.parts))

    def discrete(self, dt: float) -> Discrete:
        """From sample to sample."""
        known = [part.discrete(dt) for part in _separable(self.parts)]
        F, LQ, L0 = (diagonal([getattr(k, name) for k in known]) for name in ("F", "LQ", "L0"))
        return Discrete(F, LQ, np.hstack([k.H for k in known]), L0)

    def continuous(self) -> Continuous:
        """In continuous time."""
        known = [part.continuous() for part in _separable(self.parts)]
        F, b, L0 = (diagonal([getattr(k, name) for k in known]) for name in ("F", "b", "L0"))
        return Continuous(F, b, np.hstack([k.H for k in known]), L0)


def _separable(parts: Sequence[Prior]) -> list[Prior]:
    """The same process with one walk at most, which has taken the constants in."""
    flat: list[Any] = [p for part in parts for p in (_separable(part.parts) if isinstance(part, Sum) else [part])]
    walks = [part for part in flat if isinstance(part, RandomWalk)]
    if not walks:
        return flat
    steady = [p for p in flat if isinstance(p, Periodic) and p.decay is None and p.constant]
    starts = [WIDE * w.rate if w.start is None else w.start for w in walks] + [float(p.amplitudes[0]) for p in steady]
    walk = RandomWalk(math.hypot(*(w.rate for w in walks)), math.hypot(*starts))
    rest = [replace(p, constant=False) if p in steady else p for p in flat if not isinstance(p, RandomWalk)]
    return [*rest, walk]


def diagonal(blocks: Sequence[Array]) -> Array:
    """Blocks on the diagonal, of any shape."""
    rows, columns = (sum(block.shape[i] for block in blocks) for i in (0, 1))
    out = np.zeros((rows, columns))
    i = j = 0
    for block in blocks:
        out[i : i + block.shape[0], j : j + block.shape[1]] = block
        i, j = i + block.shape[0], j + block.shape[1]
    return out


def _settle(prior: Any, *names: str) -> None:
    """Replace settings by positive floats, or refuse them by name."""
    for name in names:
        value = positive(name, getattr(prior, name), where=type(prior).__name__)
        object.__setattr__(prior, name, value)


def _step(dt: float) -> float:
    return positive("the step", dt, where="dt", unit="s")
