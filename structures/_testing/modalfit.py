"""Modes fitted to FRFs by maximum likelihood: poles, participations and shapes with their covariance.

M. El-Kafafy, T. De Troyer, B. Peeters, P. Guillaume, "Fast maximum-likelihood identification of modal parameters with
uncertainty intervals: a modal model-based formulation", Mech. Syst. Signal Process. 37 (2013) 422-439. Shapes and
residuals are linear, and eliminated: G. H. Golub, V. Pereyra, "Separable nonlinear least squares", Inverse Problems 19
(2003) R1-R26, with Kaufman's Jacobian.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from .spectra import smooth_lines

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

STEPS, QUICK = 20, 5  # of Gauss and Newton, at most: at the end, and while modes come and go
DONE = 1e-6  # relative fall of the misfit that ends them
HALVINGS = 8
LEAST = 0.3  # of its decay rate that a pole keeps in one step
EXTRA = 4  # modes that the residual of a fit may add
GUESSED = 0.01  # damping ratio with which they begin
DAMPED = 0.25  # and beyond which there is no mode
LAGS = 4  # lines over which errors of an estimated FRF are correlated, at most
BELOW, BELOW_DAMPING = 0.1, 0.5  # the mode that stands for those below the band: share of its start, damping ratio
ABOVE = ((1.3,), (2.0,), (4.0,), (1.3, 2.0), (1.5, 4.0))  # and those for what is above it: times its end
ABOVE_DAMPING = 0.02
APART = (-4.0, 3.0)  # log of how far above the end they may lie, over the end
SEARCH = 40  # places that are tried for them


@dataclass(frozen=True, eq=False)
class FrfBand:
    """FRFs of one kind on the lines of a band, and the std of their errors.

    Parameters
    ----------
    f : array (lines,)
        Hz.
    H : array (lines, outputs, references), complex
    std : array like H
    derivative : int
        0 receptance, 1 mobility, 2 accelerance.
    """

    f: Real
    H: Complex
    std: Real
    derivative: int

    @property
    def s(self) -> Complex:
        """``i omega`` of every line."""
        return np.asarray(2j * np.pi * self.f, complex)


@dataclass(frozen=True, eq=False)
class ModalFit:
    """Modes of FRFs: ``H = sum_k psi_k l_k^T g(s, p_k) + conjugates + what lies outside the band``.

    Parameters
    ----------
    poles : array (modes,), complex
        rad/s.
    participation : array (modes, references), complex
        The largest entry of each is 1.
    shapes : array (modes, outputs), complex
        Residues of receptance per participation, unit of the response times s over that of the load.
    covariance : array (2 modes, 2 modes)
        Of the real parts of the poles, then of their imaginary parts.
    misfit : float
        Mean squared residual over the squared std, with the freedom of the fit allowed for.
    residual : array (lines, outputs, references), complex
    rest : tuple of float
        Frequencies (Hz) of the modes that stand for those outside the band.
    correlation : array (lags,)
        Of the errors of neighbouring lines, from lag 1 on.
    stayed : array of bool (modes,)
        Poles that stay over the orders of pLSCF. The others were added where the residual asked for them: they carry
        what lies outside the band, or what is no mode, and make the FRFs right.
    """

    poles: Complex
    participation: Complex
    shapes: Complex
    covariance: Real
    misfit: float
    residual: Complex
    rest: tuple[float, ...]
    correlation: Real
    stayed: NDArray[np.bool_]


def kernel(s: Complex, p: Complex, derivative: int) -> Complex:
    """Response of every pole (lines, modes), of the sensor's kind: that of the states ``x' = p x + u``."""
    base = 1 / (s[:, None] - p)
    return np.asarray((base, p * base, s[:, None] * p * base)[derivative])


def kernel_slope(s: Complex, p: Complex, derivative: int) -> Complex:
    """Derivative of `kernel` with respect to the pole."""
    return np.asarray(s[:, None] ** derivative / (s[:, None] - p) ** 2)


def resonator(s: Complex, frequency: float, damping: float, derivative: int) -> Complex:
    """Response (lines,) of a mode of unit modal mass that stands for others."""
    w = 2 * np.pi * frequency
    return np.asarray(s**derivative / (s**2 + 2 * damping * w * s + w**2))


def outside(band: FrfBand, frequencies: Sequence[float]) -> list[Complex]:
    """What modes at some frequencies (Hz) below and above the band give on its lines."""
    pairs = [(w, BELOW_DAMPING if w < band.f[0] else ABOVE_DAMPING) for w in frequencies]
    return [resonator(band.s, w, damping, band.derivative) for w, damping in pairs]


def candidates(band: FrfBand) -> list[tuple[float, ...]]:
    """Sets of frequencies (Hz) of modes that may stand for those outside the band."""
    above = [tuple(times * float(band.f[-1]) for times in some) for some in ABOVE]
    low = BELOW * float(band.f[0])
    return [*above, *((low, *some) for some in above)] if low > 0 else above


def real_rows(x: Complex) -> Real:
    """Complex rows (..., columns) as real ones: real parts above imaginary parts."""
    flat = x.reshape(-1, x.shape[-1])
    return np.concatenate([flat.real, flat.imag])


class _Problem:
    """One band, one set of out-of-band modes: what a set of poles and participations leaves."""

    def __init__(self, band: FrfBand, rest: Sequence[float]) -> None:
        self.band, self.w = band, 1 / band.std
        self.outside = outside(band, rest)
        self.lines, self.outputs, self.references = band.H.shape

    def basis(self, p: Complex, v: Complex) -> Complex:
        """Columns (lines, references, linear unknowns) of one output before weighting."""
        g, c = kernel(self.band.s, p, self.band.derivative), kernel(self.band.s, p.conj(), self.band.derivative)
        a, b = g[:, None, :] * v.T[None], c[:, None, :] * v.conj().T[None]
        rest = np.zeros((self.lines, self.references, len(self.outside) * self.references), complex)
        for i, u in enumerate(self.outside):
            for j in range(self.references):
                rest[:, j, i * self.references + j] = u
        return np.concatenate([a + b, 1j * (a - b), rest], axis=2)

    def slopes(self, p: Complex, v: Complex, psi: Complex, largest: NDArray[np.intp]) -> Complex:
        """Derivatives (lines, references, unknowns) of one output's FRF: poles, real and imaginary, participations."""
        s, d = self.band.s, self.band.derivative
        a = kernel_slope(s, p, d)[:, None, :] * (psi * v.T)[None]
        b = kernel_slope(s, p.conj(), d)[:, None, :] * (psi * v.T).conj()[None]
        parts = [a + b, 1j * (a - b)]
        if self.references > 1:
            g, c = kernel(s, p, d) * psi, kernel(s, p.conj(), d) * psi.conj()
            for j in range(self.references):
                moves = largest != j
                one = np.zeros((self.lines, self.references, 2 * int(moves.sum())), complex)
                one[:, j] = np.concatenate([(g + c)[:, moves], 1j * (g - c)[:, moves]], axis=1)
                parts.append(one)
        return np.concatenate(parts, axis=2)

    def solved(self, p: Complex, v: Complex) -> tuple[float, Complex, Complex]:
        """Misfit, shapes (modes, outputs) and residual for these poles."""
        basis, n = self.basis(p, v), len(p)
        psi, residual = np.zeros((n, self.outputs), complex), np.empty_like(self.band.H)
        for o in range(self.outputs):
            w = self.w[:, o]
            rows = real_rows(basis * w[..., None])
            data = real_rows((self.band.H[:, o] * w)[..., None])[:, 0]
            x = linalg.lstsq(rows, data, lapack_driver="gelsy", check_finite=False)[0]
            psi[:, o] = x[:n] + 1j * x[n : 2 * n]
            residual[:, o] = self.band.H[:, o] - basis @ x
        return float(np.sum(np.abs(residual * self.w) ** 2)), psi, residual

    def losses(self, p: Complex, v: Complex) -> Real:
        """How much the squared residual would rise without each mode (modes,), its unknowns eliminated."""
        basis, n = self.basis(p, v), len(p)
        out = np.zeros(n)
        for o in range(self.outputs):
            w = self.w[:, o, :, None]
            rows = np.hstack([real_rows(basis * w), real_rows(self.band.H[:, o, :, None] * w)])
            R = linalg.qr(rows, mode="r", check_finite=False)[0][: rows.shape[1]]
            for k in range(n):
                own = [k, n + k]
                rest = [c for c in range(R.shape[1] - 1) if c not in own]
                last = linalg.qr(R[:, [*rest, *own, R.shape[1] - 1]], mode="r", check_finite=False)[0]
                out[k] += np.sum(last[len(rest) : len(rest) + 2, -1] ** 2)
        return out

    def linearised(self, p: Complex, v: Complex, psi: Complex, residual: Complex) -> tuple[Real, Real, list[Complex]]:
        """Triangle (unknowns, unknowns) and right side of the projected problem; the projected slopes by output."""
        basis, largest = self.basis(p, v), np.argmax(np.abs(v), axis=1)
        R, kept = np.zeros((0, 0)), []
        for o in range(self.outputs):
            w = self.w[:, o, :, None]
            Q = linalg.qr(real_rows(basis * w), mode="economic", check_finite=False)[0]
            J = real_rows(self.slopes(p, v, psi[:, o], largest) * w)
            J -= Q @ (Q.T @ J)
            r = real_rows(residual[:, o, :, None] * w)
            stacked = np.hstack([J, r])
            R = linalg.qr(np.vstack([R, stacked]) if R.size else stacked, mode="r", check_finite=False)[0]
            R = R[: stacked.shape[1]]
            half = len(J) // 2
            kept.append((J[:half] + 1j * J[half:]).reshape(self.lines, self.references, -1))
        return R[:-1, :-1], R[:-1, -1], kept


def completed(band: FrfBand, poles: Complex, participation: Complex) -> tuple[float, ...]:
    """The set of `candidates` that explains most, a larger set only where it is worth its unknowns (Schwarz)."""
    v, size = turned(participation), 2 * band.H.size

    def worth(some: tuple[float, ...]) -> float:
        problem = _Problem(band, some)
        cost = problem.solved(poles, v)[0]
        floor = np.finfo(float).eps ** 2 * float(np.sum(np.abs(band.H / band.std) ** 2))
        return size * float(np.log(max(cost, floor))) + _linear(problem, len(poles)) * float(np.log(size))

    return min(candidates(band), key=worth)


def placed(band: FrfBand, fit: ModalFit) -> ModalFit:
    """A fit whose modes above the band stand where its own modes leave least, by a search over their frequencies.

    Where they stand in the wrong place, what they miss goes into the residues, most of all of the load that drives
    them most.
    """
    from scipy.optimize import minimize

    low, top = [w for w in fit.rest if w < band.f[0]], float(band.f[-1])
    start = np.log([w / top - 1 for w in fit.rest if w > top])

    def frequencies(x: Real) -> tuple[float, ...]:
        return (*low, *(top * (1 + np.exp(np.clip(x, *APART)))).tolist())

    def left(x: Real) -> float:
        cost = _Problem(band, frequencies(x)).solved(fit.poles, fit.participation)[0]
        return float(np.log(max(cost, np.finfo(float).tiny)))

    simplex = np.vstack([start, start + 0.5 * np.eye(len(start))])
    limits = {"maxfev": SEARCH, "xatol": 0.02, "fatol": 1e-4, "initial_simplex": simplex}
    best = minimize(left, start, method="Nelder-Mead", options=limits).x
    return fitted(band, fit.poles, fit.participation, frequencies(best), fit.stayed, QUICK)


def turned(v: Complex) -> Complex:
    """Participations with their largest entry 1."""
    top = v[np.arange(len(v)), np.argmax(np.abs(v), axis=1)] if len(v) else np.ones(0)
    return v / np.where(top == 0, 1.0, top)[:, None]


def fitted(
    band: FrfBand,
    poles: Complex,
    participation: Complex,
    rest: Sequence[float],
    stayed: NDArray[np.bool_],
    steps: int = STEPS,
) -> ModalFit:
    """Poles and participations of maximum likelihood, begun at some.

    Gauss and Newton with steps that are halved while they do not lower the misfit; a pole that is vague holds none of
    the others back.
    """
    v = turned(participation)
    problem = _Problem(band, rest)
    p, (cost, psi, residual) = poles, problem.solved(poles, v)
    for _ in range(steps):
        R, right, _slopes = problem.linearised(p, v, psi, residual)
        step = _step(R, right)
        for k in range(HALVINGS):
            q, u = _moved(p, v, step * 0.5**k)
            trial = problem.solved(q, u)
            if trial[0] < cost:
                break
        else:
            break
        fall = (cost - trial[0]) / max(cost, np.finfo(float).tiny)
        p, v, (cost, psi, residual) = q, u, trial
        if fall < DONE:
            break
    R, _, slopes = problem.linearised(p, v, psi, residual)
    white = residual / band.std
    freedom = max(2 * residual.size - R.shape[1] - _linear(problem, len(p)), 1)
    misfit = 2 * cost / freedom
    rho = correlation(white)
    covariance = _covariance(R, slopes, rho) * misfit / 2
    n = 2 * len(p)
    return ModalFit(p, v, psi, covariance[:n, :n], misfit, residual, tuple(rest), rho, stayed)


def _linear(problem: _Problem, modes: int) -> int:
    return problem.outputs * (2 * modes + len(problem.outside) * problem.references)


def _step(R: Real, right: Real) -> Real:
    """Gauss and Newton's step, columns of one size first: poles and participations have their own units."""
    scale = np.linalg.norm(R, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    return np.asarray(linalg.lstsq(R / scale, right, cond=1e-10, check_finite=False)[0] / scale)


def _moved(p: Complex, v: Complex, step: Real) -> tuple[Complex, Complex]:
    """Poles and participations after a step, in which no pole moves by more than its decay rate, or ceases to decay."""
    n, largest = len(p), np.argmax(np.abs(v), axis=1)
    by = step[:n] + 1j * step[n : 2 * n]
    q = p + by * np.minimum(1.0, np.abs(p.real) / np.maximum(np.abs(by), np.finfo(float).tiny))
    q = np.minimum(q.real, LEAST * p.real) + 1j * q.imag
    u, place = np.array(v), 2 * n
    for j in range(v.shape[1] if v.shape[1] > 1 else 0):
        moves = np.flatnonzero(largest != j)
        u[moves, j] += step[place : place + len(moves)] + 1j * step[place + len(moves) : place + 2 * len(moves)]
        place += 2 * len(moves)
    return q, turned(u)


def correlation(white: Complex) -> Real:
    """Correlation (lags,) of whitened errors of neighbouring lines, over all entries; it ends where chance begins."""
    lines = len(white)
    power = float(np.sum(np.abs(white) ** 2))
    if not power or lines < 4 * LAGS:
        return np.zeros(0)
    chance = 3 / np.sqrt(white.size)
    found = []
    for lag in range(1, LAGS + 1):
        rho = float(np.sum((white[:-lag].conj() * white[lag:]).real)) / power
        if abs(rho) < chance:
            break
        found.append(rho)
    return np.array(found)


def root_of(R: Real) -> Real:
    """Root (unknowns, rank) of the covariance of least squares with these rows or their triangle, at unit std."""
    scale = np.linalg.norm(R, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    sizes, Vt = linalg.svd(R / scale, full_matrices=False, check_finite=False)[1:]
    good = sizes > 1e-12 * sizes[0]
    return np.asarray(Vt[good].T / sizes[good] / scale[:, None])


def _covariance(R: Real, slopes: list[Complex], rho: Real) -> Real:
    """Covariance of the unknowns at unit std, errors of neighbouring lines correlated: ``N^-1 M N^-1``."""
    root = root_of(R)
    middle = np.eye(root.shape[1])
    for J in slopes:
        half = np.einsum("lju,uv->ljv", J, root)
        for lag, value in enumerate(rho, start=1):
            cross = np.einsum("lju,ljv->uv", half[:-lag].conj(), half[lag:]).real
            middle = middle + value * (cross + cross.T)
    values, vectors = np.linalg.eigh(0.5 * (middle + middle.T))
    wide = root @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    return np.asarray(wide @ wide.T)


def extended(band: FrfBand, fit: ModalFit) -> ModalFit:
    """A fit with the modes that its residual shows, one after the other while each is worth its unknowns.

    Each begins where the smoothed residual is largest over its std; one that moves onto a mode that is there, within
    the sum of their decay rates, is none.
    """
    size = 2 * band.H.size
    for _ in range(EXTRA):
        power = smooth_lines(np.sum(np.abs(fit.residual / band.std) ** 2, axis=(1, 2)), 2)
        line = int(np.argmax(power))
        at = 2 * np.pi * band.f[line]
        v = linalg.svd(fit.residual[line] / band.std[line])[2][:1]
        p, u = np.append(fit.poles, complex(-GUESSED * at, at)), np.concatenate([fit.participation, v])
        trial = fitted(band, p, turned(u), fit.rest, np.append(fit.stayed, False), QUICK)
        gain = size * np.log(_power(band, fit) / max(_power(band, trial), np.finfo(float).tiny))
        apart = np.abs(trial.poles[-1] - trial.poles[:-1]) > np.abs(trial.poles[-1].real + trial.poles[:-1].real)
        if (
            gain < _unknowns(band) * np.log(size)
            or not apart.all()
            or -trial.poles[-1].real > DAMPED * abs(trial.poles[-1])
        ):
            break
        fit = trial
    return fit


def _power(band: FrfBand, fit: ModalFit) -> float:
    return float(np.sum(np.abs(fit.residual / band.std) ** 2))


def _unknowns(band: FrfBand) -> int:
    """Real unknowns of one mode."""
    return 2 + 2 * band.H.shape[1] + 2 * (band.H.shape[2] - 1)


def selected(
    band: FrfBand, poles: Complex, participation: Complex, stayed: NDArray[np.bool_] | None = None
) -> tuple[ModalFit, int]:
    """Fit of those modes that explain more than chance would, and how many were dropped that stay over the orders.

    A mode stays where its loss would raise the squared residual by more than ``log(data)`` for each of its unknowns
    (Schwarz, Annals of Statistics 6, 1978), and where its decay rate is known to a half; the least of them goes first.
    """
    known = np.ones(len(poles), bool) if stayed is None else stayed
    fit = extended(band, fitted(band, poles, participation, completed(band, poles, participation), known, QUICK))
    before = int(np.sum(fit.stayed))
    while len(fit.poles):
        losses = _Problem(band, fit.rest).losses(fit.poles, fit.participation) / fit.misfit
        std = np.sqrt(np.diag(fit.covariance))[: len(fit.poles)]
        weak = losses < _unknowns(band) * np.log(2 * band.H.size)
        bad = weak | (std > 0.5 * np.abs(fit.poles.real))
        if not bad.any():
            break
        if len(losses) == 1:
            return replace(fit, stayed=np.zeros(1, bool)), before
        kept = np.arange(len(losses)) != np.argmin(np.where(bad, losses, np.inf))
        fit = fitted(band, fit.poles[kept], fit.participation[kept], fit.rest, fit.stayed[kept], QUICK)
    fit = placed(band, fit)
    fit = fitted(band, fit.poles, fit.participation, fit.rest, fit.stayed)
    return fit, before - int(np.sum(fit.stayed))


def reweighted(band: FrfBand, residual: Complex, *, known: bool) -> FrfBand:
    """The band with the std that its residuals show, smoothed over neighbouring lines; a known one is the least."""
    half = max(5, len(band.f) // 40)
    power = smooth_lines(np.abs(residual) ** 2, half)
    floor = band.std**2 if known else 1e-12 * np.mean(np.abs(band.H) ** 2, axis=0)
    return replace(band, std=np.sqrt(np.maximum(power, floor)))
