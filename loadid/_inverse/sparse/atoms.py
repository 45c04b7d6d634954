"""Dictionaries of load histories, and the columns A = H D that a sparse solver asks for.

Spikes, cubic B-splines and Daubechies wavelets are given by waveforms and shifts; asked for are products, single
columns, and blocks of their Gram matrix.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from structures.errors import InputError

from .. import Array, Flags, Indices
from ..convolution import Convolution

KNOTS = (1, 2, 4, 8, 16)  # spacings that are scanned, in samples
MOMENTS = 4  # vanishing moments of the wavelets
COARSEST = 64  # scale in samples up to which wavelets are made


@dataclass(frozen=True)
class Family:
    """Copies of one waveform: copy k begins at sample ``first + k * step``; what lies outside the record is cut off.

    Parameters
    ----------
    waveform : array, shape (length,)
    first : int
        May be negative: the copy is then cut at the start of the record.
    step, count : int
    """

    waveform: Array
    first: int
    step: int
    count: int


@dataclass(frozen=True)
class Dictionary:
    """Load histories ``g = D x`` of one load as a sum of shifted waveforms.

    Parameters
    ----------
    name : str
    families : tuple of Family
    samples : int
    """

    name: str
    families: tuple[Family, ...]
    samples: int

    @property
    def atoms(self) -> int:
        """Number of columns of D."""
        return sum(f.count for f in self.families)

    def synthesise(self, x: Array) -> Array:
        """D x: coefficients (atoms, loads) to histories (samples, loads)."""
        g = np.zeros((self.samples, x.shape[1]))
        at = 0
        for f in self.families:
            before, room = _margins(f, self.samples)
            wide = np.zeros((room, x.shape[1]))
            for k, value in enumerate(f.waveform):
                wide[k : k + f.count * f.step : f.step] += value * x[at : at + f.count]
            g += wide[before : before + self.samples]
            at += f.count
        return g

    def within(self, mask: Flags) -> Array:
        """Those columns of D, (samples, kept), that are zero wherever `mask` (samples,) is False."""
        outside, kept = np.concatenate([[0], np.cumsum(~mask)]), []
        for f in self.families:
            for first in f.first + f.step * np.arange(f.count):
                low, high = max(int(first), 0), min(int(first) + len(f.waveform), self.samples)
                if low < high and outside[high] == outside[low]:
                    column = np.zeros(self.samples)
                    column[low:high] = f.waveform[low - first : high - first]
                    kept.append(column)
        return np.array(kept).reshape(len(kept), self.samples).T

    def analyse(self, g: Array) -> Array:
        """D^T g: histories (samples, loads) to coefficients (atoms, loads)."""
        x = np.zeros((self.atoms, g.shape[1]))
        at = 0
        for f in self.families:
            before, room = _margins(f, self.samples)
            wide = np.zeros((room, g.shape[1]))
            wide[before : before + self.samples] = g
            for k, value in enumerate(f.waveform):
                x[at : at + f.count] += value * wide[k : k + f.count * f.step : f.step]
            at += f.count
        return x


def _margins(f: Family, samples: int) -> tuple[int, int]:
    """Samples before the record that the copies reach, and the length from there that holds all of them."""
    before = max(-f.first, 0)
    if f.first > 0:
        raise InputError("a family of waveforms begins after the record does", where="dictionary", found=f.first)
    return before, max(before + samples, f.count * f.step + len(f.waveform))


def dirac(samples: int) -> Dictionary:
    """One spike per sample."""
    return Dictionary("dirac", (Family(np.ones(1), 0, 1, samples),), samples)


def bspline(samples: int, knots: int) -> Dictionary:
    """Cubic B-splines centred at every `knots`-th sample, of height 1 for one (2/3 times 3/2).

    Parameters
    ----------
    samples : int
    knots : int
        Spacing of the centres in samples; a spline is four spacings wide.

    Raises
    ------
    InputError
        A spacing below 1 or above a quarter of the record.
    """
    if isinstance(knots, bool) or not isinstance(knots, int | np.integer) or not 1 <= knots <= samples // 4:
        raise InputError(
            "no spacing of knots", where="knots", found=repr(knots), expected=f"an integer from 1 to {samples // 4}"
        )
    t = np.abs(np.arange(-2 * knots + 1, 2 * knots)) / knots
    near, far = 1 - 1.5 * t**2 + 0.75 * t**3, 0.25 * (2 - t) ** 3
    waveform = np.where(t <= 1, near, far)
    count = (samples - 1) // knots + 1
    return Dictionary(f"bspline {knots}", (Family(waveform, -2 * int(knots) + 1, int(knots), count),), samples)


def wavelet(samples: int, moments: int = MOMENTS, coarsest: int = COARSEST) -> Dictionary:
    """Daubechies wavelets of all scales up to `coarsest` samples, and the scaling functions of that scale.

    Orthonormal away from the ends of the record, where they are cut off (Daubechies, Ten Lectures on Wavelets, SIAM
    1992, ch. 6): the dictionary is complete, but for the outermost waveforms no basis of unit vectors.
    """
    low = daubechies(moments)
    high = low[::-1] * (-1.0) ** np.arange(len(low))
    levels = max(1, int(np.log2(max(2, min(coarsest, samples // 8)))))
    families, smooth = [], np.ones(1)
    for level in range(1, levels + 1):
        hole = 2 ** (level - 1)
        families.append(_copies(np.convolve(smooth, _spread(high, hole)), 2**level, samples))
        smooth = np.convolve(smooth, _spread(low, hole))
    families.append(_copies(smooth, 2**levels, samples))
    return Dictionary("wavelet", tuple(families), samples)


def _copies(waveform: Array, step: int, samples: int) -> Family:
    """All copies on a grid of `step` that touch the record."""
    reach = (len(waveform) - 1) // step
    return Family(waveform, -reach * step, step, reach + (samples - 1) // step + 1)


def _spread(taps: Array, hole: int) -> Array:
    wide = np.zeros((len(taps) - 1) * hole + 1)
    wide[::hole] = taps
    return wide


def daubechies(moments: int) -> Array:
    """Orthonormal low-pass filter of 2 * `moments` taps, sum sqrt(2), by spectral factorisation.

    Daubechies, Comm. Pure Appl. Math. 41 (1988) 909: the roots of the half-band polynomial inside the unit circle.
    """
    from math import comb

    # P(y) = sum C(p - 1 + k, k) y^k with y = (2 - z - 1/z) / 4; each root in y gives a pair z, 1/z
    roots = np.roots([comb(moments - 1 + k, k) for k in range(moments)][::-1])
    half = 1 - 2 * roots
    z = half + np.sqrt(half.astype(complex) ** 2 - 1)
    inside = np.where(np.abs(z) < 1, z, 1 / z)
    taps = np.real(np.poly(np.concatenate([-np.ones(moments), inside])))
    return np.asarray(taps * np.sqrt(2) / taps.sum())


# -- the columns of a solver -------------------------------------------------------------------------------------------
FADED = 1e-10  # share of the largest response below which it has died away
LARGEST = 50_000_000  # numbers in the responses to a dictionary that is given as a matrix
CHUNK = 2048  # rows of columns that are held at once
TABLE = 20_000_000  # products of two responses that are kept, at all lags and all places of the record's end


class Atoms(Protocol):
    """What a sparse solver asks of an operator of shape (m, n)."""

    m: int
    n: int

    def apply(self, x: Array) -> Array:
        """A x, (m,)."""
        ...

    def adjoint(self, r: Array) -> Array:
        """A^T r, (n,)."""
        ...

    def columns(self, which: Indices) -> Array:
        """Columns of A, (m, k)."""
        ...

    def gram(self, rows: Indices, columns: Indices) -> Array:
        """Block of A^T A."""
        ...


class DenseAtoms:
    """Atoms that are given as a matrix (m, n)."""

    def __init__(self, matrix: Array) -> None:
        self.matrix = np.asarray(matrix, float)
        if self.matrix.ndim != 2 or not np.all(np.isfinite(self.matrix)):
            raise InputError("no matrix of finite numbers", where="dictionary", found=f"shape {self.matrix.shape}")
        self.m, self.n = self.matrix.shape

    def apply(self, x: Array) -> Array:
        """A x."""
        return self.matrix @ x

    def adjoint(self, r: Array) -> Array:
        """A^T r."""
        return self.matrix.T @ r

    def columns(self, which: Indices) -> Array:
        """Columns of A, (m, k)."""
        return self.matrix[:, which]

    def gram(self, rows: Indices, columns: Indices) -> Array:
        """Block of A^T A."""
        return np.asarray(self.matrix[:, rows].T @ self.matrix[:, columns])


class MatrixAtoms(DenseAtoms):
    """Responses to the columns of a dictionary that a user gives, at every load.

    Parameters
    ----------
    h : array, shape (taps, sensors, loads)
        Impulse responses, whitened.
    D : array, shape (samples, atoms)
        Histories of one load; every load has the same.
    weight : array, shape (samples, sensors), optional
        0 for missing data.

    Raises
    ------
    InputError
        Where the responses do not fit in `LARGEST` numbers.
    """

    def __init__(self, h: Array, D: Array, weight: Array | None = None) -> None:
        self.D, self.samples, self.loads = np.asarray(D, float), len(D), h.shape[2]
        operator = Convolution(h, self.samples, weight)
        size = operator.shape[0] * self.D.shape[1] * self.loads
        if size > LARGEST:
            raise InputError(
                "the dictionary is too large for a matrix",
                where="dictionary",
                found=f"{self.D.shape[1]} atoms of {self.samples} samples, {size:.2g} numbers with their responses",
                expected=f"at most {LARGEST:.0e}",
                hint="fewer atoms, a window of the record, or 'bspline' or 'wavelet', which need no matrix",
            )
        matrix = np.empty((operator.shape[0], self.D.shape[1], self.loads))
        for load in range(self.loads):
            for k, column in enumerate(self.D.T):
                g = np.zeros((self.samples, self.loads))
                g[:, load] = column
                matrix[:, k, load] = operator.apply(g).reshape(-1)
        super().__init__(matrix.reshape(operator.shape[0], -1))
        self.load = np.tile(np.arange(self.loads), self.D.shape[1])
        self.slot = np.repeat(np.arange(self.D.shape[1]), self.loads)

    def history(self, x: Array) -> Array:
        """D x: coefficients (n,) to loads (samples, loads)."""
        return self.D @ x.reshape(-1, self.loads)

    def histories(self, which: Indices) -> Any:
        """Loads of single atoms, sparse (samples * loads, k)."""
        from scipy.sparse import csc_matrix

        full = np.zeros((self.samples, self.loads, len(which)))
        for c, j in enumerate(which):
            full[:, self.load[j], c] = self.D[:, self.slot[j]]
        return csc_matrix(full.reshape(-1, len(which)))


class ShiftedAtoms:
    """Responses to the shifted waveforms of a dictionary at every load.

    A column is a kernel (response to a waveform) that begins at its shift and is cut at the end of the record. The
    product of two columns is the cross-correlation of their kernels at the difference of the shifts, as long as one of
    them dies away within the record; else it is the running sum of their products at that lag, up to the end of the
    record. Only where shifts lie on no common grid, where data are missing, or where these sums are too many, are the
    columns themselves multiplied.

    Parameters
    ----------
    h : array, shape (taps, sensors, loads)
        Impulse responses, whitened.
    dictionary : Dictionary
        Of the histories of each load.
    weight : array, shape (samples, sensors), optional
        0 for missing data.
    """

    def __init__(self, h: Array, dictionary: Dictionary, weight: Array | None = None) -> None:
        self.dictionary, self.samples = dictionary, dictionary.samples
        self.operator = Convolution(h, self.samples, weight)
        self._h = np.zeros((self.samples, *h.shape[1:]))
        self._h[: len(h)] = h[: self.samples]
        self.sensors, self.loads = h.shape[1:]
        self.m, self.n = self.samples * self.sensors, dictionary.atoms * self.loads
        self.weight = weight
        shift = np.concatenate([f.first + f.step * np.arange(f.count) for f in dictionary.families])
        wave = np.repeat(np.arange(len(dictionary.families)), [f.count for f in dictionary.families])
        self.shift, self.wave = np.repeat(shift, self.loads), np.repeat(wave, self.loads)
        self.load = np.tile(np.arange(self.loads), dictionary.atoms)
        self.slot = np.repeat(np.arange(dictionary.atoms), self.loads)
        cut = np.maximum(-self.shift, 0)
        name = (cut * len(dictionary.families) + self.wave) * self.loads + self.load
        _, self._first, self._kind = np.unique(name, return_index=True, return_inverse=True)
        self._begin = np.maximum(self.shift, 0)
        self._kernels: dict[int, Array] = {}
        self._alive = np.full(len(self._first), -1)
        self._products: dict[tuple[int, int], Array] = {}
        self._sums: dict[tuple[int, int], _RunningSums] = {}
        self._step = np.repeat([f.step for f in dictionary.families], [f.count for f in dictionary.families])
        self._step = np.repeat(self._step, self.loads)
        self._partial = None if weight is None else np.flatnonzero(np.any(weight != 1, axis=1))

    # -- products ---------------------------------------------------------------------------------------------------
    def history(self, x: Array) -> Array:
        """D x: coefficients (n,) to loads (samples, loads)."""
        return self.dictionary.synthesise(x.reshape(-1, self.loads))

    def apply(self, x: Array) -> Array:
        """H D x, (m,)."""
        return self.operator.apply(self.history(x)).reshape(-1)

    def adjoint(self, r: Array) -> Array:
        """D^T H^T r, (n,)."""
        return self.dictionary.analyse(self.operator.apply_transposed(r.reshape(self.samples, self.sensors))).reshape(
            -1
        )

    def histories(self, which: Indices) -> Any:
        """Loads of single atoms, sparse (samples * loads, k)."""
        from scipy.sparse import csc_matrix

        rows, columns, values = [np.zeros(0, int)], [np.zeros(0, int)], [np.zeros(0)]
        for c, j in enumerate(which):
            waveform = self.dictionary.families[self.wave[j]].waveform
            time = self.shift[j] + np.arange(len(waveform))
            inside = (time >= 0) & (time < self.samples)
            rows.append(time[inside] * self.loads + self.load[j])
            columns.append(np.full(np.count_nonzero(inside), c))
            values.append(waveform[inside])
        at = np.concatenate(rows), np.concatenate(columns)
        return csc_matrix((np.concatenate(values), at), (self.samples * self.loads, len(which)))

    # -- columns ----------------------------------------------------------------------------------------------------
    def columns(self, which: Indices) -> Array:
        """Columns of A, (m, k)."""
        return self._rows(which, 0, self.samples, self.weight).reshape(self.m, len(which))

    def _rows(self, which: Indices, start: int, stop: int, weight: Array | None) -> Array:
        """Samples start to stop of some columns, (stop - start, sensors, k)."""
        block = np.zeros((stop - start, self.sensors, len(which)))
        for c, j in enumerate(which):
            q, shift = self._kernel(self._kind[j]), self._begin[j]
            low = max(start, shift)
            if low < stop:
                block[low - start :, :, c] = q[low - shift : stop - shift]
        if weight is not None:
            block *= weight[start:stop, :, None]
        return block

    def _kernel(self, kind: int) -> Array:
        """Response (samples, sensors) to a waveform from its first sample in the record on."""
        if kind not in self._kernels:
            j = self._first[kind]
            waveform = self.dictionary.families[self.wave[j]].waveform[max(-int(self.shift[j]), 0) :]
            q = _convolved(self._h[:, :, self.load[j]], waveform)
            size = np.abs(q).max(axis=1)
            alive = np.flatnonzero(size > FADED * size.max())
            self._kernels[kind] = q
            self._alive[kind] = alive[-1] + 1 if len(alive) else 0
        return self._kernels[kind]

    # -- Gram matrix ------------------------------------------------------------------------------------------------
    def gram(self, rows: Indices, columns: Indices) -> Array:
        """Block of A^T A."""
        block = np.empty((len(rows), len(columns)))
        first, second = self._dies(rows), self._dies(columns)
        if first.any():
            block[first] = self._looked_up(rows[first], columns)
        if not first.all() and second.any():
            block[np.ix_(~first, second)] = self._looked_up(rows[~first], columns[second])
        if not (first.all() or second.all()):
            block[np.ix_(~first, ~second)] = self._cut(rows[~first], columns[~second])
        return block

    def _dies(self, which: Indices) -> Flags:
        """Whether the response to an atom has died away within the record."""
        for kind in np.unique(self._kind[which]):
            self._kernel(kind)
        return np.asarray(self._begin[which] + self._alive[self._kind[which]] <= self.samples)

    def _looked_up(self, rows: Indices, columns: Indices) -> Array:
        block = np.empty((len(rows), len(columns)))
        for a in np.unique(self._kind[rows]):
            i = np.flatnonzero(self._kind[rows] == a)
            for b in np.unique(self._kind[columns]):
                j = np.flatnonzero(self._kind[columns] == b)
                lag = self._begin[rows[i]][:, None] - self._begin[columns[j]]
                block[np.ix_(i, j)] = self._correlation(a, b)[lag + self.samples]
        if self._partial is not None and len(self._partial):
            block -= self._lost(rows, columns)
        return block

    def _lost(self, rows: Indices, columns: Indices) -> Array:
        """What the weights take away from the products of full columns."""
        assert self.weight is not None
        assert self._partial is not None
        left, right = self._at(rows, self._partial), self._at(columns, self._partial)
        rest = 1 - self.weight[self._partial] ** 2
        return np.asarray(np.einsum("tsi,ts,tsj->ij", left, rest, right, optimize=True))

    def _at(self, which: Indices, samples: Indices) -> Array:
        """Columns at some samples only, without weights, (len(samples), sensors, k)."""
        block = np.zeros((len(samples), self.sensors, len(which)))
        for c, j in enumerate(which):
            after = samples >= self._begin[j]
            block[after, :, c] = self._kernel(self._kind[j])[samples[after] - self._begin[j]]
        return block

    def _correlation(self, a: int, b: int) -> Array:
        """``sum_t a_t b_(t + lag)`` over all sensors at lags -samples .. samples, stored from index 0."""
        if (a, b) in self._products:
            return self._products[a, b]
        from scipy import fft

        p, q = self._kernel(a), self._kernel(b)
        padded = fft.next_fast_len(2 * self.samples + 1, real=True)
        lines = np.sum(fft.rfft(p, padded, axis=0).conj() * fft.rfft(q, padded, axis=0), axis=1)
        circular = fft.irfft(lines, padded)
        self._products[a, b] = np.concatenate([circular[-self.samples :], circular[: self.samples + 1]])
        return self._products[a, b]

    def _cut(self, rows: Indices, columns: Indices) -> Array:
        """Block of A^T A of responses that the end of the record cuts."""
        grid = int(self._step[0])
        steps = (self.samples // grid + 1) ** 2 * self.loads**2 // 2
        if self.weight is not None or np.any(self._step != grid) or steps > TABLE:
            return self._multiplied(rows, columns)
        i, j = self.shift[rows] >= 0, self.shift[columns] >= 0
        block = np.empty((len(rows), len(columns)))
        for left, right in ((~i, ~j), (~i, j), (i, ~j)):  # waveforms that the beginning cuts are kinds of their own
            if left.any() and right.any():
                block[np.ix_(left, right)] = self._multiplied(rows[left], columns[right])
        block[np.ix_(i, j)] = self._summed(rows[i], columns[j], grid)
        return block

    def _summed(self, rows: Indices, columns: Indices, grid: int) -> Array:
        """Block of A^T A by running sums, for waveforms that begin on the grid of the dictionary."""
        block = np.empty((len(rows), len(columns)))
        for a in np.unique(self._kind[rows]):
            i = np.flatnonzero(self._kind[rows] == a)
            for b in np.unique(self._kind[columns]):
                j = np.flatnonzero(self._kind[columns] == b)
                first, second = self._begin[rows[i]][:, None], self._begin[columns[j]][None, :]
                lag, part = first - second, np.empty((len(i), len(j)))
                later = np.maximum(first, second)
                for kinds, which in (((a, b), lag >= 0), ((b, a), lag < 0)):
                    part[which] = self._sums_of(*kinds, grid).at(np.abs(lag[which]), self.samples - later[which])
                block[np.ix_(i, j)] = part
        return block

    def _sums_of(self, a: int, b: int, grid: int) -> _RunningSums:
        if (a, b) not in self._sums:
            offset = (self.samples - int(self._begin[self._first[a]])) % grid
            self._sums[a, b] = _RunningSums(self._kernel(a), self._kernel(b), grid, offset)
        return self._sums[a, b]

    def _multiplied(self, rows: Indices, columns: Indices) -> Array:
        """Block of A^T A by multiplying columns, a chunk of samples at a time."""
        block = np.zeros((len(rows), len(columns)))
        begin = int(max(self._begin[rows].min(), self._begin[columns].min()))
        for start in range(begin, self.samples, CHUNK):
            stop = min(start + CHUNK, self.samples)
            r = np.flatnonzero(self.shift[rows] < stop)
            c = np.flatnonzero(self.shift[columns] < stop)
            left = self._rows(rows[r], start, stop, self.weight).reshape(-1, len(r))
            right = self._rows(columns[c], start, stop, self.weight).reshape(-1, len(c))
            block[np.ix_(r, c)] += left.T @ right
        return block


class _RunningSums:
    """``sum_(t < length) a_t b_(t + lag)`` over all sensors, at lags and lengths of a grid; a lag when it is asked for.

    Parameters
    ----------
    a, b : array, shape (samples, sensors)
    grid : int
        Spacing of the lags and of the lengths, in samples.
    offset : int
        Shortest length.
    """

    def __init__(self, a: Array, b: Array, grid: int, offset: int) -> None:
        self.a, self.b, self.grid, self.offset = a, b, grid, offset
        lengths = np.maximum((len(a) - offset) // grid + 1 - np.arange(len(a) // grid + 1), 0)
        self.first = np.concatenate([[0], np.cumsum(lengths)])  # of the sums of each lag
        self.sums, self.known = np.empty(self.first[-1]), np.zeros(len(lengths), bool)

    def at(self, lag: Indices, length: Indices) -> Array:
        """Sums at some lags, each up to its length."""
        row = lag // self.grid
        asked = np.zeros(len(self.known), bool)
        asked[row] = True
        for k in np.flatnonzero(asked & ~self.known):
            self._add(int(k))
        return np.asarray(self.sums[self.first[row] + (length - self.offset) // self.grid])

    def _add(self, k: int) -> None:
        shift, count = k * self.grid, self.first[k + 1] - self.first[k]
        stop = self.offset + (count - 1) * self.grid
        product = np.einsum("ts,ts->t", self.a[:stop], self.b[shift : shift + stop])
        parts = np.empty(count)
        parts[0] = product[: self.offset].sum()
        parts[1:] = product[self.offset :].reshape(-1, self.grid).sum(axis=1)
        np.cumsum(parts, out=self.sums[self.first[k] : self.first[k + 1]])
        self.known[k] = True


def _convolved(q: Array, waveform: Array) -> Array:
    """Response (samples, sensors) to a waveform instead of a spike."""
    response = np.zeros_like(q)
    for k, value in enumerate(waveform[: len(q)]):
        response[k:] += value * q[: len(q) - k]
    return response
