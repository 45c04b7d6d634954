"""Guards of the inversion: resolution, nulls, dynamics, memory, pieces of a record, loads in space and time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._advice import Advice, Option, Spelling
from structures._flags import Evidence, Flag
from structures.errors import InputError, NotIdentifiable

from .._inverse.diagnosis.detection import CHANCE
from .._inverse.diagnosis.identifiability import Refinement, Start

PRESSURES = {"Pa", "kPa", "MPa", "GPa", "bar", "mbar", "psi", "N/m^2", "N/m²", "N/mm^2", "N/mm²"}
LIKELY = 0.5  # probability from which something is said
FEW = 3.0  # periods of the lowest mode below which a record is called short
AMPLE = 2.0  # effective degrees of freedom over recoverable modes that a good lambda may use ...
SPARE = 5.0  # ... and some more


def resolution(nullity: int, prior: str, width: float, unit: str, bias: float | None = None) -> Flag:
    """N303: what regularisation did, always said."""
    if nullity == 0 and bias == 0 and unit == "loads":
        return Flag(
            "N303",
            Evidence("resolution width", float(width), None),
            "nothing was filled in: each load is determined by the data, at full height",
            "judge the loads by their std",
        )
    null = f"{nullity} components in ker(H) are set by the prior ({prior}); " if nullity else ""
    peak = "" if bias is None else f"; a single-sample peak is shown at {1 - bias:.0%} of its height"
    return Flag(
        "N303",
        Evidence("resolution width", float(width), None),
        f"{null}nothing finer than {width:.3g} {unit} is resolved{peak}",
    )


def nodal_as_pressure(kind: str, quantity: str) -> Flag | None:
    """W106: nodal forces under the unit or the name of a pressure; `kind` of the load basis, `quantity` or unit."""
    if kind != "nodal" or (quantity not in PRESSURES and quantity.lower() not in ("pressure", "traction", "stress")):
        return None
    return Flag(
        "W106",
        Evidence("shown as", quantity, "N"),
        "nodal forces scale with element size; not a pressure",
    )


def refined(found: Refinement) -> Flag | None:
    """W107: a finer load basis shows no more modes above the noise."""
    if found.gained > 0:
        return None
    return Flag(
        "W107",
        Evidence("modes above the noise", found.after, found.before),
        f"n rose from {found.coarse} to {found.fine}; modes above noise stayed {found.after} "
        f"(relative noise {found.eta:.2g})",
        state=True,
    )


def recoverable(plateau: int, rank: int, edf: float | None = None, requested: float | None = None) -> Flag | None:
    """W304: more detail is claimed or used than the data hold.

    Parameters
    ----------
    plateau, rank : int
        Modes before the data coefficients reach the noise, and modes of the operator.
    edf : float, optional
        Effective degrees of freedom that lambda lets through, per frame.
    requested : float, optional
        Number of components whose resolution is promised.
    """
    asked = requested is not None and requested > plateau
    used = edf is not None and edf > AMPLE * plateau + SPARE
    if plateau > 0 and not asked and not used:
        return None
    value, name = (requested, "components asked for") if asked else (edf, "effective degrees of freedom")
    if value is None:
        value, name = 0.0, "recoverable modes"
    tail = "the data are all noise" if plateau == 0 else f"{name} {value:.3g}"
    return Flag(
        "W304",
        Evidence(name, float(value), float(plateau)),
        f"i* = {plateau} recoverable modes of {rank}; {tail}",
    )


def not_told(chance: float, least: str) -> Flag:
    """W318: noise alone explains as much with this chance; `least` in words are the loads that would have been told."""
    return Flag(
        "W318",
        Evidence("chance that noise alone explains as much", float(chance), CHANCE),
        f"no load is told from noise: {least} would have been (95 %)",
        effect=1.0,
    )


def window_missed(
    ratio: float, threshold: float, outside: float, windows: Sequence[tuple[float, float]],
    found: Sequence[tuple[float, float]],
) -> Flag:  # fmt: skip
    """W319: windows of a load leave `ratio` times the residual of a load at any time, which lies in `found` (s)."""

    def said(pairs: Sequence[tuple[float, float]]) -> str:
        return ", ".join(f"{1e3 * a:.6g} to {1e3 * b:.6g} ms" for a, b in pairs)

    ends = [(round(a, 9), round(b, 9)) for a, b in found]
    python = f"support={ends[0] if len(ends) == 1 else ends}"
    words = " ".join(f"--support {a:.10g}:{b:.10g}" for a, b in ends)
    return Flag(
        "W319",
        Evidence("residual with the windows over that without", float(ratio), threshold),
        f"the window ({said(windows)}) misses the load: without it the residual is {ratio:.3g} times smaller, and the "
        f"load lies at {said(found)}, {outside:.0%} of its energy outside the window",
        Advice("take the window that the data ask for (", Spelling(python, words), "), or none"),
        effect=float(ratio),
    )


def over_smoothed(
    edf: float | None,
    plateau: int,
    bias: float | None = None,
    resultant: ArrayLike | None = None,
    measured: ArrayLike | None = None,
    std: ArrayLike | None = None,
    labels: Sequence[str] = (),
) -> Flag | None:
    """W310: lambda is so large that even resultants are biased.

    Parameters
    ----------
    edf : float or None
        Effective degrees of freedom, per frame.
    plateau : int
        Recoverable modes.
    bias : float, optional
        What this lambda would take from a resultant of the estimated load, over the std of that. Where the load is one
        of the prior's it is beyond 3 in less than 0.3 % of all cases: (R - I) g has the covariance P R, P that of the
        posterior.
    resultant, measured, std : array, shape (R,), optional
        Resultants of the estimate that were not imposed, measured ones, and the std of their difference.
    labels : sequence of str
        Names of the resultants.
    """
    if resultant is not None and measured is not None and std is not None:
        off = np.abs(np.subtract(resultant, measured)) / np.maximum(np.asarray(std, float), np.finfo(float).tiny)
        k = int(np.argmax(off))
        if np.ravel(off)[k] > 3:
            name = labels[k] if len(labels) > k else "the resultant"
            ours, theirs = float(np.ravel(resultant)[k]), float(np.ravel(measured)[k])
            return Flag(
                "W310",
                Evidence("distance in standard deviations", float(np.ravel(off)[k]), 3.0),
                f"lambda is so large that even the resultant is biased: {name} {ours:.4g}, measured {theirs:.4g}",
                "lower lambda, or impose the resultant as a constraint; else look for a gain error of the model",
            )
    if edf is None or bias is None or not bias > 3:
        return None
    return Flag(
        "W310",
        Evidence("bias of the resultant over its std", float(bias), 3.0),
        f"lambda is so large that even the resultant is biased: {edf:.2g} effective degrees of freedom are left of "
        f"{plateau} recoverable modes",
        effect=float(bias),
    )


def index_offset(ratio: float, load: str, shift: int | None) -> InputError:
    """E506: the first sample of the impulse response is zero and no shift helps."""
    return InputError(
        f"the impulse response of load {load} has no usable diagonal: |h(0)| is {ratio:.2g} of its maximum "
        "and no shift helps",
        where="deconvolution",
        found="a zero impulse response" if shift is None else f"first usable sample {shift}",
        expected="a response that begins within the record",
        hint="check sensors and loads; a first-order hold gives displacement an answer at once",
        code="LID-E506",
    )


def overridden(code: str, what: str, value: float, threshold: float) -> Flag:
    """A refusal (E506, E306) that the user allowed: it stays as a flag on everything made from the result."""
    return Flag(
        code,
        Evidence(what, value, threshold),
        f"refused by default, allowed by the user: {what} is {value:.3g}",
        "do not use the result where this matters",
    )


MEMORY = 0.01  # share of the first response that may be left at the end of a record
UNSEEN = 1e-8  # static over dynamic gain that is rounding
PRESENT = 0.05  # share of the largest response from which the first sample is no rest
SHORTEST, PULSE, REACHES = 32, 0.2, 0.3  # samples that tell; share of them in pulses; of the largest load at the end
UNREST = 5.0  # times the misfit that chance removes per free motion
VISIBLE = 0.02  # share of the largest response from which a motion matters
MOVING = 0.03  # share of the largest response that may be there at the end of a record on the FFT path


def memory(
    decay_rate: float | None, duration: float, h: NDArray[Any] | None = None, frequencies: NDArray[Any] | None = None,
    *, periodic: bool = False,
) -> Flag | None:  # fmt: skip
    """W505: the record is shorter than the memory of the structure, as with light damping.

    A note where the record starts at rest and is inverted as it is; `periodic` transforms need the response to end.

    The share of the response left after the record is exp(-decay_rate * duration) where the model knows its slowest
    decay, else the largest value in the last twentieth of the impulse response over the largest of all. The natural
    frequencies (Hz) tell how many periods of the lowest one the record holds.
    """
    if decay_rate is not None:
        left = float(np.exp(-decay_rate * duration))
    elif h is not None and len(h) >= 8:
        level = np.abs(h).reshape(len(h), -1)
        end = level[-max(len(h) // 20, 2) :].max(axis=0)
        left = float(np.max(end / np.maximum(level.max(axis=0), np.finfo(float).tiny)))
    else:
        return None
    if left <= MEMORY:
        return None
    return Flag(
        "W505",
        Evidence("response left after the record", left, MEMORY),
        f"the record is shorter than the memory: {left:.1%} of the response is left at its end, so "
        f"{'start and end are contaminated' if periodic else 'any motion from before it would come out as load'}"
        f"{_periods(frequencies, duration)}",
        Advice(
            f"record longer{_enough(decay_rate, duration)}, begin before the load, or take the start as unknown (",
            Option("initial", "unknown"),
            ", state-space models)",
        ),
        state=not periodic,
    )


def cut_off(found: Flag | None, load: NDArray[Any], std: NDArray[Any]) -> Flag | None:
    """W505 of a pulse that reaches the end of a record shorter than the memory: the rest of it is not seen.

    Parameters
    ----------
    found : Flag or None
        What `memory` says of the record.
    load, std : array, shape (samples, loads)
    """
    if found is None or len(load) < SHORTEST:
        return found
    size = np.abs(load)
    largest = np.maximum(size.max(axis=0), np.finfo(float).tiny)
    end = max(len(load) // 50, 4)
    clear = np.where(size[-end:] > 3 * std[-end:], size[-end:], 0.0).max(axis=0) / largest
    pulse = np.mean(size > 0.2 * largest, axis=0) < PULSE
    worst = float(np.max(np.where(pulse, clear, 0.0)))
    if worst < REACHES:
        return found
    return Flag(
        "W505",
        Evidence("load at the end of the record over its largest", worst, REACHES),
        "a pulse of the load reaches the end of the record, and its response does not: what is shown there is a guess; "
        f"{found.message}",
        found.advice,
    )


def _periods(frequencies: NDArray[Any] | None, duration: float) -> str:
    """How many periods of the lowest mode a record holds, where they are few."""
    moving = np.asarray([] if frequencies is None else frequencies, float)
    moving = moving[moving > 0]
    if not len(moving) or moving.min() * duration >= FEW:
        return ""
    return f"; it holds {moving.min() * duration:.2g} periods of the lowest mode ({moving.min():.4g} Hz)"


def _enough(decay_rate: float | None, duration: float) -> str:
    """How long a record must be until the response is gone."""
    if decay_rate is None:
        return ""
    if decay_rate <= 0:
        return " (an undamped motion never ends: state the damping of the model)"
    return f" ({-np.log(MEMORY) / decay_rate:.3g} s instead of {duration:.3g} s)"


def drifting(share: NDArray[Any], loads: Sequence[str], sensors: Sequence[str], penalty: str) -> Flag | None:
    """W517: no sensor sees a constant load, and the penalty leaves it free.

    Parameters
    ----------
    share : array, shape (loads,)
        Static gain over the dynamic one of each load, for the sensor where that is most.
    penalty : str
        Name of a difference: its null space holds the constants.
    """
    blind = np.flatnonzero(np.asarray(share) < UNSEEN)
    if not len(blind):
        return None
    names = ", ".join(loads[j] for j in blind[:8]) + (", ..." if len(blind) > 8 else "")
    return Flag(
        "W517",
        Evidence("static gain over dynamic gain", float(np.max(np.asarray(share)[blind])), UNSEEN),
        f"no sensor ({', '.join(sensors[:8])}{', ...' if len(sensors) > 8 else ''}) sees a constant part of {names}, "
        f"and the {penalty} leaves it free: the mean drifts, and its std grows with the length of the record",
    )


def in_motion(found: Start | None) -> Flag | None:
    """W518: the record does not start at rest, or the load is there before it: also what a wrong index offset shows."""
    if found is None or found.first < PRESENT or found.share < VISIBLE or found.gain < UNREST * found.motions:
        return None
    return Flag(
        "W518",
        Evidence("misfit of the start that motion before it removes, per motion", found.gain / found.motions, UNREST),
        f"the record starts in motion: its first sample holds {found.first:.0%} of the largest response, and loads "
        "within the record do not explain it; a model at rest puts this into the load",
    )


def unfinished(values: NDArray[Any], residual: NDArray[Any]) -> Flag | None:
    """W505 for padded transforms: the record ends while the structure still moves, whatever moves it.

    Judged by the last fiftieth of each channel (samples, sensors) against its maximum and against its residual.
    """
    end = np.sqrt(np.mean(values[-max(len(values) // 50, 8) :] ** 2, axis=0))
    largest, noise = np.abs(values).max(axis=0), np.sqrt(np.mean(residual**2, axis=0))
    share = np.where(end > 3 * noise, end / np.maximum(largest, np.finfo(float).tiny), 0.0)
    if share.max() <= MOVING:
        return None
    return Flag(
        "W505",
        Evidence("motion at the end over the largest", float(share.max()), MOVING),
        f"the record ends in motion: {share.max():.1%} of the largest response is there at its end, which the padded "
        "transform takes for a jump to zero",
        "record until the structure rests, or cut the record into windows that the dense path takes",
    )


def aliased(frequencies: NDArray[Any] | None, dt: float) -> Flag | None:
    """W509: modes of the model above the Nyquist frequency of the record."""
    if frequencies is None:
        return None
    count, nyquist = int(np.sum(np.asarray(frequencies) > 0.5 / dt)), 0.5 / dt
    if count == 0:
        return None
    return Flag(
        "W509",
        Evidence("highest natural frequency, Hz", float(np.max(frequencies)), nyquist),
        f"{count} modes lie above the Nyquist frequency {nyquist:.4g} Hz and are aliased in the sampled response",
    )


NEGLIGIBLE = 0.01  # share of the std that the windows may leave open


def windows_apart(share: float) -> Flag | None:
    """W410: the windows were stopped while the load could still differ from that of the record in one piece.

    Parameters
    ----------
    share : float
        Bound on that difference over the std, both as norms over all samples and loads.
    """
    if not share > NEGLIGIBLE:
        return None
    return Flag(
        "W410",
        Evidence("bound on the error of the windows over the std", float(share), NEGLIGIBLE),
        f"the record was solved in windows; the load can differ from that of the record in one piece by up to "
        f"{share:.2g} of its std",
        Advice(
            Option("path", "toeplitz", within="choice=Lambda"),
            " solves it in one piece; a larger lambda makes the windows forget their ends sooner",
        ),
    )


def between_gauges(share: float, apart: float) -> Flag | None:
    """W320: a load with detail between the gauges, which its smooth part does not explain.

    Parameters
    ----------
    share : float
        Probability of a load that is as strong at wavelengths down to the distance of the gauges and beyond.
    apart : float
        That distance, m.
    """
    if not share > LIKELY:
        return None
    return Flag(
        "W320",
        Evidence("probability of a load with such detail", float(share), LIKELY),
        f"the readings ask for a load with detail as narrow as the distance of the gauges, {apart:.2g} m: its peaks "
        "are smoothed, and what lies between the gauges is in the band only",
    )


def undetermined_field(rank: int, loads: int, sensors: int, samples: int) -> NotIdentifiable:
    """E514: the sensors do not tell so many places apart, and nothing was said of the field between them.

    Parameters
    ----------
    rank : int
        Combinations of the loads that the sensors tell apart at a frequency, at most.
    loads, sensors, samples : int
        Unknowns of one sample; what is measured, and how often.
    """
    return NotIdentifiable(
        f"the load is unknown in space and time: {sensors} sensors tell {rank} of {loads} places apart, so that the "
        f"stacked operator has rank {rank * samples} for {loads * samples} unknowns, nullity "
        f"{(loads - rank) * samples}",
        advice=f"a low-order basis of at most {rank} loads (bases.hats, bases.polynomials, shapes=), a spatial prior "
        "(space='gradient'), or more sensors",
        code="LID-E514",
    )
