"""The guide as one page that stands alone: the answer, every step with figures, evidence and flags, what is open."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from structures._flags import table as guards

from .. import __version__
from .. import _page as pages
from .._page import Html, PageSection
from .._page.chart import Chart, Curve
from .._results.summary import number
from .ledger import Signature, hashed
from .recipe import CANDIDATES, STEPS, VALIDATE, VERIFY
from .standing import BEFORE, relative

if TYPE_CHECKING:
    from .job import Guide, StepStanding

DONE, FAULTY = "signed", ("stale", "does not hold")
CURVES = "picard"  # figures that are drawn, not listed
DIGITS = 5
UNITS = {"_hz": ", Hz", "_per_s": ", 1/s", "_s": ", s", "_Pa": ", Pa", "_m": ", m"}  # ends of the names of figures
NAMES = {"m": "readings", "n": "unknowns", "kappa": "condition number", "edf": "effective degrees of freedom",
         "lam": "relative lambda", "nis": "squared innovation over its variance (NIS), per channel",
         "nis_by_chance": "NIS by chance"}  # fmt: skip
MANY = 12  # rows of a table, above which those that say the same stand together


def document(guide: Guide) -> str:
    """The whole page."""
    standing = guide.standing()
    sections = [
        PageSection("The job", _job(guide)),
        PageSection("The ten steps", _overview(standing)),
        PageSection("What was not done", _open(standing)),
        PageSection("Signed with cautions", _cautions(standing)),
        *(PageSection(f"Step {one.step.title}", _step(one)) for one in standing if one.signature is not None),
        PageSection("Every signature that was ever made", _history(guide), folded=True),
        PageSection("How to check this page", _how(guide)),
    ]
    about = " · ".join(part for part in (guide.ledger.about.get("structure", ""), f"job {guide.ledger.job}",
                                         f"loadid {__version__}") if part)  # fmt: skip
    return pages.document(
        "Load identification: ten steps, signed",
        sections,
        about=about,
        note=f"{guide.ledger.job}  |  seal {guide.ledger.seal[:16]}",
        answer=_answer(standing),
    )


# -- the answer --------------------------------------------------------------------------------------------------------
def _answer(standing: Sequence[StepStanding]) -> Html:
    good = [one for one in standing if one.state == DONE]
    faulty = [one for one in standing if one.state in FAULTY]
    waits = [one for one in standing if one.state not in (DONE, *FAULTY)]
    cards = [("signed and standing", f"{len(good)} of {len(standing)}", "steps"),
             ("stale or failed", str(len(faulty)), ", ".join(str(one.step.number) for one in faulty) or "none"),
             ("not done", str(len(waits)), ", ".join(str(one.step.number) for one in waits) or "none"),
             ("validated to", _level(standing), "step 9")]  # fmt: skip
    notices = [pages.part("notice", text, "", "alert") for text in _faults(faulty)]
    verified = next(one for one in standing if one.step.number == VERIFY)
    if verified.signature is None:
        notices.insert(
            0, pages.part("notice", "The forward model is not verified: nothing below it can be trusted.", "", "alert")
        )
    warned = [one.step.title for one in good if one.signature is not None
              and any(flag.get("level") != "note" for flag in one.signature.flags)]  # fmt: skip
    if warned:
        notices.append(
            pages.part("notice", f"Signed with cautions, which are listed below: step {', step '.join(warned)}.")
        )
    whole = not faulty and not waits
    end = pages.part("notice", "All ten steps are signed, and everything that they stand on is as it was.", "good")
    return pages.joined(pages.part("cards", cards), *notices, end if whole else "")


def _level(standing: Sequence[StepStanding]) -> str:
    one = standing[VALIDATE - 1]
    if one.signature is None or one.state == "stale":
        return "nothing"
    return str(one.signature.figures.get("level", "nothing")) + (" (disagrees)" if not one.signature.holds else "")


def _faults(faulty: Sequence[StepStanding]) -> list[str]:
    """A sentence for each step that does not stand; those that are stale as the one before them are only named."""
    led: list[tuple[StepStanding, list[str]]] = []
    for one in faulty:
        own = {why for why in one.why if not why.endswith(BEFORE)}
        if led and one.state == "stale" == led[-1][0].state and own <= set(led[-1][0].why):
            led[-1][1].append(one.step.title)
        else:
            led.append((one, []))
    return [
        f"Step {one.step.title} {_words(one)}" + (f" So are those after it: {'; '.join(same)}." if same else "")
        for one, same in led
    ]


def _words(one: StepStanding) -> str:
    return f"{'is stale' if one.state == 'stale' else one.state}: {'; '.join(one.why)}."


# -- sections ----------------------------------------------------------------------------------------------------------
def _job(guide: Guide) -> Html:
    rows = [(name, text) for name, text in guide.ledger.about.items()]
    rows += [("job file", guide.ledger.job), ("guide begun", guide.ledger.created)]
    settings = [(f"setting {name}", _value(value)) for name, value in guide.job.items() if name not in ("log", "model")]
    files = [(f"{name} now", f"{_relative(guide, name)}, sha256 {_now(guide, name)}") for name in ("model", "log")]
    words = "Structure, client and remarks are words of the author: no signature covers them."
    return pages.joined(pages.table([*rows, *files, *settings]), pages.part("quiet", words))


def _relative(guide: Guide, name: str) -> str:
    return relative(guide.job[name], guide.folder)


def _now(guide: Guide, name: str) -> str:
    from structures.errors import InputError

    try:
        return hashed(guide.job[name])
    except InputError as error:
        return f"not known: {error.what}"


def _overview(standing: Sequence[StepStanding]) -> Html:
    rows = [(f"{one.step.number} {one.state}", f"{one.step.name}{_outcome(one)}") for one in standing]
    return pages.table(rows, ("", "step and outcome"))


def _outcome(one: StepStanding) -> str:
    signature = one.signature
    return "" if signature is None else f": {signature.said} ({signature.by}, {signature.date[:10]})"


def _cautions(standing: Sequence[StepStanding]) -> Html | str:
    """Warnings of the guards that signatures carry, step by step."""
    rows = [
        (one.step.title, flag.get("code", ""), f"{flag.get('message', '')}. What to do: {flag.get('advice', '')}")
        for one in standing if one.signature is not None for flag in one.signature.flags if flag.get("level") != "note"
    ]  # fmt: skip
    return pages.table(rows, ("step", "code", "what a guard warns of")) if rows else ""


def _open(standing: Sequence[StepStanding]) -> Html:
    lines = [f"Step {one.step.title} is {one.state}. It needs: {one.step.needs}. Without it: {one.step.why}."
             for one in standing if one.signature is None]  # fmt: skip
    lines += [f"Step {one.step.title} must be signed again: {'; '.join(one.why)}." for one in standing
              if one.signature is not None and one.state in FAULTY]  # fmt: skip
    validated = standing[VALIDATE - 1].signature
    candidates = standing[CANDIDATES - 1].signature
    loads = {} if candidates is None else candidates.figures.get("loads", {})
    if validated is not None and "resultant" not in validated.figures.get("kinds", ()) and len(loads) > 1:
        lines.append("No resultant of the load was held against anything that is known.")
    if validated is not None and validated.figures.get("partial"):
        lines.append("The distribution of the load was not held against anything that is known: infinitely many "
                     "distributions have the same resultant.")  # fmt: skip
    for one in standing:
        if one.signature is not None and not _computed(one.signature):
            lines.append(
                f"Step {one.step.title}: the evidence was attached as it is; the package computed nothing of it."
            )
    return (
        pages.part("listed", lines) if lines else pages.paragraphs("Every step is signed, and every signature stands.")
    )


def _computed(one: Signature) -> bool:
    """Whether figures beside those of the model came of the evidence."""
    return one.step != 1 or "against_a_test" in one.figures or "made_from" in one.figures


def _step(one: StepStanding) -> Html:
    signature = one.signature
    assert signature is not None
    stamp = f"signed by {signature.by} on {signature.date}, loadid {signature.version}"
    seal = f"checksum {signature.checksum}"
    kind = "good" if one.state == DONE else ""
    return pages.joined(
        pages.paragraphs(f"{one.step.why[0].upper()}{one.step.why[1:]}."),
        pages.part("notice", f"{one.state}: {signature.said}", kind) if one.state != "does not hold" else "",
        pages.part("notice", _words(one).capitalize(), "", "alert") if one.state in FAULTY else "",
        pages.paragraphs(f"Note of who signed: {signature.note}") if signature.note else "",
        figures(signature.figures),
        _picard(signature.figures.get(CURVES, {})),
        _files(signature),
        _flags(signature.flags),
        pages.part("quiet", f"{stamp}; {seal}"),
    )


def figures(given: Mapping[str, Any]) -> Html:
    """Numbers in one table, tables of them below each other."""
    plain = [(_title(name), _value(value)) for name, value in given.items() if not isinstance(value, Mapping)]
    pieces: list[Html | str] = [pages.table(plain)] if plain else []
    for name, value in given.items():
        if isinstance(value, Mapping) and name != CURVES:
            pieces += [pages.part("quiet", _title(name)), _nested(value)]
    return pages.joined(*pieces)


def _nested(tree: Mapping[str, Any]) -> Html:
    if not all(isinstance(row, Mapping) for row in tree.values()):
        return pages.table([(_title(name), _value(value)) for name, value in tree.items()])
    columns = list(dict.fromkeys(key for row in tree.values() for key in row))
    rows = [(name, *(_value(row[key]) if key in row else "" for key in columns)) for name, row in tree.items()]
    return pages.table(_together(rows) if len(rows) > MANY else rows, ("", *map(_title, columns)))


def _together(rows: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Rows that say the same one after the other as one row, with the first name, the last one and their number."""
    runs: list[list[tuple[str, ...]]] = []
    for row in rows:
        if runs and runs[-1][0][1:] == row[1:]:
            runs[-1].append(row)
        else:
            runs.append([row])
    return [run[0] if len(run) == 1 else (f"{run[0][0]} to {run[-1][0]} ({len(run)})", *run[0][1:]) for run in runs]


def _title(name: str) -> str:
    if name in NAMES:
        return NAMES[name]
    end = next((end for end in UNITS if name.endswith(end)), "")
    return name.removesuffix(end).replace("_", " ") + UNITS.get(end, "")


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_value(one)}" for key, one in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(_value(one) for one in value) or "none"
    return number(value, DIGITS)


def _picard(curves: Mapping[str, Any]) -> Html | str:
    """Singular values and data coefficients, over the modes."""
    sigma, beta = (np.asarray(curves.get(name, ()), float) for name in ("singular_values", "coefficients"))
    if len(sigma) < 2 or len(sigma) != len(beta):
        return ""
    top = float(beta.max(initial=0.0)) or 1.0
    i = np.linspace(0.0, 1.0, len(sigma))
    shown = [np.where(y > 1e-17, y, np.nan) for y in (sigma, beta / top)]
    return pages.drawn(
        Chart(
            title="Picard plot",
            x_name="share of the modes, by falling singular value",
            y_name="relative to the largest",
            x=i,
            curves=[
                Curve("singular value", shown[0], "estimate"),
                Curve("data coefficient |u·y|", shown[1], "other4", True),
            ],
            y_log=True,
            said="Picard plot: singular values and data coefficients of the modes",
        )
    )


def _files(one: Signature) -> Html:
    rows = [
        (kind, name, digest)
        for kind, files in (("evidence", one.evidence), ("stands on", one.files))
        for name, digest in files.items()
    ]
    return pages.table(rows, ("", "file", "sha256")) if rows else pages.part("quiet", "no file")


def _flags(flags: Sequence[Mapping[str, Any]]) -> Html:
    if not flags:
        return pages.part("quiet", "No guard raised a flag.")
    rows = [
        (f"{flag.get('code', '')} {flag.get('level', '')}", _meaning(str(flag.get("code", ""))),
         f"{flag.get('message', '')} [{flag.get('evidence', '')}]", flag.get("advice", ""))
        for flag in flags
    ]  # fmt: skip
    return pages.table(rows, ("flag", "about", "what was found", "what to do"))


def _meaning(code: str) -> str:
    row = guards().get(code.removeprefix("LID-"))
    return "" if row is None else row.title


def _history(guide: Guide) -> Html | str:
    rows = [
        (
            str(k),
            f"{one.step}",
            one.date,
            one.by,
            one.version,
            "yes" if one.holds else "NO",
            one.said,
            one.checksum[:16],
        )
        for k, one in enumerate(guide.ledger.signatures, 1)
    ]
    head = ("", "step", "date", "by", "version", "holds", "outcome", "checksum")
    return pages.table(rows, head) if rows else ""


def _how(guide: Guide) -> Html:
    return pages.joined(
        pages.paragraphs(
            f"This page was written from {guide.path.name}. Its seal is {guide.ledger.seal}: the sha256 over every "
            "signature in order. Each signature carries the sha256 of its figures and of the signature before it, so "
            "that none can be changed, taken out or put in between without a trace.",
            "The checksums tell of changes, not of persons: who signed is what was stated at the time.",
            f"In the folder of the job, loadid guide status --job {guide.ledger.job} hashes every file again and says "
            "which signatures still stand; sha256sum FILE gives the hashes that are listed here.",
            f"Figures were computed by the package. Steps: {', '.join(one.title for one in STEPS)}.",
        )
    )


def in_lines(one: Signature) -> list[str]:
    """The figures of a signature as lines of text."""
    lines = []
    for name, value in one.figures.items():
        if name == CURVES:
            continue
        if isinstance(value, Mapping):
            lines += [f"  {_title(name)}:", *(f"    {key}: {_value(part)}" for key, part in value.items())]
        else:
            lines.append(f"  {_title(name)}: {_value(value)}")
    return lines
