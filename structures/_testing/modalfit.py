"""Modes fitted to FRFs by maximum likelihood: poles, participations and shapes with their covariance.

M. El-Kafafy, T. De Troyer, B. Peeters, P. Guillaume, "Fast maximum-likelihood identification of modal parameters with
uncertainty intervals: a modal model-based formulation", Mech. Syst. Signal Process. 37 (2013) 422-439. Shapes and
residuals are linear, and eliminated: G. H. Golub, V. Pereyra, "Separable nonlinear least squares", Inverse Problems 19
(2003) R1-R26, with Kaufman's Jacobian.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

STEPS, QUICK = 20, 5  # of Gauss and Newton, at most: at the end, and while modes come and go
DONE = 1e-6  # relative fall of the misfit that ends them
HALVINGS = 8
LEAST = 0.3  # of its decay rate that a pole keeps in one step
LAGS = 4  # lines over which errors of an estimated FRF are correlated, at most
APART = (-4.0, 3.0)  # log of how far beyond an end of the band a resonator may lie, as a ratio of frequencies less one
DAMPED, FACTOR = 0.02, 2.0  # damping ratio of a resonator outside the band: where it begins, std of its logarithm
DAMPINGS = (np.log(1e-3), np.log(0.2))  # logarithms between which it stays
HELD = 0.3  # damping ratio from which on a resonator stands still: it is no mode, but the sum of many


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
    length : float
        Seconds after which the impulse response was cut; the lines are then those of its transform.
    freedom : float
        Real degrees of freedom of each std; inf where the test states them.
    """

    f: Real
    H: Complex
    std: Real
    derivative: int
    length: float = np.inf
    freedom: float = np.inf

    @property
    def s(self) -> Complex:
        """``i omega`` of every line."""
        return np.asarray(2j * np.pi * self.f, complex)

    @property
    def loss(self) -> float:
        """What weights that are themselves estimates cost, as a factor on the covariance.

        J. Schoukens, R. Pintelon, G. Vandersteen, P. Guillaume, Automatica 33 (1997) 1073-1086: (n - 2)/(n - 4) for n
        real degrees of freedom.
        """
        return 1.0 if np.isinf(self.freedom) else (self.freedom - 2) / (self.freedom - 4)


class Poles(NamedTuple):
    """What an FRF does not depend on linearly.

    Parameters
    ----------
    inside : array (modes,), complex
        Poles of the modes, rad/s.
    participation : array (modes, references), complex
        The largest entry of each is 1.
    rest : array (resonators,), complex
        Poles of the resonators that stand for modes outside the band.
    """

    inside: Complex
    participation: Complex
    rest: Complex


class Solved(NamedTuple):
    """What is linear, for given `Poles`: cost, shapes (modes, outputs), resonators (outputs, unknowns), residual."""

    cost: float
    shapes: Complex
    rest: Real
    residual: Complex


class Linearised(NamedTuple):
    """Gauss and Newton's problem, what is linear eliminated.

    Parameters
    ----------
    R, right : array (unknowns, unknowns), (unknowns,)
        Its triangle and right side.
    slopes : list of array (lines, references, unknowns)
        Projected slopes of each output.
    leverage : array (lines, outputs, references)
        Share of each datum that what is linear follows.
    """

    R: Real
    right: Real
    slopes: list[Complex]
    leverage: Real


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
    covariance : array (unknowns, unknowns)
        Of the real parts of the poles, then of their imaginary parts, then of the resonators that move, as
        `moved_slopes` counts them, then of the participations, as `slopes` does.
    misfit : float
        Mean squared residual over the squared std, with the freedom of the fit allowed for.
    residual : array (lines, outputs, references), complex
    rest : array (resonators,), complex
        Poles of the modes that stand for those outside the band, those below it first.
    rest_shares : array (outputs, resonators x references)
        What each gives.
    correlation : array (lags,)
        Of the errors of neighbouring lines, from lag 1 on.
    stayed : array of bool (modes,)
        Poles that stay over the orders of pLSCF. The others were added where the residual asked for them: they carry
        what lies outside the band, or what is no mode, and make the FRFs right.
    leverage : array like residual
        Share of each datum that the fit follows, whatever its error.
    """

    poles: Complex
    participation: Complex
    shapes: Complex
    covariance: Real
    misfit: float
    residual: Complex
    rest: Complex
    rest_shares: Real
    correlation: Real
    stayed: NDArray[np.bool_]
    leverage: Real

    @property
    def at(self) -> Poles:
        """Where it stands."""
        return Poles(self.poles, self.participation, self.rest)

    def ranked(self, rank: NDArray[np.intp]) -> ModalFit:
        """The same with its modes in another order."""
        v, moved = self.participation, 2 * len(moving(self.rest))
        old = {key: i for i, key in enumerate(_keys(v, moved))}
        own = [old[name, j, int(rank[k])] if k >= 0 else old[name, j, k] for name, j, k in _keys(v[rank], moved)]
        return replace(
            self, poles=self.poles[rank], participation=self.participation[rank], shapes=self.shapes[rank],
            covariance=self.covariance[np.ix_(own, own)], stayed=self.stayed[rank],
        )  # fmt: skip


def _keys(v: Complex, moved: int) -> list[tuple[str, int, int]]:
    """What each unknown of a fit is: a name, a number, its mode or -1."""
    n = len(v)
    keys = [(name, 0, k) for name in ("real", "imaginary") for k in range(n)] + [("rest", i, -1) for i in range(moved)]
    driven = enumerate(_driven(v))
    return keys + [
        (name, j, int(k)) for j, moves in driven for name in ("real driven", "imaginary driven") for k in moves
    ]


# -- responses --------------------------------------------------------------------------------------------------------
def kernel(s: Complex, p: Complex, derivative: int, length: float = np.inf) -> Complex:
    """Response of every pole (lines, modes), of the sensor's kind: that of the states ``x' = p x + u``.

    Where the impulse response was cut after `length` s and the lines are those of its transform, a pole responds with
    ``1 - exp(p length)`` of its size.
    """
    cut = 1 - np.exp(p * length) if np.isfinite(length) else np.ones(len(p))
    through = p if derivative == 2 else np.zeros(len(p))
    return np.asarray(through + p**derivative * cut / (s[:, None] - p))


def kernel_slope(s: Complex, p: Complex, derivative: int, length: float = np.inf) -> Complex:
    """Derivative of `kernel` with respect to the pole."""
    gone = np.exp(p * length) if np.isfinite(length) else np.zeros(len(p))
    far, through = 1 / (s[:, None] - p), float(derivative == 2)
    turn = -length * gone if np.isfinite(length) else 0.0
    own = derivative * p ** max(derivative - 1, 0) * (1 - gone) + p**derivative * turn
    return np.asarray(through + own * far + p**derivative * (1 - gone) * far**2)


def resonators(s: Complex, p: Complex, derivative: int) -> Complex:
    """Response (lines, modes) of real modes of unit modal mass that have these poles."""
    return np.asarray(s[:, None] ** derivative / (s[:, None] ** 2 - 2 * p.real * s[:, None] + np.abs(p) ** 2))


def pole(frequency: float, damping: float) -> complex:
    """Pole (rad/s) of a frequency in Hz and a damping ratio."""
    w = 2 * np.pi * frequency
    return complex(-damping * w, w * np.sqrt(1 - damping**2))


def moving(rest: Complex) -> NDArray[np.intp]:
    """Which resonators outside the band have poles that are unknowns."""
    return np.flatnonzero(-rest.real < HELD * np.abs(rest))


def moved_slopes(s: Complex, rest: Complex, ends: tuple[float, float], derivative: int) -> Complex:
    """Derivatives (lines, 2 resonators) of resonators outside a band with these ends in Hz.

    With respect to the logarithms of their distances from it, then to those of their damping ratios.
    """
    w, decay, (low, high) = np.abs(rest), -rest.real, 2 * np.pi * np.asarray(ends)
    h, plain = resonators(s, rest, derivative), resonators(s, rest, 0)
    by = np.where(w < low, w * (w / low - 1), w - high)
    far = -h * plain * (2 * decay / w * s[:, None] + 2 * w) * by
    return np.asarray(np.concatenate([far, -h * plain * 2 * decay * s[:, None]], axis=1))


def _unknown(rest: Complex, ends: tuple[float, float]) -> tuple[Real, Real]:
    """Logarithms of the distance from the band, as a ratio of frequencies less one, and of the damping ratio."""
    w, (low, high) = np.abs(rest), 2 * np.pi * np.asarray(ends)
    return np.log(np.where(w < low, low / w, w / high) - 1), np.log(-rest.real / w)


def real_rows(x: Complex) -> Real:
    """Complex rows (..., columns) as real ones: real parts above imaginary parts."""
    flat = x.reshape(-1, x.shape[-1])
    return np.concatenate([flat.real, flat.imag])


def each_reference(columns: Complex, references: int) -> Complex:
    """Columns (lines, references, unknowns x references) that every reference has for itself."""
    out = np.zeros((len(columns), references, columns.shape[1], references), complex)
    for j in range(references):
        out[:, j, :, j] = columns
    return out.reshape(len(columns), references, -1)


def basis(s: Complex, derivative: int, at: Poles, length: float = np.inf) -> Complex:
    """What the linear unknowns of an output are multiplied by, (lines, references, 2 modes + resonators x references).

    Real parts of the shapes, their imaginary parts, resonators of every reference.
    """
    g = kernel(s, at.inside, derivative, length)
    c = kernel(s, at.inside.conj(), derivative, length)
    a, b = g[:, None, :] * at.participation.T[None], c[:, None, :] * at.participation.conj().T[None]
    rest = each_reference(resonators(s, at.rest, derivative), at.participation.shape[1])
    return np.concatenate([a + b, 1j * (a - b), rest], axis=2)


def slopes(
    s: Complex,
    derivative: int,
    at: Poles,
    psi: Complex,
    rest: Real,
    ends: tuple[float, float],
    length: float = np.inf,
) -> Complex:
    """Derivatives (lines, references, unknowns) of the FRFs of an output with shapes (modes,) and resonators.

    Poles, real and imaginary, resonators that move, participations but for the largest of each mode.
    """
    p, v = at.inside, at.participation
    a = kernel_slope(s, p, derivative, length)[:, None, :] * (psi * v.T)[None]
    b = kernel_slope(s, p.conj(), derivative, length)[:, None, :] * (psi * v.T).conj()[None]
    own = moving(at.rest)
    moved = moved_slopes(s, at.rest[own], ends, derivative)
    share = rest.reshape(-1, v.shape[1])[own].T
    parts = [a + b, 1j * (a - b), moved[:, None, :] * np.tile(share, (1, 2))[None]]
    if v.shape[1] > 1:
        g = kernel(s, p, derivative, length) * psi
        c = kernel(s, p.conj(), derivative, length) * psi.conj()
        for j, moves in enumerate(_driven(v)):
            one = np.zeros((len(s), v.shape[1], 2 * len(moves)), complex)
            one[:, j] = np.concatenate([(g + c)[:, moves], 1j * (g - c)[:, moves]], axis=1)
            parts.append(one)
    return np.concatenate(parts, axis=2)


def _driven(v: Complex) -> list[NDArray[np.intp]]:
    """Modes whose participation of each reference is unknown."""
    largest = np.argmax(np.abs(v), axis=1)
    return [np.flatnonzero(largest != j) for j in range(v.shape[1])] if v.shape[1] > 1 else []


# -- one problem ------------------------------------------------------------------------------------------------------
class Problem:
    """One band: what a set of poles leaves, and how that changes with them."""

    def __init__(self, band: FrfBand) -> None:
        self.band, self.w = band, 1 / band.std
        self.lines, self.outputs, self.references = band.H.shape
        self.ends = float(band.f[0]), float(band.f[-1])

    def basis(self, at: Poles) -> Complex:
        """Columns of one output before weighting, as `basis` has them."""
        return basis(self.band.s, self.band.derivative, at, self.band.length)

    def solved(self, at: Poles) -> Solved:
        """Shapes and residual for these poles; the cost counts how far the dampings of resonators are from usual."""
        columns, n = self.basis(at), len(at.inside)
        psi, residual = np.zeros((n, self.outputs), complex), np.empty_like(self.band.H)
        rest = np.zeros((self.outputs, columns.shape[2] - 2 * n))
        for o in range(self.outputs):
            w = self.w[:, o]
            rows = real_rows(columns * w[..., None])
            data = real_rows((self.band.H[:, o] * w)[..., None])[:, 0]
            x = linalg.lstsq(rows, data, lapack_driver="gelsy", check_finite=False)[0]
            psi[:, o], rest[o] = x[:n] + 1j * x[n : 2 * n], x[2 * n :]
            residual[:, o] = self.band.H[:, o] - columns @ x
        cost = float(np.sum(np.abs(residual * self.w) ** 2) + np.sum(self._unusual(at) ** 2))
        return Solved(cost, psi, rest, residual)

    def _unusual(self, at: Poles) -> Real:
        """Logarithms of the damping ratios outside the band over the usual one, at the weight of the data."""
        damped = _unknown(at.rest[moving(at.rest)], self.ends)[1]
        return np.asarray((damped - np.log(DAMPED)) / FACTOR / np.sqrt(2))

    def losses(self, at: Poles) -> Real:
        """How much the squared residual would rise without each mode (modes,), its unknowns eliminated."""
        columns, n = self.basis(at), len(at.inside)
        out = np.zeros(n)
        for o in range(self.outputs):
            w = self.w[:, o, :, None]
            rows = np.hstack([real_rows(columns * w), real_rows(self.band.H[:, o, :, None] * w)])
            R = linalg.qr(rows, mode="r", check_finite=False)[0][: rows.shape[1]]
            for k in range(n):
                own = [k, n + k]
                rest = [c for c in range(R.shape[1] - 1) if c not in own]
                last = linalg.qr(R[:, [*rest, *own, R.shape[1] - 1]], mode="r", check_finite=False)[0]
                out[k] += np.sum(last[len(rest) : len(rest) + 2, -1] ** 2)
        return out

    def linearised(self, at: Poles, found: Solved) -> Linearised:
        """The projected problem about some poles."""
        columns = self.basis(at)
        R, kept, leverage = np.zeros((0, 0)), [], np.empty(self.band.H.shape)
        for o in range(self.outputs):
            w = self.w[:, o, :, None]
            Q = linalg.qr(real_rows(columns * w), mode="economic", check_finite=False)[0]
            turn = slopes(self.band.s, self.band.derivative, at, found.shapes[:, o], found.rest[o], self.ends,
                          self.band.length)  # fmt: skip
            J = real_rows(turn * w)
            J -= Q @ (Q.T @ J)
            stacked = np.hstack([J, real_rows(found.residual[:, o, :, None] * w)])
            R = linalg.qr(np.vstack([R, stacked]) if R.size else stacked, mode="r", check_finite=False)[0]
            R = R[: stacked.shape[1]]
            half = len(J) // 2
            leverage[:, o] = (np.sum(Q**2, axis=1).reshape(2, self.lines, -1)).mean(axis=0)
            kept.append((J[:half] + 1j * J[half:]).reshape(self.lines, self.references, -1))
        unusual = self._unusual(at)
        rows = np.zeros((len(unusual), R.shape[1]))
        first = 2 * len(at.inside) + len(unusual)
        rows[:, first : first + len(unusual)] = np.eye(len(unusual)) / FACTOR / np.sqrt(2)
        rows[:, -1] = -unusual
        R = linalg.qr(np.vstack([R, rows]), mode="r", check_finite=False)[0][: R.shape[1]]
        return Linearised(R[:-1, :-1], R[:-1, -1], kept, leverage)

    def linear(self, at: Poles) -> int:
        """Number of linear unknowns."""
        return self.outputs * (2 * len(at.inside) + len(at.rest) * self.references)

    def moved(self, at: Poles, step: Real) -> Poles:
        """Poles after a step, in which none moves by more than its decay rate or ceases to decay.

        A resonator moves by its distance from the band at most, and its damping by a factor of e.
        """
        p, v, own = at.inside, at.participation, moving(at.rest)
        n, q = len(p), len(own)
        by = step[:n] + 1j * step[n : 2 * n]
        there = p + by * np.minimum(1.0, np.abs(p.real) / np.maximum(np.abs(by), np.finfo(float).tiny))
        there = np.minimum(there.real, LEAST * p.real) + 1j * there.imag
        rest, place = np.array(at.rest), 2 * n + 2 * q
        far, damped = _unknown(rest[own], self.ends)
        low = np.abs(rest[own]) < 2 * np.pi * self.ends[0]
        most = np.where(low, 0.0, APART[1])  # a mode below half of the first line is one of many
        far = np.exp(np.clip(far + np.clip(step[2 * n : 2 * n + q], -1, 1), APART[0], most)) + 1
        damped = np.exp(np.clip(damped + np.clip(step[2 * n + q : place], -1, 1), *DAMPINGS))
        f = np.where(low, self.ends[0] / far, self.ends[1] * far)
        rest[own] = [pole(x, z) for x, z in zip(f, damped, strict=True)]
        u = np.array(v)
        for j, moves in enumerate(_driven(v)):
            u[moves, j] += step[place : place + len(moves)] + 1j * step[place + len(moves) : place + 2 * len(moves)]
            place += 2 * len(moves)
        return Poles(there, turned(u), rest)


def turned(v: Complex) -> Complex:
    """Participations with their largest entry 1."""
    top = v[np.arange(len(v)), np.argmax(np.abs(v), axis=1)] if len(v) else np.ones(0)
    return v / np.where(top == 0, 1.0, top)[:, None]


# -- the fit ----------------------------------------------------------------------------------------------------------
def fitted(band: FrfBand, at: Poles, stayed: NDArray[np.bool_], steps: int = STEPS) -> ModalFit:
    """Poles and participations of maximum likelihood, begun at some.

    Gauss and Newton with steps that are halved while they do not lower the misfit; a pole that is vague holds none of
    the others back.
    """
    problem = Problem(band)
    at = Poles(at.inside, turned(at.participation), at.rest)
    found = problem.solved(at)
    for _ in range(steps):
        step = _step(*problem.linearised(at, found)[:2])
        for k in range(HALVINGS):
            there = problem.moved(at, step * 0.5**k)
            trial = problem.solved(there)
            if trial.cost < found.cost:
                break
        else:
            break
        fall = (found.cost - trial.cost) / max(found.cost, np.finfo(float).tiny)
        at, found = there, trial
        if fall < DONE:
            break
    last = problem.linearised(at, found)
    white, root = found.residual / band.std, root_of(last.R)
    freedom = max(2 * white.size - last.R.shape[1] - problem.linear(at), 1)
    misfit = 2 * float(np.sum(np.abs(white) ** 2)) / freedom
    rho = correlation(white)
    moved = [J @ root for J in last.slopes]
    leverage = last.leverage + 0.5 * np.stack([np.sum(np.abs(half) ** 2, axis=2) for half in moved], axis=1)
    return ModalFit(
        at.inside, at.participation, found.shapes, _covariance(root, moved, rho) * band.loss * misfit / 2, misfit,
        found.residual, at.rest, found.rest, rho, stayed, leverage,
    )  # fmt: skip


def _step(R: Real, right: Real) -> Real:
    """Gauss and Newton's step, columns of one size first: poles and participations have their own units."""
    scale = np.linalg.norm(R, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    return np.asarray(linalg.lstsq(R / scale, right, cond=1e-10, check_finite=False)[0] / scale)


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


def _covariance(root: Real, moved: list[Complex], rho: Real) -> Real:
    """Covariance of the unknowns at unit std, errors of neighbouring lines correlated: ``N^-1 M N^-1``.

    By a root of N^-1 and the slopes (lines, references, rank) of each output times it.
    """
    middle = np.eye(root.shape[1])
    for half in moved:
        for lag, value in enumerate(rho, start=1):
            cross = np.einsum("lju,ljv->uv", half[:-lag].conj(), half[lag:]).real
            middle = middle + value * (cross + cross.T)
    values, vectors = np.linalg.eigh(0.5 * (middle + middle.T))
    wide = root @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    return np.asarray(wide @ wide.T)
