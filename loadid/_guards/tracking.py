"""Guards of online tracking: what the sensors cannot show and which would, settings, what innovations say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from structures._advice import Advice, Spelling
from structures._flags import Evidence, Flag
from structures._model import Model
from structures._models.assembly import columns
from structures.errors import NotIdentifiable

from .._inverse.gaussian.model import FilterModel
from .._inverse.gaussian.observe import UNSEEN, Observability

MOST_CANDIDATES = 200_000  # degrees of freedom beyond which the best of an even selection is named


@dataclass(frozen=True)
class Cure:
    """A displacement sensor that is not there.

    Parameters
    ----------
    dof : str
        Where, ``"10+X"``.
    moves : float
        By how much (m) the load that is unseen, at one of its sizes, moves it for ever.
    """

    dof: str
    moves: float

    def __str__(self) -> str:
        return f"a displacement sensor at {self.dof}, which the unseen load moves by {self.moves:.3g} m"


def cures(model: Model, unseen: NDArray[np.float64], scale: NDArray[np.float64]) -> tuple[Cure, ...]:
    """The displacement sensors that together show every load that leaves no static trace, the best first.

    Parameters
    ----------
    model : Model
        A `ForwardModel` has places to offer; others have none.
    unseen : array, shape (p, r)
        Directions of the loads, in their sizes: `Observability.lacking`.
    scale : array, shape (p,)
        Sizes of the loads.

    Returns
    -------
    tuple of Cure
        As many as directions; empty where the model names no places, moves freely, or its loads move.

    Notes
    -----
    Greedy choice by column-pivoted QR of the static responses, as in P. Businger, G. H. Golub, "Linear least squares
    solutions by Householder transformations", Numerische Mathematik 7 (1965) 269-276.
    """
    from scipy.linalg import qr

    if model.structure is None or model.moving or not unseen.shape[1]:
        return ()
    structure = model.structure
    free = [i for i, index in enumerate(structure.free) if abs(structure.dofs[index].direction) <= 3]
    free = free[:: 1 + len(free) // MOST_CANDIDATES]
    B = columns(structure, model.loads if model.basis is None else model.basis)
    try:
        if (factor := model.factor) is None:
            return ()
        moved = factor.solve(B @ (np.asarray(scale, float)[:, None] * unseen))[free]
    except NotIdentifiable:
        return ()
    pivots = qr(moved.T, mode="r", pivoting=True)[1]
    chosen = [int(i) for i in pivots[: unseen.shape[1]]]
    found = [Cure(str(structure.dofs[structure.free[free[i]]]), float(np.linalg.norm(moved[i]))) for i in chosen]
    return tuple(cure for cure in found if cure.moves > 0)


Array = NDArray[np.float64]

CALM, RESTLESS = 0.8, 1.25  # mean NIS per channel that a filter with the right variances has
BIASED = 4.0  # standard errors (19 degrees) by which a mean innovation may leave zero: 1 false alarm in 1200 channels
PIECES = 20  # of a record, whose means tell the standard error of the whole where innovations are correlated
HIDING = 1.0  # noise sds that the state noise of one mode may be worth at a sensor
SHARE = 0.2  # of a record that the filter may take to settle
FEW, OFTEN = 10, 2e-3  # channel samples beyond a gate before it is said, and their share
MOST = 4  # channels that are named with them
AGREE = 0.8  # least share of a channel inside the 95 % band that the others predict
BLIND, LONG_BLIND = 0.5, 1000  # share of the time, and samples, from which a blind watch is said
FAR = 100.0  # times the load of the fit (40 dB) of an event: tuned in the wind and then hit with a hammer is less
STAYS = 3.0  # times the largest load of the fit
SHIFTED = (
    8.0  # standard errors of a mean in service: asked at every block, so that 4 would come by chance in a long day
)
LOUD, MORE = 2.0, 1.25  # power over that of a right filter (5 stds of one channel), and over the largest of the fit
LONG = 40  # samples below which a mean of innovations is not judged


def drifting(observed: Observability, cures: Sequence[Cure] = ()) -> Flag | None:
    """E501: something that never dies out is seen by no sensor, a load as a rule: its mean drifts, its std grows."""
    unseen = observed.drifting or observed.unseen
    if not unseen:
        return None
    names = " and ".join(s.name for s in unseen)
    static = observed.static_rank
    told = "" if static is None else f"; the sensors show the constant part of {static} of {len(observed.loads)} loads"
    few = observed.sensors < len(observed.loads)
    if few:
        told += f", and are fewer ({observed.sensors})"
    if observed.drifting:
        what = f"no sensor sees a constant force ({names}): the mean will drift and the std will grow"
    else:
        what = f"no sensor sees the motion of {names}: its state drifts"
    return Flag(
        "E501",
        Evidence("smallest singular value of [F - lam I; H]", unseen[0].sigma, UNSEEN),
        f"{what} (singular value {unseen[0].sigma:.1g}){told}",
        Advice(
            f"add {_cure(cures)}; or take a prior that returns to zero (OU, Matern); or accept a drift with its",
            " growing std (",
            Spelling("allow=['LID-E501']", "--allow-drift"),
            ")",
        ),
    )


def _cure(cures: Sequence[Cure]) -> str:
    if not cures:
        return "one displacement or strain channel that sees the load at 0 Hz for each load that none sees"
    return " and ".join(str(cure) for cure in cures)


def refused(flag: Flag | None, allow_drift: bool) -> Flag | None:
    """The drift as a refusal, or as a flag that stays where the user allows it.

    Raises
    ------
    NotIdentifiable
        E501, unless allowed.
    """
    if flag is not None and not allow_drift:
        raise NotIdentifiable(f"{flag.message} [{flag.evidence}]", advice=flag.advice, code=flag.code)
    return flag


def supposed(observed: Observability, cures: Sequence[Cure] = ()) -> Flag | None:
    """W519: the filter holds, but the constant part of a load comes from its prior alone."""
    if observed.static is None or observed.drifting or observed.static_rank == len(observed.loads):
        return None
    return Flag(
        "W519",
        Evidence("loads whose constant part the sensors show", float(observed.static_rank or 0), len(observed.loads)),
        f"no sensor sees the constant part of the loads ({observed.static_rank} of {len(observed.loads)} seen): what "
        "the track says of it, and its std there, is the prior",
        f"add {_cure(cures)}, or read the track above the slowest frequency of its prior only",
    )


def slow(time_constant: float, duration: float) -> Flag | None:
    """W520: the filter takes a good part of the record to settle; durations in s."""
    if time_constant <= SHARE * duration:
        return None
    return Flag(
        "W520",
        Evidence("time constant of the filter, s", float(time_constant), SHARE * duration),
        f"the filter forgets its start with a time constant of {time_constant:.3g} s, in a record of {duration:.3g} s",
    )


def kept_out(
    gated: int, taken: int, steps: int, believed: int = 0, channels: Mapping[str, int] | None = None
) -> Flag | None:
    """W521: more than single samples are beyond the gate: a sensor is off, or the load is none that the prior knows.

    Parameters
    ----------
    gated, taken : int
        Channel samples that were kept out, and all.
    steps : int
        Events of the load that were taken up: steps, impacts.
    believed : int
        Channel samples beyond the gate that were not kept out, as it had been set aside.
    channels : mapping of str to int, optional
        Samples beyond the gate of each channel.
    """
    share = (gated + believed) / max(taken, 1)
    if gated + believed < FEW or share <= OFTEN:
        return None
    most = sorted((n, name) for name, n in (channels or {}).items() if n)[::-1]
    named = f" ({', '.join(f'{n} of {name}' for n, name in most[:MOST])})" if most else ""
    aside = f", set itself aside and believed {believed}" if believed else ""
    return Flag(
        "W521",
        Evidence("share of the channel samples beyond the gate", share, OFTEN),
        f"the gate kept {gated} of {taken} channel samples out and took {steps} events of the load up{aside}{named}: "
        "a sensor is broken or has an offset, or the model does not fit where the load moves in ways that its prior "
        "does not know",
    )


def beyond_the_fit(size: float, times: float = 0.0) -> Flag | None:
    """W526: an event of the load was taken up that is far beyond what the fit saw, or the load stays there.

    Parameters
    ----------
    size : float
        Largest event that was taken up, over the one that makes the load as large as its prior says.
    times : float
        Largest load that stayed beyond that of the fit, over it; 0 where none did.
    """
    if times:
        return Flag(
            "W526",
            Evidence("largest load over that of the fit", float(times), STAYS),
            f"the load came to {times:.3g} times the largest of the fit and stayed: it is that large, or a sensor that "
            "alone sees its slow part is wrong; the band holds both",
        )
    if size <= FAR:
        return None
    return Flag(
        "W526",
        Evidence("largest event over the load of the fit", float(size), FAR),
        f"the gate took up an event that moves the load by {size:.3g} times the std that it had at the fit",
    )


def moved_off(errors: Array, sensors: Sequence[str]) -> Flag | None:
    """W527: innovations in service have a mean; `errors` (sensors,) are its standard errors."""
    wrong = [i for i in np.argsort(-np.abs(errors)) if abs(errors[i]) > SHIFTED]
    if not wrong:
        return None
    listed = ", ".join(f"{sensors[i]} ({errors[i]:+.3g})" for i in wrong)
    return Flag(
        "W527",
        Evidence("standard errors of the mean innovation in service", float(errors[wrong[0]]), SHIFTED),
        f"the innovations of channel {listed} lie so many standard errors off zero in service: an offset?",
    )


def louder(most: float, usual: float) -> Flag | None:
    """W534: innovations are larger, or more alike, than the filter says (`Loudness`); `usual`: at the fit."""
    limit = max(LOUD, MORE * usual)
    if most <= limit:
        return None
    return Flag(
        "W534",
        Evidence("power of the innovations in service over what the filter says", float(most), limit),
        f"the innovations in service have {most:.3g} times the power that the filter says, and at the fit at most "
        f"{usual:.3g} times: the loads are larger or move otherwise than those of the fit, or the model is off by more "
        "than the noise; the band is that of the fit, and too narrow",
    )


def faulty(faults: Sequence[tuple[str, str | None, str, int]], acts: bool = True) -> Flag | None:
    """W528: sensors that were found wrong in service.

    Parameters
    ----------
    faults : sequence of (channel, the one that it is swapped with, what it does, samples before it was named)
    acts : bool
        It is kept out, two that are swapped are taken the other way round.
    """
    if not faults:
        return None
    listed = "; ".join(
        f"{channel} ({kind}, sample {sample})" if other is None else f"{channel} and {other} (swapped, sample {sample})"
        for channel, other, kind, sample in faults[-MOST:]
    )
    done = "kept out from there on, or taken the other way round" if acts else "believed all the same (gate=None)"
    return Flag(
        "W528", Evidence("channels named in service", float(len(faults)), 0.0), f"wrong in service: {listed}; {done}"
    )


def unlike_the_fit(samples: int, loudest: float, suspects: Sequence[str] = ()) -> Flag | None:
    """W529: samples in service that the model does not explain, nor one wrong channel for sure; `loudest` of the fit.

    `suspects`: channels any of which may have been the wrong one; none where no single one explains the samples.
    """
    if not samples:
        return None
    if suspects:
        return Flag(
            "W529",
            Evidence("samples in service that do not fit", float(samples), 0.0),
            f"for {samples} samples the innovations were larger than in any part of the record of the fit (there at "
            f"most {loudest:.3g} times their mean): one of {', '.join(suspects)} is wrong, or the structure has "
            "changed, and the samples do not tell which; the band holds what the others say without each of them",
        )
    return Flag(
        "W529",
        Evidence("samples in service that do not fit", float(samples), 0.0),
        f"for {samples} samples the innovations were several times larger than in any part of the record of the fit "
        f"(there at most {loudest:.3g} times their mean), and no single channel explains it: the structure has "
        "changed or started anew, several sensors are wrong, or a load acts that the model lacks; the loads are "
        "those of all channels, and their band knows nothing of it",
    )


def blind(samples: int, taken: int) -> Flag | None:
    """N531: samples of which the watch over the sensors tells nothing, as cells are missing, of all that it took."""
    if samples < LONG_BLIND or samples <= BLIND * taken:
        return None
    return Flag(
        "N531",
        Evidence("share of the samples of which the watch tells nothing", samples / taken, BLIND),
        f"for {samples} of {taken} samples cells were missing that the watch over the sensors needs: it has named no "
        "wrong sensor there, and would not have",
    )


def started_in_motion(gain: float, threshold: float) -> Flag:
    """N532: the first samples are more likely (logarithm `gain`) where the structure moves than where it rests."""
    return Flag(
        "N532",
        Evidence("logarithm of the likelihood of the first samples over that of a start at rest", gain, threshold),
        "the record starts in motion: the first states are found with the loads, and the band of the first samples "
        "holds what is not known of them",
    )


def other_model(before: str, now: str) -> Flag | None:
    """W522: a tracker goes on with another model than the one that it was certified with (fingerprints)."""
    if before == now:
        return None
    return Flag(
        "W522",
        Evidence("model", now[:12], before[:12]),
        "the filter goes on with another model than the one it was fitted and certified with: priors and noises are "
        "those of the fit, the certificate is not of this model",
    )


def undetermined(names: Sequence[str]) -> Flag | None:
    """W523: numbers of a prior that ended at a bound of their search (`names`): the record does not tell them."""
    if not names:
        return None
    return Flag(
        "W523",
        Evidence("numbers at a bound of the search", float(len(names)), 0.0),
        f"the record does not tell {', '.join(names)}: the search ended at its bound, a length at ten records",
    )


def spoilt(wrong: Sequence[int], sensors: Sequence[str]) -> Flag | None:
    """W524: single samples of the record of a fit that no load explains; how many of each channel."""
    if not any(wrong):
        return None
    listed = ", ".join(f"{n} of {name}" for n, name in zip(wrong, sensors, strict=True) if n)
    return Flag(
        "W524",
        Evidence("wrong samples in the record of the fit", float(sum(wrong)), 0.0),
        f"single samples that no load explains were left out of the tuning: {listed}",
    )


def believed(dummy: float | None) -> Flag | None:
    """W525: displacements near zero are believed, not measured; `dummy` is their std in m."""
    if dummy is None:
        return None
    return Flag(
        "W525",
        Evidence("std of the displacements that are believed, m", float(dummy), "measured"),
        f"the mean of the loads rests on the belief that displacements stay near zero within {dummy:.3g} m at every "
        "sample: a prior, not data; it draws static loads to zero and the band does not know by how much",
    )


def untuned(nis: float, *, tuned: bool) -> Flag | None:
    """W502: the variance of the load was not tuned, or does not fit: mean NIS per channel, and whether a sweep ran."""
    if tuned and CALM <= nis <= RESTLESS:
        return None
    why = "" if tuned else ", and no likelihood or sweep chose the prior"
    return Flag(
        "W502",
        Evidence("mean NIS per channel", float(nis), f"{CALM:g} to {RESTLESS:g}, tuned"),
        f"NIS per channel is {nis:.3g}{why}: the track and its band cannot be trusted",
    )


def unbalanced(model: FilterModel, state_noise: Array | float, states: Sequence[str] = ()) -> Flag | None:
    """W503: one number for the noise of all states, which in some mode is worth more than the noise of a sensor.

    Parameters
    ----------
    model : FilterModel
    state_noise : float or array (nx,)
        Std that a sample adds to each state of the structure.
    states : sequence of str, optional
        Their names.
    """
    from scipy.linalg import solve_triangular

    sd = np.broadcast_to(np.asarray(state_noise, float), (model.nx,))
    if model.nx < 2 or np.ptp(sd) > 1e-12 * sd.max():
        return None  # balanced by hand
    worth = np.abs(solve_triangular(model.LR, model.H[:, : model.nx], lower=True)) * sd
    state = int(np.argmax(worth.max(axis=0)))
    largest = float(worth.max())
    if largest <= HIDING:
        return None
    name = states[state] if state < len(states) else f"state {state}"
    return Flag(
        "W503",
        Evidence("state noise over sensor noise", largest, HIDING),
        f"the same state noise for all states is worth {largest:.3g} times the noise of sensor "
        f"{int(np.argmax(worth[:, state]))} in {name}: NIS will look safe and hide a bias",
    )


def overconfident(nis: float, innovations: Array, sensors: Sequence[str]) -> Flag | None:
    """W504: innovations larger than the filter says, or a channel whose innovations have a mean.

    Parameters
    ----------
    nis : float
        Mean NIS per channel.
    innovations : array (samples, m)
        Over their std; NaN where a channel was missing.
    sensors : sequence of str
    """
    z = biases(innovations)
    order = np.argsort(-np.abs(z))
    wrong = [i for i in order if abs(z[i]) > BIASED]
    if nis <= RESTLESS and not wrong:
        return None
    if wrong:
        listed = ", ".join(f"{sensors[i]} ({z[i]:+.3g})" for i in wrong)
        found = Evidence("standard errors of the mean innovation", float(z[wrong[0]]), BIASED)
        what = f"innovations are biased on channel {listed}, in standard errors of their mean"
    else:
        found = Evidence("mean NIS per channel", float(nis), RESTLESS)
        what = f"the filter is overconfident: NIS per channel is {nis:.3g}"
    return Flag(
        "W504", found, what,
    )  # fmt: skip


def contradicting(left_out: Sequence[float | None], sensors: Sequence[str]) -> Flag | None:
    """W530: channels that are not where the others say, by the model: shares inside the 95 % band of it."""
    wrong = sorted((s, name) for s, name in zip(left_out, sensors, strict=True) if s is not None and s < AGREE)
    if not wrong:
        return None
    listed = ", ".join(f"{name} {share:.0%}" for share, name in wrong[:MOST])
    return Flag(
        "W530",
        Evidence("share in the band that the other sensors predict", float(wrong[0][0]), AGREE),
        f"the sensors contradict each other by this model (inside the 95 % band from the others: {listed}): the model "
        "is wrong by more than the noise, and the band does not hold for sure",
    )


def biases(innovations: Array) -> Array:
    """Mean of each channel's innovations in its standard errors (m,), from means of pieces; 0 where there are too few.

    Innovations of a filter whose prior is rough are correlated: the spread of pieces tells the error of the mean, where
    the spread of samples does not.
    """
    out = np.zeros(innovations.shape[1])
    for i, channel in enumerate(innovations.T):
        there = channel[np.isfinite(channel)]
        if len(there) < LONG:
            continue
        means = np.array([piece.mean() for piece in np.array_split(there, PIECES)])
        error = max(means.std(ddof=1), np.finfo(float).tiny) / np.sqrt(PIECES)
        out[i] = there.mean() / error
    return out
