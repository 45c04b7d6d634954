"""What every load adds to the response of every sensor: contributions, their shares, and who is first."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._channels import Channel
from structures._model import Model
from structures._testing.spectra import multiplicity
from structures.errors import InputError

from .._results.estimate import Axis, LoadEstimate
from . import _synthesis as synthesis
from ._levels import FLOOR, BandPower, Bands, band_power, bands_of, widths
from ._synthesis import DENSITIES, HISTORIES, SPECTRA, Paths

if TYPE_CHECKING:
    from matplotlib.figure import Figure


Real = NDArray[np.float64]
DOUBT = 0.5  # std of the contributions over the contributions, from which on a line is called uncertain
NOTHING = 1e-3  # share below which a load is not listed in words
AGAINST = -1.0  # dB between the whole and the sum of its parts from which on loads are said to cancel


@dataclass(frozen=True, eq=False)
class Shares:
    """Shares of the loads in the response of the sensors, for each band, or for all lines together.

    Parameters
    ----------
    bands : Bands or None
        None: one row for the whole.
    share : array, shape (bands, sensors, loads)
        Mean square of the response to each load alone, over the sum of these: 0 to 1, adds to 1.
    in_phase : array, shape (bands, sensors, loads)
        Part of each load in the mean square of the whole response: adds to 1, negative where a load works against it.
    uncertain : array, shape (bands, sensors, loads), or None
        Share that the std of a load would make without any load; a share near it is noise.
    rms : array, shape (bands, sensors)
        Of the whole response, in the unit of each sensor; of complex amplitudes the root of their summed squares.
    interference : array, shape (bands, sensors)
        Mean square of the whole over the sum of the parts, dB: 0 for loads that do not correlate, -inf never.
    coverage : array, shape (bands, sensors)
        Share of each band that lines cover which count; 0 for a single line.
    """

    bands: Bands | None
    share: Real
    in_phase: Real
    uncertain: Real | None
    rms: Real
    interference: Real
    coverage: Real


@dataclass(frozen=True, eq=False)
class Contributions:
    """Response of every sensor to each load alone.

    Parameters
    ----------
    axis : Axis
        Lines (Hz) or samples (s).
    values : array, shape (lines, sensors, loads)
        Complex amplitudes; one-sided densities (unit^2/Hz) from the autospectra; or histories.
    total : array, shape (lines, sensors)
        Response to all loads: the sum of the amplitudes or histories; ``H S_ff H^H`` of densities.
    projected : array, shape (lines, sensors, loads)
        Part of each load in the power of the whole: ``Re(y_j conj(y))``, or ``Re(h_j (S_ff h^H)_j)``; of histories
        the product with the whole. Adds to the power of the whole.
    std : array, shape (points, sensors, loads), or None
        Standard deviation from that of the loads, at the entries `points` of the axis.
    total_std : array, shape (points, sensors), or None
    kind : ``"spectra"``, ``"densities"`` or ``"histories"``
    sensors, loads : tuple of Channel
    points : array of int
        All lines; some samples of a history.
    measured : tuple of array or None
        What was measured at each sensor, (lines,), where the estimate carries it.
    trusted : array of bool, shape (lines, sensors), or None
        Lines that count in the shares of a sensor; None is all.
    estimate : LoadEstimate
    """

    axis: Axis
    values: NDArray[Any]
    total: NDArray[Any]
    projected: Real
    std: Real | None
    total_std: Real | None
    kind: str
    sensors: tuple[Channel, ...]
    loads: tuple[Channel, ...]
    points: NDArray[np.intp] = field(default_factory=lambda: np.empty(0, np.intp))
    measured: tuple[NDArray[Any] | None, ...] = ()
    trusted: NDArray[np.bool_] | None = None
    estimate: LoadEstimate | None = field(default=None, repr=False)

    # -- numbers ------------------------------------------------------------------------------------------------------
    @property
    def units(self) -> tuple[str, ...]:
        """Units of the values, one per sensor."""
        return tuple(synthesis.unit_of(c.unit, self.kind) for c in self.sensors)

    @property
    def coherent(self) -> Real | None:
        """What loads that act together add to (or take from) the sum of the densities, (lines, sensors)."""
        return self.total - self.values.sum(axis=2) if self.kind == DENSITIES else None

    def shares(self, fraction: int | None = None) -> Shares:
        """Share of each load in the power, in bands of a fraction of an octave or (None) over all lines.

        Histories are taken to the lines of their whole record, so that the bands add to its mean square without the
        mean itself; amplitudes and densities as they are, 0 Hz left out of every band.

        Raises
        ------
        InputError
            No such fraction, or no line above 0 Hz.
        """
        p = _powers(self)
        counted = np.ones(p.whole.shape) if self.trusted is None else self.trusted.astype(float)
        parts = [x * (counted if x.ndim == 2 else counted[..., None]) for x in p.parts]
        if fraction is None:
            width = _widths(p.frequencies, p.density)
            return _shares(None, None, p.known, *(np.tensordot(width, x, axes=1)[None] for x in parts))
        bands = bands_of(p.frequencies, fraction)
        found = [band_power(p.frequencies, x, bands, density=p.density) for x in parts]
        strips = band_power(p.frequencies, counted, bands, density=True) if len(counted) > 1 else None
        return _shares(bands, strips, p.known, *(x.power for x in found))

    def ranking(self, sensor: int | str | None = None) -> tuple[tuple[str, float], ...]:
        """Loads with their share in the power, largest first; without a sensor the mean over all of them.

        Raises
        ------
        InputError
            No such sensor.
        """
        share = self.shares().share[0]
        row = share.mean(axis=0) if sensor is None else share[self.index(sensor)]
        best = np.argsort(-row, kind="stable")
        return tuple((self.loads[j].label, float(row[j])) for j in best)

    def index(self, sensor: int | str) -> int:
        """Column of a sensor, by index or label.

        Raises
        ------
        InputError
            There is none.
        """
        return synthesis.row_of(sensor, [c.label for c in self.sensors])

    # -- words and pictures -------------------------------------------------------------------------------------------
    def table(self, fraction: int | None = None) -> str:
        """Loads in the order of their share, one line per sensor; with a fraction one line per sensor and band."""
        whole = self.shares()
        lines = [self._line(c.label, c.unit, whole, 0, i) for i, c in enumerate(self.sensors)]
        if fraction is None:
            return "\n".join(lines)
        banded = self.shares(fraction)
        assert banded.bands is not None
        for i, c in enumerate(self.sensors):
            lines += [
                self._line(f"{c.label}, {name} Hz", c.unit, banded, k, i)
                for k, name in enumerate(banded.bands.names)
                if banded.rms[k, i] > 0
            ]
        return "\n".join(lines)

    def __str__(self) -> str:
        ranked = ", ".join(f"{name} {share:.0%}" for name, share in self.ranking() if share >= NOTHING)
        many = f"{len(self.sensors)} sensor{'s' * (len(self.sensors) != 1)}"
        return f"share of the loads in the power of {many}: {ranked or 'none'}{self._doubt()}\n{self.table()}"

    def _doubt(self) -> str:
        """How many lines are not trusted, and whether they count."""
        if self.trusted is not None:
            left = int(np.sum(~np.any(self.trusted, axis=1)))
            return f" ({left} of {len(self.trusted)} lines left out: not trusted)"
        if self.std is None or self.kind == HISTORIES:
            return ""
        size, std = np.linalg.norm(self.values, axis=2), np.linalg.norm(self.std, axis=2)
        doubtful = int(np.sum(np.all(std > DOUBT * size, axis=1)))
        return f" ({doubtful} of {len(size)} lines are uncertain by more than {DOUBT:.0%} and count)" * bool(doubtful)

    def _line(self, name: str, unit: str, shares: Shares, band: int, i: int) -> str:
        row = shares.share[band, i]
        noise = None if shares.uncertain is None else shares.uncertain[band, i]
        parts = []
        for j in np.argsort(-row, kind="stable"):
            if row[j] >= NOTHING:
                doubt = noise is not None and row[j] < 2 * noise[j]
                parts.append(f"{self.loads[j].label} {row[j]:.1%}" + (" (within its own std)" if doubt else ""))
        text = f"{name}: {', '.join(parts) or 'nothing'}; rms of all {shares.rms[band, i]:.4g} {unit}"
        if shares.interference[band, i] < AGAINST:
            text += f", {-shares.interference[band, i]:.1f} dB below the sum of the parts: the loads cancel"
        return text

    def plot(
        self,
        kind: str = "stacked",
        *,
        sensor: int | str | None = None,
        fraction: int = 3,
        path: str | os.PathLike[str] | None = None,
        show: bool = False,
    ) -> Figure:
        """Picture of the contributions.

        Parameters
        ----------
        kind : ``"stacked"`` or ``"map"``
            Shares per band, stacked, for each sensor; or levels of each load over the lines for one sensor.
        sensor : int or str, optional
            Only this one; the map shows the one with the largest response otherwise.
        fraction : int
            Of an octave.
        path, show
            As in `LoadEstimate.plot`.
        """
        from .._plots.sources import draw_contributions

        return draw_contributions(self, kind, sensor=sensor, fraction=fraction, path=path, show=show)


def contributions(
    model: Model,
    estimate: LoadEstimate,
    sensors: Any = None,
    *,
    trust: float | None = None,
    covariance: ArrayLike | None = None,
    points: int = 0,
) -> Contributions:
    """Response of the sensors of a model to each load of an estimate alone.

    Parameters
    ----------
    model : Model
        From the loads of the estimate to any sensors.
    estimate : LoadEstimate
        Complex loads or cross spectra over frequency, or load histories.
    sensors : sequence of str or int, optional
        Which ones; default all.
    trust : float, optional
        Only lines on which the std of the contributions lies below this share of them (root sums over the loads)
        count in the shares of a sensor. An antiresonance that blew up would otherwise rank first.
    covariance : array, shape (lines, loads, loads), optional
        As in `synthesise`: for the std of the whole.
    points : int
        Samples of a history at which the std is found from the posterior.

    Raises
    ------
    InputError
        As `synthesise`.
    """
    kind, rows = synthesis.kind_of(estimate), synthesis.rows_of(model, sensors)
    assert estimate.axis is not None
    if kind == HISTORIES and trust is not None:
        raise InputError(
            "lines are trusted, not samples", where="contributions", found="a load history with trust=",
            expected="loads over frequency", hint="leave trust out",
        )  # fmt: skip
    chosen = tuple(model.sensors[i] for i in rows)
    same: dict[str, Any] = {
        "axis": estimate.axis, "kind": kind, "sensors": chosen, "loads": tuple(model.loads),
        "measured": tuple(_measured(estimate, c.label) for c in chosen), "estimate": estimate,
    }  # fmt: skip
    if kind == HISTORIES:
        return _over_time(model, estimate, rows, points, same)
    parts = synthesis.paths(model, estimate, rows, covariance)
    whole = synthesis.whole(estimate.axis, chosen, parts)
    values, projected, std = _amplitudes(parts, whole.values) if kind == SPECTRA else _densities(parts)
    return Contributions(
        values=values,
        total=whole.values,
        projected=projected,
        std=std,
        trusted=None if trust is None else synthesis.reliable(values, std, trust),
        total_std=whole.std,
        points=whole.points,
        **same,
    )


# -- inside ------------------------------------------------------------------------------------------------------------
def _amplitudes(p: Paths, whole: NDArray[Any]) -> tuple[NDArray[Any], Real, Real]:
    """Complex amplitude of each load alone, its part in the power of the whole, its std; (lines, sensors, loads)."""
    assert p.load is not None
    load = p.load[:, None]
    values, variance = p.H * load, np.abs(p.H) ** 2 * p.std[:, None] ** 2
    if p.variance is not None:
        variance = variance + p.variance * np.abs(load) ** 2
    return values, (values * whole[..., None].conj()).real, np.sqrt(variance)


def _densities(p: Paths) -> tuple[NDArray[Any], Real, Real]:
    """Density of each load alone, its part in that of the whole, its std; (lines, sensors, loads)."""
    assert p.cross is not None
    auto = np.einsum("ljj->lj", p.cross).real[:, None]
    seen = np.einsum("ljk,lik->lij", p.cross, p.H.conj())  # S h^H
    gain = np.abs(p.H) ** 2
    variance = gain**2 * p.std[:, None] ** 2
    if p.variance is not None:  # d|h|^2 = 2 Re(conj(h) dh), dh circular
        variance = variance + 2 * p.variance * gain * auto**2
    return gain * auto, (p.H * seen).real, np.sqrt(variance)


def _histories(model: Model, estimate: LoadEstimate, rows: list[int]) -> Real:
    """Histories (samples, sensors, loads), each with the other loads at zero."""
    load, axis = estimate.load[:, synthesis.order(model, estimate)], estimate.over("time")
    found = np.empty((len(load), len(rows), load.shape[1]))
    for j in range(load.shape[1]):
        single = np.zeros_like(load)
        single[:, j] = load[:, j]
        found[:, :, j] = model.predict(single, axis.step)[:, rows]
    return found


def _over_time(
    model: Model, estimate: LoadEstimate, rows: list[int], points: int, same: dict[str, Any]
) -> Contributions:
    values = _histories(model, estimate, rows)
    total = values.sum(axis=2)
    std, joint, at = synthesis.band_of_history(model, estimate, rows, points)
    return Contributions(
        values=values, total=total, projected=values * total[..., None], std=std, total_std=joint, points=at, **same
    )


def _measured(estimate: LoadEstimate, label: str) -> NDArray[Any] | None:
    """Measured response of a sensor, where the estimate carries it along its own axis."""
    rows = 0 if estimate.axis is None else len(estimate.axis.values)
    if estimate.response is None or len(estimate.response) != rows or label not in estimate.sensors:
        return None
    return np.asarray(estimate.response)[:, list(estimate.sensors).index(label)]


@dataclass(frozen=True, eq=False)
class _Powers:
    """Over frequency: powers of each load alone, their parts in the whole, of the whole, of their errors if known."""

    frequencies: Real
    alone: Real
    joint: Real
    whole: Real
    noise: Real
    known: bool
    density: bool

    @property
    def parts(self) -> tuple[Real, Real, Real, Real]:
        return self.alone, self.joint, self.whole, self.noise


def _powers(c: Contributions) -> _Powers:
    if c.kind == HISTORIES:
        samples = len(c.values)
        df = 1 / (samples * c.axis.step)
        count = multiplicity(samples)[:, None] / (samples**2 * df)
        alone, whole = (np.fft.rfft(x, axis=0) for x in (c.values, c.total))
        joint = (alone * whole[..., None].conj()).real * count[..., None]
        f = np.asarray(np.arange(len(count)) * df, float)
        single = np.abs(alone) ** 2 * count[..., None]
        return _Powers(f, single, joint, np.abs(whole) ** 2 * count, np.zeros_like(single), False, True)
    f = np.asarray(c.axis.values, float)
    known = c.std is not None
    std = c.std if c.std is not None else np.zeros_like(c.projected)
    if c.kind == SPECTRA:
        return _Powers(f, np.abs(c.values) ** 2, c.projected, np.abs(c.total) ** 2, std**2, known, False)
    values, total = np.asarray(c.values, float), np.asarray(c.total, float)
    return _Powers(f, values, c.projected, total, std, known, len(f) > 1)


def _widths(f: Real, density: bool) -> Real:
    if not density:
        return np.where(f > 0, 1.0, 0.0) if np.any(f > 0) else np.ones(len(f))
    return np.where(f > 0, widths(f), 0.0)


def _shares(
    bands: Bands | None, strips: BandPower | None, known: bool, alone: Real, joint: Real, whole: Real, noise: Real
) -> Shares:
    parts = alone.sum(axis=2)
    coverage = np.ones(whole.shape)
    if bands is not None:
        coverage = np.zeros(whole.shape) if strips is None else (strips.power.T / (bands.upper - bands.lower)).T
    return Shares(
        bands,
        _over(alone, parts[..., None]),
        _over(joint, whole[..., None]),
        _over(noise, parts[..., None]) if known else None,
        np.sqrt(whole),
        10 * np.log10(np.maximum(np.where(parts > 0, _over(whole, parts), 1.0), FLOOR)),
        np.minimum(coverage, 1.0),
    )


def _over(x: Real, y: Real) -> Real:
    """Ratio; 0 where nothing moves."""
    return np.asarray(np.divide(x, y, out=np.zeros(np.broadcast_shapes(x.shape, y.shape)), where=y > 0), float)
