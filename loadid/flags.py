"""The guards of measuring and inverting: each takes numbers and returns a flag, or None."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.channels import Channel
from structures.errors import InputError
from structures.flags import Evidence, Flag

from .codes import known_codes
from .inverse.choice import Choice

MEMORY = 0.01  # share of the first response that may be left at the end of a record
MOVING = 0.03  # share of the largest response that may be there at the end of a record on the FFT path
DECADE = 1.0  # spread of the rules, decades
COVERED = 0.05  # how far the share inside a band may lie below its level
SIGMA_RULES = ("discrepancy", "dof_discrepancy", "upre", "predicted_error", "evidence")
GCV_RULES = ("gcv", "robust_gcv", "modified_gcv", "predicted_error")
FLAT = 1.05  # GCV: highest over lowest within half a decade
KNOWN_SOURCES = (
    "quiet segment",
    "unloaded record",
    "repeatability",
    "covariance",
    "data sheet",
    "residual",
    "roughness",
)


def collect(flags: Iterable[Flag | None]) -> tuple[Flag, ...]:
    """The flags that were raised, without repeats, in order."""
    seen: dict[tuple[str, str], Flag] = {}
    for flag in flags:
        if flag is not None:
            seen.setdefault((flag.code, flag.message), flag)
    return tuple(seen.values())


def allowed(codes: Sequence[str]) -> tuple[str, ...]:
    """Codes that a user allows, in full form.

    Raises
    ------
    InputError
        If one of them is no guard code.
    """
    if isinstance(codes, str):
        raise InputError("allow takes a list of codes", where="allow", found=repr(codes), expected=f"[{codes!r}]")
    return known_codes(codes)


# -- forward model ---------------------------------------------------------------------------------------------------
def not_verified(certificate: object | None) -> Flag | None:
    """W114: the forward model was never checked against a known load."""
    if certificate is not None:
        return None
    return Flag(
        "W114",
        Evidence("certificates", 0, 1),
        "forward model not verified: no residual and no parameter rule can find an error of the model",
        "hang a known mass or apply a measured hit, and call model.verify(load, response)",
    )


# -- measurement -----------------------------------------------------------------------------------------------------
def null_space(m: int, n: int, rank: int) -> Flag | None:
    """W201: the sensors leave part of the load without a trace."""
    if rank >= n:
        return None
    return Flag(
        "W201",
        Evidence("rank", rank, n),
        f"m = {m} data, n = {n} unknowns, rank r = {rank}, nullity {n - rank}: what lies in ker(H) leaves no trace "
        "in the data and is set by the prior",
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


# -- inversion -------------------------------------------------------------------------------------------------------
def resolution(nullity: int, prior: str, width: float, unit: str, bias: float | None = None) -> Flag:
    """N303: what regularisation did, always said."""
    null = f"{nullity} components in ker(H) are set by the prior ({prior}); " if nullity else ""
    peak = "" if bias is None else f"; a single-sample peak is shown at {1 - bias:.0%} of its height"
    return Flag(
        "N303",
        Evidence("resolution width", float(width), None),
        f"{null}nothing finer than {width:.3g} {unit} is resolved{peak}",
        "claim no detail below this width",
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


# -- parameter choice ------------------------------------------------------------------------------------------------
def parameter(choice: Choice, discrepancy: Callable[[float], float | None]) -> tuple[Flag, ...]:
    """W401, W402, W406 and W407 of one choice; `discrepancy` gives its lambda at a multiple of the noise level."""
    return collect([no_corner(choice), gcv_minimum(choice), noise_source(choice, discrepancy), disagreement(choice)])


def no_corner(choice: Choice) -> Flag | None:
    """W401: lambda was chosen by the L-curve, and it has no corner or one at the end of the sweep.

    Elsewhere that does no harm: well-conditioned problems have no corner, and the table of the rules says so.
    """
    found = next((r for r in choice.rules if r.rule == "l_curve"), None)
    if choice.rule != "l_curve" or found is None or (found.lam is not None and not found.edge):
        return None
    value = "none" if found.lam is None else found.lam
    return Flag(
        "W401",
        Evidence("lambda at the corner", value, "inside the sweep"),
        f"the L-curve has no usable corner ({found.note})",
        "use discrepancy or GCV",
    )


def gcv_minimum(choice: Choice) -> Flag | None:
    """W402: lambda was chosen by GCV or from it, and GCV sits at an end of the sweep or is flat around its minimum."""
    found = next((r for r in choice.rules if r.rule == "gcv"), None)
    if choice.rule not in GCV_RULES or found is None or found.lam is None:
        return None
    if choice.sweep is None or choice.sweep.gcv is None:
        return None
    near = np.abs(np.log10(choice.sweep.lam / found.lam)) <= 0.5
    G = choice.sweep.gcv[near]
    G = G[np.isfinite(G)]
    ratio = float(G.max() / G.min()) if len(G) else np.inf
    if not found.edge and ratio >= FLAT:
        return None
    if found.edge:
        evidence = Evidence("GCV lambda", found.lam, "inside the sweep")
        advice = "at the lower end the data ask for no regularisation; at the upper end they carry no information"
    else:
        evidence = Evidence("GCV max/min", ratio, FLAT)
        advice = "the response hardly depends on lambda here: compare the rules, and state the noise of the sensors"
    return Flag(
        "W402",
        evidence,
        f"GCV did not find a minimum (relative lambda {found.lam:.3g})",
        advice,
    )


def noise_source(choice: Choice, discrepancy: Callable[[float], float | None]) -> Flag | None:
    """W406: the noise level decides and nobody said where it comes from."""
    if choice.sigma is None or choice.rule not in SIGMA_RULES:
        return None
    if any(source in choice.sigma_source for source in KNOWN_SOURCES):
        return None
    values = ", ".join("none" if d is None else f"{d:.3g}" for d in map(discrepancy, (0.5, 1.0, 2.0)))
    return Flag(
        "W406",
        Evidence("source of the noise level", choice.sigma_source, "unloaded record, repeatability or covariance"),
        f"the noise level comes from {choice.sigma_source!r}; relative lambda at half, once and twice of it: {values}",
        "record the unloaded sensors for a minute, or name the source with noise_source=",
    )


def disagreement(choice: Choice) -> Flag | None:
    """W407: the rules lie more than a decade apart, or none found an optimum."""
    if choice.verdict not in ("rules disagree", "not determined"):
        return None
    found = {r.rule: r.lam for r in choice.rules if r.lam is not None and not r.edge}
    listed = ", ".join(f"{k} {v:.2g}" for k, v in found.items())
    return Flag(
        "W407",
        Evidence("spread of the rules, decades", float(min(choice.spread, 99.0)), DECADE),
        f"{choice.verdict}: {listed or 'no rule found an optimum'}",
        "suspect correlated noise or model error before trusting any; look at the path plot and verify the model",
    )


# -- dynamics --------------------------------------------------------------------------------------------------------
def memory(decay_rate: float | None, duration: float, h: NDArray | None = None) -> Flag | None:
    """W505: the record is shorter than the memory of the structure.

    The share of the response left after the record is exp(-decay_rate * duration) where the model knows its slowest
    decay, else the largest value in the last twentieth of the impulse response over the largest of all.
    """
    if decay_rate is not None:
        left = float(np.exp(-decay_rate * duration))
    elif h is not None and len(h) >= 40:
        level = np.abs(h).reshape(len(h), -1)
        left = float(np.max(level[-(len(h) // 20) :].max(axis=0) / np.maximum(level.max(axis=0), np.finfo(float).tiny)))
    else:
        return None
    if left <= MEMORY:
        return None
    return Flag(
        "W505",
        Evidence("response left after the record", left, MEMORY),
        f"the record is shorter than the memory: {left:.1%} of the response is left at its end, "
        "so start and end are contaminated",
        "record longer, begin before the load, or use a state-space method",
    )


def unfinished(values: NDArray, residual: NDArray) -> Flag | None:
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


def aliased(frequencies: NDArray | None, dt: float) -> Flag | None:
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
        "keep fewer modes (the static residual stands for the rest), or sample faster",
    )


# -- validation ------------------------------------------------------------------------------------------------------
def inverse_crime(simulated_by: str, fingerprint: str) -> Flag | None:
    """W702: the data were simulated with the model that inverts them."""
    if not simulated_by or simulated_by != fingerprint:
        return None
    return Flag(
        "W702",
        Evidence("model of the data", fingerprint[:12], "another mesh, other parameters"),
        f"same model {fingerprint[:12]} for data and inversion: the result is optimistic",
        "simulate with another mesh, 2-4 % of stiffness error and a finer step",
    )


def no_coverage(coverage: Any) -> Flag | None:
    """W703: a std is shown whose coverage nobody tested on this set-up, or whose band failed that test."""
    share, level = getattr(coverage, "share", None), getattr(coverage, "level", None)
    if share is None or level is None:
        return Flag(
            "W703",
            Evidence("coverage tests", 0, 1),
            "the std covers noise and prior as assumed; its coverage was not tested on this set-up",
            "run loadid.validate.coverage(...) with loads like yours and pass coverage=",
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
        "keep a record, or a channel, out of the model and of the inversion",
    )
