"""Which modes a band of FRFs holds: those that explain more than chance, and resonators for what lies outside it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from .modalfit import QUICK, Complex, FrfBand, ModalFit, Poles, Problem, Real, fitted, pole, turned
from .spectra import smooth_lines

EXTRA = 12  # places where the residual of a fit may ask for a mode
BESIDE = 5  # lines on each side of one that gave none
GUESSED = 0.01  # damping ratio with which they begin
DAMPED = 0.25  # and beyond which there is no mode
LOW, LOW_DAMPING = (
    0.1,
    0.5,
)  # what stands for rigid motion and all far below the band: share of its start, damping ratio
NEAR, STAYS = 0.8, 0.51  # where a mode just below the band begins, and from where on it is one: times its start
ABOVE = ((1.3,), (2.0,), (4.0,), (1.3, 2.0), (1.5, 4.0))  # and those for what is above it: times its end
BOTH = 0.01  # of the highest, within which two resonators outside are one
OUTSIDE = 0.02  # damping ratio of modes outside
LEFT = 0.05  # share of a datum that a fit leaves, at least
FEWEST = 6.0  # degrees of freedom of a smoothed power, at least


def candidates(band: FrfBand) -> list[Complex]:
    """Sets of poles (rad/s) of modes that may stand for those outside the band; none just below it."""
    top, low = float(band.f[-1]), LOW * float(band.f[0])
    above = [[pole(times * top, OUTSIDE) for times in some] for some in ABOVE]
    below = [[pole(low, LOW_DAMPING), *some] for some in above] if low > 0 else []
    return [np.array(some, complex) for some in (*above, *below)]


def completed(band: FrfBand, poles: Complex, participation: Complex) -> Complex:
    """The set of `candidates` that explains most, a larger set only where it is worth its unknowns (Schwarz)."""
    v, size, problem = turned(participation), 2 * band.H.size, Problem(band)

    def worth(some: Complex) -> float:
        at = Poles(poles, v, some)
        floor = np.finfo(float).eps ** 2 * float(np.sum(np.abs(band.H / band.std) ** 2))
        return size * float(np.log(max(problem.solved(at).cost, floor))) + problem.linear(at) * float(np.log(size))

    return min(candidates(band), key=worth)


def neighboured(band: FrfBand, fit: ModalFit) -> ModalFit:
    """A fit with a mode just below the band, where that is worth its unknowns and stays there.

    One that moves far below is the sum of many: it would ring in a model where nothing was measured.
    """
    start = float(band.f[0])
    if start <= 0:
        return fit
    near = np.append(fit.rest, pole(NEAR * start, OUTSIDE))
    trial = fitted(band, Poles(fit.poles, fit.participation, near), fit.stayed, QUICK)
    size, more = 2 * band.H.size, 2 + band.H.shape[1] * band.H.shape[2]
    gain = size * np.log(_power(band, fit) / max(_power(band, trial), np.finfo(float).tiny))
    stays = abs(trial.rest[-1]) > 2 * np.pi * STAYS * start
    return trial if stays and gain > more * np.log(size) else fit


def extended(band: FrfBand, fit: ModalFit) -> ModalFit:
    """A fit with the modes that its residual shows, one after the other while each is worth its unknowns.

    Each begins where the smoothed residual is largest over its std; one that moves onto a mode that is there, within
    the sum of their decay rates, is none, and the next is looked for elsewhere.
    """
    size, tried = 2 * band.H.size, np.zeros(len(band.f), bool)
    for _ in range(EXTRA):
        power = smooth_lines(np.sum(np.abs(fit.residual / band.std) ** 2, axis=(1, 2)), 2)
        line = int(np.argmax(np.where(tried, 0.0, power)))
        at = 2 * np.pi * band.f[line]
        v = linalg.svd(fit.residual[line] / band.std[line])[2][:1]
        p, u = np.append(fit.poles, complex(-GUESSED * at, at)), np.concatenate([fit.participation, v])
        trial = fitted(band, Poles(p, u, fit.rest), np.append(fit.stayed, False), QUICK)
        gain = size * np.log(_power(band, fit) / max(_power(band, trial), np.finfo(float).tiny))
        own = trial.poles[-1]
        apart = np.all(np.abs(own - trial.poles[:-1]) > np.abs(own.real + trial.poles[:-1].real))
        if gain >= _unknowns(band) * np.log(size) and apart and -own.real <= DAMPED * abs(own):
            fit = trial
        else:
            tried[max(line - BESIDE, 0) : line + BESIDE + 1] = True
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
    start = Poles(poles, participation, completed(band, poles, participation))
    fit = extended(band, neighboured(band, fitted(band, start, known, QUICK)))
    before = int(np.sum(fit.stayed))
    while len(fit.poles):
        losses = Problem(band).losses(fit.at) / fit.misfit
        std = np.sqrt(np.diag(fit.covariance))[: len(fit.poles)]
        weak = losses < _unknowns(band) * np.log(2 * band.H.size)
        bad = weak | (std > 0.5 * np.abs(fit.poles.real))
        if not bad.any():
            break
        if len(losses) == 1:
            return replace(fit, stayed=np.zeros(1, bool)), before
        kept = np.arange(len(losses)) != np.argmin(np.where(bad, losses, np.inf))
        fit = fitted(band, Poles(fit.poles[kept], fit.participation[kept], fit.rest), fit.stayed[kept], QUICK)
    fit = parted(band, fitted(band, fit.at, fit.stayed))
    return fit, before - int(np.sum(fit.stayed))


def parted(band: FrfBand, fit: ModalFit) -> ModalFit:
    """A fit without resonators that moved onto one another: their shares are huge and cancel, a filter loses them."""
    while len(fit.rest) > 1:
        gap = np.abs(fit.rest[:, None] - fit.rest) + np.where(np.eye(len(fit.rest)), np.inf, 0.0)
        if gap.min() > BOTH * np.abs(fit.rest).max():
            return fit
        kept = np.arange(len(fit.rest)) != np.argmin(gap.min(axis=1))
        fit = fitted(band, Poles(fit.poles, fit.participation, fit.rest[kept]), fit.stayed)
    return fit


def reweighted(band: FrfBand, fit: ModalFit) -> FrfBand:
    """The band with the std that residuals of neighbouring lines show, none judged by its own.

    What the fit followed of the noise is made up for, line by line (J. G. MacKinnon, H. White, J. Econometrics 29
    (1985) 305-325). With n degrees of freedom the mean of 1/power is n/(n - 2) of what it should be, and divided out.
    """
    half = max(5, len(band.f) // 40)
    left = smooth_lines(np.clip(1 - fit.leverage, LEFT, 1), half, own=False)
    power = smooth_lines(np.abs(fit.residual) ** 2, half, own=False) / left
    freedom = max(_freedom(len(band.f), half, fit.correlation), FEWEST)
    power *= freedom / (freedom - 2)
    least = 1e-12 * np.mean(np.abs(band.H) ** 2, axis=0)
    return replace(band, std=np.sqrt(np.maximum(power, least)), freedom=freedom)


def _freedom(lines: int, half: int, correlation: Real) -> float:
    """Real degrees of freedom of powers that are smoothed over lines with errors that are correlated by so much."""
    k = smooth_lines(np.eye(lines)[:, lines // 2], half, own=False)
    rho = [1.0, *correlation]
    both = sum((2 if lag else 1) * r**2 * float(k[lag:] @ k[: lines - lag]) for lag, r in enumerate(rho))
    return 2 / both
