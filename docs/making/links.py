"""Single backticks of docstrings: classes and dotted names are links where they have an entry, other words are code."""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from sphinx.domains.python import PyXRefRole

ENTRY = re.compile(r"(?:[A-Z]\w*[a-z]\w+|\w+\.\w[\w.]*)")


def _name(name: str, raw: str, text: str, line: int, inliner: Any, *more: Any) -> tuple[list[Any], list[Any]]:
    if not ENTRY.fullmatch(text):
        return [nodes.literal(raw, text)], []
    found: tuple[list[Any], list[Any]] = PyXRefRole()("py:obj", f":py:obj:`.{text}`", "." + text, line, inliner, *more)
    return found


def setup(app: Any) -> dict[str, Any]:
    """Register with Sphinx as the role ``name``."""
    app.add_role("name", _name)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
