"""What every frequency line of an estimate can tell: gain, condition, predicted error, the nearest antiresonance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

LEVEL = 0.10  # predicted relative standard deviation above which a line is not believed


@dataclass(frozen=True, eq=False, kw_only=True)
class Spectrum:
    """Lines of an estimate. Arrays are (lines, loads) unless said.

    Parameters
    ----------
    frequencies : array, shape (lines,)
        Hz.
    load : array
        Complex amplitudes that were estimated; of cross-spectral data the root of the autospectra.
    std : array
        ``sqrt(E|error|^2)`` of these, prior included.
    covariance : array, shape (lines, loads, loads)
        ``E[e e^H]`` of the errors of a line.
    naive : array
        Least-squares amplitudes, without a prior: what blows up at an antiresonance.
    naive_std : array
        Their standard deviation by noise and FRF errors; infinite where a line does not determine the load.
    expected : array
        Size of the load around each line (root mean square over its neighbours).
    gain : array
        Whitened response to one unit of the load that no other loads can imitate: 1 / `naive_std`.
    condition : array, shape (lines,)
        Largest over smallest singular value over loads of their expected size.
    zeros : array
        Frequency (Hz) of the antiresonance nearest to each line; infinite where there is none.
    lam : array, shape (lines,)
        Noise over expected load, relative to the largest singular value of the line.
    noise : array, shape (lines,)
        Standard deviation of the whitened noise: above 1 the data contradict the stated level.
    level : float
        Predicted relative error that was asked for.
    cross : array, shape (lines, loads, loads), optional
        Cross spectra of the loads, unit^2/Hz.
    """

    frequencies: NDArray[np.float64]
    load: NDArray[np.complex128]
    std: NDArray[np.float64]
    covariance: NDArray[np.complex128]
    naive: NDArray[np.complex128]
    naive_std: NDArray[np.float64]
    expected: NDArray[np.float64]
    gain: NDArray[np.float64]
    condition: NDArray[np.float64]
    zeros: NDArray[np.float64]
    lam: NDArray[np.float64]
    noise: NDArray[np.float64]
    level: float = LEVEL
    cross: NDArray[np.complex128] | None = None

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, np.ndarray):
                value = np.array(value)
                value.setflags(write=False)
                object.__setattr__(self, f.name, value)

    @property
    def predicted(self) -> NDArray[np.float64]:
        """Predicted relative standard deviation of the least-squares load on each line, (lines, loads)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.expected > 0, self.naive_std / self.expected, np.inf)

    def trust(self, level: float | None = None) -> NDArray[np.bool_]:
        """Lines whose predicted relative error is at most `level`, (lines, loads); default the level of the estimate.

        Raises
        ------
        InputError
            A level that is not positive.
        """
        level = self.level if level is None else level
        if not isinstance(level, int | float) or isinstance(level, bool) or not level > 0:
            raise InputError(
                "no level of trust", where="trust", found=repr(level), expected="a number > 0, such as 0.1"
            )
        return self.predicted <= level

    def bands(self, load: int = 0, level: float | None = None) -> tuple[tuple[float, float], ...]:
        """First and last line (Hz) of every stretch that is not trusted, for one load."""
        flagged = np.concatenate([[False], ~self.trust(level)[:, load], [False]])
        edges = np.flatnonzero(np.diff(flagged)).reshape(-1, 2)
        return tuple((float(self.frequencies[a]), float(self.frequencies[b - 1])) for a, b in edges)

    def to_dict(self) -> dict[str, Any]:
        """Plain tree for files."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @classmethod
    def from_dict(cls, tree: Mapping[str, Any]) -> Spectrum:
        """Inverse of `to_dict`."""
        return cls(**{f.name: tree[f.name] for f in fields(cls)})


def in_words(bands: tuple[tuple[float, float], ...], most: int = 4) -> str:
    """Bands as text, the widest first: ``"1 to 4.25 Hz, 16.5 Hz and 3 more"``."""
    order = sorted(bands, key=lambda b: b[0] - b[1])[:most]
    said = [f"{a:.5g} Hz" if a == b else f"{a:.5g} to {b:.5g} Hz" for a, b in sorted(order)]
    more = len(bands) - len(order)
    return ", ".join(said) + (f" and {more} more" if more > 0 else "")
