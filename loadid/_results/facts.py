"""What a result states of itself: facts, typed and with their units, where it comes from, and its grade.

Four grades say how often answers of each were as good as they say. What the estimate knows of its own error is one
number, the error that is expected of it relative to the load. Cuts make grades of it, cautions lower them, and
``python -m tests.campaigns grades`` measures on random problems with foreign truths what each grade is worth:
`grades.toml` is its output.
"""

from __future__ import annotations

import platform
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import Field, dataclass, field, fields, replace
from datetime import UTC, datetime
from functools import cache, cached_property
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from structures._flags import cautions

NOT_STATED: Any = object()  # the default: None says that a fact is asked for and not available
GROUPS = {"tuned": "tuned_", "counts": "count_"}  # mappings, and how their names begin in a dictionary


def fact(title: str = "", unit: str = "", *, key: str = "", shown: bool = True) -> Any:
    """A field of `Facts`.

    Parameters
    ----------
    title : str
        What it is called in a summary; "" for its name.
    unit : str
        SI; "" for counts, shares, ratios and words.
    key : str
        Its name in dictionaries and files; "" for that of the field.
    shown : bool
        Whether a summary lists it; what other lines say already is left out.
    """
    return field(default=NOT_STATED, metadata={"title": title, "unit": unit, "key": key, "shown": shown})


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Facts(Mapping[str, Any]):
    """Facts of a result, None where they are not stated or not available. Immutable.

    Also a mapping of those that are stated, as files hold them: ``facts.edf`` is ``facts["edf"]``.

    Parameters
    ----------
    m, n, rank, nullity : int
        Data, unknowns, and how many unknowns the data see and do not see.
    kappa : float
        Condition number of the visible part.
    frames : int
        Static readings in one estimate.
    chosen : str
        Which family and prior were taken where the data decided, and why; one line.
    missing, frf_errors, band, path, solver : str
        In words: samples that are not there, what errors of the FRF add to the noise, what the std holds, how it was
        solved, and by what where loads only push.
    frf_source : str
        Who says how large errors of the FRF are: ``"stated"``, ``"the model's variance"``, ``"spare sensors"``,
        ``"loads of smooth size"``, ``"floor"`` where nothing tells, or ``"taken for exact"``.
    edf, residual_to_noise, noise_level : float
        Effective degrees of freedom of the load; residual over noise, where that is known; noise of the whitened data.
    noise_source, noise_kind : str
        Where the noise level comes from, and which kind of `loadid.NoiseSource` that is.
    resolution, peak_bias, noise_share : float
        Width in `resolution_unit` at which a single load is shown, share of its height that is lost, share of the
        variance at the largest load that is noise (the rest is prior).
    expected_error : float
        Relative error that the posterior expects of the load, root mean square; not stated where the std says it.
    trusted_lines, trust_level, untold_power : float
        Share of the frequency lines that tell every load to this predicted relative error; a load that makes less than
        5 % of the response of a line does not count there. Largest share of the power of a load on the other lines.
    history_band, history_ends : str
        In words: from where to where the lines go that a history is made of; their tapers, and what of the record lies
        outside.
    averages, bandwidth, window
        Of cross spectra: independent averages, bandwidth of a line (Hz), name of the window.
    untested_sensors : tuple of str
        Sensors that the others do not determine: whether these are sound cannot be said.
    offsets : tuple of str
        Constants of channels that no constant load moves, with std and unit, estimated with the load and taken off.
    held_out : tuple of str
        Prediction error of each sensor that was kept out.
    told_from, told_from_throughout : tuple of float
        Where no load is told from noise, of each load in its unit: the size from which it would have been in 95 % of
        all cases (peak of a hit in a record, static load, amplitude, spectrum, rms of a tracked load), and the rms of a
        wide-band load throughout.
    window_level : float
        Noise level where a load acts over that of the record, where the residual there shows more: errors of the model,
        which the std holds.
    window_bound : float
        Bound on the error of solving in windows, over the std.
    frequency, length, time_constant : float
        Of a harmonic load (Hz), of a spatial prior (m), of a settled filter (s).
    explained : float
        Of a harmonic load from a record: share of the power of the record, about its mean, that lies at its frequency.
    gap, converged, steps, held
        Of a solver: relative duality gap, whether it met its limit, steps; samples that a sign holds at zero.
    support, mu, support_kappa, knots, amplitude_std_with_neighbours
        Of a sparse load: its waveforms, the weight of their penalty, their condition number, the spacing of B-splines,
        the relative std of the largest spike if its neighbours in time may act too.
    acting_loads, criterion_by_knots
        Labels of the loads that act; information criterion by spacing, in words.
    places, distinguishable : int
        Of a field: places of its loads, and combinations that the sensors tell apart.
    novelty : float
        Of a learned map: the worst score of the readings over its limit; above 1 the physics answered.
    novelty_by, answered_by, engine : str
        In words: the scores with their limits, who answered, and the engine of the map.
    lam : float
        Relative lambda, where no `Choice` holds it.
    tuned, counts : mapping of str to number
        Parameters that a tracker tuned, and what it counted.
    other : mapping
        What another release wrote or a user added.
    stated : frozenset of str
        Names of the fields that are given; found by itself.
    """

    m: int | None = fact("data m")
    n: int | None = fact("unknowns n")
    rank: int | None = fact()
    nullity: int | None = fact()
    kappa: float | None = fact("condition number of the visible part")
    frames: int | None = fact()
    missing: str | None = fact()
    chosen: str | None = fact("family and prior, and why", shown=False)
    edf: float | None = fact("effective degrees of freedom")
    residual_to_noise: float | None = fact("residual / noise")
    resolution: float | None = fact("resolution width", "that of resolution_unit")
    peak_bias: float | None = fact("share of a single-sample peak that is lost")
    expected_error: float | None = fact("expected error of the load, relative", shown=False)
    trusted_lines: float | None = fact("share of the lines that tell every load")
    trust_level: float | None = fact("to a predicted error of")
    frf_errors: str | None = fact("errors of the FRF")
    frf_source: str | None = fact("errors of the FRF by", shown=False)
    untold_power: float | None = fact("largest share of a load's power on lines that do not tell it")
    averages: float | None = fact("independent averages")
    bandwidth: float | None = fact("bandwidth of a line, Hz", "Hz")
    window: str | None = fact()
    history_band: str | None = fact("band of the history")
    history_ends: str | None = fact("ends of that band")
    untested_sensors: tuple[str, ...] | None = fact("sensors that the others do not determine")
    offsets: tuple[str, ...] | None = fact("offsets of channels, estimated with the load")
    held_out: tuple[str, ...] | None = fact("prediction error of the sensors that were kept out")
    noise_share: float | None = fact("share of the variance at the peak that is noise (the rest is prior)")
    path: str | None = fact("solved by")
    told_from: tuple[float, ...] | None = fact("told from noise from (SI)", shown=False)
    told_from_throughout: tuple[float, ...] | None = fact("told from noise from, rms (SI)", shown=False)
    window_level: float | None = fact("residual where the load acts / noise")
    window_bound: float | None = fact("bound on the error of solving in windows / std")
    resolution_unit: str | None = fact(shown=False)
    noise_level: float | None = fact(shown=False)
    noise_source: str | None = fact(shown=False)
    noise_kind: str | None = fact(shown=False)
    band: str | None = fact(shown=False)
    frequency: float | None = fact(unit="Hz")
    explained: float | None = fact("share of the record that the harmonic explains")
    gap: float | None = fact()
    converged: bool | None = fact()
    held: int | None = fact()
    solver: str | None = fact()
    steps: int | None = fact()
    support: int | None = fact()
    mu: float | None = fact()
    support_kappa: float | None = fact()
    knots: int | None = fact()
    acting_loads: tuple[str, ...] | None = fact()
    amplitude_std_with_neighbours: float | None = fact()
    criterion_by_knots: str | None = fact()
    places: int | None = fact()
    distinguishable: int | None = fact(key="told_apart")
    length: float | None = fact(unit="m")
    answered_by: str | None = fact("answered by")
    engine: str | None = fact("engine of the learned map")
    novelty: float | None = fact("novelty of the readings (alarm above 1)")
    novelty_by: str | None = fact("novelty by")
    lam: float | None = fact(key="lambda")
    time_constant: float | None = fact(unit="s")
    tuned: Mapping[str, float] = field(default_factory=dict)
    counts: Mapping[str, int] = field(default_factory=dict)
    other: Mapping[str, Any] = field(default_factory=dict)
    stated: frozenset[str] = field(default=NOT_STATED)

    def __post_init__(self) -> None:
        put, given = object.__setattr__, set()
        for name in (f.name for f in self.specs().values()):
            value = getattr(self, name)
            if value is NOT_STATED:
                put(self, name, None)
            elif value is not None or self.stated is NOT_STATED or name in self.stated:
                given.add(name)
                put(self, name, tuple(value) if isinstance(value, list) else value)
        put(self, "stated", frozenset(given))
        for name in (*GROUPS, "other"):
            put(self, name, MappingProxyType(dict(getattr(self, name))))

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Self:
        """Facts of a dictionary, as `dict` of them gives it; what it holds besides is kept in `other`."""
        if isinstance(given, cls):
            return given
        specs = cls.specs()
        own: dict[str, Any] = {"other": {}} | {name: {} for name in GROUPS}
        for key, value in given.items():
            group = next((name for name, start in GROUPS.items() if key.startswith(start)), None)
            if key in specs:
                own[specs[key].name] = value
            else:
                own[group or "other"][key.removeprefix(GROUPS.get(group or "", ""))] = value
        return cls(**own)

    @classmethod
    def specs(cls) -> dict[str, Field[Any]]:
        """Key in a dictionary -> field, in the order in which facts are printed."""
        return {f.metadata["key"] or f.name: f for f in fields(cls) if f.metadata}

    @classmethod
    def title(cls, key: str) -> str:
        """What a summary calls a fact; "" where other lines say it already."""
        specs = cls.specs()
        if key not in specs:
            return key.replace("_", " ")
        about = specs[key].metadata
        return str(about["title"] or key.replace("_", " ")) if about["shown"] else ""

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{key}={value!r}' for key, value in self.items())})"

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self).of, (dict(self),)

    # -- as a mapping -------------------------------------------------------------------------------------------------
    @cached_property
    def _flat(self) -> dict[str, Any]:
        own = {key: getattr(self, f.name) for key, f in self.specs().items() if f.name in self.stated}
        plain = {key: list(value) if isinstance(value, tuple) else value for key, value in own.items()}
        parts = {f"{start}{k}": v for name, start in GROUPS.items() for k, v in getattr(self, name).items()}
        return {**plain, **parts, **self.other}

    def __getitem__(self, key: str) -> Any:
        return self._flat[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._flat)

    def __len__(self) -> int:
        return len(self._flat)


STATIC = "static inversion"  # name of the family whose loads are of readings, whatever their axis


def provenance(
    family: str, *, settings: Mapping[str, Any], inputs: Mapping[str, str], model: str, prior: str
) -> dict[str, Any]:
    """Record of how an estimate was made.

    Parameters
    ----------
    family : str
    settings : mapping
    inputs : mapping
        Name -> sha256.
    model : str
        Fingerprint of the forward model.
    prior : str
        The prior, in words.
    """
    return {
        "family": family,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {"python": platform.python_version(), **{p: _version(p) for p in ("loadid", "numpy", "scipy")}},
        "settings": dict(settings),
        "inputs": dict(inputs),
        "model": model,
        "prior": prior,
    }


@cache
def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


# -- grades of an answer -----------------------------------------------------------------------------------------------
if TYPE_CHECKING:
    from .estimate import LoadEstimate

LETTERS = ("A", "B", "C", "D")
MEANINGS = {
    "A": "good",
    "B": "fair",
    "C": "size and rough shape only",
    "D": "not determined: do not use the number",
}
CUTS = (0.10, 0.30, 0.90)  # expected relative error between the grades
CONTRADICTED = ("LID-W308", "LID-W318", "LID-W412")  # the data speak against the answer itself
DRIFTING = {"LID-W519", "LID-W520"}  # together: a slow part that no sensor holds, of a filter that does not settle
FEW, MANY = 2.5, 5.0  # degrees of freedom that explain so many times as many readings: a simple load, confirmed
CHANCE = 0.01  # that noise alone looks as simple
WHOLE = 0.99  # share of the unknowns that is fitted whole
SHARES = {"A": "19 of 20", "B": "9 of 10", "C": "9 of 10", "D": "half"}  # of what `MEASURED` states


@dataclass(frozen=True)
class GradeOdds:
    """Measured on answers of one family and grade.

    Parameters
    ----------
    answers : int
        How many there were.
    within : float
        Relative error (root mean square over the load) that the share of `SHARES` stays below; of the worst grade, that
        half exceeds.
    """

    answers: int
    within: float


def _stated() -> dict[str, dict[str, GradeOdds]]:
    rows = tomllib.loads(Path(__file__).with_name("grades.toml").read_text("utf-8"))
    return {family: {letter: GradeOdds(**odds) for letter, odds in grades.items()} for family, grades in rows.items()}


MEASURED = _stated()  # family -> grade -> odds


@dataclass(frozen=True)
class Grade:
    """How far an answer can be trusted.

    Parameters
    ----------
    letter : str
        ``A`` to ``D``.
    expected : float
        Relative error that is expected of the load, root mean square; 1 where nothing is known of it.
    odds : GradeOdds or None
        What answers of this family and grade were worth; None where nobody measured it.
    """

    letter: str
    expected: float
    odds: GradeOdds | None

    @property
    def meaning(self) -> str:
        """What the letter stands for."""
        return MEANINGS[self.letter]

    @property
    def usable(self) -> bool:
        """Whether the number may be used, for what the grade says it is good for: not of the worst grade."""
        return self.letter != LETTERS[-1]

    def __str__(self) -> str:
        text = f"grade {self.letter} ({self.meaning})"
        if self.odds is None:
            return f"{text}; an error of about {_percent(self.expected)} is expected, not measured for such answers"
        within = _percent(self.odds.within)
        if self.letter == LETTERS[-1]:
            return f"{text}; half of the answers like this one were off by more than {within}"
        return f"{text}; {SHARES[self.letter]} answers like this one were within {within}"


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share >= 0.01 else f"{100 * share:.1g} %"


def expected_error(estimate: LoadEstimate) -> float:
    """Relative error that is expected of a load: of the posterior where that says more, else of its std.

    Errors of variance S about a load of squared norm G leave a true load of G + S on average, as the posterior of a
    prior is smaller than its load, so that it is below 1. Where nothing was held back, the noise is part of G instead,
    and G - S is left. Over frequency lines those count that are trusted, where one is.
    """
    if estimate.facts.expected_error is not None:
        return float(estimate.facts.expected_error)
    load, std = np.asarray(estimate.load), np.asarray(estimate.std)
    if estimate.spectrum is not None and estimate.spectrum.load.shape == load.shape:
        trusted = estimate.trust()
        load, std = (load[trusted], std[trusted]) if trusted.any() else (load, std)
    error2, load2 = float(np.sum(std**2)), float(np.sum(np.abs(load) ** 2))
    if _whole(estimate):
        load2 = max(load2 - 2 * error2, 0.0)
    return relative(error2, load2)


def expecting(estimate: LoadEstimate, error: float) -> LoadEstimate:
    """The estimate, whose load is expected to be off by so much (relative) at least."""
    least = max(expected_error(estimate), float(error))
    return replace(estimate, facts=Facts.of({**estimate.facts, "expected_error": least}))


def _whole(estimate: LoadEstimate) -> bool:
    """Whether every unknown is fitted: nothing of the load is held back, and nothing of the noise."""
    edf, n = estimate.facts.edf, estimate.facts.n
    return edf is not None and n is not None and edf / (estimate.facts.frames or 1) >= WHOLE * n


def relative(error2: float, load2: float) -> float:
    """Expected relative error of a load of squared norm `load2` with errors of that variance."""
    return float(np.sqrt(error2 / (error2 + load2))) if error2 + load2 > 0 else 1.0


def grade(estimate: LoadEstimate) -> Grade:
    """Grade of an estimate by its expected error and its cautions, with what was measured of that grade."""
    expected = expected_error(estimate)
    found = cautions(estimate.flags)
    letter = LETTERS[int(np.searchsorted(CUTS, expected, side="right"))]
    if letter == "D" and _simple(estimate):
        letter = "C"
    if found and letter < "C":
        letter = LETTERS[LETTERS.index(letter) + 1]
    if any(flag.code in CONTRADICTED or flag.code[4] == "E" for flag in found) or {f.code for f in found} >= DRIFTING:
        letter = "D"
    family = str(estimate.provenance.get("family", ""))
    return Grade(letter, expected, MEASURED.get(family, {}).get(letter))


def _simple(estimate: LoadEstimate) -> bool:
    """Whether a few degrees of freedom explain many more readings, and more of them than they explain of noise."""
    edf, m = estimate.facts.edf, estimate.facts.m
    if edf is None or m is None:
        return False
    each = edf / (estimate.facts.frames or 1)
    return each <= FEW and m >= MANY * each and _beyond_chance(estimate, max(each, 1.0), float(m))


def _beyond_chance(estimate: LoadEstimate, edf: float, m: float) -> bool:
    """Whether a fit of so many degrees of freedom, per frame, leaves less of m readings than it leaves of white noise.

    Every sensor counts by its own rms, so that units do not matter.
    """
    from scipy.special import betaincc

    if estimate.response is None or estimate.residual is None:
        return False
    data, rest = (np.abs(np.asarray(part).reshape(-1, np.shape(part)[-1])) for part in
                  (estimate.response, estimate.residual))  # fmt: skip
    size = np.sqrt(np.mean(data**2, axis=0))
    if len(data) == 1:
        size = np.array([np.sqrt(np.mean(data[0, [v == u for v in estimate.sensor_units]] ** 2))
                         for u in estimate.sensor_units])  # fmt: skip
    seen = size > 0
    if not seen.any():
        return False
    left = float(np.sum((rest[:, seen] / size[seen]) ** 2) / np.sum((data[:, seen] / size[seen]) ** 2))
    return bool(betaincc(edf / 2, max(m - edf, 1.0) / 2, max(1.0 - left, 0.0)) < CHANCE)
