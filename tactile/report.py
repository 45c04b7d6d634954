"""One self-contained HTML page of a force map: numbers of the strongest frame, map and std, forces over the frames."""

from __future__ import annotations

import os
from collections.abc import Iterable
from functools import partial
from html import escape
from importlib.resources import files
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from loadid import report as parts
from structures.errors import InputError

from .words import numbers, provided

if TYPE_CHECKING:
    from .forcemap import ForceMap

BITMAP = 10**6  # points: maps are bitmaps, a vector picture of them is many times larger


def write_report(
    force: ForceMap,
    path: str | os.PathLike,
    *,
    truth: ArrayLike | None = None,
    wrenches: ArrayLike | None = None,
    frame: int | None = None,
    about: Iterable[tuple[str, str]] = (),
    compared: Iterable[tuple[str, ...]] = (),
) -> None:
    """Write the page, whole or not at all; the settings are those of `page`.

    Raises
    ------
    InputError
        If the file cannot be written, or the truth does not fit.
    """
    from structures.storage import as_path, replace

    target = as_path(path)
    if not target.resolve().parent.is_dir():  # said before the pictures are drawn
        raise InputError("the folder does not exist", where=str(target), found=str(target.resolve().parent),
                         hint="make the folder first, or write elsewhere")  # fmt: skip
    text = page(force, truth=truth, wrenches=wrenches, frame=frame, about=about, compared=compared)
    replace(target, text.encode())


def page(
    force: ForceMap,
    *,
    truth: ArrayLike | None = None,
    wrenches: ArrayLike | None = None,
    frame: int | None = None,
    about: Iterable[tuple[str, str]] = (),
    compared: Iterable[tuple[str, ...]] = (),
) -> str:
    """The page as text.

    Parameters
    ----------
    force : ForceMap
        One frame, or a sequence.
    truth, wrenches, frame
        As `tactile.plots.maps.sequence_figure`.
    about : iterable of (str, str)
        How the map came about: names and texts.
    compared : iterable of (str, str, str)
        What was compared with the truth: name, estimate, truth.
    """
    from .plots.maps import chosen, named

    k = chosen(force, frame)
    one = force if force.single else force.frame(k)
    name = "" if force.single else f", {named(force, k)}"
    sections = [
        (f"Result{name}", _result(one) + _picture(force, one, truth, wrenches, frame)),
        ("Against the truth", _compared(compared)),
        ("Flags", parts.flag_list(force)),
        ("How it came about", _about(force, about)),
        ("Verification", parts.verification(force)),
        ("Provenance", parts.provenance_table(force)),
    ]
    body = "\n".join(f"<section>\n<h2>{escape(title)}</h2>\n{text}\n</section>" for title, text in sections if text)
    said = " · ".join(escape(str(x)) for x in (force.provenance.get("family"), force.provenance.get("created")) if x)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<title>Contact force map</title>
<style>
{files("loadid").joinpath("report.css").read_text(encoding="utf-8")}</style>
</head>
<body>
<header>
<h1>Contact force map</h1>
<p class="quiet">{said}</p>
{parts.notices(force)}
</header>
<main>
{body}
</main>
</body>
</html>
"""


def _result(one: ForceMap) -> str:
    cards = "".join(
        f"<li>{escape(name)}<b>{escape(value)}</b>{escape(remark)}</li>" for name, value, remark in numbers(one)
    )
    return f'<ul class="results">{cards}</ul><p class="quiet">± one standard deviation</p>'


def _picture(
    force: ForceMap, one: ForceMap, truth: ArrayLike | None, wrenches: ArrayLike | None, frame: int | None
) -> str:
    from .plots.maps import sequence_figure

    name, value, _ = numbers(one)[0]
    draw = partial(sequence_figure, force, truth=truth, wrenches=wrenches, frame=frame)
    return parts.html_image(draw, f"map of pressure and shear with its std: {name} {value}", BITMAP)


def _compared(rows: Iterable[tuple[str, ...]]) -> str:
    listed = list(rows)
    return parts.html_table(listed, ("", "estimate", "truth")) if listed else ""


def _about(force: ForceMap, about: Iterable[tuple[str, str]]) -> str:
    facts = force.facts
    rows = [*about]
    said = {name for name, _ in rows}
    own = [
        ("motion", provided(force)),
        ("frames", "1" if force.single else str(len(force.load))),
        ("lambda", f"{facts['lambda']:.3g} by {facts['lambda_rule']}" if "lambda" in facts else ""),
        ("readings and loads", f"{facts.get('m', '?')} and {facts.get('n', '?')}" if "n" in facts else ""),
        ("solved by", _path(facts.get("path"))),
    ]
    rows += [(name, text) for name, text in own if text and name not in said]
    prior = force.provenance.get("prior")
    said_prior = f"<p>What the data do not determine is filled by the prior: {escape(str(prior))}.</p>" if prior else ""
    return parts.html_table(rows) + said_prior


def _path(path: object) -> str:
    """How the frames were solved; what counts the steps of each is cut."""
    if isinstance(path, list):
        return "; ".join(dict.fromkeys(str(p).rpartition(", ")[0] or str(p) for p in path))
    return "" if path is None else str(path)
