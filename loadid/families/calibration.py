"""One lambda for many readings: chosen on all of them together, with the spread of what each alone would have said."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from structures.errors import InputError

from .readings import Readings, readings

if TYPE_CHECKING:
    from .static import StaticInversion


@dataclass(frozen=True)
class Calibration:
    """One relative lambda for a set-up.

    Parameters
    ----------
    lam : float
        Relative lambda, chosen on all records together.
    rule : str
    records : tuple of str
        Names of the records.
    alone : tuple of float
        Lambda that each record alone would choose.
    spread : float
        Decades between the smallest and the largest of them.
    verdict : str
        Of the joint choice.
    sigma_source : str
        Where the noise level (delta) comes from.
    date : str
        ISO date and time, UTC.
    level : array or None
        Noise level of the sensors that the records told, where neither the user nor the model states one.
    """

    lam: float
    rule: str
    records: tuple[str, ...]
    alone: tuple[float, ...]
    spread: float
    verdict: str
    sigma_source: str
    date: str
    level: Any = field(default=None, repr=False, compare=False)

    def __str__(self) -> str:
        return (
            f"relative lambda {self.lam:.3g} by {self.rule} from {len(self.records)} records on {self.date[:10]} "
            f"({self.verdict}; alone {min(self.alone):.3g} to {max(self.alone):.3g}, spread {self.spread:.2f} decades; "
            f"noise level: {self.sigma_source})"
        )

    def table(self) -> str:
        """The records and their own lambdas, as text."""
        width = max(len(name) for name in self.records)
        rows = [f"{name:{width}s}  {lam:.3g}" for name, lam in zip(self.records, self.alone, strict=True)]
        return "\n".join([*rows, f"{'together':{width}s}  {self.lam:.3g}", str(self)])


def calibrate(family: StaticInversion, records: Sequence[Any]) -> Calibration:
    """See `StaticInversion.calibrate`."""
    if not isinstance(records, list | tuple) or not records:
        raise InputError(
            "no records to calibrate with",
            where="calibrate",
            found=f"{type(records).__name__} of length {len(records) if hasattr(records, '__len__') else '?'}",
            expected="a list of readings",
            hint="calibrate([reading_1, reading_2, ...])",
        )
    given = [_read(family, r, i) for i, r in enumerate(records)]
    alone = [family.choose(family.pose(g)).lam for g in given]
    posed = family.pose(_together(given))
    joint = family.choose(posed)
    told = posed.noise.known and family.noise is None and family.model.noise is None
    positive = np.array([x for x in alone if x > 0] or [1.0])
    names = [g.name if g.data is not None else f"record {i + 1}" for i, g in enumerate(given)]
    return Calibration(
        lam=joint.lam,
        rule=joint.rule,
        records=tuple(names),
        alone=tuple(alone),
        spread=float(np.ptp(np.log10(positive))),
        verdict=joint.verdict,
        sigma_source=joint.sigma_source,
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        level=posed.noise.level if told else None,
    )


def _read(family: StaticInversion, record: Any, i: int) -> Readings:
    """Readings of one record; a refusal names it."""
    try:
        return readings(record, family.model, family.sensors)
    except InputError as error:
        raise InputError(
            error.what, where=f"calibrate, record {i + 1}", found=error.found, expected=error.expected, hint=error.hint
        ) from None


def _together(given: Sequence[Readings]) -> Readings:
    """All frames of all records as one sequence."""
    from ..estimate import Axis

    values = np.vstack([g.values for g in given])
    first = given[0]
    axis = Axis("frame", "", np.arange(float(len(values))))
    return Readings(values, first.rows, first.channels, axis, "records", "", data=first.data)
