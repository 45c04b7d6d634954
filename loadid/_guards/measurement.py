"""Guards of the measurement, of the forward model and of the validation."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import Any

from structures._advice import Advice, Spelling
from structures._certificate import WRONG, Certificate
from structures._channels import Channel
from structures._flags import Evidence, Flag

from .._results.faults import SensorFault

CORRELATED = 0.5  # effective over nominal number of data
LOST = 0.5  # missing share of a channel
UNHEARD = 0.3  # relative error of a load, as far as its response was lost, from which on it is said
BESIDE_GAP = 1e-3  # share of the energy of a load about a gap, from which its hit may lie in it
APART = 1e-6  # singular values of the loads, smallest over largest, below which the difference is rounding
MOTION = ("velocity", "acceleration", "angular_velocity", "angular_acceleration")  # blind at 0 Hz


def null_space(m: int, n: int, rank: int, unseen: Sequence[str] = ()) -> Flag | None:
    """W201: the sensors leave part of the load without a trace; `unseen` names loads that no sensor sees at all."""
    if rank >= n:
        return None
    named = f"; no sensor sees {', '.join(unseen[:8])}{', ...' if len(unseen) > 8 else ''} at all" if unseen else ""
    return Flag(
        "W201",
        Evidence("rank", rank, n),
        f"m = {m} data, n = {n} unknowns, rank r = {rank}, nullity {n - rank}: what lies in ker(H) leaves no trace "
        f"in the data and is set by the prior, so that the answer is one of many{named}",
        state=not unseen,  # the band holds what the prior sets; a load that nobody sees is another matter
    )


def lost_channels(before: tuple[float, int, int], after: tuple[float, int, int], lost: Sequence[str]) -> Flag | None:
    """W202: conditioning looks better because channels were lost; arguments (kappa, rank, nullity)."""
    if not lost or not (after[0] < before[0] and after[2] > before[2]):
        return None
    return Flag(
        "W202",
        Evidence("nullity", after[2], before[2]),
        f"kappa fell from {before[0]:.3g} to {after[0]:.3g} because modes were lost with {', '.join(lost)}; rank fell "
        f"from {before[1]} to {after[1]}, nullity rose from {before[2]} to {after[2]}",
    )


def mixed_kinds(channels: Sequence[Channel], known: bool) -> Flag | None:
    """W204: sensors of different units without noise levels."""
    units = sorted({c.unit for c in channels})
    if known or len(units) < 2:
        return None
    return Flag(
        "W204",
        Evidence("units", ", ".join(units), "one unit, or a noise std for each"),
        f"{len(units)} kinds of sensor without noise levels: rows are not comparable; each was scaled by its own rms",
        state=True,
    )


def contradicting(fault: SensorFault) -> Flag:
    """W214 of a sensor that contradicts the others, W215 where they contradict each other and none can be named."""
    evidence = Evidence(
        "contradiction of the sensors, over what noise and errors of the model leave", fault.excess, 1.0
    )
    if fault.kind == "load":
        return Flag("W215", evidence, f"the sensors contradict each other: {fault}")
    if fault.kind == "one of":
        return Flag("W215", evidence, f"the sensors contradict each other: {fault}",
                    "check these channels (gain, polarity, unit, place, cable), or add a sensor")  # fmt: skip
    name, kept = fault.channels[0], ", ".join(fault.kept[:8]) + (", ..." if len(fault.kept) > 8 else "")
    mended = Spelling("estimate again from estimate.faults[0].correct(record)", "correct the channel in the file")
    dropped = Advice(Spelling(f"leave {name} out (sensors=estimate.faults[0].kept)", f"leave {name} out ({kept} stay)"))
    advice = (
        Advice("check the channel, then ", mended) if fault.correctable else Advice("check the channel, or ", dropped)
    )
    rest = f"; without that the others agree to {fault.without:.2g} of what noise and errors of the model leave"
    return Flag("W214", evidence, f"sensor fault: {fault}{rest}", advice)


def high_pass(channels: Sequence[Channel], duration: float, recorded: Sequence[Channel] = ()) -> Flag | None:
    """W205: no channel sees 0 Hz because of AC coupling, and the record reaches below the corners.

    Also where a channel was recorded AC-coupled and the model takes it for one that sees 0 Hz.

    Parameters
    ----------
    channels : sequence of Channel
        Sensors of the model that are used. Velocities and accelerations see no static load anyway.
    duration : float
        Of the record, s.
    recorded : sequence of Channel, optional
        Channels of the record, in the same order.
    """
    unknown = [r.label for c, r in zip(channels, recorded, strict=False) if r.highpass and not c.highpass]
    if unknown:
        corner = max(r.highpass for r in recorded if r.highpass)
        return Flag(
            "W205",
            Evidence("corner of the record that the model does not know, Hz", corner, 0.0),
            f"recorded AC-coupled, taken by the model for sensors that see 0 Hz: {', '.join(unknown)}; the slow part "
            "of the load comes out wrong",
            f"state the corner on the sensor of the model too: highpass={corner:.4g}",
        )
    corners = [c.highpass for c in channels if c.highpass or c.quantity not in MOTION]
    if not corners or any(c is None for c in corners):
        return None
    corner, lowest = min(c for c in corners if c is not None), 1 / duration
    if lowest >= corner:
        return None
    others = ", or sees motion only" if len(corners) < len(channels) else ""
    return Flag(
        "W205",
        Evidence("lowest frequency of the record, Hz", lowest, corner),
        f"every channel is AC-coupled{others}: the static part of the load is unobservable below {corner:.3g} Hz",
    )


def gaps(lost: Sequence[float], labels: Sequence[str]) -> Flag | None:
    """W210: more of a channel is missing than there; `lost` is the missing share of each channel."""
    worst = [(x, name) for x, name in zip(lost, labels, strict=True) if x > LOST]
    if not worst:
        return None
    said = ", ".join(f"{name} ({x:.0%})" for x, name in worst[:8]) + (", ..." if len(worst) > 8 else "")
    return Flag(
        "W210",
        Evidence("missing share of a channel", max(x for x, _ in worst), LOST),
        f"more than half of the samples are missing: {said}; the rest was used as it is",
    )


def lost_response(share: float) -> Flag | None:
    """W224: the load acts where samples are missing; `share` is that of the power of its response which fell there."""
    if share <= UNHEARD**2:
        return None
    return Flag(
        "W224",
        Evidence("share of the power of the response to the load that fell on missing samples", share, UNHEARD**2),
        f"samples are missing where the load acts: {share:.0%} of what its response would have told are lost, and a "
        "prior that expects the same load everywhere fills the gap with too little of it",
    )


def hit_beside_gap(share: float) -> Flag | None:
    """W224: a hit lies in a gap, or right beside it; `share` is that of the energy of the load there."""
    if share <= BESIDE_GAP:
        return None
    return Flag(
        "W224",
        Evidence("share of the energy of the load that lies in a gap or a pulse beside it", share, BESIDE_GAP),
        f"samples are missing where a hit acts, or right beside it: {share:.0%} of its energy is there, and what acted "
        "in the gap is told only by what rings on behind it",
        advice="record it again where its size matters",
    )


def not_apart(ratio: float, combination: Sequence[float], loads: Sequence[str], sensors: int) -> Flag | None:
    """W201: at no frequency do the sensors tell all loads apart.

    Parameters
    ----------
    ratio : float
        Smallest over largest singular value of the frequency response, columns of equal size, on the best line; zero
        where there are fewer sensors than loads.
    combination : sequence of float
        The combination of the loads that is seen least, of norm 1, over all lines.
    """
    if ratio >= APART:
        return None
    size = [abs(c) for c in combination]
    among = [name for name, s in zip(loads, size, strict=True) if s > 0.1 * max(size)]
    few = f"{len(loads)} loads, {sensors} sensor{'s' * (sensors > 1)}: " if sensors < len(loads) else ""
    return Flag(
        "W201",
        Evidence("loads told apart, smallest over largest singular value on the best line", ratio, APART),
        f"{few}at no frequency can the sensors tell apart the loads {', '.join(among[:8])}"
        f"{', ...' if len(among) > 8 else ''}: how the response is shared among them is set by the prior",
        "add a sensor that sees them differently, join them into one load, or read their sum only",
    )


def interpolated(m: int, effective: float, rank: int, dropped: float = 0.0) -> Flag | None:
    """W203: the noise of the data is correlated, as interpolation or filtering makes it.

    Parameters
    ----------
    m : int
        Nominal number of data.
    effective : float
        (tr C)^2 / tr(C^2) of their noise covariance, scaled to unit variances.
    rank : int
        Rank of C.
    dropped : float
        Share of the model, by its norm, outside the range of C: such responses cannot be read and were left out.
    """
    if rank == m and effective > CORRELATED * m:
        return None
    left = f"; {dropped:.1%} of the model lies outside what they can show and was left out" if dropped > 1e-6 else ""
    return Flag(
        "W203",
        Evidence("effective number of data", effective, CORRELATED * m),
        f"nominal m = {m}, effective m = {effective:.1f}, rank of the noise covariance {rank}: the data were "
        f"interpolated or filtered{left}",
    )


def not_verified(certificate: Certificate | None) -> Flag | None:
    """W114: the forward model was never checked against a known load, or failed that check."""
    if certificate is not None and certificate.wrong:
        told = zip(certificate.error, certificate.gain, certificate.sensors, strict=True)
        worst = max(x for x in told if x[2] in certificate.wrong)
        return Flag(
            "W114",
            Evidence("residual over response", worst[0], WRONG),
            f"forward model disagrees with {certificate.source} on {len(certificate.wrong)} of "
            f"{len(certificate.sensors)} sensors: residual {worst[0]:.0%} of the response at {worst[2]}, gain "
            f"{worst[1]:.3g}",
            "check signs, units and places of these sensors, then geometry and supports, and verify again",
        )
    if certificate is not None:
        return None
    return Flag(
        "W114",
        Evidence("certificates", 0, 1),
        "forward model not verified: no residual and no parameter rule can find an error of the model",
        state=True,
    )


COVERED = 0.05  # how far the share inside a band may lie below its level
NECESSARY = "Necessary, not sufficient: infinitely many maps share this resultant"


def resultant_only(levels: Collection[str], numbers: int, loads: int) -> Flag | None:
    """N701: nothing but resultants was compared, and they are fewer independent numbers than loads."""
    if "resultant" not in levels or "distribution" in levels or numbers >= loads:
        return None
    return Flag(
        "N701",
        Evidence("independent numbers compared", numbers, loads),
        f"level: resultant. {NECESSARY}",
    )


def inverse_crime(simulated_by: str, fingerprint: str) -> Flag | None:
    """W702: the data were simulated with the model that inverts them."""
    if not simulated_by or simulated_by != fingerprint:
        return None
    return Flag(
        "W702",
        Evidence("model of the data", fingerprint[:12], "another mesh, other parameters"),
        f"same model {fingerprint[:12]} for data and inversion: the result is optimistic",
    )


def no_coverage(coverage: Any) -> Flag | None:
    """W703: a std is shown whose coverage nobody tested on this set-up, or whose band failed that test."""
    share, level = getattr(coverage, "share", None), getattr(coverage, "level", None)
    if share is None or level is None:
        return Flag(
            "W703",
            Evidence("coverage tests", 0, 1),
            "the std covers noise and prior as assumed; its coverage was not tested on this set-up",
            state=True,
        )
    if share >= level - COVERED:
        return None
    return Flag(
        "W703",
        Evidence("share of the true samples inside the band", float(share), float(level - COVERED)),
        f"{coverage}: the stated std is too small on this set-up",
        "widen the band by what the test shows, or look for model error and a prior that does not fit such loads",
    )


def used_for_training(name: str, overlap: Iterable[str]) -> Flag | None:
    """W704: validation data that were used in the inversion or in making the model."""
    overlap = sorted(overlap)
    if not overlap:
        return None
    return Flag(
        "W704",
        Evidence("shared", ", ".join(o[:16] for o in overlap), "none"),
        f"{name} is in both training and validation ({len(overlap)} shared): the agreement proves nothing",
    )
