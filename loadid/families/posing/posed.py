"""What is asked of a problem, and the problem as posed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.discretise import HOLDS
from structures.errors import InputError
from structures.model import Model
from structures.values import number, reals

from ... import flags as guards
from ...inverse.noise_source import NoiseSource
from ...inverse.nonnegative.solver import NonNegativeRecord
from ...inverse.path import RegularizationPath
from ...inverse.penalties import order
from .. import noise as noises

PATHS = ("auto", "dense", "statespace", "toeplitz", "windows", "fft")
PADDED = "zero-padded FFT"  # name of the path that goes line by line
WHOLE = 50_000  # samples up to which a record is convolved in one piece: `python -m tests.benchmarks.windows`
UNUSABLE = 1e-12  # |h(0)| over max |h| below which the diagonal is zero


def _one_of(name: str, value: object, allowed: tuple) -> None:
    if not isinstance(value, str | bool | None) or value not in allowed:
        raise InputError(f"unknown {name}", where=name, found=repr(value)[:80],
                         expected=f"one of {', '.join(repr(x) for x in allowed)}")  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """What decides how a problem is posed; see `Deconvolution`."""

    method: str
    penalty: str | ArrayLike | None
    hold: str | None
    noise: ArrayLike | None
    noise_source: NoiseSource | None
    allow: tuple[str, ...]
    path: str = "auto"
    initial: str | ArrayLike = "rest"
    leak: float | None = None
    from_zero: bool = False
    free: bool = False
    signed: ArrayLike | bool | None = False
    size: ArrayLike | None = None

    def __post_init__(self) -> None:
        _one_of("method", self.method, ("tikhonov", "tsvd"))
        _one_of("path", self.path, PATHS)
        _one_of("hold", self.hold, (None, *HOLDS))
        _one_of("from_zero", self.from_zero, (False, True))
        if isinstance(self.penalty, str):
            order(self.penalty)
        if self.truncated:
            self._check_truncated()
        if self.leak is not None:
            object.__setattr__(self, "leak", number("leak", self.leak, where="leak"))
        if self.size is not None:
            self._check_size()
        if isinstance(self.initial, str):
            _one_of("initial", self.initial, ("rest", "unknown"))
        else:
            object.__setattr__(self, "initial", reals(self.initial, what="no initial state", where="initial"))

    def _check_truncated(self) -> None:
        if self.path in ("statespace", "toeplitz", "windows"):
            raise InputError("this path has no singular values to truncate", where="method",
                             found=f"'tsvd' with path={self.path!r}",
                             expected="path='auto', 'dense' or 'fft', or method='tikhonov'")  # fmt: skip
        if self.signed is not False:
            raise InputError("a truncated SVD takes no constraints", where="method", found="'tsvd'",
                             expected="method='tikhonov'")  # fmt: skip

    def _check_size(self) -> None:
        object.__setattr__(self, "size", reals(self.size, what="no weights of the size", where="size"))
        size = np.asarray(self.size, float)
        if size.ndim > 1 or not np.all(np.isfinite(size)) or np.any(size <= 0):
            raise InputError("no weights of the size of the loads", where="size", expected="positive, for each load",
                             found=f"shape {size.shape}, or not > 0")  # fmt: skip
        if not isinstance(self.penalty, str) or self.truncated or self.signed is not False:
            raise InputError(
                "a weight of the size stands beside a named penalty", where="size",
                found=self.method if self.truncated else "signs" if self.signed is not False else "a matrix or None",
                expected="penalty='first_difference' or another name, Tikhonov, no constraints",
            )  # fmt: skip

    @property
    def truncated(self) -> bool:
        """Truncated SVD in place of Tikhonov."""
        return self.method == "tsvd"

    @property
    def named(self) -> bool:
        """A penalty that every path knows."""
        return isinstance(self.penalty, str)

    @property
    def resting(self) -> bool:
        """The structure is at rest at the first sample."""
        return isinstance(self.initial, str) and self.initial == "rest"

    @property
    def special(self) -> bool:
        """Asks for what only the state-space path gives."""
        return not self.resting or self.leak is not None or self.from_zero

    def sizes(self, loads: int) -> NDArray[np.float64] | None:
        """Weight of the size of each load beside its differences.

        Raises
        ------
        InputError
            Another number of weights than loads.
        """
        if self.size is None:
            return None
        size = np.asarray(self.size, float)
        if size.ndim and size.shape != (loads,):
            raise InputError("the weights of the size do not fit the loads", where="size", found=f"shape {size.shape}",
                             expected=f"a number, or ({loads},)")  # fmt: skip
        return np.array(np.broadcast_to(size, loads), float)

    def refuse_special(self, path: str) -> None:
        """Refuse a start, a leak or a size on a path that does not know them.

        Raises
        ------
        InputError
            If one was asked for.
        """
        if self.special or (self.size is not None and path != "dense"):
            name = "initial" if not self.resting else "leak" if self.leak is not None else "from_zero"
            name = name if self.special else "size"
            raise InputError(
                f"the {path} path does not know this setting", where=name, found=repr(getattr(self, name))[:60],
                expected="a named penalty, Tikhonov with lambda > 0, a model with state_space(), and path='auto' or "
                "'statespace'",
            )  # fmt: skip


@dataclass(frozen=True)
class Posed:
    """A problem as posed.

    Parameters
    ----------
    path : RegularizationPath
    noise : Noise
    compare : callable
        (load, relative lambda, start or None) -> response and residual (samples, sensors); what is missing in the
        response is filled by the prediction. `start` is the state at the first sample, where that is an unknown and
        not that of the path.
    values : array, shape (samples, sensors)
        The data, advanced where the impulse response begins late.
    name : str
        Which path it is.
    h : array, shape (taps, sensors, loads)
        Impulse response of the used sensors; of a long record its beginning.
    layout : (kappa, rank, nullity)
        Conditioning of the visible part.
    full : (kappa, rank, nullity) or None
        The same with all sensors of the model, where only some are used.
    unknowns : int
    judged : RegularizationPath
        What the rules are asked on: the path itself, or the windows of a long record.
    pushing : callable, optional
        Numbers of the loads that only push (None: all) -> the same problem under signs.
    """

    path: RegularizationPath
    noise: noises.Noise
    compare: Callable[[NDArray, float, NDArray | None], tuple[NDArray, NDArray]]
    values: NDArray[np.float64]
    name: str
    h: NDArray[np.float64]
    layout: tuple[float, int, int]
    full: tuple[float, int, int] | None
    unknowns: int
    judged: RegularizationPath
    pushing: Callable[[ArrayLike | None], NonNegativeRecord] | None = None

    @property
    def rank(self) -> int:
        """Unknowns that the data see."""
        return self.layout[1]


def by_prediction(
    values: NDArray, predict: Callable[[NDArray], NDArray]
) -> Callable[[NDArray, float, NDArray | None], tuple[NDArray, NDArray]]:
    """Comparison of complete data with the prediction of a load."""

    def compare(load: NDArray, lam: float, start: NDArray | None) -> tuple[NDArray, NDArray]:
        return values, values - predict(load)

    return compare


def diagonal(h: NDArray) -> float:
    """First sample of the impulse responses (samples, sensors, loads) over their maximum, for the worst load."""
    level = np.max(np.abs(h), axis=1)
    return float(np.min(level[0] / level.max(axis=0)))


def shift(h: NDArray, model: Model, allow: tuple[str, ...]) -> int:
    """Samples by which data are advanced so that the first load to arrive has a diagonal (0 with a first-order hold).

    No more than that: what a load that arrives earlier does in between must stay in the operator. The last samples of
    a load that arrives later are not seen, and are left to the prior.
    """
    level = np.max(np.abs(h), axis=1)  # (samples, loads)
    largest = level.max(axis=0)
    for j in np.flatnonzero(largest == 0):
        raise guards.index_offset(0.0, model.loads[j].label, None)
    usable = level > UNUSABLE * largest
    if "LID-E506" in allow or usable[0].all():
        return 0
    first = np.argmax(usable, axis=0)
    worst = int(np.argmax(first))
    if first[worst] > len(h) // 2:
        raise guards.index_offset(float(level[0, worst] / largest[worst]), model.loads[worst].label, int(first[worst]))
    return int(first.min())
