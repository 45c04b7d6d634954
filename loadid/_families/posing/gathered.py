"""From spectra, cross spectra or a record to the lines that are inverted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._advice import Advice
from structures._channels import Channel
from structures._flags import Flag
from structures._model import Model
from structures._testing.spectra import padded_length
from structures._testing.welch import CrossSpectra, cross_spectra
from structures.errors import InputError, digest, plain, reals

from ..._inverse.problem import NOT_KNOWN, STATED, NoiseSource
from ..._record import Record, Spectra
from ...settings import SIGNALS, Noise, Signal
from .. import noise as noises
from ..data import WITHOUT_SENSOR, Data, gather

Array = NDArray[Any]

NEGATIVE = 1e-6  # of the largest eigenvalue: rounding that a cross-spectral matrix may show


@dataclass(frozen=True)
class LineData:
    """Responses on frequency lines.

    Parameters
    ----------
    frequencies : array, shape (lines,)
    X : array, shape (lines, sensors, snapshots)
        ``X X^H`` is the spectrum of one realisation, or the mean over the averages of a cross spectrum.
    power : array, shape (lines, sensors)
        Variance of the noise of one realisation; where it is not known, a scale per channel.
    known : bool
    source : NoiseSource
        Where the noise comes from.
    averages : float
    kind : str
        ``"spectra"``, ``"cross spectra"`` or ``"transient"``.
    rows : array of int
        Sensors of the model.
    channels : tuple of Channel
    inputs : dict
        Name -> digest.
    data : Data or None
        The record of a transient.
    padded : int
        Length of its transform.
    part_of : BandPart, optional
        Of a transient behind a table of FRFs: which lines of the transform these are.
    findings : tuple of Flag
    facts : dict
        How the spectra were made.
    fingerprints : frozenset of str
        Digests of the channels of the records, which a model made from them knows.
    simulated_by : str
        Fingerprint of the model that made the records; "" where they were measured.
    """

    frequencies: NDArray[np.float64]
    X: NDArray[np.complex128]
    power: NDArray[np.float64]
    known: bool
    source: NoiseSource
    averages: float
    kind: str
    rows: NDArray[np.int_]
    channels: tuple[Channel, ...]
    inputs: dict[str, str]
    data: Data | None = None
    padded: int = 0
    part_of: BandPart | None = None
    findings: tuple[Flag, ...] = ()
    facts: dict[str, Any] | None = None
    fingerprints: frozenset[str] = frozenset()
    simulated_by: str = ""

    @property
    def fullness(self) -> float:
        """Independent lines over all lines: below 1 where the transform was padded."""
        return 1.0 if self.data is None else len(self.data.values) / self.padded

    def part(self, pick: slice) -> LineData:
        """The lines of some sensors."""
        data = self.data
        if data is not None:
            data = replace(data, values=data.values[:, pick], rows=data.rows[pick], channels=data.channels[pick],
                           missing=data.missing[:, pick])  # fmt: skip
        return replace(
            self, X=self.X[:, pick], power=self.power[:, pick], rows=self.rows[pick], channels=self.channels[pick],
            data=data,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class BandPart:
    """A part of the lines of a padded transform, and how its ends fade.

    Parameters
    ----------
    at : array of int, shape (lines,)
        Where they stand in the transform.
    weight : array, shape (lines,)
        1 inside, falling to 0 as a half cosine over `TAPERED` of the band, below over an octave at most, at an end that
        is not that of all lines.
    edges : (float, float)
        Widths (Hz) of the two tapers, 0 where there is none.
    outside : float
        Share of the energy of the record on the other lines, and of what the tapers take away.
    """

    at: NDArray[np.int_]
    weight: NDArray[np.float64]
    edges: tuple[float, float]
    outside: float

    def whole(self, lines: Array, padded: int, power: int = 1) -> NDArray[Any]:
        """Lines (lines, ...) in the transform of this length, zero elsewhere, by a power of the weight."""
        found = np.zeros((padded // 2 + 1, *lines.shape[1:]), lines.dtype)
        found[self.at] = lines * (self.weight**power).reshape(-1, *[1] * (lines.ndim - 1))
        return found

    def history(self, lines: Array, padded: int, samples: int) -> NDArray[np.float64]:
        """What these lines are over time, (samples, ...)."""
        return np.fft.irfft(self.whole(lines, padded), padded, axis=0)[:samples]


TAPERED = 0.1  # of the band, at each end; below over no more than an octave, where a hit has most of its force


@dataclass(frozen=True)
class LineSettings:
    """How records become lines."""

    noise: Noise
    signal: Signal
    band: tuple[float, float] | None


def lines_of(found: Any, dt: float | None, model: Model, rows: Array, s: LineSettings) -> LineData:
    """The lines of any input.

    Raises
    ------
    InputError
        Another type, channels or lines that do not fit the model, a record whose signal is not stated.
    """
    if isinstance(found, Spectra):
        return _of_spectra(found, model, rows, s)
    if isinstance(found, CrossSpectra):
        return _of_cross(found, model, rows, s)
    if isinstance(found, Record) or (isinstance(found, np.ndarray) and not np.iscomplexobj(found)):
        return _of_record(found, dt, model, rows, s)
    if isinstance(found, list | tuple) and found and all(isinstance(r, Record) for r in found):
        return _of_records(list(found), model, rows, s)
    raise InputError("this is no response that lines can be made of", where="estimate", found=type(found).__name__,
                     expected="loadid.Spectra, structures.CrossSpectra, a Record or a list of Records",
                     hint="loadid.Spectra(frequencies, values) wraps complex amplitudes")  # fmt: skip


def _of_spectra(found: Spectra, model: Model, rows: Array, s: LineSettings) -> LineData:
    f, keep = _inside(found.frequencies, s.band)
    columns = _columns([model.sensors[i].label for i in rows], found.labels, found.values.shape[1], len(model.sensors),
                       rows, found.name)  # fmt: skip
    X = found.values[keep][:, columns]
    noise = _stated(found.noise, keep, columns) if not s.noise.stated else _levels(s.noise.std, len(rows))
    power, known = _power(noise, X, [model.sensors[i] for i in rows])
    stated = s.noise.origin if s.noise.stated else NoiseSource.of(found.noise_source)
    source = stated or (STATED if known else NOT_KNOWN)
    return LineData(
        f, X[..., None], power, known, source, 1.0, "spectra", rows, tuple(model.sensors[i] for i in rows),
        {found.name: digest(found.frequencies, found.values)},
    )  # fmt: skip


def _of_cross(found: CrossSpectra, model: Model, rows: Array, s: LineSettings) -> LineData:
    labels = [model.sensors[i].label for i in rows]
    f, keep = _inside(found.frequencies, s.band)
    f, keep = _known_lines(model, f, keep)
    columns = _columns(labels, found.labels, len(found.channels), len(model.sensors), rows, "cross spectra")
    S = found.matrix[keep][:, columns][:, :, columns]
    noise = None if not s.noise.stated else _levels(s.noise.std, len(rows))
    X = _snapshots(S)
    own = np.sqrt(np.einsum("kss->ks", S).real)
    power, known = _power(noise, own, [model.sensors[i] for i in rows])
    source = (s.noise.origin or STATED) if known else NOT_KNOWN
    facts = {"averages": found.averages, "bandwidth": found.bandwidth, "window": found.window}
    return LineData(
        f, X, power, known, source, found.averages, "cross spectra", rows, tuple(model.sensors[i] for i in rows),
        {"cross spectra": digest(found.frequencies, found.matrix)}, findings=found.flags, facts=facts,
    )  # fmt: skip


def _of_record(found: Any, dt: float | None, model: Model, rows: Array, s: LineSettings) -> LineData:
    if isinstance(found, np.ndarray) and found.ndim == 2 and found.shape[1] == len(model.sensors) == len(rows):
        found = found[:, rows]  # columns without names are the sensors of the model in its order
    data = gather(found, dt, model, [int(i) for i in rows])
    if s.signal.kind is None:
        raise InputError("is the record a transient, or does it go on all the time?", where="signal",
                         found=repr(s.signal.kind), expected=" or ".join(map(repr, SIGNALS)),
                         hint="'stationary' averages windowed segments into cross spectra; 'transient' transforms the "
                         "whole record once, zero-padded, and gives the load history")  # fmt: skip
    if s.signal.kind == "stationary":
        return _averaged([data], model, s)
    return _of_transient(data, model, s)


def _of_records(found: list[Record], model: Model, rows: Array, s: LineSettings) -> LineData:
    if s.signal.kind != "stationary":
        raise InputError("several records at once are averaged", where="signal", found=repr(s.signal.kind),
                         expected="'stationary'", hint="estimate transients one by one")  # fmt: skip
    return _averaged([gather(r, None, model, [int(i) for i in rows]) for r in found], model, s)


def _averaged(data: list[Data], model: Model, s: LineSettings) -> LineData:
    first = data[0]
    found = cross_spectra(
        [d.values for d in data], first.dt, channels=first.channels, window=s.signal.window,
        segment=s.signal.segment, overlap=s.signal.overlap,
    )  # fmt: skip
    positive = found.lines(found.frequencies > 0)  # the mean has been removed
    noise = noises.resolve(s.noise, model, first)
    level = None
    if noise.known:
        _refuse_covariance(noise)
        level = np.sqrt(2 * first.dt) * noise.level
    line = _of_cross(positive, model, first.rows, replace(s, noise=Noise(level, noise.source)))
    inputs = {d.record.source or d.record.name or f"record {i + 1}": d.record.sha256 for i, d in enumerate(data)}
    flags = tuple(flag for d in data for flag in d.findings)
    findings = (*line.findings, *flags)
    return replace(line, inputs=inputs, findings=findings, channels=first.channels, **_origin(data))


def _of_transient(data: Data, model: Model, s: LineSettings) -> LineData:
    if not (model.sampled or model.gives("impulse_response")):
        return _of_banded(data, model, s)
    if s.band is not None:
        raise InputError("a history is made of all lines of its record", where="band", found=f"{s.band!r}"[:80],
                         expected="no band with signal='transient'",
                         hint="filter the record, or look at estimate.spectrum in the band")  # fmt: skip
    noise = noises.resolve(s.noise, model, data)
    _refuse_covariance(noise)
    samples, padded = len(data.values), padded_length(len(data.values))
    f = np.asarray(np.fft.rfftfreq(padded, data.dt), float)
    X = np.fft.rfft(data.values, padded, axis=0)
    power, known, source = np.tile(samples * noise.level**2, (len(f), 1)), noise.known, noise.source
    if not s.noise.stated and model.sampled:
        spectrum = model.noise_spectrum(f)
        if spectrum is not None:
            power, known = samples * spectrum[:, data.rows], True
            source = NoiseSource("residual", f"residual power of {sum(h.used for h in model.hits)} training hits")
    return LineData(
        f, X[..., None], power, known, source, 1.0, "transient", data.rows, data.channels,
        data.inputs, data, padded, None, data.findings, **_origin([data]),
    )  # fmt: skip


def _of_banded(data: Data, model: Model, s: LineSettings) -> LineData:
    """A transient on the lines that a table of FRFs has: its loads come out in that band."""
    noise = noises.resolve(s.noise, model, data)
    _refuse_covariance(noise)
    samples, own = len(data.values), model.frequencies
    if own is None or len(own) < FEWEST:
        raise InputError("a history takes a band of lines", where="signal", found="a table of too few lines",
                         expected=f"{FEWEST} lines or more")  # fmt: skip
    padded = _length(model, np.asarray(own, float), data)
    f = np.asarray(np.fft.rfftfreq(padded, data.dt), float)
    step = float(f[1])
    low, high = (float(own[0]), float(own[-1])) if s.band is None else _band(s.band)
    slack = 1e-6 * step
    at = np.flatnonzero((f >= max(low, own[0]) - slack) & (f <= min(high, own[-1]) + slack))
    if len(at) < FEWEST:
        raise InputError("no band of lines", where="band", found=f"{low:g} to {high:g} Hz", expected="lines within "
                         f"{own[0]:.6g} to {own[-1]:.6g} Hz, {FEWEST} or more")  # fmt: skip
    weight, edges = _tapered(f[at], f[-1], step)
    X = np.fft.rfft(data.values, padded, axis=0)
    energy = np.sum(np.abs(X) ** 2, axis=1)
    outside = float(1 - np.sum(weight**2 * energy[at]) / max(float(np.sum(energy)), np.finfo(float).tiny))
    part = BandPart(at, weight, edges, outside)
    ends = " and ".join(f"{e:.4g} Hz {end}" for e, end in zip(edges, ("below", "above"), strict=True) if e) or "no end"
    told = (
        f"tapered over {ends}; {outside:.1%} of the energy of the record is outside, and so is what the load does there"
    )
    return LineData(
        f[at], X[at][..., None], np.tile(samples * noise.level**2, (len(at), 1)), noise.known, noise.source, 1.0,
        "transient", data.rows, data.channels, data.inputs, data, padded, part, data.findings,
        {"history_band": f"{f[at[0]]:.6g} to {f[at[-1]]:.6g} Hz", "history_ends": told}, **_origin([data]),
    )  # fmt: skip


FEWEST = 8  # lines that make a history
EVEN = 1e-3  # of a line, by which two grids may differ over the band


def _length(model: Model, own: Array, data: Data) -> int:
    """Length of the transform whose lines the table has.

    Raises
    ------
    InputError
        Lines that are no multiples of one step; a record longer than the spacing of the lines resolves.
    """
    samples = len(data.values)
    if model.has_lines([0.5 * (own[0] + own[1])]).all() and model.has_lines(own).all():
        return padded_length(samples)
    step = float(np.median(np.diff(own)))
    length = round(1 / (step * data.dt))
    even = abs(length * step * data.dt - 1) * own[-1] / step <= EVEN and length % 2 == 0
    on_lines = np.abs(own / step - np.round(own / step)).max() <= EVEN and np.ptp(np.diff(own)) <= EVEN * step
    if not on_lines:
        raise InputError(
            "the lines of the table are not those of a transform", where="signal",
            found=f"lines from {own[0]:.6g} to {own[-1]:.6g} Hz, {step:.6g} Hz apart (median)",
            expected="lines at whole multiples of one step, 0 Hz among them or left out",
            hint="export the lines as the analyser has them, or FrfModel(..., interpolate=True) where they are dense "
            "beside the peaks",
        )  # fmt: skip
    if length < samples or not even:
        raise InputError(
            "the lines of the table are not those of a transform of this record", where="signal",
            found=f"lines every {step:.6g} Hz, a record of {samples * data.dt:.6g} s at {data.dt:.6g} s",
            expected=f"a record of at most {1 / step:.6g} s, whose step divides that time evenly",
            hint="take a part of the record that holds the event, or FrfModel(..., interpolate=True) where the lines "
            "are dense beside the peaks",
        )  # fmt: skip
    return length


def _tapered(f: Array, nyquist: float, step: float) -> tuple[NDArray[np.float64], tuple[float, float]]:
    """Weights of the lines of a band, and the widths of its tapers."""
    width = max(TAPERED * float(f[-1] - f[0]), 2 * step)
    low = max(min(width, float(f[0])), 2 * step) if f[0] > 1.5 * step else 0.0
    high = width if f[-1] < nyquist - 0.5 * step else 0.0
    weight = np.ones(len(f))
    if low:
        weight *= 0.5 - 0.5 * np.cos(np.pi * np.clip((f - f[0] + 0.5 * step) / low, 0, 1))
    if high:
        weight *= 0.5 - 0.5 * np.cos(np.pi * np.clip((f[-1] + 0.5 * step - f) / high, 0, 1))
    return weight, (low, high)


def _origin(data: list[Data]) -> dict[str, Any]:
    """Where records come from."""
    return {
        "fingerprints": frozenset().union(*(d.fingerprints for d in data)),
        "simulated_by": data[0].simulated_by,
    }


def response(model: Model, line: LineData) -> NDArray[np.complex128]:
    """FRF of the model at the lines, (lines, sensors of the model, loads): of a transient that of its sampled form."""
    if line.data is None or line.part_of is not None or model.sampled:
        return model.frf(line.frequencies)
    model.require("impulse_response")
    h = model.impulse_response(line.data.dt, line.padded // 2, model.default_hold)
    return np.fft.rfft(h, line.padded, axis=0)


# -- helpers ----------------------------------------------------------------------------------------------------------
def _inside(f: Array, band: tuple[float, float] | None) -> tuple[NDArray[np.float64], NDArray[np.int_]]:
    if band is None:
        return f, np.arange(len(f))
    band = _band(band)
    keep = np.flatnonzero((f >= band[0]) & (f <= band[1]))
    if not len(keep):
        raise InputError("no line in the band", where="band", found=f"lines {f[0]:.6g} to {f[-1]:.6g} Hz",
                         expected=f"lines in {band[0]:g} to {band[1]:g} Hz")  # fmt: skip
    return f[keep], keep


def _band(band: Any) -> tuple[float, float]:
    ends = reals(band, what="the band is no pair of numbers", where="band")
    if ends.shape != (2,) or not ends[0] <= ends[1]:
        raise InputError("the band is no pair of numbers", where="band", found=repr(band)[:80],
                         expected="(lowest, highest) in Hz")  # fmt: skip
    return float(ends[0]), float(ends[1])


def _known_lines(model: Model, f: Array, keep: Array) -> tuple[NDArray[np.float64], NDArray[np.int_]]:
    """Lines that a table of FRFs has; the others of an averaged spectrum are left out."""
    there, own = model.has_lines(f), model.frequencies
    if own is not None and not there.any():
        raise InputError("no line of the spectra is a line of the model", where="frequency lines",
                         found=f"spectra {f[0]:.6g} to {f[-1]:.6g} Hz, {len(f)} lines",
                         expected=f"some of the {len(own)} lines {own[0]:.6g} to {own[-1]:.6g} Hz",
                         hint="choose the segment, signal=Signal('stationary', segment=...), so that the line spacing "
                         "is that of the model")  # fmt: skip
    return f[there], keep[there]


def _columns(wanted: list[str], labels: tuple[str, ...], count: int, sensors: int, rows: Array, name: str) -> Array:
    """Columns of the spectra for the sensors that are used."""
    if labels and set(wanted) <= set(labels):
        return np.array([labels.index(w) for w in wanted])
    plain = not labels or all(label.startswith("channel ") for label in labels)
    if plain and count in (len(rows), sensors):
        return np.asarray(rows) if count == sensors else np.arange(len(rows))
    found = list(labels) if labels and not plain else f"{count} columns without names"
    raise InputError("the spectra have no channel for a sensor of the model", where=name, found=found,
                     expected=[w for w in wanted if w not in labels][:8],
                     hint=Advice("name the channels, or ", WITHOUT_SENSOR))  # fmt: skip


def _snapshots(S: Array) -> NDArray[np.complex128]:
    """Columns whose products with themselves sum up to the matrix of each line."""
    w, V = np.linalg.eigh(S)
    if np.any(w[:, 0] < -NEGATIVE * np.maximum(w[:, -1], 0)):
        k = int(np.argmin(w[:, 0] / np.maximum(w[:, -1], 1e-300)))
        raise InputError("a cross-spectral matrix has a negative eigenvalue: no responses have such spectra",
                         where="cross spectra", found=f"{w[k, 0]:.3g} beside {w[k, -1]:.3g} (line {k})",
                         expected="none below zero", hint="estimate all entries from the same segments")  # fmt: skip
    return np.asarray(V * np.sqrt(np.maximum(w, 0.0))[:, None, :])


def _levels(noise: ArrayLike, count: int) -> NDArray[np.float64]:
    level = reals(noise, what="the noise is no real number", where="noise")
    if level.shape not in ((), (count,)) or not np.all(np.isfinite(level)) or np.any(level <= 0):
        found = f"shape {level.shape}" if level.ndim else f"{float(level):g}"
        raise InputError("the noise does not fit the sensors", where="noise", found=found,
                         expected=f"positive: a number or ({count},)",
                         hint="a level for each line goes into Spectra(noise=)")  # fmt: skip
    return level


def _stated(noise: Any, keep: Array, columns: Array) -> NDArray[np.float64] | None:
    """Levels that the spectra carry, for the lines and columns that are used."""
    if noise is None or np.ndim(noise) == 0:
        return None if noise is None else np.asarray(plain(noise), float)
    level = np.asarray(plain(noise), float)[..., columns]
    return level[keep] if level.ndim == 2 else level


def _power(noise: Array | None, X: Array, sensors: list[Channel]) -> tuple[NDArray[np.float64], bool]:
    """Variance of the noise, or a scale: channels of one unit are taken as equally noisy."""
    if noise is not None:
        return np.broadcast_to(noise**2, X.shape).copy(), True
    units = [c.unit for c in sensors]
    size = np.mean(np.abs(X) ** 2, axis=0)
    scale = np.array([np.mean([v for v, u in zip(size, units, strict=True) if u == unit]) for unit in units])
    if np.any(scale == 0):
        silent = [c.label for c, v in zip(sensors, scale, strict=True) if v == 0]
        raise InputError("a kind of channel is zero throughout", where="spectra", found=silent, expected="a response",
                         hint="leave the channels out (sensors=[...])")  # fmt: skip
    return np.tile(scale, (len(X), 1)), False


def _refuse_covariance(noise: noises.NoiseLevel) -> None:
    if np.ndim(noise.level) == 2:
        raise InputError("lines take a noise std per sensor, not a covariance", where="noise", found="a matrix",
                         expected="a number or (sensors,)", hint="Deconvolution takes a covariance")  # fmt: skip
