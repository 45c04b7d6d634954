"""Forward model from measurement: FRFs from hammer hits, or FRFs that somebody else estimated."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .channels import Channel
from .errors import InputError
from .flags import Evidence, Flag
from .hits import Hit, judge
from .model import Certificate, Model
from .spectra import padded_length, resample_lines, smooth_lines

KINDS = {"receptance": 0, "mobility": 1, "accelerance": 2}
QUANTITY = {"receptance": "displacement", "mobility": "velocity", "accelerance": "acceleration"}
UNIT = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s^2"}
NEIGHBOURS = 5  # lines on each side over which residual power is averaged


@dataclass(frozen=True)
class _Set:
    """Hits on one grid: force (hits, samples), responses (hits, samples, sensors)."""

    force: NDArray
    responses: NDArray
    dt: float
    load: Channel
    sensors: tuple[Channel, ...]
    names: tuple[str, ...]


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
        self.frequencies, self.H = np.asarray(frequencies, float), np.asarray(H, complex)
        self.sensors, self.loads, self.hits = tuple(sensors), tuple(loads), tuple(hits)
        self.variance = None if variance is None else np.asarray(variance, float)
        self.noise_power = None if noise_power is None else np.asarray(noise_power, float)
        self.coherence = None if coherence is None else np.asarray(coherence, float)
        self.samples = samples or len(self.frequencies) - 1
        self.certificate = certificate
        _check(self)
        self.flags = (*flags, *(f for f in [causality(self)] if f))

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
            Leave out double hits, clipped forces and overloads.

        Raises
        ------
        InputError
            No usable hit, different steps, unknown channels.

        Notes
        -----
        H1 = S_fy / S_ff over the zero-padded records (Bendat & Piersol, Random Data, ch. 6). With two hits or more the
        residual of the hits gives its variance, and each hit predicted from the others gives the certificate.
        """
        data = _gather(records, dt, force, responses)
        hits = []
        for f, y, name in zip(data.force, data.responses, data.names, strict=True):
            reason = judge(f, y) if reject else ""
            hits.append(Hit(name, not reason, reason, float(f[np.argmax(np.abs(f))]), digests(y)))
        keep = np.array([h.used for h in hits])
        if not keep.any():
            raise InputError(
                "no usable hit",
                where="from_hits",
                found="; ".join(f"{h.name}: {h.reason}" for h in hits),
                expected="at least one clean hit",
                hint="repeat the hits, or pass reject=False",
            )
        return cls._estimate(replace(data, force=data.force[keep], responses=data.responses[keep]), hits)

    @classmethod
    def _estimate(cls, data: _Set, hits: Sequence[Hit]) -> Self:
        from scipy import fft

        n, samples, _ = data.responses.shape
        padded = padded_length(samples)
        F = fft.rfft(data.force, padded, axis=1)
        Y = fft.rfft(data.responses, padded, axis=1)
        Sff = np.sum(np.abs(F) ** 2, axis=0)
        if np.any(Sff == 0):
            raise InputError(
                "the force has lines without any energy",
                where="from_hits",
                found=f"{int(np.sum(Sff == 0))} lines",
                expected="a broadband force",
            )
        Sfy = np.sum(F.conj()[..., None] * Y, axis=0)
        H = Sfy / Sff[:, None]
        extra: dict[str, Any] = {}
        if n > 1:
            residual = np.sum(np.abs(Y - H * F[..., None]) ** 2, axis=0) / (n - 1)
            power = smooth_lines(residual, NEIGHBOURS)
            floor = np.finfo(float).eps ** 2 * np.mean(np.abs(Y) ** 2, axis=(0, 1))
            power = np.maximum(power, np.maximum(floor, np.finfo(float).tiny))
            Syy = np.sum(np.abs(Y) ** 2, axis=0)
            extra = {
                "noise_power": power / samples,
                "variance": (power / Sff[:, None])[..., None],
                "coherence": np.abs(Sfy) ** 2 / (Sff[:, None] * np.where(Syy > 0, Syy, 1.0)),
                "certificate": _leave_one_out(data, F, Y, Sff, Sfy, padded),
            }
        return cls(
            np.fft.rfftfreq(padded, data.dt),
            H[..., None],
            sensors=data.sensors,
            loads=[data.load],
            hits=hits,
            samples=samples,
            **extra,
        )

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
        if kind not in KINDS:
            raise InputError(
                "receptance, mobility or accelerance?",
                where="from_frf",
                found=f"kind={kind!r}",
                expected=" or ".join(KINDS),
                hint="pass kind=",
                code="LID-W208",
            )
        f = np.atleast_1d(np.asarray(frequencies, float))
        H = _cube(np.asarray(H, complex))
        spread = None if variance is None else _cube(np.asarray(variance, float))
        if len(f) > 1 and 0.5 < f[0] / (f[1] - f[0]) < 1.5:
            first = H[:1] if kind == "receptance" else np.zeros_like(H[:1])
            f, H = np.concatenate([[0.0], f]), np.concatenate([first.real, H])
            spread = None if spread is None else np.concatenate([spread[:1], spread])
        quantity = QUANTITY[kind]
        rows, flags = _rows(sensors, H.shape[1], quantity), []
        for row in rows:
            if row.unit not in (UNIT[quantity], "arbitrary"):
                flags.append(
                    Flag(
                        "W208",
                        Evidence(f"unit of {row.label}", row.unit, UNIT[quantity]),
                        f"kind={kind!r} and the response unit {row.unit} do not fit",
                        "receptance is m/N, mobility m/s/N, accelerance m/s^2/N: correct the kind or the unit",
                    )
                )
        columns = tuple(
            c if isinstance(c, Channel) else Channel(label=c, quantity="force", unit="N")
            for c in (loads or [f"load {j + 1}" for j in range(H.shape[2])])
        )
        return cls(f, H, sensors=rows, loads=columns, variance=spread, flags=flags)

    def as_kind(self, kind: str) -> MeasuredModel:
        """The same model with its motion sensors as accelerance, mobility or receptance (0 Hz is dropped to zero)."""
        if kind not in KINDS:
            raise InputError("unknown kind of FRF", where="as_kind", found=repr(kind), expected=" or ".join(KINDS))
        have = {QUANTITY[k]: n for k, n in KINDS.items()}
        omega = 2j * np.pi * self.frequencies
        power = np.array([KINDS[kind] - have[s.quantity] if s.quantity in have else 0 for s in self.sensors])
        with np.errstate(divide="ignore", invalid="ignore"):
            factor = np.where(omega[:, None] == 0, (power == 0).astype(complex), omega[:, None] ** power)
        quantity = QUANTITY[kind]
        sensors = [
            replace(s, quantity=quantity, unit=UNIT[quantity], noise=None) if s.quantity in have else s
            for s in self.sensors
        ]
        size = np.abs(factor) ** 2
        return MeasuredModel(
            self.frequencies,
            self.H * factor[..., None],
            sensors=sensors,
            loads=self.loads,
            variance=None if self.variance is None else self.variance * size[..., None],
            noise_power=None if self.noise_power is None else np.maximum(self.noise_power * size, np.finfo(float).tiny),
            coherence=self.coherence,
            hits=self.hits,
            samples=self.samples,
        )

    # -- the contract -----------------------------------------------------------------------------------------------
    @property
    def dt(self) -> float:
        """Step (s) of the records that this model describes."""
        return float(1 / (2 * self.frequencies[-1]))

    def frf(self, frequencies: ArrayLike) -> NDArray[np.complex128]:
        """FRF at `frequencies` (Hz) inside the measured range, shape (lines, sensors, loads).

        On another uniform grid up to the same Nyquist frequency it is resampled through its impulse response; at other
        frequencies it is interpolated linearly on an eight times finer grid.
        """
        return self._lines(self.H, np.atleast_1d(np.asarray(frequencies, float)))

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
                hint="resample the record, or give --fs / dt= as recorded",
            )
        from scipy import fft

        h = fft.irfft(self.H, axis=0)
        h = h[: len(h) // 2]
        missing = samples - len(h)
        return h[:samples] if missing <= 0 else np.concatenate([h, np.zeros((missing, *h.shape[1:]))])

    def perturbed(self, parameter: str, factor: float) -> MeasuredModel:
        """The same model with its gain multiplied by `factor`; nothing else of a measured model has a name."""
        if parameter != "gain":
            raise InputError(
                "a measured model has no such parameter", where="perturbed", found=repr(parameter), expected="'gain'"
            )
        return MeasuredModel(
            self.frequencies,
            self.H * factor,
            sensors=self.sensors,
            loads=self.loads,
            variance=self.variance,
            noise_power=self.noise_power,
            coherence=self.coherence,
            hits=self.hits,
            samples=self.samples,
        )

    @property
    def training(self) -> frozenset[str]:
        """Digests of the responses that the model was made from."""
        return frozenset(d for h in self.hits if h.used for d in h.digests)

    @property
    def fingerprint(self) -> str:
        """Digest of grid, FRF and labels."""
        h = hashlib.sha256(np.ascontiguousarray(self.frequencies).tobytes() + np.ascontiguousarray(self.H).tobytes())
        h.update("|".join(c.label for c in (*self.sensors, *self.loads)).encode())
        return h.hexdigest()

    # -- files ------------------------------------------------------------------------------------------------------
    def save(self, path: str | os.PathLike) -> None:
        """Write the model to HDF5, whole or not at all, with checksums."""
        from . import storage

        certificate = None
        if self.certificate is not None:
            certificate = {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(self.certificate).items()}
        tree = {
            "frequencies": self.frequencies,
            "H": self.H,
            "variance": self.variance,
            "noise_power": self.noise_power,
            "coherence": self.coherence,
            "samples": self.samples,
            "sensors": [asdict(Channel(**_channel(c))) for c in self.sensors],
            "loads": [asdict(Channel(**_channel(c))) for c in self.loads],
            "hits": [{**asdict(h), "digests": list(h.digests)} for h in self.hits],
            "flags": [f.to_dict() for f in self.flags if f.code != "LID-W207"],
            "certificate": certificate,
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
        from . import storage

        tree = storage.read(path, "measured model")
        certificate = tree.pop("certificate")
        if certificate is not None:
            fields: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in certificate.items()}
            certificate = Certificate(**fields)
        return cls(
            tree.pop("frequencies"),
            tree.pop("H"),
            sensors=[Channel(**c) for c in tree.pop("sensors")],
            loads=[Channel(**c) for c in tree.pop("loads")],
            hits=[Hit(**{**h, "digests": tuple(h["digests"])}) for h in tree.pop("hits")],
            flags=[Flag.from_dict(f) for f in tree.pop("flags")],
            certificate=certificate,
            **tree,
        )

    def __repr__(self) -> str:
        used = sum(h.used for h in self.hits)
        source = f"{used} hits" if self.hits else "an imported FRF"
        return (
            f"MeasuredModel({len(self.sensors)} sensors, {len(self.loads)} loads, {len(self.frequencies)} lines "
            f"to {self.frequencies[-1]:.6g} Hz, from {source})"
        )

    def _lines(self, H: NDArray, f: NDArray) -> NDArray:
        own, top = self.frequencies, self.frequencies[-1]
        if f.shape == own.shape and np.allclose(f, own, rtol=1e-9, atol=1e-9 * top):
            return H
        if np.any(f < 0) or np.any(f > top * (1 + 1e-9)):
            raise InputError(
                "a frequency outside the measured range",
                where="frf",
                found=f"{f.min():.6g} to {f.max():.6g} Hz",
                expected=f"0 to {top:.6g} Hz",
            )
        n = len(f) - 1
        if n > 1 and np.allclose(f, np.linspace(0, top, n + 1), rtol=1e-9, atol=1e-9 * top):
            return resample_lines(H, 2 * n)
        fine = resample_lines(H, 16 * (len(own) - 1))
        return _interpolate(f, np.linspace(0, top, len(fine)), fine)


def causality(model: MeasuredModel) -> Flag | None:
    """W207: share of the impulse response's energy at negative times (0 for a causal response, 1 for a conjugate)."""
    h = np.fft.irfft(model.H, axis=0)
    half, skip = len(h) // 2, max(4, len(h) // 200)  # an anti-alias filter rings a little before zero
    before, after = (np.sum(x[skip : half - skip] ** 2) for x in (h[::-1], h))
    share = float(before / max(before + after, np.finfo(float).tiny))
    if share <= 0.1:
        return None
    return Flag(
        "W207",
        Evidence("energy at negative times", share, 0.1),
        f"the FRF is not causal: {share:.0%} of its impulse response lies before zero",
        "conjugate it, or correct the sign convention at import (e^{+i omega t})",
    )


def digests(columns: NDArray) -> tuple[str, ...]:
    """sha256 of the samples of each column of an array (samples, columns)."""
    return tuple(hashlib.sha256(np.ascontiguousarray(c, float).tobytes()).hexdigest() for c in np.asarray(columns).T)


def _leave_one_out(data: _Set, F: NDArray, Y: NDArray, Sff: NDArray, Sfy: NDArray, padded: int) -> Certificate:
    """Certificate of each hit predicted from the others."""
    from scipy import fft

    predicted = []
    for f, y in zip(F, Y, strict=True):
        rest = Sff - np.abs(f) ** 2
        H = (Sfy - f.conj()[:, None] * y) / np.where(rest > 0, rest, 1.0)[:, None]
        predicted.append(fft.irfft(H * f[:, None], padded, axis=0)[: data.responses.shape[1]])
    return Certificate.compare(
        np.concatenate(predicted),
        np.concatenate(list(data.responses)),
        [s.label for s in data.sensors],
        source=f"{len(F)} hits, each predicted from the others",
    )


def _gather(records: Sequence[Any], dt: float | None, force: str | int, responses: Sequence[str | int]) -> _Set:
    if not len(records):
        raise InputError("no records", where="from_hits", found="an empty list", expected="at least one hit")
    if isinstance(responses, (str, int)):
        responses = [responses]
    parts = [_columns(r, dt, [force, *responses], i) for i, r in enumerate(records)]
    steps = sorted({p[1] for p in parts})
    if steps[-1] / steps[0] - 1 > 1e-6:
        raise InputError(
            "the records have different steps", where="from_hits", found=f"dt = {steps} s", expected="one dt"
        )
    longest = max(len(p[0]) for p in parts)
    stack = np.zeros((len(parts), longest, 1 + len(responses)))
    for row, (values, *_) in zip(stack, parts, strict=True):
        row[: len(values)] = values
    first, *rest = parts[0][2]
    return _Set(stack[..., 0], stack[..., 1:], steps[0], first, tuple(rest), tuple(p[3] for p in parts))


def _columns(record: Any, dt: float | None, wanted: list, i: int) -> tuple[NDArray, float, tuple[Channel, ...], str]:
    values = np.asarray(getattr(record, "values", record), float)
    step = dt if dt is not None else getattr(record, "dt", None)
    name = str(getattr(record, "name", "") or f"hit {i + 1}")
    if step is None:
        raise InputError("the step of a bare array is not known", where=name, found="no dt", expected="dt= in s")
    if values.ndim != 2:
        raise InputError(
            "a record is a table", where=name, found=f"shape {values.shape}", expected="(samples, channels)"
        )
    channels = getattr(record, "channels", None) or [Channel(label=f"channel {j}") for j in range(values.shape[1])]
    labels = [c.label if isinstance(c, Channel) else str(c) for c in channels]
    index = []
    for w in wanted:
        j = labels.index(w) if w in labels else int(w) if str(w).lstrip("-").isdigit() else None
        if j is None or not -len(labels) <= j < len(labels):
            raise InputError("no such channel", where=name, found=repr(w), expected=f"one of {labels} or an index")
        index.append(j)
    picked = tuple(c if isinstance(c, Channel) else Channel(label=c) for c in (channels[j] for j in index))
    return values[:, index], float(step), picked, name


def _check(m: MeasuredModel) -> None:
    f, H = m.frequencies, m.H
    if H.ndim != 3 or H.shape != (len(f), len(m.sensors), len(m.loads)):
        raise InputError(
            "FRF, lines and channels do not fit",
            where="measured model",
            found=f"H {H.shape}, {len(f)} lines, {len(m.sensors)} sensors, {len(m.loads)} loads",
            expected="H (lines, sensors, loads)",
        )
    step = np.diff(f)
    if len(f) < 3 or f[0] != 0 or np.any(np.abs(step - step.mean()) > 1e-6 * step.mean()):
        raise InputError(
            "the lines of a measured model run uniformly from 0 Hz",
            where="measured model",
            found=f"{len(f)} lines from {f[0] if len(f) else 'none'} Hz",
            expected="uniform spacing, first line 0 Hz",
            hint="interpolate the FRF onto a uniform grid first",
        )
    for name in ("H", "variance", "noise_power", "coherence"):
        x = getattr(m, name)
        if x is not None and not np.all(np.isfinite(x)):
            raise InputError(
                "NaN or inf",
                where=f"measured model, {name}",
                expected="finite numbers",
                hint="mask or repair the lines",
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


def _rows(sensors: Sequence[str | Channel] | None, count: int, quantity: str) -> tuple[Channel, ...]:
    given = sensors or [f"sensor {i + 1}" for i in range(count)]
    return tuple(
        s if isinstance(s, Channel) else Channel(label=s, quantity=quantity, unit=UNIT[quantity]) for s in given
    )


def _channel(c: Channel) -> dict[str, Any]:
    return {k: getattr(c, k) for k in ("label", "quantity", "unit", "noise", "highpass", "measure")}
