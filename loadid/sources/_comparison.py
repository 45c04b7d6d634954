"""Measured against synthesised responses: errors in dB by line, by band and over time, and their correlation."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._testing.spectra import multiplicity
from structures.errors import InputError, plain, positive

from .._results.estimate import Axis, LoadEstimate
from . import _levels as levels
from ._correlation import frac, trac
from ._levels import Bands, band_power, bands_of, widths
from ._synthesis import DENSITIES, HISTORIES, SPECTRA, kind_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


Real = NDArray[np.float64]
COVERED = 0.5  # share of a band that must be covered for its level to be called one


@dataclass(frozen=True, eq=False)
class BandLevels:
    """Levels of measured and synthesised responses in bands.

    Parameters
    ----------
    bands : Bands
    measured, synthesised : array, shape (bands, sensors)
        Root of the mean square in each band, in the unit of the sensor.
    error : array, shape (bands, sensors)
        Synthesised over measured, dB.
    coverage : array, shape (bands,)
        Share of each band that the lines cover.
    """

    bands: Bands
    measured: Real
    synthesised: Real
    error: Real
    coverage: Real


@dataclass(frozen=True, eq=False)
class ResponseComparison:
    """Measured and synthesised responses of the same sensors.

    Parameters
    ----------
    axis : Axis
        Lines (Hz) or samples (s).
    measured, synthesised : array, shape (lines, sensors)
        Complex amplitudes, densities or histories.
    kind : ``"spectra"``, ``"densities"`` or ``"histories"``
    sensors, units : tuple of str
        Labels; units of the sensors themselves (``m/s^2``), whatever the kind.
    std : array, shape (points, sensors), or None
        Standard deviation of the difference, at the entries `points` of the axis.
    points : array of int
    estimate : LoadEstimate, optional
        Whose load was synthesised.
    """

    axis: Axis
    measured: NDArray[Any]
    synthesised: NDArray[Any]
    kind: str
    sensors: tuple[str, ...]
    units: tuple[str, ...]
    std: Real | None = None
    points: NDArray[np.intp] = field(default_factory=lambda: np.empty(0, np.intp))
    estimate: LoadEstimate | None = field(default=None, repr=False)

    # -- one number per sensor ----------------------------------------------------------------------------------------
    @property
    def error(self) -> tuple[float, ...]:
        """Norm of the difference over the norm of the measured, per sensor; of densities of the densities."""
        top = np.abs(self.measured).max(axis=0)
        size = np.linalg.norm(self.measured / top, axis=0)
        return tuple((np.linalg.norm((self.synthesised - self.measured) / top, axis=0) / size).tolist())

    @property
    def overall(self) -> Real:
        """Overall level, synthesised over measured, dB per sensor; without 0 Hz."""
        m, s = (np.sum(x, axis=0) for x in self._line_powers())
        return np.asarray(levels.decibels(s[None], m[None])[0])

    @property
    def correlation(self) -> Real | None:
        """FRAC of spectra or TRAC of histories, per sensor; None for densities; 0 where zeros were synthesised."""
        if self.kind == DENSITIES:
            return None
        found = np.zeros(len(self.sensors))
        moves = np.any(self.synthesised != 0, axis=0)
        if moves.any():
            criterion = frac if self.kind == SPECTRA else trac
            found[moves] = criterion(self.measured[:, moves], self.synthesised[:, moves])
        return found

    # -- by line, by band, over time ----------------------------------------------------------------------------------
    @property
    def lines(self) -> Real:
        """Error of the autospectra in dB at each line, (lines, sensors); of histories at the lines of the whole record.

        Histories leave out 0 Hz and have as many lines as `frequencies`.
        """
        m, s = self._densities()
        return levels.decibels(s, m)

    @property
    def frequencies(self) -> Real:
        """Lines (Hz) of `lines`."""
        if self.kind != HISTORIES:
            return np.asarray(self.axis.values, float)
        return np.asarray(np.fft.rfftfreq(len(self.measured), self.axis.step)[1:], float)

    @property
    def rms_lines(self) -> Real:
        """Rms over the lines of their error in dB, per sensor."""
        return np.asarray(np.sqrt(np.mean(self.lines**2, axis=0)), float)

    @property
    def global_lines(self) -> Real:
        """Error of the autospectra in dB over all sensors at each line, weighted by the squared measured density.

        MIL-STD-810H, method 525; sensors of one unit only.

        Raises
        ------
        InputError
            Sensors of different units: their densities cannot be weighed against each other.
        """
        if len(set(self.units)) > 1:
            raise InputError(
                "a global error weighs densities of one unit", where="comparison", found=sorted(set(self.units)),
                expected="sensors of one unit", hint="compare the sensors of each unit apart, or read rms_lines",
            )  # fmt: skip
        return levels.weighted(self.lines, self._densities()[0])

    def bands(self, fraction: int = 3) -> BandLevels:
        """Levels in bands of a fraction of an octave that hold a line; 0 Hz is in none.

        Densities and histories keep their power at the edges of the bands (`band_power`); an amplitude is a tone.

        Raises
        ------
        InputError
            No such fraction, or no line above 0 Hz.
        """
        f, bands = self.frequencies, bands_of(self.frequencies, fraction)
        density = self.kind != SPECTRA and len(f) > 1
        m, s = (band_power(f, x, bands, density=density) for x in self._densities())
        # bands that no line lies in have no level
        held = np.any(m.power > 0, axis=1)
        kept = Bands(
            bands.fraction, bands.centres[held], bands.lower[held], bands.upper[held],
            tuple(n for n, h in zip(bands.names, held, strict=True) if h),
        )  # fmt: skip
        error = levels.decibels(s.power[held], m.power[held])
        return BandLevels(kept, np.sqrt(m.power[held]), np.sqrt(s.power[held]), error, m.coverage[held])

    def running(self, window: str | float = "fast") -> levels.RunningLevel:
        """Levels over time: ``"fast"``, ``"slow"``, or a centred window in s.

        Raises
        ------
        InputError
            Responses over frequency, or no such window.
        """
        if self.kind != HISTORIES:
            raise InputError(
                "only histories have a level over time", where="running", found=self.kind,
                expected="responses over time", hint="bands() compares spectra",
            )  # fmt: skip
        return levels.running_level(self.measured, self.synthesised, self.axis.step, window)

    # -- words and pictures -------------------------------------------------------------------------------------------
    def table(self, fraction: int = 1) -> str:
        """One line per sensor: overall error, correlation, error of each band."""
        banded, matching = self.bands(fraction), self.correlation
        name = {SPECTRA: "FRAC", HISTORIES: "TRAC"}.get(self.kind)
        head = ["sensor", "overall dB", "rms dB"] + ([name] if name else []) + [f"{n} Hz" for n in banded.bands.names]
        rows = [head]
        overall, rms = self.overall, self.rms_lines if self.kind != HISTORIES else self._band_rms()
        for i, label in enumerate(self.sensors):
            row = [label, f"{overall[i]:+.2f}", f"{rms[i]:.2f}"]
            row += [] if matching is None else [f"{matching[i]:.4f}"]
            row += [
                f"{e:+.2f}" + ("" if c >= COVERED else "*")
                for e, c in zip(banded.error[:, i], banded.coverage, strict=True)
            ]
            rows.append(row)
        wide = [max(len(r[k]) for r in rows) for k in range(len(head))]
        text = [
            "  ".join([r[0].ljust(wide[0]), *(x.rjust(w) for x, w in zip(r[1:], wide[1:], strict=True))]) for r in rows
        ]
        if np.any(banded.coverage < COVERED) and self.kind != SPECTRA:
            text.append(f"* the lines cover less than {COVERED:.0%} of this {banded.bands.title} band")
        return "\n".join(text)

    def __str__(self) -> str:
        worst = int(np.argmax(np.abs(self.overall)))
        matching = self.correlation
        text = f"{len(self.sensors)} sensor{'s' * (len(self.sensors) != 1)}: overall level off by at most "
        text += f"{abs(self.overall[worst]):.2f} dB ({self.sensors[worst]})"
        if matching is not None:
            k = int(np.argmin(matching))
            text += f", {'FRAC' if self.kind == SPECTRA else 'TRAC'} at least {matching[k]:.4f} ({self.sensors[k]})"
        return f"{text}\n{self.table()}"

    def plot(
        self,
        kind: str = "bands",
        *,
        sensor: int | str | None = None,
        fraction: int = 3,
        window: str | float = "fast",
        path: str | os.PathLike[str] | None = None,
        show: bool = False,
    ) -> Figure:
        """Picture of the comparison.

        Parameters
        ----------
        kind : ``"bands"`` or ``"running"``
            Responses with the error in dB by band; or levels over time.
        sensor : int or str, optional
            Only this one.
        fraction : int
            Of an octave.
        window : str or float
            As in `running`.
        path, show
            As in `LoadEstimate.plot`.
        """
        from .._plots.sources import draw_comparison

        return draw_comparison(self, kind, sensor=sensor, fraction=fraction, window=window, path=path, show=show)

    # -- inside -------------------------------------------------------------------------------------------------------
    def _densities(self) -> tuple[Real, Real]:
        """Powers at `frequencies`: of tones, or densities."""
        if self.kind == HISTORIES:
            count = multiplicity(len(self.measured))[1:, None] * self.axis.step / len(self.measured)
            m, s = (np.abs(np.fft.rfft(x, axis=0)[1:]) ** 2 * count for x in (self.measured, self.synthesised))
            return m, s
        if self.kind == SPECTRA:
            return np.abs(self.measured) ** 2, np.abs(self.synthesised) ** 2
        return np.asarray(self.measured, float), np.asarray(self.synthesised, float)

    def _line_powers(self) -> tuple[Real, Real]:
        """What adds to the mean square, line by line: tones, or densities times the width of their line; not 0 Hz."""
        m, s = self._densities()
        f = self.frequencies
        width = widths(f) if self.kind != SPECTRA and len(f) > 1 else np.ones(len(f))
        width = np.where(f > 0, width, 0.0)[:, None]
        return m * width, s * width

    def _band_rms(self) -> Real:
        """Rms of the third-octave errors of histories: single lines of one record scatter by 5 dB and more."""
        return np.asarray(np.sqrt(np.mean(self.bands(3).error ** 2, axis=0)), float)


def compare(
    measured: ArrayLike,
    synthesised: ArrayLike,
    *,
    frequencies: ArrayLike | None = None,
    dt: float | None = None,
    sensors: Sequence[str] | None = None,
    units: Sequence[str] | None = None,
) -> ResponseComparison:
    """Compare measured with synthesised responses.

    Parameters
    ----------
    measured, synthesised : array, shape (lines, sensors) or (lines,)
        Complex amplitudes or one-sided densities at `frequencies`, or histories at the step `dt`.
    frequencies : array, shape (lines,), optional
        Hz, ascending. Real numbers are then densities.
    dt : float, optional
        s. One of the two is given.
    sensors, units : sequence of str, optional

    Raises
    ------
    InputError
        Shapes that differ, NaN, neither or both of `frequencies` and `dt`, a sensor measured as zero throughout.
    """
    m, s = (np.asarray(plain(x)) for x in (measured, synthesised))
    m, s = (x[:, None] if x.ndim == 1 else x for x in (m, s))
    if m.shape != s.shape or m.ndim != 2 or not m.size or not (np.all(np.isfinite(m)) and np.all(np.isfinite(s))):
        raise InputError(
            "measured and synthesised responses do not fit", where="compare", found=f"shapes {m.shape}, {s.shape}",
            expected="two finite arrays (lines, sensors)", hint="cut both to the same lines or samples",
        )  # fmt: skip
    if (frequencies is None) == (dt is None):
        raise InputError(
            "over frequency or over time?", where="compare", found="both" if dt else "neither",
            expected="frequencies= or dt=", hint="histories have a step, spectra have lines",
        )  # fmt: skip
    names = tuple(sensors) if sensors is not None else tuple(f"sensor {i + 1}" for i in range(m.shape[1]))
    of = tuple(units) if units is not None else ("arbitrary",) * m.shape[1]
    if dt is not None:
        step = positive("the step", dt, where="compare", unit="s")
        axis, kind = Axis("time", "s", np.asarray(np.arange(len(m)) * step, float)), HISTORIES
    else:
        axis = Axis("frequency", "Hz", np.asarray(frequencies, float))
        kind = SPECTRA if "c" in (m.dtype.kind, s.dtype.kind) else DENSITIES
    return checked(axis, m, s, kind, names, of)


def compare_estimate(estimate: LoadEstimate) -> ResponseComparison:
    """Response that an estimate was made from, against the one that its load gives: its training sensors.

    Raises
    ------
    InputError
        The estimate carries no response over its axis.
    """
    predicted = estimate.predicted
    if estimate.response is None or predicted is None or estimate.axis is None:
        raise InputError(
            "the estimate carries no response", where="compare_estimate", found="no response or no axis",
            expected="a family that keeps it, over time or frequency", hint="compare(measured, synthesised, ...)",
        )  # fmt: skip
    kind = kind_of(estimate)
    if kind == DENSITIES and estimate.response.dtype.kind == "c":
        kind = SPECTRA  # a family that keeps amplitudes of its data
    units = [u.removeprefix("(").removesuffix(")^2/Hz") if kind == DENSITIES else u for u in estimate.sensor_units]
    return checked(
        estimate.axis, np.asarray(estimate.response), np.asarray(predicted), kind, estimate.sensors, units, estimate
    )


def checked(
    axis: Axis,
    measured: NDArray[Any],
    synthesised: NDArray[Any],
    kind: str,
    sensors: Sequence[str],
    units: Sequence[str],
    estimate: LoadEstimate | None = None,
    std: Real | None = None,
    points: NDArray[np.intp] | None = None,
) -> ResponseComparison:
    """A comparison whose parts fit together.

    Raises
    ------
    InputError
        Lines or names that do not fit, negative densities, a sensor measured as zero.
    """
    fits = len(axis.values) == len(measured) and len(sensors) == len(units) == measured.shape[1]
    if not fits or np.any(np.diff(axis.values) <= 0):
        raise InputError(
            "axis, names or units do not fit the responses", where="compare",
            found=f"{len(axis.values)} values of {axis.name}, {len(sensors)} sensors, {len(units)} units",
            expected=f"ascending, for {measured.shape}", hint="lines first, then sensors",
        )  # fmt: skip
    dead = [n for n, x in zip(sensors, measured.T, strict=True) if not np.any(x)]
    if dead or (kind == DENSITIES and min(measured.min(), synthesised.min()) < 0):
        raise InputError(
            "no level: zeros, or a negative density", where="compare", found=dead or "a negative density",
            expected="measured responses that moved", hint="leave dead sensors out",
        )  # fmt: skip
    none = np.empty(0, np.intp)
    return ResponseComparison(
        axis, measured, synthesised, kind, tuple(sensors), tuple(units), std, none if points is None else points,
        estimate,
    )  # fmt: skip
