"""From modes to discrete time, exact under the hold, mode by mode; and the same states in continuous time.

Van Loan's augmented matrix exponential of every mode (2 states, its force and the slope of its force) gives transition
and input matrices that are right from rigid-body modes to modes far above the sampling frequency; the closed forms lose
all digits for small ``omega h``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from ..errors import InputError, real, shown
from .reduction import FLOATS, ReducedModel

if TYPE_CHECKING:
    from .._model import Model

HOLDS = ("foh", "zoh")


@dataclass(frozen=True)
class ModalRecurrence:
    """One small discrete system per mode, each driven by its own modal force ``g``.

    ``x_{k+1} = A x_k + (G1 - G2) g_k + G2 g_{k+1}``, ``y = c x + d g``; with a zero-order hold ``G2 = 0``.
    States: scaled displacement ``omega q`` (``q`` of a rigid mode), velocity, and, with a corner, the filter's.

    Parameters
    ----------
    A : array (k, s, s)
    G1, G2 : array (k, s)
    c : array (k, s)
    d : float
    """

    A: NDArray[np.float64]
    G1: NDArray[np.float64]
    G2: NDArray[np.float64]
    c: NDArray[np.float64]
    d: float

    @property
    def B(self) -> NDArray[np.float64]:
        """Input of the causal form (k, s): the state is shifted by ``G2 g``."""
        return np.asarray(self.G1 + np.einsum("kst,kt->ks", self.A, self.G2) - self.G2)

    @property
    def D(self) -> NDArray[np.float64]:
        """Feedthrough of the causal form (k,)."""
        return np.asarray(np.einsum("ks,ks->k", self.c, self.G2) + self.d)


def check(dt: float, hold: str) -> None:
    """Refuse a step that is not positive and a hold that is not ``"foh"`` or ``"zoh"``."""
    step = real(dt)
    if step is None or step <= 0:
        raise InputError(
            "the step must be positive",
            where="dt",
            found=shown(dt),
            expected="seconds, > 0",
            hint="dt = 1 / sampling rate in Hz",
        )
    if hold not in HOLDS:
        raise InputError(
            "no such hold",
            where="hold",
            found=repr(hold),
            expected="'foh' (the load is linear between samples) or 'zoh' (it is constant over a sample)",
            hint="'foh' fits a sampled smooth load",
        )


def own(model: Model, dt: float, hold: str | None, what: str, hint: str) -> None:
    """Refuse (`what`, `hint`) another step or hold than those at which a model exists; no hold means its own."""
    same = np.ndim(dt) == 0 and np.isfinite(dt) and model.dt is not None and abs(dt - model.dt) <= 1e-9 * model.dt
    if not same or hold not in (None, model.default_hold):
        raise InputError(
            what,
            where=type(model).__name__,
            found=f"dt={dt!r}, hold={hold!r}",
            expected=f"dt={model.dt:g}, hold={model.default_hold!r}",
            hint=hint,
        )


def blocks(
    lam: NDArray[np.float64],
    c: NDArray[np.float64],
    dt: float,
    hold: str,
    *,
    derivative: int = 0,
    corner: float = 0.0,
) -> ModalRecurrence:
    """Discrete system of every mode, seen through one kind of sensor.

    Parameters
    ----------
    lam, c : array (k,)
        Squared circular frequency and damping 2 zeta omega of every mode.
    dt : float
        Step in s.
    hold : ``"foh"`` or ``"zoh"``
    derivative : 0, 1 or 2
        What the sensor reads of the modal coordinate.
    corner : float
        High-pass corner of the sensor in Hz; 0 for none.

    Returns
    -------
    ModalRecurrence
        With 2 states per mode, or 3 where there is a corner.
    """
    k, s = len(lam), 3 if corner > 0 else 2
    w = np.sqrt(lam) * dt
    # Time in steps, states q / dt^2 and dq/dt / dt: for a slow mode, every entry of the result is of order one.
    F = np.zeros((k, s + 2, s + 2))
    F[:, 0, 1] = 1.0
    F[:, 1, 0], F[:, 1, 1], F[:, 1, s] = -(w**2), -c * dt, 1.0
    F[:, s, s + 1] = 1.0
    out = np.empty((k, s))
    out[:, 0] = np.where(lam > 0, w * dt, dt**2)
    out[:, 1] = dt
    if corner > 0:
        a, zero = 2 * np.pi * corner * dt, np.zeros(k)
        seen, out[:, 2] = (
            ((zero + 1, zero, zero), dt**2),
            ((zero, zero + 1, zero), dt),
            ((-(w**2), -c * dt, zero + 1), 1.0),
        )[derivative]
        F[:, 2, 0], F[:, 2, 1], F[:, 2, 3], F[:, 2, 2] = a * seen[0], a * seen[1], a * seen[2], -a
    E = linalg.expm(F)
    A = E[:, :s, :s] * out[:, :, None] / out[:, None, :]
    G1, G2 = E[:, :s, s] * out, E[:, :s, s + 1] * out
    rows = np.zeros((k, s))
    rows[:, :2], feed = output_rows(lam, c, derivative)
    if corner > 0:
        rows[:, 2] = -1.0
    return ModalRecurrence(A, G1, G2 if hold == "foh" else np.zeros_like(G2), rows, feed)


def output_rows(lam: NDArray[Any], c: NDArray[Any], derivative: int) -> tuple[NDArray[np.float64], float]:
    """What a sensor reads of the state ``(omega q, dq/dt)`` (k, 2), and of the modal force."""
    omega = np.sqrt(lam)
    one, zero = np.ones_like(omega), np.zeros_like(omega)
    pair = (
        (np.where(lam > 0, 1 / np.where(lam > 0, omega, 1.0), 1.0), zero),
        (zero, one),
        (-omega, -c),
    )[derivative]
    return np.stack(pair, axis=1), float(derivative == 2)


def filter_step(corner: float, dt: float, hold: str) -> tuple[float, float, float]:
    """Low-pass state of a high-pass sensor driven by a feedthrough: its decay over a step, `G1` and `G2`."""
    a = 2 * np.pi * corner * dt
    E = linalg.expm(np.array([[-a, a, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]))
    return float(E[0, 0]), float(E[0, 1]), float(E[0, 2]) if hold == "foh" else 0.0


@dataclass(frozen=True)
class ModalSystem:
    """The whole reduced model in discrete time, before the loads: driven by modal forces and by feedthroughs.

    States: two per mode, then one per sensor with a corner.

    Parameters
    ----------
    A : array (nx, nx)
    G1, G2 : array (nx, k)
    R1, R2 : array (nx, sensors)
        How the feedthrough of the residual enters the filter states.
    C, D : array (sensors, nx), (sensors, k)
    """

    A: NDArray[np.float64]
    G1: NDArray[np.float64]
    G2: NDArray[np.float64]
    R1: NDArray[np.float64]
    R2: NDArray[np.float64]
    C: NDArray[np.float64]
    D: NDArray[np.float64]


def discretise(
    reduced: ReducedModel, dt: float, hold: str
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Matrices ``A, B, C, D`` of the causal discrete system, exact under the hold.

    Parameters
    ----------
    reduced : ReducedModel
    dt : float
        Step in s.
    hold : ``"foh"`` or ``"zoh"``

    Returns
    -------
    A (nx, nx), B (nx, loads), C (sensors, nx), D (sensors, loads)
        B and D with a leading time axis where a load moves.
    """
    check(dt, hold)
    modal = _separate(reduced, dt, hold) if reduced.proportional else _coupled(reduced, dt, hold)
    R = feedthrough(reduced)
    G1, G2 = modal.G1 @ reduced.B + modal.R1 @ R, modal.G2 @ reduced.B + modal.R2 @ R
    return modal.A, G1 + modal.A @ G2 - G2, modal.C, modal.C @ G2 + modal.D @ reduced.B + R


def feedthrough(reduced: ReducedModel) -> NDArray[np.float64]:
    """Residual as a feedthrough (..., sensors, loads): displacement and strain only, it has no finite derivative."""
    shape = (*reduced.B.shape[:-2], len(reduced.S), reduced.B.shape[-1])
    if reduced.residual is None:
        return np.zeros(shape)
    return np.broadcast_to(np.where(reduced.derivative[:, None] == 0, reduced.residual, 0.0), shape)


def _layout(reduced: ReducedModel) -> tuple[int, NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Number of states, filtered sensors, output matrix and feedthrough of the modal forces."""
    k, m = len(reduced.lam), len(reduced.S)
    filtered = np.flatnonzero(reduced.corner > 0)
    C, D = np.zeros((m, 2 * k + len(filtered))), np.zeros((m, k))
    c = reduced.damping if reduced.proportional else np.zeros(k)
    for d in np.unique(reduced.derivative):
        s = np.flatnonzero(reduced.derivative == d)
        rows, feed = output_rows(reduced.lam, c, int(d))
        C[s, : 2 * k] = (reduced.S[s][:, :, None] * rows).reshape(len(s), -1)
        D[s] = feed * reduced.S[s]
        if d == 2 and not reduced.proportional:
            C[s, 1 : 2 * k : 2] = -reduced.S[s] @ reduced.damping
    C[filtered, 2 * k + np.arange(len(filtered))] = -1.0
    return C.shape[1], filtered, C, D


def _separate(reduced: ReducedModel, dt: float, hold: str) -> ModalSystem:
    """Mode by mode: a 2x2 block each, and the rows of the filters."""
    lam, c, k = reduced.lam, reduced.damping, len(reduced.lam)
    n, filtered, C, D = _layout(reduced)
    A, G1, G2 = np.zeros((n, n)), np.zeros((n, k)), np.zeros((n, k))
    R1, R2 = np.zeros((n, len(reduced.S))), np.zeros((n, len(reduced.S)))
    free = blocks(lam, c, dt, hold)
    i = 2 * np.arange(k)
    for a in range(2):
        G1[i + a, np.arange(k)], G2[i + a, np.arange(k)] = free.G1[:, a], free.G2[:, a]
        for b in range(2):
            A[i + a, i + b] = free.A[:, a, b]
    for row, s in enumerate(filtered, start=2 * k):
        seen = blocks(lam, c, dt, hold, derivative=int(reduced.derivative[s]), corner=float(reduced.corner[s]))
        A[row, : 2 * k] = (reduced.S[s][:, None] * seen.A[:, 2, :2]).ravel()
        G1[row], G2[row] = reduced.S[s] * seen.G1[:, 2], reduced.S[s] * seen.G2[:, 2]
        A[row, row], R1[row, s], R2[row, s] = filter_step(float(reduced.corner[s]), dt, hold)
    return ModalSystem(A, G1, G2, R1, R2, C, D)


def _coupled(reduced: ReducedModel, dt: float, hold: str) -> ModalSystem:
    """Damping couples the modes: one exponential of the small system, filters included."""
    k, m = len(reduced.lam), len(reduced.S)
    n, filtered, C, D = _layout(reduced)
    omega = np.sqrt(reduced.lam)
    inputs = k + len(filtered)
    F = np.zeros((n + 2 * inputs, n + 2 * inputs))
    i = 2 * np.arange(k)
    F[i, i + 1] = np.where(reduced.lam > 0, omega, 1.0)
    F[i + 1, i] = -omega
    F[1 : 2 * k : 2, 1 : 2 * k : 2] = -reduced.damping
    F[i + 1, n + np.arange(k)] = 1.0
    for j, s in enumerate(filtered):
        a = 2 * np.pi * reduced.corner[s]
        F[2 * k + j, : 2 * k], F[2 * k + j, n : n + k] = a * C[s, : 2 * k], a * D[s]
        F[2 * k + j, 2 * k + j], F[2 * k + j, n + k + j] = -a, a
    F *= dt
    F[n : n + inputs, n + inputs :] = np.eye(inputs)
    E = linalg.expm(F)
    G1, G2 = E[:n, n : n + inputs], E[:n, n + inputs :] * (hold == "foh")
    R1, R2 = np.zeros((n, m)), np.zeros((n, m))
    R1[:, filtered], R2[:, filtered] = G1[:, k:], G2[:, k:]
    return ModalSystem(E[:n, :n], G1[:, :k], G2[:, :k], R1, R2, C, D)


def markov(reduced: ReducedModel, dt: float, hold: str, samples: int) -> NDArray[np.float64]:
    """Markov parameters (samples, sensors, loads) of `discretise`, by powers of the small blocks.

    The damping must be proportional and no load may move.
    """
    check(dt, hold)
    k, (m, p) = len(reduced.lam), (len(reduced.S), reduced.B.shape[1])
    h = np.zeros((samples, m, p))
    R = feedthrough(reduced)
    kinds = np.stack([reduced.derivative, reduced.corner], axis=1)
    step = max(1, FLOATS // (3 * samples))
    for d, fc in np.unique(kinds, axis=0):
        s = np.flatnonzero((reduced.derivative == d) & (reduced.corner == fc))
        for a in range(0, k, step):
            part = slice(a, a + step)
            system = blocks(reduced.lam[part], reduced.damping[part], dt, hold, derivative=int(d), corner=float(fc))
            outer = (reduced.S[s, part].T[:, :, None] * reduced.B[part, None, :]).reshape(-1, len(s) * p)
            h[:, s] += (sequence(system, samples).T @ outer).reshape(samples, len(s), p)
        h[:, s] += _filtered_feedthrough(float(fc), dt, hold, samples)[:, None, None] * R[s]
    return h


def sequence(system: ModalRecurrence, samples: int) -> NDArray[np.float64]:
    """``D, cB, cAB, ...`` of every block (k, samples): each pass doubles what is known."""
    k, s = system.c.shape
    x = np.empty((k, s, max(samples - 1, 1)))
    x[:, :, 0] = system.B
    power, known = system.A, 1
    while known < samples - 1:
        more = min(known, samples - 1 - known)
        x[:, :, known : known + more] = power @ x[:, :, :more]
        power, known = power @ power, known + more
    out = np.empty((k, samples))
    out[:, 0] = system.D
    out[:, 1:] = (system.c[:, None, :] @ x)[:, 0, : samples - 1]
    return out


def _filtered_feedthrough(corner: float, dt: float, hold: str, samples: int) -> NDArray[np.float64]:
    """Response (samples,) of a sensor's high-pass to a feedthrough of one."""
    out = np.zeros(samples)
    out[0] = 1.0
    if corner > 0:
        decay, g1, g2 = filter_step(corner, dt, hold)
        out[0] -= g2
        out[1:] = -(g1 + decay * g2 - g2) * decay ** np.arange(samples - 1)
    return out


def continuous(reduced: ReducedModel) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Matrices of ``dx/dt = A x + B p``, ``y = C x + D p``.

    States: ``omega q`` (``q`` of a rigid mode) and ``dq/dt`` of every mode, then the low-pass of every sensor with a
    corner.

    Parameters
    ----------
    reduced : ReducedModel

    Returns
    -------
    A (nx, nx) in 1/s, B (nx, loads), C (sensors, nx), D (sensors, loads)

    Raises
    ------
    InputError
        If a load moves, or the damping is structural.
    """
    if reduced.moving or reduced.loss != 0:
        raise InputError("the model has no constant matrices in continuous time", where="continuous",
                         found="a load that moves" if reduced.moving else f"structural damping {reduced.loss:g}",
                         expected="loads that stay in place, damping that is a matrix or modal",
                         hint="a modal ratio of half the loss has the same peaks")  # fmt: skip
    filtered = np.flatnonzero(reduced.corner > 0)
    k, m, p = len(reduced.lam), len(reduced.S), reduced.B.shape[1]
    n, place, speed = 2 * k + len(filtered), 2 * np.arange(k), 2 * np.arange(k) + 1
    omega = np.sqrt(reduced.lam)
    unit = np.where(reduced.lam > 0, omega, 1.0)  # of the first state, against q
    damping = np.diag(reduced.damping) if reduced.proportional else reduced.damping
    A, B, C, D = np.zeros((n, n)), np.zeros((n, p)), np.zeros((m, n)), np.array(feedthrough(reduced))
    A[place, speed], A[speed, place] = unit, -omega
    A[np.ix_(speed, speed)] = -damping
    B[speed] = reduced.B
    q, v, a = (reduced.derivative == d for d in range(3))
    C[np.ix_(q, place)] = reduced.S[q] / unit
    C[np.ix_(v, speed)] = reduced.S[v]
    C[a] = reduced.S[a] @ A[speed]
    D[a] = reduced.S[a] @ reduced.B
    for row, s in enumerate(filtered, start=2 * k):
        pole = 2 * np.pi * reduced.corner[s]
        A[row], B[row] = pole * C[s], pole * D[s]
        A[row, row], C[s, row] = -pole, -1.0
    return A, B, C, D
