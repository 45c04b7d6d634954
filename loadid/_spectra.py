"""Complex amplitudes of responses on frequency lines, with a name and a unit for every column."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._channels import Channel
from structures._readonly import ReadOnly
from structures.errors import InputError, plain, reals

from ._inverse.problem import NoiseSource, NoiseSourceLike


@dataclass(frozen=True, eq=False)
class Spectra(ReadOnly):
    """Complex amplitudes of responses on frequency lines, ``y(t) = Re[Y exp(i 2 pi f t)]`` on each.

    Parameters
    ----------
    frequencies : array, shape (lines,)
        Hz, ascending.
    values : array, shape (lines, sensors) or (lines,)
        In the units of the channels.
    channels : sequence of str or Channel, optional
        Names of the columns; without them the columns are the sensors of the model in its order.
    noise : float, array (sensors,) or (lines, sensors), optional
        Standard deviation of the amplitudes, ``sqrt(E|error|^2)``.
    noise_source : NoiseSource, str or (str, str), optional
        Where that level comes from.
    name : str

    Raises
    ------
    InputError
        Shapes that do not fit, NaN, lines that do not ascend, a noise that is no standard deviation.
    """

    frequencies: NDArray[np.float64]
    values: NDArray[np.complex128]
    channels: Sequence[str | Channel] = ()
    noise: ArrayLike | None = None
    noise_source: NoiseSourceLike = None
    name: str = "spectra"
    labels: tuple[str, ...] = field(init=False, default=())

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "frequencies", _lines(self.frequencies))
        put(self, "values", _values(self.values, len(self.frequencies)))
        put(self, "channels", tuple(self.channels))
        labels = tuple(c if isinstance(c, str) else c.label for c in self.channels)
        count = self.values.shape[1]
        if labels and (len(labels) != count or len(set(labels)) != count):
            raise InputError("the channels do not fit the spectra", where="Spectra", found=labels,
                             expected=f"{count} different names")  # fmt: skip
        put(self, "labels", labels)
        put(self, "noise_source", NoiseSource.of(self.noise_source))
        if self.noise is not None:
            put(self, "noise", _noise(self.noise, self.values.shape))


def _lines(frequencies: ArrayLike) -> NDArray[np.float64]:
    f = np.atleast_1d(reals(frequencies, what="these are no frequency lines", where="Spectra, frequencies"))
    if f.ndim != 1 or not len(f) or not np.all(np.isfinite(f)) or f[0] < 0 or np.any(np.diff(f) <= 0):
        raise InputError("these are no frequency lines", where="Spectra, frequencies", found=f"shape {f.shape}",
                         expected="finite Hz, ascending, each line once, none negative",
                         hint="negative frequencies: give the one-sided spectrum")  # fmt: skip
    f.flags.writeable = False
    return f


def _values(values: ArrayLike, lines: int) -> NDArray[np.complex128]:
    try:
        x = np.array(plain(values), complex)
    except (TypeError, ValueError):
        raise InputError("these are no numbers", where="Spectra, values", expected="complex amplitudes") from None
    x = x[:, None] if x.ndim == 1 else x
    if x.ndim != 2 or len(x) != lines or not x.size:
        found = f"shape {x.shape} on {lines} lines"
        hint = "transpose it: lines come first" if x.ndim == 2 and x.shape[1] == lines else ""
        raise InputError("spectra and lines do not fit", where="Spectra, values", found=found,
                         expected=f"({lines}, sensors)", hint=hint)  # fmt: skip
    if not np.all(np.isfinite(x)):
        raise InputError("NaN or infinity", where="Spectra, values",
                         found=f"{int(np.sum(~np.isfinite(x)))} of {x.size} values", expected="finite numbers",
                         hint="leave out the lines that were not measured")  # fmt: skip
    x.flags.writeable = False
    return x


def _noise(noise: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    level = reals(noise, what="the noise is no real number", where="Spectra, noise")
    if level.shape not in ((), shape[1:], shape) or not np.all(np.isfinite(level)) or np.any(level <= 0):
        found = f"shape {level.shape}" if level.ndim else f"{float(level):g}"
        raise InputError("the noise does not fit the spectra", where="Spectra, noise", found=found,
                         expected=f"positive: one number, {shape[1:]} or {shape}")  # fmt: skip
    level.flags.writeable = False
    return level
