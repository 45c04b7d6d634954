"""Bare arrays as forward models: a static matrix, an impulse response."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._channels import named
from .._model import Model
from ..errors import InputError, count, digest, frozen, lines
from .discretise import check, own

TAIL = 0.1  # share of the impulse response, at its end, that tells whether it has decayed
DECAYED = 1e-3  # largest value of that tail over the peak, for every sensor and load


class MatrixModel(Model):
    """A static transfer matrix.

    Parameters
    ----------
    H : array (sensors, loads)
        Response per unit load; one dimension is one load.
    sensors, loads : sequence of Channel or str, optional

    Raises
    ------
    InputError
        If `H` is no real, finite matrix, is zero, or the labels do not fit.
    """

    def __init__(
        self, H: ArrayLike, *, sensors: Sequence[Any] | None = None, loads: Sequence[Any] | None = None
    ) -> None:
        H = frozen(H, "H")
        self.H = H[:, None] if H.ndim == 1 else H
        if self.H.ndim != 2 or 0 in self.H.shape:
            raise InputError(
                "no matrix",
                where="MatrixModel",
                found=f"shape {H.shape}",
                expected="(sensors, loads)",
                hint="one row per sensor, one column per load; ImpulseModel takes a response in time",
            )
        self.sensors = named(sensors, self.H.shape[0], "y", "sensors")
        self.loads = named(loads, self.H.shape[1], "u", "loads")
        _moves(self.H, "MatrixModel")

    def __repr__(self) -> str:
        return f"MatrixModel({len(self.sensors)} sensors, {len(self.loads)} loads)"

    @classmethod
    def of(cls, given: Model | ArrayLike) -> Model:
        """A model as it is, or a bare matrix as one.

        Raises
        ------
        InputError
            As the class.
        """
        return given if isinstance(given, Model) else cls(given)

    def static(self) -> NDArray[np.float64]:
        """The matrix (sensors, loads)."""
        return self.H

    @property
    def fingerprint(self) -> str:
        """Sha256 of the matrix and the channels."""
        return digest("MatrixModel", self.H, self.sensors, self.loads)


class ImpulseModel(Model):
    """An impulse response, known at one step.

    Parameters
    ----------
    h : array (samples,), (samples, sensors) or (samples, sensors, loads)
    dt : float
        Step in s.
    kind : ``"held"`` or ``"continuous"``
        Response to one unit held over one sample, as the contract wants it; or the impulse response of the continuous
        system sampled at ``dt``, which is then multiplied by `dt`.
    hold : ``"foh"`` or ``"zoh"``
        Under which hold it is used.
    sensors, loads : sequence of Channel or str, optional

    Notes
    -----
    It has *decayed* when, for every sensor and load, the last tenth stays below 1e-3 of the peak. Only then may more
    samples be asked than there are (zeros follow), and only then has it a frequency response.

    Raises
    ------
    InputError
        If `kind` is missing, a shape does not fit, a number is not finite, or all are zero.
    """

    dt: float

    def __init__(
        self,
        h: ArrayLike,
        dt: float,
        kind: str | None = None,
        hold: str = "foh",
        *,
        sensors: Sequence[Any] | None = None,
        loads: Sequence[Any] | None = None,
    ) -> None:
        check(dt, hold)
        if kind not in ("held", "continuous"):
            raise InputError(
                "the kind of the impulse response must be stated: it decides a factor dt",
                where="ImpulseModel(kind=)",
                found=repr(kind),
                expected="'held' (response to one unit held over one sample) or 'continuous' (to a unit impulse)",
                hint="kind='continuous' for a sampled textbook formula, 'held' for what a discrete model gives",
            )
        array = frozen(h, "h")
        if array.ndim not in (1, 2, 3) or 0 in array.shape:
            raise InputError(
                "no impulse response",
                where="ImpulseModel",
                found=f"shape {array.shape}",
                expected="(samples,), (samples, sensors) or (samples, sensors, loads)",
                hint="time comes first",
            )
        array = array.reshape(*array.shape, *[1] * (3 - array.ndim))
        self.h = frozen(array * dt, "h") if kind == "continuous" else array
        self.dt, self.kind, self.hold = float(dt), kind, hold
        self.sensors = named(sensors, array.shape[1], "y", "sensors")
        self.loads = named(loads, array.shape[2], "u", "loads")
        _moves(self.h, "ImpulseModel")

    def __repr__(self) -> str:
        n, m, p = self.h.shape
        size = f"{n} samples, {m} sensors, {p} loads"
        return f"ImpulseModel({size}, dt={self.dt:g} s, kind={self.kind!r}, hold={self.hold!r})"

    @property
    def default_hold(self) -> str:
        """The hold under which it is used."""
        return self.hold

    @property
    def tail(self) -> float:
        """Largest value of the last tenth over the peak: the worst sensor and load."""
        last = max(1, int(np.ceil(TAIL * len(self.h))))
        peak = np.abs(self.h).max(axis=0)
        return float(np.max(np.abs(self.h[-last:]).max(axis=0) / np.where(peak > 0, peak, 1.0)))

    @property
    def decayed(self) -> bool:
        """Whether zeros may follow its last sample."""
        return self.tail < DECAYED

    def impulse_response(self, dt: float, samples: int, hold: str | None = None) -> NDArray[np.float64]:
        """The first `samples` of it (samples, sensors, loads), zeros after its end where it has decayed.

        Raises
        ------
        InputError
            At another step or hold than its own, or beyond its end where it has not decayed.
        """
        what = "an impulse response exists at one step and one hold only"
        own(self, dt, hold, what, "resample the record, or give an impulse response at its step")
        if count(samples) > len(self.h):
            self._need_decay(f"{samples} samples were asked and it has {len(self.h)}")
            return np.concatenate([self.h, np.zeros((samples - len(self.h), *self.h.shape[1:]))])
        return self.h[:samples]

    def frf(self, frequencies: ArrayLike) -> NDArray[np.complex128]:
        """Frequency response (lines, sensors, loads) of the sampled system: the transform of `h`.

        Parameters
        ----------
        frequencies : array (lines,)
            Hz, up to Nyquist.

        Raises
        ------
        InputError
            If the response has not decayed, or a frequency lies above Nyquist.
        """
        self._need_decay("its transform needs its end")
        f = lines(frequencies, nyquist=0.5 / self.dt)
        n, flat = len(self.h), self.h.reshape(len(self.h), -1)
        H = np.empty((len(f), flat.shape[1]), dtype=complex)
        step = max(1, 2_000_000 // n)
        for a in range(0, len(f), step):
            H[a : a + step] = np.exp(-2j * np.pi * self.dt * np.outer(f[a : a + step], np.arange(n))) @ flat
        return H.reshape(len(f), *self.h.shape[1:])

    def _need_decay(self, why: str) -> None:
        if not self.decayed:
            raise InputError(
                f"the impulse response has not decayed: {why}",
                where="ImpulseModel",
                found=f"last tenth up to {self.tail:.2g} of the peak",
                expected=f"below {DECAYED:g} of the peak for every sensor and load",
                hint="give more samples of it",
            )

    @property
    def fingerprint(self) -> str:
        """Sha256 of the response, the step, the hold and the channels."""
        return digest("ImpulseModel", self.h, self.dt, self.hold, self.sensors, self.loads)


def _moves(response: NDArray[Any], where: str) -> None:
    """Refuse a model in which no load moves any sensor."""
    if not np.any(response):
        raise InputError(
            "no load moves any sensor",
            where=where,
            found=f"zeros, shape {response.shape}",
            expected="a response that is not zero everywhere",
            hint="check what was read or computed",
        )
