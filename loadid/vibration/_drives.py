"""Drives of shakers that make the sensors of a model move as a specification says, within limits."""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._channels import Channel
from structures._flags import Flag
from structures._model import Model, as_model
from structures._readonly import ReadOnly
from structures._testing.welch import CrossSpectra
from structures.errors import InputError
from structures.files import _storage as storage

from .._guards import collect
from .._guards import vibration as guards
from .._record import Spectra, find
from ..sources._levels import widths
from ._profiles import TOLERANCE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .._inverse.constrained.driven import Caps

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
FILE = "drives"
MET = 1e-3  # relative distance from a limit at which it holds the drives
CHANNEL = ("label", "quantity", "unit")


@dataclass(frozen=True, eq=False, repr=False)
class Drives(ReadOnly):
    """Drives, and what the model predicts of them.

    Parameters
    ----------
    kind : ``"random"`` or ``"sine"``
    frequencies : array, shape (lines,)
        Hz.
    loads, sensors : tuple of Channel
        Drives in the order of the model; sensors of the target.
    matrix : array, shape (lines, loads, loads), complex, or None
        Cross spectra of random drives (unit^2/Hz).
    amplitudes : array, shape (lines, loads), complex, or None
        Of sines.
    H : array, shape (lines, sensors, loads), complex
        FRFs of these sensors.
    variance : array, shape (lines, sensors, loads)
        Of H, that was reckoned with.
    target : array, shape (lines, sensors)
        Densities or amplitudes that are asked for.
    free : array, shape (lines, sensors)
        Error in dB of the best drives without limits.
    tolerance : float
        dB to either side.
    limits : tuple of str
        What was limited, in words.
    caps, spread : array, shape (limits, lines, loads)
        Rows whose response is limited, and their variance.
    most, total : array, shape (limits, lines) and (limits,)
        To what: densities (or squared amplitudes) on the lines, mean squares over all of them; inf where there is none.
    passed : array, shape (limits,)
        dB by which the best drives without limits pass each, at most; 0 where they keep it.
    fingerprint : str
        Of the model.
    flags : tuple of Flag
    """

    kind: str
    frequencies: Real
    loads: tuple[Channel, ...]
    sensors: tuple[Channel, ...]
    matrix: Complex | None
    amplitudes: Complex | None
    H: Complex
    variance: Real
    target: Real
    free: Real
    tolerance: float = TOLERANCE
    limits: tuple[str, ...] = ()
    caps: Complex = field(default_factory=lambda: np.zeros((0, 0, 0), complex))
    spread: Real = field(default_factory=lambda: np.zeros((0, 0, 0)))
    most: Real = field(default_factory=lambda: np.zeros((0, 0)))
    total: Real = field(default_factory=lambda: np.zeros(0))
    passed: Real = field(default_factory=lambda: np.zeros(0))
    fingerprint: str = ""
    flags: tuple[Flag, ...] = ()

    def __post_init__(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False

    # -- numbers ------------------------------------------------------------------------------------------------------
    @property
    def level(self) -> Real:
        """Densities (unit^2/Hz) or amplitudes of the drives, (lines, loads)."""
        if self.matrix is not None:
            return np.asarray(np.einsum("kjj->kj", self.matrix).real, float)
        assert self.amplitudes is not None
        return np.abs(self.amplitudes)

    @property
    def response(self) -> Real:
        """Densities or amplitudes that the model predicts of the sensors, (lines, sensors)."""
        return _levels(self.H, self)

    @property
    def std(self) -> Real:
        """Std of `response` by errors of the FRFs, to first order, (lines, sensors)."""
        if self.matrix is not None:
            pushed = np.asarray(np.einsum("kij,ksj->ksi", self.matrix, self.H.conj()))
            return np.asarray(np.sqrt(2 * np.einsum("ksi,ksi->ks", self.variance, np.abs(pushed) ** 2)))
        return np.asarray(np.sqrt(np.einsum("ksi,ki->ks", self.variance, self.level**2) / 2))

    @property
    def error(self) -> Real:
        """Predicted response over target, dB, (lines, sensors)."""
        return decibels(self.response, self.target, self.kind)

    @property
    def rms_error(self) -> float:
        """Root mean square of `error` over lines and sensors, dB."""
        return float(np.sqrt(np.mean(self.error**2)))

    @property
    def within(self) -> float:
        """Share of lines and sensors within the tolerance."""
        return float(np.mean(np.abs(self.error) <= self.tolerance))

    @property
    def rms(self) -> Real:
        """Root mean square of every random drive over all lines; of a sine that of its largest line, (loads,)."""
        if self.matrix is not None:
            return np.asarray(np.sqrt(widths(self.frequencies) @ self.level))
        return np.asarray(self.level.max(axis=0) / np.sqrt(2))

    @property
    def power(self) -> float:
        """Sum of the mean squares of all drives, unit^2; of a sine the mean over its lines."""
        if self.matrix is not None:
            return float(np.sum(self.rms**2))
        return float(np.mean(np.sum(self.level**2, axis=1)) / 2)

    @property
    def cross_spectra(self) -> CrossSpectra:
        """Random drives as cross spectra.

        Raises
        ------
        InputError
            Of a sine.
        """
        if self.matrix is None:
            raise InputError("a sine has no cross spectra", where="Drives", found="sine", expected="random drives",
                             hint="Drives.amplitudes")  # fmt: skip
        return CrossSpectra(self.frequencies, self.matrix, channels=self.loads, averages=np.inf)

    def predict(self, model: Model) -> CrossSpectra | Spectra:
        """Response of the sensors of a model of the same loads: of those that were kept out, of another structure.

        Raises
        ------
        InputError
            Other loads.
        """
        H = _frf(model, self.frequencies, self.loads)
        if self.matrix is None:
            return Spectra(self.frequencies, np.einsum("ksj,kj->ks", H, np.asarray(self.amplitudes)), model.sensors)
        return CrossSpectra(self.frequencies, H @ self.matrix @ H.conj().swapaxes(1, 2), channels=model.sensors,
                            averages=np.inf)  # fmt: skip

    def errors_on(self, model: Model, measured: ArrayLike | CrossSpectra | Spectra) -> Real:
        """Response of the sensors of a model to these drives over what was measured, dB, (lines, sensors).

        Parameters
        ----------
        model : Model
            Of sensors that were kept out, or of the same ones.
        measured : CrossSpectra, Spectra or array, shape (lines, sensors)
            On the lines of the drives; densities or amplitudes.

        Raises
        ------
        InputError
            Other loads, lines or sensors, or a sensor that did not move.
        """
        levels = _levels(_frf(model, self.frequencies, self.loads), self)
        return decibels(levels, self._measured(measured, tuple(c.label for c in model.sensors)), self.kind)

    # -- updates ------------------------------------------------------------------------------------------------------
    def match_trace(self, measured: ArrayLike | CrossSpectra | Spectra | None = None) -> Self:
        """The drives with one factor per line that makes the summed power of the sensors that of the target.

        Parameters
        ----------
        measured : CrossSpectra, Spectra or array, shape (lines, sensors), optional
            Response of the sensors of the target while these drives ran; default what the model predicts.

        Returns
        -------
        Drives
            Within the limits all the same: where the factor passes one, it is lowered.

        Raises
        ------
        InputError
            Other lines or sensors.
        """
        names = tuple(c.label for c in self.sensors)
        made = self.response if measured is None else self._measured(measured, names)
        power = 1 if self.kind == "random" else 2
        gain = np.sum(self.target**power, axis=1) / np.sum(made**power, axis=1)
        new = self._scaled(gain)
        caps = new._caps()
        over = np.max(caps.power(new._power()) / caps.most, axis=0, initial=1.0)
        new = new._scaled(1 / over)
        whole = np.max(np.sum(caps.widths * caps.power(new._power()), axis=1) / caps.total, initial=1.0)
        return new._scaled(np.full(len(over), 1 / whole)).judged()

    def judged(self) -> Self:
        """The same drives with what is to be said of them: targets out of reach (W317), limits that cost (W316)."""
        names = tuple(c.label for c in self.sensors)
        kept = [f for f in self.flags if f.code not in ("LID-W316", "LID-W317")]
        found = collect([*kept, guards.unreachable(self.free, self.tolerance, names),
                         guards.held_back(self.free, self.error, self.bound)])  # fmt: skip
        return replace(self, flags=found)

    @property
    def met(self) -> Real:
        """Share of the lines on which each limit is met, (limits,); 1 for one over all lines that is."""
        if not self.limits:
            return np.zeros(0)
        caps, power = self._caps(), self._caps().power(self._power())
        whole = np.sum(caps.widths * power, axis=1) >= (1 - MET) * caps.total
        return np.where(whole, 1.0, np.mean(power >= (1 - MET) * caps.most, axis=1))

    @property
    def bound(self) -> tuple[str, ...]:
        """Limits that are met, with the share of the lines on which they are, and what the best drives would need."""
        found = []
        for c, (name, met) in enumerate(zip(self.limits, self.met, strict=True)):
            if met > 0:
                more = self.passed[c] if c < len(self.passed) else 0.0
                found.append(name + ("" if met == 1 else f" on {met:.0%} of the lines")
                             + (f", {more:.0f} dB below what the best drives need" if more >= 0.5 else ""))  # fmt: skip
        return tuple(found)

    @property
    def over(self) -> Real:
        """How far these drives pass each limit in dB, on the worst line or over all of them; 0 where they keep it."""
        if not self.limits:
            return np.zeros(0)
        caps, power = self._caps(), self._caps().power(self._power())
        lines = np.max(power / caps.most, axis=1)
        return np.asarray(10 * np.log10(np.maximum(np.maximum(lines, power @ caps.widths / caps.total), 1.0)))

    # -- words, pictures, files ---------------------------------------------------------------------------------------
    def __repr__(self) -> str:
        return (f"Drives({self.kind}, {self._sizes()}, "
                f"{len(self.frequencies)} lines, {self.rms_error:.2g} dB rms)")  # fmt: skip

    def __str__(self) -> str:
        return self.summary()

    def summary(self) -> str:
        """Errors first, then the drives, the limits that are met, and the flags."""
        f, error = self.frequencies, self.error
        k, i = np.unravel_index(int(np.argmax(np.abs(error))), error.shape)
        many = f"{self._sizes()}, {len(f)} lines, {f[0]:.6g} to {f[-1]:.6g} Hz"
        off = f"{self.rms_error:.2f} dB rms off the target, {self.within:.1%} within {self.tolerance:g} dB"
        lines = [
            f"{self.kind} drives: {many}",
            f"predicted response {off}; most {error[k, i]:+.1f} dB at {self.sensors[i].label}, {f[k]:.6g} Hz",
            f"errors of the FRFs make {self._frf_share():.2f} dB rms of the response uncertain",
        ]
        what = "rms" if self.kind == "random" else "largest amplitude"
        size = self.rms if self.kind == "random" else self.level.max(axis=0)
        lines += [f"  {c.label}: {what} {x:.4g} {c.unit}" for c, x in zip(self.loads, size, strict=True)]
        lines += [f"limit that binds: {name}" for name in self.bound]
        lines += [f"limit kept, with room: {n}" for n, met in zip(self.limits, self.met, strict=True) if met == 0]
        return "\n".join([*lines, *(str(flag) for flag in self.flags)])

    def _sizes(self) -> str:
        loads, sensors = len(self.loads), len(self.sensors)
        return f"{loads} load{'s' * (loads > 1)} for {sensors} sensor{'s' * (sensors > 1)}"

    def plot(self, *, path: str | os.PathLike[str] | None = None, show: bool = False) -> Figure:
        """Picture of the target with its tolerance, the predicted response, the drives and the error.

        Parameters
        ----------
        path, show
            As in `LoadEstimate.plot`.
        """
        from .._plots.vibration import draw_drives

        return draw_drives(self, path=path, show=show)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the drives to a file, whole or not at all, with checksums."""
        tree = {name: getattr(self, name) for name in self.__dataclass_fields__}
        for name in ("loads", "sensors"):
            tree[name] = [{k: getattr(c, k) for k in CHANNEL} for c in tree[name]]
        storage.write(path, {**tree, "flags": [f.to_dict() for f in self.flags]}, FILE)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Self:
        """Drives that `save` wrote.

        Raises
        ------
        InputError
            A damaged file, or one of another kind.
        """
        tree = storage.read(path, FILE)
        for name in ("loads", "sensors"):
            tree[name] = tuple(Channel(**c) for c in tree[name])
        tree["flags"] = tuple(Flag.from_dict(f) for f in tree["flags"])
        return cls(**{**tree, "limits": tuple(tree["limits"])})

    # -- inside -------------------------------------------------------------------------------------------------------
    def _frf_share(self) -> float:
        factor = 10 if self.kind == "random" else 20
        return float(factor / np.log(10) * np.sqrt(np.mean((self.std / np.maximum(self.response, 1e-300)) ** 2)))

    def _power(self) -> Complex:
        """Matrices whose diagonal is what is limited: cross spectra, or products of amplitudes."""
        if self.matrix is not None:
            return self.matrix
        assert self.amplitudes is not None
        return np.asarray(self.amplitudes[:, :, None] * self.amplitudes[:, None, :].conj())

    def _caps(self) -> Caps:
        from .._inverse.constrained.driven import Caps

        if not len(self.limits):
            return Caps.none(len(self.frequencies), len(self.loads))
        return Caps(self.caps, self.spread, self.most, widths(self.frequencies), self.total)

    def _scaled(self, gain: Real) -> Self:
        if self.matrix is not None:
            return replace(self, matrix=self.matrix * gain[:, None, None])
        assert self.amplitudes is not None
        return replace(self, amplitudes=self.amplitudes * np.sqrt(gain)[:, None])

    def _measured(self, measured: Any, names: tuple[str, ...]) -> Real:
        if isinstance(measured, CrossSpectra):
            measured = measured.restricted(list(names)).autospectra
        elif isinstance(measured, Spectra):
            table = np.abs(measured.values)
            measured = table[:, [find(n, measured.labels, what="channel", where="Drives") for n in names]]
        levels = np.asarray(measured, float)
        if levels.shape != (len(self.frequencies), len(names)) or not np.all(levels > 0):
            raise InputError("the measured response does not fit", where="Drives", found=f"shape {levels.shape}",
                             expected=f"{(len(self.frequencies), len(names))}, all above 0",
                             hint="on the lines of the drives: spectra.lines(...)")  # fmt: skip
        return levels


def decibels(made: Real, wanted: Real, kind: str) -> Real:
    """Level over level in dB, of densities or of amplitudes."""
    factor = 10 if kind == "random" else 20
    return np.asarray(factor * np.log10(np.maximum(made, 1e-20 * wanted) / wanted))


def _levels(H: Complex, drives: Drives) -> Real:
    if drives.matrix is not None:
        return np.asarray(np.maximum(np.einsum("ksi,kij,ksj->ks", H, drives.matrix, H.conj()).real, 0.0))
    assert drives.amplitudes is not None
    return np.asarray(np.abs(np.einsum("ksi,ki->ks", H, drives.amplitudes)))


def _frf(model: Model, frequencies: Real, loads: tuple[Channel, ...]) -> Complex:
    model = as_model(model, "Drives", "frf")
    have, want = [c.label for c in model.loads], [c.label for c in loads]
    if sorted(have) != sorted(want):
        raise InputError("the model has other loads than the drives", where="Drives", found=have[:12],
                         expected=want[:12])  # fmt: skip
    return np.asarray(model.frf(frequencies), complex)[:, :, [have.index(w) for w in want]]
