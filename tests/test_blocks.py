"""Every block of the documentation runs from an empty folder, in less than 15 s of CPU, or says why it cannot."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest

from tests import blocks
from tests.blocks import Block

# test_readme.py and test_start.py run these, and look at their answers
SEEN = ("README.md", "docs/parallel.md", "docs/start/", "docs/concepts/")
PAGES = [page for page in blocks.pages() if not page.startswith(SEEN)]


@pytest.mark.parametrize("page", [page for page in PAGES if any(b.runs for b in blocks.blocks(page))])
def test_the_page_runs(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    blocks.prepare(page)
    scope: dict[str, Any] = {}
    for block in blocks.blocks(page):
        if block.runs:
            _, seconds = blocks.run(block, scope)
            assert seconds < blocks.LIMIT, f"{block} took {seconds:.1f} s of CPU"


@pytest.mark.parametrize("page", blocks.pages())
def test_what_does_not_run_says_why(page: str) -> None:
    for block in blocks.blocks(page):
        if block.mark == "not run":
            assert block.said in blocks.REASONS, f"{block}: {block.said!r} is none of {', '.join(blocks.REASONS)}"


@pytest.mark.parametrize(
    "block", [b for page in blocks.pages() for b in blocks.blocks(page) if b.kind == "toml"], ids=str
)
def test_plans_are_toml(block: Block) -> None:
    assert tomllib.loads(block.text)


TEXT = """# A page

    loadid info a.csv            # a word
    loadid check a.csv \\
        --model m.h5

    loadid info FILE [--json]

text    indented

    a formula = 1

<!-- not run: broker -->

    loadid serve plan.toml

<!-- file: plan.toml -->

```toml
a = 1
```

```toml
b = 1
```

```python
x = 1
```

```c
int x;
```
"""


def test_one_rule_finds_the_blocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blocks, "ROOT", tmp_path)
    (tmp_path / "page.md").write_text(TEXT)
    found = blocks.blocks("page.md")
    assert [(b.kind, b.line, b.mark, b.said, b.runs) for b in found] == [
        ("shell", 3, "", "", True), ("shell", 7, "", "", False), ("shell", 15, "not run", "broker", False),
        ("toml", 19, "file", "plan.toml", True), ("toml", 23, "", "", False), ("python", 27, "", "", True),
    ]  # fmt: skip
    assert blocks.commands(found[0].text) == [
        ["loadid", "info", "a.csv"], ["loadid", "check", "a.csv", "--model", "m.h5"],
    ]  # fmt: skip


def test_a_block_that_fails_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(AssertionError, match=r"docs/x\.md:7: loadid info none\.csv ended with 3"):
        blocks.run(Block("docs/x.md", 7, "shell", "loadid info none.csv\n"), {})
    with pytest.raises(AssertionError, match="mark it"):
        blocks.run(Block("docs/x.md", 7, "shell", "curl localhost\n"), {})
