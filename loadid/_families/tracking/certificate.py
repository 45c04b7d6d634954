"""What a track is worth: innovations against their prediction, sensors against each other, where data decide.

The error of a filter that has settled is a stationary process, driven by what moves the loads and by the noise of the
sensors; the load by its prior is one too. Frequency by frequency their ratio is what the data have left of what was
not known before. Over all frequencies the first is the square of the std of the track.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..._guards.tracking import CALM, RESTLESS
from ..._inverse.gaussian.roots import Array
from ..._inverse.gaussian.steady import SteadyFilter
from .innovations import loudness

LINES = 160  # frequencies at which the two are compared
LOWEST = 1e-4  # of the Nyquist frequency; what is told there is told below
Bands = tuple[tuple[float, float], ...]


def spectra(settled: SteadyFilter, turns: Array) -> tuple[Array, Array]:
    """Variance of a sample by frequency: of the error of every load, and of the load by its prior.

    Parameters
    ----------
    settled : SteadyFilter
    turns : array, shape (lines,)
        Frequency in radians a sample, 0 to pi.

    Returns
    -------
    error, prior : array, shape (lines, p)
        Their means over 0 to 2 pi are the variances; infinite or large where a walk has no variance.
    """
    model, part, K = settled.model, settled.part, settled.K
    shift = np.exp(-1j * np.asarray(turns, float))[:, None, None]
    pushes = np.hstack([part.LQ - K @ (part.H @ part.LQ), -K @ part.LR])
    error = _power(settled.A, model.Cp, pushes, shift)
    own = slice(model.nx, None)
    return error, _power(model.F[own, own], model.Cp[:, own], model.LQ[own], shift)


def told_bands(settled: SteadyFilter, dt: float) -> tuple[Bands, ...]:
    """Bands in Hz, load by load, in which the error of the track is smaller than what its prior knew.

    The lowest line stands for all below it, the highest ends at the Nyquist frequency.
    """
    turns = np.pi * np.r_[np.geomspace(LOWEST, 0.02, LINES // 4, endpoint=False), np.linspace(0.02, 1, LINES)]
    error, prior = spectra(settled, turns)
    hertz = turns / (2 * np.pi * dt)
    hertz[0] = 0.0
    return tuple(_intervals(hertz, below) for below in (error < prior).T)


def in_words(bands: Bands, nyquist: float) -> str:
    """What the bands of a load say of its track."""
    if not bands:
        return "at no frequency do the data tell more than the prior"
    listed = " and ".join(f"{low:.3g} to {high:.3g} Hz" for low, high in bands)
    if len(bands) == 1 and bands[0][0] == 0.0 and np.isclose(bands[0][1], nyquist):
        return f"the data tell more than the prior at all frequencies ({listed})"
    return f"the data tell more than the prior from {listed}; elsewhere the track is its prior"


def _power(A: Array, C: Array, B: Array, shift: Array) -> Array:
    """Squares of the gains of ``x_k = A x_{k-1} + B e_k``, read by C, summed over e: (lines, rows of C)."""
    adjoint = np.eye(len(A)) - A.T * shift  # C (I - A s)^-1, transposed
    read = np.linalg.solve(adjoint, np.broadcast_to(C.T.astype(complex), (len(shift), *C.T.shape)))
    return np.asarray(np.sum(np.abs(np.swapaxes(read, 1, 2) @ B) ** 2, axis=2))


def _intervals(hertz: Array, inside: NDArray[np.bool_]) -> Bands:
    edges = np.flatnonzero(np.diff(np.r_[False, inside, False])).reshape(-1, 2)
    return tuple((float(hertz[a]), float(hertz[b - 1])) for a, b in edges)


LAGS = 20
LEVEL = 0.05
WIDE = 1.96
QUARTILE = 0.6745  # std of a normal number whose size has the median one
INSIDE = 0.85  # least share inside the 95 % band of a sensor that the others predict; more is only cautious
OFF = 0.3  # std of a channel's innovation that its mean may have
MOVING = 0.9  # largest correlation: less is a load rougher or smoother than its prior, which costs little
HELD = 6.0  # correlation lengths of a load that a record holds, at least, to tell them
SHORT = 0.2  # samples of a correlation length, below which a load is white and nothing of it is told


@dataclass(frozen=True)
class TrackCertificate:
    """Tests of the innovations of a record.

    Parameters
    ----------
    samples : int
    nis : float
        Mean normalised square of the innovations per channel; 1 where noise and prior are right.
    nis_bounds : (float, float)
        Where chance leaves it in 95 of 100 cases.
    whiteness : float
        Largest autocorrelation over channels and lags of the normalised innovations.
    whiteness_bound : float
    rms, mean : tuple of float
        Of the normalised innovation of each channel.
    left_out : tuple of float or None
        Share of each channel inside the 95 % band that the other channels predict; None where they cannot.
    sensors : tuple of str
    time_constant : float
        In which the filter forgets an error, s.
    robust_std : tuple of float
        Std of the normalised innovation of each channel as its median tells it, single wrong samples apart.
    bands : tuple of (tuple of (float, float))
        For each load, the frequencies (Hz) at which the track knows more than its prior did.
    loads : tuple of str
        Loads of the bands.
    nyquist : float
        Hz.
    lengths : tuple of (float or None)
        Correlation length of each load that the record has told, in samples; None where it was given, or has none.
    told : bool
        The record tells a load from noise.
    loudest : float
        Largest `loudness` of a stretch, at least the NIS: all that a short record tells.
    """

    samples: int
    nis: float
    nis_bounds: tuple[float, float]
    whiteness: float
    whiteness_bound: float
    rms: tuple[float, ...]
    mean: tuple[float, ...]
    left_out: tuple[float | None, ...]
    sensors: tuple[str, ...]
    time_constant: float
    robust_std: tuple[float, ...] = ()
    bands: tuple[Bands, ...] = ()
    loads: tuple[str, ...] = ()
    nyquist: float = float("inf")
    lengths: tuple[float | None, ...] = ()
    told: bool = True
    loudest: float = 1.0

    @property
    def failing(self) -> tuple[str, ...]:
        """Tests that are not passed, in words: of the size of what is wrong, which no length of a record changes."""
        found = [] if self.told else ["the record tells no load from noise, so that none has tuned the prior"]
        if not CALM <= self.nis <= RESTLESS:
            found.append(f"NIS per channel {self.nis:.3f} ({CALM:g} to {RESTLESS:g})")
        if self.whiteness > MOVING:
            found.append(f"innovations correlated: {self.whiteness:.3f} (at most {MOVING:g})")
        for name, mean in zip(self.sensors, self.mean, strict=True):
            if abs(mean) > OFF:
                found.append(f"{name} has a mean innovation of {mean:+.2f} stds")
        for name, share in zip(self.sensors, self.left_out, strict=True):
            if share is not None and share < INSIDE:
                found.append(f"{name} from the others: {share:.0%} inside the 95 % band")
        for i, length in enumerate(self.lengths):
            name = self.loads[i] if i < len(self.loads) else f"load {i + 1}"
            if length is not None and self.samples < HELD * length:
                found.append(f"the record holds {self.samples / length:.2g} correlation lengths of {name}: another one "
                             f"may move otherwise (at least {HELD:g})")  # fmt: skip
            elif length is not None and length < SHORT:
                found.append(f"the record tells no correlation length of {name}: {length:.2g} samples")
        return tuple(found)

    @property
    def verdict(self) -> str:
        """``"calibrated"`` only where every test passes."""
        return "calibrated" if not self.failing else "not calibrated"

    def __str__(self) -> str:
        low, high = self.nis_bounds
        lines = [
            f"{self.verdict}, {self.samples} samples",
            f"NIS per channel {self.nis:.3f} (chance {low:.3f} to {high:.3f})",
            f"largest correlation of the innovations {self.whiteness:.3f} (chance {self.whiteness_bound:.3f})",
            f"the filter forgets within {self.time_constant:.3g} s",
        ]
        for name, r, m, share in zip(self.sensors, self.rms, self.mean, self.left_out, strict=True):
            alone = "not predictable from the others" if share is None else f"{share:.0%} inside from the others"
            lines.append(f"  {name}: innovation rms {r:.3f}, mean {m:+.3f}; {alone}")
        for name, bands in zip(self.loads, self.bands, strict=True):
            lines.append(f"  {name}: {in_words(bands, self.nyquist)}")
        return "\n".join(lines)


def banded(
    certificate: TrackCertificate, settled: SteadyFilter | None, loads: Sequence[str], dt: float
) -> TrackCertificate:
    """A certificate with the bands in which the track of every load knows more than its prior did.

    A filter that never settles has no such bands, and the certificate stays as it is.
    """
    if settled is None:
        return certificate
    return replace(certificate, bands=told_bands(settled, dt), loads=tuple(loads), nyquist=0.5 / dt)


def certify(
    normalised: Array,
    nis: Array,
    left_out: Sequence[float | None],
    sensors: Sequence[str],
    time_constant: float,
    lengths: Sequence[float | None] = (),
) -> TrackCertificate:
    """Certificate of normalised innovations (samples, channels), NaN where missing, and their NIS (samples,).

    `lengths`: as `TrackCertificate` has them.
    """
    from scipy.stats import norm

    present = np.isfinite(normalised)
    count = int(present.sum())
    samples, m = normalised.shape
    mean = float(np.sum(nis)) / max(count, 1)
    half = WIDE * np.sqrt(2 / max(count, 1))
    bound = float(norm.ppf(1 - LEVEL / 2 / (LAGS * m)) / np.sqrt(max(samples, 1)))
    return TrackCertificate(
        samples=samples,
        nis=mean,
        nis_bounds=(float(1 - half), float(1 + half)),
        whiteness=max((_correlation(normalised[:, i]) for i in range(m)), default=0.0),
        whiteness_bound=bound,
        rms=tuple(float(np.sqrt(np.nanmean(x**2))) if np.isfinite(x).any() else float("nan") for x in normalised.T),
        mean=tuple(float(np.nanmean(x)) if np.isfinite(x).any() else float("nan") for x in normalised.T),
        left_out=tuple(left_out),
        sensors=tuple(sensors),
        time_constant=float(time_constant),
        lengths=tuple(lengths),
        loudest=float(np.nanmax(loudness(normalised), initial=max(mean, 1.0))),
        robust_std=tuple(
            float(np.nanmedian(np.abs(x))) / QUARTILE if np.isfinite(x).any() else 1.0 for x in normalised.T
        ),
    )


def _correlation(x: Array) -> float:
    """Largest autocorrelation over the lags, of the samples that are there."""
    x = np.where(np.isfinite(x), x - np.nanmean(x) if np.isfinite(x).any() else 0.0, 0.0)
    power = float(x @ x)
    if power == 0 or len(x) <= LAGS:
        return 0.0
    return float(max(abs(float(x[lag:] @ x[:-lag])) / power for lag in range(1, LAGS + 1)))
