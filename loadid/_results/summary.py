"""A load estimate in words: the same lines for the terminal, the report and the picture."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from structures._advice import on_command_line
from structures._flags import cautions
from structures.errors import InputError, plain

if TYPE_CHECKING:
    from structures._flags import Flag

    from .._inverse.choice import Choice
    from .._inverse.diagnosis.diagnose import Diagnosis
    from .estimate import Axis, LoadEstimate, Peak


NOT_VERIFIED = "forward model not verified"
_MANY = 8
NARROW = 0.9  # share of a pulse inside its 95 % band below which the band is called too narrow there
CAUTIONS, OTHERS = 3, 4  # that a short summary has room for; loads that it names
UNTESTED = "LID-W703"
UNSTATED = ("unknown", "residual")
NOISE = {"datasheet": "data sheet", "pre_trigger": "quiet part of the record", "quiet": "unloaded record"}
Z95, DISC95 = 1.959963984540054, math.sqrt(-math.log(0.05))  # half-widths of 95 % bands, of numbers and of moduli
UNEXPLAINED = "LID-W412"  # the load does not explain its data: said before all else
NOT_TOLD = "LID-W318"  # no load is told from noise: said in place of the number


def plus_minus(value: float, half: float | None) -> str:
    """``"1003 ± 12"``: the value rounded where the second digit of half its band stands; in words ± is 95 %."""
    if half is None:
        return f"{value:.4g}"
    if not (half > 0 and math.isfinite(half) and math.isfinite(value)):
        return f"{value:.4g} ± {half:.2g}"
    places = 1 - math.floor(math.log10(half))
    if abs(value) >= 1e5 or max(abs(value), half) < 1e-3:
        digits = max(math.floor(math.log10(max(abs(value), half))) + places, 1)
        return f"{value:.{digits}e} ± {half:.1e}"
    return f"{round(value, places):.{max(places, 0)}f} ± {round(half, places):.{max(places, 0)}f}"


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


def along(axis: Axis, value: float) -> str:
    """A place on the first axis: ``"5.12 ms"``, ``"frame 7"``."""
    return quantity(value, axis.unit) if axis.unit else f"{axis.name} {value:g}"


def sort(flags: Iterable[Flag]) -> list[Flag]:
    """Refusals that were overridden first, then warnings by their expected effect on the load, then notes."""
    flags = list(flags)
    return [*cautions(flags), *sorted((f for f in flags if f.level == "note"), key=lambda f: f.code)]


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


def against(estimate: LoadEstimate, truth: Any, load: int = 0) -> dict[str, Any]:
    """Comparison of one load with a known one (samples,).

    Returns
    -------
    dict
        ``error`` (relative, L2), ``peak_error`` (relative, signed), ``coverage_95`` (share of all samples inside the
        95 % band), ``learned`` (that band is of a variance that changes with time) and, where the load is one short
        pulse, ``window`` and ``coverage_95_peak`` of it; else None.
    """
    amplitudes = estimate.load.dtype.kind == "c"
    found, known = estimate.load[:, load], np.asarray(plain(truth), complex if amplitudes else float)
    lower, upper = (edge[:, load] for edge in estimate.band())
    disc = np.abs(known - found) <= upper - np.abs(found)  # of complex amplitudes
    inside = disc if amplitudes else (known >= lower) & (known <= upper)
    peak, real = (float(np.abs(y) if amplitudes else y) for x in (found, known) for y in [x[np.argmax(np.abs(x))]])
    window, near = pulse_window(estimate, load), None
    if window is not None and estimate.axis is not None:
        axis = estimate.axis.values
        near = float(np.mean(inside[(axis >= window[0]) & (axis <= window[1])]))
    return {
        "error": float(np.linalg.norm(found - known) / np.linalg.norm(known)),
        "peak_error": peak / real - 1,
        "coverage_95": float(np.mean(inside)),
        "coverage_95_peak": near,
        "window": window,
        "learned": estimate.facts.get("variance") == "local",
    }


def comparison(error: dict[str, Any]) -> str:
    """Answer of `against` as one line."""
    text = (
        f"against the known load: relative error {error['error']:.2%}, peak error {error['peak_error']:+.2%}; the 95 % "
        f"band holds {share(error['coverage_95'])} of all samples"
    )
    if error.get("window") is None:
        return text
    start, stop = (quantity(t, "s") for t in error["window"])
    text += f" and {share(error['coverage_95_peak'])} of those around the peak ({start} to {stop})"
    if error["coverage_95_peak"] >= NARROW:
        return text
    if error.get("learned"):
        return f"{text}\ncaution: the band is too narrow around the peak, or the known load has errors of its own"
    return (
        f"{text}\ncaution: do not read the band as 95 % around the peak: it is that of a load of one variance "
        "throughout, and a hit is none"
    )


def share(part: float) -> str:
    """A share in per cent, rounded down: 100 % is said of all, not of nearly all."""
    if part >= 1:
        return "100 %"
    places = 2 if part > 0.99 else 1
    return f"{math.floor(part * 10 ** (2 + places) + 1e-9) / 10**places:.{places}f} %"


def allowed(estimate: LoadEstimate, word: str = "overridden refusals") -> str:
    """The codes of ``allow=`` in words: refusals that were overridden, apart from what was allowed without need."""
    done = overridden(estimate)
    idle = [code for code in estimate.allowed if code not in done]
    texts = [f"{word}: {', '.join(done)}"] if done else []
    return "; ".join([*texts, f"allowed: {', '.join(idle)}"] if idle else texts)


def overridden(estimate: LoadEstimate) -> list[str]:
    """Codes of the refusals that the result owes its existence to."""
    lam = None if estimate.choice is None else estimate.choice.lam
    rank, n = estimate.facts.rank, estimate.facts.n
    short = lam == 0 and rank is not None and n is not None and rank < n
    found = {f.code for f in estimate.flags} | ({"LID-E306"} if short else set())
    return [code for code in estimate.allowed if code[4] == "E" and code in found]


def notes(estimate: LoadEstimate) -> list[str]:
    """What was decided while reading the record."""
    return [str(n) for n in estimate.provenance.get("notes") or ()]


def cannot_tell(estimate: LoadEstimate) -> str:
    """One sentence on what the data do not determine; "" where it is not known."""
    nullity, n = estimate.facts.nullity, estimate.facts.n
    if nullity is None:
        return ""
    loads = "component" if nullity == 1 else "components"
    if nullity > 0:
        of = f" of {n}" if n else ""
        return (
            f"{nullity}{of} {loads} of the load leave no trace in the data: what is shown of them comes from the prior "
            "alone."
        )
    width, bias, unit = estimate.facts.resolution, estimate.facts.peak_bias, estimate.facts.resolution_unit or ""
    limits = [] if width is None else [f"nothing finer than {quantity(width, unit).strip()} is resolved"]
    if bias is not None:
        limits.append(f"a peak of a single sample is shown at {1 - bias:.0%} of its height")
    rest = " and ".join(limits) or "weak components are held down by the prior"
    return f"Every component of the load leaves a trace in the data (nullity 0), but not all equally: {rest}."


def diagnosis(estimate: LoadEstimate) -> list[str]:
    """What the data can tell: recoverable modes, law of decay and what it buys, conditioning, point spreads."""
    d = estimate.diagnosis
    if d is None:
        return []
    level = "; the data coefficients fall to the end, no noise is seen" if d.floor == 0 else ""
    used = float(np.sum(d.filter_factors))
    lines = [f"recoverable modes: i* = {d.plateau} of {d.seen} (lambda uses {used:.3g}){level}"]
    lines.append(f"decay: {d.decay}{_buys(d)}")
    hidden = "" if not d.null_share else f"; {share(d.null_share)} of the load shown lies in ker(H)"
    lines.append(f"condition number {d.kappa:.3g} of the visible part, rank {d.rank} and nullity {d.nullity}{hidden}")
    talk = d.cross_talk[d.columns == d.load]
    names = estimate.labels if len(estimate.labels) == d.n else [f"load {j + 1}" for j in range(d.n)]
    other = share(float(talk[0])) if len(talk) and np.isfinite(talk[0]) else "beyond measure"
    lines.append(
        f"a single load at {names[d.load]} is shown {d.width:.3g} {d.width_unit} wide at {1 - d.peak_bias:.0%} of its "
        f"height, cross-talk {other} of that; worst {names[d.worst]} at {d.heights[d.worst]:.0%}"
    )
    return lines


def _buys(d: Diagnosis) -> str:
    """What a better signal-to-noise ratio buys, from where the record stands."""
    ten, hundred = d.decay.buys(10.0, d.snr), d.decay.buys(100.0, d.snr)
    if not (math.isfinite(ten) and math.isfinite(hundred)):
        return ""
    return f"; 10 x better SNR buys x {ten:.3g} of resolution, 100 x buys x {hundred:.3g}, as long as the mesh allows"


def facts(estimate: LoadEstimate) -> list[tuple[str, str]]:
    """Title and text of every fact; what other lines say already is left out."""
    given = dict(estimate.facts)
    if (width := estimate.facts.resolution) is not None and (unit := estimate.facts.resolution_unit) is not None:
        given["resolution"] = quantity(width, unit)
    return [(title, number(value)) for key, value in given.items() if (title := estimate.facts.title(key))]


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


def refusals(estimate: LoadEstimate) -> list[str]:
    """Why the answer is not to be used, in one line; nothing where it may be."""
    return [f"NOT TO BE USED: {f.message}" for f in estimate.flags if f.code == UNEXPLAINED]


def not_told(estimate: LoadEstimate) -> Flag | None:
    """The flag of an answer that tells no load from noise."""
    return next((f for f in estimate.flags if f.code == NOT_TOLD), None)


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


def summary(estimate: LoadEstimate, *, details: bool = False, command: bool = False) -> str:
    """What a user must read first, in at most eight lines; `details`: all that is known besides.

    Line by line: why the answer is not to be used, where that is so; the largest load with its 95 % band and its grade;
    other loads; resultants; how things were set up; up to three cautions, those first that are expected to matter most.
    `command`: advice in the words of the command line.
    """
    refused = refusals(estimate)
    shown = [f for f in cautions(estimate.flags) if f.code not in (UNEXPLAINED, NOT_TOLD)]
    most = CAUTIONS - len(refused)
    lines = [*refused, *_first(estimate), f"state: {'; '.join([state(estimate), *notes(estimate)])}"]
    lines += [f"caution: {_caution(flag, command)}" for flag in shown[:most]]
    if details:
        return "\n".join([*lines, *_details(estimate, command)])
    rest = len(estimate.flags) - len(shown[:most]) - len(refused) - (not_told(estimate) is not None)
    how = "--details" if command else "summary(details=True)"
    return "\n".join([*lines, f"how it was found, and {rest} more remark{'s' * (rest != 1)}: {how}"])


def state(estimate: LoadEstimate) -> str:
    """How things were set up, in one line: what was checked, and where the noise level comes from."""
    certificate, tested = estimate.certificate, not any(f.code == UNTESTED and f.state for f in estimate.flags)
    model = NOT_VERIFIED if certificate is None else "forward model " + (
        "checked, and wrong" if certificate.wrong else "verified"
    )  # fmt: skip
    parts = [model, "band tested" if tested else "band not tested"]
    if estimate.choice is not None:
        kind = estimate.choice.source.kind
        parts.append(f"noise level: {'from the residual' if kind in UNSTATED else NOISE.get(kind, kind)}")
    if estimate.facts.history_band is not None:
        parts.insert(0, f"what the load does in {estimate.facts.history_band}, and nothing else")
    if estimate.facts.explained is not None:
        parts.append(f"the harmonic explains {estimate.facts.explained:.1%} of the record")
    if estimate.validation is not None:
        parts.append("validated")
    return "; ".join([*parts, *([allowed(estimate)] if estimate.allowed else [])])


def _caution(flag: Flag, command: bool) -> str:
    message, advice = (on_command_line(x) if command else x for x in (flag.message, flag.advice))
    return f"{message} ({flag.code.removeprefix('LID-')}). What to do: {advice}"


def _first(e: LoadEstimate) -> list[str]:
    """The largest load with its band and its grade; the others; resultants."""
    peaks = sorted(e.peaks, key=lambda p: -abs(p.value))
    kind = "peak " if e.axis is not None else ""

    wide = DISC95 if e.load.dtype.kind == "c" else Z95

    def said(peak: Peak) -> str:
        at = "" if peak.at is None or e.axis is None else f" at {along(e.axis, peak.at)}"
        return f"{peak.label} {plus_minus(peak.value, wide * peak.std)} {peak.unit}{at}"

    if (nothing := not_told(e)) is not None:
        return [f"{nothing.message}; grade {e.grade.letter} ({e.grade.meaning})"]
    lines = [f"{kind}{said(peaks[0])} (95 % band); {e.grade}"]
    if len(peaks) > 1:
        more = len(peaks) - OTHERS
        text = ", ".join(said(p) for p in peaks[1:OTHERS]) + (f"; {more} smaller loads not listed" if more > 0 else "")
        lines.append(f"{kind}{text}")
    if e.resultants:
        lines.append("resultants, with 95 % band: " + "; ".join(
            f"{r.name} {plus_minus(r.value, None if r.std is None else Z95 * r.std)} {r.unit}" for r in e.resultants
        ))  # fmt: skip
    return lines


def _details(estimate: LoadEstimate, command: bool) -> list[str]:
    """How the answer was found, and every flag."""
    lines = [_shape(estimate)]
    for key, word in (("family", "family"), ("prior", "prior")):
        if estimate.provenance.get(key):
            lines.append(f"  {word}: {estimate.provenance[key]}")
    lines += [f"  {line}" for line in _loads(estimate)]
    lines.append(f"  expected error of the load: {number(estimate.grade.expected, 2)} of its size")
    if estimate.choice is not None:
        lines.append(f"  lambda: {headline(estimate.choice)}")
        lines += [
            f"    {name}: {lam}{f' ({remark})' if remark else ''}" for name, lam, remark in rules(estimate.choice)
        ]
        lines.append(f"  noise: {noise(estimate.choice)}")
    if estimate.facts:
        lines.append("  " + "; ".join(f"{name} {value}" for name, value in facts(estimate)))
    lines += [f"  {line}" for line in diagnosis(estimate)]
    if estimate.facts.band is not None:
        lines.append(f"  the band holds {estimate.facts.band}")
    lines.append(f"  validation: {'level none' if estimate.validation is None else estimate.validation}")
    lines.append(f"  verification: {estimate.verified}")
    if estimate.allowed:
        lines.append(f"  {allowed(estimate)}")
    lines.append(f"  flags: {len(estimate.flags) or 'none'}")
    lines += [f"    {flag.command if command else flag}" for flag in sort(estimate.flags)]
    return lines


def _shape(e: LoadEstimate) -> str:
    text = f"Load estimate: {len(e.labels)} load{'s' * (len(e.labels) != 1)}"
    if e.axis is None:
        return text
    if e.axis.unit == "":  # counted, not measured
        return f"{text}, {len(e.load)} {e.axis.name}s, {e.axis.values[0]:g} to {e.axis.values[-1]:g}"
    span = quantity(float(e.axis.values[-1] - e.axis.values[0]), e.axis.unit)
    step = f", step {quantity(e.axis.step, e.axis.unit)}" if len(e.axis.values) > 1 else ""
    return f"{text}, {len(e.load)} samples over {span}{step}"


def _loads(e: LoadEstimate) -> list[str]:
    order = sorted(zip(e.peaks, impulses(e), strict=True), key=lambda p: -abs(p[0].value))
    wide = DISC95 if e.load.dtype.kind == "c" else Z95
    shown = order if len(order) <= _MANY else order[:_MANY]
    lines = []
    for peak, impulse in shown:
        word = "peak " if e.axis is not None else ""
        at = "" if peak.at is None or e.axis is None else f" at {along(e.axis, peak.at)}"
        lines.append(
            f"{peak.label}: {word}{plus_minus(peak.value, wide * peak.std)} {peak.unit}{at}"
            + (f", {impulse}" if impulse else "")
        )
    if len(shown) < len(order):
        lines.append(f"({len(order) - len(shown)} smaller loads not listed)")
    return [*lines, "(±: 95 % band)"]
