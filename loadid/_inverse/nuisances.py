"""Parameters that nobody asks for, such as errors of the model: linearised about a fit, marginalised with the load.

    y = H(theta) g + e,   theta ~ N(0, Sigma),   H(theta) g = H g + S (theta - theta_),   S_i = dH/dtheta_i g_

The covariance of the data about the fit is K + S Sigma S', K that of load and noise. By Woodbury's identity all follows
from what the problem without parameters makes of each column: K^-1 S_i, and the load J_i that it would estimate.

    P = (Sigma^-1 + S' K^-1 S)^-1,   d = P (S' K^-1 (y - H g_) - Sigma^-1 theta_),
    g = g_ - J d,   cov g = cov_0 + J P J'

The prior of the load is taken about the fit: a parameter that only scales the load is learned from nothing, and what
was said of it before stays in the band. (Joint input-state-parameter estimation by sensitivities: Y. Xu & C. Soize;
O. Zhang, J. Antoni & E. Foltete treat it by sampling. Laplace's method: D. MacKay, Neural Comput. 4 (1992) 448.)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np

from .gaussian.gains import feedback
from .gaussian.passes import forward
from .gaussian.record import WhitenedRecord
from .gaussian.roots import Array

STEP = 1e-3  # of a finite difference, over the std of the parameter
PROPER = 1e-12  # variance over the largest below which a combination of parameters is held at zero
SEEN = 1e-4  # energy over that of the noise up to which one std of a parameter is not seen in the data


@dataclass(frozen=True, eq=False)
class Nuisances:
    """Parameters of a problem and their prior, of mean zero.

    Parameters
    ----------
    names : tuple of str
    covariance : array, shape (k, k)
    record : callable
        Parameters (k,) -> the problem with them.
    """

    names: tuple[str, ...]
    covariance: Array
    record: Callable[[Array], WhitenedRecord]

    @property
    def std(self) -> Array:
        """Standard deviations, shape (k,)."""
        return np.sqrt(np.diag(self.covariance))

    def columns(self, at: Array, respond: Callable[[WhitenedRecord], Array]) -> tuple[Array, Array]:
        """Response at some parameters, and its derivative by each, (k, ...); `respond` answers for one load."""
        base, out = respond(self.record(at)), []
        for i, std in enumerate(self.std):
            moved = np.array(at)
            moved[i] += STEP * std
            out.append((respond(self.record(moved)) - base) / (STEP * std))
        return base, np.array(out)


Solve: TypeAlias = Callable[[Array], tuple[Array, Array]]


@dataclass(frozen=True, eq=False)
class Marginal:
    """What data tell of parameters, and what these do to the load.

    Parameters
    ----------
    mean : array, shape (k,)
    covariance : array, shape (k, k)
    step : array, shape (k,)
        Mean less the point at which the problem was linearised.
    pulled : array, shape (k, ...)
        Load that a unit of each parameter is taken for.
    gain : float
        Log likelihood that the step gains.
    odds : float
        Probability of being told errors as large as these, where they are of their prior.
    """

    mean: Array
    covariance: Array
    step: Array
    pulled: Array
    gain: float
    odds: float

    @property
    def shift(self) -> Array:
        """What the step takes from the load."""
        return np.asarray(np.tensordot(self.step, self.pulled, 1))

    @property
    def scatter(self) -> Array:
        """Loads (k, ...) whose outer products are the covariance that the parameters add."""
        w, V = np.linalg.eigh(self.covariance)
        return np.asarray(np.tensordot((V * np.sqrt(np.maximum(w, 0.0))).T, self.pulled, 1))

    @cached_property
    def spread(self) -> Array:
        """Loads (k + 1, ...) whose outer products are what the parameters add to the second moment about the fit.

        That is their covariance, and the shift, which the load of the fit does not make.
        """
        return np.concatenate([self.scatter, self.shift[None]])


def linearised(
    nuisances: Nuisances, load: Array, start: Array, solve: Solve, data: Array, noise: Array | float
) -> Marginal:
    """Marginalise errors of a model about a load; what the data cannot see of them keeps its prior and moves nothing.

    Parameters
    ----------
    nuisances : Nuisances
    load : array, shape (samples, p)
    start : array, shape (n,)
        State at the first sample; further states behind it do not count.
    solve : callable
        As of `marginal`.
    data : array, shape (samples, m)
        Zero where there are none.
    noise : array, broadcast to that shape
        Variances.
    """

    def respond(record: WhitenedRecord, load: Array, first: Array) -> Array:
        return forward(record, feedback(record, record.E), np.ascontiguousarray(load), first[: record.n])[2]

    mean = np.zeros(len(nuisances.names))
    response, columns = nuisances.columns(mean, lambda record: respond(record, load, start))
    seen = np.sum(columns**2 / noise, axis=(1, 2)) * nuisances.std**2 > SEEN
    step, covariance, every = 0.0 * mean, np.array(nuisances.covariance), np.zeros((len(mean), *load.shape))
    if not seen.any():
        return Marginal(mean, covariance, step, every, 0.0, 1.0)
    plain, inside = nuisances.record(mean), np.ix_(seen, seen)
    each = np.array([respond(plain, load * one, 0.0 * start) for one in np.eye(load.shape[1])])
    part = marginal(columns[seen], solve, data - response, covariance[inside], mean[seen], each)
    mean[seen], step[seen], every[seen], covariance[inside] = part.mean, part.step, part.pulled, part.covariance
    return Marginal(mean, covariance, step, every, part.gain, part.odds)


def marginal(
    columns: Array, solve: Solve, residual: Array, covariance: Array, at: Array,
    loads: Array | None = None,
) -> Marginal:  # fmt: skip
    """Marginalise parameters of a linearised problem.

    Parameters
    ----------
    columns : array, shape (k, ...)
        Derivative of the data by each.
    solve : callable
        Data -> K^-1 times them, and the load that is estimated from them.
    residual : array
        Data less the response of the fit.
    covariance : array, shape (k, k)
        Before the data.
    at : array, shape (k,)
        Where it is linearised.
    loads : array, shape (p, ...), optional
        Data that each load makes. Errors that only scale it are not told: its prior is of its own size.
    """
    k = len(columns)
    weighed, pulled = zip(*(solve(one) for one in columns), strict=True)
    flat = np.array(weighed).reshape(k, -1)
    known = flat @ columns.reshape(k, -1).T
    known, seen = (known + known.T) / 2, flat @ residual.ravel()
    if loads is not None:
        beside = np.array([solve(one)[0] for one in loads]).reshape(len(loads), -1)
        size, shared = beside @ loads.reshape(len(loads), -1).T, flat @ loads.reshape(len(loads), -1).T
        along = np.linalg.lstsq((size + size.T) / 2, shared.T, rcond=None)[0].T
        seen, known = seen - along @ (beside @ residual.ravel()), known - along @ shared.T
    # Sigma = R R': no inverse of a prior that is nearly singular
    w, V = np.linalg.eigh(covariance)
    root = V * np.sqrt(np.maximum(w, 0.0))
    after = root @ np.linalg.solve(np.eye(k) + root.T @ known @ root, root.T)
    mean = after @ (seen + known @ at)
    step = mean - at
    return Marginal(mean, after, step, np.array(pulled), 0.5 * float(step @ known @ step), _odds(mean, w, V, after))


TOLD = 1e-10  # share of a column that no load may make, below which its parameter is not told


@dataclass(frozen=True, eq=False)
class Free:
    """Parameters without a prior, by generalised least squares.

    Parameters
    ----------
    mean : array, shape (k,)
    covariance : array, shape (k, k)
        For noise of unit level.
    noise2 : float
        Variance of the noise that the data show, load and parameters taken off.
    explained : float
        What they take off the objective.
    left : int
        Degrees of freedom of `noise2`.
    """

    mean: Array
    covariance: Array
    noise2: float
    explained: float
    left: int

    def chance(self, excess: float = 1.0) -> float:
        """Of values as far from zero where they are zero, and noise like them has up to this variance over `noise2`."""
        from scipy.special import fdtrc

        k = len(self.mean)
        return float(fdtrc(k, self.left, self.explained / k / self.noise2 / max(excess, 1.0)))

    @property
    def std(self) -> Array:
        """For unit noise, shape (k,)."""
        return np.sqrt(np.diag(self.covariance))


def free(columns: Array, left: Array, residual: Array, objective: float, m: int, least: float) -> Free | None:
    """Parameters ``b`` of ``y = H g + C b + e`` that nothing is known of; None where no data tell them from the load.

    Parameters
    ----------
    columns : array, shape (k, ...)
        Data C that a unit of each makes.
    left, residual : array, shapes (k, ...), (...)
        K^-1 times the columns and times the data.
    objective : float
        ``y' K^-1 y``.
    m : int
        Number of data.
    least : float
        Variance of the noise of these data, which they may contradict upwards alone; 0 where it is not known.
    """
    k = len(columns)
    flat = columns.reshape(k, -1)
    size = np.sqrt(np.sum(flat**2, axis=1))
    if m <= k or not size.all():
        return None
    flat = flat / size[:, None]
    known = flat @ left.reshape(k, -1).T / size
    w, V = np.linalg.eigh((known + known.T) / 2)
    if w[0] <= TOLD:
        return None
    seen = V.T @ (flat @ residual.ravel())
    explained = float(np.sum(seen**2 / w))
    noise2 = max((objective - explained) / (m - k), least, np.finfo(float).tiny)
    covariance = (V / w) @ V.T / size / size[:, None]
    return Free(V @ (seen / w) / size, covariance, noise2, explained, m - k)


def _odds(mean: Array, w: Array, V: Array, after: Array) -> float:
    """Tail of chi squared of a posterior mean in units of its prior V diag(w) V', with the degrees that data told."""
    from scipy.special import gammaincc

    proper = w > PROPER * w.max(initial=0.0)
    back = V[:, proper].T / np.sqrt(w[proper])[:, None]
    told = proper.sum() - float(np.trace(back @ after @ back.T))
    return float(gammaincc(max(told, 1.0) / 2, float(np.sum((back @ mean) ** 2)) / 2))
