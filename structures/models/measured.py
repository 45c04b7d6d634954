"""Forward model from measurement: FRFs from hammer hits, or FRFs that somebody else estimated."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..advice import Advice, Option
from ..channels import Channel
from ..errors import InputError, as_array, plain
from ..files import storage
from ..flags import Flag
from ..model import Certificate, Model
from ..testing import kinds
from ..testing import kinds as causality
from ..testing.impact import Hit, from_hits
from ..testing.runs import full
from ..testing.spectra import checked_decay, exponential, resample_lines, taken_out

ARRAYS = ("frequencies", "H", "variance", "noise_power", "coherence")
PARTS = (*ARRAYS, "sensors", "loads", "hits", "samples")


class MeasuredModel(Model):
    """Frequency responses (lines, sensors, loads) on a uniform grid from 0 to the Nyquist frequency.

    Parameters
    ----------
    frequencies : array, shape (lines,)
        Hz, uniform, first line 0.
    H : array, shape (lines, sensors, loads)
        Response over load.
    sensors, loads : sequence of Channel
    variance : array like H, optional
        Variance of H.
    noise_power : array, shape (lines, sensors), optional
        Mean squared residual of the training hits per sample of record: what one more hit will miss by.
    coherence : array, shape (lines, sensors), optional
    hits : sequence of Hit
    samples : int, optional
        Length of the training records.

    Notes
    -----
    The ratio of sampled response to sampled force is a discrete response already: it knows no hold.
    """

    sampled = True
    frequencies: NDArray[np.float64]
    dt: float
    samples: int

    def __init__(
        self,
        frequencies: ArrayLike,
        H: ArrayLike,
        *,
        sensors: Sequence[Channel],
        loads: Sequence[Channel],
        variance: ArrayLike | None = None,
        noise_power: ArrayLike | None = None,
        coherence: ArrayLike | None = None,
        hits: Sequence[Hit] = (),
        samples: int | None = None,
        certificate: Certificate | None = None,
        flags: Sequence[Flag] = (),
    ) -> None:
        self.frequencies, self.H = np.asarray(plain(frequencies), float), np.asarray(plain(H), complex)
        self.sensors, self.loads, self.hits = tuple(sensors), tuple(loads), tuple(hits)
        self.variance = None if variance is None else np.asarray(plain(variance), float)
        self.noise_power = None if noise_power is None else np.asarray(plain(noise_power), float)
        self.coherence = None if coherence is None else np.asarray(plain(coherence), float)
        self.samples = samples or len(self.frequencies) - 1
        self.certificate = certificate
        _check(self)
        self.dt = float(1 / (2 * self.frequencies[-1]))
        self.flags = (*flags, *causality.whole(self.frequencies, self.H, self.sensors, self.loads))

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
            Leave out double hits, clipped forces and overloads. Records with NaN, without any force or with a dead
            response are left out in any case; `hits` says which and why.
        gate : float, optional
            Seconds on each side of the peak that are kept of the force; what lies outside is noise.
        decay : float
            Rate a (1/s) of an exponential window ``exp(-a t)`` on force and responses, from the peak of the force. The
            damping a / omega that it adds is taken out again, and the variance grows by what that costs.

        Raises
        ------
        InputError
            No usable hit, different steps or units, unknown channels, a window that is none.

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
        window: str | tuple = "hann",
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
        sensors: Sequence[str | Channel] | None = None,
        loads: Sequence[str | Channel] | None = None,
        variance: ArrayLike | None = None,
    ) -> Self:
        """Model from an FRF of somebody else.

        Parameters
        ----------
        frequencies : array, shape (lines,)
            Hz, uniform; a missing 0 Hz line is filled by 0 for accelerance and mobility, by the first line otherwise.
        H : array, shape (lines,), (lines, sensors) or (lines, sensors, loads)
        kind : {"accelerance", "mobility", "receptance"}
            What the response is; required, and never guessed.
        sensors, loads : sequence of str or Channel, optional
        variance : array like H, optional

        Raises
        ------
        InputError
            Kind missing (LID-W208), wrong shapes, a grid that is not uniform.
        """
        kind = kinds.check(kind, "from_frf")
        f = np.atleast_1d(as_array(frequencies, where="from_frf, frequencies", dtype=float))
        H = _cube(as_array(H, where="from_frf, H", dtype=complex))
        spread = None if variance is None else _cube(as_array(variance, where="from_frf, variance", dtype=float))
        if len(f) > 1 and 0.5 < f[0] / (f[1] - f[0]) < 1.5:
            first = H[:1].real if kind == "receptance" else np.zeros_like(H[:1])
            f, H = np.concatenate([[0.0], f]), np.concatenate([first, H])
            spread = None if spread is None else np.concatenate([spread[:1], spread])
        rows, flags = kinds.rows(sensors, H.shape[1], kind)
        columns = [
            c if isinstance(c, Channel) else Channel(label=str(c), quantity="force", unit="N")
            for c in (loads or [f"load {j + 1}" for j in range(H.shape[2])])
        ]
        return cls(f, H, sensors=rows, loads=columns, variance=spread, flags=flags)

    def as_kind(self, kind: str) -> Self:
        """The same model with its motion sensors as accelerance, mobility or receptance.

        Where a sensor changes its kind the 0 Hz line tells nothing: it becomes 0, as uncertain as the line beside it.
        """
        kind = kinds.check(kind, "as_kind")
        factor, size, _ = kinds.conversion(self.sensors, self.frequencies, kind)
        sensors = [kinds.convert(s, kind) for s in self.sensors]
        known = self.certificate
        return self._like(
            H=self.H * factor[..., None],
            sensors=sensors,
            variance=None if self.variance is None else self.variance * size[..., None],
            noise_power=None if self.noise_power is None else self.noise_power * size,
            certificate=known and replace(known, source=f"{known.source} (before it was converted to {kind})"),
        )

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
        changed = {name: getattr(self, name) for name in ("variance", "noise_power", "coherence")}
        moved = {n: None if x is None else _interpolate(f, self.frequencies, x) for n, x in changed.items()}
        if moved["variance"] is not None:
            moved["variance"] = moved["variance"] / np.mean(exponential(samples, self.dt, decay) ** 2)
        known = self.certificate
        return self._like(
            frequencies=f,
            H=H,
            **moved,
            certificate=known and replace(known, source=f"{known.source} (before its window was taken out)"),
        )

    def perturbed(self, parameter: str, factor: float) -> Self:
        """The same model with its gain multiplied by `factor`; nothing else of a measured model has a name."""
        if parameter != "gain":
            raise InputError(
                "a measured model has no such parameter", where="perturbed", found=repr(parameter), expected="'gain'"
            )
        return self._like(H=self.H * factor, variance=None if self.variance is None else self.variance * factor**2)

    def with_sensors(self, rows: Sequence[int] | NDArray[np.intp]) -> Self:
        """The same model with some of its sensors, in the order given, and not yet verified."""
        rows = np.asarray(rows, np.intp)
        return self._like(
            sensors=[self.sensors[i] for i in rows],
            H=self.H[:, rows],
            variance=None if self.variance is None else self.variance[:, rows],
            coherence=None if self.coherence is None else self.coherence[:, rows],
            noise_power=None if self.noise_power is None else self.noise_power[:, rows],
            certificate=None,
        )

    def _like(self, **changes: Any) -> Self:
        same = {name: getattr(self, name) for name in PARTS}
        return type(self)(**{**same, "flags": self._given_flags, **changes})

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
        return _interpolate(f, np.linspace(0, top, len(fine)), fine)

    def frf_variance(self, frequencies: ArrayLike) -> NDArray[np.float64] | None:
        """Variance of the FRF at `frequencies`, or None where one hit or an imported FRF does not tell."""
        return None if self.variance is None else _interpolate(frequencies, self.frequencies, self.variance)

    def noise_spectrum(self, frequencies: ArrayLike) -> NDArray[np.float64] | None:
        """Mean squared residual of the hits, per sample of record, shape (lines, sensors); None for one hit."""
        return None if self.noise_power is None else _interpolate(frequencies, self.frequencies, self.noise_power)

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

    @property
    def _given_flags(self) -> tuple[Flag, ...]:
        """Flags that no constructor finds again."""
        return tuple(f for f in self.flags if f.code != "LID-W207")

    # -- files ------------------------------------------------------------------------------------------------------
    def save(self, path: str | os.PathLike) -> None:
        """Write the model to HDF5, whole or not at all, with checksums."""
        tree: dict[str, Any] = {
            **{name: getattr(self, name) for name in ARRAYS},
            "samples": self.samples,
            "hits": [asdict(h) for h in self.hits],
            "flags": [f.to_dict() for f in self._given_flags],
            **self._told(),
        }
        storage.write(path, tree, "measured model")

    @classmethod
    def load(cls, path: str | os.PathLike) -> Self:
        """Read a model that `save` wrote.

        Raises
        ------
        InputError
            A damaged file, or one of another kind.
        """
        tree = storage.read(path, "measured model")
        known = tree.pop("certificate")
        return cls(
            sensors=[Channel(**c) for c in tree.pop("sensors")],
            loads=[Channel(**c) for c in tree.pop("loads")],
            hits=[Hit(**tuples(h)) for h in tree.pop("hits")],
            flags=[Flag.from_dict(f) for f in tree.pop("flags")],
            certificate=None if known is None else Certificate(**tuples(known)),
            **tree,
        )

    def __repr__(self) -> str:
        used = sum(h.used for h in self.hits)
        source = f"{used} record{'s' * (used != 1)}" if self.hits else "an imported FRF"
        return (
            f"MeasuredModel({len(self.sensors)} sensors, {len(self.loads)} loads, {len(self.frequencies)} lines "
            f"to {self.frequencies[-1]:.6g} Hz, from {source})"
        )


def _check(m: MeasuredModel) -> None:
    f, H = m.frequencies, m.H
    rows = (len(f), len(m.sensors))
    if H.ndim != 3 or H.shape != (*rows, len(m.loads)) or not H.size:
        raise InputError(
            "FRF, lines and channels do not fit",
            where="measured model",
            found=f"H {H.shape}, {len(f)} lines, {len(m.sensors)} sensors, {len(m.loads)} loads",
            expected="H (lines, sensors, loads)",
        )
    for name, shape in (("variance", H.shape), ("noise_power", rows), ("coherence", rows)):
        x = getattr(m, name)
        if x is not None and x.shape != shape:
            raise InputError(f"{name} does not fit the FRF", where="measured model", found=x.shape, expected=shape)
    for name in ARRAYS:
        x = getattr(m, name)
        if x is not None and not np.all(np.isfinite(x)):
            raise InputError(
                "NaN or inf",
                where=f"measured model, {name}",
                found=f"{int(np.sum(~np.isfinite(x)))} of {x.size}",
                expected="finite numbers",
                hint="mask or repair the lines",
            )
        if name in ARRAYS[2:] and x is not None and np.any(x < 0):
            raise InputError("a negative power", where=f"measured model, {name}", found=x.min(), expected=">= 0")
    step = np.diff(f)
    if len(f) < 3 or f[0] != 0 or np.any(np.abs(step - step.mean()) > 1e-6 * step.mean()):
        raise InputError(
            "the lines of a measured model run uniformly from 0 Hz",
            where="measured model",
            found=f"{len(f)} lines from {f[0] if len(f) else 'none'} Hz",
            expected="uniform spacing, first line 0 Hz",
            hint="interpolate the FRF onto a uniform grid first",
        )
    labels = [c.label for c in m.sensors]
    if len(set(labels)) != len(labels):
        raise InputError("sensor labels are not unique", where="measured model", found=labels, expected="unique labels")


def _interpolate(f: ArrayLike, own: NDArray, x: NDArray) -> NDArray:
    from scipy.interpolate import make_interp_spline

    f = np.clip(np.atleast_1d(np.asarray(f, float)), own[0], own[-1])
    if np.iscomplexobj(x):
        return make_interp_spline(own, x.real, k=1)(f) + 1j * make_interp_spline(own, x.imag, k=1)(f)
    return make_interp_spline(own, x, k=1)(f)


def _cube(H: NDArray) -> NDArray:
    return H.reshape(H.shape + (1,) * (3 - H.ndim))


def tuples(tree: dict[str, Any]) -> dict[str, Any]:
    """What a file gives back as lists, as the tuples that it was."""
    return {k: tuple(v) if isinstance(v, list) else v for k, v in tree.items()}
