"""Tractions on a layer wave by wave: modes, regularisation path, bands; and by iteration where waves alone do not do.

The penalty is the norm of loads z, of which the tractions are ``root`` times the waves: white ones, or smooth ones. On
a full grid the singular value decomposition of every wave (its directions of motion by those of traction) makes the
problem diagonal. What rules and bands ask are sums over the modes of smooth functions of the singular value alone: each
mode is shared out between the two nearest values of a fixed set, so that every sum is right to 1e-5.

Where places are missing, scattered, or a frame bounds the load, the same problem is solved by conjugate gradients. What
rules ask of it then comes from two bidiagonalisations, one of the data and one of a random vector for the traces
(G. Golub & U. von Matt, J. Comput. Graph. Stat. 6 (1997) 1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from loadid._inverse.path import FactoredPath
from structures.errors import NotIdentifiable

from .._arrays import Array
from .._closed.waves import Gridding, Waved, Waves

CLASS = 0.01  # distance of the values, in their logarithm
FLOOR = 1e-14  # of the largest singular value: the least value
STEPS = 80  # of a bidiagonalisation
SETTLED, ROUGH = 1e-8, 1e-4  # residual at which conjugate gradients end, over the first: of a load, of bands and shares
MOST = 1000  # their steps
ASIDE = 1e-9  # weight of a mode that holds data and counts for no trace


class WavesPath(FactoredPath):
    """Path of many modes, by a fixed set of singular values."""

    def residuals(self, lams: Array) -> None:
        """None: places are no record."""

    def energies(self) -> None:
        """None: the modes are not told apart."""


class WaveSpectrum:
    """Modes of the waves on a layer.

    Parameters
    ----------
    waves : Waves
    noise : array (axes,)
        Std of the motion seen along X, Y (and Z), m.
    loads : int
        2 for tractions in the plane alone, 3 with normal ones.
    smooth : float
        Length (m) over which tractions are smooth: the penalty is ``|t|^2 + smooth^2 |grad t|^2``.
    """

    def __init__(self, waves: Waves, noise: Array, loads: int, smooth: float = 0.0) -> None:
        self.waves, self.noise, self.loads = waves, noise, loads
        kx, ky = waves.numbers
        self.root = 1 / np.sqrt(1 + smooth**2 * (kx**2 + ky**2))
        self.white = smooth == 0
        self.symbol = waves.symbol[: len(noise), :loads] / noise[:, None, None, None]
        posed = np.moveaxis(self.symbol * self.root, (0, 1), (-2, -1))
        U, c, Vh = np.linalg.svd(posed, full_matrices=False)
        self.c = np.ascontiguousarray(np.moveaxis(c, -1, 0))
        self.adjoint = np.ascontiguousarray(np.moveaxis(U.conj(), (-1, -2), (0, 1)))  # (modes, axes, ...)
        self.V = np.ascontiguousarray(np.moveaxis(Vh.conj(), (-1, -2), (0, 1)))  # (loads, modes, ...)
        least = float(self.c.max()) * FLOOR
        place = (np.log(np.maximum(self.c, least) / least) / CLASS).ravel()
        self._below, low = place.astype(np.intp), int(place.min())
        self._above = place - self._below
        self._below -= low
        self.values = least * np.exp(CLASS * np.arange(low, low + self._below.max() + 2))
        self.counts = self.binned(np.ones(self.c.shape))

    def binned(self, values: Array) -> Array:
        """Sums at the values of something of every mode (modes, ny, nx // 2 + 1), each as often as its wave counts."""
        weighed = np.broadcast_to(values * self.waves.counts, self.c.shape).ravel()
        above = weighed * self._above
        found = np.bincount(self._below, weighed - above, minlength=len(self.values))
        found[1:] += np.bincount(self._below, above, minlength=len(self.values))[:-1]
        return np.asarray(found, float)

    def modal(self, motion: Array) -> Waved:
        """Coefficients of the modes in whitened motion (axes, <= ny, <= nx), nothing beyond."""
        return _times(self.adjoint, self.waves.waves(motion))

    def load(self, coefficients: Waved) -> Array:
        """Tractions (loads, ny, nx) of coefficients of the modes."""
        return self.waves.field(_times(self.V, coefficients) * self.root)

    def path(self, motions: Sequence[Array]) -> WavesPath:
        """Path of whitened motions (axes, ny, nx) of a full window, with one lambda."""
        beta, outside = np.zeros(len(self.values)), 0.0
        for motion in motions:
            found = self.binned(np.abs(self.modal(motion)) ** 2)
            beta += found
            outside += max(float(np.sum(motion**2)) - found.sum(), 0.0)
        data = motions[0][0].size * len(motions)
        share = data / np.prod(self.waves.shape)
        square, some = len(self.noise) <= self.loads, self.counts > 0
        return WavesPath(
            self.values[some], np.ones(some.sum()), np.sqrt(beta[some] / (self.counts[some] * share)),
            0.0 if square else outside, data * len(self.noise), weight=self.counts[some] * share,
        )  # fmt: skip

    def filtered(self, motion: Array, alpha: float) -> tuple[Array, Array]:
        """Tractions (loads, ny, nx) of whitened motion of a full window, and what this absolute lambda costs them."""
        total = self.c**2 + alpha**2
        found = self.modal(self.waves.held(motion)) * (self.c / total)
        return self.load(found), self.load(-found * (alpha**2 / total))

    def motion(self, load: Array) -> Array:
        """Whitened motion (axes, ny, nx) of all nodes under tractions (loads, <= ny, <= nx)."""
        return self.waves.field(_times(self.symbol, self.waves.waves(load)))

    def found(self, load: Array, alpha: float) -> Array:
        """What would be found of tractions (loads, <= ny, <= nx) without noise, if all of their motion were seen."""
        return self.load(_times(self.adjoint, self.waves.waves(self.motion(load))) * (self.c / (self.c**2 + alpha**2)))

    def residual(self, motion: Array, load: Array) -> Array:
        """What tractions (loads, ny, nx) leave of whitened motion of a full window."""
        return motion - self.motion(load)[:, : motion.shape[1], : motion.shape[2]]

    @property
    def scale(self) -> float:
        """Largest singular value."""
        return float(self.values[self.counts > 0].max())

    def spread(self, alpha: float, density: float = 1.0) -> Array:
        """Std of the tractions (loads,) in units of the noise, where `density` data are seen for every node."""
        shares = self._shares / np.prod(self.waves.shape)
        prior = 1 / alpha**2 if alpha else 0.0
        whole = float(np.sum(self.root**2 * self.waves.counts) / np.prod(self.waves.shape))
        left = np.maximum(whole - shares.sum(axis=1), 0.0) if len(self.noise) < self.loads else 0.0
        return np.sqrt(shares @ (1 / (density * self.values**2 + alpha**2)) + left * prior)

    @cached_property
    def _shares(self) -> Array:
        """Share of each component of the tractions in the modes of each value (loads, values)."""
        return np.array([self.binned(np.abs(row * self.root) ** 2) for row in self.V])

    def gram(self, rows: Sequence[Array]) -> Array:
        """Products of fields (loads, ny, nx) at each value, and beyond all modes: (values + 1, rows, rows)."""
        told = [self.waves.waves(row) * self.root for row in rows]
        modes = [_times(np.swapaxes(self.V.conj(), 0, 1), one) for one in told]
        whole = np.array([[float(np.sum((a * b.conj()).real * self.waves.counts)) for b in told] for a in told])
        found = np.empty((len(self.values) + 1, len(rows), len(rows)))
        for i, a in enumerate(modes):
            for j in range(i + 1):
                found[:-1, i, j] = found[:-1, j, i] = self.binned((a * modes[j].conj()).real)
        found[-1] = whole - found[:-1].sum(axis=0) if len(self.noise) < self.loads else 0.0
        return found

    def covariance(self, gram: Array, alpha: float) -> Array:
        """Covariance of the sums that `gram` was made of, in units of the noise squared."""
        weight = np.append(1 / (self.values**2 + alpha**2), 1 / alpha**2 if alpha else 0.0)
        return np.asarray(np.einsum("b,bij->ij", weight, gram))


def _times(matrices: Waved, vectors: Waved) -> Waved:
    """Products of (rows, columns, ...) with (columns, ...), wave by wave."""
    return np.asarray([sum(m * v for m, v in zip(row, vectors, strict=True)) for row in matrices])


@dataclass(frozen=True, eq=False)
class Gathered:
    """The same problem where not every node of the grid is seen, or not every node loaded.

    Parameters
    ----------
    spectrum : WaveSpectrum
    seen : Gridding or None
        Points that are seen; None: nodes.
    precision : array (axes, points) or (axes, ny, nx)
        One over the std of each datum in units of the noise; 0 where there is none.
    loaded : tuple of two slices
        Nodes that may be loaded.
    density : float
        Data for every node.
    """

    spectrum: WaveSpectrum
    seen: Gridding | None
    precision: Array
    loaded: tuple[slice, slice]
    density: float

    def data(self, motion: Array) -> Array:
        """Data of whitened motion (axes, points), or (axes, <= ny, <= nx) on the first nodes, held beyond."""
        if self.seen is not None:
            return motion * self.precision
        return self.spectrum.waves.held(motion) * self.precision

    def filtered(self, data: Array, alpha: float) -> tuple[Array, Array]:
        """As `WaveSpectrum.filtered`, on the nodes that may be loaded."""
        load = self.solve(self.back(data), alpha, SETTLED)
        return load, -(alpha**2) * self.solve(self._penalised(load), alpha)

    def found(self, load: Array, alpha: float) -> Array:
        """What would be found of tractions (loads, <= y, <= x) without noise."""
        return self.solve(self.back(self.motion(self._embedded(load))), alpha)

    def residual(self, data: Array, load: Array) -> Array:
        """What tractions leave of the data."""
        return data - self.motion(load)

    @property
    def scale(self) -> float:
        """Largest singular value."""
        return float(self._traces[0].max())

    def spread(self, alpha: float) -> Array:
        """Std of the tractions (loads,) in units of the noise, as if data of this density were everywhere."""
        return self.spectrum.spread(alpha, self.density)

    def covariance(self, rows: Array, alpha: float) -> Array:
        """Covariance of sums of tractions with weights (rows, loads, <= y, <= x), in units of the noise squared."""
        whole = np.array([self._embedded(row) for row in rows])
        size = np.sqrt(np.sum(whole**2, axis=(1, 2, 3)))
        told = [i for i in range(len(rows)) if size[i] > 0]
        found = np.zeros((len(rows), len(rows)))
        for i in told:
            found[i] = np.einsum("lyx,rlyx->r", self.solve(whole[i] / size[i], alpha), whole) * size[i]
        return (found + found.T) / 2

    def motion(self, load: Array) -> Array:
        """Whitened data of tractions (loads, y, x) on the nodes that may be loaded."""
        waves = _times(self.spectrum.symbol, self._waves(load))
        found = self.spectrum.waves.field(waves) if self.seen is None else self.seen(waves)
        return found * self.precision

    def back(self, data: Array) -> Array:
        """Adjoint of `motion`."""
        weighed = data * self.precision
        waves = self.spectrum.waves.waves(weighed) if self.seen is None else self.seen.adjoint(weighed)
        return self._field(_times(np.swapaxes(self.spectrum.symbol.conj(), 0, 1), waves))

    def solve(self, load: Array, alpha: float, settled: float = ROUGH) -> Array:
        """``(H^T H + alpha^2)^-1`` times tractions, to a residual of `settled`."""
        from scipy.sparse.linalg import LinearOperator, cg

        s, shape, size = self.spectrum, load.shape, load.size
        told = self.density * s.c**2
        share = told / (told + alpha**2)

        def posed(x: Array) -> Array:
            t = x.reshape(shape)
            return np.asarray((self.back(self.motion(t)) + alpha**2 * self._penalised(t)).ravel())

        def undone(x: Array) -> Array:
            waves = self._waves(x.reshape(shape)) * s.root
            modes = _times(np.swapaxes(s.V.conj(), 0, 1), waves)
            return np.asarray(self._field((waves - _times(s.V, share * modes)) * s.root).ravel()) / alpha**2

        A, M = (LinearOperator((size, size), matvec=f, dtype=float) for f in (posed, undone))
        found, left = cg(A, load.ravel(), rtol=settled, maxiter=MOST, M=M)
        if left:
            raise NotIdentifiable(f"the inversion did not settle in {MOST} steps", advice="give a larger lambda",
                                  code="LID-E306")  # fmt: skip
        return np.asarray(found.reshape(shape))

    def path(self, datas: Sequence[Array]) -> WavesPath:
        """Path of whitened data, with one lambda."""
        m = int(np.sum(self.precision > 0))
        c, part = self._traces
        values, betas, weights, outside = [c], [np.zeros(len(c))], [part**2 * len(datas)], 0.0
        for data in datas:
            c, part, rest = self._modes(data)
            values, weights = [*values, c], [*weights, np.full(len(c), ASIDE)]
            betas, outside = [*betas, part / np.sqrt(ASIDE)], outside + rest
        values_, betas_, weights_ = (np.concatenate(x) for x in (values, betas, weights))
        return WavesPath(values_, np.ones(len(values_)), betas_, outside, m * len(datas), weight=weights_)

    @cached_property
    def _traces(self) -> tuple[Array, Array]:
        """Singular values, and parts of a random vector in them: sums of their squares are traces."""
        probe = np.random.default_rng(0).choice([-1.0, 1.0], self.precision.shape) * (self.precision > 0)
        return self._modes(probe)[:2]

    def _modes(self, data: Array) -> tuple[Array, Array, float]:
        """Singular values that bidiagonalisation from `data` finds, its parts in them, and the energy beyond."""
        size = float(np.linalg.norm(data))
        u = data / size
        v = self._smoothed(self.back(u))
        a = float(np.linalg.norm(v))
        v = v / a
        diagonal, below = [a], []
        for _ in range(STEPS):
            u = self.motion(self._smoothed(v)) - diagonal[-1] * u
            b = float(np.linalg.norm(u))
            below.append(b)
            if b <= 1e-10 * diagonal[0]:
                break
            u = u / b
            v = self._smoothed(self.back(u)) - b * v
            a = float(np.linalg.norm(v))
            if a <= 1e-10 * diagonal[0]:
                break
            v = v / a
            diagonal.append(a)
        B = np.zeros((len(below) + 1, len(diagonal)))
        B[np.arange(len(diagonal)), np.arange(len(diagonal))] = diagonal
        rows = np.arange(min(len(below), len(diagonal)))
        B[rows + 1, rows] = below[: len(rows)]
        U, c, _ = np.linalg.svd(B)
        part = size * U[0]
        return c, part[: len(c)], float(np.sum(part[len(c) :] ** 2))

    def _penalised(self, load: Array) -> Array:
        """``L^T L`` times tractions on the nodes that may be loaded, none beyond them."""
        return load if self.spectrum.white else self._field(self._waves(load) / self.spectrum.root**2)

    def _smoothed(self, load: Array) -> Array:
        """Loads made as smooth as the penalty wants tractions, and cut at the nodes that may be loaded."""
        return load if self.spectrum.white else self._field(self._waves(load) * self.spectrum.root)

    def _embedded(self, load: Array) -> Array:
        """Tractions on all nodes that may be loaded, of those on the first of them."""
        whole = np.zeros((len(load), *self.spectrum.waves.shape))[:, *self.loaded]
        whole[:, : load.shape[1], : load.shape[2]] = load
        return whole

    def _waves(self, load: Array) -> Waved:
        whole = np.zeros((len(load), *self.spectrum.waves.shape))
        whole[:, *self.loaded] = load
        return self.spectrum.waves.waves(whole)

    def _field(self, waves: Waved) -> Array:
        return self.spectrum.waves.field(waves)[:, *self.loaded]
