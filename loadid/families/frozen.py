"""A frozen inverse: one matrix-vector product per reading, or a warm solver where there are constraints."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures import storage
from structures.errors import InputError
from structures.values import reals

from .readings import LARGEST
from .steady import Absolute, Steady

if TYPE_CHECKING:
    from .static import StaticInversion

KIND = "frozen inverse"


@dataclass(frozen=True, eq=False)
class Frozen:
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
                "the reading does not fit the frozen inverse",
                where="frozen",
                found=f"shape {y.shape}",
                expected=f"({len(self.sensors)},): {list(self.sensors)[:12]}",
            )
        if not (np.abs(y).max() <= LARGEST):  # also NaN
            self._refuse(y)
        if self.matrix is None:
            return self.solver(y, resultants)
        if resultants is not None:
            raise InputError(
                "this frozen inverse has no resultant constraint",
                where="frozen",
                found="resultants",
                expected="a reading alone",
                hint="freeze a family with constraints=[Resultant(...)]",
            )
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

    def save(self, path: str | os.PathLike) -> None:
        """Write an HDF5 file with checksums, whole or not at all.

        Raises
        ------
        InputError
            If constraints make it a solver, which a file does not hold.
        """
        if self.matrix is None:
            raise InputError(
                "constraints need the solver, which a file does not hold",
                where="frozen.save",
                found="a frozen solver",
                expected="an inverse without constraints",
                hint="save the model and the lambda, and freeze again",
            )
        tree = {k: v for k, v in vars(self).items() if k != "solver"}
        storage.write(path, {k: list(v) if isinstance(v, tuple) else v for k, v in tree.items()}, KIND)

    @classmethod
    def read(cls, path: str | os.PathLike) -> Frozen:
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
            f"NaN, infinity or a number above {LARGEST:g} in the reading",
            where="frozen",
            found=bad[:8],
            expected="a finite number per sensor",
            hint="freeze another inverse without the lost sensor",
        )


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
    posed = family.at_rest()
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


def _fixed(family: StaticInversion, posed: Steady) -> float:
    """The relative lambda that was calibrated or given."""
    if family.calibration is not None:
        return family.calibration.lam
    if isinstance(family.choice, Absolute):
        return family.choice.relative(posed.base)
    return float(family.choice)  # type: ignore[arg-type]
