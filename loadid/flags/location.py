"""Guards of the search for the place of a load."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from structures.errors import NotIdentifiable
from structures.flags import Evidence, Flag

AMBIGUOUS = 1.05  # runner-up over best: all misses of 1520 simulated searches lay below 1.045
COARSE = 0.03  # relative lambda above which residuals measure bias: misses with ratios above 1.05 were seen from there
LOUD, LARGE = 3.0, 0.1  # residual over noise, and over data, from which on no candidate explains the data
CERTAIN = 1.96  # half-width of the 95 % band in standard deviations


def ambiguous(ratio: float, found: str, rival: str) -> Flag | None:
    """W511: another place explains the data as well, by the ratio of the residual norms."""
    if ratio >= AMBIGUOUS:
        return None
    return Flag(
        "W511",
        Evidence("residual of the runner-up over the best", float(ratio), AMBIGUOUS),
        f"the place is ambiguous: {rival} explains the data as well as {found}, residual ratio {ratio:.4f}",
        "add a sensor off the symmetry axis, or use a record with less noise",
    )


def blurred(std: float, spacing: float, found: str) -> Flag | None:
    """W511: the place is not known to one spacing of the candidates."""
    if CERTAIN * std <= spacing:
        return None
    return Flag(
        "W511",
        Evidence("half-width of the 95 % band of the place, m", float(CERTAIN * std), float(spacing)),
        f"the place {found} is ambiguous: it is known to ±{CERTAIN * std:.3g} m only, the candidates are "
        f"{spacing:.3g} m apart",
        "add sensors, or use a record with less noise",
    )


def at_the_rim(found: str) -> Flag:
    """W511: the place came to rest at the end of the candidates; the best one may lie beyond."""
    return Flag(
        "W511",
        Evidence("place", found, "inside the grid of candidates"),
        f"the place is ambiguous: {found} lies on the rim of the candidates, and the best place may lie beyond",
        "extend the grid of candidates",
    )


def unexplained(to_noise: float | None, residual: float) -> Flag | None:
    """W511: no place explains the data: the load acts beyond the candidates, or the model is wrong."""
    if to_noise is None or to_noise <= LOUD or residual <= LARGE:
        return None
    return Flag(
        "W511",
        Evidence("residual over noise", float(to_noise), LOUD),
        f"no place explains the data: the best one leaves {residual:.0%} of them, {to_noise:.3g} times the noise",
        "extend the grid of candidates, search for several loads (impacts=2), or check the model and the noise level",
    )


def few_sensors(sensors: int, loads: int) -> Flag | None:
    """W511: as many unknown histories as sensors: every place explains the data with some load."""
    if sensors > loads:
        return None
    return Flag(
        "W511",
        Evidence("sensors", float(sensors), float(loads + 1)),
        f"the place is ambiguous: with {sensors} sensor{'s' * (sensors > 1)} and {loads} unknown "
        f"histor{'ies' if loads > 1 else 'y'} every place explains the data with some load, and only the size of that "
        "load speaks for one of them",
        "use more sensors than there are loads",
    )


def biased(lam: float) -> Flag | None:
    """W511: a large lambda leaves residuals that measure bias, not the place."""
    if lam <= COARSE:
        return None
    return Flag(
        "W511",
        Evidence("relative lambda", float(lam), COARSE),
        f"the place is ambiguous: at a relative lambda of {lam:.2g} the residuals measure what the penalty takes away",
        "use the default of 1e-3",
    )


def alike(groups: Sequence[Sequence[str]], difference: float) -> NotIdentifiable:
    """E512: candidates at different places whose loads leave the same data, from the model alone."""
    return NotIdentifiable(
        f"{_listed(groups)} give the same data: their impulse responses differ by at most {difference:.1g}",
        advice="move or add a sensor off the symmetry axis, drop one candidate of each group, or allow=['LID-E512'] to "
        "have all of them reported",
        code="LID-E512",
    )


def alike_allowed(groups: Sequence[Sequence[str]], difference: float) -> Flag:
    """E512 as a flag, where the user allowed it."""
    return Flag(
        "E512",
        Evidence("relative difference of the impulse responses", f"at most {difference:.1g}", f"{difference:.1g}"),
        f"{_listed(groups)} give the same data",
        "move or add a sensor off the symmetry axis; the load may act at any of them",
    )


def not_comparable(what: str, found: Any) -> NotIdentifiable:
    """E513: a regularisation that differs from candidate to candidate."""
    return NotIdentifiable(
        f"residuals of candidates are not comparable with {what}: {found}",
        advice="give one relative lambda for all candidates (choice=1e-3); a rule may choose the lambda of the load at "
        "the place that was found (settings={'choice': ...})",
        code="LID-E513",
    )


def _listed(groups: Sequence[Sequence[str]]) -> str:
    shown = ["candidates " + " and ".join(g[:6]) + (" ..." if len(g) > 6 else "") for g in groups[:4]]
    return "; ".join(shown) + (f"; and {len(groups) - 4} more groups" if len(groups) > 4 else "")
