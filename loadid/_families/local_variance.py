"""The load under a prior whose variance changes with time, in place of that of one lambda."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .._inverse.choice import Choice, ungraded
from .._inverse.convolved.local_lines import LocalLinesPrior, Spectrum, local_lines
from .._inverse.local_prior import (
    UNLIKELY,
    LocalPrior,
    StationaryPrior,
    errors_told,
    local_prior,
    stationary_prior,
    with_errors,
    with_misfit,
)
from .._inverse.nuisances import Marginal, linearised
from .._inverse.posterior import WidenedPosterior
from .._inverse.support import ActingPosterior
from .._results.facts import Facts
from .answer import SolvedLoad, beyond_noise
from .histories import half_width
from .posing import Posed, PosingSettings
from .posing.paths import LONGEST

Array = NDArray[Any]

SMEARED = "W311"
RESIDUAL = "residual"  # noise that tests left, which another record may have less of
WINDOW = 9  # samples over which the energy of the load is averaged
IMPACTS = 0.4  # such a spread beyond which no impacts are sought
THROUGHOUT = "the load acts throughout"
WIDER = 0.01  # of lambda
GROSS = 0.3  # share of its response that the residual of a sensor has where a noisy one cannot be told from a wrong one
FAIR = 0.03  # share of the response that no known error makes, up to which the band of what was learned held
EITHER = 0.5  # odds of another prior than that of the penalty
LONGEST_LINES = 2**18  # samples line by line


@dataclass(frozen=True, eq=False)
class Learned:
    """Both priors, and whether the local one is used.

    Parameters
    ----------
    prior : LocalPrior or LocalLinesPrior
    posed : Posed
        Over the states of the model, or line by line.
    asked_for : bool
        By the user, or by the data.
    names : tuple of str
        Of the errors of the model.
    """

    prior: LocalPrior | LocalLinesPrior
    posed: Posed
    asked_for: bool
    names: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Smooth:
    """A load of constant variance that is smooth over as many samples as the data ask for; as it was asked for.

    Parameters
    ----------
    prior : StationaryPrior
    posed : Posed
        Over the states of the model.
    errors : Marginal, optional
        Of the model.
    """

    prior: StationaryPrior
    posed: Posed
    errors: Marginal | None = None


Priors: TypeAlias = Learned | Smooth | StationaryPrior | str | None
"""Both; a constant variance alone, of a load that acts throughout; why none was learned; none was to be learned."""


def learned(
    posed: Posed, settings: PosingSettings, load: Array, states: Callable[[], Posed | None],
    anywhere: Callable[[], Posed | None] = lambda: None,
) -> Priors:  # fmt: skip
    """Both priors of a problem, that of constant variance alone where the load acts throughout, or why there is none.

    Parameters
    ----------
    posed : Posed
    settings : PosingSettings
    load : array, shape (samples, loads)
        Under one constant variance.
    states : callable
        The same problem over the states of the model; None where it has none.
    anywhere : callable
        The same without the windows of the load.
    """
    if settings.penalty.variance == "local" and posed.spectrum is not None:
        return _over_lines(posed, posed.spectrum, load, asked=True)
    if settings.penalty.variance == "local":
        assert posed.record is not None
        prior = local_prior(posed.record, stated=posed.noise.known)
        return _with_errors(prior, posed)
    if settings.penalty.variance == "smooth":
        assert posed.record is not None
        still = stationary_prior(posed.record, stated=posed.noise.known)
        wrong = None if posed.nuisances is None else errors_told(still, posed.nuisances)
        return Smooth(still, posed, wrong)
    if settings.penalty.variance == "constant":
        return None
    if why := _not_asked(settings, load, LONGEST if posed.spectrum is None else LONGEST_LINES):
        return why
    if settings.support is not None:
        return _in_windows(states(), anywhere)
    if spread(load) > IMPACTS:
        over = states() if len(load) <= LONGEST else None
        if over is None or over.record is None:
            return THROUGHOUT
        return stationary_prior(over.record, stated=over.noise.known)
    if posed.spectrum is not None:
        return _over_lines(posed, posed.spectrum, load)
    over = states()
    if over is None or over.record is None:
        return "the model has no states to learn it over, or too many"
    prior = local_prior(over.record, stated=over.noise.known)
    return _with_errors(prior, over) if prior.asked_for else Learned(prior, over, False)


def _in_windows(over: Posed | None, anywhere: Callable[[], Posed | None]) -> Priors:
    """The local prior inside windows of the load, where the record asks for it there, or would without its windows.

    Inside a window that is tight about a hit the load acts throughout: what tells a hit is the record as a whole.
    """
    if over is None or over.record is None:
        return "a window of the load was given, and the model has no states to learn it over, or too many"
    known = over.noise.known
    prior = local_prior(over.record, stated=known)
    if not prior.asked_for:
        whole = anywhere()
        if whole is None or whole.record is None or not local_prior(whole.record, stated=known).asked_for:
            return "a window of the load was given, and no hit is told in it"
    return _with_errors(prior, over)


def _over_lines(posed: Posed, spectrum: Spectrum, load: Array, asked: bool = False) -> Learned | str:
    """Both priors of a problem that goes line by line."""
    known = posed.noise.known
    stated = known and posed.noise.source.kind != RESIDUAL
    prior = local_lines(spectrum, load, known=known, stated=stated)
    if isinstance(prior, str):
        return prior
    if not (asked or prior.asked_for):
        return Learned(prior, posed, False)
    prior = prior.with_gaps()
    if posed.gains is None:
        return Learned(prior, posed, True)
    return Learned(prior.with_gains(posed.gains.covariance), posed, True, posed.gains.names)


def _with_errors(prior: LocalPrior, posed: Posed) -> Learned:
    prior = with_misfit(prior)
    if posed.nuisances is None:
        return Learned(prior, posed, True)
    return Learned(with_errors(prior, posed.nuisances), posed, True, posed.nuisances.names)


def _not_asked(settings: PosingSettings, load: Array, longest: int) -> str:
    """Why a variance that changes with time is out of the question, before one is learned; "" where it is not."""
    if not settings.unasked:
        return "another prior, a lambda or a rule was asked for"
    if len(load) > longest:
        return f"beyond {longest} samples learning it costs more than the estimate; variance='local' learns it"
    return ""


def spread(load: Array) -> float:
    """Share of the record over which the energy of the load is spread, of the load that is spread least."""
    window = np.ones(WINDOW) / WINDOW
    energy = np.array([np.convolve(g**2, window, "same") for g in load.T])
    square = np.maximum(np.sum(energy**2, axis=1), np.finfo(float).tiny)
    return float(np.min(energy.sum(axis=1) ** 2 / (len(load) * square)))


def _beyond_fair(prior: LocalPrior | LocalLinesPrior, posed: Posed, residual: Array) -> float | None:
    """Residual over the noise that no model as good as may be expected leaves.

    By measured FRFs no misfit is learned, and the noise of each sensor is: it would take a channel in another unit for
    a very noisy one. A residual of `GROSS` of the response is excused, and so is the mean of the residual: a constant
    is an offset of the instrument, and moves no hit.
    """
    if prior.misfit > FAIR or prior.contradicted:
        return beyond_noise(prior.unexplained(), prior.data, posed.noise)
    if not isinstance(prior, LocalLinesPrior):
        return None
    varying = np.nanvar(residual, axis=0) / np.maximum(np.nanmean(residual**2, axis=0), np.finfo(float).tiny)
    return beyond_noise(prior.unexplained(GROSS**2, varying), prior.data, posed.noise)


def unasked(choice: Choice, learned: Learned | Smooth) -> Choice:
    """The choice of lambda where the load is not that of any lambda: its rules are no judgement of it.

    A model that the data contradict beyond what it was said to be wrong by has the worst grade.
    """
    if isinstance(learned, Learned) and learned.prior.contradicted:
        return replace(ungraded(choice), odds=f"the data contradict the model: {wrong(learned)}")
    odds = "the variance of the load was learned by its evidence; lambda and its rules are those of a constant variance"
    return replace(choice, verdict="not asked", odds=odds)


def wrong(learned: Learned) -> str:
    """What the data tell of the errors of the model, the largest first, in words."""
    errors, prior = learned.prior.errors, learned.prior
    told = [] if errors is None else _told(errors, learned.names)
    return ", ".join([*told, f"{prior.misfit:.1%} of the response is of no load and of no error that is known"])


def widened_by_gains(found: SolvedLoad, posed: Posed, choice: Choice) -> SolvedLoad:
    """The answer of a constant variance by measured FRFs, with errors of the gains of its sensors in the band.

    A load is off by no more than the worst of them; a residual that two standard deviations of them make is theirs.
    """
    if posed.gains is None or found.posterior is None:
        return found
    variance = np.diag(posed.gains.covariance)
    band = WidenedPosterior(found.posterior, np.sqrt(variance.max()) * found.load[None])
    excess, theirs = found.excess, 4 * float(variance @ posed.gains.energy)
    if excess is not None:
        left = float(posed.path.at(choice.lam).residual2) - theirs
        excess = beyond_noise(max(left, 0.0), posed.path.m, posed.noise)
    return replace(found, std=band.std, posterior=band, excess=excess)


def _told(errors: Marginal, names: Sequence[str]) -> list[str]:
    """The largest errors that the data tell, in words."""
    std = np.sqrt(np.diag(errors.covariance))
    sure = [i for i in np.argsort(-np.abs(errors.mean)) if abs(errors.mean[i]) > 2 * std[i]]
    return [f"{names[i]} {errors.mean[i]:+.1%}" for i in sure[:3]]


def widened(found: SolvedLoad, posed: Posed | None, choice: Choice) -> SolvedLoad:
    """The answer of a constant variance with the errors of the model in its band.

    Parameters
    ----------
    posed : Posed or None
        Over the states of the model.
    """
    if posed is None or posed.nuisances is None or posed.record is None or found.posterior is None:
        return found
    path, record = posed.path, posed.record
    lam, sigma2 = choice.lam * choice.scale / float(path.scale), found.facts["noise_level"] ** 2
    wider = max(lam * WIDER, path.range[0])  # what is told of errors is not told by a load that is thought white

    def solve(data: Array) -> tuple[Array, Array]:
        return path.of_data(data, wider)[0] / sigma2, path.of_data(data, lam)[1]

    errors = linearised(posed.nuisances, found.load, path.start(lam), solve, record.y, sigma2)
    band = WidenedPosterior(found.posterior, errors.spread)
    excess = found.excess
    if excess is not None and errors.odds > UNLIKELY:  # is the residual that of such errors?
        left = float(path.at(lam).residual2) - 2 * sigma2 * errors.gain
        excess = beyond_noise(max(left, 0.0), path.m, posed.noise)
    told = ", ".join(_told(errors, posed.nuisances.names))
    facts = {**found.facts, "model_errors": told or "none that the data tell"}
    return replace(found, std=band.std, posterior=band, facts=Facts.of(facts), excess=excess)


def _constant(found: SolvedLoad, because: str) -> SolvedLoad:
    """The answer, with why its variance is constant."""
    return replace(found, facts=Facts.of({**found.facts, "variance": "constant", "variance_because": because}))


def _between(found: SolvedLoad, others: Sequence[StationaryPrior | LocalLinesPrior]) -> SolvedLoad:
    """The answer of the penalty, whose band knows that the prior may be another one: each as likely as not."""
    each = [one.posterior()[0] for one in others]  # not finite where data contradict the model beyond all measure
    away = [load - found.load for load in each if np.all(np.isfinite(load))]
    if found.posterior is None or not away:
        return found
    band = WidenedPosterior(found.posterior, np.sqrt(EITHER) * np.array(away))
    return replace(found, std=band.std, posterior=band)


def words(learned: Priors) -> str:
    """The prior in words; "" where it is that of the penalty."""
    if not isinstance(learned, Learned | Smooth) or not (isinstance(learned, Smooth) or learned.asked_for):
        return ""
    memory = "white" if not learned.prior.memory else f"smooth over {learned.prior.memory:g} samples"
    if isinstance(learned, Smooth):
        return f"a load of zero mean and constant variance, {memory}"
    return f"a load of zero mean whose variance changes with time, {memory}"


def told(learned: Priors) -> bool:
    """Whether the evidence asks for hits: these are told from noise."""
    return isinstance(learned, Learned) and learned.prior.asked_for


def _smooth(found: SolvedLoad, learned: Smooth, choice: Choice, dt: float) -> SolvedLoad:
    """The answer with the load of a smooth prior."""
    prior, posed = learned.prior, learned.posed
    load, band, start = prior.posterior(learned.errors)
    response, residual = posed.compare(load, choice.lam, start)
    resolution, lost = _seen(prior, load, dt)
    facts = {
        **found.facts, "path": posed.name, "variance": "smooth", "memory": prior.memory, "log_evidence": prior.evidence,
        "resolution": resolution, "peak_bias": lost, "edf": prior.freedom(),
    }  # fmt: skip
    flags = tuple(flag for flag in found.flags if not flag.code.endswith(SMEARED))
    excess = beyond_noise(prior.unexplained(), prior.data, posed.noise)
    return replace(found, load=load, std=band.std, posterior=band, bias=None, response=response, residual=residual,
                   facts=Facts.of(facts), flags=flags, excess=excess)  # fmt: skip


def _seen(prior: StationaryPrior | LocalLinesPrior, load: Array, dt: float) -> tuple[float, float]:
    """Width (s) at which a single sample is shown where the load is largest, and the share of it that is lost."""
    at = np.unravel_index(int(np.argmax(np.abs(load))), load.shape)
    one = np.zeros_like(load)
    one[at] = 1.0
    seen = prior.resolved(one)[:, at[1]]
    return half_width(seen) * dt, float(np.clip(1 - seen[at[0]], 0.0, 1.0))


def replaced(
    found: SolvedLoad, learned: Priors, choice: Choice, dt: float, acting: NDArray[np.bool_] | None = None
) -> SolvedLoad:
    """The answer with the load of the local prior, where that is used; the facts say which stands, and why.

    Parameters
    ----------
    acting : array, shape (samples,), optional
        When the loads act; at other times they are zero.
    """
    if isinstance(learned, StationaryPrior):
        return _between(_constant(found, THROUGHOUT), [learned])
    if learned is None:
        return found
    if isinstance(learned, str):
        return _constant(found, learned)
    if isinstance(learned, Smooth):
        return _smooth(found, learned, choice, dt)
    prior, posed = learned.prior, learned.posed
    facts = {
        **found.facts,
        "variance": "local" if learned.asked_for else "constant",
        "log_evidence_local": prior.evidence,
        "log_evidence_stationary": prior.stationary.evidence,
        "gain_for_each_bump": prior.gain,
        "local_asked_for": prior.asked_for,
    }
    if not learned.asked_for:
        stationary = [prior.stationary] if isinstance(prior.stationary, StationaryPrior) else []
        return _between(replace(found, facts=Facts.of(facts)), [prior, *stationary])
    load, band, start = prior.posterior(prior.errors)
    if acting is not None:
        when = np.repeat(acting[:, None], load.shape[1], axis=1)
        load, band = np.where(when, load, 0.0), ActingPosterior(band, when)
    response, residual = posed.compare(load, choice.lam, start)
    resolution, lost = _seen(prior, load, dt)
    facts |= {
        "path": posed.name,
        "resolution": resolution,
        "peak_bias": lost,
        "edf": prior.freedom(),
        "model_misfit": prior.misfit,
        "model_errors": wrong(learned),
    }
    flags = tuple(flag for flag in found.flags if not flag.code.endswith(SMEARED))
    excess = _beyond_fair(prior, posed, residual)
    return replace(found, load=load, std=band.std, posterior=band, bias=None, response=response, residual=residual,
                   facts=Facts.of(facts), flags=flags, excess=excess)  # fmt: skip
