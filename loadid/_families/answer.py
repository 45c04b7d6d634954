"""One place where what a family computed becomes the answer: its facts, its flags, its grade and its history.

And what its sensors say of each other, in every family: what was measured as lines, and who contradicts the others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from structures._advice import Advice
from structures._channels import Channel
from structures._flags import Flag
from structures._model import Model
from structures.errors import NotIdentifiable

from .. import _guards as guards
from .._guards.inversion import windows_apart
from .._inverse.choice import Choice, ungraded
from .._inverse.diagnosis import identifiability
from .._inverse.diagnosis.faults import LineTimes, drifting, told_apart
from .._inverse.diagnosis.leave_one_out import FLOOR, LeftOut, SensorLines, left_out, unlikely
from .._inverse.diagnosis.suspects import prepared, suspect
from .._inverse.noise_level import residual_level, unexplained
from .._inverse.path import RegularizationPath, Solution
from .._results.estimate import Axis, LoadEstimate
from .._results.facts import Facts, provenance
from .._results.faults import SensorFault
from .noise import NoiseLevel

if TYPE_CHECKING:
    from .data import Data, Readings
    from .detection import NotTold
    from .posing.gathered import LineData

Array = NDArray[Any]
Measured: TypeAlias = "Data | Readings | LineData | Amplitudes"
UNDETERMINED = "LID-E306"


class LoadFamily(Protocol):
    """Who answers."""

    name: str
    model: Model
    coverage: Any

    @property
    def allow(self) -> Sequence[str]:
        """Guard codes whose refusal is overridden."""


@dataclass(frozen=True)
class Amplitudes:
    """Numbers without a record behind them, with what records, readings and lines tell of theirs."""

    channels: Sequence[Channel]
    rows: NDArray[np.int_]
    inputs: Mapping[str, str] = field(default_factory=dict)
    fingerprints: AbstractSet[str] = frozenset()
    simulated_by: str = ""
    findings: Sequence[Flag] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class SolvedLoad:
    """The numbers of an answer.

    Parameters
    ----------
    load, std : array
        The std without the bias.
    axis : Axis or None
    response, residual : array or None
    facts : Facts
    bias, posterior, spectrum, geometry, diagnosis
        As in `LoadEstimate`.
    excess : float or None
        Residual over the stated noise, where noise alone never leaves so much.
    not_told : NotTold or None
        No load is told from noise.
    flags : tuple of Flag
        What solving found.
    unit : str
        Of the arrays in terms of the channels' units: ``"({})^2/Hz"`` of spectra.
    """

    load: Array
    std: Array
    axis: Axis | None
    response: Array | None
    residual: Array | None
    facts: Facts
    bias: Array | None = None
    posterior: Any = None
    spectrum: Any = None
    geometry: Mapping[str, Any] | None = None
    diagnosis: Any = None
    excess: float | None = None
    not_told: NotTold | None = None
    flags: tuple[Flag, ...] = ()
    unit: str = "{}"


def of_path(
    path: RegularizationPath, choice: Choice, solution: Solution, sigma: float, noise: NoiseLevel, *,
    layout: tuple[float, int, int], axis: Axis | None, response: Array, residual: Array, facts: Mapping[str, Any],
    load: Array | None = None, hidden_by: RegularizationPath | None = None, along: int = 0,
) -> SolvedLoad:  # fmt: skip
    """What a path gives at the chosen lambda.

    Parameters
    ----------
    solution : Solution
        At that lambda.
    sigma : float
        NoiseLevel level of the whitened data.
    layout : (kappa, rank, nullity)
        Of the visible part.
    facts : mapping
        Added to those of the path.
    load : array, optional
        In place of that of the path, whose posterior it keeps.
    hidden_by : RegularizationPath, optional
        What the bias is asked of; None where the posterior says all.
    along : int
        Axis along which a load has one peak.
    """
    load = solution.load if load is None else load
    assert solution.posterior is not None
    std = np.broadcast_to(solution.posterior.std, load.shape)
    kappa, rank, nullity = layout
    point = path.at(choice.lam)
    own: dict[str, Any] = {
        "m": int(path.m), "rank": rank, "nullity": nullity, "kappa": kappa,
        "edf": None if point.edf is None else float(point.edf),
        "residual_to_noise": residual_level(path, choice.lam) if noise.known else None,
        "noise_level": float(sigma), **noise.source.facts,
    }  # fmt: skip
    flags: tuple[Flag, ...] = ()
    if (bound := path.bound(choice.lam)) is not None:
        own["window_bound"] = bound / float(np.linalg.norm(std))
        flags = guards.collect([windows_apart(own["window_bound"])])
    return SolvedLoad(
        load=load, std=std, axis=axis, response=response, residual=residual, facts=Facts.of({**own, **facts}),
        bias=None if hidden_by is None else identifiability.hidden(hidden_by, choice.lam, load, std, axis=along),
        posterior=solution.posterior, excess=beyond_noise(float(point.residual2), path.m, noise), flags=flags,
    )  # fmt: skip


def beyond_noise(residual2: float, m: float, noise: NoiseLevel) -> float | None:
    """Residual of m whitened data over the stated noise, where noise alone never leaves so much."""
    return None if noise.sigma is None else unexplained(residual2, m, noise.sigma)


def over_time(samples: int, dt: float) -> Axis:
    """The axis of a history."""
    return Axis("time", "s", np.asarray(np.arange(samples) * dt, float))


def labelled(found: SolvedLoad, loads: Sequence[Channel], sensors: Sequence[Channel], **more: Any) -> LoadEstimate:
    """Estimate of the numbers with the names and units of their channels; the bias is in the std."""
    return LoadEstimate(
        load=found.load,
        # a posterior holds the bias of an average sample; where more is expected to be hidden, that counts
        std=found.std if found.bias is None else np.maximum(found.std, np.abs(found.bias)),
        bias=found.bias,
        posterior=found.posterior,
        axis=found.axis,
        labels=[c.label for c in loads],
        units=[found.unit.format(c.unit) for c in loads],
        response=found.response,
        residual=found.residual,
        sensors=[c.label for c in sensors],
        sensor_units=[found.unit.format(c.unit) for c in sensors],
        geometry=found.geometry,
        diagnosis=found.diagnosis,
        spectrum=found.spectrum,
        facts=found.facts,
        **more,
    )


def answer(
    family: LoadFamily, measured: Measured, found: SolvedLoad, choice: Choice, *, known: bool, prior: str,
    settings: Mapping[str, Any], flags: Iterable[Flag | None], searched: RegularizationPath | None = None,
    solved: RegularizationPath | None = None, full: tuple[float, int, int] | None = None, free: bool = False,
    judged: bool = True, spare: Overlooked | None = None,
) -> LoadEstimate:  # fmt: skip
    """The estimate, with the guards that all families share.

    Parameters
    ----------
    known : bool
        The noise level is known.
    prior : str
        In words.
    settings : mapping
        For the provenance.
    flags : iterable of Flag or None
        What this family finds besides.
    searched : RegularizationPath, optional
        On which lambda was sought.
    solved : RegularizationPath, optional
        On which the load was solved for.
    full : (kappa, rank, nullity), optional
        Of all sensors of the model, where only some are used.
    free : bool
        Without regularisation.
    judged : bool
        What the rules say of lambda is told.
    spare : Overlooked, optional
        What the sensors can tell of each other.
    """
    model, facts = family.model, found.facts
    fewer = None
    if full is not None:
        used = set(measured.rows.tolist())
        lost = [s.label for i, s in enumerate(model.sensors) if i not in used]
        fewer = guards.lost_channels(full, (facts["kappa"], facts["rank"], facts["nullity"]), lost)
    short = free and UNDETERMINED in family.allow and facts["rank"] < facts["n"]
    heard = sought(spare)
    if heard.untested:
        found = replace(found, facts=Facts.of({**facts, "untested_sensors": heard.untested}))
    raised = guards.collect(
        [
            guards.overridden("E306", "rank", facts["rank"], facts["n"]) if short else None,
            *model.flags,
            guards.not_verified(model.certificate),
            *measured.findings,
            *map(guards.contradicting, heard.faults),
            *found.flags,
            *flags,
            fewer,
            guards.mixed_kinds(measured.channels, known),
            *(guards.parameter(choice, searched, solved, relative_spread(found)) if judged else ()),
            guards.inverse_crime(measured.simulated_by, model.fingerprint),
            guards.no_coverage(family.coverage),
            guards.used_for_training("the record", measured.fingerprints & model.training),
        ]
    )
    if found.excess is not None:  # the worst grade, and said first
        raised = (guards.unexplained(choice, found.excess), *raised)
        choice = ungraded(choice)
    elif found.not_told is not None:
        raised = (found.not_told.flag, *raised)
        found = replace(found, facts=Facts.of({**found.facts, **found.not_told.facts}))
    history = provenance(family.name, settings=settings, inputs=measured.inputs, model=model.fingerprint, prior=prior)
    return labelled(
        found, model.loads, measured.channels, choice=choice, flags=raised, allowed=family.allow,
        certificate=model.certificate, provenance=history, faults=heard.faults,
    )  # fmt: skip


def relative_spread(found: SolvedLoad) -> float | None:
    """Norm of the std over that of the load; None of no load."""
    size = float(np.linalg.norm(found.load))
    return float(np.linalg.norm(found.std)) / size if size > 0 else None


def undetermined(rank: int, unknowns: str, source: str, advice: Advice | str) -> NotIdentifiable:
    """LID-E306: without regularisation the data do not determine the load."""
    return NotIdentifiable(
        f"without regularisation the load is not determined: rank {rank} of {unknowns} from {source}",
        advice=advice, code=UNDETERMINED,
    )  # fmt: skip


if TYPE_CHECKING:
    from .posing.gathered import LineData


# -- sensors that contradict the others --------------------------------------------------------------------------------
VAGUE = ("other", "one of")  # what is said only of a contradiction ...
SURE = 4.0  # ... this far beyond what noise and errors of the model leave
MANY = 64  # sensors beyond which each against all others takes too long
LINES = 2048  # lines that are asked
QUIET = 0.1  # share of the lines whose power stands for the noise, where it is not known
TAIL = 0.02  # share of the largest response that may be left at the end of a record
SMOOTH = 9  # lines over which the size of a response is taken
LONGEST = 0.05  # share of a record that a delay may take
DRIFTS = 0.03  # share of the band that is slow


@dataclass(frozen=True, eq=False)
class Overlooked:
    """What the sensors of an answer can tell of each other.

    Parameters
    ----------
    lines : SensorLines
    labels : tuple of str
        Of the sensors.
    clock : LineTimes or None
        Of lines over frequency.
    dt : float
        Of the clock, s.
    """

    lines: SensorLines
    labels: tuple[str, ...]
    clock: LineTimes | None = None
    dt: float = 0.0


@dataclass(frozen=True)
class Sought:
    """What the sensors of an answer say of each other.

    Parameters
    ----------
    faults : tuple of SensorFault
    untested : tuple of str
        Sensors that the others do not determine: of these nothing can be said.
    """

    faults: tuple[SensorFault, ...] = ()
    untested: tuple[str, ...] = ()


def sought(given: Overlooked | None) -> Sought:
    """The fault that the sensors show, if they have any to spare, and whom they do not test."""
    lines = None if given is None or given.lines.spare < 1 else prepared(given.lines)
    if given is None or lines is None:
        return Sought()
    whole = left_out(lines, FLOOR)
    untested = tuple(label for label, due in zip(given.labels, whole.silent, strict=True) if due < 1)
    return Sought(_faults(given, lines, whole), untested)


def _faults(given: Overlooked, lines: SensorLines, whole: LeftOut) -> tuple[SensorFault, ...]:
    found = suspect(lines, whole)
    only = None if found is None or found.swap else told_apart(lines, found, given.clock)
    if found is None and given.clock is not None and (slow := drifting(lines, given.clock)) is not None:
        found, only = slow[0], slow[1:]
    if found is None:
        return ()
    who = tuple(given.labels[i] for i in found.sensors)
    kind, size, std = "swap" if found.swap else "one of" if who else "load", 0.0, 0.0
    if only is not None:
        at, fault = only
        who, unit = (given.labels[at],), given.dt if fault.kind == "delay" else 1.0
        kind, size, std = fault.kind, fault.size * unit, fault.std * unit
    if (kind in VAGUE and found.excess < SURE) or (kind == "gain" and not unlikely(lines, size)):
        return ()
    kept = tuple(label for label in given.labels if label not in who)
    return (SensorFault(who, kind, size, std, found.excess, found.without, found.other, kept),)


# -- lines of each family ----------------------------------------------------------------------------------------------
def of_static(
    H: Array, values: Array, noise: NoiseLevel, channels: Sequence[Channel],
    prior: Callable[[], tuple[Array, Array | None]] | None,
) -> Overlooked | None:  # fmt: skip
    """Static readings (frames, sensors); `prior` gives that of the loads (`prior_of`), None where they have none."""
    if np.ndim(noise.level) != 1 or len(H) > MANY:
        return None
    units = [c.unit for c in channels]
    row2 = np.sum(H**2, axis=1)
    alike = np.array([np.mean([s for s, u in zip(row2, units, strict=True) if u == v]) for v in units])
    # how much the loads move a sensor, in part how much they move all of its kind: no one sensor decides it
    size = 0.5 * (row2 + alike) * np.median(np.mean(values**2, axis=0) / row2)
    if np.any(size <= 0):
        return None
    level = np.asarray(noise.level, float) ** 2 if noise.known else np.zeros(len(units))
    spread, flat = (None, None) if prior is None else prior()
    lines = SensorLines(H[None], values.T[None], level[None], size[None], noise.known, 1.0, spread, flat)
    return Overlooked(lines, tuple(c.label for c in channels))


def prior_of(L: Array | None, loads: int) -> tuple[Array, Array | None]:
    """Covariance (loads, loads) of the loads that a penalty expects, and what it leaves free (loads, k) if anything."""
    if L is None:
        return np.eye(loads), None
    _, s, V = np.linalg.svd(np.atleast_2d(L))
    s = np.concatenate([s, np.zeros(loads - len(s))])
    held = s > 1e-10 * s[0]
    return (V[held].T / s[held] ** 2) @ V[held], V[~held].T


def of_lines(line: LineData, H: Array) -> Overlooked | None:
    """Spectra, cross spectra or a transient, with the FRFs of the used sensors."""
    if not H.shape[2] < line.X.shape[1] <= MANY:
        return None
    if line.data is not None:  # a record that ends in motion is damped: its lines alone would not tell
        samples = len(line.data.values)
        level = np.sqrt(np.median(line.power, axis=0) / samples)
        h = np.asarray(np.fft.irfft(H, line.padded, axis=0)[:samples])
        return of_record(h, line.data.values, line.data.dt, NoiseLevel(level, line.known, line.source), line.channels)
    pick = slice(None, None, max(1, len(line.frequencies) // LINES))
    X, f, snapshots = line.X[pick], line.frequencies[pick], line.X.shape[2]
    if np.any(np.max(np.abs(X), axis=(0, 2)) == 0):
        return None
    y, top = X * np.sqrt(snapshots), float(line.frequencies[-1])
    noise = line.power[pick] if line.known else np.tile(_quiet(y), (len(y), 1))
    dt = 0.5 / top
    clock = LineTimes(2 * np.pi * f * dt, None, f <= DRIFTS * top, _longest(len(line.frequencies)))
    worth = 2 * min(line.averages, 1e6) / snapshots
    lines = SensorLines(H[pick], y, noise, _size(y), line.known, worth)
    return Overlooked(lines, tuple(c.label for c in line.channels), clock, dt)


def of_record(h: Array, values: Array, dt: float, noise: NoiseLevel, channels: Sequence[Channel]) -> Overlooked | None:
    """A record (samples, sensors) and the impulse responses behind it, (taps, sensors, loads).

    Lines of the zero-padded record, as many as are asked, by folding it. What has not decayed at the end of the record
    is damped by an exponential window, which a convolution does not mind.
    """
    samples, sensors = values.shape
    if not h.shape[2] < sensors <= MANY or np.ndim(noise.level) != 1 or np.any(np.abs(values).max(axis=0) == 0):
        return None
    if len(h) < samples and np.abs(h[-max(len(h) // 50, 1) :]).max() > TAIL * np.abs(h).max():
        return None
    pieces = -(-2 * samples // (2 * LINES))
    length = 2 * (-(-samples // pieces))
    window = np.exp(-_damping(values) * np.arange(samples))
    y = np.fft.rfft(_folded(window[:, None] * values, length), axis=0)[..., None]
    taps = min(len(h), samples)
    H = np.fft.rfft(_folded(window[:taps, None, None] * h[:taps], length), axis=0)
    constant = np.fft.rfft(_folded(window[:, None], length), axis=0)[:, 0]
    energy = float(np.sum(window**2))
    worth = 2 * energy**2 / float(np.sum(window**4)) / (pieces * length)
    level = np.asarray(noise.level, float) ** 2 * energy if noise.known else _quiet(y)
    f = np.asarray(np.fft.rfftfreq(length), float)
    clock = LineTimes(2 * np.pi * f, constant, f <= max(DRIFTS / 2, 3 / samples), _longest(samples))
    lines = SensorLines(H, y, np.tile(level, (len(y), 1)), _size(y), noise.known, worth)
    return Overlooked(lines, tuple(c.label for c in channels), clock, dt)


def _damping(values: Array) -> float:
    """Decay per sample of the window that leaves next to nothing at the end of a record."""
    tail = np.abs(values[-max(len(values) // 50, 4) :]).max(axis=0) / np.abs(values).max(axis=0)
    return max(float(np.log(np.max(tail) / TAIL)), 0.0) / len(values)


def _folded(x: Array, length: int) -> Array:
    """Sum of the stretches of `length` samples: its transform is every so manieth line of that of x."""
    pad = -len(x) % length
    whole = np.concatenate([x, np.zeros((pad, *x.shape[1:]))])
    return np.asarray(whole.reshape(-1, length, *x.shape[1:]).sum(axis=0))


def _longest(samples: int) -> float:
    return float(np.clip(LONGEST * samples, 2.0, 64.0))


def _quiet(y: Array) -> NDArray[np.float64]:
    """Power of the quietest lines of each sensor: no less than its noise."""
    power = np.sum(np.abs(y) ** 2, axis=2)
    floor = np.quantile(power, QUIET, axis=0) / -np.log1p(-QUIET)
    return np.asarray(np.maximum(floor, 1e-20 * power.max(axis=0)))


def _size(y: Array) -> NDArray[np.float64]:
    """Power of each response around each line, in part that of all responses."""
    from scipy.ndimage import uniform_filter1d

    power = uniform_filter1d(np.mean(np.abs(y) ** 2, axis=2), min(SMOOTH, len(y)), axis=0, mode="nearest")
    energy = np.mean(power, axis=0)
    return np.asarray(0.5 * power + 0.5 * energy * np.median(power / energy, axis=1, keepdims=True))
