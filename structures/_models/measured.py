"""Forward model from measurement: FRFs from hammer hits, or FRFs that somebody else estimated."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._advice import Advice, Option
from .._certificate import Certificate
from .._channels import Channel
from .._flags import Flag
from .._testing import kinds
from .._testing.frfs import full
from .._testing.impact import Hit, TrainingRecords, from_hits
from .._testing.spectra import checked_decay, exponential, resample_lines, taken_out
from ..errors import InputError, as_array, lines, plain
from .lines import between, checked
from .tabulated import FrfModel

OLD = ("noise_power", "hits", "samples")  # what 0.1 took beside `records`


class MeasuredModel(FrfModel):
    """Frequency responses (lines, sensors, loads) on a uniform grid from 0 to the Nyquist frequency.

    Parameters
    ----------
    frequencies : array, shape (lines,)
        Hz, uniform, first line 0.
    H : array, shape (lines, sensors, loads)
        Response over load.
    sensors, loads : sequence of Channel
    variance : array like H, optional
        Variance E|error|^2 of H.
    coherence : array, shape (lines, sensors), optional
    records : TrainingRecords
        What the tests tell of themselves that H was estimated from: hits, their length, residual power.
    certificate : Certificate, optional
    flags : sequence of Flag
    **old
        ``hits``, ``samples`` and ``noise_power`` of version 0.1, which `records` holds now.

    Raises
    ------
    InputError
        Shapes that do not fit, NaN, lines that do not run uniformly from 0 Hz, doubled labels, a table of zeros.

    Notes
    -----
    The ratio of sampled response to sampled force is a discrete response already: it knows no hold. `from_frf` fills a
    missing line at 0 Hz, by 0 for accelerance and mobility, by the first line otherwise.
    """

    sampled = True
    dt: float
    samples: int
    file = "measured model"
    tables: ClassVar[tuple[str, ...]] = ("H", "variance", "coherence", "noise_power")
    powers: ClassVar[tuple[str, ...]] = ("variance", "noise_power")
    others: ClassVar[tuple[str, ...]] = ("frequencies", "sensors", "loads")

    def __init__(
        self,
        frequencies: ArrayLike,
        H: ArrayLike,
        *,
        sensors: Sequence[Channel],
        loads: Sequence[Channel],
        variance: ArrayLike | None = None,
        coherence: ArrayLike | None = None,
        records: TrainingRecords | None = None,
        certificate: Certificate | None = None,
        flags: Sequence[Flag] = (),
        **old: Any,
    ) -> None:
        super().__init__(
            frequencies, H, sensors=sensors, loads=loads, variance=variance, coherence=coherence,
            certificate=certificate, flags=flags,
        )  # fmt: skip
        records = _records(records, old)
        power, rows = records.noise_power, self.H.shape[:2]
        self.noise_power = None if power is None else checked("noise_power", power, rows, where=type(self).__name__)
        self.gain_covariance = None if records.gains is None else np.asarray(records.gains, float)
        self.hits, self.samples = tuple(records.hits), records.samples or len(self.frequencies) - 1
        self.dt = float(1 / (2 * self.frequencies[-1]))
        turned = kinds.whole(self.frequencies, self.H, self.sensors, self.loads)
        self.flags = (*self.flags, *turned, *self._reciprocal())

    # -- construction -----------------------------------------------------------------------------------------------
    @classmethod
    def from_hits(
        cls,
        records: Sequence[Any],
        *,
        dt: float | None = None,
        force: str | int,
        responses: Sequence[str | int],
        reject: bool = True,
        gate: float | None = None,
        decay: float = 0.0,
    ) -> Self:
        """FRF (H1), coherence, FRF variance and residual power from the records of an impact test.

        Parameters
        ----------
        records : sequence
            Arrays (samples, channels), or objects with ``values`` and ``dt`` (and ``labels`` or ``channels``).
        dt : float, optional
            Step in s of bare arrays.
        force, responses : label or index
            Channels.
        reject : bool
            Leave out double hits, clipped forces and overloads, and hits that contradict most of the others (W223).
            Records with NaN, without any force or with a dead response are left out in any case; `hits` says which and
            why.
        gate : float, optional
            Seconds on each side of the peak that are kept of the force; what lies outside is noise.
        decay : float
            Rate a (1/s) of an exponential window ``exp(-a t)`` on force and responses, from the peak of the force. The
            damping a / omega that it adds is taken out again, and the variance grows by what that costs.

        Raises
        ------
        InputError
            No usable hit, different steps or units, unknown channels, a window that is none; hits that contradict each
            other where no majority says which is right (LID-E223).

        Notes
        -----
        H1 = S_fy / S_ff over the zero-padded records (Bendat & Piersol, Random Data, ch. 6). With two hits or more the
        residual of the hits gives its variance, and each hit predicted from the others gives the certificate.
        """
        return cls(**from_hits(records, dt, force, responses, reject, gate, decay))

    @classmethod
    def from_random(
        cls,
        records: Any,
        *,
        forces: str | int | Sequence[str | int],
        responses: str | int | Sequence[str | int],
        dt: float | None = None,
        channels: Sequence[Channel | str] | None = None,
        kind: str | None = None,
        estimator: str = "H1",
        window: str | tuple[Any, ...] = "hann",
        segment: int | None = None,
        overlap: float = 0.5,
        detrend: str | None = "constant",
    ) -> Self:
        """FRFs, coherence, variance and residual power from shaker records with broadband forces.

        Parameters
        ----------
        records, forces, responses, dt, channels, kind, estimator, window, segment, overlap, detrend
            As for `FrfModel.from_records`. A segment has an even length; the impulse response is as long as half of it.

        Raises
        ------
        InputError
            As for `FrfModel.from_records`; forces without energy on more than 1 % of the lines.
        NotIdentifiable
            Code LID-E212: forces that are one.

        Notes
        -----
        Each record predicted from the others, or each half of one from the other, gives the certificate. A line
        without excitation takes the FRF of the nearest one that has it.
        """
        cut = {"dt": dt, "channels": channels, "window": window, "segment": segment, "overlap": overlap}
        cut["detrend"] = detrend
        return cls(**full(records, forces, responses, kind, estimator, cut))

    @classmethod
    def from_frf(
        cls,
        frequencies: ArrayLike,
        H: ArrayLike,
        *,
        kind: str | None = None,
        variance: ArrayLike | None = None,
        **settings: Any,
    ) -> Self:
        """Model from an FRF of somebody else; parameters and errors as for `FrfModel.from_frf`.

        The lines are uniform; a missing one at 0 Hz is filled by 0 for accelerance and mobility, by the first line
        otherwise.
        """
        f = np.atleast_1d(as_array(frequencies, where="from_frf, frequencies", dtype=float))
        table = np.atleast_1d(as_array(H, where="from_frf, H", dtype=complex))
        spread = None if variance is None else np.atleast_1d(as_array(variance, where="from_frf, variance"))
        if len(f) > 1 and 0.5 < f[0] / (f[1] - f[0]) < 1.5:
            first = table[:1].real if kind == "receptance" else np.zeros_like(table[:1])
            f, table = np.concatenate([[0.0], f]), np.concatenate([first, table])
            spread = None if spread is None else np.concatenate([spread[:1], spread])
        return super().from_frf(f, table, kind=kind, variance=spread, **settings)

    @classmethod
    def _lines(cls, frequencies: ArrayLike) -> NDArray[np.float64]:
        f = lines(frequencies)
        step = np.diff(f)
        if len(f) < 3 or f[0] != 0 or np.any(np.abs(step - step.mean()) > 1e-6 * step.mean()):
            raise InputError(
                "the lines of a measured model run uniformly from 0 Hz",
                where="measured model",
                found=f"{len(f)} lines from {f[0] if len(f) else 'none'} Hz",
                expected="uniform spacing, first line 0 Hz",
                hint="interpolate the FRF onto a uniform grid first",
            )
        return f

    def judged(self) -> Self:
        """The model itself: its whole impulse response was judged when it was made."""
        return self

    def without_window(self, decay: float, duration: float | None = None) -> Self:
        """The model without the damping of an exponential window ``exp(-decay t)`` under which it was measured.

        Parameters
        ----------
        decay : float
            Rate in 1/s: that of a window that falls to the share s over T seconds is ``-ln(s) / T``.
        duration : float, optional
            Length T of the windowed records in s; half of the transform where not given. What comes later becomes 0.

        Raises
        ------
        InputError
            A decay below zero or too steep, a duration that the lines do not hold.

        Notes
        -----
        Force and response, both windowed, give ``H(omega - i decay)``; its impulse response times ``exp(decay t)`` is
        that of H. Where the window was on the response alone and began with the hit, the force being short, it is the
        same. The variance grows by one over the mean square of the window: noise was recorded before it was windowed.
        """
        period = 2 * (len(self.frequencies) - 1)
        samples = period // 2 if duration is None else round(duration / self.dt)
        if not 1 <= samples <= period:
            raise InputError(
                "a record longer than the lines resolve",
                where="without_window",
                found=f"duration={duration!r} s",
                expected=f"at most {period * self.dt:.6g} s",
            )
        decay = checked_decay(decay, samples * self.dt, "without_window")
        H = taken_out(self.H, decay * self.dt, samples)
        f = np.linspace(0.0, self.frequencies[-1], len(H))
        moved = self._each(lambda x: between(f, self.frequencies, x))
        if moved["variance"] is not None:
            moved["variance"] = moved["variance"] / np.mean(exponential(samples, self.dt, decay) ** 2)
        return self._like(
            **{**moved, "frequencies": f, "H": H}, certificate=self._certified("its window was taken out")
        )

    def with_sensors(self, rows: Sequence[int] | NDArray[np.intp]) -> Self:
        """The same model with some of its sensors, by index, in the order given."""
        gains = self.gain_covariance
        kept = np.asarray(rows, np.intp)
        return super().with_sensors(kept)._like(gains=None if gains is None else gains[np.ix_(kept, kept)])

    def _like(self, **changes: Any) -> Self:
        """The same model with other arguments."""
        power, gains = changes.pop("noise_power", self.noise_power), changes.pop("gains", self.gain_covariance)
        records = TrainingRecords(self.hits, self.samples, power, gains)
        same = {name: getattr(self, name) for name in ("H", "variance", "coherence", *self.others)}
        return type(self)(**{**same, "flags": self._given_flags, "records": records, **changes})

    # -- the contract -----------------------------------------------------------------------------------------------
    def frf(self, frequencies: ArrayLike) -> NDArray[np.complex128]:
        """FRF at `frequencies` (Hz) inside the measured range, shape (lines, sensors, loads).

        On another uniform grid up to the same Nyquist frequency it is resampled through its impulse response; at other
        frequencies it is interpolated linearly on an eight times finer grid.

        Raises
        ------
        InputError
            A frequency outside the measured range.
        """
        f = np.atleast_1d(np.asarray(plain(frequencies), float))
        own, top = self.frequencies, self.frequencies[-1]
        if not np.all((f >= 0) & (f <= top * (1 + 1e-9))):
            raise InputError(
                "a frequency outside the measured range",
                where="frf",
                found=f"{f.min():.6g} to {f.max():.6g} Hz",
                expected=f"0 to {top:.6g} Hz",
            )
        if f.shape == own.shape and np.allclose(f, own, rtol=1e-9, atol=1e-9 * top):
            return self.H
        n = len(f) - 1
        if n > 1 and np.allclose(f, np.linspace(0, top, n + 1), rtol=1e-9, atol=1e-9 * top):
            return resample_lines(self.H, 2 * n)
        fine = resample_lines(self.H, 16 * (len(own) - 1))
        return between(f, np.linspace(0, top, len(fine)), fine)

    def frf_variance(self, frequencies: ArrayLike) -> NDArray[np.float64] | None:
        """Variance of the FRF at `frequencies`, or None where one hit or an imported FRF does not tell."""
        return None if self.variance is None else self._read(self.variance, frequencies)

    def noise_spectrum(self, frequencies: ArrayLike) -> NDArray[np.float64] | None:
        """Mean squared residual of the hits, per sample of record, shape (lines, sensors); None for one hit."""
        return None if self.noise_power is None else self._read(self.noise_power, frequencies)

    def has_lines(self, frequencies: ArrayLike) -> NDArray[np.bool_]:
        """It answers at all frequencies (Hz) of its range."""
        return np.ones(np.shape(frequencies), bool)

    def _read(self, table: NDArray[Any], frequencies: ArrayLike) -> NDArray[Any]:
        return between(np.atleast_1d(np.asarray(plain(frequencies), float)), self.frequencies, table)

    def impulse_response(self, dt: float, samples: int, hold: str = "foh") -> NDArray[np.float64]:
        """Impulse response (samples, sensors, loads) at the step of the training records.

        Raises
        ------
        InputError
            Another step than the model's.
        """
        if abs(dt / self.dt - 1) > 1e-6:
            raise InputError(
                "the record and the model have different steps",
                where="impulse_response",
                found=f"dt = {dt:.9g} s",
                expected=f"dt = {self.dt:.9g} s",
                hint=Advice("resample the record, or give ", Option("dt", flag="fs"), " as recorded"),
            )
        from scipy import fft

        h = fft.irfft(self.H, axis=0)
        h = h[: len(h) // 2]
        missing = samples - len(h)
        return h[:samples] if missing <= 0 else np.concatenate([h, np.zeros((missing, *h.shape[1:]))])

    @property
    def training(self) -> frozenset[str]:
        """Digests of the responses that the model was made from."""
        return frozenset(d for h in self.hits if h.used for d in h.digests)

    @property
    def fingerprint(self) -> str:
        """Digest of grid, FRF, its variance, the residual power, and what the channels are."""
        h = hashlib.sha256(repr([(c.label, c.quantity, c.unit) for c in (*self.sensors, *self.loads)]).encode())
        for name in ("frequencies", "H", "variance", "noise_power"):
            x = getattr(self, name)
            h.update(f"|{name}|".encode() + (b"" if x is None else np.ascontiguousarray(x).tobytes()))
        return h.hexdigest()

    # -- files ------------------------------------------------------------------------------------------------------
    def _arguments(self) -> dict[str, Any]:
        names = ("frequencies", *self.tables, "samples", "gain_covariance")
        return {name: getattr(self, name) for name in names} | {"hits": [asdict(h) for h in self.hits]}

    @classmethod
    def _restored(cls, tree: dict[str, Any]) -> dict[str, Any]:
        hits = tuple(Hit(**{**h, "digests": tuple(h["digests"])}) for h in tree.pop("hits"))
        records = TrainingRecords(hits, tree.pop("samples"), tree.pop("noise_power"), tree.pop("gain_covariance", None))
        return {**tree, "records": records}

    def __repr__(self) -> str:
        used = sum(h.used for h in self.hits)
        source = f"{used} record{'s' * (used != 1)}" if self.hits else "an imported FRF"
        return (
            f"MeasuredModel({len(self.sensors)} sensors, {len(self.loads)} loads, {len(self.frequencies)} lines "
            f"to {self.frequencies[-1]:.6g} Hz, from {source})"
        )


def _records(records: TrainingRecords | None, old: dict[str, Any]) -> TrainingRecords:
    """The records, or what 0.1 called them."""
    unknown = [name for name in old if name not in OLD]
    if unknown:
        raise TypeError(f"MeasuredModel takes no argument {unknown[0]!r}")
    if not old:
        return records or TrainingRecords()
    new = "records=structures.TrainingRecords(hits=, samples=, noise_power=)"
    warnings.warn(f"MeasuredModel({', '.join(f'{n}=' for n in old)}) is now {new}", DeprecationWarning, stacklevel=3)
    return TrainingRecords(tuple(old.get("hits", ())), old.get("samples"), old.get("noise_power"))
