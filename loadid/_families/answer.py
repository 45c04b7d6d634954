"""One place where what a family computed becomes the answer: its facts, its flags, its grade and its history."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
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
from .._inverse.choice import Choice, residual_level, unexplained, ungraded
from .._inverse.diagnosis import identifiability
from .._inverse.path import RegularizationPath, Solution
from .._results.estimate import Axis, LoadEstimate
from .._results.facts import Facts, provenance
from .faults import Overlooked, sought
from .noise import NoiseLevel

if TYPE_CHECKING:
    from .data import Data, Readings
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
