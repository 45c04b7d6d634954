"""Maps at a lambda that is fixed: one product per frame, or a warm-started solver where the contact is."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loadid.families.static import StaticInversion
from structures.errors import InputError
from structures.flags import Flag

from .consistency import Consistency
from .guards import maps as guards
from .inversion import Answer, Inverse, prepare
from .reading import Wrench
from .region import Pressed, RegionSolver, carried

Array = NDArray[np.float64]
TOUCH = 0.05  # of the peak pressure of the unconstrained map: where the constrained one looks for contact
CLEAR = 2.0  # stds of the unconstrained map


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
    markers : array (N, 2)
        Their places (m); their readings come first.
    axes : int
        Readings of each marker.
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
    markers: Array
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
        self.consistency = Consistency(self.inverse, self.markers, self.axes)
        self.recovery = self.inverse.recovery(self._press())

    @property
    def constrained(self) -> bool:
        """Whether the map may not pull, or not leave its friction cone."""
        return self.pressing or self.friction is not None

    def __call__(self, y: Array, wrench: Wrench | None = None) -> Found:
        """Map of readings (m,), NaN where one is lost."""
        inverse = self.inverse
        y, strays, misfit = self.consistency.checked(y)
        answer = inverse(y, None if self.constrained else wrench)
        load, std, covariance, path = answer.load, answer.std, answer.wrench, "frozen inverse"
        flags: list[Flag | None] = [guards.strays(strays), guards.misfit(misfit)]
        if wrench is None:
            hidden = inverse.hidden(load)
            flags += [guards.unseen(self.recovery), guards.taken(hidden, inverse.resultant @ load, covariance)]
            covariance = covariance + np.outer(hidden, hidden) + self._blind(inverse.resultant @ load)
        if self.constrained:
            found = self.pressed(y, wrench, answer)
            load, std = found.load, found.std
            covariance = found.wrench if wrench is not None or found.touched else covariance
            path = f"active sets on the contact region, {found.steps} steps"
            flags.append(guards.stopped(found.converged, found.steps))
        wide = max(1.0, misfit)  # as far as the markers contradict their noise, so does the map
        std, covariance = wide * std, wide**2 * covariance
        lost = int(np.sum(~np.isfinite(y)))
        facts = {
            "path": path,
            "m": len(y) - lost,
            "n": len(load),
            "lost": lost,
            "strays": strays,
            "misfit": misfit,
            "lambda": inverse.lam,
            "lambda_rule": inverse.rule,
        }
        return Found(load, std, covariance, facts, flags)

    def pressed(self, y: Array, wrench: Wrench | None = None, answer: Answer | None = None) -> Pressed:
        """The map that only presses, looked for where the unconstrained answer does.

        Raises
        ------
        InputError
            For penalties that couple loads; a resultant that no contact of this friction carries.
        """
        if wrench is not None:
            carried(wrench, self.friction)
        answer = self.inverse(y) if answer is None else answer
        pressure, spread = -answer.load[2::3], answer.std[2::3]
        touched = pressure > TOUCH * pressure.max()
        if wrench is None:
            touched &= pressure > CLEAR * spread
        return self._region.solve(y / self.inverse.spread, touched, wrench, answer)

    def _blind(self, resultant: Array) -> Array:
        """Variance of a normal force that the readings hardly see: as large as what they may hide."""
        out = np.zeros((6, 6))
        if self.recovery < guards.SEEN:
            out[2, 2] = (resultant[2] * (1 / max(self.recovery, 1e-3) - 1)) ** 2
        return out

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

    def _press(self) -> Array:
        """A plain press in the middle of the surface (n,), of no particular size."""
        press = np.zeros((len(self.places), 3))
        press[:, 2] = -np.exp(-np.sum((self.places[:, :2] - self.about[:2]) ** 2, axis=1) / self.reach**2)
        return press.ravel()
