"""The reduced model: a structure seen from its sensors and loads through a few modes and a static residual."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import NotIdentifiable
from .factor import MECHANISM
from .modes import Modes

ON_RESONANCE = 1e-12  # share of omega^2 that an eigenvalue and its square root keep: nearer is on the resonance
FLOATS = 4_000_000  # largest scratch array of a sweep


@dataclass(frozen=True)
class ReducedModel:
    """A structure seen from its sensors and loads through a few modes.

    Parameters
    ----------
    lam : array (k,)
        Squared circular frequencies; 0 marks a rigid-body mode.
    damping : array (k,) or (k, k)
        Modal damping 2 zeta omega, or the full projected matrix.
    S : array (sensors, k)
        Modal sensor rows, before any time derivative.
    B : array (k, loads) or (samples, k, loads)
        Modal load columns; a leading time axis where a load moves.
    residual : array (sensors, loads) or (samples, sensors, loads), or None
        Static response of the modes left out, before any derivative.
    derivative : int array (sensors,)
        0 displacement and strain, 1 velocity, 2 acceleration.
    corner : array (sensors,)
        Corner of the first-order high-pass in Hz; 0 = none.
    loss : float
        Structural loss factor; where it is not 0 the model has frequency responses only.
    """

    lam: NDArray[np.float64]
    damping: NDArray[np.float64]
    S: NDArray[np.float64]
    B: NDArray[np.float64]
    residual: NDArray[np.float64] | None
    derivative: NDArray[np.int64]
    corner: NDArray[np.float64]
    loss: float = 0.0

    @property
    def moving(self) -> bool:
        """A load moves."""
        return self.B.ndim == 3

    @property
    def proportional(self) -> bool:
        """The damping is diagonal in the modes."""
        return self.damping.ndim == 1

    @property
    def decay_rate(self) -> float:
        """Slowest decay rate (1/s) that a sensor sees; 0 where something never decays. Loss as at resonance."""
        rates = [2 * np.pi * fc for fc in self.corner if fc > 0]
        elastic = self.lam > 0
        if not self.proportional:
            k = len(self.lam)
            damping = self.damping + np.diag(self.loss * np.sqrt(self.lam))
            A = np.block([[np.zeros((k, k)), np.eye(k)], [-np.diag(self.lam), -damping]])
            s = np.linalg.eigvals(A)
            rates.append(float(np.min(-s.real)) if np.all(elastic) else 0.0)
            return max(min(rates), 0.0)
        lam = self.lam[elastic]
        c = self.damping[elastic] + self.loss * np.sqrt(lam)
        root = np.sqrt(np.maximum(c**2 / 4 - lam, 0.0))
        # overdamped: the slow root lam / (c/2 + root) without cancellation; undamped: exactly 0
        slow = root > 0
        rates.extend(np.where(slow, lam / np.where(slow, c / 2 + root, 1.0), c / 2))
        for k in np.flatnonzero(~elastic).tolist():
            # A free body keeps its place and, undamped, its velocity; an accelerometer sees the load alone.
            for d in self.derivative[self.S[:, k] != 0]:
                if d < 2 or self.damping[k] > 0:
                    rates.append(0.0 if d == 0 else float(self.damping[k]))
        return float(min(rates, default=0.0))

    def frf(self, frequencies: NDArray[np.float64]) -> NDArray[np.complex128]:
        """Frequency response (lines, sensors, loads), high-pass included; the residual counts in every row.

        Raises
        ------
        NotIdentifiable
            If a line (Hz) lies on a natural frequency without damping.
        """
        omega = 2 * np.pi * frequencies
        H = self._proportional(omega) if self.proportional else self._coupled(omega)
        if not np.all(np.isfinite(H)):
            line = int(np.flatnonzero(~np.isfinite(H).all(axis=(1, 2)))[0])
            raise unbounded(frequencies[line], self.lam)
        return H * highpass(frequencies, self.corner)[:, :, None]

    def _proportional(self, omega: NDArray) -> NDArray[np.complex128]:
        lines, (m, k), p = len(omega), self.S.shape, self.B.shape[1]
        H = np.empty((lines, m, p), dtype=complex)
        elastic = self.lam > 0
        rows = max(1, FLOATS // max(1, k * p))
        step = max(1, FLOATS // max(1, k))
        flexible = 1 / self._stiffening(omega)
        for d in (int(x) for x in np.unique(self.derivative)):
            sensors = np.flatnonzero(self.derivative == d)
            for a in range(0, lines, step):
                w = modal_weights(omega[a : a + step], self.lam, self.damping, elastic, d, self.loss)
                unbounded = np.argwhere(np.isnan(w))
                w[np.isnan(w)] = 0.0
                for b in range(0, len(sensors), rows):
                    s = sensors[b : b + rows]
                    outer = (self.S[s].T[:, :, None] * self.B[:, None, :]).reshape(k, -1)
                    part = w.real @ outer + 1j * (w.imag @ outer)
                    for i, mode in unbounded:
                        part[i, outer[mode] != 0] = np.nan
                    part = part.reshape(len(w), len(s), p)
                    if self.residual is not None:
                        rest = (1j * omega[a : a + step]) ** d * flexible[a : a + step]
                        part += rest[:, None, None] * self.residual[s]
                    H[a : a + step, s] = part
        return H

    def _coupled(self, omega: NDArray) -> NDArray[np.complex128]:
        k = len(self.lam)
        H = np.empty((len(omega), len(self.S), self.B.shape[1]), dtype=complex)
        step = max(1, FLOATS // k**2)
        for a in range(0, len(omega), step):
            w = omega[a : a + step, None, None]
            stiff = self._stiffening(w) * np.diag(self.lam)
            D = stiff - w**2 * np.eye(k) + 1j * w * self.damping
            lost = np.array([self._unbounded(d, w0) for d, w0 in zip(D, omega[a : a + step], strict=True)])
            D[lost] = np.eye(k)
            H[a : a + step] = self.S @ np.linalg.solve(D, np.broadcast_to(self.B, (len(D), *self.B.shape)))
            H[a : a + step][lost] = np.nan
        if self.residual is not None:
            H += self.residual / self._stiffening(omega)[:, None, None]
        return H * (1j * omega[:, None, None]) ** self.derivative[:, None]

    def _stiffening(self, omega: NDArray) -> NDArray[np.complex128]:
        """What structural damping makes of a stiffness of one: ``1 + i loss``, and 1 at rest."""
        return np.asarray(1 + 1j * self.loss * (omega > 0), complex)

    def _unbounded(self, D: NDArray, omega: float) -> bool:
        """Whether the dynamic stiffness is singular to rounding; only near an undamped frequency can it be."""
        if np.abs(self.lam - omega**2).min() > 1e-6 * omega**2:
            return False
        if omega == 0:  # the static limit: a rigid-body mode is among them
            return True
        scale = 1 / np.maximum(np.sqrt(self.lam), omega)
        return bool(np.linalg.svd(scale[:, None] * D * scale, compute_uv=False)[-1] <= ON_RESONANCE)


def on_resonance(omega: float, lam: NDArray) -> bool:
    """Whether a line (rad/s) lies on an undamped natural frequency, to rounding."""
    return bool(np.any(np.abs(lam - omega**2) <= ON_RESONANCE * lam))


def unbounded(frequency: float, lam: NDArray) -> NotIdentifiable:
    """The refusal of a line (Hz) at which the response is unbounded; names the mode that has it."""
    k = int(np.argmin(np.abs(lam - (2 * np.pi * frequency) ** 2)))
    natural = float(np.sqrt(lam[k]) / (2 * np.pi))
    why = f"it is the natural frequency of mode {k + 1} ({natural:.9g} Hz), which has no damping"
    return NotIdentifiable(
        f"the response at {frequency:.6g} Hz is unbounded: "
        + (why if natural > 0 else "nothing resists the rigid-body motion there"),
        advice="leave this line out, add damping (damping=0.01), or support the structure",
        code=MECHANISM,
    )


def modal_weights(
    omega: NDArray, lam: NDArray, c: NDArray, elastic: NDArray[np.bool_], derivative: int, loss: float = 0.0
) -> NDArray[np.complex128]:
    """Frequency response of every mode (lines, k) to a unit modal force, differentiated; its limit for rigid modes."""
    jw = 1j * omega[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        stiffness = lam * (1 + 1j * loss * (omega[:, None] > 0)) + jw**2 + jw * c
        w = jw**derivative / np.where(np.abs(stiffness) <= ON_RESONANCE * lam, np.nan, stiffness)
        for k in np.flatnonzero(~elastic).tolist():
            # One factor j omega cancels, so that the acceleration of a free body is right down to 0 Hz.
            u = jw[:, 0]
            if derivative == 0:
                w[:, k] = 1 / (u * (u + c[k]))
            else:
                w[:, k] = np.ones_like(u) if derivative == 2 and c[k] == 0 else u ** (derivative - 1) / (u + c[k])
    w[~np.isfinite(w)] = np.nan
    return w


def highpass(frequencies: NDArray, corner: NDArray) -> NDArray[np.complex128]:
    """First-order high-pass ``j f / (fc + j f)`` of every sensor (lines, sensors); 1 where there is no corner."""
    f = frequencies[:, None]
    return np.where(corner > 0, 1j * f / np.where(corner > 0, corner + 1j * f, 1.0), 1.0)


def static_residual(
    shapes: Modes, S: Any, B: Any, modal_S: NDArray, modal_B: NDArray, static: NDArray | None = None
) -> NDArray[np.float64]:
    """Static response of the modes left out (sensors, loads).

    Parameters
    ----------
    S, B : sparse (sensors, n_free), (n_free, loads)
    modal_S, modal_B : array (sensors, k), (k, loads)
    static : array (sensors, loads), optional
        ``S K^-1 B`` where it is known already (supported structure).
    """
    full = shapes.factor.transfer(S, B) if static is None else static
    return full - (modal_S / (shapes.lam - shapes.shift)) @ modal_B
