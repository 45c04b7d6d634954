"""Docstrings of properties are sentences, whose colon does not part a type from a text, as napoleon has it."""

from __future__ import annotations

from typing import Any

NAPOLEON = 500  # priority of its handler
HELD = "\ue000"  # in place of a colon, while napoleon reads


def _hide(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    if what in ("property", "attribute", "data") and lines:
        lines[0] = lines[0].replace(":", HELD)


def _show(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    lines[:] = [line.replace(HELD, ":") for line in lines]


def setup(app: Any) -> dict[str, Any]:
    """Register with Sphinx, before and after napoleon."""
    app.connect("autodoc-process-docstring", _hide, NAPOLEON - 1)
    app.connect("autodoc-process-docstring", _show, NAPOLEON + 1)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
