"""Shapes for poles that are known, real or complex, and the errors of the FRFs that they make."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from .modalfit import (
    FrfBand,
    ModalFit,
    Poles,
    basis,
    each_reference,
    kernel,
    kernel_slope,
    moved_slopes,
    moving,
    real_rows,
    resonators,
    root_of,
    slopes,
)
from .spectra import smooth_lines

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

ROUNDS = 6  # of Gauss and Newton for the participations, at most
DONE = 1e-8  # relative fall of the squared residual that ends them
CHANCE = 3.0  # std of a smoothed power, beyond which it is no chance


@dataclass(frozen=True, eq=False)
class ShapeFit:
    """Modes, resonators outside the band, and the errors of the FRFs that they make.

    Parameters
    ----------
    poles : array (modes,), complex
    participation : array (modes, references)
        The largest entry of each is 1.
    shapes : array (modes, outputs)
    rest : array (resonators, outputs, references)
        Of the modes outside the band, as `structures._testing.modalfit.resonators` answer.
    rest_poles : array (resonators,), complex
    covariance : array (outputs, unknowns, unknowns)
        Of shapes and rest of each output, for given common unknowns.
    slope : array (outputs, unknowns, common)
        How these follow the common unknowns: real parts of the poles, imaginary parts, resonators that move as
        `structures._testing.modalfit.moved_slopes` counts them, participations but for the largest of each mode.
    common : array (common, common)
        Covariance of the common unknowns.
    power : float
        Squared residual over the variance.
    f : array (lines,)
        Lines of the band in Hz.
    bias : array (lines, outputs, references)
        Squared error of the fit on them where it is wrong rather than noisy: residual power beyond the stated noise.
    missed : array (outputs, references)
        Share of the rms of each FRF that the fit misses beyond the noise.
    """

    poles: Complex
    participation: NDArray[Any]
    shapes: NDArray[Any]
    rest: Real
    rest_poles: Complex
    covariance: Real
    slope: Real
    common: Real
    power: float
    f: Real
    bias: Real
    missed: Real

    @property
    def low(self) -> NDArray[np.bool_]:
        """Which resonators lie below the band."""
        return np.asarray(np.abs(self.rest_poles) < 2 * np.pi * self.f[0])

    @property
    def ends(self) -> tuple[float, float]:
        """First and last line in Hz."""
        return float(self.f[0]), float(self.f[-1])

    def columns(self, s: Complex, derivative: int, length: float = np.inf) -> Complex:
        """What shapes and rest of an output are multiplied by (lines, references, unknowns)."""
        raise NotImplementedError

    def slopes(self, s: Complex, derivative: int, output: int, length: float = np.inf) -> Complex:
        """Derivatives (lines, references, common) of the FRFs of an output for given shapes and rest."""
        raise NotImplementedError

    def variance(self, f: Real, derivative: int) -> Real:
        """Variance (lines, outputs, references) of the fitted FRF of a kind at f (Hz): noise of the fit, and its bias.

        The kind is that of the fit.
        """
        s = np.asarray(2j * np.pi * f, complex)
        out = np.empty((len(f), self.shapes.shape[1], self.participation.shape[1]))
        for o in range(out.shape[1]):
            out[:, o] = np.sum(np.abs(self.root(s, derivative, o)) ** 2, axis=2)
        if np.any(self.bias):
            out += _interpolated(f, self.f, self.bias)
        return out

    def root(self, s: Complex, derivative: int, output: int) -> Complex:
        """Root (lines, references, any) of the covariance of the FRFs of one output: times unit noise, their errors."""
        columns = self.columns(s, derivative)
        follows = self.slopes(s, derivative, output) + columns @ self.slope[output]
        return np.concatenate([columns @ _root(self.covariance[output]), follows @ _root(self.common)], axis=2)


@dataclass(frozen=True, eq=False)
class NormalFit(ShapeFit):
    """Real shapes: ``sum_k shapes_k participation_k^T s^d / (s^2 - 2 Re(p_k) s + |p_k|^2)`` and the rest."""

    @property
    def free(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Modes and references whose participation is unknown, reference by reference."""
        fixed = np.argmax(np.abs(self.participation), axis=1)
        j, k = np.nonzero(np.arange(self.participation.shape[1])[:, None] != fixed)
        return k, j

    def columns(self, s: Complex, derivative: int, length: float = np.inf) -> Complex:
        """What shapes and rest of an output are multiplied by (lines, references, unknowns)."""
        q = _real_modes(s, self.poles, derivative, length)[:, None, :] * self.participation.T
        rest = each_reference(resonators(s, self.rest_poles, derivative), self.participation.shape[1])
        return np.concatenate([q, rest], axis=2)

    def slopes(self, s: Complex, derivative: int, output: int, length: float = np.inf) -> Complex:
        """Derivatives (lines, references, common) of the FRFs of an output for given shapes and rest."""
        q, own = _real_modes(s, self.poles, derivative, length), moving(self.rest_poles)
        p, turn = self.poles, 2j * self.poles.imag
        above, below = kernel_slope(s, p, derivative, length), kernel_slope(s, p.conj(), derivative, length)
        turned = np.concatenate([(above - below) / turn, 1j * (above + below) / turn - q / p.imag], axis=1)
        size = np.tile(self.shapes[:, output, None] * self.participation, (2, 1)).T
        moved = moved_slopes(s, self.rest_poles[own], self.ends, derivative)
        share = np.tile(self.rest[own, output].T, (1, 2))
        k, j = self.free
        driven = np.zeros((len(s), self.participation.shape[1], len(k)), complex)
        driven[:, j, np.arange(len(k))] = q[:, k] * self.shapes[k, output]
        return np.concatenate([turned[:, None] * size, moved[:, None] * share, driven], axis=2)

    def residue_variance(self, output: int, reference: int) -> Real:
        """Variance (modes,) of the residues ``shapes participation`` of one entry."""
        n = len(self.poles)
        b = self.participation[:, reference]
        k, j = self.free
        own = np.zeros((n, len(self.common)))
        place = len(self.common) - len(k) + np.flatnonzero(j == reference)
        own[k[j == reference], place] = self.shapes[k[j == reference], output]
        follows = own + b[:, None] * self.slope[output][:n]
        alone = np.diag(self.covariance[output])[:n] * b**2
        return np.asarray(alone + np.einsum("kc,cd,kd->k", follows, self.common, follows))


@dataclass(frozen=True, eq=False)
class ComplexFit(ShapeFit):
    """Complex shapes: ``sum_k shapes_k participation_k^T g(s, p_k)``, its conjugate, and the rest."""

    @property
    def at(self) -> Poles:
        """Poles and participations."""
        return Poles(self.poles, self.participation, self.rest_poles)

    def columns(self, s: Complex, derivative: int, length: float = np.inf) -> Complex:
        """What shapes and rest of an output are multiplied by (lines, references, unknowns)."""
        return basis(s, derivative, self.at, length)

    def slopes(self, s: Complex, derivative: int, output: int, length: float = np.inf) -> Complex:
        """Derivatives (lines, references, common) of the FRFs of an output for given shapes and rest."""
        return slopes(s, derivative, self.at, self.shapes[:, output], self.rest[:, output], self.ends, length)


def _real_modes(s: Complex, p: Complex, derivative: int, length: float) -> Complex:
    """Response (lines, modes) of real modes of unit modal mass."""
    both = kernel(s, p, derivative, length) - kernel(s, p.conj(), derivative, length)
    return np.asarray(both / (2j * p.imag))


Fit = TypeVar("Fit", bound=ShapeFit)


def _interpolated(f: Real, lines: Real, values: Real) -> Real:
    """Values (lines, outputs, references) at other lines, constant beyond the ends."""
    i = np.clip(np.searchsorted(lines, f), 1, len(lines) - 1)
    share = np.clip((f - lines[i - 1]) / (lines[i] - lines[i - 1]), 0, 1)[:, None, None]
    return np.asarray((1 - share) * values[i - 1] + share * values[i])


def _root(covariance: Real) -> Real:
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def normal(band: FrfBand, fit: ModalFit, stated: Real | None = None) -> NormalFit:
    """Real shapes and participations of the poles of a fit, by weighted least squares, shapes eliminated.

    Parameters
    ----------
    band : FrfBand
    fit : ModalFit
    stated : array like H, optional
        Std of the FRFs as the test tells it: what the residual has beyond it is bias.

    Notes
    -----
    Poles and resonators are those of the fit, with its covariance: its complex shapes make them less exact than real
    ones would, by an error that is independent of all that is estimated here for given poles (the efficient
    estimate's), so that the two covariances add up.
    """
    _, outputs, references = band.H.shape
    phase, known = 0.5 * np.angle(np.sum(fit.participation**2, axis=1)), 2 * (len(fit.poles) + len(moving(fit.rest)))
    found = NormalFit(
        participation=_turned((fit.participation * np.exp(-1j * phase[:, None])).real),
        shapes=np.zeros((len(fit.poles), outputs)), rest=np.zeros((len(fit.rest), outputs, references)),
        **_same(band, fit, fit.covariance[:known, :known]),
    )  # fmt: skip
    found, residual = _shapes(band, found)
    for _ in range(ROUNDS if references > 1 else 0):
        trial, left = _shapes(band, _stepped(band, found, residual))
        before, after = (float(np.sum(np.abs(r / band.std) ** 2)) for r in (residual, left))
        if after < before:
            found, residual = trial, left
        if after >= (1 - DONE) * before:
            break
    unknowns = found.shapes.size + found.rest.size + len(found.free[0])
    return _judged(band, _with_errors(band, found, _scale(band, fit, residual, unknowns)), residual, stated)


def complex_shapes(band: FrfBand, fit: ModalFit, stated: Real | None = None) -> ComplexFit:
    """Complex shapes of a fit, with the errors of their FRFs; parameters as for `normal`."""
    _, outputs, references = band.H.shape
    rest = fit.rest_shares.reshape(outputs, len(fit.rest), references).transpose(1, 0, 2)
    found = ComplexFit(
        participation=fit.participation, shapes=fit.shapes, rest=rest, **_same(band, fit, fit.covariance)
    )
    unknowns = 2 * found.shapes.size + found.rest.size + len(fit.covariance)
    return _judged(band, _with_errors(band, found, _scale(band, fit, fit.residual, unknowns)), fit.residual, stated)


def _same(band: FrfBand, fit: ModalFit, common: Real) -> dict[str, Any]:
    """Fields that real and complex shapes share."""
    none = np.zeros(0)
    return {
        "poles": fit.poles, "rest_poles": fit.rest, "common": common, "f": band.f, "power": 0.0,
        "covariance": none, "slope": none, "bias": np.zeros(band.H.shape), "missed": np.zeros(band.H.shape[1:]),
    }  # fmt: skip


def _scale(band: FrfBand, fit: ModalFit, residual: Complex, unknowns: int) -> float:
    """Variance of each real error over the squared std, for the correlation of neighbouring lines."""
    inflation = max(1.0, 1.0 + 2.0 * float(np.sum(fit.correlation)))
    power = float(np.sum(np.abs(residual / band.std) ** 2))
    return power / max(2 * residual.size - unknowns, 1) * inflation * band.loss


def _judged(band: FrfBand, found: Fit, residual: Complex, stated: Real | None) -> Fit:
    """The same with what it misses."""
    noise = np.broadcast_to(rough(residual), band.H.shape) if stated is None else stated**2
    whole = np.mean(np.abs(band.H) ** 2, axis=0)
    chance = CHANCE * np.sqrt(np.sum(noise**2, axis=0)) / len(noise)
    beyond = np.maximum(np.mean(np.abs(residual) ** 2 - noise, axis=0) - chance, 0.0)
    return replace(
        found, power=float(np.sum(np.abs(residual / band.std) ** 2)),
        bias=found.bias if stated is None else excess(residual, stated),
        missed=np.sqrt(beyond / np.where(whole > 0, whole, 1.0)),
    )  # fmt: skip


def rough(residual: Complex) -> Real:
    """Power (outputs, references) of what changes from line to line: noise, where no test tells it."""
    if len(residual) < 3:
        return np.zeros(residual.shape[1:])
    return np.asarray(np.mean(np.abs(np.diff(residual, 2, axis=0)) ** 2, axis=0) / 6, float)


def excess(residual: Complex, std: Real) -> Real:
    """Power of residuals beyond that of noise, smoothed over lines; 0 where chance explains it."""
    half = max(5, len(residual) // 40)
    power, noise = smooth_lines(np.abs(residual) ** 2, half), smooth_lines(std**2, half)
    return np.where(power > (1 + CHANCE / np.sqrt(2 * half + 1)) * noise, power - noise, 0.0)


def _turned(b: Real) -> Real:
    top = b[np.arange(len(b)), np.argmax(np.abs(b), axis=1)]
    return b / np.where(top == 0, 1.0, top)[:, None]


def _scaled(band: FrfBand, columns: Complex, o: int) -> Real:
    """Weighted real rows of one output."""
    return real_rows(np.asarray(columns / band.std[:, o, :, None], complex))


def _shapes(band: FrfBand, found: NormalFit) -> tuple[NormalFit, Complex]:
    """Shapes and rest for given participations, and the residual."""
    n, (_, outputs, references) = len(found.poles), band.H.shape
    columns = found.columns(band.s, band.derivative, band.length)
    x, residual = np.zeros((outputs, columns.shape[2])), np.empty_like(band.H)
    for o in range(outputs):
        rows = _scaled(band, columns, o)
        scale = np.linalg.norm(rows, axis=0)
        scale = np.where(scale > 0, scale, 1.0)
        data = _scaled(band, band.H[:, o, :, None], o)[:, 0]
        x[o] = linalg.lstsq(rows / scale, data, cond=1e-12, check_finite=False)[0] / scale
        residual[:, o] = band.H[:, o] - columns @ x[o]
    rest = x[:, n:].reshape(outputs, len(found.rest_poles), references).transpose(1, 0, 2)
    return replace(found, shapes=x[:, :n].T, rest=rest), residual


def _stepped(band: FrfBand, found: NormalFit, residual: Complex) -> NormalFit:
    """One step of the participations, shapes and rest eliminated."""
    columns, (k, j) = found.columns(band.s, band.derivative, band.length), found.free
    R = np.zeros((0, len(k) + 1))
    for o in range(band.H.shape[1]):
        Q = linalg.qr(_scaled(band, columns, o), mode="economic", check_finite=False)[0]
        J = _scaled(band, found.slopes(band.s, band.derivative, o, band.length)[..., -len(k) :], o)
        J -= Q @ (Q.T @ J)
        rows = np.vstack([R, np.hstack([J, _scaled(band, residual[:, o, :, None], o)])])
        R = linalg.qr(rows, mode="r", check_finite=False)[0][: R.shape[1]]
    b = np.array(found.participation)
    root = root_of(R[:-1, :-1])
    b[k, j] += root @ (root.T @ (R[:-1, :-1].T @ R[:-1, -1]))
    return replace(found, participation=_turned(b))


def _with_errors(band: FrfBand, found: Fit, scale: float) -> Fit:
    """Covariances: those of the poles are known, participations follow them, and shapes and rest follow both."""
    columns, known = found.columns(band.s, band.derivative, band.length), len(found.common)
    size, common = columns.shape[2], found.slopes(band.s[:1], band.derivative, 0).shape[2]
    driven = common - known
    covariance, slope = np.zeros((len(found.shapes.T), size, size)), np.zeros((len(found.shapes.T), size, common))
    R = np.zeros((0, common))
    for o in range(len(covariance)):
        rows = _scaled(band, columns, o)
        Q, triangle = linalg.qr(rows, mode="economic", check_finite=False)
        root = root_of(triangle)
        J = _scaled(band, found.slopes(band.s, band.derivative, o, band.length), o)
        covariance[o], slope[o] = scale * root @ root.T, -root @ (root.T @ (rows.T @ J))
        J -= Q @ (Q.T @ J)
        order = np.concatenate([np.arange(known, common), np.arange(known)])  # participations first
        R = linalg.qr(np.vstack([R, J[:, order]]), mode="r", check_finite=False)[0][:common]
    follows = np.zeros((common, known))
    follows[:known] = np.eye(known)
    whole = np.zeros((common, common))
    if driven:
        root = root_of(R[:driven, :driven])
        follows[known:] = -root @ (root.T @ (R[:driven, :driven].T @ R[:driven, driven:]))
        whole[known:, known:] = scale * root @ root.T
    return replace(found, covariance=covariance, slope=slope, common=whole + follows @ found.common @ follows.T)
