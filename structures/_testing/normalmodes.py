"""Real shapes for poles that are known: the modes of a structure with proportional damping, with their errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from .modalfit import ABOVE_DAMPING, BELOW_DAMPING, FrfBand, ModalFit, outside, real_rows, root_of

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

ROUNDS = 6  # of shapes and participations in turn


@dataclass(frozen=True, eq=False)
class NormalFit:
    """Real modes of FRFs: ``sum_k shapes_k participation_k^T s^d / (s^2 - 2 Re(p_k) s + |p_k|^2)`` and the rest.

    Parameters
    ----------
    poles : array (modes,), complex
    participation : array (modes, references)
        The largest entry of each is 1.
    shapes : array (modes, outputs)
    rest : array (resonators, outputs, references)
        Of the modes outside the band, as `structures._testing.modalfit.resonator` answers.
    frequencies : array (resonators,)
        Theirs in Hz.
    low : array of bool (resonators,)
        Those below the band.
    covariance : array (outputs, references, unknowns, unknowns)
        Of residues and rest of each entry for given poles, as if entries shared no shape: rather too large.
    slope : array (outputs, references, unknowns, 2 modes)
        How these follow the real parts of the poles, and their imaginary parts.
    poles_covariance : array (2 modes, 2 modes)
    share : float
        Of the power of the FRFs that real shapes leave over, beyond what complex ones do.
    """

    poles: Complex
    participation: Real
    shapes: Real
    rest: Real
    frequencies: Real
    low: NDArray[np.bool_]
    covariance: Real
    slope: Real
    poles_covariance: Real
    share: float

    @property
    def rest_damping(self) -> Real:
        """Damping ratio of every resonator of the rest."""
        return np.where(self.low, BELOW_DAMPING, ABOVE_DAMPING)

    def variance(self, f: Real, derivative: int) -> Real:
        """Variance (lines, outputs, references) of the fitted FRF of a kind at f (Hz), by the errors of the fit."""
        s = np.asarray(2j * np.pi * f, complex)
        q, d = lines_of(s, self.poles, derivative), slopes_of(s, self.poles, derivative)
        ends = [*self.frequencies]
        g = _rest_lines(s, ends, self.low, derivative)
        columns = np.concatenate([q, g], axis=1)
        out = np.empty((len(f), self.shapes.shape[1], self.participation.shape[1]))
        for o, j in np.ndindex(*out.shape[1:]):
            own = d * np.tile(self.shapes[:, o] * self.participation[:, j], 2) + columns @ self.slope[o, j]
            out[:, o, j] = np.einsum("li,ij,lj->l", columns, self.covariance[o, j], columns.conj()).real
            out[:, o, j] += np.einsum("li,ij,lj->l", own, self.poles_covariance, own.conj()).real
        return np.maximum(out, 0.0)


def lines_of(s: Complex, p: Complex, derivative: int) -> Complex:
    """Response (lines, modes) of every mode of unit modal mass."""
    return np.asarray(s[:, None] ** derivative / (s[:, None] ** 2 - 2 * p.real * s[:, None] + np.abs(p) ** 2))


def slopes_of(s: Complex, p: Complex, derivative: int) -> Complex:
    """Its derivatives (lines, 2 modes) with respect to the real and the imaginary parts of the poles."""
    q = lines_of(s, p, derivative)
    base = q**2 / s[:, None] ** derivative if derivative == 0 else q * lines_of(s, p, 0)
    return np.asarray(np.concatenate([base * (2 * s[:, None] - 2 * p.real), -2 * base * p.imag], axis=1))


def _rest_lines(s: Complex, ends: list[float], low: NDArray[np.bool_], derivative: int) -> Complex:
    pairs = [(2 * np.pi * f, BELOW_DAMPING if below else ABOVE_DAMPING) for f, below in zip(ends, low, strict=True)]
    columns = [s**derivative / (s**2 + 2 * z * w * s + w**2) for w, z in pairs]
    return np.array(columns, complex).reshape(len(ends), len(s)).T


def normal(band: FrfBand, fit: ModalFit) -> NormalFit:
    """Real shapes and participations of the poles of a fit, by weighted least squares in turn."""
    references = fit.participation.shape[1]
    q, g = lines_of(band.s, fit.poles, band.derivative), outside(band, fit.rest)
    phase = 0.5 * np.angle(np.sum(fit.participation**2, axis=1))
    b = _turned((fit.participation * np.exp(-1j * phase[:, None])).real)
    for turn in range(ROUNDS if references > 1 else 1):
        shapes, rest, residual = _shapes(band, q, g, b)
        if references > 1 and turn < ROUNDS - 1:
            b = _turned(_participation(band, q, g, shapes, rest))
    covariance, slope = _errors(band, q, g, np.einsum("ko,kj->ojk", shapes, b), fit.poles)
    power = np.sum(np.abs(residual / band.std) ** 2)
    whole = float(np.sum(np.abs(band.H / band.std) ** 2))
    own = float(np.sum(np.abs(fit.residual / band.std) ** 2))
    inflation = max(1.0, 1.0 + 2.0 * float(np.sum(fit.correlation)))
    scale = max(float(power) / max(2 * residual.size - shapes.size - rest.size, 1), 0.0) * inflation
    return NormalFit(
        poles=fit.poles, participation=b, shapes=shapes, rest=rest,
        frequencies=np.array(fit.rest, float), low=np.array([w < band.f[0] for w in fit.rest], bool),
        covariance=covariance * scale, slope=slope, poles_covariance=fit.covariance,
        share=max(0.0, (float(power) - own) / whole),
    )  # fmt: skip


def _turned(b: Real) -> Real:
    top = b[np.arange(len(b)), np.argmax(np.abs(b), axis=1)]
    return b / np.where(top == 0, 1.0, top)[:, None]


def _columns(q: Complex, g: list[Complex], b: Real) -> Complex:
    """Columns (lines, references, unknowns) of one output."""
    lines, references = len(q), b.shape[1]
    rest = np.zeros((lines, references, len(g) * references), complex)
    for i, u in enumerate(g):
        for j in range(references):
            rest[:, j, i * references + j] = u
    return np.concatenate([q[:, None, :] * b.T[None], rest], axis=2)


def _shapes(band: FrfBand, q: Complex, g: list[Complex], b: Real) -> tuple[Real, Real, Complex]:
    """Shapes (modes, outputs), rest (resonators, outputs, references) and residual for given participations."""
    n, (_, outputs, references) = len(b), band.H.shape
    columns = _columns(q, g, b)
    x, residual = np.zeros((outputs, columns.shape[2])), np.empty_like(band.H)
    for o in range(outputs):
        w = 1 / band.std[:, o, :, None]
        rows = real_rows(columns * w)
        scale = np.linalg.norm(rows, axis=0)
        scale = np.where(scale > 0, scale, 1.0)
        data = real_rows(band.H[:, o, :, None] * w)[:, 0]
        x[o] = linalg.lstsq(rows / scale, data, cond=1e-12, check_finite=False)[0] / scale
        residual[:, o] = band.H[:, o] - columns @ x[o]
    rest = x[:, n:].reshape(outputs, len(g), references).transpose(1, 0, 2)
    return x[:, :n].T, rest, residual


def _errors(band: FrfBand, q: Complex, g: list[Complex], residues: Real, poles: Complex) -> tuple[Real, Real]:
    """Covariance of residue and rest of each entry at unit std, and how they follow the poles.

    Parameters
    ----------
    residues : array (outputs, references, modes)

    Returns
    -------
    covariance : array (outputs, references, unknowns, unknowns)
    slope : array (outputs, references, unknowns, 2 modes)
    """
    columns, moved = (
        np.concatenate([q, np.array(g).reshape(len(g), -1).T], axis=1),
        slopes_of(band.s, poles, band.derivative),
    )
    n, size = q.shape[1], columns.shape[1]
    covariance, slope = np.zeros((*residues.shape[:2], size, size)), np.zeros((*residues.shape[:2], size, 2 * n))
    for o, j in np.ndindex(*residues.shape[:2]):
        w = 1 / band.std[:, o, j, None]
        rows = real_rows(np.asarray(columns * w, complex))
        root = root_of(linalg.qr(rows, mode="r", check_finite=False)[0][:size])
        covariance[o, j] = root @ root.T
        own = real_rows(np.asarray(moved * np.tile(residues[o, j], 2) * w, complex))
        slope[o, j] = -root @ (root.T @ (rows.T @ own))
    return covariance, slope


def _participation(band: FrfBand, q: Complex, g: list[Complex], shapes: Real, rest: Real) -> Real:
    """Participations (modes, references) for given shapes."""
    b = np.zeros((len(shapes), band.H.shape[2]))
    left = band.H - np.einsum("il,ioj->loj", np.array(g).reshape(len(rest), len(band.f)), rest)
    for j in range(b.shape[1]):
        w = 1 / band.std[:, :, j, None]
        rows, data = real_rows(q[:, None, :] * shapes.T[None] * w), real_rows(left[:, :, j, None] * w)[:, 0]
        scale = np.linalg.norm(rows, axis=0)
        scale = np.where(scale > 0, scale, 1.0)
        b[:, j] = linalg.lstsq(rows / scale, data, cond=1e-12, check_finite=False)[0] / scale
    return b
