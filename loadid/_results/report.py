"""One self-contained HTML page of a load estimate: the answer, its picture, what to mind; the rest is folded."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from structures._flags import Flag, codes
from structures._flags import table as guards
from structures.errors import plain

from .. import _page
from .._page import Html, PageSection
from .functionals import in_words
from .shown import label
from .summary import (
    CAUTIONS,
    DISC95,
    NOT_TOLD,
    OTHERS,
    UNEXPLAINED,
    Z95,
    against,
    allowed,
    along,
    cannot_tell,
    comparison,
    diagnosis,
    facts,
    headline,
    impulses,
    noise,
    not_told,
    notes,
    number,
    plus_minus,
    refusals,
    rules,
    sort,
    state,
)

if TYPE_CHECKING:
    from .._page.chart import Chart
    from .estimate import LoadEstimate

Rows = list[tuple[str, str, str]]  # label, value and remark of loads
_SHOWN = 12  # loads that are compared with known ones
_LISTED = 200  # loads of the table
# what a setting that was not given stands for
_DEFAULTS = {
    "choice": "automatic",
    "hold": "the model's own",
    "sensors": "all",
    "penalty": "none (plain least squares)",
    "noise": "estimated",
}


def write_report(estimate: LoadEstimate, path: str | os.PathLike[str], *, truth: ArrayLike | None = None) -> None:
    """Write the page, whole or not at all.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    _page.write_page(path, lambda: page(estimate, truth=truth))


def page(estimate: LoadEstimate, *, truth: ArrayLike | None = None, png: bytes | None = None) -> str:
    """The page as text; `png` is the picture of the load, where it has been drawn and the page needs it."""
    title = f"Load estimate: {', '.join(estimate.labels[:4])}" + (" …" if len(estimate.labels) > 4 else "")
    rows = _told(estimate)
    sections = [
        PageSection("Result", _page.joined(_known(estimate, truth), _picture(estimate, truth, png), _notes(estimate))),
        PageSection("Cautions", cautions(estimate)),
        PageSection("Every load", _every(estimate, rows), folded=True),
        PageSection("What every line can tell", _lines(estimate), folded=True),
        PageSection("Measured against predicted", _response(estimate), folded=True),
        PageSection("What the data cannot tell", _limits(estimate), folded=True),
        PageSection("What the data can tell", _diagnosis(estimate), folded=True),
        PageSection("How lambda was chosen", _choice(estimate), folded=True),
        PageSection("Flags", flag_list(estimate.flags), folded=True),
        PageSection("Verification", verification(estimate), folded=True),
        PageSection("Provenance", provenance_table(estimate), folded=True),
    ]
    answer = _page.joined(_answer(estimate, rows), checked(estimate))
    note = "  |  ".join(label(estimate))
    return _page.document(title, sections, about=about(estimate), note=note, answer=answer)


def fragment(estimate: LoadEstimate) -> str:
    """Short form for notebooks: answer, picture and cautions in the style of the page, without a script."""
    rows = _told(estimate)
    answer, picture = _page.joined(_answer(estimate, rows), checked(estimate)), _picture(estimate, None, page=False)
    folded = [("Every load", _every(estimate, rows)), ("Flags", flag_list(estimate.flags))]
    return _page.part("inside", _page.text(_page.STYLE), answer, picture, cautions(estimate, linked=False), folded)


def about(e: LoadEstimate) -> str:
    """The line below the heading: family and time."""
    return " · ".join(str(e.provenance[key]) for key in ("family", "created") if e.provenance.get(key))


# -- the answer -------------------------------------------------------------------------------------------------------
def refused(e: LoadEstimate) -> Html:
    """Why the answer is not to be used, where that is so."""
    return _page.joined(*(_page.part("notice", line, "", "alert") for line in refusals(e)))


def _answer(e: LoadEstimate, rows: Rows) -> Html:
    """The largest load with its band and its grade; resultants, and a few others."""
    if (nothing := not_told(e)) is not None:
        said = _page.part("answer", "load", "none told from noise", "", e.grade.letter,
                          f"grade {e.grade.letter} ({e.grade.meaning})")  # fmt: skip
        return _page.joined(said, _page.paragraphs(nothing.message), _page.part("quiet", nothing.advice))
    first, *others = rows
    cards = [(r.name, f"{plus_minus(r.value, None if r.std is None else Z95 * r.std)} {r.unit}", "resultant, 95 % band")
             for r in e.resultants]  # fmt: skip
    named = [] if cards else others[: OTHERS - 1]
    more = len(others) - len(named)
    return _page.joined(
        refused(e),
        _page.part("answer", first[0] if e.axis is None else f"peak of {first[0]}", first[1], "95 % band",
                   e.grade.letter, str(e.grade)),
        _page.part("quiet", first[2]),
        _page.part("cards", [*cards, *named]) if cards or named else "",
        _page.part("quiet", f"{more} smaller load{'s' * (more != 1)} below, under Every load") if more > 0 else "",
    )  # fmt: skip


def _told(e: LoadEstimate) -> Rows:
    """Label, value with its 95 % band, and remark of every load, the largest first."""
    wide = DISC95 if e.load.dtype.kind == "c" else Z95
    rows = []
    for peak, impulse in sorted(zip(e.peaks, impulses(e), strict=True), key=lambda pair: -abs(pair[0].value)):
        at = "" if peak.at is None or e.axis is None else f"peak at {along(e.axis, peak.at)}"
        remark = " · ".join(x for x in (at, impulse, f"std {number(peak.std, 3)} {peak.unit}") if x)
        rows.append((peak.label, f"{plus_minus(peak.value, wide * peak.std)} {peak.unit}", remark))
    return rows


def _every(e: LoadEstimate, rows: Rows) -> Html | str:
    """All loads as a table, where the answer does not name them all."""
    if len(rows) <= OTHERS and not (e.resultants and len(rows) > 1):
        return ""
    more = len(rows) - _LISTED
    rest = _page.part("quiet", f"and {more} smaller ones, in the result file") if more > 0 else ""
    return _page.joined(_page.table(rows[:_LISTED], ("load", "value, 95 % band", "")), rest)


def checked(e: LoadEstimate) -> Html:
    """How things were set up: checks of the model, noise level, what was allowed."""
    known = e.certificate
    return _page.joined(
        _page.part("notice", e.verified, "" if known.wrong else "good") if known is not None else "",
        _page.part("quiet", state(e)),
        _page.part("notice", allowed(e)) if e.allowed else "",
    )


def cautions(e: LoadEstimate, *, linked: bool = True) -> Html:
    """The few cautions that are expected to matter most, and how many remarks there are besides.

    `linked`: each code leads to what it means, further down on the page.
    """
    shown = [flag for flag in e.cautions if flag.code not in (UNEXPLAINED, NOT_TOLD)]
    few, rest = shown[:CAUTIONS], len(e.flags) - min(len(shown), CAUTIONS)
    more = f"{rest} more remark{'s' * (rest != 1)} below, under Flags" if rest else ""
    if not few:
        return _page.joined(_page.paragraphs("No caution was raised."), _page.part("quiet", more) if more else "")
    return _page.part("cautions", few, more, linked)


# -- sections ---------------------------------------------------------------------------------------------------------
def _known(e: LoadEstimate, truth: ArrayLike | None) -> Html | str:
    """How far the estimate lies from a known load, where there is one that is not zero."""
    if truth is None or e.axis is None:
        return ""
    import numpy as np

    known = np.asarray(plain(truth), complex if e.load.dtype.kind == "c" else float)
    known = known.reshape(e.load.shape) if known.size == e.load.size else known
    if known.shape != e.load.shape:
        return ""  # the picture refuses it in words
    return _page.paragraphs(*(
        (f"{name}, " if len(e.labels) > 1 else "") + comparison(against(e, known[:, j], j))
        for j, name in enumerate(e.labels[:_SHOWN])
        if np.any(known[:, j])
    ))  # fmt: skip


def _picture(e: LoadEstimate, truth: ArrayLike | None, png: bytes | None = None, *, page: bool = True) -> Html:
    from .charts import of_load

    charts = of_load(e, truth)
    if charts is None:  # a map over a surface
        wide = png or _map(e, truth, narrow=False)
        small = _map(e, truth, narrow=True) if page else b""
        return _page.image(wide, "map of the load over its surface with its std", small)
    return drawn(charts, live=page)


def _map(e: LoadEstimate, truth: ArrayLike | None, *, narrow: bool) -> bytes:
    from .._plots import load_figure
    from .._plots.style import drawn as rendered

    return rendered(load_figure(e, truth=truth, narrow=narrow), "png")


def drawn(charts: list[Chart], *, beside: bool = False, live: bool = True) -> Html:
    """Charts below each other, or beside each other where there is room."""
    pieces = _page.joined(*(_page.drawn(chart, live=live) for chart in charts))
    return _page.part("beside", pieces) if beside and len(charts) > 1 else pieces


def _lines(e: LoadEstimate) -> Html | str:
    """Bands that are not trusted, of an estimate over frequency lines."""
    if e.spectrum is None:
        return ""
    from .charts import of_lines

    s, trusted = e.spectrum, e.spectrum.trust()
    rows = [
        (name, f"{trusted[:, j].mean():.1%}", in_words(s.bands(j), 8) or "none")
        for j, name in enumerate(e.labels[:_SHOWN])
    ]
    head = ("load", f"lines predicted to {s.level:.0%} or better", "bands that are not trusted")
    return _page.joined(_page.table(rows, head), drawn(of_lines(e)))


def _notes(e: LoadEstimate) -> Html | str:
    lines = notes(e)
    if not lines:
        return ""
    return _page.joined(_page.part("quiet", "Decided while reading the record:"), _page.part("listed", lines, "quiet"))


def flag_list(flags: Sequence[Flag]) -> Html:
    """The flags, the gravest first, and what the table says of their codes."""
    if not flags:
        return _page.paragraphs("No guard raised a flag.")
    raised = codes(flags)
    return _page.part("flags", sort(flags), [guard for code, guard in guards().items() if code in raised])


def _choice(e: LoadEstimate) -> Html:
    from .charts import of_choice

    if e.choice is None:
        return _page.paragraphs("No lambda was chosen.")
    rows = [*rules(e.choice)]
    return _page.joined(
        _page.paragraphs(headline(e.choice), f"noise: {noise(e.choice)}"),
        _page.table(rows, ("rule", "relative lambda", "remark")) if rows else "",
        drawn(of_choice(e), beside=True),
    )


def _diagnosis(e: LoadEstimate) -> Html | str:
    """Recoverable modes, decay, conditioning and point spreads, in words and in pictures."""
    from .charts import of_diagnosis

    if e.diagnosis is None:
        return ""
    return _page.joined(_page.part("listed", diagnosis(e)), drawn(of_diagnosis(e), beside=True))


def _limits(e: LoadEstimate) -> Html | str:
    if not e.facts:
        return ""
    prior = e.provenance.get("prior")
    said = f"What the data do not determine is filled by the prior: {prior}." if prior else ""
    return _page.joined(_page.paragraphs(cannot_tell(e), said), _page.table(facts(e)))


def _response(e: LoadEstimate) -> Html | str:
    from .charts import of_response

    return drawn(of_response(e))


def verification(e: LoadEstimate) -> Html:
    """The check of the forward model against a known load."""
    c = e.certificate
    if c is None:
        advice = "Check the model against a known load (model.verify) and the certificate travels with every estimate."
        return _page.paragraphs(f"{e.verified}.", advice)
    ratios = c.noise_ratio or ("not known",) * len(c.sensors)
    rows = [
        (s, number(g), number(r), f"{x:.2%}", number(q))
        for s, g, r, x, q in zip(c.sensors, c.gain, c.shape, c.error, ratios, strict=True)
    ]
    head = ("sensor", "gain (1 is right)", "shape (1 is right)", "residual", "residual / noise")
    return _page.joined(_page.paragraphs(f"Checked against {c.source} on {c.date}."), _page.table(rows, head))


def provenance_table(e: LoadEstimate) -> Html:
    """Inputs, settings and versions, in rows."""
    return _page.table(_flat(e.provenance)) if e.provenance else _page.paragraphs("Not recorded.")


def _flat(tree: Mapping[str, Any], prefix: str = "", parent: str = "") -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    for key, value in tree.items():
        if key == "notes":
            continue  # they stand with the result
        name = prefix + str(key).replace("_", " ")
        if parent == "inputs":  # paths stay as they are, in the column that wraps
            rows.append(("input", f"{key}, sha256 {value}"))
        elif isinstance(value, Mapping):
            rows += _flat(value, f"{name}: ", str(key))
        else:
            default = _DEFAULTS.get(str(key)) if value is None and parent == "settings" else None
            rows.append((name, default or number(value, 6)))
    return rows
