"""Cross spectra of records by averaging windowed segments, and what window and overlap do to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._channels import Channel, named
from .._flags import Flag
from .._readonly import ReadOnly
from ..errors import InputError, as_array, finite, frozen, own_step, plain, whole
from ..errors import lines as checked_lines
from .spectra import leakage, multiplicity, transforms

SKEW = 1e-6  # of the two autospectra: rounding of single precision that a Hermitian matrix may show
ABOVE_ONE = 1e-4  # by how much rounding may lift a coherence above one
SEGMENTS = 8  # disjoint segments that a record is cut into where no length is given
DETREND = ("constant", "linear", None)


@dataclass(frozen=True, eq=False, repr=False)
class CrossSpectra(ReadOnly):
    """One-sided cross-spectral densities ``S_xy = E[X conj(Y)]`` of some channels.

    Parameters
    ----------
    frequencies : array, shape (lines,)
        Hz, ascending.
    matrix : array, shape (lines, channels, channels), complex
        Unit of row times unit of column, per Hz; Hermitian. The sign of time is exp(+i omega t), so that a response
        ``Y = H F`` has ``S_yy = H S_ff H^H``.
    channels : sequence of Channel or str
    averages : float
        Effective number of independent averages: an autospectrum has the standard deviation S / sqrt(averages).
        Infinity for spectra that are known exactly.
    window, overlap, segment
        How they were estimated; "" and 0 where that is not known.
    bandwidth : float
        Equivalent noise bandwidth of the window, Hz: detail finer than this is smoothed, and a sine of mean square P
        stands as a peak of P / bandwidth. 0 where it is not known.
    flags : tuple of Flag

    Raises
    ------
    InputError
        NaN, lines that do not ascend, a matrix that is not Hermitian, a negative autospectrum, a coherence above one.
    """

    frequencies: NDArray[np.float64]
    matrix: NDArray[np.complex128]
    channels: tuple[Channel, ...]
    averages: float
    window: str = ""
    overlap: float = 0.0
    segment: int = 0
    bandwidth: float = 0.0
    flags: tuple[Flag, ...] = field(default=())

    def __post_init__(self) -> None:
        f = checked_lines(self.frequencies)
        S = _finite(self.matrix)
        if S.ndim != 3 or S.shape[1] != S.shape[2] or len(S) != len(f) or not S.size:
            raise InputError(
                "lines and cross spectra do not fit",
                where="CrossSpectra",
                found=f"{len(f)} lines, matrix {S.shape}",
                expected="(lines, channels, channels)",
            )
        if np.any(np.diff(f) <= 0):
            raise InputError("the lines do not ascend", where="CrossSpectra", found="unsorted or doubled lines",
                             expected="Hz, ascending")  # fmt: skip
        if not self.averages > 0:
            raise InputError("no averages", where="CrossSpectra", found=f"averages={self.averages!r}",
                             expected="a positive number; inf where the spectra are exact")  # fmt: skip
        described = named(self.channels, S.shape[1], "channel ", "CrossSpectra")
        settled = {"frequencies": f, "matrix": _hermitian(S, described), "channels": described}
        settled |= {"averages": float(self.averages), "flags": tuple(self.flags)}
        for name, value in settled.items():
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        f = self.frequencies
        return (
            f"CrossSpectra({len(self.channels)} channels, {len(f)} lines, {f[0]:.6g} to {f[-1]:.6g} Hz, "
            f"{self.averages:.4g} averages)"
        )

    def __len__(self) -> int:
        return len(self.frequencies)

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the channels."""
        return tuple(c.label for c in self.channels)

    @property
    def autospectra(self) -> NDArray[np.float64]:
        """Densities (lines, channels), unit^2/Hz."""
        return np.diagonal(self.matrix, axis1=1, axis2=2).real

    @property
    def coherence(self) -> NDArray[np.float64]:
        """Ordinary coherence of every two channels, shape (lines, channels, channels); 0 where a channel is silent."""
        power = self.autospectra[:, :, None] * self.autospectra[:, None, :]
        return np.asarray(
            np.minimum(np.divide(np.abs(self.matrix) ** 2, power, out=np.zeros(power.shape), where=power > 0), 1.0)
        )

    def restricted(self, channels: Sequence[str | int | Channel]) -> Self:
        """The spectra of some channels, by label or index, in the order given.

        Raises
        ------
        InputError
            A channel that is not there, or named twice.
        """
        index = self.index(channels)
        return replace(self, matrix=self.matrix[:, index][:, :, index], channels=tuple(self.channels[i] for i in index))

    def index(self, channels: Sequence[str | int | Channel]) -> list[int]:
        """Columns of some channels; errors as `restricted`."""
        found = [self._column(c) for c in ([channels] if isinstance(channels, str | int | Channel) else channels)]
        if len(set(found)) < len(found) or not found:
            raise InputError(
                "a channel is named twice" if found else "no channel",
                where="CrossSpectra",
                found=[self.labels[i] for i in found],
                expected="each channel once",
            )
        return found

    def _column(self, channel: str | int | Channel) -> int:
        label = channel.label if isinstance(channel, Channel) else channel
        if label in self.labels:
            return self.labels.index(str(label))
        if not isinstance(label, int) or not -len(self.channels) <= label < len(self.channels):
            raise InputError(
                "no such channel",
                where="CrossSpectra",
                found=repr(label),
                expected=f"one of {list(self.labels)} or an index",
            )
        return label % len(self.channels)

    def lines(self, mask: ArrayLike) -> Self:
        """The spectra on some lines, by a mask (lines,) of truth values.

        Raises
        ------
        InputError
            A mask that does not fit, or that leaves no line.
        """
        keep = as_array(mask, where="mask")
        if keep.dtype != bool or keep.shape != self.frequencies.shape or not keep.any():
            raise InputError(
                "no mask of the lines",
                where="CrossSpectra",
                found=f"{keep.dtype} {keep.shape}, {int(np.sum(keep != 0))} lines kept",
                expected=f"truth values ({len(self)},), one of them true",
            )
        return replace(self, frequencies=self.frequencies[keep], matrix=self.matrix[keep])


def cross_spectra(
    values: Any,
    dt: float | None = None,
    *,
    channels: Sequence[Channel | str] | None = None,
    window: str | tuple[Any, ...] = "hann",
    segment: int | None = None,
    overlap: float = 0.5,
    detrend: str | None = "constant",
) -> CrossSpectra:
    """Cross-spectral densities of records by Welch's method.

    Parameters
    ----------
    values : array (samples, channels), or a record with ``values`` and ``dt``, or a list of either
        Several records are averaged segment by segment: each weighs as many segments as it gives.
    dt : float, optional
        Step in s of bare arrays.
    channels : sequence of Channel or str, optional
        Columns, where the records do not name them.
    window : str or tuple
        A window of `scipy.signal.get_window`.
    segment : int, optional
        Samples per segment; by default the power of two of which eight fit into the records, end to end.
    overlap : float
        Share of a segment that the next one repeats, 0 <= overlap < 1.
    detrend : ``"constant"``, ``"linear"`` or None
        What is taken off each segment.

    Returns
    -------
    CrossSpectra
        With a flag W508 where a transient is cut by the segments, a spectral line is narrower than they resolve, or
        a box window smears one line over the others.

    Raises
    ------
    InputError
        Records of different steps or channels, shorter than a segment, with NaN; a step or window that is none.

    Notes
    -----
    P. D. Welch, IEEE Trans. Audio Electroacoust. 15 (1967) 70-73. The mean of K segments, shifted by D samples, has
    the variance ``S^2/K (1 + 2 sum_m (1 - m/K) rho_m)`` with ``rho_m = (sum_n w_n w_{n + m D})^2 / (sum_n w_n^2)^2``;
    ``averages`` is what K would have to be without overlap. The lines at 0 Hz and at the Nyquist frequency are real
    and have half of them.
    """
    tables, step, described = gather(values, dt, channels)
    n = _segment(segment, tables)
    hop = n - _overlap(overlap, n)
    w = taper(window, n)
    if detrend not in DETREND:
        raise InputError("unknown detrend", where="cross_spectra", found=repr(detrend), expected=list(DETREND))
    total: NDArray[Any] = np.zeros((n // 2 + 1, len(described), len(described)), complex)
    counts = []
    for table in tables:
        counts.append(0)
        for X in transforms(table, w, hop, detrend):
            counts[-1] += len(X)
            lined = X.transpose(1, 2, 0)
            total += lined @ lined.conj().transpose(0, 2, 1)
    matrix = total * (multiplicity(n) * step / np.sum(w**2) / sum(counts))[:, None, None]
    return CrossSpectra(
        frequencies=np.fft.rfftfreq(n, step).astype(float),
        matrix=matrix.astype(complex),
        channels=described,
        averages=effective_averages(w, hop, counts),
        window=window if isinstance(window, str) else str(window),
        overlap=1 - hop / n,
        segment=n,
        bandwidth=noise_bandwidth(w, step),
        flags=leakage(tables, step, matrix, described, w, hop, detrend, effective_averages(w, hop, counts)),
    )


# -- windows and segments ---------------------------------------------------------------------------------------------
def taper(window: str | tuple[Any, ...], samples: int) -> NDArray[np.float64]:
    """Periodic window (samples,) of that name; a box for "boxcar" or "none".

    Raises
    ------
    InputError
        A name that is none.
    """
    from scipy.signal import get_window

    try:
        return np.asarray(get_window("boxcar" if window == "none" else window, samples), float)
    except (ValueError, TypeError, KeyError) as error:
        raise InputError(
            "no window of that name",
            where="window",
            found=f"{window!r} ({str(error)[:80]})",
            expected="hann, hamming, blackman, flattop, boxcar, ('tukey', 0.1), ...",
        ) from None


def noise_bandwidth(w: NDArray[Any], dt: float) -> float:
    """Equivalent noise bandwidth of a window, Hz: 1 / (samples dt) for a box, 1.5 of that for a Hann window."""
    return float(np.sum(w**2) / np.sum(w) ** 2 / dt)


def effective_averages(w: NDArray[Any], hop: int, counts: Sequence[int]) -> float:
    """Independent averages that records with `counts` segments are worth, each `hop` samples after the last (Welch)."""
    n = len(w)
    shifts = np.arange(hop, n, hop)
    rho = np.array([np.dot(w[:-m], w[m:]) for m in shifts]) ** 2 / np.sum(w**2) ** 2
    spread = sum(k + 2 * float(np.sum(rho[: k - 1] * (k - np.arange(1, len(rho) + 1)[: k - 1]))) for k in counts)
    return float(sum(counts) ** 2 / spread)


# -- what comes in ----------------------------------------------------------------------------------------------------
def gather(
    values: Any, dt: float | None, channels: Sequence[Channel | str] | None
) -> tuple[list[NDArray[np.float64]], float, tuple[Channel, ...]]:
    """Tables (samples, channels), their step and their channels.

    Raises
    ------
    InputError
        As `cross_spectra`.
    """
    several = isinstance(values, list | tuple) and all(
        hasattr(v, "values") or (hasattr(v, "shape") and np.ndim(v) > 0) for v in values
    )
    records = list(values) if several else [values]
    if not records:
        raise InputError("no records", where="cross_spectra", found="an empty list", expected="at least one")
    tables = [_table(r, i) for i, r in enumerate(records)]
    steps = [own_step(getattr(r, "dt", None), dt, f"record {i + 1}") for i, r in enumerate(records)]
    if max(steps) / min(steps) - 1 > 1e-6:
        raise InputError(
            "the records have different steps",
            where="cross_spectra",
            found=f"dt = {sorted(set(steps))} s",
            expected="one dt",
            hint="resample them",
        )
    told = [channels if channels is not None else getattr(r, "channels", None) for r in records]
    described = [named(t, x.shape[1], "channel ", "channels") for t, x in zip(told, tables, strict=True)]
    what = [[(c.label, c.quantity, c.unit) for c in d] for d in described]
    if any(w != what[0] for w in what):
        other = next(w for w in what if w != what[0])
        raise InputError(
            "the records have different channels",
            where="cross_spectra",
            found=f"{what[0]} and {other}"[:300],
            expected="the same channels, in the same order and units",
        )
    return tables, steps[0], described[0]


def _table(record: Any, i: int) -> NDArray[np.float64]:
    table = frozen(getattr(record, "values", record), f"record {i + 1}")
    table = table[:, None] if table.ndim == 1 else table
    if table.ndim != 2 or 0 in table.shape:
        raise InputError(
            "a record is a table", where=f"record {i + 1}", found=f"shape {table.shape}", expected="(samples, channels)"
        )
    return table


def _segment(segment: int | None, tables: Sequence[NDArray[Any]]) -> int:
    shortest, total = min(map(len, tables)), sum(map(len, tables))
    if segment is None:
        segment = min(1 << max(int(np.log2(max(total / SEGMENTS, 1))), 0), shortest)
    found = whole(segment)
    if found is None or not 4 <= found <= shortest:
        raise InputError(
            "no length of a segment",
            where="segment",
            found=f"{segment!r} samples",
            expected=f"an integer from 4 to {shortest}, the samples of the shortest record",
            hint="leave out short records, or take shorter segments" if found is not None and found > shortest else "",
        )
    return found


def _overlap(overlap: float, n: int) -> int:
    if not isinstance(overlap, int | float | np.number) or not 0 <= overlap < 1:
        raise InputError("no overlap", where="overlap", found=repr(overlap), expected="a share, 0 <= overlap < 1")
    return min(round(overlap * n), n - 1)


# -- what a matrix of spectra must be ---------------------------------------------------------------------------------
def _finite(matrix: Any) -> NDArray[np.complex128]:
    try:
        S = np.array(plain(matrix), complex)
    except (TypeError, ValueError) as error:
        raise InputError(
            "no numbers", where="CrossSpectra", found=str(error)[:200], expected="complex numbers"
        ) from None
    finite(S, where="CrossSpectra", hint="leave out the lines or channels that are not known")
    return S


def _hermitian(S: NDArray[Any], channels: Sequence[Channel]) -> NDArray[np.complex128]:
    """The matrix itself, exactly Hermitian and read-only, or a refusal that names the two channels."""
    auto = np.diagonal(S, axis1=1, axis2=2)
    if np.any(auto.real < 0):
        k, i = divmod(int(np.argmin(auto.real)), len(channels))
        raise InputError(
            "a negative autospectrum",
            where=f"CrossSpectra, {channels[i].label}",
            found=f"{auto[k, i].real:.4g} on line {k}",
            expected=">= 0",
        )
    size = np.sqrt(auto.real[:, :, None] * auto.real[:, None, :])
    skew = np.abs(S - S.conj().transpose(0, 2, 1))
    fault = skew > SKEW * size
    if np.any(fault):
        k, i, j = np.argwhere(fault)[0].tolist()
        raise InputError(
            "the cross spectra are not Hermitian",
            where=f"CrossSpectra, {channels[i].label} and {channels[j].label}",
            found=f"S_xy and conj(S_yx) differ by {skew[k, i, j]:.3g} on line {k}",
            expected=f"at most {SKEW:g} of their autospectra",
            hint="S_xy = E[X conj(Y)]: fill both triangles, the lower one with the conjugate",
        )
    above = np.abs(S) > (1 + ABOVE_ONE) * size
    if np.any(above):
        k, i, j = np.argwhere(above)[0].tolist()
        raise InputError(
            "a coherence above one",
            where=f"CrossSpectra, {channels[i].label} and {channels[j].label}",
            found=f"|S_xy| = {np.abs(S[k, i, j]):.4g} on line {k}",
            expected=f"at most sqrt(S_xx S_yy) = {size[k, i, j]:.4g}",
            hint="autospectra and cross spectra from the same segments, in the same units",
        )
    S = (S + S.conj().transpose(0, 2, 1)) / 2
    S.flags.writeable = False
    return S
