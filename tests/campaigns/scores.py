"""What an answer is worth where the truth is known, and the table of many."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Z95 = 1.959963984540054


@dataclass(frozen=True)
class Scored:
    """One answer beside its truth.

    Parameters
    ----------
    groups : tuple of str
        The groups that the problem counts in: kind of structure, penalty, what is wrong with the model.
    grade : str
        Verdict of the answer.
    codes : frozenset of str
        Flags on it.
    error : float
        Norm of the load error over that of the load.
    best : float
        The same at the best lambda; NaN where nobody searched it.
    z : array
        Error over std of every value in the load's support.
    z_all : array
        Of every value.
    z_resultants : array
        Of forces, moments, impulses.
    width : float
        Median std over the rms error, of the values in the support.
    letter : str
        Grade of the answer.
    cautions : int
        Flags on it that are no notes.
    """

    groups: tuple[str, ...]
    grade: str
    codes: frozenset[str]
    error: float
    best: float
    z: Array
    z_all: Array
    z_resultants: Array
    width: float
    letter: str = ""
    cautions: int = 0

    @property
    def covered(self) -> float:
        """Share of the values that lie in their 95 % band."""
        return float(np.mean(np.abs(self.z_all) <= Z95))


def deviations(error: Array, std: Array) -> Array:
    """Error over std; a value without any spread is right or infinitely wrong."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(error == 0, 0.0, np.asarray(error) / np.asarray(std))


def line(name: str, found: Sequence[Scored]) -> str:
    """One row of the table."""
    if not found:
        return f"{name:28s}  none"
    z, inside, total = (np.abs(np.concatenate([getattr(s, a) for s in found])) for a in ("z_all", "z", "z_resultants"))
    ratio = np.array([s.error / s.best for s in found if np.isfinite(s.best)])
    return (
        f"{name:28s} {len(found):4d}   {np.mean(z <= Z95):5.0%}  {np.mean(inside <= Z95):5.0%}"
        f"  {np.mean([s.covered < 0.5 for s in found]):5.0%}   {np.mean(total <= Z95):5.0%}"
        f"  {np.mean(total > 3):4.0%} {np.mean(total > 6):5.1%}   {np.median([s.error for s in found]):6.3f}"
        f"  {np.median(ratio) if len(ratio) else np.nan:5.2f} {np.quantile(ratio, 0.9) if len(ratio) else np.nan:5.2f}"
        f"  {np.median([s.width for s in found]):5.2f}  {np.mean([s.cautions for s in found]):5.2f}"
    )


HEADING = (
    f"{'':28s} {'n':>4s}   {'band':>5s}  {'there':>5s}  {'<half':>5s}   {'total':>5s}  {'>3':>4s} {'>6':>5s}"
    f"   {'error':>6s}  {'/best':>5s} {'90 %':>5s}  {'width':>5s}  {'flags':>5s}"
)


def table(found: Sequence[Scored], told: Callable[[str], None] = print) -> None:
    """Print all, each group and each grade.

    Columns: values in their 95 % band, of all and where the load is; problems with less than half in their band;
    resultants in the band, beyond 3 and 6 std; load error, over the error at the best lambda (median, 90 %); median std
    over the rms error; cautions on an answer.
    """
    told(HEADING)
    told(line("all", found))
    for group in sorted({g for s in found for g in s.groups}):
        told(line(group, [s for s in found if group in s.groups]))
    for grade in sorted({s.grade for s in found}):
        told(line(f"verdict: {grade}", [s for s in found if s.grade == grade]))
    for letter in sorted({s.letter for s in found}):
        told(line(f"grade {letter}", [s for s in found if s.letter == letter]))
    silent = [s for s in found if s.covered < 0.5 or np.any(np.abs(s.z_resultants) > 6)]
    told(f"bands that do not hold, by verdict: {counts(s.grade for s in silent)}")


def counts(values: Iterable[str]) -> str:
    """``a 3, b 1``."""
    names = list(values)
    return ", ".join(f"{name} {names.count(name)}" for name in sorted(set(names))) or "none"
