"""A structure at a step with the priors of its loads: from sample to sample, or jointly in continuous time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.continuous import continuous
from structures.errors import InputError
from structures.model import Model, as_model
from structures.values import positive, shown

from .priors import Companion, Prior, diagonal
from .quadrature import step
from .roots import lower

HOLDS = ("foh", "zoh", "joint")
SINGULAR = 1e13  # condition above which a structure has no static state

Parts = tuple[NDArray, NDArray, NDArray, NDArray]


@dataclass(frozen=True, eq=False)
class Matrices:
    """Matrices of a structure at a step: discrete, or under the joint hold continuous.

    Under the first-order hold of a model with modes those in continuous time (A, B) stand in `rates` beside.
    """

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]
    D: NDArray[np.float64]
    dt: float
    hold: str
    rates: tuple[NDArray, NDArray] | None = None

    @classmethod
    def of(cls, model: Any, dt: float, hold: str | None) -> Matrices:
        """Those of a model; refused by name where it has none that stay."""
        model = as_model(model, "augment", "state_space")
        hold = model.default_hold if hold is None else hold
        if hold not in HOLDS:
            raise InputError("no such hold", where="hold", found=shown(hold), expected=", ".join(map(repr, HOLDS)),
                             hint="'foh' fits a sampled smooth load, 'joint' one with a Matern prior")  # fmt: skip
        if hold == "joint":
            return cls(*_continuous(model), positive("the step", dt, where="dt", unit="s"), hold)
        known = model.state_space(dt, hold)
        if known.moving:
            raise InputError("a load that moves has no filter of constant matrices", where="augment", found="B(t)",
                             expected="loads that stay in place",
                             hint="put a basis of fixed loads along its way")  # fmt: skip
        return cls(known.A, known.B, known.C, known.D, known.dt, hold, _rates(model) if hold == "foh" else None)

    def static(self) -> NDArray[np.float64]:
        """States in equilibrium with constant loads of one (nx, loads)."""
        rest = -self.A if self.hold == "joint" else np.eye(len(self.A)) - self.A
        if len(rest) and np.linalg.cond(rest) > SINGULAR:
            raise InputError("the structure never settles under a constant load", where="start='static'",
                             found=f"a motion that nothing resists (condition {np.linalg.cond(rest):.1g})",
                             expected="a supported structure", hint="start it with stds of its states")  # fmt: skip
        return np.asarray(np.linalg.solve(rest, self.B), float)

    def held(self, priors: Sequence[Prior]) -> Parts:
        """F and LQ (of x and z), reading of the loads and their start.

        A prior with a length says how its load runs between the samples; the first-order hold takes it for straight.
        What the load does beside disturbs the structure, where it is known in continuous time.
        """
        known = [prior.discrete(self.dt) for prior in priors]
        Fz, LQz, H, L0 = (diagonal([getattr(k, name) for k in known]) for name in ("F", "LQ", "H", "L0"))
        F = np.block([[self.A, self.B @ H], [np.zeros((len(Fz), len(self.A))), Fz]])
        rest = np.hstack([self._beside(prior, load) for load, prior in enumerate(priors)])
        LQ = diagonal([rest, LQz])
        return F, LQ, H, L0

    def displaced(self, model: Model) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Displacements where and as the loads act, of the states (loads, nx) and of the loads (loads, loads).

        Those of the modes: what the modes left out add under a static load is not among them.
        """
        rates = _rates(model)
        if rates is None:
            raise InputError(f"{type(model).__name__} knows no displacement at its loads", where="dummy",
                             found="no modes", expected="a model with modes, as ForwardModel has them",
                             hint="a displacement sensor of the model that is zero does the same")  # fmt: skip
        omega = np.sqrt(model.reduced.lam)
        C = np.zeros((rates[1].shape[1], len(self.A)))
        C[:, 2 * np.arange(len(omega))] = rates[1][1 : 2 * len(omega) : 2].T / np.where(omega > 0, omega, 1.0)
        if self.hold != "foh":
            return C, np.zeros((len(C), len(C)))
        return C, C @ np.hstack([self._pushed(rates[0], b[:, None])[1] for b in rates[1].T])

    def _pushed(self, A: NDArray, b: NDArray) -> tuple[NDArray, NDArray]:
        """What a load does to the states at the end of a step (nx, 1): with its value before it, and after it."""
        n, line = len(A), np.diag([1.0], 1)  # of the load: a value and a slope
        held, ramp = _exponential(self.dt * np.block([[A, b, 0 * b], [np.zeros((2, n)), line]]))[:n, n:].T[:, :, None]
        return held - ramp / self.dt, ramp / self.dt

    def _beside(self, prior: Prior, load: int) -> NDArray[np.float64]:
        """Root of what a load does to the states within a step beside its straight line (nx, any), in the long run.

        From one step to the next it is correlated a little, and with the noise of the load: taken as white it makes
        the band cautious, not its mean better (the joint hold does both).
        """
        n = len(self.A)
        if self.rates is None or not isinstance(prior, Companion):
            return np.zeros((n, 0))
        A, b, known = self.rates[0], self.rates[1][:, [load]], prior.continuous()
        size, (early, late) = len(known.F), self._pushed(A, b)
        rates = np.block([[A, b @ known.H], [np.zeros((size, n)), known.F]])
        E, L = step(rates, np.vstack([np.zeros((n, known.b.shape[1])), known.b]), self.dt)
        straight = early @ known.H + late @ known.H @ E[n:, n:]
        return lower(L[:n] - late @ known.H @ L[n:], (E[:n, n:] - straight) @ known.L0)

    def jointly(self, priors: Sequence[Prior]) -> Parts:
        """The same from one system in continuous time."""
        known = [prior.continuous() for prior in priors]
        for prior in priors:
            prior.discrete(self.dt)  # what the step cannot carry is refused by the prior
        Fz, b, H, L0 = (diagonal([getattr(k, name) for k in known]) for name in ("F", "b", "H", "L0"))
        rates = np.block([[self.A, self.B @ H], [np.zeros((len(Fz), len(self.A))), Fz]])
        pushes = np.vstack([np.zeros((len(self.A), b.shape[1])), b])
        return *step(rates, pushes, self.dt), H, L0


def _continuous(model: Model) -> Parts:
    """Matrices in continuous time of a model that has modes."""
    if model.reduced is None:
        raise InputError(f"{type(model).__name__} exists from sample to sample only: it has no joint hold",
                         where="hold", found="'joint'", expected=f"hold={model.default_hold!r}",
                         hint="'joint' needs a model with modes, as ForwardModel has them")  # fmt: skip
    return continuous(model.reduced)


def _rates(model: Model) -> tuple[NDArray, NDArray] | None:
    """A and B in continuous time of a model that has modes and constant matrices; None of any other."""
    if model.reduced is None or model.reduced.moving or model.reduced.loss != 0:
        return None
    return continuous(model.reduced)[:2]


def _exponential(A: NDArray) -> NDArray[np.float64]:
    from scipy.linalg import expm

    return np.asarray(expm(A))


def held_over(A: NDArray, B: NDArray, dt: float) -> NDArray[np.float64]:
    """State that a load of one, held over a step, leaves behind."""
    n, p = B.shape
    return _exponential(dt * np.block([[A, B], [np.zeros((p, n + p))]]))[:n, n:]
