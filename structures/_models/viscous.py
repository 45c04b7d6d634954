"""Complex modes as a system of first order: what a structure with any viscous damping answers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from .reduction import highpass

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class ComplexModes:
    """``x' = p x + l u`` for every pole, and displacements ``2 Re(psi x)``, in real coordinates two states each.

    Parameters
    ----------
    poles : array (modes,), complex
        rad/s, one of each pair.
    shapes : array (sensors, modes), complex
        Before any time derivative.
    participation : array (modes, loads), complex
    derivative : int array (sensors,)
        0 displacement and strain, 1 velocity, 2 acceleration.
    corner : array (sensors,)
        Corner of the first-order high-pass in Hz; 0 = none.

    Notes
    -----
    P. Lancaster, *Lambda-Matrices and Vibrating Systems* (1966): the receptance of ``M s^2 + C s + K`` is
    ``sum_k psi_k psi_k^T / (s - p_k)`` and its conjugate, whatever C is. All modes together give displacements no jump,
    ``Re sum_k psi_k l_k^T = 0``; modes of a band do so nearly, and no jump is given to them.
    """

    poles: Complex
    shapes: Complex
    participation: Complex
    derivative: NDArray[np.int64]
    corner: Real

    def frf(self, frequencies: Real) -> Complex:
        """Frequency response (lines, sensors, loads), high-pass included."""
        s = 2j * np.pi * frequencies[:, None]
        H = np.zeros((len(s), len(self.shapes), self.participation.shape[1]), complex)
        for p, S, B in ((self.poles, self.shapes, self.participation), tuple(x.conj() for x in self._complex)):
            for d in np.unique(self.derivative):
                own = self.derivative == d
                H[:, own] += np.einsum("lk,sk,kj->lsj", p**d / (s - p) + (p if d == 2 else 0), S[own], B)
        return H * highpass(frequencies, self.corner)[:, :, None]

    @property
    def _complex(self) -> tuple[Complex, Complex, Complex]:
        return self.poles, self.shapes, self.participation

    def static(self) -> Real:
        """Response of displacements at rest (sensors, loads)."""
        return np.asarray(-2 * np.einsum("sk,kj->sj", self.shapes / self.poles, self.participation).real)

    def continuous(self) -> tuple[Real, Real, Real, Real]:
        """Matrices ``A, B, C, D`` in continuous time: two states for each mode, one for each high-pass."""
        n, (m, _), loads = len(self.poles), self.shapes.shape, self.participation.shape[1]
        filtered = np.flatnonzero(self.corner > 0)
        size = 2 * n + len(filtered)
        A, B, C = np.zeros((size, size)), np.zeros((size, loads)), np.zeros((m, size))
        a, b = 2 * np.arange(n), 2 * np.arange(n) + 1
        A[a, a] = A[b, b] = self.poles.real
        A[b, a], A[a, b] = self.poles.imag, -self.poles.imag
        B[a], B[b] = self.participation.real, self.participation.imag
        seen = self.shapes * self.poles ** self.derivative[:, None]
        C[:, a], C[:, b] = 2 * seen.real, -2 * seen.imag
        D = 2 * ((self.shapes * self.poles) @ self.participation).real * (self.derivative == 2)[:, None]
        rate = 2 * np.pi * self.corner[filtered]
        own = 2 * n + np.arange(len(filtered))
        A[own, : 2 * n], B[own] = rate[:, None] * C[filtered, : 2 * n], rate[:, None] * D[filtered]
        A[own, own], C[filtered, own] = -rate, -1.0
        return A, B, C, D

    def discrete(self, dt: float, hold: str) -> tuple[Real, Real, Real, Real]:
        """Matrices ``A, B, C, D`` of the causal discrete system, exact under the hold (Van Loan's exponential)."""
        A, B, C, D = self.continuous()
        n, loads = B.shape
        whole = np.zeros((n + 2 * loads, n + 2 * loads))
        whole[:n, :n], whole[:n, n : n + loads] = A * dt, B * dt
        whole[n : n + loads, n + loads :] = np.eye(loads)
        E = linalg.expm(whole)
        step, held, ramp = E[:n, :n], E[:n, n : n + loads], E[:n, n + loads :]
        if hold != "foh":
            return step, held, C, D
        return step, held + step @ ramp - ramp, C, C @ ramp + D

    def perturbed(self, parameter: str, factor: float) -> ComplexModes:
        """The same with stiffness, mass, damping or gain multiplied, as real modes of these poles would be."""
        if parameter == "gain":
            return replace(self, shapes=self.shapes * factor)
        lam, c = np.abs(self.poles) ** 2, -2 * self.poles.real
        if parameter in ("stiffness", "mass"):
            lam = lam * factor if parameter == "stiffness" else lam / factor
        if parameter in ("damping", "mass"):
            c = c * factor if parameter == "damping" else c / factor
        poles = -c / 2 + 1j * np.sqrt(np.maximum(lam - c**2 / 4, np.finfo(float).tiny))
        size = self.poles.imag / poles.imag / (factor if parameter == "mass" else 1.0)
        return replace(self, poles=poles, participation=self.participation * size[:, None])
