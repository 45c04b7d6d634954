"""The load under a prior whose variance changes with time, in place of that of one lambda."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from structures.errors import InputError

from .._inverse.choice import Choice, ungraded
from .._inverse.local_prior import LocalPrior, freedom, local_prior, posterior, resolved, unexplained, with_errors
from .._results.facts import Facts
from .answer import SolvedLoad, beyond_noise
from .histories import half_width
from .posing import Posed

SMEARED = "W311"


@dataclass(frozen=True, eq=False)
class Learned:
    """Both priors, and whether the local one is used.

    Parameters
    ----------
    prior : LocalPrior
    asked_for : bool
        By the user, or by the data.
    names : tuple of str
        Of the errors of the model.
    """

    prior: LocalPrior
    asked_for: bool
    names: tuple[str, ...] = ()


def learned(posed: Posed, variance: str) -> Learned | None:
    """Both priors of a problem; None where none is to be learned, or where there are no states to learn it from.

    Raises
    ------
    InputError
        Asked for by name, on another path.
    """
    if variance == "constant":
        return None
    if posed.record is None:
        if variance == "auto":
            return None
        raise InputError("a local variance is learned over the states of a model", where="variance", found=posed.name,
                         expected="a model with state_space()")  # fmt: skip
    prior = local_prior(posed.record, stated=posed.noise.known)
    asked = variance == "local" or prior.asked_for
    if asked and posed.nuisances is not None:
        return Learned(with_errors(prior, posed.nuisances), asked, posed.nuisances.names)
    return Learned(prior, asked)


def unasked(choice: Choice, learned: Learned) -> Choice:
    """The choice of lambda where the load is not that of any lambda: its rules are no judgement of it.

    A model that the data contradict beyond what it was said to be wrong by has the worst grade.
    """
    if learned.prior.contradicted:
        return replace(ungraded(choice), odds=f"the data contradict the model: {wrong(learned)}")
    odds = "the variance of the load was learned by its evidence; lambda and its rules are those of a constant variance"
    return replace(choice, verdict="not asked", odds=odds)


def wrong(learned: Learned) -> str:
    """What the data tell of the errors of the model, the largest first, in words."""
    errors, prior = learned.prior.errors, learned.prior
    beside = f"{prior.misfit:.1%} of the response is of no load and of no error that is known"
    if errors is None:
        return beside
    std = np.sqrt(np.diag(errors.covariance))
    sure = [i for i in np.argsort(-np.abs(errors.mean)) if abs(errors.mean[i]) > 2 * std[i]]
    told = [f"{learned.names[i]} {errors.mean[i]:+.1%}" for i in sure[:3]]
    return ", ".join([*told, beside])


def words(learned: Learned | None) -> str:
    """The prior in words; "" where it is that of the penalty."""
    if learned is None or not learned.asked_for:
        return ""
    memory = "white" if not learned.prior.memory else f"smooth over {learned.prior.memory:g} samples"
    return f"a load of zero mean whose variance changes with time, {memory}"


def replaced(found: SolvedLoad, learned: Learned, posed: Posed, choice: Choice, dt: float) -> SolvedLoad:
    """The answer with the load of the local prior, where that is used; the facts name both priors in any case."""
    prior = learned.prior
    facts = {
        **found.facts,
        "log_evidence_local": prior.evidence,
        "log_evidence_stationary": prior.stationary.evidence,
        "gain_for_each_bump": prior.gain,
        "local_asked_for": prior.asked_for,
    }
    if not learned.asked_for:
        return replace(found, facts=Facts.of(facts))
    load, band, start = posterior(prior, prior.errors)
    response, residual = posed.compare(load, choice.lam, start)
    at = np.unravel_index(int(np.argmax(np.abs(load))), load.shape)
    one = np.zeros_like(load)
    one[at] = 1.0
    seen = resolved(prior, one)[:, at[1]]
    facts |= {
        "resolution": half_width(seen) * dt,
        "peak_bias": float(np.clip(1 - seen[at[0]], 0.0, 1.0)),
        "edf": freedom(prior),
        "model_misfit": prior.misfit,
        "model_errors": wrong(learned),
    }
    flags = tuple(flag for flag in found.flags if not flag.code.endswith(SMEARED))
    excess = beyond_noise(unexplained(prior), prior.record.data, posed.noise)
    return replace(found, load=load, std=band.std, posterior=band, bias=None, response=response, residual=residual,
                   facts=Facts.of(facts), flags=flags, excess=excess)  # fmt: skip
