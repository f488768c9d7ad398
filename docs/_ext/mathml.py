"""Equations as MathML, made by docutils: no network, no LaTeX, no pictures of letters."""

from __future__ import annotations

from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util.math import get_node_equation_number


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the renderer ``mathml``."""
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}


def visit_inline(translator: Any, node: nodes.math) -> None:
    """Write an equation within a line."""
    translator.body.append(mathml(node.astext(), block=False))
    raise nodes.SkipNode


def visit_block(translator: Any, node: nodes.math_block) -> None:
    """Write an equation of its own, with its number where it has one."""
    translator.body.append('<div class="equation">')
    translator.body.append(mathml(node.astext(), block=True))
    if node.get("number"):
        number = get_node_equation_number(translator, node)
        translator.body.append(f'<span class="number">({number})</span>')
    translator.body.append("</div>\n")
    raise nodes.SkipNode


def mathml(tex: str, *, block: bool) -> str:
    """Return an equation as MathML.

    Parameters
    ----------
    tex : str
        In LaTeX's math mode.
    block : bool
        Whether it stands by itself.
    """
    # A prime is raised by every font that has one; docutils would set an apostrophe.
    text: str = tex2mathml(tex, as_block=block).replace("<mo>'</mo>", "<mo>′</mo>")
    # Entities of docutils that HTML reads; XML-minded tools would not.
    return text.replace("&ApplyFunction;", "\u2061")
