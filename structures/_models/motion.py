"""The motion of a whole structure under a load history, exact between samples, and how well it obeys its equation."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._system.damping import Modal, causal, loss_factor
from .._system.factor import Factor
from .._system.structure import Structure
from ..errors import InputError, plain, positive, reals
from .discretise import blocks, check
from .forward import ForwardModel

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion of every DOF under a load, at rest before its first sample.

    Parameters
    ----------
    structure : Structure
    dt : float
        Step in s.
    shapes : array (n, modes)
        Mode shapes over all DOFs, zero at the supports.
    lam, damping : array (modes,)
        Squared circular frequencies and modal damping ``2 zeta omega``.
    q, qd, qdd : array (samples, modes)
        Modal displacement, velocity and acceleration.
    forces : array (samples, n)
        The load on every DOF.
    """

    structure: Structure
    dt: float
    shapes: Array = field(repr=False)
    lam: Array = field(repr=False)
    damping: Array = field(repr=False)
    q: Array = field(repr=False)
    qd: Array = field(repr=False)
    qdd: Array = field(repr=False)
    forces: Array = field(repr=False)

    @property
    def displacement(self) -> Array:
        """Of every DOF in the order of the table (samples, n): m, rad."""
        return self.q @ self.shapes.T

    @property
    def velocity(self) -> Array:
        """Of every DOF (samples, n): m/s, rad/s."""
        return self.qd @ self.shapes.T

    @property
    def acceleration(self) -> Array:
        """Of every DOF (samples, n): m/s^2, rad/s^2."""
        return self.qdd @ self.shapes.T

    def along(self, direction: int = 3) -> NDArray[np.intp]:
        """DOFs that point along an axis (3: Z), by node."""
        return np.array([i for i, dof in enumerate(self.structure.dofs) if abs(dof.direction) == direction], np.intp)

    def imbalance(self) -> float:
        """Relative residual of ``M a + C v + K u = f`` over the record, in the energy norm.

        ``sqrt(sum r^T K^-1 r / sum f^T K^-1 f)``: the deflections that residual and load would cause, weighed alike
        whatever the units of a DOF. The matrices are those of the structure, not of its modes; where the model keeps
        fewer modes than the structure has, the equation is that of these modes.
        """
        s, phi = self.structure, self.shapes[self.structure.free]
        u, v, a = (phi @ x.T for x in (self.q, self.qd, self.qdd))
        mass = s.M_free
        assert mass is not None  # it moves
        resisted = mass @ (phi @ (self.damping[:, None] * (phi.T @ (mass @ v)))) if s.C_free is None else s.C_free @ v
        load = self.forces[:, s.free].T
        residual = mass @ a + resisted + s.K_free @ u - load
        elastic = self.lam[self.lam > 0]
        weight = 1 / np.sqrt(np.maximum(self.lam, elastic.min() if len(elastic) else 1.0))[:, None]
        size = float(np.linalg.norm(weight * (phi.T @ load)))
        found = float(np.linalg.norm(weight * (phi.T @ residual)))
        return found / size if size > 0 else found


def motion(model: ForwardModel, load: ArrayLike, dt: float, hold: str = "foh") -> Motion:
    """Motion of the whole structure under the loads of a model.

    Mode by mode, exact for a load that is linear (or constant) between its samples: displacement, velocity and
    acceleration obey the equation of motion of the retained modes at every sample.

    Parameters
    ----------
    model : ForwardModel
        Its sensors do not matter. For the equation of motion of the structure itself keep all of its modes.
    load : array (samples, loads)
    dt : float
        Step in s.
    hold : ``"foh"`` or ``"zoh"``

    Raises
    ------
    InputError
        If the load does not fit or holds NaN, a load moves over the structure, or the damping couples the modes.

    Notes
    -----
    The recursion is that of `structures._models.discretise`; R. R. Craig, A. J. Kurdila, *Fundamentals of Structural
    Dynamics*, 2nd ed. (2006), section 16.1.
    """
    check(dt, hold)
    g = reals(load, where="motion", what="the load is no array of numbers")
    causal(model.structure.damping, "motion")
    if model.moving or not model.reduced.proportional:
        raise InputError(
            "the motion is computed mode by mode",
            where="motion",
            found="a load that moves" if model.moving else "damping that couples the modes",
            expected="loads that stay in place, Rayleigh or modal damping",
            hint="model.state_space(dt).simulate() takes both",
        )
    if g.ndim != 2 or g.shape[1] != len(model.loads) or len(g) == 0 or not np.all(np.isfinite(g)):
        raise InputError("the load does not fit the model", where="motion", found=f"shape {g.shape}, or not finite",
                         expected=f"finite, (samples, {len(model.loads)})", hint="one column per load")  # fmt: skip
    reduced, s = model.reduced, model.structure
    push = g @ reduced.B.T
    q, qd = _advance(reduced.lam, reduced.damping, push, float(dt), hold)
    acceleration = push - reduced.damping * qd - reduced.lam * q
    forces = np.zeros((len(g), s.n))
    forces[:, s.free] = (model.columns @ g.T).T
    return Motion(s, float(dt), s.expand(model.modes.phi), reduced.lam, reduced.damping, q, qd, acceleration, forces)


def _advance(lam: Array, c: Array, push: Array, dt: float, hold: str) -> tuple[Array, Array]:
    """Modal displacement and velocity (samples, modes) under the modal forces `push`, from rest."""
    step = blocks(lam, c, dt, hold)
    x, states = step.G2 * push[0][:, None], np.empty((len(push), *step.A.shape[:2]))
    before, after = step.G1 - step.G2, step.G2
    states[0] = x
    for k in range(1, len(push)):
        x = np.einsum("kst,kt->ks", step.A, x) + before * push[k - 1][:, None] + after * push[k][:, None]
        states[k] = x
    scale = np.where(lam > 0, np.sqrt(lam), 1.0)
    return states[..., 0] / scale, states[..., 1]


@dataclass(frozen=True, eq=False)
class HarmonicMotion:
    """Complex motion of every DOF under loads on one frequency line.

    Parameters
    ----------
    structure : Structure
    frequency : float
        Hz.
    displacement : array (n,), complex
        m, rad.
    forces : array (n,), complex
        The load on every DOF.
    """

    structure: Structure
    frequency: float
    displacement: NDArray[np.complex128] = field(repr=False)
    forces: NDArray[np.complex128] = field(repr=False)

    @property
    def velocity(self) -> NDArray[np.complex128]:
        """Of every DOF (n,): m/s, rad/s."""
        return 2j * np.pi * self.frequency * self.displacement

    def along(self, direction: int = 3) -> NDArray[np.intp]:
        """DOFs that point along an axis (3: Z), by node."""
        return np.array([i for i, dof in enumerate(self.structure.dofs) if abs(dof.direction) == direction], np.intp)

    def imbalance(self) -> float:
        """Relative residual of ``(K + i omega C - omega^2 M) u = f`` over the free DOFs, forces and moments each."""
        s, omega = self.structure, 2 * np.pi * self.frequency
        assert s.M_free is not None  # it moves
        u, f = self.displacement[s.free], self.forces[s.free]
        terms = [(1 + 1j * loss_factor(s.damping)) * (s.K_free @ u), -(omega**2) * (s.M_free @ u), f]
        if s.C_free is not None:
            terms.insert(0, 1j * omega * (s.C_free @ u))
        turns = np.array([3 < abs(s.dofs[i].direction) <= 6 for i in s.free])
        residual, found = sum(terms[:-1]) - f, 0.0
        for part in (turns, ~turns):
            largest = max(float(np.linalg.norm(term[part])) for term in terms)
            found = max(found, float(np.linalg.norm(residual[part])) / largest if largest > 0 else 0.0)
        return found


def harmonic_motion(model: ForwardModel, load: ArrayLike, frequency: float) -> HarmonicMotion:
    """Motion of the whole structure under complex loads (loads,) on one line (Hz): one sparse solve.

    Raises
    ------
    InputError
        If the load does not fit, a load moves over the structure, or its damping is no matrix.
    """
    f, s = positive("frequency", frequency, where="harmonic_motion", unit="Hz"), model.structure
    g = np.asarray(plain(load), complex).reshape(-1)
    if model.moving or s.M_free is None or isinstance(s.damping, Modal):
        raise InputError("one solve needs matrices that stay", where="harmonic_motion",
                         found="a load that moves, no mass, or modal damping",
                         expected="fixed loads, mass, and Rayleigh damping or C",
                         hint="model.frf([frequency]) with a displacement sensor at every node takes them")  # fmt: skip
    if g.shape != (len(model.loads),) or not np.all(np.isfinite(g)):
        raise InputError("the load does not fit the model", where="harmonic_motion", found=f"shape {g.shape}",
                         expected=f"finite, ({len(model.loads)},)")  # fmt: skip
    omega, forces = 2 * np.pi * f, model.columns @ g
    dynamic = (1 + 1j * loss_factor(s.damping)) * s.K_free - omega**2 * s.M_free
    dynamic = dynamic if s.C_free is None else dynamic + 1j * omega * s.C_free
    u = Factor(dynamic, check=False).solve(forces)
    return HarmonicMotion(s, f, np.asarray(s.expand(u), complex), np.asarray(s.expand(forces), complex))
