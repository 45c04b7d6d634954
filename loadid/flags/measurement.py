"""Guards of the measurement."""

from __future__ import annotations

from collections.abc import Sequence

from structures.channels import Channel
from structures.flags import Evidence, Flag

CORRELATED = 0.5  # effective over nominal number of data


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
        "add sensors, shrink the load basis, or state the prior",
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
        "restore the channels, or accept the smaller identifiable space",
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
        "give noise= per channel, or record a quiet segment before the load",
    )


def high_pass(channels: Sequence[Channel], duration: float) -> Flag | None:
    """W205: every channel is AC-coupled and the record reaches below the corners."""
    corners = [c.highpass for c in channels]
    if not corners or any(c is None for c in corners):
        return None
    corner, lowest = min(c for c in corners if c is not None), 1 / duration
    if lowest >= corner:
        return None
    return Flag(
        "W205",
        Evidence("lowest frequency of the record, Hz", lowest, corner),
        f"every channel is AC-coupled: the static part of the load is unobservable below {corner:.3g} Hz",
        "add a strain or displacement sensor that sees 0 Hz, or do not read the mean of the load",
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
        "invert on the raw markers; the covariance given here was whitened on its range",
    )
