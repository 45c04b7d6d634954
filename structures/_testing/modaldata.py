"""What a modal test gives to be fitted: FRFs of one kind on the lines of a band, with the std of their errors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._channels import Channel
from .._model import Model
from .._models.measured import MeasuredModel
from .._models.reduction import highpass
from .._models.tabulated import FrfModel
from ..errors import InputError
from . import kinds
from .impact import judge, unusable
from .modalfit import FrfBand
from .spectra import smooth_lines
from .welch import gather

LEAST = 16  # lines of a band
SMALL = 1e-6  # of the rms of an entry, below which its std is not believed
RINGING = 8  # samples of a hit's own length at the end of a record
BEFORE = 0.05  # share of an impulse response before its start that is what a band-limited one rings
OVER = 2.0  # times the variance that is taken off the power of lines outside the band
ORDER = {**kinds.ORDER, "strain": 0, "angle": 0}


def table_of(
    source: Any, forces: Any, responses: Any, dt: float | None, kind: str | None, segment: int | None
) -> Model:
    """FRFs of a source: a model as it is, records estimated."""
    if isinstance(source, Model):
        if source.frequencies is None:
            raise InputError("a model that has no lines of its own", where="identify_modes", found=repr(source)[:200],
                             expected="measured FRFs or records",
                             hint="FrfModel.of(model, lines) is its table")  # fmt: skip
        return source
    if forces is None or responses is None:
        raise InputError("which channels are forces?", where="identify_modes", found=f"{forces=}, {responses=}",
                         expected="forces= and responses= of records, or an FrfModel",
                         hint="FrfModel.from_frf(f, H, kind=...) takes arrays of FRFs")  # fmt: skip
    records = source if isinstance(source, list | tuple) else [source]
    several = isinstance(forces, list | tuple) and len(forces) > 1
    force = forces[0] if isinstance(forces, list | tuple) else forces
    if not several and _hammered(records, force, dt):
        heard = list(responses) if isinstance(responses, list | tuple) else [responses]
        made: Model = MeasuredModel.from_hits(list(records), dt=dt, force=force, responses=heard)
        return made
    return FrfModel.from_records(source, forces=forces, responses=responses, dt=dt, kind=kind, segment=segment)


def _hammered(records: Sequence[Any], force: str | int, dt: float | None) -> bool:
    """Whether the force of every record is one hit, and rest besides."""
    tables, _, channels = gather(list(records), dt, None)
    labels = [c.label for c in channels]
    column = labels.index(force) if force in labels else int(force) if isinstance(force, int) else None
    if column is None:
        raise InputError("no such channel", where="forces", found=repr(force), expected=f"one of {labels}")
    for t in tables:
        f = t[:, column] - np.median(t[:, column])
        quiet = np.zeros((len(f), 0))
        if unusable(f, quiet, []) or judge(f, quiet, []):
            return False
    return True


def of_own_length(table: Any, band: tuple[float, float] | None) -> tuple[Any, float]:
    """FRFs of hits on the lines of a transform as long as their records after the hit, and that length in s.

    Their padded spectra are those of an impulse response that was cut where the records end. On lines that fit a whole
    number of periods into it a cut moves no pole: it scales each residue, by one less what is left of the mode. Lines
    outside the band where the hits had no energy are left out first: their errors would leak into it.
    """
    hits = [hit for hit in table.hits if hit.used]
    known = [hit.after for hit in hits if hit.after is not None]
    if not table.sampled or not hits or len(known) < len(hits) or min(known) <= 4 * RINGING:
        return table, np.inf
    h = np.fft.irfft(table.H * _believed(table, band), axis=0)
    samples = min(min(known), len(h)) - RINGING
    before = int(BEFORE * samples)
    cut = h[:samples].copy()
    cut[-before:] += h[-before:]
    f = np.fft.rfftfreq(samples, table.dt)
    at = np.clip(np.searchsorted(table.frequencies, f), 0, len(table.frequencies) - 1)
    variance = None if table.variance is None else np.asarray(table.variance)[at]
    made = FrfModel(
        f, np.fft.rfft(cut, axis=0), sensors=table.sensors, loads=table.loads, variance=variance, flags=table.flags
    )
    return made, samples * table.dt


def _believed(table: Any, band: tuple[float, float] | None) -> NDArray[np.float64]:
    """Share (lines, sensors, loads) of each line that is no error (Wiener), and 1 within the band.

    With twice the variance taken off (Berouti et al., ICASSP 1979): where a hit has no energy its FRFs are many times
    those of the band and nothing but error, and a share of them by chance would leak into it.
    """
    if table.variance is None:
        return np.ones(table.H.shape)
    half = max(5, len(table.H) // 500)
    power = smooth_lines(np.abs(table.H) ** 2, half)
    share = np.clip(1 - OVER * smooth_lines(np.asarray(table.variance), half) / np.where(power > 0, power, 1.0), 0, 1)
    if band is not None:
        share[(table.frequencies >= band[0]) & (table.frequencies <= band[1])] = 1.0
    return share


def picked(table: Model, band: tuple[float, float] | None) -> FrfModel:
    """The lines of a band, as a table with their variance."""
    f = np.asarray(table.frequencies, float)
    low, high = (0.0, np.inf) if band is None else (float(band[0]), float(band[1]))
    within = (f > 0) & (f >= low) & (f <= high)
    if table.sampled:
        within &= f < f[-1]  # the last line of a transform is real
    if np.sum(within) < LEAST:
        raise InputError("too few lines in the band", where="identify_modes", found=f"{int(np.sum(within))} lines",
                         expected=f"at least {LEAST}",
                         hint=f"the FRFs run from {f[0]:.5g} to {f[-1]:.5g} Hz")  # fmt: skip
    f = f[within]
    return FrfModel(
        f, table.frf(f), sensors=table.sensors, loads=table.loads, variance=table.frf_variance(f), flags=table.flags
    )


def orders(sensors: Sequence[Channel]) -> NDArray[np.int64]:
    """How often each sensor's reading is derived from a displacement."""
    unknown = next((s for s in sensors if s.quantity not in ORDER), None)
    if unknown is not None:
        raise InputError(
            "receptance, mobility or accelerance?", where=f"channel {unknown.label}", found=unknown.quantity,
            expected="displacement, velocity, acceleration or strain", code="LID-W208",
            hint="state the quantity of the channel, or FrfModel.from_frf(f, H, kind=...)",
        )  # fmt: skip
    return np.array([ORDER[s.quantity] for s in sensors])


def prepared(table: FrfModel, length: float = np.inf) -> tuple[FrfBand, bool, bool]:
    """FRFs of one kind with their std, whether loads were taken for outputs, and whether the std was known.

    `length` is that of their impulse response in s, where it was cut.
    """
    own, f = orders(table.sensors), table.frequencies
    common = int(np.bincount(own).argmax())
    corner = np.array([s.highpass or 0.0 for s in table.sensors])
    factor = (2j * np.pi * f[:, None]) ** (common - own) / highpass(f, corner)
    H = table.H * factor[:, :, None]
    rms = np.sqrt(np.mean(np.abs(H) ** 2, axis=0))
    rms = np.where(rms > 0, rms, rms.max())
    known = table.variance is not None and bool(np.any(table.variance > 0))
    if known:
        power = smooth_lines(np.asarray(table.variance), 3) * np.abs(factor[:, :, None]) ** 2
        std = np.sqrt(np.maximum(power, (SMALL * rms) ** 2))
    else:
        std = np.broadcast_to(rms, H.shape)
    turned = H.shape[2] > H.shape[1]
    if turned:
        H, std = H.transpose(0, 2, 1), std.transpose(0, 2, 1)
    return FrfBand(f, H, np.array(std), common, length), turned, known
