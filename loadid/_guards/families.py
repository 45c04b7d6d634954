"""Guards of single families: frequency lines, the search for a place, sparse loads."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures._flags import Evidence, Flag
from structures.errors import NotIdentifiable

from .._inverse.problem import NoiseSource
from .._results.functionals import LoadSpectrum, in_words

ENDS = 0.01  # share of the peak that may be left at the ends of a transient
TONES = 30.0  # power of a line over the median around it from which it is a harmonic, not a random load
STRONG = 3.0  # signal over noise of a line that is excited
FEW = 16  # lines that were picked because they are excited
MOST = 0.5  # share of a variance, or of the power of a load, that decides
HARMONIC = 0.5  # share of the power of a record that its one harmonic explains
SHARP = 1.0  # bandwidth of the window over that of the sharpest resonance


def antiresonance(spectrum: LoadSpectrum, labels: tuple[str, ...]) -> Flag | None:
    """W507: lines on which the predicted relative std of a load exceeds the stated level.

    A note: there the load is mostly prior, and its band says so.
    """
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
    seen = spectrum.predicted[:, worst]
    return Flag(
        "W507",
        Evidence("largest predicted relative std", float(np.min([np.max(seen), 1e6])), spectrum.level),
        f"{count} of {lines} lines do not tell some load to {spectrum.level:.0%} ({where}): antiresonances, or no load "
        f"there. They hold up to {spectrum.untold_power:.0%} of the power of a load and are shaded; what stands in "
        "`load` there is mostly prior, and its band as wide",
        state=True,
    )


def frf_by_floor(by_floor: bool, made: NDArray[np.float64], spectrum: LoadSpectrum) -> Flag | None:
    """W406: nothing shows how large errors of the FRF are, and they are what spoils most of a load.

    Parameters
    ----------
    made : array, shape (lines, loads)
        Variance of the loads that errors of the FRF make.
    """
    power = spectrum.expected**2
    spoilt = (made > MOST * spectrum.std**2) & (spectrum.std > spectrum.level * spectrum.expected)
    share = float(np.max(np.sum(power * spoilt, axis=0) / np.maximum(np.sum(power, axis=0), 1e-300)))
    if not by_floor or share <= MOST:
        return None
    return Flag(
        "W406",
        Evidence("share of the power of a load on lines that errors of the FRF spoil", share, MOST),
        f"nothing tells how wrong the FRF is: 5 % of an entry is taken, which keeps {share:.0%} of a load from being "
        f"told to {spectrum.level:.0%}",
        "state noise=Noise(frf=...), give the FRF its variance, or use more sensors than loads",
        effect=1.0,
    )


def leaking(values: NDArray[Any], residual: NDArray[Any]) -> Flag | None:
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


def _calm(residual: NDArray[Any], few: int) -> NDArray[np.float64]:
    """Noise of each channel where the residual is calm: what leaks stands in a part of it and is no noise."""
    few = min(few, len(residual))
    parts = residual[: len(residual) // few * few].reshape(-1, few, residual.shape[1])
    return np.asarray(np.sqrt(np.quantile(np.mean(parts**2, axis=1), 0.25, axis=0)))


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


def little_explained(share: float, frequency: float) -> Flag | None:
    """W533: one harmonic explains only a share of the power of a record."""
    if share >= HARMONIC:
        return None
    return Flag(
        "W533",
        Evidence("share of the record that the harmonic explains", float(share), HARMONIC),
        f"a harmonic of {frequency:.5g} Hz explains {share:.1%} of the record: the rest is noise, another load, or a "
        "load that is no harmonic",
    )


def inseparable(
    spectrum: LoadSpectrum, H: NDArray[Any], strength: NDArray[Any], labels: tuple[str, ...]
) -> Flag | None:
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
    )


def likeness(H: NDArray[Any]) -> NDArray[np.float64]:
    """Condition of lines (lines, sensors, loads) whose columns have unit length: how alike the loads look."""
    if H.shape[1] < H.shape[2]:
        return np.full(len(H), np.inf)
    size = np.linalg.norm(H, axis=1, keepdims=True)
    s = np.linalg.svd(H / np.where(size > 0, size, 1.0), compute_uv=False)
    with np.errstate(divide="ignore"):
        return s[:, 0] / s[:, -1]


def harmonics(load: NDArray[Any]) -> NDArray[np.bool_]:
    """Lines on which the loads (lines, loads) stand out of those around them; of a few lines all."""
    power = np.sum(np.abs(load) ** 2, axis=1)
    if len(power) < FEW:
        return np.asarray(power > 0)
    from scipy.ndimage import median_filter

    around = median_filter(power, size=min(len(power) // 2 * 2 - 1, 41), mode="reflect")
    return np.asarray(power > TONES * np.maximum(around, np.finfo(float).tiny))


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
    """W406, a note: no noise level, and no more sensors than loads: neighbouring lines alone tell noise from load."""
    if known or spare > 0:
        return None
    return Flag(
        "W406",
        Evidence("sensors beyond the loads", spare, 1),
        "the noise level is not known, and no sensor is left over to show it: it comes from how the neighbouring lines "
        "vary with the gain of the FRF",
        "state noise=, or use more sensors than loads",
        state=True,
    )


AMBIGUOUS = 1.05  # runner-up over best: all misses of 1520 simulated searches lay below 1.045
COARSE = 0.03  # relative lambda above which residuals measure bias: misses with ratios above 1.05 were seen from there
LOUD, LARGE = 3.0, 0.1  # residual over noise, and over data, from which on no candidate explains the data
LARGE_EARLY = 0.15  # error of the model over the first part of the response, from which on none does
CERTAIN = 1.96  # half-width of the 95 % band in standard deviations


def ambiguous(ratio: float, found: str, rival: str) -> Flag | None:
    """W511: another place explains the data as well, by the ratio of the residual norms."""
    if ratio >= AMBIGUOUS:
        return None
    return Flag(
        "W511",
        Evidence("residual of the runner-up over the best", float(ratio), AMBIGUOUS),
        f"the place is ambiguous: {rival} explains the data as well as {found}, residual ratio {ratio:.4f}",
        "add a sensor off the symmetry axis, or use a record with less noise",
    )


def blurred(std: float, spacing: float, found: str) -> Flag | None:
    """W511: the place is not known to one spacing of the candidates."""
    if CERTAIN * std <= spacing:
        return None
    return Flag(
        "W511",
        Evidence("half-width of the 95 % band of the place, m", float(CERTAIN * std), float(spacing)),
        f"the place {found} is ambiguous: it is known to ±{CERTAIN * std:.3g} m only, the candidates are "
        f"{spacing:.3g} m apart",
        "add sensors, or use a record with less noise",
    )


def at_the_rim(found: str) -> Flag:
    """W511: the place came to rest at the end of the candidates; the best one may lie beyond."""
    return Flag(
        "W511",
        Evidence("place", found, "inside the grid of candidates"),
        f"the place is ambiguous: {found} lies on the rim of the candidates, and the best place may lie beyond",
        "extend the grid of candidates",
    )


def place_unexplained(to_noise: float | None, residual: float, early: float | None) -> Flag | None:
    """W511: no place explains the data: the load acts beyond the candidates, or the model is wrong.

    Where the first part of the response told the place, what is left of that (`early`) counts.
    """
    if to_noise is None or to_noise <= LOUD or residual <= LARGE or (early is not None and early <= LARGE_EARLY):
        return None
    residual = residual if early is None else early
    return Flag(
        "W511",
        Evidence("residual over noise", float(to_noise), LOUD),
        f"no place explains the data: the best one leaves {residual:.0%} of them, {to_noise:.3g} times the noise",
        "extend the grid of candidates, search for several loads (search=Search(impacts=2)), or check the model and "
        "the noise level",
    )


def few_sensors(sensors: int, loads: int) -> Flag | None:
    """W511: as many unknown histories as sensors: every place explains the data with some load."""
    if sensors > loads:
        return None
    return Flag(
        "W511",
        Evidence("sensors", float(sensors), float(loads + 1)),
        f"the place is ambiguous: with {sensors} sensor{'s' * (sensors > 1)} and {loads} unknown "
        f"histor{'ies' if loads > 1 else 'y'} every place explains the data with some load, and only the size of that "
        "load speaks for one of them",
        "use more sensors than there are loads",
    )


def biased(lam: float) -> Flag | None:
    """W511: a large lambda leaves residuals that measure bias, not the place."""
    if lam <= COARSE:
        return None
    return Flag(
        "W511",
        Evidence("relative lambda", float(lam), COARSE),
        f"the place is ambiguous: at a relative lambda of {lam:.2g} the residuals measure what the penalty takes away",
        "use the default of 1e-3",
    )


def alike(groups: Sequence[Sequence[str]], difference: float) -> NotIdentifiable:
    """E512: candidates at different places whose loads leave the same data, from the model alone."""
    return NotIdentifiable(
        f"{_listed(groups)} give the same data: their impulse responses differ by at most {difference:.1g}",
        advice="move or add a sensor off the symmetry axis, drop one candidate of each group, or allow=['LID-E512'] to "
        "have all of them reported",
        code="LID-E512",
    )


def alike_allowed(groups: Sequence[Sequence[str]], difference: float) -> Flag:
    """E512 as a flag, where the user allowed it."""
    return Flag(
        "E512",
        Evidence("relative difference of the impulse responses", f"at most {difference:.1g}", f"{difference:.1g}"),
        f"{_listed(groups)} give the same data",
    )


def not_comparable(what: str, found: Any) -> NotIdentifiable:
    """E513: a regularisation that differs from candidate to candidate."""
    return NotIdentifiable(
        f"residuals of candidates are not comparable with {what}: {found}",
        advice="give one relative lambda for all candidates (choice=1e-3); a rule may choose the lambda of the load at "
        "the place that was found (settings={'choice': ...})",
        code="LID-E513",
    )


def _listed(groups: Sequence[Sequence[str]]) -> str:
    shown = ["candidates " + " and ".join(g[:6]) + (" ..." if len(g) > 6 else "") for g in groups[:4]]
    return "; ".join(shown) + (f"; and {len(groups) - 4} more groups" if len(groups) > 4 else "")


DENSE = 0.3  # share of the dictionary in use above which a load is not sparse
CLEARLY = 10.0  # difference of the information criterion that counts as strong evidence
UNSURE = 0.25  # std of an amplitude over the amplitude above which it is not determined
MISFIT = 1.3  # residual over noise above which a dictionary does not hold the load
SOLVED = 1e-5  # relative duality gap above which an l1 solution is none


def dense_support(count: int, atoms: int) -> Flag | None:
    """W311 under l1: so much of the dictionary is in use that nothing is sparse about the load."""
    share = count / max(atoms, 1)
    if share <= DENSE:
        return None
    return Flag(
        "W311",
        Evidence("share of the dictionary in use", float(share), DENSE),
        f"the load looks dense: {count} of {atoms} waveforms are in use; the prior used was a sparse one",
        "use Deconvolution (Tikhonov) for a load that acts all the time",
    )


def wide_pulses(gain: float, knots: int, spikes: int, used: str = "spikes of one sample") -> Flag | None:
    """W311 under l1 on a dictionary of too narrow or too wide waveforms: B-splines of another spacing fit far better.

    Parameters
    ----------
    gain : float
        By how much the extended information criterion of those is smaller.
    knots : int
        Their spacing, in samples.
    spikes : int
        Waveforms in use.
    used : str
        The waveforms, in words.
    """
    if not gain > CLEARLY:
        return None
    return Flag(
        "W311",
        Evidence("information criterion in favour of wider pulses", float(gain), CLEARLY),
        f"the pulses are not {used}: {spikes} of these stand for them, with peaks that mean nothing; cubic B-splines "
        f"with knots every {knots} samples explain the record by {gain:.3g} better",
        f"SparseDeconvolution(dictionary='bspline', knots={knots}) or knots='scan'; or Tikhonov with a load that only "
        "pushes",
    )


def unexplained(level: float, prior: str) -> Flag | None:
    """W311 under l1: no load of the dictionary explains the data to their noise; `level` is residual over noise."""
    if not level > MISFIT:
        return None
    return Flag(
        "W311",
        Evidence("residual over noise", float(level), MISFIT),
        f"the dictionary ({prior}) cannot explain the data: the residual is {level:.3g} times the stated noise",
        "narrower waveforms (knots='scan'), or another prior; then look for model error or a noise level too small",
    )


def unsure_amplitudes(share: float, label: str) -> Flag | None:
    """W304 of spikes: their places are told by the data, their heights are not.

    Parameters
    ----------
    share : float
        Std of the largest spike over its height, if its neighbours in time may act too.
    label : str
        Load that it belongs to.
    """
    if not share > UNSURE:
        return None
    return Flag(
        "W304",
        Evidence("std of the largest spike over its height, neighbours allowed", float(share), UNSURE),
        f"the spikes are well placed, their heights are not to be trusted: if the neighbouring samples act too, the "
        f"largest ({label}) is known to ± {share:.0%} only; under Tikhonov it would be smeared and too low instead",
        "read places and impulses (functional('impulse', window=...)), not peaks; an accelerometer near the load, or "
        "less noise, tells single samples apart",
    )


def stopped_gap(gap: float, wanted: float) -> Flag | None:
    """W410 of an l1 problem: rounding ended it above the gap that was asked for, and below the one that is refused."""
    if gap <= wanted:
        return None
    return Flag(
        "W410",
        Evidence("relative duality gap", float(gap), wanted),
        f"the l1 problem was solved to a duality gap of {gap:.2g}, not to {wanted:.2g}: neighbouring responses are "
        "equal to rounding",
        "a larger mu, or a coarser dictionary (knots=)",
    )


def outside_training(name: str, scores: str, value: float, limit: float, alarms: int, of: int, lost: bool) -> Flag:
    """W609: readings unlike the examples of a learned map, which the physics answered.

    Parameters
    ----------
    name : str
        Of the score that is furthest beyond its limit.
    scores : str
        All of them in words.
    value, limit : float
        Of that score.
    alarms, of : int
        Frames or records with an alarm, and how many there are.
    lost : bool
        Samples are missing.
    """
    where = f"in {alarms} of {of} frames the readings are" if of > 1 else "the readings are"
    why = "samples are missing, which the map knows nothing of; " if lost else ""
    return Flag(
        "W609",
        Evidence(name, float(value), float(limit)),
        f"{where} unlike the examples that the map was learned from ({why}{scores}): the load is that of the physics",
    )


def not_in_the_set(still: Sequence[str], tied: Sequence[str], rank: int, wanted: int) -> list[Flag]:
    """W616: loads that the examples of a learned map do not tell apart; none where they tell all.

    Parameters
    ----------
    still : sequence of str
        Loads that never vary in the examples.
    tied : sequence of str
        Loads that vary together alone.
    rank, wanted : int
        Directions in which loads vary, and in how many sensors could tell them apart.
    """
    said = [f"never varying there, and answered by their mean: {_few(still)}"] if still else []
    if rank < wanted:
        said.append(f"acting only together, in {rank} directions of {wanted}: {_few(tied) if tied else 'not named'}")
    if not said:
        return []
    return [
        Flag(
            "W616",
            Evidence("directions of the loads in the examples", rank, wanted + len(still)),
            f"the examples do not span all loads: {'; '.join(said)}; no band of the map shows what else they could do",
        )
    ]


def _few(names: Sequence[str]) -> str:
    """Some names, and how many more there are."""
    more = f" and {len(names) - 6} more" if len(names) > 6 else ""
    return ", ".join(names[:6]) + more
