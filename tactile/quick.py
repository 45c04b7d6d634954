"""Maps at a lambda that is fixed: one product per frame, or a warm-started solver where the contact is."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loadid.families.static import StaticInversion
from structures.errors import InputError
from structures.flags import Flag

from .guards import maps as guards
from .inversion import Inverse, prepare
from .reading import Wrench
from .region import Pressed, RegionSolver

Array = NDArray[np.float64]
TOUCH = 0.05  # of the peak pressure of the unconstrained map: where the constrained one looks for contact
CLEAR = 2.0  # stds of the unconstrained map
MANY = 12  # markers from which one can be told to contradict the others
STRAYS = 20  # of them that are left out, at most


@dataclass(frozen=True, eq=False)
class Found:
    """What came of one frame: load (n,) and std, covariance of the resultant (6, 6), facts, flags."""

    load: Array
    std: Array
    wrench: Array
    facts: dict[str, Any]
    flags: list[Flag | None]


@dataclass(eq=False)
class QuickMap:
    """The frozen inverse of a sensor, with what it keeps from frame to frame.

    Parameters
    ----------
    family : StaticInversion
        At a calibrated or given lambda.
    resultant : array (6, n)
    places : array (n / 3, 3)
        Nodes that may be loaded (m).
    neighbours : sparse (n / 3, n / 3)
        Which of them share a cell.
    markers, axes : int
        How many, and how many readings each has; these come first.
    reach : float
        Radius (m) of the press whose recovery is told.
    about : array (3,)
        Middle of the surface.
    pressing : bool
        No pulling.
    friction : float or None
    """

    family: StaticInversion
    resultant: Array
    places: Array
    neighbours: Any
    markers: int
    axes: int
    reach: float
    about: Array
    pressing: bool = False
    friction: float | None = None
    _solver: RegionSolver | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        family = self.family
        lam = family.calibration.lam if family.calibration is not None else family.choice
        if not isinstance(lam, int | float):
            raise InputError(
                "lambda is not fixed yet", where="sensor", found=f"choice={lam!r}",
                expected="a calibration, or a relative lambda", hint="sensor.calibrate([press, press, ...])",
            )  # fmt: skip
        rule = "given" if family.calibration is None else family.calibration.rule
        self.inverse: Inverse = prepare(family, self.resultant, float(lam), rule)
        self.unseen = guards.unseen(self.inverse.recovery(self._press()))

    @property
    def constrained(self) -> bool:
        """Whether the map may not pull, or not leave its friction cone."""
        return self.pressing or self.friction is not None

    def __call__(self, y: Array, wrench: Wrench | None = None) -> Found:
        """Map of readings (m,), NaN where one is lost."""
        inverse, (y, strays) = self.inverse, self._without_strays(y)
        answer = inverse(y, None if self.constrained else wrench)
        load, std, covariance, path = answer.load, answer.std, answer.wrench, "frozen inverse"
        flags: list[Flag | None] = [self.unseen, guards.strays(strays)]
        if self.constrained:
            found = self.pressed(y, wrench, load, std)
            load, std, covariance = found.load, found.std, found.wrench
            path = f"active sets on the contact region, {found.steps} steps"
            flags.append(guards.stopped(found.converged, found.steps))
        elif wrench is None:
            hidden = inverse.hidden(load)
            flags.append(guards.taken(hidden, inverse.resultant @ load, covariance))
            covariance = covariance + np.outer(hidden, hidden)  # what the penalty takes is in the band
        lost = int(np.sum(~np.isfinite(y)))
        facts = {
            "path": path,
            "m": len(y) - lost,
            "n": len(load),
            "lost": lost,
            "strays": strays,
            "lambda": inverse.lam,
            "lambda_rule": inverse.rule,
        }
        return Found(load, std, covariance, facts, flags)

    def pressed(
        self, y: Array, wrench: Wrench | None = None, load: Array | None = None, std: Array | None = None
    ) -> Pressed:
        """The map that only presses, looked for where the unconstrained one (load, std) does.

        Raises
        ------
        InputError
            For penalties that couple loads.
        """
        if load is None or std is None:
            answer = self.inverse(y)
            load, std = answer.load, answer.std
        pressure, spread = -load[2::3], std[2::3]
        touched = (pressure > TOUCH * pressure.max()) & (pressure > CLEAR * spread)
        return self._region.solve(y / self.inverse.spread, touched, wrench)

    @property
    def _region(self) -> RegionSolver:
        if self._solver is None:
            if self.family.L is not None:
                raise InputError(
                    "constrained maps at a fixed lambda take the identity as their penalty",
                    where="penalty", found=self.family.penalty, expected="'identity'",
                    hint="leave lambda to be chosen per frame, or leave the constraints out",
                )  # fmt: skip
            inverse = self.inverse
            prior = np.full(inverse.shape[0], inverse.lam * inverse.scale)
            H = self.family.H[: inverse.shape[1]] / inverse.spread[:, None]  # markers first, depth after them
            self._solver = RegionSolver(H, prior, inverse.resultant, self.neighbours, self.friction)
        return self._solver

    def _without_strays(self, y: Array) -> tuple[Array, int]:
        """Readings without those of markers that contradict all others: a dot taken for its neighbour."""
        if self.markers < MANY:
            return y, 0
        found = 0
        while found < STRAYS and (stray := self.inverse.stray(y, self.markers, self.axes)) is not None:
            found += 1
            y = y.copy()
            y[stray * self.axes : (stray + 1) * self.axes] = np.nan
        return y, found

    def _press(self) -> Array:
        """A plain press in the middle of the surface (n,), of no particular size."""
        press = np.zeros((len(self.places), 3))
        press[:, 2] = -np.exp(-np.sum((self.places[:, :2] - self.about[:2]) ** 2, axis=1) / self.reach**2)
        return press.ravel()
