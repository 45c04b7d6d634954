"""Records the gallery: what every case study prints and draws, and what its tests found where they assert.

`python -m docs --gallery` runs the case studies and their tests and keeps the records in ``docs/gallery``: for each
study a JSON file and a picture. Pages are made of them without running anything; `stale` says which records no longer
fit the tests and the text that they were made from.
"""

from __future__ import annotations

import ast
import io
import json
import os
import re
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
RECORDS = ROOT / "docs" / "gallery"
WIDE = 1000  # pixels of a picture


@dataclass(frozen=True)
class Study:
    """A case study: its module's name, its title and group on the site, and the tests that pin its numbers."""

    name: str
    title: str
    group: str
    tests: tuple[str, ...]

    @property
    def source(self) -> Path:
        """Its file."""
        return ROOT / "case_studies" / f"{self.name}.py"

    @property
    def said(self) -> tuple[str, str]:
        """Its first sentence; and the rest of its docstring, which names its source and what it states."""
        text = ast.get_docstring(ast.parse(self.source.read_text("utf-8"))) or ""
        first, _, rest = text.partition("\n\n")
        return " ".join(first.split()), rest

    @property
    def kept(self) -> Path:
        """Where its record is."""
        return RECORDS / f"{self.name}.json"

    def record(self) -> dict[str, Any]:
        """What was recorded when it ran: what it ``printed``, and what its tests ``pinned``."""
        found: dict[str, Any] = json.loads(self.kept.read_text("utf-8"))
        return found

    @property
    def picture(self) -> Path:
        """Its figure; a study may have none."""
        return RECORDS / f"{self.name}.png"


@cache
def studies() -> tuple[Study, ...]:
    """All of them, in the order of the site."""
    rows = tomllib.loads((RECORDS / "studies.toml").read_text("utf-8"))
    return tuple(Study(name, row["title"], row["group"], tuple(row["tests"])) for name, row in rows.items())


# -- what tests assert -------------------------------------------------------------------------------------------------
def assertions(tests: Sequence[str]) -> list[tuple[str, str]]:
    """Test and text of every assertion of some tests, ``file::Class``, ``file::function`` or a whole file."""
    return [(name, " ".join(ast.unparse(node.test).split())) for test in tests
            for name, function in _functions(*test.partition("::")[::2])
            for node in ast.walk(function) if isinstance(node, ast.Assert)]  # fmt: skip


def _functions(path: str, wanted: str) -> Iterator[tuple[str, ast.FunctionDef]]:
    for node in ast.parse((ROOT / path).read_text("utf-8")).body:
        inside = node.body if isinstance(node, ast.ClassDef) else [node]
        if not wanted or getattr(node, "name", "") == wanted:
            yield from ((one.name, one) for one in inside if isinstance(one, ast.FunctionDef)
                        and one.name.startswith("test_"))  # fmt: skip


class _Pins:
    """A plugin of pytest that notes what every assertion found."""

    def __init__(self) -> None:
        self.found: list[dict[str, str]] = []

    def pytest_assertion_pass(self, item: Any, lineno: int, orig: str, expl: str) -> None:
        """Called for each assertion that holds."""
        text = " ".join(ast.unparse(ast.parse(orig.strip(), mode="eval")).split())
        self.found.append({"node": item.nodeid, "asserted": text, "found": shortened(expl.splitlines()[0])})


def shortened(text: str) -> str:
    """Numbers of an explanation to four digits, without the names of their types; ``""`` where there is none."""
    text = re.sub(r"np\.(?:float64|int64|bool|bool_)\(([^()]*)\)", r"\1", text)
    text = re.sub(r"-?\d+\.\d+(?:e[-+]?\d+)?", lambda number: f"{float(number[0]):.4g}", text)
    return "" if len(text) > 90 or re.search(r"<[A-Za-z]", text) else text


def _pin(study: Study) -> list[dict[str, Any]]:
    """Run the tests of a study; what each assertion found. A picture that they draw is kept where there is none."""
    script = "import sys; from docs.making.gallery import pinned; pinned(sys.argv[1], sys.argv[2:])"
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "pins.json"
        # rewritten tests are cached without what the hook needs: look for them elsewhere
        settings = {**os.environ, "PYTHONPYCACHEPREFIX": folder, "MPLBACKEND": "agg"}
        words = [sys.executable, "-c", script, str(out), *study.tests]
        subprocess.run(words, cwd=ROOT, env=settings, check=True, stdout=subprocess.DEVNULL)
        grouped: dict[tuple[str, str], list[str]] = {}
        for pin in json.loads(out.read_text("utf-8")):
            name = pin["node"].rpartition("::")[2].partition("[")[0]
            grouped.setdefault((name, pin["asserted"]), []).append(pin["found"])
        drawn = sorted((Path(folder) / "made").rglob("x.png"))
        if drawn and not study.picture.exists():
            study.picture.write_bytes(small(drawn[0].read_bytes()))
    return [{"test": test, "asserted": text, "found": [*dict.fromkeys(found)]}
            for (test, text), found in grouped.items()]  # fmt: skip


def pinned(out: str, tests: Sequence[str]) -> None:
    """What `_pin` starts in a process of its own: run tests, write what their assertions found.

    Raises
    ------
    RuntimeError
        If one of them fails.
    """
    import pytest

    pins = _Pins()
    words = ["-q", "-n", "0", "-p", "no:cacheprovider", "-o", "enable_assertion_pass_hook=true", "--timeout", "3000",
             "--basetemp", str(Path(out).with_name("made"))]  # fmt: skip
    if code := pytest.main([*words, *tests], plugins=[pins]):
        raise RuntimeError(f"pytest ended with {code}: {' '.join(tests)}")
    Path(out).write_text(json.dumps(pins.found), "utf-8")


# -- running -----------------------------------------------------------------------------------------------------------
def record(names: Sequence[str] = (), *, printing: bool = True) -> None:
    """Run case studies, all or some, with their tests, and keep what they print, draw and find.

    Parameters
    ----------
    names : sequence of str
        Of modules; none stands for all.
    printing : bool
        Whether they run as users run them, which takes minutes for some, or their tests alone.
    """
    with tempfile.TemporaryDirectory() as folder:  # one for all: some go on with what others drew
        for study in studies():
            if not names or study.name in names:
                found = {"printed": "", **(study.record() if study.kept.exists() else {})}
                found["printed"] = _run(study, Path(folder)) if printing else found["printed"]
                found["pinned"] = _pin(study)
                study.kept.write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n", "utf-8")
                sys.stdout.write(f"{study.name}: {len(found['pinned'])} assertions\n")


def _run(study: Study, folder: Path) -> str:
    settings = {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg"}
    settings.setdefault("LOADID_DATA", str(ROOT.parent / "shared" / "data"))
    done = subprocess.run([sys.executable, "-m", f"case_studies.{study.name}"], cwd=folder, env=settings,
                          check=True, capture_output=True, text=True)  # fmt: skip
    if (drawn := folder / f"{study.name}.png").exists():
        study.picture.write_bytes(small(drawn.read_bytes()))
    return "\n".join(line.rstrip() for line in done.stdout.splitlines() if not line.startswith("picture")).strip()


def small(png: bytes, wide: int = WIDE) -> bytes:
    """A picture of few colours, no wider than `wide` pixels."""
    from PIL import Image

    image = Image.open(io.BytesIO(png)).convert("RGB")
    if image.width > wide:
        image = image.resize((wide, round(image.height * wide / image.width)), Image.Resampling.LANCZOS)
    out = io.BytesIO()
    image.quantize(128).save(out, "PNG", optimize=True)
    return out.getvalue()


# -- are the records those of today? -----------------------------------------------------------------------------------
def stale() -> list[str]:
    """Assertions of today's tests that a record lacks, and those of a record that are no longer asserted."""
    wrong = []
    for study in studies():
        recorded = {(pin["test"], pin["asserted"]) for pin in study.record()["pinned"]}
        wrong += [f"{study.name}: {test}: {text}" for test, text in recorded ^ set(assertions(study.tests))]
    return sorted(wrong)
