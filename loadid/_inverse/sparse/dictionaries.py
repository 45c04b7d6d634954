"""Dictionaries of load histories: spikes, cubic B-splines, Daubechies wavelets, given by waveforms and shifts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from structures.errors import InputError

from .. import Array

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


def of(names: Sequence[int] | int, samples: int) -> list[Dictionary]:
    """B-spline dictionaries of one or several spacings that fit the record."""
    spacings = [names] if isinstance(names, int | np.integer) else [k for k in names if k <= samples // 8]
    return [bspline(samples, k) for k in spacings]
