"""From records of shaker tests, forces measured, to the arguments of a table of FRFs or of a measured model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._certificate import Certificate
from .._channels import Channel
from .._flags import Evidence, Flag
from .._model import convolved
from ..errors import InputError, digests
from . import kinds
from .frfs import FrfEstimate, channels_of, estimate
from .impact import SILENT, Hit, TrainingRecords
from .welch import CrossSpectra, cross_spectra, gather


def tabulated(
    records: Any,
    forces: Any,
    responses: Any,
    kind: str | None,
    least_coherence: float,
    estimator: str,
    cut: dict[str, Any],
) -> dict[str, Any]:
    """Arguments of `FrfModel`; parameters and errors as for `FrfModel.from_records`."""
    spectra = cross_spectra(records, **cut)
    return of_spectra(spectra, forces, responses, kind, least_coherence, estimator, cut["detrend"] is not None)


def of_spectra(
    spectra: CrossSpectra,
    forces: Any,
    responses: Any,
    kind: str | None,
    least_coherence: float,
    estimator: str,
    detrended: bool = False,
) -> dict[str, Any]:
    """Arguments of `FrfModel` from cross spectra; the line at 0 Hz is left out where the mean was taken off."""
    loads, sensors = channels_of(spectra, forces, responses)
    flags: list[Flag] = []
    if kind is not None:
        sensors, flags = kinds.rows(sensors, len(sensors), kinds.check(kind, "from_records"))
    if detrended and spectra.frequencies[0] == 0 and len(spectra) > 1:
        spectra = spectra.lines(spectra.frequencies > 0)
    found = estimate(spectra, loads, responses, estimator)
    clear = _clear(found, least_coherence)
    return {
        "frequencies": found.frequencies[clear],
        "H": found.H[clear],
        "variance": None if found.variance is None else found.variance[clear],
        "coherence": found.coherence[clear],
        "sensors": sensors,
        "loads": loads,
        "flags": (*found.flags, *flags, *_left_out(found, clear, len(spectra), least_coherence)),
    }


def full(
    records: Any, forces: Any, responses: Any, kind: str | None, estimator: str, cut: dict[str, Any]
) -> dict[str, Any]:
    """Arguments of `MeasuredModel`; parameters and errors as for `MeasuredModel.from_random`."""
    tables, dt, channels = gather(records, cut.pop("dt"), cut.pop("channels"))
    spectra = cross_spectra(tables, dt, channels=channels, **cut)
    if spectra.segment % 2:
        raise InputError(
            "segments of an odd length end below the Nyquist frequency",
            where="from_random",
            found=f"segment={spectra.segment}",
            expected="an even number of samples",
        )
    loads, sensors = channels_of(spectra, forces, responses)
    flags: list[Flag] = []
    if kind is not None:
        sensors, flags = kinds.rows(sensors, len(sensors), kinds.check(kind, "from_random"))
    found = estimate(spectra, loads, responses, estimator)
    kept = found.kept & ~((spectra.frequencies == 0) & (cut["detrend"] is not None))
    lost = ~kept & (spectra.frequencies > 0)
    if np.mean(lost) > SILENT:
        raise InputError(
            "the forces have no energy on many lines",
            where="from_random",
            found=f"{int(lost.sum())} of {len(lost)} lines",
            expected="broadband forces",
            hint="FrfModel.from_records takes the lines that are excited",
        )
    inner = kept[found.kept]
    multiplicity = np.where((spectra.frequencies == 0) | (spectra.frequencies == spectra.frequencies[-1]), 1.0, 2.0)
    power = _filled(found.residual[inner], kept) / (multiplicity * dt)[:, None]
    H = _filled(found.H[inner], kept)
    if not kept[0]:
        still = np.array([s.quantity in ("velocity", "acceleration") for s in sensors])
        H[0] = np.where(still[:, None], 0.0, H[0].real)
    y = spectra.index(responses)
    hits = [
        Hit(str(getattr(r, "name", "")) or f"run {i + 1}", True, "", float(np.abs(t[:, spectra.index(loads)]).max()),
            digests(t[:, y]))
        for i, (r, t) in enumerate(zip(_several(records, len(tables)), tables, strict=True))
    ]  # fmt: skip
    return {
        "frequencies": spectra.frequencies,
        "H": H,
        "variance": None if found.variance is None else _filled(found.variance[inner], kept),
        "coherence": _filled(found.coherence[inner], kept),
        "records": TrainingRecords(tuple(hits), spectra.segment, None if found.variance is None else power),
        "sensors": sensors,
        "loads": loads,
        "certificate": held_out(tables, dt, channels, spectra, loads, y, estimator, cut),
        "flags": (*found.flags, *flags),
    }


def held_out(
    tables: Sequence[NDArray[Any]],
    dt: float,
    channels: Sequence[Channel],
    spectra: CrossSpectra,
    loads: Sequence[Channel],
    responses: Sequence[int],
    estimator: str,
    cut: dict[str, Any],
) -> Certificate | None:
    """Certificate of each record predicted from the others, one record in two halves; None where it is too short.

    The response of the first half segment is left out: it answers to forces before the record.
    """
    from scipy import fft

    n, labels = spectra.segment, [spectra.labels[i] for i in responses]
    parts = list(tables)
    if len(parts) == 1:
        middle = len(parts[0]) // 2
        parts = [parts[0][:middle], parts[0][middle:]]
    if min(map(len, parts)) < 2 * n:
        return None
    predicted, measured = [], []
    for i, part in enumerate(parts):
        rest = cross_spectra([p for j, p in enumerate(parts) if j != i], dt, channels=channels, **{**cut, "segment": n})
        if len(loads) > 1 and rest.averages <= len(loads):
            return None
        found = estimate(rest, loads, responses, estimator)
        h = fft.irfft(_filled(found.H, found.kept), n, axis=0)[: n // 2]
        force = part[:, spectra.index(loads)]
        force = force - force.mean(axis=0)
        response = convolved(h, force)
        own = part[:, responses] - part[:, responses].mean(axis=0)
        predicted.append(response[n // 2 :])
        measured.append(own[n // 2 :])
    return Certificate.compare(
        np.concatenate(predicted),
        np.concatenate(measured),
        labels,
        source=f"{len(tables)} records, each predicted from the others"
        if len(tables) > 1
        else "two halves of a record, each predicted from the other",
    )


def _clear(found: FrfEstimate, least: float) -> NDArray[np.bool_]:
    """Lines on which some sensor has at least this coherence: at an antiresonance one sensor has none."""
    if not isinstance(least, int | float | np.number) or not 0 <= least < 1:
        raise InputError(
            "no coherence", where="least_coherence", found=repr(least), expected="a share, 0 <= least_coherence < 1"
        )
    clear = found.coherence.max(axis=1) >= least
    if not np.any(clear):
        raise InputError(
            "no line is coherent enough",
            where="least_coherence",
            found=f"at most {found.coherence.max():.3f}",
            expected=f">= {least}",
            hint="is the force the one that moves the structure?",
        )
    return np.asarray(clear)


def _left_out(found: FrfEstimate, clear: NDArray[Any], lines: int, least: float) -> list[Flag]:
    gone = lines - int(np.sum(clear))
    if not gone:
        return []
    why = f"no force excites them apart, or no coherence reaches {least:g}" if least else "no force excites them apart"
    return [
        Flag(
            "W211",
            Evidence("lines left out", float(gone), 0.0),
            f"{gone} of {lines} lines are not calibrated: {why}",
            "loads are identified on the other lines; excite these to know them",
        )
    ]


def _filled(x: NDArray[Any], kept: NDArray[np.bool_]) -> NDArray[Any]:
    """Values of the kept lines on all of them, those of the nearest kept line elsewhere."""
    index = np.flatnonzero(kept)
    middle = (index[1:] + index[:-1]) / 2
    return np.array(x[np.searchsorted(middle, np.arange(len(kept)))])


def _several(records: Any, count: int) -> Sequence[Any]:
    return records if isinstance(records, list | tuple) and len(records) == count else [records]
