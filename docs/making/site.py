"""Stages the pages of the site, written and made, and lets Sphinx build them."""

from __future__ import annotations

import re
import shutil
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from . import gallery, reference
from .gallery import ROOT, Study

DOCS = ROOT / "docs"
HEAD = """\
Every case study of the project: its source, what it states, its code, figure and numbers. The numbers are those that
its tests assert, as they were found when the study was recorded (`python -m docs --gallery`); a test fails where an
assertion and its record differ.
"""
FOUND = 4  # values that an assertion found in a loop, as far as the page lists them


def stage(folder: Path) -> None:
    """Lay the pages of the site in an empty folder."""
    if folder.exists():
        shutil.rmtree(folder)
    shutil.copytree(DOCS, folder, ignore=shutil.ignore_patterns("making", "__pycache__", "__main__.py", "*.json"))
    (folder / "developers").mkdir(exist_ok=True)
    for name, place in (("CONTRIBUTING.md", "developers/contributing.md"), ("CHANGELOG.md", "developers/changelog.md")):
        (folder / place).write_text(_moved((ROOT / name).read_text("utf-8")), "utf-8")
    for page in folder.glob("*.md"):
        page.write_text(page.read_text("utf-8").replace("(../README.md)", "(index.md)"), "utf-8")
    guards = folder / "guards.md"
    guards.write_text("(guard-codes)=\n" + guards.read_text("utf-8"), "utf-8")
    _listed(folder / "manual.md", "@others", _others(folder))
    _listed(folder / "reference" / "index.md", "@modules", sorted(reference.modules()))
    reference.write(folder / "reference")
    _gallery(folder / "gallery")
    from . import house

    (folder / "static").mkdir(exist_ok=True)
    (folder / "static" / "house.svg").write_text(house.drawn(), "utf-8")


def _listed(page: Path, mark: str, names: Iterable[str]) -> None:
    """Put names in the place of a mark of a table of contents."""
    page.write_text(page.read_text("utf-8").replace(mark + "\n", "".join(f"{name}\n" for name in names)), "utf-8")


def _others(folder: Path) -> list[str]:
    """Pages of the first level that no table of contents of their neighbours names."""
    held = "".join((folder / name).read_text("utf-8") for name in ("index.md", "manual.md", "developers/index.md"))
    listed = set(re.findall(r"^(?:\.\./)?([\w/-]+)$", held, re.MULTILINE))
    return sorted({page.stem for page in folder.glob("*.md")} - listed - {"index"})


def _moved(text: str) -> str:
    """A page of the root, its links from where it is on the site."""
    return re.sub(r"\]\(docs/", "](../", text)


def build(source: Path, out: Path, *words: str) -> int:
    """HTML of the staged pages; 0 where nothing is wrong."""
    from sphinx.cmd.build import build_main

    if str(ROOT) not in sys.path:
        sys.path.insert(0, str(ROOT))
    doctrees = out.parent / "doctrees"
    return build_main(["-q", "-W", "--keep-going", "-b", "html", "-d", str(doctrees), *words, str(source), str(out)])


# -- the gallery -------------------------------------------------------------------------------------------------------
def _gallery(folder: Path) -> None:
    for study in gallery.studies():
        (folder / f"{study.name}.md").write_text("\n".join(_study(study)), "utf-8")
    (folder / "index.md").write_text("\n".join(_cards()), "utf-8")


def _cards() -> Iterator[str]:
    yield "# Gallery\n"
    yield HEAD
    groups = dict.fromkeys(study.group for study in gallery.studies())
    for group in groups:
        listed = [study for study in gallery.studies() if study.group == group]
        yield f"## {group}\n\n::::{{container}} cards"
        for study in listed:
            yield ""
            picture = f"[![]({study.name}.png)]({study.name}.md)" if study.picture.exists() else ""
            yield f":::{{container}} card\n{picture}\n\n**[{study.title}]({study.name}.md)**\n\n{study.said[0]}\n:::"
        yield "\n::::\n"
    yield "```{toctree}\n:hidden:\n"
    yield from (study.name for study in gallery.studies())
    yield "```\n"


def _study(study: Study) -> Iterator[str]:
    said, rest = study.said
    record = study.record()
    yield f"# {study.title}\n\n{said}\n"
    if study.picture.exists():
        yield f"![What the study draws: {said.rstrip('.')}]({study.name}.png){{.figure}}\n"
    yield "## Source and statement\n"
    yield rest.replace("``", "`") + "\n"
    yield f"## What it prints\n\n`python -m case_studies.{study.name}`\n"
    if record["printed"]:
        yield "```text\n" + record["printed"] + "\n```\n"
    yield "## What its tests pin\n"
    tests = ", ".join(f"`{test}`" for test in study.tests)
    yield f"Each line is an assertion of {tests}, with what it found when this page was recorded.\n"
    yield from _pins(record["pinned"])
    yield "## Code\n"
    yield f"`case_studies/{study.name}.py`, without its docstring:\n"
    yield f"```{{code-block}} python\n:class: long\n\n{_code(study)}\n```\n"


def _pins(pinned: list[dict[str, Any]]) -> Iterator[str]:
    yield "| what is asserted | found |\n|---|---|"
    test = ""
    for pin in (one for one in pinned if "tmp_path" not in one["asserted"]):
        if pin["test"] != test:
            test = pin["test"]
            yield f"| **{test.removeprefix('test_').replace('_', ' ')}** | |"
        found = [text for text in pin["found"] if text and text not in ("True", "not False")]
        more = f" and {len(found) - FOUND} more" if len(found) > FOUND else ""
        said = ", ".join(f"`{_cell(text)}`" for text in found[:FOUND]) + more
        yield f"| `{_cell(pin['asserted'])}` | {said or 'holds'} |"
    yield ""


def _cell(text: str) -> str:
    return text.replace("|", r"\|").replace("`", "'")


def _code(study: Study) -> str:
    return study.source.read_text("utf-8").partition('"""\n')[2].strip()
