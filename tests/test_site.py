"""The documentation site: it builds without a warning, fetches nothing, and everything has its place on it.

It is built once for the module (half a minute of CPU). Sphinx itself refuses what pages name and is missing.
"""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

from docs.making import gallery
from structures._flags import table
from tests.blocks import ROOT

for needed in ("sphinx", "myst_parser", "pydata_sphinx_theme", "latex2mathml"):
    pytest.importorskip(needed)

FETCHED = {
    ("script", "src"),
    ("link", "href"),
    ("img", "src"),
    ("source", "srcset"),
    ("iframe", "src"),
    ("object", "data"),
}


class Page(HTMLParser):
    """What a page fetches, where it leads, and its anchors."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.links: list[str] = []
        self.anchors: set[str] = set()
        self.feed(path.read_text("utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {key: value or "" for key, value in attrs}
        self.fetched += [given[key] for of, key in FETCHED if of == tag and key in given]
        self.links += [given["href"]] if tag == "a" and "href" in given else []
        self.anchors |= {given["id"]} if "id" in given else set()


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built site; building it fails where there is a warning."""
    import subprocess
    import sys

    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run([sys.executable, "-m", "docs", str(folder)], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-4000:]
    return folder / "html"


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[str, Page]:
    return {path.relative_to(site).as_posix(): Page(path) for path in site.rglob("*.html")}


def test_nothing_is_fetched_from_outside(site: Path, pages: dict[str, Page]) -> None:
    wrong = {name: url for name, page in pages.items() for url in page.fetched if urlsplit(url).netloc}
    assert not wrong
    for style in site.rglob("*.css"):
        text = re.sub(r"/\*.*?\*/", "", style.read_text("utf-8", errors="replace"), flags=re.DOTALL)
        assert not re.search(r"""(?:url\(\s*["']?|@import\s+["'])(?:https?:)?//""", text), style.name


def test_every_link_inside_leads_somewhere(pages: dict[str, Page]) -> None:
    """Pages that Sphinx itself makes, such as the search, and files beside the pages included."""
    wrong = []
    for name, page in pages.items():
        for link in page.links:
            target = urlsplit(link)
            if target.scheme or target.netloc:
                continue
            path = (Path("/") / Path(name).parent / unquote(target.path)).as_posix() if target.path else "/" + name
            parts: list[str] = []
            for part in path.split("/")[1:]:
                parts = parts[:-1] if part == ".." else [*parts, part]
            there, anchor = pages.get("/".join(parts)), unquote(target.fragment)
            lost = target.path.endswith(".html") if there is None else anchor and anchor not in there.anchors
            wrong += [f"{name}: {link}"] if lost else []
    assert not wrong, "\n".join(wrong[:20])


def test_every_code_has_its_section(pages: dict[str, Page]) -> None:
    assert {code.lower() for code in table()} <= pages["guards.html"].anchors
    assert all(f"guards.html#{code.lower()}" == guard.docs.removeprefix("docs/").replace(".md", ".html")
               for code, guard in table().items())  # fmt: skip


def test_every_public_name_has_its_entry(pages: dict[str, Page]) -> None:
    from docs.making import reference

    assert len(reference.names()) > 200
    missing = [name.full for name in reference.names()
               if name.entry not in pages[f"reference/{name.entry.rpartition('.')[0]}.html"].anchors]  # fmt: skip
    assert not missing
    linked = {module: " ".join(pages[f"reference/{module}.html"].links) for module in reference.modules()}
    assert [n.full for n in reference.names() if f"#{n.entry}" not in linked[n.module]] == []


def test_a_colon_in_the_sentence_of_a_property_parts_no_type(site: Path) -> None:
    text = (site / "reference" / "tactile.html").read_text("utf-8")
    entry = text.partition('id="tactile.Press.parts"')[2].partition("</dd>")[0]
    assert "<p>Itself alone: what a sum is made of.</p>" in entry
    assert not [page.name for page in site.glob("reference/*.html")
                if '>Type<span class="colon">' in page.read_text("utf-8")]  # fmt: skip


def test_the_manual_tells_of_every_page_that_it_holds() -> None:
    """By a row of its table: a page that only the side bar names is found by nobody who does not know of it."""
    from docs.making import site

    text = (ROOT / "docs" / "manual.md").read_text("utf-8")
    table_, _, held = text.partition("```{toctree}")
    listed = re.findall(r"^(\w+)$", held.partition(":hidden:")[2], re.MULTILINE)
    assert {"lab", "guide"} <= set(listed)
    assert [name for name in [*listed, *site._others(ROOT / "docs")] if f"({name}.md)" not in table_] == []


def test_every_command_and_option_is_there(site: Path) -> None:
    from loadid import cli

    text = re.sub(r"<[^>]+>", "", (site / "reference" / "cli.html").read_text("utf-8"))
    for name, parser in cli.parsers().items():
        assert f"loadid {name}".strip() in text
        options = {option for action in parser.arguments for option in action.option_strings if action.help}
        hidden = {o for a in parser.arguments for o in a.option_strings if a.help == "==SUPPRESS=="}
        assert not [o for o in options - hidden - {"-h", "--help"} if o not in text], name


def test_every_case_study_has_its_page_and_its_numbers(site: Path) -> None:
    parts = {"__init__", "bodies", "pads"}  # no studies, but what some of them share
    modules = {path.stem for path in (ROOT / "case_studies").glob("*.py")} - parts
    assert {study.name for study in gallery.studies()} == modules
    for study in gallery.studies():
        text = (site / "gallery" / f"{study.name}.html").read_text("utf-8")
        assert "Source and statement" in text
        assert text.count("<tr") > 3, study.name
        assert f"{study.name}.png" in text or not study.picture.exists()


def test_the_records_of_the_gallery_are_those_of_the_tests() -> None:
    """`python -m docs --gallery NAME` records a study anew."""
    assert gallery.stale() == []


def test_an_assertion_that_changed_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    study = gallery.studies()[0]
    changed = {**study.record(), "pinned": study.record()["pinned"][1:]}
    monkeypatch.setattr(gallery.Study, "record", lambda self: changed if self == study else {"pinned": [
        {"test": test, "asserted": text} for test, text in gallery.assertions(self.tests)]})  # fmt: skip
    assert len(gallery.stale()) == 1


@pytest.mark.parametrize(("text", "short"), [
    ("np.float64(0.0331234567) <= 0.035", "0.03312 <= 0.035"), ("1.5e-12 < 1e-09", "1.5e-12 < 1e-09"), ("True", "True"),
    ("all(<generator object TestX.<genexpr> at 0x7f>)", ""),
])  # fmt: skip
def test_what_was_found_is_short(text: str, short: str) -> None:
    assert gallery.shortened(text) == short
