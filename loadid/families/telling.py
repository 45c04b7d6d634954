"""What a static estimate says of itself: facts, flags and settings."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from structures.flags import Flag

from .. import flags as guards
from ..inverse import diagnose
from ..inverse.choice import Choice, residual_level
from ..inverse.path import Solution
from . import smoothness
from .readings import Readings
from .steady import Absolute, Steady, discrepancy

if TYPE_CHECKING:
    from .static import StaticInversion

MANY = 16  # loads from which their mesh can be called fine


def facts(
    posed: Steady, choice: Choice, sigma: float, solution: Solution, diagnosis: diagnose.Diagnosis
) -> dict[str, Any]:
    """Numbers that are printed with every result."""
    path, load, posterior = posed.path, solution.load, solution.posterior
    kappa, rank, nullity = posed.layout
    point = path.at(choice.lam)
    return {
        "path": posed.solved_by,
        "m": len(posed.H),
        "n": posed.H.shape[1],
        "frames": 1 if load.ndim == 1 else len(load),
        "rank": rank,
        "nullity": nullity,
        "kappa": kappa,
        "edf": None if point.edf is None else float(point.edf),
        "residual_to_noise": residual_level(path, choice.lam) if posed.noise.known else None,
        "noise_share": _noise_share(posterior, load),
        "noise_level": float(sigma),
        **posed.noise.source.facts,
        "band": posed.band,
        "resolution": diagnosis.width,
        "resolution_unit": diagnosis.width_unit,
        "peak_bias": diagnosis.peak_bias,
    }


def flags(
    family: StaticInversion,
    given: Readings,
    posed: Steady,
    choice: Choice,
    facts: dict[str, Any],
    diagnosis: diagnose.Diagnosis,
) -> tuple[Flag, ...]:
    """Findings of the guards."""
    model, lost = family.model, [s.label for i, s in enumerate(family.model.sensors) if i not in given.rows]
    after = (facts["kappa"], facts["rank"], facts["nullity"])
    unseen = [c.label for c, column in zip(model.loads, posed.H.T, strict=True) if not np.any(column)]
    simulated = "" if given.data is None else given.data.record.simulated_by
    return guards.collect(
        [
            *_overridden(family, posed),
            *model.flags,
            guards.not_verified(model.certificate),
            *given.flags,
            guards.null_space(facts["m"], facts["n"], facts["rank"], unseen),
            None if posed.full is None else guards.lost_channels(posed.full, after, lost),
            posed.correlated,
            guards.mixed_kinds(given.channels, posed.noise.known),
            *_resolved(family, posed, choice, diagnosis),
            *posed.fought(choice, posed.noise.sigma or facts["noise_level"]),
            *(() if family.free else guards.parameter(choice, lambda factor: discrepancy(posed, factor))),
            guards.absolute_lambda(family.choice.lam, choice.scale) if isinstance(family.choice, Absolute) else None,
            guards.inverse_crime(simulated, model.fingerprint),
            guards.no_coverage(family.coverage),
            guards.used_for_training("the record", given.fingerprints & model.training),
            guards.resolution(
                facts["nullity"],
                smoothness.words(family.penalty, family.basis),
                facts["resolution"],
                facts["resolution_unit"],
                facts["peak_bias"],
            ),
        ]
    )


def settings(family: StaticInversion, posed: Steady) -> dict[str, Any]:
    """Settings of an inversion, for the provenance."""
    given = family.choice.lam if isinstance(family.choice, Absolute) else family.choice
    return {
        "method": family.method,
        "penalty": family.penalty if isinstance(family.penalty, str | None) else "matrix",
        "choice": given,
        "calibration": None if family.calibration is None else str(family.calibration),
        "constraints": [str(c) for c in family.constraints],
        "constraint_kinds": [type(c).__name__ for c in family.constraints],
        "path": posed.solved_by,
        "noise_source": posed.noise.source.text,
        "interpolated": family.interpolation is not None,
        "sensors": None if family.sensors is None else [str(s) for s in family.sensors],
    }


def _resolved(
    family: StaticInversion, posed: Steady, choice: Choice, diagnosis: diagnose.Diagnosis
) -> list[Flag | None]:
    """W304, W310, and W107 where no penalty ties neighbouring loads together."""
    edf = None if choice.edf is None else choice.edf / diagnosis.frames
    found = [
        guards.over_smoothed(edf, diagnosis.plateau),
        guards.recoverable(diagnosis.plateau, diagnosis.seen, edf),
    ]
    smooth = family.basis is not None and family.basis.kind == "polynomials"
    if family.L is None and not smooth and diagnosis.n >= MANY:
        basis = family.basis
        parts = {} if basis is None else {"components": len(basis.components), "edges": basis.edges}
        found.append(guards.refined(diagnose.against_half(posed.base.problem.H, diagnosis.eta, **parts)))
    return found


def _overridden(family: StaticInversion, posed: Steady) -> list[Flag]:
    """Refusals that `allow` took away."""
    found = []
    if "LID-E102" in family.allow and guards.diagonal(family.H) is not None:
        found.append(guards.overridden("E102", "off-diagonal entries", 0, 1))
    if "LID-E306" in family.allow and family.free and posed.rank < family.H.shape[1]:
        found.append(guards.overridden("E306", "rank", posed.rank, family.H.shape[1]))
    return found


def _noise_share(posterior: Any, load: NDArray[np.float64]) -> float | None:
    """Share of the variance of the largest load that is noise; None where the posterior does not tell."""
    noise = getattr(posterior, "noise_std", None)
    if noise is None:
        return None
    at = np.unravel_index(int(np.argmax(np.abs(load))), load.shape)
    noise, std = np.broadcast_to(noise, load.shape), np.broadcast_to(posterior.std, load.shape)
    return float((noise[at] / std[at]) ** 2) if std[at] > 0 else None
