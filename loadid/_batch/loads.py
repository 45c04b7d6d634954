"""What is kept of a load history: numbers that add up over pieces of a record exactly, cycles among them.

Rainflow cycles that close within a piece are counted there. What is left open, the residue, is joined with that of the
next piece and counted again: the four-point method closes the same cycles as on the whole record (Amzallag et al., Int.
J. Fatigue 16 (1994) 287).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

Array = NDArray[np.float64]

WIDTH = 1.959963984540054  # of the 95 % band, in std
CLASSES = 20  # of a decade of ranges


@dataclass(frozen=True)
class PeakBand:
    """Largest magnitude of a load: value and std in its unit, s after the beginning of the record."""

    value: float
    std: float
    at: float


@dataclass(frozen=True)
class Cycles:
    """Closed cycles of a load, and what is left open.

    Parameters
    ----------
    classes : mapping of int to float
        Number of cycles whose range is from 10^(k/20) up to 10^((k+1)/20).
    power : mapping of float to float
        Exponent m -> sum of range^m over the closed cycles.
    closed : int
    residue : tuple of float
        Turning points that belong to no closed cycle.
    """

    classes: Mapping[int, float]
    power: Mapping[float, float]
    closed: int
    residue: tuple[float, ...]

    @property
    def whole(self) -> Cycles:
        """The same with the residue counted as half cycles (ASTM E1049), and nothing left open."""
        halves = np.abs(np.diff(self.residue))
        return _with(self, halves, 0.5, ())


@dataclass(frozen=True)
class Kept:
    """What is kept of one load over some samples.

    Parameters
    ----------
    samples : int
    total, squares, spread : float
        Sums of the load, of its square and of its variance (std^2).
    low, high : float
        Smallest and largest value.
    sure, perhaps : (float, float)
        Smallest upper and largest lower end of the 95 % band: beyond these the load was for certain. Smallest lower and
        largest upper end: beyond these it was not.
    peak : PeakBand
    cycles : Cycles, optional
    """

    samples: int
    total: float
    squares: float
    spread: float
    low: float
    high: float
    sure: tuple[float, float]
    perhaps: tuple[float, float]
    peak: PeakBand
    cycles: Cycles | None = None

    @property
    def numbers(self) -> dict[str, Any]:
        """Mean, root mean square, std of the error (root mean square), extremes, peak with its band."""
        p = self.peak
        return {
            "samples": self.samples, "mean": self.total / self.samples, "rms": math.sqrt(self.squares / self.samples),
            "std": math.sqrt(self.spread / self.samples), "min": self.low, "max": self.high, "peak": p.value,
            "peak_std": p.std, "peak_low": p.value - WIDTH * p.std, "peak_high": p.value + WIDTH * p.std,
            "peak_at": p.at,
        }  # fmt: skip

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)

    @classmethod
    def of(cls, tree: Mapping[str, Any]) -> Kept:
        """Inverse of `to_dict` through JSON."""
        given = dict(tree)
        cycles = given.pop("cycles")
        if cycles is not None:
            cycles = Cycles(
                {int(k): v for k, v in cycles["classes"].items()}, {float(m): v for m, v in cycles["power"].items()},
                cycles["closed"], tuple(cycles["residue"]),
            )  # fmt: skip
        ends = {name: (float(given[name][0]), float(given[name][1])) for name in ("sure", "perhaps")}
        return cls(**{**given, **ends, "peak": PeakBand(**given["peak"])}, cycles=cycles)


def kept(load: Array, std: Array, dt: float, start: int = 0, exponents: Sequence[float] | None = None) -> Kept:
    """What is kept of a load (samples,) and its std, which begins `start` samples after the record.

    Parameters
    ----------
    exponents : sequence of float, optional
        Of damage-equivalent loads; None counts no cycles.
    """
    top, bottom, k = load + WIDTH * std, load - WIDTH * std, int(np.argmax(np.abs(load)))
    return Kept(
        len(load), math.fsum(load), math.fsum(load**2), math.fsum(std**2), float(load.min()), float(load.max()),
        (float(top.min()), float(bottom.max())), (float(bottom.min()), float(top.max())),
        PeakBand(float(load[k]), float(std[k]), (start + k) * dt),
        None if exponents is None else cycles_of(load, exponents),
    )  # fmt: skip


def joined(parts: Sequence[Kept]) -> Kept:
    """Of pieces of one record, in their order, what is kept of the whole."""
    first = parts[0]
    cycles = first.cycles
    if cycles is not None:
        for part in parts[1:]:
            assert part.cycles is not None
            cycles = _joined(cycles, part.cycles)
    return Kept(
        sum(p.samples for p in parts), math.fsum(p.total for p in parts), math.fsum(p.squares for p in parts),
        math.fsum(p.spread for p in parts), min(p.low for p in parts), max(p.high for p in parts),
        (min(p.sure[0] for p in parts), max(p.sure[1] for p in parts)),
        (min(p.perhaps[0] for p in parts), max(p.perhaps[1] for p in parts)),
        max((p.peak for p in parts), key=lambda peak: abs(peak.value)), cycles,
    )  # fmt: skip


# -- cycles -----------------------------------------------------------------------------------------------------------
def turning_points(x: Array) -> Array:
    """First and last value of a history, and where it turns; of a level stretch one value."""
    x = x[np.r_[True, np.diff(x) != 0]]
    rising = np.diff(x) > 0
    return x[np.r_[True, rising[1:] != rising[:-1], True][: len(x)]] if len(x) > 1 else x


def cycles_of(x: Array, exponents: Sequence[float]) -> Cycles:
    """Rainflow cycles of a history or of joined residues.

    Raises
    ------
    InputError
        fatpack is not installed.
    """
    return _counted(Cycles({}, dict.fromkeys(exponents, 0.0), 0, ()), x)


def equivalent(cycles: Cycles, exponent: float, count: float) -> float:
    """Damage-equivalent load: the range that does in `count` cycles the damage of all, those of the residue halved."""
    return float((cycles.whole.power[exponent] / count) ** (1 / exponent))


def _joined(before: Cycles, after: Cycles) -> Cycles:
    both = Cycles(
        {k: before.classes.get(k, 0.0) + after.classes.get(k, 0.0) for k in {**before.classes, **after.classes}},
        {m: before.power[m] + after.power[m] for m in before.power}, before.closed + after.closed, (),
    )  # fmt: skip
    return _counted(both, np.array([*before.residue, *after.residue]))


def _counted(known: Cycles, x: Array) -> Cycles:
    """Closed cycles of a history added to those that are known."""
    try:
        from fatpack import find_rainflow_cycles
    except ImportError:
        raise InputError("cycles are counted by a package that is not installed", where="[fatigue]",
                         found="no fatpack", expected="fatpack",
                         hint="pip install 'loadid[cluster]', or leave [fatigue] out") from None  # fmt: skip
    pairs, residue = find_rainflow_cycles(turning_points(x).tolist())
    ranges = np.abs(np.diff(pairs, axis=1)).reshape(-1) if len(pairs) else np.zeros(0)
    return _with(known, ranges, 1.0, tuple(residue.tolist()))


def _with(known: Cycles, ranges: Array, each: float, residue: tuple[float, ...]) -> Cycles:
    """Further cycles of some ranges, each counted as so much."""
    ranges = ranges[ranges > 0]
    classes = dict(known.classes)
    for k, count in zip(*np.unique(np.floor(CLASSES * np.log10(ranges)), return_counts=True), strict=True):
        classes[int(k)] = classes.get(int(k), 0.0) + each * int(count)
    power = {m: total + each * math.fsum(ranges**m) for m, total in known.power.items()}
    return Cycles(dict(sorted(classes.items())), power, known.closed + (len(ranges) if each == 1.0 else 0), residue)
