"""Guards of the choice of lambda."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from structures.flags import Evidence, Flag

from ..inverse.choice import Choice
from .base import collect

DECADE = 1.0  # spread of the rules, decades
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
