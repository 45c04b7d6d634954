"""Octave bands and their fractions after IEC 61260-1, and the power that a spectrum holds in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import as_array, integer, pair

Vector = NDArray[np.float64]
RATIO = 10.0**0.3  # octave ratio G of base ten
REFERENCE = 1000.0  # Hz
PREFERRED = (1.0, 1.25, 1.6, 2.0, 2.5, 3.15, 4.0, 5.0, 6.3, 8.0)
FINEST = 96
APART = 1.5  # times the gap beside it, from which on a gap between lines is a hole and no step


@dataclass(frozen=True, eq=False)
class Bands:
    """Neighbouring bands of one width on a logarithmic scale.

    Parameters
    ----------
    fraction : int
        1 octave, 3 third octaves, 12 twelfth octaves.
    centres, lower, upper : array, shape (bands,)
        Exact midband and edge frequencies (Hz); the upper edge of a band is the lower one of the next.
    names : tuple of str
        Nominal midband frequencies as they are printed: ``"31.5"``, ``"1000"``.
    """

    fraction: int
    centres: Vector
    lower: Vector
    upper: Vector
    names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.centres)

    @property
    def title(self) -> str:
        """``"octave"``, ``"third octave"`` or ``"1/12 octave"``."""
        return {1: "octave", 3: "third octave"}.get(self.fraction, f"1/{self.fraction} octave")


@dataclass(frozen=True, eq=False)
class BandPower:
    """Power of spectra in bands.

    Parameters
    ----------
    bands : Bands
    power : array, shape (bands, ...)
        Mean square in each band, unit^2.
    coverage : array, shape (bands,)
        Share of the width of each band that the lines cover: a level of a half-covered band is the level of a half.
    """

    bands: Bands
    power: Vector
    coverage: Vector


def octave_bands(fraction: int = 3, low: float = 20.0, high: float = 20e3) -> Bands:
    """Bands of a fraction of an octave, from the one that holds `low` to the one that holds `high`.

    Parameters
    ----------
    fraction : int
        Bandwidth designator b: 1, 3, 6, 12, 24, ...
    low, high : float
        Hz.

    Raises
    ------
    InputError
        No fraction, or no range of frequencies above 0 Hz.

    Notes
    -----
    IEC 61260-1:2014, base ten: G = 10^(3/10), midband 1000 G^(x/b) Hz for odd b and 1000 G^((2x+1)/(2b)) Hz for even
    b, edges a factor G^(1/(2b)) below and above. Nominal frequencies after its annex E.
    """
    b = integer("fraction of an octave", fraction, where="octave_bands", limit=FINEST)
    low, high = pair("the range", (low, high), where="octave_bands", unit="Hz")
    if not 0 < low < high:
        raise InputError(
            "no range of frequencies", where="octave_bands", found=f"{low:g} to {high:g} Hz",
            expected="0 < low < high", hint="a band never reaches down to 0 Hz",
        )  # fmt: skip
    first, last = (int(_number(f, b)) for f in (low, high))
    numbers = np.arange(first, last + 1)
    centres = _midband(numbers, b)
    # edges from one formula, so that neighbours share them to the last bit
    edges = REFERENCE * RATIO ** ((2 * np.arange(first, last + 2) - 1 + (b % 2 == 0)) / (2 * b))
    names = tuple(f"{nominal(float(f), int(x), b):.7g}" for f, x in zip(centres, numbers, strict=True))
    return Bands(b, centres, edges[:-1], edges[1:], names)


def bands_of(frequencies: ArrayLike, fraction: int = 3) -> Bands:
    """Bands that hold some lines (Hz); 0 Hz is in none.

    Raises
    ------
    InputError
        No line above 0 Hz.
    """
    f = as_array(frequencies, where="bands_of", dtype=float)
    f = f[f > 0]
    if not f.size:
        raise InputError("no line above 0 Hz", where="octave bands", found="lines at 0 Hz", expected="lines in Hz")
    return octave_bands(fraction, float(f.min()), max(float(f.max()), float(f.min()) * (1 + 1e-12)))


def band_power(frequencies: ArrayLike, power: ArrayLike, bands: Bands, *, density: bool) -> BandPower:
    """Power that spectra hold in bands; a line at 0 Hz is in none.

    Parameters
    ----------
    frequencies : array, shape (lines,)
        Hz, ascending.
    power : array, shape (lines, ...)
        One-sided density in unit^2/Hz, or the power of each line in unit^2.
    bands : Bands
    density : bool
        True: every line stands for a strip up to half way to its neighbours, and a strip across an edge is parted
        there, so that no power is lost or counted twice. False: a line is a tone and lies in one band.

    Raises
    ------
    InputError
        Lines that do not ascend or do not fit; one line of a density, which has no width.
    """
    f, p = (as_array(x, where="band_power", dtype=float) for x in (frequencies, power))
    if f.ndim != 1 or not len(f) or len(p) != len(f) or np.any(np.diff(f) <= 0) or not np.all(np.isfinite(p)):
        raise InputError(
            "lines and powers do not fit", where="band_power", found=f"{f.shape} lines, {p.shape} powers",
            expected="ascending lines (Hz) and a finite power for each", hint="lines first, then sensors",
        )  # fmt: skip
    if density and len(f) < 2:
        raise InputError(
            "one line of a density has no width", where="band_power", found=f"{f[0]:g} Hz",
            expected="two lines or more", hint="density=False where the line is a tone",
        )  # fmt: skip
    start, stop = _strips(f)
    inside = np.clip(
        np.minimum(stop, bands.upper[:, None]) - np.maximum(start, bands.lower[:, None]), 0, None
    )  # (bands, lines)
    coverage = inside.sum(axis=1) / (bands.upper - bands.lower)
    if density:
        weights = np.where(f > 0, inside, 0.0)
    else:
        weights = ((f >= bands.lower[:, None]) & (f < bands.upper[:, None])).astype(float)
    return BandPower(bands, np.tensordot(weights, p, axes=1), np.minimum(coverage, 1.0))


def widths(frequencies: ArrayLike) -> Vector:
    """Width (Hz) of the strip that each line of a density stands for; the mean square is the sum of width times it."""
    start, stop = _strips(np.asarray(frequencies, float))
    return stop - start


def nominal(centre: float, number: int, fraction: int) -> float:
    """Nominal midband frequency (Hz) of a band: preferred numbers for octaves and thirds, else rounded.

    Parameters
    ----------
    centre : float
        Exact midband frequency (Hz).
    number : int
        x, 0 at the band of 1 kHz.
    fraction : int
        1/b octave: three digits where the first one is below 5, else two (finer than 1/24: one digit more).
    """
    if fraction in (1, 3):
        tenth = number * (3 // fraction) + 30  # centre = 10^(tenth/10) Hz
        return PREFERRED[tenth % 10] * 10.0 ** (tenth // 10)
    decade = int(np.floor(np.log10(centre)))
    digits = (3 if fraction == 2 or centre / 10.0**decade < 5 else 2) + (fraction > 24)
    return float(f"{centre:.{digits - 1}e}")


def _midband(x: NDArray[np.int_], b: int) -> Vector:
    return REFERENCE * RATIO ** (x / b if b % 2 else (2 * x + 1) / (2 * b))


def _number(frequency: float, b: int) -> float:
    """Number x of the band that holds a frequency."""
    place = b * np.log(frequency / REFERENCE) / np.log(RATIO)
    return float(np.floor(place + 0.5 if b % 2 else place))


def _strips(f: Vector) -> tuple[Vector, Vector]:
    """Ends of the strip that each line stands for: half way to its neighbours, but not across a hole."""
    if len(f) == 1:
        return f, f
    gaps = np.diff(f)
    beside = np.full(len(gaps), np.inf)
    beside[1:] = gaps[:-1]
    beside[:-1] = np.minimum(beside[:-1], gaps[1:])
    half = np.where(gaps > APART * beside, beside, gaps) / 2
    left, right = np.concatenate([half[:1], half]), np.concatenate([half, half[-1:]])
    return np.maximum(f - left, 0.0), f + right
