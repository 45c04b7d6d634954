"""Validation of an estimate against references of every kind, and the level that they reach."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from structures.errors import InputError
from structures.flags import Flag

from .. import flags as guards
from ..estimate import LoadEstimate
from ..flags.validation import NECESSARY
from ..inverse.constraints import Resultant
from ..record import Record
from .checks import Check, DistributionCheck, ResultantCheck, SensorCheck, from_dict, to_dict
from .held_out import HeldOut
from .pairs import against_known, against_mat, against_wrench
from .references import Known, PressureMat, Wrench

LEVELS = ("none", "held-out sensors", "resultant", "distribution")


@dataclass(frozen=True)
class Validation:
    """What an estimate was compared with, and how far that reaches.

    Parameters
    ----------
    checks : tuple of SensorCheck, ResultantCheck or DistributionCheck
    flags : tuple of Flag
        N701 where resultants alone were compared, W704 where a reference was used in the inversion.
    date : str
        ISO date and time, UTC.

    Attributes
    ----------
    level : str
        ``"none"`` < ``"held-out sensors"`` < ``"resultant"`` < ``"distribution"``: the highest with a check.
    agrees : bool
        Every check agrees within its limits, which the classes of the checks name.
    """

    checks: tuple[Check, ...] = ()
    flags: tuple[Flag, ...] = ()
    date: str = ""

    @property
    def level(self) -> str:
        """Highest level at which there is a check."""
        return LEVELS[max((LEVELS.index(c.kind) for c in self.checks), default=0)]

    @property
    def agrees(self) -> bool:
        """Every check agrees; false where there is none."""
        return bool(self.checks) and all(c.agrees for c in self.checks)

    @property
    def partial(self) -> bool:
        """The checks leave the distribution open."""
        return any(f.code == "LID-N701" for f in self.flags) or self.level in LEVELS[:2]

    @property
    def resultants(self) -> tuple[ResultantCheck, ...]:
        """Checks of resultants."""
        return tuple(c for c in self.checks if isinstance(c, ResultantCheck))

    @property
    def distributions(self) -> tuple[DistributionCheck, ...]:
        """Checks of distributions."""
        return tuple(c for c in self.checks if isinstance(c, DistributionCheck))

    @property
    def sensors(self) -> tuple[SensorCheck, ...]:
        """Checks on held-out sensors."""
        return tuple(c for c in self.checks if isinstance(c, SensorCheck))

    def __str__(self) -> str:
        if not self.checks:
            return "level: none"
        text = f"level: {self.level}" + (", partial" if self.partial else "") + ("" if self.agrees else ", disagrees")
        parts = [f"{_source(c)}{c}" for c in self.checks]
        parts += [NECESSARY for f in self.flags if f.code == "LID-N701"]
        return f"{text}. " + ". ".join(parts)

    def table(self) -> str:
        """One line for each check, as text."""
        rows = [(c.kind, c.source, "agrees" if c.agrees else "disagrees", str(c)) for c in self.checks]
        wide = [max((len(r[i]) for r in rows), default=0) for i in range(3)]
        lines = ["  ".join([*(x.ljust(w) for x, w in zip(r, wide, strict=False)), r[3]]) for r in rows]
        return "\n".join([f"level reached: {self.level}{' (partial)' if self.partial else ''}", *lines])

    def to_dict(self) -> dict[str, Any]:
        """Plain texts, numbers and lists, for files."""
        return {
            "level": self.level,
            "checks": [to_dict(c) for c in self.checks],
            "flags": [f.to_dict() for f in self.flags],
            "date": self.date,
        }

    @classmethod
    def from_dict(cls, tree: Mapping[str, Any]) -> Validation:
        """Inverse of `to_dict`."""
        checks = tuple(from_dict(c) for c in tree["checks"])
        return cls(checks, tuple(Flag.from_dict(f) for f in tree["flags"]), str(tree["date"]))


def validate(estimate: LoadEstimate, *references: Any, level: float = 0.95) -> Validation:
    """Hold an estimate of any family against what is known of the load, and say at which level that validates it.

    Parameters
    ----------
    estimate : LoadEstimate
    *references
        One or more of: `Known`, `PressureMat` (distribution); `Wrench`, or a resultant constraint with ``C`` and
        ``value`` (resultant); the answer of `held_out` (held-out sensors). An array, a function of the places, a pair
        ``(coordinates, values)`` and a Record with channels named as the loads are taken as `Known`.
    level : float
        Probability of the band whose coverage is counted.

    Returns
    -------
    Validation
        ``estimate.validated(validation)`` keeps it with the result.

    Raises
    ------
    InputError
        No reference, shapes or units that do not fit, NaN, a reference that is zero.

    Notes
    -----
    A resultant is a few well-conditioned numbers of a distribution: agreement there is necessary, and not sufficient.
    """
    if not isinstance(estimate, LoadEstimate):
        raise InputError(
            "no estimate", where="validate", found=type(estimate).__name__, expected="a LoadEstimate",
            hint="validate(family.estimate(...), reference)",
        )  # fmt: skip
    if estimate.load.dtype.kind == "c":
        raise InputError(
            "complex loads have no level", where="validate", found="a load over frequency", expected="a real load",
            hint="transform it to time first",
        )  # fmt: skip
    if not references:
        raise InputError(
            "nothing to validate against", where="validate", found="no reference",
            expected="a known load, a pressure mat, a wrench or held-out sensors",
            hint="validate(estimate, Wrench(value, std=...)), for example",
        )  # fmt: skip
    if isinstance(level, bool) or not isinstance(level, int | float) or not 0 < level < 1:
        raise InputError(
            "no probability", where="level", found=repr(level), expected="between 0 and 1", hint="level=0.95"
        )
    checks: list[Check] = []
    raised: list[Flag | None] = []
    known = 0  # independent numbers of the load that the resultants fix
    for reference in map(_settled, references):
        if isinstance(reference, HeldOut):
            checks.append(SensorCheck(reference.labels, reference.error, reference.noise_ratio, "held-out sensors"))
            raised += reference.flags
        elif isinstance(reference, Wrench):
            check, rank = against_wrench(estimate, reference)
            checks, known = [*checks, check], max(known, rank)
            raised.append(_imposed(estimate))
        elif isinstance(reference, PressureMat):
            cells, rank = against_mat(estimate, reference, level)
            checks, known = [*checks, cells], max(known, rank)
        else:
            checks += against_known(estimate, reference, level)
    kinds = {c.kind for c in checks}
    raised.append(guards.resultant_only(kinds, known, estimate.load.shape[-1]))
    return Validation(tuple(checks), guards.collect(raised), datetime.now(UTC).isoformat(timespec="seconds"))


def _settled(reference: Any) -> Known | PressureMat | Wrench | HeldOut:
    """The reference as one of the four kinds."""
    if isinstance(reference, Known | PressureMat | Wrench | HeldOut):
        return reference
    if isinstance(reference, Record):
        return Known(reference, source=reference.name or reference.source or "a record")  # type: ignore[arg-type]
    if hasattr(reference, "C") and hasattr(reference, "value"):  # a constraint of the inversion, or its like
        return _wrench(reference)
    if isinstance(reference, tuple) and len(reference) == 2 and not any(_scalar(r) for r in reference):
        return Known(reference[1], coordinates=reference[0])
    return Known(reference)


def _wrench(constraint: Any) -> Wrench:
    import numpy as np

    covariance = getattr(constraint, "covariance", None)
    std = None if covariance is None else np.sqrt(np.diagonal(np.atleast_2d(np.asarray(covariance, float))))
    return Wrench(constraint.value, std, tuple(getattr(constraint, "labels", ())), constraint.C)


def _scalar(x: Any) -> bool:
    return not callable(x) and not isinstance(x, Sequence) and getattr(x, "ndim", 0) == 0


def _imposed(estimate: LoadEstimate) -> Flag | None:
    """W704: the resultant was a constraint of this very inversion."""
    settings = estimate.provenance.get("settings") or {}
    kinds = settings.get("constraint_kinds") or () if isinstance(settings, Mapping) else ()
    return guards.used_for_training("the resultant", {"resultant constraint"} if Resultant.__name__ in kinds else set())


def _source(check: Check) -> str:
    return f"{check.source}: " if check.source and check.source != check.kind else ""
