"""Many static readings: one lambda for all, a frozen inverse, frames on their own; whether they determine it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._readonly import ReadOnly
from structures.errors import InputError, reals
from structures.files import _storage as storage

from .. import _guards as guards
from .._inverse.posterior import FramesPosterior
from .._results.estimate import Axis, LoadEstimate
from ..settings import Absolute
from .data import LARGEST, Readings, readings, rows_of
from .posing.steady import StaticProblem

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
            "no records to calibrate with", where="calibrate",
            found=f"{type(records).__name__} of length {len(records) if hasattr(records, '__len__') else '?'}",
            expected="a list of readings", hint="calibrate([reading_1, reading_2, ...])",
        )  # fmt: skip
    given = [_read(family, r, i) for i, r in enumerate(records)]
    alone = [family.choose(family.pose(g)).lam for g in given]
    posed = family.pose(_together(given))
    joint = family.choose(posed)
    told = posed.noise.known and not family.noise.stated and family.model.noise is None
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
    values = np.vstack([g.values for g in given])
    first = given[0]
    axis = Axis("frame", "", np.arange(float(len(values))))
    return Readings(values, first.rows, first.channels, axis, "records", "", data=first.data)


KIND = "frozen inverse"


@dataclass(frozen=True, eq=False)
class Frozen(ReadOnly):
    """A static inverse at a fixed lambda. Immutable; ``frozen(y)`` gives the loads of one reading.

    Parameters
    ----------
    matrix : array, shape (loads, sensors), or None
        Loads per unit reading; None where constraints need a solver.
    std : array, shape (loads,), or None
        Posterior standard deviation of the loads (without constraints); None where the noise level is not known.
    lam, scale : float
        Relative lambda, and the scale that makes it absolute.
    rule, date, delta_source : str
        How and when lambda was chosen; where the noise level comes from.
    sensors, loads, units : tuple of str
        Labels of readings and loads, units of the loads.
    model : str
        Fingerprint of the forward model.
    solver : object or None
        Where there are constraints.
    """

    matrix: NDArray[np.float64] | None
    std: NDArray[np.float64] | None
    lam: float
    scale: float
    rule: str
    date: str
    delta_source: str
    sensors: tuple[str, ...]
    loads: tuple[str, ...]
    units: tuple[str, ...]
    model: str
    solver: Any = None

    def __call__(self, y: ArrayLike, resultants: Sequence[ArrayLike] | None = None) -> NDArray[np.float64]:
        """Loads (loads,) of one reading (sensors,).

        Parameters
        ----------
        y : array, shape (sensors,)
        resultants : sequence of array, optional
            New values of the resultant constraints, in their order: a force/torque sensor that is read with the others.

        Raises
        ------
        InputError
            If the reading does not fit or holds NaN, or resultants are given where none is a constraint.
        """
        if type(y) is not np.ndarray or y.dtype.kind != "f":
            y = reals(y, what="the reading is no real numbers", where="frozen")
        if y.shape != (len(self.sensors),):
            raise InputError(
                "the reading does not fit the frozen inverse", where="frozen", found=f"shape {y.shape}",
                expected=f"({len(self.sensors)},): {list(self.sensors)[:12]}",
            )  # fmt: skip
        if not (np.abs(y).max() <= LARGEST):  # also NaN
            self._refuse(y)
        if self.matrix is None:
            return np.asarray(self.solver(y, resultants))
        if resultants is not None:
            raise InputError(
                "this frozen inverse has no resultant constraint", where="frozen", found="resultants",
                expected="a reading alone", hint="freeze a family with constraints=[Resultant(...)]",
            )  # fmt: skip
        return self.matrix @ y

    def __str__(self) -> str:
        how = (
            "one matrix-vector product per reading"
            if self.matrix is not None
            else "constraints: a warm-started solver per reading, no longer one product"
        )
        return (
            f"frozen inverse of {self.date[:10]}: {len(self.sensors)} sensors to {len(self.loads)} loads, relative "
            f"lambda {self.lam:.3g} ({self.rule}; noise level: {self.delta_source}); {how}"
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an HDF5 file with checksums, whole or not at all.

        Raises
        ------
        InputError
            If constraints make it a solver, which a file does not hold.
        """
        if self.matrix is None:
            raise InputError(
                "constraints need the solver, which a file does not hold", where="frozen.save",
                found="a frozen solver", expected="an inverse without constraints",
                hint="save the model and the lambda, and freeze again",
            )  # fmt: skip
        tree = {k: v for k, v in vars(self).items() if k != "solver"}
        storage.write(path, {k: list(v) if isinstance(v, tuple) else v for k, v in tree.items()}, KIND)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Frozen:
        """Read what `save` wrote.

        Raises
        ------
        InputError
            If the file is missing, of another kind, or damaged.
        """
        tree: dict[str, Any] = storage.read(path, KIND)
        try:
            settled: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in tree.items()}
            return cls(**settled)
        except TypeError as error:
            raise InputError(
                "its content is not what this release expects", where=str(path), found=str(error), expected=KIND
            ) from None

    def _refuse(self, y: NDArray[np.float64]) -> None:
        bad = [label for label, value in zip(self.sensors, y, strict=True) if not abs(value) <= LARGEST]
        raise InputError(
            f"NaN, infinity or a number above {LARGEST:g} in the reading", where="frozen", found=bad[:8],
            expected="a finite number per sensor", hint="freeze another inverse without the lost sensor",
        )  # fmt: skip


def freeze(family: StaticInversion) -> Frozen:
    """See `StaticInversion.freeze`."""
    fixed = family.calibration is not None or isinstance(family.choice, int | float | Absolute)
    if not fixed:
        raise InputError(
            "lambda is not fixed yet",
            where="freeze",
            found=f"choice={family.choice!r}",
            expected="a relative lambda, or a calibration",
            hint="calibrate([...]) with several records first: a lambda chosen anew per frame makes frames "
            "incomparable",
        )
    posed = at_rest(family)
    lam = _fixed(family, posed)
    known = posed.base.solution(lam, posed.noise.sigma).posterior
    matrix, solver = None, None
    if posed.constrained:
        solver = posed.solver(lam)
    else:
        matrix = np.ascontiguousarray(posed.inverse(lam))
    return Frozen(
        matrix=matrix,
        std=None if known is None else known.std,
        lam=lam,
        scale=float(posed.base.scale),
        rule="given" if family.calibration is None else family.calibration.rule,
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        delta_source=posed.noise.source.text if family.calibration is None else family.calibration.sigma_source,
        sensors=tuple(c.label for c in posed.channels),
        loads=tuple(c.label for c in family.model.loads),
        units=tuple(c.unit for c in family.model.loads),
        model=family.model.fingerprint,
        solver=solver,
    )


def at_rest(family: StaticInversion) -> StaticProblem:
    """The problem without readings: what a frozen inverse is made of.

    Raises
    ------
    InputError
        If sensors of several units, or sensors and measured resultants, have no noise levels: nothing says how
        they weigh.
    """
    rows = rows_of(family.sensors, family.model)
    channels = tuple(family.model.sensors[i] for i in rows)
    told = None if family.calibration is None else family.calibration.level
    stated = family.noise.stated or told is not None or family.model.noise is not None
    # readings of zero are in the range of any noise; without a noise level they would have no scale
    values = np.zeros((1, len(rows))) if stated else np.ones((1, len(rows)))
    posed = family.pose(Readings(values, rows, channels, None, "none", ""), told)
    if not posed.noise.known and posed.soft:
        raise _unweighed("measured resultants weigh against the noise of the sensors, which is not known", "no level")
    if not posed.noise.known and len(units := {c.unit for c in channels}) > 1:
        raise _unweighed("sensors of several units have no noise levels: nothing says how they weigh", sorted(units))
    return posed


def _unweighed(what: str, found: object) -> InputError:
    return InputError(what, where="freeze", found=found, expected="noise= per sensor",
                      hint="state the noise in the model (noise= of each sensor) or here")  # fmt: skip


def _fixed(family: StaticInversion, posed: StaticProblem) -> float:
    """The relative lambda that was calibrated or given."""
    if family.calibration is not None:
        return family.calibration.lam
    if isinstance(family.choice, Absolute):
        return family.choice.relative(posed.base)
    return float(family.choice)


def each_frame(family: StaticInversion, given: Readings) -> LoadEstimate:
    """One estimate of several frames, each with its own lambda (flag W409).

    The choice, the diagnosis and the other facts are those of the last frame.
    """
    singles = []
    for row in given.values:
        one = replace(given, values=row[None], axis=None)
        posed = family.pose(one)
        singles.append(family.answer(one, posed, family.choose(posed)))
    last = singles[-1]
    lams = [e.choice.lam for e in singles if e.choice is not None]
    bias = None if last.bias is None else np.stack([e.bias for e in singles if e.bias is not None])
    flags = [f for e in singles for f in e.flags if f.code != "LID-N303"] + [f for f in last.flags if "N303" in f.code]
    unique = {f.code: f for f in flags}
    return replace(
        last,
        load=np.stack([e.load for e in singles]),
        std=np.stack([e.std for e in singles]),
        bias=bias,
        axis=given.axis,
        response=given.values,
        residual=np.stack([e.residual for e in singles if e.residual is not None]),
        posterior=FramesPosterior([e.posterior for e in singles]),
        flags=guards.collect([guards.changing_lambda(lams), *unique.values()]),
        facts=replace(last.facts, frames=len(singles)),
    )
