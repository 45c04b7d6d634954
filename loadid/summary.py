"""A load estimate in words: the same lines for the terminal, the report and the picture."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from structures.errors import InputError

if TYPE_CHECKING:
    from loadid.estimate import LoadEstimate
    from loadid.inverse.choice import Choice
    from structures.flags import Flag

# what the numbers of `facts` are called, in the order in which they are printed
FACTS = {
    "m": "data m",
    "n": "unknowns n",
    "rank": "rank",
    "nullity": "nullity",
    "kappa": "condition number of the visible part",
    "edf": "effective degrees of freedom",
    "residual_to_noise": "residual / noise",
    "resolution": "resolution width",
    "peak_bias": "share of a single-sample peak that is lost",
    "path": "solved by",
}
_SAID = {"resolution_unit", "noise_level", "noise_source", "guards_checked"}
_MANY = 8


def plus_minus(value: float, std: float | None) -> str:
    """``"1003 ± 12"``: the value rounded where the second digit of its std stands."""
    if std is None:
        return f"{value:.4g}"
    if not (std > 0 and math.isfinite(std) and math.isfinite(value)):
        return f"{value:.4g} ± {std:.2g}"
    places = 1 - math.floor(math.log10(std))
    if abs(value) >= 1e5 or max(abs(value), std) < 1e-3:
        digits = max(math.floor(math.log10(max(abs(value), std))) + places, 1)
        return f"{value:.{digits}e} ± {std:.1e}"
    return f"{round(value, places):.{max(places, 0)}f} ± {round(std, places):.{max(places, 0)}f}"


def number(value: Any, digits: int = 4) -> str:
    """A fact as text."""
    if value is None:
        return "not available"
    if isinstance(value, float):
        return f"{value:.{digits}g}"
    if isinstance(value, list | tuple):
        return ", ".join(number(v, digits) for v in value) or "none"
    return str(value)


def quantity(value: float, unit: str) -> str:
    """A time in a readable unit: ``"5.12 ms"``."""
    for factor, prefix in ((1, ""), (1e3, "m"), (1e6, "µ"), (1e9, "n")):
        if abs(value) * factor >= 1 and unit == "s":
            return f"{value * factor:.4g} {prefix}{unit}"
    return f"{value:.4g} {unit}"


def sort(flags: Iterable[Flag]) -> list[Flag]:
    """Refusals that were overridden first, then warnings, then notes."""
    return sorted(flags, key=lambda f: ("EWN".index(f.code[4]), f.code))


def pulse_window(estimate: LoadEstimate, load: int) -> tuple[float, float] | None:
    """Part of the axis that holds the pulse, with a margin; None where the load fills more than a fifth of it."""
    if estimate.axis is None or len(estimate.load) < 16:
        return None
    size = np.abs(estimate.load[:, load])
    large = np.flatnonzero(size > 0.2 * size.max())
    if len(large) == 0:
        return None
    first, last = int(large[0]), int(large[-1])
    width = max(last - first, 3)
    start, stop = max(first - 2 * width, 0), min(last + 3 * width, len(size) - 1)
    if last - first > 0.2 * len(size) or stop - start > 0.6 * len(size):
        return None
    return float(estimate.axis.values[start]), float(estimate.axis.values[stop])


def impulses(estimate: LoadEstimate) -> list[str]:
    """Impulse of every load in words: of its pulse where it has a short one, else of the record; "" without time."""
    texts = []
    for j in range(len(estimate.labels)):
        window = pulse_window(estimate, j)
        try:
            found = estimate.functional("impulse", load=j, window=window)
        except InputError:
            return [""] * len(estimate.labels)
        where = f" ({quantity(window[0], 's')} to {quantity(window[1], 's')})" if window else " (whole record)"
        texts.append(f"{found}{where}")
    return texts


def facts(estimate: LoadEstimate) -> list[tuple[str, str]]:
    """Name and text of every fact, the known ones first; what other lines say already is left out."""
    given = {k: v for k, v in estimate.facts.items() if k not in _SAID}
    unit = estimate.facts.get("resolution_unit")
    if unit is not None and isinstance(given.get("resolution"), float):
        given["resolution"] = quantity(given["resolution"], str(unit))
    known = [(name, given.pop(key)) for key, name in FACTS.items() if key in given]
    other = [(key.replace("_", " "), value) for key, value in given.items()]
    return [(name, number(value)) for name, value in known + other]


def rules(choice: Choice) -> list[tuple[str, str, str]]:
    """Name, lambda and remark of every rule that was asked."""
    rows = []
    for rule in choice.rules:
        lam = "refused" if rule.lam is None else f"{rule.lam:.3g}"
        remarks = [
            "chosen" if rule.rule == choice.rule else "",
            "at the edge of the sweep" if rule.edge else "",
            rule.note,
        ]
        rows.append((rule.rule, lam, "; ".join(r for r in remarks if r)))
    return rows


def headline(choice: Choice) -> str:
    """Which lambda was used, and what the agreement of the rules is worth."""
    text = f"relative lambda {choice.lam:.3g} ({choice.rule})"
    if choice.rules:
        text += f"; verdict: {choice.verdict}, rules {choice.spread:.2f} decades apart"
    return text + (f"; {choice.odds}" if choice.odds else "")


def noise(choice: Choice) -> str:
    """Noise level and where it comes from."""
    plain = choice.sigma is None or choice.sigma == 1  # 1: the data were whitened with the known noise
    return choice.sigma_source if plain else f"sigma {choice.sigma:.3g} ({choice.sigma_source})"


def summary(estimate: LoadEstimate) -> str:
    """All that a user must read, as text of a few lines."""
    lines = [_shape(estimate)]
    for key, word in (("family", "family"), ("prior", "prior")):
        if estimate.provenance.get(key):
            lines.append(f"  {word}: {estimate.provenance[key]}")
    lines += [f"  {line}" for line in _loads(estimate)]
    if estimate.choice is not None:
        lines.append(f"  lambda: {headline(estimate.choice)}")
        lines += [
            f"    {name}: {lam}{f' ({remark})' if remark else ''}" for name, lam, remark in rules(estimate.choice)
        ]
        lines.append(f"  noise: {noise(estimate.choice)}")
    if estimate.facts:
        lines.append("  " + "; ".join(f"{name} {value}" for name, value in facts(estimate)))
    lines.append(f"  verification: {estimate.verified}")
    if estimate.allowed:
        lines.append(f"  overridden refusals: {', '.join(estimate.allowed)}")
    lines.append(f"  flags: {len(estimate.flags) or 'none'}")
    lines += [f"    {flag}" for flag in sort(estimate.flags)]
    return "\n".join(lines)


def _shape(e: LoadEstimate) -> str:
    text = f"Load estimate: {len(e.labels)} load{'s' * (len(e.labels) != 1)}"
    if e.axis is None:
        return text
    span = quantity(float(e.axis.values[-1] - e.axis.values[0]), e.axis.unit)
    step = f", step {quantity(e.axis.step, e.axis.unit)}" if len(e.axis.values) > 1 else ""
    return f"{text}, {len(e.load)} samples over {span}{step}"


def _loads(e: LoadEstimate) -> list[str]:
    order = sorted(zip(e.peaks, impulses(e), strict=True), key=lambda p: -abs(p[0].value))
    shown = order if len(order) <= _MANY else order[:_MANY]
    lines = []
    for peak, impulse in shown:
        word = "peak " if e.axis is not None else ""
        at = "" if peak.at is None or e.axis is None else f" at {quantity(peak.at, e.axis.unit)}"
        lines.append(
            f"{peak.label}: {word}{plus_minus(peak.value, peak.std)} {peak.unit}{at}"
            + (f", {impulse}" if impulse else "")
        )
    if len(shown) < len(order):
        lines.append(f"({len(order) - len(shown)} smaller loads not listed)")
    return [*lines, "(± one standard deviation)"]
