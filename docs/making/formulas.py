"""Formulas as MathML, which browsers draw themselves: no script, no font, no picture."""

from __future__ import annotations

from typing import Any

from docutils import nodes


def _inline(writer: Any, node: nodes.math) -> None:
    writer.body.append(_markup(node.astext(), "inline"))
    raise nodes.SkipNode


def _block(writer: Any, node: nodes.math_block) -> None:
    writer.body.append(f'<div class="formula" tabindex="0">{_markup(node.astext(), "block")}</div>')
    raise nodes.SkipNode


def _markup(text: str, display: str) -> str:
    from latex2mathml.converter import convert

    found: str = convert(text.strip(), display=display)
    return found


def setup(app: Any) -> dict[str, Any]:
    """Register with Sphinx as the renderer ``mathml``."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
