"""Many frequency lines at once: whitened and compressed, loads of every line, variances from neighbouring lines.

Loads of neighbouring lines are as large as each other on average, though their phases tell nothing of each other: each
load is drawn from a complex normal distribution whose variance changes slowly with frequency, and so is the noise. The
variances with the largest evidence are the regularisation: they replace a lambda per line, which the few data of one
line determine badly, and let an inactive load vanish. M. E. Tipping, J. Mach. Learn. Res. 1 (2001) 211, for variances
by evidence; D. J. C. MacKay, Neural Computation 4 (1992) 415.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

from . import Array, Flags, Numbers
from .path import FactoredPath


@dataclass(frozen=True)
class Compressed:
    """Lines ``R g = b`` with what no load explains.

    Parameters
    ----------
    R : array, shape (lines, rank, loads)
        Whitened FRF after an orthogonal reduction.
    b : array, shape (lines, rank, snapshots)
        Whitened data: ``b b^H`` is the mean over the averages of a cross spectrum; a spectrum is one snapshot.
    outside : array, shape (lines,)
        Squared norm of the data outside the range of the FRF.
    left : int
        Data of a line beyond its loads.
    Q : array, shape (lines, data, rank), optional
        The reduction: ``H = Q R``.
    """

    R: NDArray[np.complex128]
    b: NDArray[np.complex128]
    outside: Array
    left: int
    Q: NDArray[np.complex128] | None = None

    @property
    def shape(self) -> tuple[int, int, int]:
        """Lines, rows and loads."""
        return self.R.shape

    def scaled(self, factor: Numbers) -> Compressed:
        """The same data over other unknowns: load ``g = factor z``, factor (loads,) or (lines, loads)."""
        return Compressed(self.R * np.asarray(factor)[..., None, :], self.b, self.outside, self.left)


def compress(H: Numbers, X: Numbers) -> Compressed:
    """Reduce whitened lines by QR.

    Parameters
    ----------
    H : array, shape (lines, sensors, loads)
    X : array, shape (lines, sensors) or (lines, sensors, snapshots)

    Raises
    ------
    InputError
        Shapes that do not fit, NaN or infinity.
    """
    X = X[..., None] if X.ndim == 2 else X
    if H.ndim != 3 or X.shape[:2] != H.shape[:2] or 0 in H.shape:
        raise InputError("lines and data do not fit", where="frequency lines", found=f"H {H.shape}, data {X.shape}",
                         expected="(lines, sensors, loads) and (lines, sensors)")  # fmt: skip
    if not (np.all(np.isfinite(H)) and np.all(np.isfinite(X))):
        raise InputError("NaN or inf in the lines or the data", where="frequency lines", expected="finite numbers",
                         hint="leave out these lines")  # fmt: skip
    Q, R = np.linalg.qr(H)
    b = Q.conj().swapaxes(1, 2) @ X
    outside = np.maximum(_power(X) - _power(b), 0.0)
    sensors, loads = H.shape[1:]
    if sensors <= loads:
        outside = np.zeros(len(H))  # rounding: the range is everything
    return Compressed(R, b, outside, max(sensors - loads, 0), Q)


def _power(x: Numbers) -> Array:
    """Energy of each line."""
    return np.asarray(np.einsum("ksn,ksn->k", x.conj(), x).real)


@dataclass(frozen=True)
class FactoredLines:
    """Singular value decomposition of the lines over loads of equal expected size.

    Parameters
    ----------
    lines : Compressed
    root : array, shape (lines, loads)
        Expected size of each load: the condition does not depend on the units of the loads.
    U, s : array
        Left singular vectors and singular values of ``R diag(root)``.
    V : array, shape (lines, loads, rank)
        Right singular vectors times `root`: load = V z.
    """

    lines: Compressed
    root: Array
    U: NDArray[np.complex128]
    s: Array
    V: NDArray[np.complex128]

    @property
    def beta(self) -> NDArray[np.complex128]:
        """Data in the singular directions, (lines, rank, snapshots)."""
        return self.U.conj().swapaxes(1, 2) @ self.lines.b

    @property
    def seen(self) -> Flags:
        """Directions above rounding, (lines, rank)."""
        return self.s > max(self.lines.shape[1:]) * np.finfo(float).eps * self.s[:, :1]


class LinesPath(FactoredPath):
    """Path of independent frequency lines, L = I over the weighted loads: every scalar has the lines first."""

    reals = 2

    def __init__(self, f: FactoredLines, truncated: bool = False) -> None:
        beta = np.sqrt(np.einsum("krn,krn->kr", f.beta.conj(), f.beta).real)
        c = np.where(f.seen, f.s, 0.0)
        m = f.lines.shape[1] + f.lines.left
        super().__init__(c, np.ones_like(c), beta, f.lines.outside, m, truncated=truncated)

    def residuals(self, lams: Array) -> None:
        """None: lines are no record."""

    def joined(self, step: int = 1) -> JoinedPath:
        """All lines, or every so many, with one lambda."""
        return JoinedPath(self, slice(None, None, step))


class JoinedPath(FactoredPath):
    """Lines with one lambda: the modes of every line side by side."""

    reals = 2

    def __init__(self, path: LinesPath, keep: slice) -> None:
        c = path.c[keep]
        super().__init__(
            c.ravel(), np.ones(c.size), path.beta[keep].ravel(), np.sum(path.outside[keep]), path.m * len(c),
            truncated=not path.smooth,
        )  # fmt: skip

    def residuals(self, lams: Array) -> None:
        """None: lines are no record."""


@dataclass(frozen=True)
class LinePosterior:
    """What the data say of the loads of each line.

    Parameters
    ----------
    gain : array, shape (lines, loads, rank)
        The estimator: load = gain b.
    load : array, shape (lines, loads, snapshots)
    covariance : array, shape (lines, loads, loads)
        ``E[e e^H]`` of the error of one realisation: noise and prior.
    edf : array, shape (lines,)
        Effective degrees of freedom.
    """

    gain: NDArray[np.complex128]
    load: NDArray[np.complex128]
    covariance: NDArray[np.complex128]
    edf: Array

    @property
    def variance(self) -> Array:
        """``E|error|^2``, shape (lines, loads)."""
        return np.asarray(np.maximum(np.einsum("kjj->kj", self.covariance).real, 0.0))


@dataclass(frozen=True)
class Identifiable:
    """What every line tells of each load without a prior, whatever regularisation does.

    Parameters
    ----------
    gain : array, shape (lines, loads)
        Whitened response to one unit of a load that no other loads can imitate: unit noise over it is the
        least-squares standard deviation. 0 where the line does not determine the load.
    naive : array, shape (lines, loads, snapshots)
        Least-squares loads, of smallest norm where there are many.
    condition : array, shape (lines,)
        Largest over smallest singular value; infinite where the line loses rank.
    inverse : array, shape (lines, loads, rank)
        The least-squares estimator: naive = inverse b.
    """

    gain: Array
    naive: NDArray[np.complex128]
    condition: Array
    inverse: NDArray[np.complex128]


def factor(lines: Compressed, variance: Numbers) -> FactoredLines:
    """Decompose every line, its loads weighted by the root of their variance (lines, loads)."""
    root = np.sqrt(variance)
    U, s, Vh = np.linalg.svd(lines.scaled(root).R, full_matrices=False)
    return FactoredLines(lines, root, U, s, root[..., None] * Vh.conj().swapaxes(1, 2))


def posterior(f: FactoredLines, noise: Numbers, cut: Numbers | None = None) -> LinePosterior:
    """Solve every line.

    Parameters
    ----------
    f : FactoredLines
        Its `root` is the standard deviation of the loads before the data.
    noise : array, shape (lines,)
        Variance of the whitened noise.
    cut : array (lines,), optional
        Singular values below this are left out and none is damped (truncated SVD); what is left out keeps its prior.
    """
    if cut is None:
        s = np.where(f.seen, f.s, 0.0)  # what rounding leaves of a silent direction carries no information
        total = np.where(f.seen, f.s**2 + noise[:, None], 1.0)
        filtered, told, remains = s / total, s**2 / total, np.where(f.seen, noise[:, None] / total, 1.0)
    else:
        kept = f.seen & (f.s >= cut[:, None] * (1 - 1e-12))
        safe = np.where(kept, f.s, 1.0)
        filtered, told = np.where(kept, 1 / safe, 0.0), kept.astype(float)
        remains = np.where(kept, noise[:, None] / safe**2, 1.0)
    gain = (f.V * filtered[:, None, :]) @ f.U.conj().swapaxes(1, 2)
    covariance = (f.V * remains[:, None, :]) @ f.V.conj().swapaxes(1, 2)
    if f.s.shape[1] < f.root.shape[1]:  # directions beyond the rank keep their prior
        j = np.arange(f.root.shape[1])
        covariance -= f.V @ f.V.conj().swapaxes(1, 2)
        covariance[:, j, j] += f.root**2
    return LinePosterior(gain, gain @ f.lines.b, covariance, np.sum(told, axis=1))


def identifiable(f: FactoredLines) -> Identifiable:
    """Judge every line."""
    seen = f.seen
    inverse = np.where(seen, 1 / np.where(seen, f.s, 1.0), 0.0)
    size = np.abs(f.V) ** 2
    spread = np.sqrt(np.einsum("kjr,kr->kj", size, inverse**2))
    # a load that reaches into a direction that the line does not see is not determined
    inside = np.einsum("kjr,kr->kj", size, seen.astype(float))
    told = (inside > (1 - 1e-9) * f.root**2) & (spread > 0)
    full = seen.all(axis=1) & (f.s.shape[1] == f.root.shape[1])
    solver = (f.V * inverse[:, None, :]) @ f.U.conj().swapaxes(1, 2)
    return Identifiable(
        gain=np.where(told, 1 / np.where(told, spread, 1.0), 0.0),
        naive=f.V @ (inverse[..., None] * f.beta),
        condition=np.where(full, f.s[:, 0] / np.where(full, f.s[:, -1], 1.0), np.inf),
        inverse=solver,
    )


SWEEPS = 4  # they settle in about 20, which changes the loads by less than their chance
SETTLED = 0.02  # change of a standard deviation at which the sweeps end
ENOUGH = 60  # data beyond the loads that a noise level rests on
DOUBT = 2.5  # standard errors by which the noise must exceed the stated level before that is set aside
RARE = 1e-3  # chance of calling a stated noise level too low that is right
TINY = 1e-300


@dataclass(frozen=True)
class LinePrior:
    """Variances around each line.

    Parameters
    ----------
    load : array, shape (lines, loads)
        Of each load, one standard error above the most probable: a load that is not seen is not said to be zero.
    probable : array, shape (lines, loads)
        The most probable.
    noise : array, shape (lines,)
        Of the whitened data, 1 where the stated level holds.
    sweeps : int
        How many it took.
    excess : float
        Median of the noise over the stated level on the lines that contradict it; 1 where none does.
    """

    load: Array
    probable: Array
    noise: Array
    sweeps: int
    excess: float = 1.0


def prior(
    lines: Compressed, *, neighbours: int = 40, known: bool = False, averages: float = 1.0, noise: Numbers | None = None
) -> LinePrior:
    """Variances of loads and noise with the largest evidence in a window around each line.

    What no load explains shows the noise by itself; only where no sensor is left over does the evidence settle it,
    since it can take a line that stands alone, a harmonic, for noise. Where a line is out of proportion to its
    neighbours, its loads keep their proportion and get the common size that the line itself shows.

    Parameters
    ----------
    lines : Compressed
    neighbours : int
        Lines to either side that count, with Hann weights.
    known : bool
        The whitened noise has variance 1; it is set aside where the data contradict it.
    averages : float
        Independent averages behind the data.
    noise : array (lines,), optional
        Variance of the whitened noise that is used as it is.
    """
    near, count = window(len(lines.R), neighbours)
    half = 0 if not lines.left else int(np.ceil(ENOUGH / (2 * lines.left * averages)))
    beside, _ = window(len(lines.R), max(half, 1) if lines.left else neighbours)
    energy = np.einsum("kij,kij->kj", lines.R.conj(), lines.R).real
    matched = _square(lines.R.conj().swapaxes(1, 2) @ lines.b)
    load = near(matched) / np.maximum(near(energy**2), TINY) / lines.shape[2] + TINY
    fixed = noise is not None or known or lines.left > 0
    v = noise if noise is not None else np.ones(len(lines.R)) if known else _start(lines, beside, load, energy)
    excess = 1.0
    if noise is None and known and lines.left:
        v, excess = contradicted(lines, averages)
    sweeps, information = 0, np.ones_like(load)
    while sweeps < SWEEPS:
        sweeps += 1
        scaled = lines.scaled(np.sqrt(load))
        a, gained, told = _explained(scaled, v)
        information = np.maximum(near(told), TINY)
        better = np.maximum(near(load * gained) / information, TINY)
        ratio, load = better / load, better
        if not fixed:
            trace = (lines.shape[1] - np.sum(told, axis=1)) / v  # of M^-1
            v = v * beside(_energy(a)) / beside(trace)
        heavy = information > 0.1  # of loads that the data see
        if not heavy.any() or np.max(np.abs(np.log(np.maximum(ratio[heavy], TINY)))) < 2 * SETTLED:
            break
    error = 1 / (np.sqrt(count * averages) * information)
    load *= _raised(lines, load, v, np.einsum("kin,kin->k", scaled.b.conj(), a).real, averages)[:, None]
    return LinePrior(load * (1 + error), load, v, sweeps, excess)


def _raised(lines: Compressed, load: Numbers, v: Numbers, misfit: Numbers, averages: float) -> Array:
    """How much larger the loads of each line are than around it, (lines,): 1 but where the line cannot be chance.

    Parameters
    ----------
    misfit : array, shape (lines,)
        ``b^H M^-1 b``, of mean `rank` where the line is like its neighbours.
    """
    factor = np.ones(len(load))
    alone = np.flatnonzero(misfit > lines.shape[1] * _by_chance(lines.shape[1] * averages, len(load)))
    for _ in range(SWEEPS if len(alone) else 0):
        line = Compressed(lines.R[alone], lines.b[alone], lines.outside[alone], lines.left)
        scaled = line.scaled(np.sqrt(load[alone] * factor[alone, None]))
        _, gained, told = _explained(scaled, v[alone])
        factor[alone] *= np.sum(gained, axis=1) / np.maximum(np.sum(told, axis=1), TINY)
    return np.maximum(factor, 1.0)


def window(lines: int, half: int) -> tuple[Callable[[Numbers], Array], float]:
    """Hann-weighted mean over neighbouring lines, and to how many independent ones that amounts."""
    from scipy.ndimage import convolve1d

    half = max(min(half, (lines - 1) // 2), 0)
    kernel = np.hanning(2 * half + 3)[1:-1]
    kernel /= kernel.sum()
    if half == 0:
        return lambda x: np.asarray(x, float), 1.0
    return lambda x: convolve1d(np.asarray(x, float), kernel, axis=0, mode="mirror"), float(1 / np.sum(kernel**2))


def contradicted(lines: Compressed, averages: float = 1.0, expected: Numbers | float = 1.0) -> tuple[Array, float]:
    """Variance of what no load explains where the data show more than `expected`, else 1; and how much in the middle.

    Both are over what is expected, a number or (lines,): the stated 1 of whitened noise.
    """
    half = int(np.ceil(2 * ENOUGH / (2 * lines.left * averages)))
    beside, count = window(len(lines.R), half)
    shown = beside(lines.outside / expected) / lines.left
    limit = 1 + DOUBT / np.sqrt(count * lines.left * averages)
    above = shown > limit
    clear = np.max(shown) > _by_chance(count * lines.left * averages, len(shown) / count)
    return np.where(above, shown, 1.0), float(np.median(shown[above])) if clear and np.mean(above) > 0.05 else 1.0


def _by_chance(data: float, windows: float) -> float:
    """Largest mean square of complex noise of variance 1 over that many data, in one of some windows, but for RARE."""
    from scipy.special import gammainccinv

    return float(gammainccinv(data, RARE / max(windows, 1.0)) / data)


def _start(lines: Compressed, beside: Callable[[Numbers], Array], load: Numbers, energy: Numbers) -> Array:
    """First guess of the noise."""
    data = _energy(lines.b) + lines.outside
    if lines.left:
        return np.asarray(np.maximum(beside(lines.outside) / lines.left, 1e-24 * np.max(data)))
    return np.asarray(np.maximum(1e-3 * beside(data) / lines.shape[1], 1e-24 * np.max(data)))


def _explained(scaled: Compressed, v: Numbers) -> tuple[Numbers, Numbers, Numbers]:
    """``M^-1 b``, ``|A^H M^-1 b|^2`` and the diagonal of ``A^H M^-1 A``; M = A A^H + v I is the covariance of the data.

    The noise in M keeps it well conditioned.
    """
    A = scaled.R
    adjoint = A.conj().swapaxes(1, 2)
    M = A @ adjoint
    size = np.einsum("kii->k", M).real + v
    rows = np.arange(M.shape[1])
    M[:, rows, rows] += np.maximum(v, 1e-14 * size)[:, None]
    solved = np.linalg.solve(M, np.concatenate([scaled.b, A], axis=2))
    a, B = solved[..., : scaled.b.shape[2]], solved[..., scaled.b.shape[2] :]
    return a, _square(adjoint @ a), np.einsum("kij,kij->kj", A.conj(), B).real


def _square(x: Numbers) -> Array:
    """Sum of squares over the snapshots."""
    return np.asarray(np.einsum("kjn,kjn->kj", x.conj(), x).real)


def _energy(x: Numbers) -> Array:
    return np.asarray(np.einsum("kjn,kjn->k", x.conj(), x).real)
