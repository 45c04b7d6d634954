"""A sensor that contradicts the others: which one, what is wrong with it, and the readings without that."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError, reals

from .._record import Record, Spectra

Array = NDArray[Any]
T = TypeVar("T")

MENDED = ("gain", "unit", "polarity", "delay", "swap", "offset")  # what readings can be freed of


@dataclass(frozen=True)
class SensorFault:
    """What explains sensors that contradict each other.

    Parameters
    ----------
    channels : tuple of str
        The sensor; both of a swap; the suspects of ``"one of"``; empty where no single sensor explains it.
    kind : str
        ``gain``, ``unit`` (a gain that is a factor between units), ``polarity``, ``delay``, ``swap``, ``offset``,
        ``drift``, ``dead``, ``other``; ``one of`` where the sensor cannot be told; ``load`` where no sensor explains
        it: a load that the model does not have, or has elsewhere, or another error of the model.
    size : float
        Gain, delay in s (positive: late), or offset in the unit of the sensor; 0 for the other kinds.
    std : float
        Of the size.
    excess : float
        By how much the sensors contradict each other, over what noise and errors of the model leave.
    without : float
        The same with this explanation, below 1 where it explains all.
    other : float
        The same with the next best explanation.
    kept : tuple of str
        The sensors that are not at fault: ``sensors=fault.kept`` leaves the others out.
    """

    channels: tuple[str, ...]
    kind: str
    size: float
    std: float
    excess: float
    without: float
    other: float
    kept: tuple[str, ...]

    def __str__(self) -> str:
        who = " and ".join(self.channels[:2]) if self.kind == "swap" else ", ".join(self.channels)
        return _WORDS[self.kind].format(who=who, size=self.size, ms=1e3 * self.size)

    @property
    def correctable(self) -> bool:
        """Whether `correct` can free readings of it; else the sensor is left out."""
        return self.kind in MENDED

    def correct(self, found: T, dt: float | None = None, *, sensors: Sequence[str] = ()) -> T:
        """The readings without the fault: divided by the gain, shifted, exchanged, or less the offset.

        Parameters
        ----------
        found : Record, Spectra, mapping of label to reading, or array (..., sensors)
            What was given to `estimate`.
        dt : float, optional
            Step in s of a bare array, for a delay.
        sensors : sequence of str
            Labels of the columns of a bare array, or of spectra without names.

        Raises
        ------
        InputError
            A fault that no correction mends: leave the sensor out.
        """
        if not self.correctable:
            raise InputError(
                f"no correction mends this: {self}", where="correct", found=self.kind, expected=", ".join(MENDED),
                hint="leave the sensor out: sensors=fault.kept" if self.channels else "check the model and its loads",
            )  # fmt: skip
        if isinstance(found, Record):
            return replace(found, values=self._corrected(found.values, found.labels, found.dt))
        if isinstance(found, Spectra):
            labels = found.labels or tuple(sensors)
            return replace(found, values=self._of_lines(found.values, labels, found.frequencies))
        if isinstance(found, Mapping):
            labels = tuple(found)
            values = self._corrected(np.stack([np.asarray(v, float) for v in found.values()], axis=-1), labels, dt)
            return dict(zip(labels, np.moveaxis(values, -1, 0), strict=True))  # type: ignore[return-value]
        values = reals(found, what="no readings", where="correct")
        return self._corrected(values, sensors, dt)  # type: ignore[return-value]

    def _columns(self, labels: Sequence[str]) -> list[int]:
        missing = [c for c in self.channels if c not in labels]
        if missing:
            raise InputError("the readings have no such channel", where="correct", found=list(labels), expected=missing,
                             hint="name the columns of an array: sensors=")  # fmt: skip
        return [list(labels).index(c) for c in self.channels]

    def _corrected(self, values: Array, labels: Sequence[str], dt: float | None) -> Array:
        out, at = np.array(values, float), self._columns(labels)
        if self.kind == "swap":
            out[..., at] = out[..., at[::-1]]
        elif self.kind == "offset":
            out[..., at[0]] -= self.size
        elif self.kind == "delay":
            if dt is None:
                raise InputError("the step is not known", where="correct", found="no dt", expected="dt= in s")
            out[..., at[0]] = _advanced(out[..., at[0]], self.size / dt)
        else:
            out[..., at[0]] /= self._factor
        return out

    def _of_lines(self, values: Array, labels: Sequence[str], f: Array) -> Array:
        if self.kind == "delay":
            out, (at,) = np.array(values), self._columns(labels)
            out[:, at] *= np.exp(2j * np.pi * f * self.size)
            return out
        return np.asarray(self._corrected(values.real, labels, None) + 1j * self._corrected(values.imag, labels, None))

    @property
    def _factor(self) -> float:
        return -1.0 if self.kind == "polarity" else self.size

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {**asdict(self), "channels": list(self.channels), "kept": list(self.kept)}

    @classmethod
    def from_dict(cls, tree: Mapping[str, Any]) -> SensorFault:
        """Inverse of `to_dict`."""
        return cls(**{**tree, "channels": tuple(tree["channels"]), "kept": tuple(tree["kept"])})


_WORDS = {
    "gain": "{who} reads {size:.3g} times what the others say",
    "unit": "{who} reads {size:.4g} times what the others say: a factor of units",
    "polarity": "{who} has the wrong sign",
    "delay": "{who} is {ms:.4g} ms late",
    "swap": "{who} are exchanged",
    "offset": "{who} has an offset of {size:.4g}",
    "drift": "{who} drifts",
    "dead": "{who} does not follow the load: dead",
    "other": "{who} does not fit the others, whatever its gain and delay",
    "one of": "one of {who} is wrong, and the data cannot say which",
    "load": "no single sensor explains it: a load that the model does not have, or has elsewhere, or a wrong model",
}


def _advanced(y: Array, lag: float) -> Array:
    """A channel earlier by `lag` samples; what comes in at the ends stays what is nearest."""
    pad = int(np.ceil(abs(lag))) + 64
    whole = np.concatenate([np.full(pad, y[0]), y, np.full(pad, y[-1])])
    line = np.linspace(whole[0], whole[-1], len(whole))
    phase = 2 * np.pi * np.fft.rfftfreq(len(whole)) * lag
    moved = np.fft.irfft(np.fft.rfft(whole - line) * np.exp(1j * phase), len(whole)) + line
    return np.asarray(moved[pad : pad + len(y)])
