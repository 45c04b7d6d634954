"""FRFs from cross spectra or shaker records with measured forces: H1, H2, Hv, Hs, coherence, variance; their tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._certificate import Certificate
from .._channels import Channel
from .._flags import Evidence, Flag
from .._model import convolved
from ..errors import InputError, NotIdentifiable, digests
from . import kinds
from .impact import DRIVES, SILENT, Hit, TrainingRecords, check_quantities
from .welch import CrossSpectra, cross_spectra, gather

ESTIMATORS = ("H1", "H2", "Hv", "Hs")
SINGULAR = 1e-8  # smallest eigenvalue of the forces' coherence matrix, below which two forces are one
TOGETHER = 100.0  # times by which correlated forces may raise a variance: 0.99 of one force follows from the others
MANY = 0.05  # share of the lines on which they may
LOST = 0.5  # share of the lines on which forces may be one before the whole test is refused
POWERLESS = 1e-24  # of its largest power, below which a force is what rounding leaves of it on a line


@dataclass(frozen=True, eq=False)
class FrfEstimate:
    """FRFs estimated from cross spectra, and how well they are known.

    Parameters
    ----------
    frequencies : array, shape (lines,)
        Hz: the lines on which the forces excite and differ.
    H : array, shape (lines, sensors, loads), complex
    variance : array like H, or None
        E|error|^2 by the noise that the segments show; None where there are no more averages than loads.
    coherence : array, shape (lines, sensors)
        Multiple coherence: the share of the response that the forces explain together.
    ordinary : array, shape (lines, sensors, loads)
        Ordinary coherence of a response with each force.
    residual : array, shape (lines, sensors)
        Density of what the forces do not explain, unit^2/Hz, degrees of freedom allowed for.
    inflation : array, shape (lines, loads)
        How many times larger the variance is than with forces that are not correlated.
    kept : array of bool, shape (lines of the spectra,)
    flags : tuple of Flag
    """

    frequencies: NDArray[np.float64]
    H: NDArray[np.complex128]
    variance: NDArray[np.float64] | None
    coherence: NDArray[np.float64]
    ordinary: NDArray[np.float64]
    residual: NDArray[np.float64]
    inflation: NDArray[np.float64]
    kept: NDArray[np.bool_]
    flags: tuple[Flag, ...]


@dataclass(frozen=True, eq=False)
class _Blocks:
    """Cross spectra S_ff (lines, loads, loads), S_yf, and S_yy (lines, sensors) on the diagonal, of `averages`."""

    S_ff: NDArray[Any]
    S_yf: NDArray[Any]
    S_yy: NDArray[Any]
    averages: float

    @property
    def freedom(self) -> float:
        """Averages that are left when each response has been fitted with one number per load."""
        return float(self.averages - self.S_ff.shape[1])


def estimate(
    spectra: CrossSpectra,
    loads: Sequence[str | int | Channel],
    sensors: Sequence[str | int | Channel],
    estimator: str = "H1",
) -> FrfEstimate:
    """FRFs of sensors over loads from their cross spectra.

    Parameters
    ----------
    spectra : CrossSpectra
    loads, sensors : sequence of labels, indices or channels
        The measured forces, and the responses.
    estimator : ``"H1"``, ``"H2"``, ``"Hv"`` or ``"Hs"``
        H1 is not biased by noise in the responses, H2 not by noise in the forces (one force, or as many sensors as
        forces). Hv allows for noise in both, in proportion to their powers on each line: for one force it is the
        geometric mean of H1 and H2. Hs takes the noise of every channel as its ``noise`` says.

    Raises
    ------
    InputError
        An estimator that is none, a channel that is not there or is force and response at once, a force without
        energy, H2 with other numbers of sensors than forces, Hs without the noise of every channel.
    NotIdentifiable
        Code LID-E212: fewer averages than forces, or forces that are one on most lines.

    Notes
    -----
    ``S_xy = E[X conj(Y)]``, so that ``H1 = S_yf S_ff^-1``. With n effective averages and p forces, what the forces
    leave of sensor i has the density ``r_i = n/(n - p) S_ii (1 - g_i)``, g_i the multiple coherence, and
    ``var H_ij = r_i (S_ff^-1)_jj / n`` (Bendat & Piersol, Random Data, 4th ed., 2010, sections 7.4 and 9.3; Brillinger,
    Time Series, 1981, theorem 8.5.1; exact for independent segments and given forces). H2 is the inverse of the
    regression of the forces on the responses, and its variance follows from that one's to first order. Hv and Hs are
    total least squares (Rocklin, Crowley & Vold, IMAC III, 1985; Wicks & Vold, IMAC IV, 1986), with the first-order
    variance of an eigenvector, ``sum_k l_k l_0 / (n (l_k - l_0)^2)`` (Brillinger, theorem 9.4.3).
    """
    if estimator not in ESTIMATORS:
        raise InputError("unknown estimator", where="estimator", found=repr(estimator), expected=list(ESTIMATORS))
    f, y = spectra.index(loads), spectra.index(sensors)
    if set(f) & set(y):
        both = [spectra.labels[i] for i in f if i in y]
        raise InputError("force and response at once", where="channels", found=both, expected="different channels")
    S = spectra.matrix
    S_ff = S[:, f][:, :, f]
    names = [spectra.labels[i] for i in f]
    excited = _excited(S_ff, names)
    kept, inflation, flags = _apart(S_ff, excited, names, spectra.averages)
    S_kept = S[kept]
    blocks = _Blocks(S_ff[kept], S_kept[:, y][:, :, f], S_kept[:, y, y].real, float(min(spectra.averages, 1e15)))
    H1, inverse = _regression(blocks)
    explained = np.einsum("kij,kij->ki", H1, blocks.S_yf.conj()).real
    quiet = blocks.S_yy <= 0
    coherence = np.where(quiet, 0.0, np.clip(explained / np.where(quiet, 1.0, blocks.S_yy), 0.0, 1.0))
    if estimator == "H1":
        H, spread = H1, _variance_h1(blocks, coherence, inverse)
    elif estimator == "H2":
        H, spread = _h2(blocks, S_kept[:, y][:, :, y], coherence)
    else:
        noise = None if estimator == "Hv" else _noise([spectra.channels[i] for i in (*f, *y)])
        H, spread = _total(blocks, coherence, noise)
    power = np.einsum("kjj->kj", blocks.S_ff).real
    ordinary = np.abs(blocks.S_yf) ** 2 / (np.where(quiet, 1.0, blocks.S_yy)[:, :, None] * power[:, None, :])
    return FrfEstimate(
        frequencies=spectra.frequencies[kept],
        H=H,
        variance=spread,
        coherence=coherence,
        ordinary=np.minimum(ordinary, 1.0),
        residual=_residual(blocks, H),
        inflation=inflation,
        kept=kept,
        flags=(*spectra.flags, *flags),
    )


# -- the forces -------------------------------------------------------------------------------------------------------
def _excited(S_ff: NDArray[Any], names: Sequence[str]) -> NDArray[np.bool_]:
    """Lines (lines,) on which every force has energy."""
    power = np.einsum("kjj->kj", S_ff).real
    top = power.max(axis=0)
    excited = np.all(power > POWERLESS * top, axis=1) & bool(np.all(top > 0))
    if not np.any(excited):
        raise InputError(
            "a force has no energy on any line that the others excite",
            where="loads",
            found=[n for n, t in zip(names, top, strict=True) if t == 0] or names,
            expected="forces that excite the same band",
            hint="leave a silent force out",
        )
    return np.asarray(excited)


def _apart(
    S_ff: NDArray[Any], excited: NDArray[Any], names: Sequence[str], averages: float
) -> tuple[NDArray[np.bool_], NDArray[np.float64], list[Flag]]:
    """Lines on which the forces differ, the inflation of the variance there, and W212 where they nearly do not."""
    count = S_ff.shape[1]
    if count > 1 and averages < count:
        raise NotIdentifiable(
            f"{averages:.3g} averages do not tell {count} forces apart ({', '.join(names)})",
            advice="shorter segments, a longer record, or a record of each force on its own",
            code="LID-E212",
        )
    C, _ = _unit(S_ff)
    values, vectors = np.linalg.eigh(C)
    lowest = values[:, 0]
    kept = excited & (lowest > SINGULAR)
    if np.sum(kept) <= (1 - LOST) * np.sum(excited):
        line = int(np.argmin(np.where(excited, lowest, np.inf)))
        together = [n for n, v in zip(names, np.abs(vectors[line, :, 0]), strict=True) if v > 0.3]
        raise NotIdentifiable(
            f"the forces {', '.join(together)} are one: smallest eigenvalue of their coherence matrix "
            f"{max(lowest[line], 0.0):.2g} (threshold {SINGULAR:g}) on {int(np.sum(excited & ~kept))} of "
            f"{int(np.sum(excited))} lines",
            advice="drive the shakers with independent signals, or take one record per force",
            code="LID-E212",
        )
    inflation = np.einsum("kjm,km->kj", np.abs(vectors[kept]) ** 2, 1 / values[kept])
    share = float(np.mean(inflation.max(axis=1) > TOGETHER))
    flags = []
    if share > MANY:
        flags.append(
            Flag(
                "W212",
                Evidence("share of lines with nearly equal forces", share, MANY),
                f"on {share:.0%} of the lines a force follows from the others to 1 %: its FRF is uncertain "
                f"{np.sqrt(np.median(inflation.max(axis=1))):.0f} times more than with independent forces",
            )
        )
    return kept, inflation, flags


def _unit(S: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Spectral matrix with unit diagonal, and the scale (lines, channels) that makes it so; silent channels stay 0."""
    power = np.einsum("kjj->kj", S).real
    d = np.divide(1.0, np.sqrt(power), out=np.zeros(power.shape), where=power > 0)
    return d[:, :, None] * S * d[:, None, :], d


# -- the estimators ---------------------------------------------------------------------------------------------------
def _regression(b: _Blocks) -> tuple[NDArray[Any], NDArray[Any]]:
    """H1 (lines, sensors, loads) and the diagonal (lines, loads) of the inverse of S_ff."""
    C, d = _unit(b.S_ff)
    values, V = np.linalg.eigh(C)
    scaled = d[:, :, None] * V  # S_ff^-1 = scaled diag(1/values) scaled^H
    H1 = ((b.S_yf @ scaled) / values[:, None, :]) @ scaled.conj().transpose(0, 2, 1)
    return H1, np.einsum("kjm,km->kj", np.abs(scaled) ** 2, 1 / values)


def _variance_h1(b: _Blocks, coherence: NDArray[Any], inverse: NDArray[Any]) -> NDArray[Any] | None:
    if b.freedom <= 0:
        return None
    return np.asarray((b.S_yy * (1 - coherence))[:, :, None] * inverse[:, None, :] / b.freedom)


def _h2(b: _Blocks, S_yy: NDArray[Any], coherence: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any] | None]:
    """H2 and its variance: per sensor for one force, else for as many sensors as forces."""
    sensors, count = b.S_yf.shape[1:]
    if count == 1:
        cross = b.S_yf[..., 0].conj()
        known = np.abs(cross) > 0
        H = np.where(known, b.S_yy / np.where(known, cross, 1.0), 0.0)[..., None]
        if b.freedom <= 0:
            return H, None
        g = np.maximum(coherence, np.finfo(float).tiny)[..., None]
        return H, np.abs(H) ** 2 * np.where(known[..., None], (1 - g) / g, 0.0) / b.freedom
    if sensors != count:
        raise InputError(
            "H2 of several forces needs as many sensors",
            where="estimator",
            found=f"{sensors} sensors, {count} forces",
            expected="the same number of both, or one force",
            hint="estimator='Hv', or H2 for some sensors at a time",
        )
    C, d = _unit(S_yy)
    smallest = np.linalg.eigvalsh(C)[:, 0]
    if b.averages < sensors or np.any(smallest <= SINGULAR):
        raise NotIdentifiable(
            f"the responses do not tell the forces apart: smallest eigenvalue of their coherence matrix "
            f"{max(float(smallest.min()), 0.0):.2g} (threshold {SINGULAR:g}), {b.averages:.3g} averages",
            advice="other sensors, or estimator='H1'",
            code="LID-E212",
        )
    S_fy = b.S_yf.conj().transpose(0, 2, 1)
    # H S_fy = S_yy, solved with the scales of the responses taken out
    scaled = S_fy * d[:, None, :]
    H = np.linalg.solve(scaled.transpose(0, 2, 1), (S_yy * d[:, None, :]).transpose(0, 2, 1)).transpose(0, 2, 1)
    if b.freedom <= 0:
        return H, None
    values, V = np.linalg.eigh(C)
    root = (d[:, :, None] * V / np.sqrt(values)[:, None, :]).conj().transpose(0, 2, 1)  # root^H root = S_yy^-1
    explained = S_fy @ root.conj().transpose(0, 2, 1)
    left = b.S_ff - explained @ explained.conj().transpose(0, 2, 1)  # what the responses leave of the forces
    out = np.einsum("kia,kab,kib->ki", H, left, H.conj()).real
    return H, np.maximum(out, 0.0)[:, :, None] * np.sum(np.abs(root @ H) ** 2, axis=1)[:, None, :] / b.freedom


def _total(b: _Blocks, coherence: NDArray[Any], noise: NDArray[Any] | None) -> tuple[NDArray[Any], NDArray[Any] | None]:
    """Total least squares of each sensor on the forces, scaled by their powers or by the noise (loads + sensors,)."""
    lines, sensors, count = b.S_yf.shape
    H = np.zeros(b.S_yf.shape, complex)
    spread = np.zeros(b.S_yf.shape)
    M = np.zeros((lines, count + 1, count + 1), complex)
    M[:, :count, :count] = b.S_ff
    for i in range(sensors):
        M[:, count, :count], M[:, count, count] = b.S_yf[:, i], b.S_yy[:, i]
        M[:, :count, count] = b.S_yf[:, i].conj()
        if noise is None:
            Z, d = _unit(M)
        else:
            d = np.broadcast_to(1 / noise[[*range(count), count + i]], (lines, count + 1))
            Z = d[:, :, None] * M * d[:, None, :]
        values, V = np.linalg.eigh(Z)
        u, own = V[:, :, 0], V[:, count, 0]
        known = (np.abs(own) > 1e-12) & (b.S_yy[:, i] > 0)
        own = np.where(known, own, 1.0)
        ratio = np.where(known[:, None], d[:, :count] / np.where(known, d[:, count], 1.0)[:, None], 0.0)
        H[:, i] = -ratio * (u[:, :count] / own[:, None]).conj()
        gap = values[:, 1:] - values[:, :1]
        moved = values[:, 1:] * values[:, :1] / np.where(gap > 0, gap, np.inf) ** 2
        turn = V[:, :count, 1:] / own[:, None, None] - (u[:, :count] / own[:, None] ** 2)[:, :, None] * V[:, count:, 1:]
        spread[:, i] = ratio**2 * np.einsum("kjm,km->kj", np.abs(turn) ** 2, np.maximum(moved, 0.0))
    if b.freedom <= 0:
        return H, None
    if noise is None and count == 1:  # the powers that scale are of the same data: the modulus varies less
        spread = spread * (1 + coherence[:, :, None]) / 2
    return H, spread / b.freedom


def _noise(channels: Sequence[Channel]) -> NDArray[np.float64]:
    silent = [c.label for c in channels if c.noise is None]
    if silent:
        raise InputError(
            "Hs needs the noise of every channel",
            where="estimator",
            found=f"no noise of {', '.join(silent[:8])}",
            expected="Channel(noise=) of every force and response",
            hint="estimator='Hv' where it is not known",
        )
    return np.array([c.noise for c in channels], float)


def _residual(b: _Blocks, H: NDArray[Any]) -> NDArray[np.float64]:
    """Density (lines, sensors) of Y - H F, with the freedom that the fit took allowed for."""
    cross = np.einsum("kij,kij->ki", H, b.S_yf.conj()).real
    quadratic = np.einsum("kij,kjm,kim->ki", H, b.S_ff, H.conj()).real
    return np.asarray(
        np.maximum(b.S_yy - 2 * cross + quadratic, 0.0) * (b.averages / b.freedom if b.freedom > 0 else 1.0)
    )


# -- records ----------------------------------------------------------------------------------------------------------
def channels_of(spectra: CrossSpectra, forces: Any, responses: Any) -> tuple[tuple[Channel, ...], tuple[Channel, ...]]:
    """Channels of the forces (or of the voltages that drive shakers) and of the responses, of quantities they can have.

    Raises
    ------
    InputError
        A channel that is not there, a force that is no force, a response that is one.
    """
    loads = tuple(spectra.channels[i] for i in spectra.index(forces))
    sensors = tuple(spectra.channels[i] for i in spectra.index(responses))
    for load in loads:
        check_quantities((load, *sensors), DRIVES)
    return loads, sensors


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
