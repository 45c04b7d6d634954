"""Pages that stand alone: templates, style, scripts and charts. Nothing is fetched, every text is escaped.

A page says the answer first, then shows it, then what to mind; the rest is folded. It works without its script, which
only zooms, reads off and saves what is there; the policy of the page lets no other script run.
"""

from __future__ import annotations

import base64
import hashlib
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, NewType

from structures.errors import InputError
from structures.files._storage import as_path, replace

from .chart import Chart, numbers, picture

if TYPE_CHECKING:
    from jinja2 import Environment

Html = NewType("Html", str)  # a piece of a page, escaped; plain text is escaped where it is put in

CHARTS, TABLES = "charts.js", "tables.js"  # scripts: of pages with charts, of pages with tables to sort
TICKS = "ticks.js"  # what the scripts of all charts begin with
STYLE = "page.css"


@dataclass(frozen=True)
class PageSection:
    """A titled part of a page.

    Parameters
    ----------
    title : str
    body : Html or str
        What stands in it; "" leaves the section out. Plain text is escaped.
    folded : bool
        Whether a reader opens it first.
    """

    title: str
    body: Html | str
    folded: bool = False


@dataclass(frozen=True)
class SortedCell:
    """A cell of a table that is sorted by `key` and not by its text."""

    text: Html | str
    key: float


def cleaned(value: Any) -> Any:
    """Text without what a terminal or a browser would obey: control characters and marks of direction become spaces."""
    if isinstance(value, str) and not hasattr(value, "__html__") and not value.isprintable():
        return "".join(c if c.isprintable() else " " for c in value)
    return value


@cache
def environment() -> Environment:
    """Where the templates come from: text is escaped, a name that does not exist is an error."""
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    return Environment(
        loader=FunctionLoader(text), autoescape=True, undefined=StrictUndefined, finalize=cleaned, trim_blocks=True,
        lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip


@cache
def text(name: str) -> str:
    """A file of the folder of templates."""
    return files("loadid._page").joinpath("templates", name).read_text(encoding="utf-8")


def code_of(script: str) -> str:
    """The script of a page, with what it shares with others."""
    return text(TICKS) + text(script) if script == CHARTS else text(script)


def part(name: str, *given: Any, **settings: Any) -> Html:
    """A piece of a page by its macro in ``parts.html``."""
    found: Html = getattr(environment().get_template("parts.html").module, name)(*given, **settings)
    return found


def drawn(chart: Chart, *, live: bool = True) -> Html:
    """A chart as a figure; `live`: with its numbers, for the script of the page."""
    return part("chart", data=numbers(chart) if live else None, **picture(chart))


def table(rows: Iterable[Sequence[Any]], head: Sequence[str] = (), *, sortable: bool = False) -> Html:
    """Rows of text as a table whose first column names the rest, or whose columns sort it by their `SortedCell`."""
    return part("table", [[*row] for row in rows], [*head], sortable)


def paragraphs(*lines: str) -> Html:
    """Lines of text, each a paragraph; empty ones are left out."""
    return part("paragraphs", [line for line in lines if line])


def image(content: bytes, words: str, narrow: bytes = b"") -> Html:
    """A PNG picture inside the page, what it shows in words, and the one that a phone shows instead."""
    wide, small = (f"data:image/png;base64,{base64.b64encode(x).decode()}" if x else "" for x in (content, narrow))
    return part("image", wide, words, small)


def joined(*pieces: Html | str) -> Html:
    """Pieces of a page below each other; plain text is escaped, empty ones are left out."""
    return part("joined", [piece for piece in pieces if piece])


def document(
    title: str, sections: Sequence[PageSection], *, about: str = "", note: str = "", answer: Html | str = "",
    script: str = CHARTS, wide: bool = False,
) -> str:  # fmt: skip
    """A whole page.

    Parameters
    ----------
    title, about, note : str
        Heading, the line below it, and what stands on pictures that are saved from the page.
    sections : sequence of PageSection
    answer : Html or str
        What a reader must see first.
    script : str
        The one script of the page.
    wide : bool
        Whether tables need the whole screen.
    """
    code, look, kept = code_of(script), text(STYLE), [section for section in sections if section.body.strip()]
    return environment().get_template("page.html").render(
        title=title, about=about, note=note, answer=answer, sections=kept, style=look, script=code,
        style_hash=_hash(look), script_hash=_hash(code), wide=wide,
    )  # fmt: skip


def require_page(path: Path, where: str = "") -> None:
    """Nothing, unless a page is asked for under the name of a PDF.

    Raises
    ------
    InputError
        It is written as HTML.
    """
    if path.suffix.lower() == ".pdf":
        raise InputError("a report is a page of HTML", where=where or str(path), found=path.suffix,
                         expected=".html or .htm", hint=f"name it {path.with_suffix('.html').name}, open it, and print "
                         "the page to PDF in the browser: it is laid out for paper")  # fmt: skip


def write_page(path: str | os.PathLike[str], made: Callable[[], str]) -> None:
    """Write a page, whole or not at all.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    target = as_path(path)
    require_page(target)
    if not target.resolve().parent.is_dir():  # said before the pictures are drawn
        raise InputError(
            "the folder does not exist", where=str(target), found=str(target.resolve().parent),
            hint="make the folder first, or write elsewhere",
        )  # fmt: skip
    replace(target, made().encode())


def _hash(content: str) -> str:
    """How a policy names what it lets run."""
    return "sha256-" + base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
