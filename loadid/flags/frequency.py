"""Guards of frequency lines: antiresonances, leakage, loads that cannot be told apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from structures.flags import Evidence, Flag

from ..inverse.noise_source import NoiseSource
from ..spectrum import Spectrum, in_words

ENDS = 0.01  # share of the peak that may be left at the ends of a transient
TONES = 30.0  # power of a line over the median around it from which it is a harmonic, not a random load
STRONG = 3.0  # signal over noise of a line that is excited
FEW = 16  # lines that were picked because they are excited
SHARP = 1.0  # bandwidth of the window over that of the sharpest resonance


def antiresonance(spectrum: Spectrum, labels: tuple[str, ...]) -> Flag | None:
    """W507: lines on which the predicted relative std of a load exceeds the stated level."""
    flagged = ~spectrum.trust()
    if not flagged.any():
        return None
    worst = int(np.argmax(flagged.sum(axis=0)))
    count, lines = int(flagged.any(axis=1).sum()), len(flagged)
    share = flagged.mean(axis=0)
    where = "; ".join(
        f"{labels[j]}: " + ("all" if share[j] == 1 else f"{share[j]:.1%}, {in_words(spectrum.bands(j))}")
        for j in np.argsort(-share)[:4] if share[j]
    )  # fmt: skip
    seen, power = spectrum.predicted[:, worst], spectrum.expected**2
    held = float(np.max(np.sum(power * flagged, axis=0) / np.maximum(np.sum(power, axis=0), 1e-300)))
    return Flag(
        "W507",
        Evidence("largest predicted relative std", float(np.min([np.max(seen), 1e6])), spectrum.level),
        f"{count} of {lines} lines do not tell some load to {spectrum.level:.0%} ({where}): antiresonances, or no load "
        f"there. They hold up to {held:.0%} of the power of a load and are shaded; what stands in `load` "
        "there is mostly prior",
        "add sensors that move at these lines, lower the noise, or average longer; estimate.trust(level) is the mask",
    )


def leaking(values: NDArray, residual: NDArray) -> Flag | None:
    """W508: a transient that has not decayed at its end, or has begun before its first sample."""
    peak = np.abs(values).max(axis=0)
    few = max(len(values) // 100, 10)
    noise = _calm(residual, few)
    first, last = (np.sqrt(np.mean(part**2, axis=0)) for part in (values[:2], values[-few:]))
    clear = np.maximum(np.where(first > 5 * noise, first, 0.0), np.where(last > 3 * noise, last, 0.0))
    share = clear / np.maximum(peak, np.finfo(float).tiny)
    if share.max() <= ENDS:
        return None
    return Flag(
        "W508",
        Evidence("response at an end of the record over its peak", float(share.max()), ENDS),
        f"a transient with leakage on the frequency route: {share.max():.1%} of the peak response is there at an end "
        "of the record, which the padded transform takes for a jump",
        "take Deconvolution, which is exact on finite records; or record until the structure rests",
    )


def _calm(residual: NDArray, few: int) -> NDArray[np.float64]:
    """Noise of each channel where the residual is calm: what leaks stands in a part of it and is no noise."""
    few = min(few, len(residual))
    parts = residual[: len(residual) // few * few].reshape(-1, few, residual.shape[1])
    return np.sqrt(np.quantile(np.mean(parts**2, axis=1), 0.25, axis=0))


def too_coarse(bandwidth: float, decay_rate: float | None) -> Flag | None:
    """W508: the window of averaged spectra is wider than the sharpest resonance."""
    if decay_rate is None or decay_rate <= 0 or not bandwidth:
        return None
    sharpest = decay_rate / np.pi  # half-power bandwidth 2 zeta f
    if bandwidth <= SHARP * sharpest:
        return None
    return Flag(
        "W508",
        Evidence("noise bandwidth of the window, Hz", bandwidth, float(sharpest)),
        f"leakage: the window averages over {bandwidth:.3g} Hz, the sharpest resonance is {sharpest:.3g} Hz wide; "
        "around it the spectra are not those of the FRF",
        f"longer segments (at least {np.ceil(bandwidth / sharpest):.0f} times)",
    )


def inseparable(spectrum: Spectrum, H: NDArray, strength: NDArray, labels: tuple[str, ...]) -> Flag | None:
    """W516: strong harmonic loads at several points that the excited lines do not tell apart.

    Parameters
    ----------
    H : array, shape (lines, sensors, loads)
        Whitened FRF.
    strength : array, shape (lines,)
        Signal over noise of each line (amplitudes).
    """
    if spectrum.load.shape[1] < 2:
        return None
    excited = harmonics(spectrum.load) & (strength > STRONG)
    condition = np.zeros(len(strength))
    condition[excited] = likeness(H[excited])
    bad = condition > strength
    if not bad.any():
        return None
    k = int(np.argmax(np.where(bad, condition / np.maximum(strength, 1e-300), 0.0)))
    where = f"{int(bad.sum())} of {int(excited.sum())} excited lines (worst {spectrum.frequencies[k]:.5g} Hz)"
    return Flag(
        "W516",
        Evidence("condition of H on an excited line", float(min(condition[k], 1e16)), float(strength[k])),
        f"forces not separable on {where}: the condition of H exceeds signal over noise, so that "
        f"{', '.join(labels[:4])} can be exchanged",
        "report the resultant of the group, or add sensors that see the loads differently",
    )


def likeness(H: NDArray) -> NDArray[np.float64]:
    """Condition of lines (lines, sensors, loads) whose columns have unit length: how alike the loads look."""
    if H.shape[1] < H.shape[2]:
        return np.full(len(H), np.inf)
    size = np.linalg.norm(H, axis=1, keepdims=True)
    s = np.linalg.svd(H / np.where(size > 0, size, 1.0), compute_uv=False)
    with np.errstate(divide="ignore"):
        return s[:, 0] / s[:, -1]


def harmonics(load: NDArray) -> NDArray[np.bool_]:
    """Lines on which the loads (lines, loads) stand out of those around them; of a few lines all."""
    power = np.sum(np.abs(load) ** 2, axis=1)
    if len(power) < FEW:
        return power > 0
    from scipy.ndimage import median_filter

    around = median_filter(power, size=min(len(power) // 2 * 2 - 1, 41), mode="reflect")
    return power > TONES * np.maximum(around, np.finfo(float).tiny)


def contradicted(excess: float, source: NoiseSource) -> Flag | None:
    """W406: the stated noise level is set aside where lines show more, noise or error of the model.

    Parameters
    ----------
    excess : float
        Variance of the whitened noise in the middle of the lines that contradict it; 1 where none does.
    """
    if excess <= 1:
        return None
    return Flag(
        "W406",
        Evidence("shown over stated noise", float(np.sqrt(excess)), 1.0),
        f"lines show {np.sqrt(excess):.2g} times the stated noise ({source}): noise, or errors of the FRF; there the "
        "band follows what is seen",
        "state the variance of the FRFs, or check the noise level",
    )


def no_spare_data(known: bool, spare: int) -> Flag | None:
    """W406: no noise level, and no more sensors than loads: neighbouring lines alone tell noise from load."""
    if known or spare > 0:
        return None
    return Flag(
        "W406",
        Evidence("sensors beyond the loads", spare, 1),
        "the noise level is not known, and no sensor is left over to show it: it comes from how the neighbouring lines "
        "vary with the gain of the FRF",
        "state noise=, or use more sensors than loads",
    )
