"""Formulas as MathML, which browsers show by themselves: pages need neither a script nor a network."""

import re

from docutils import nodes
from docutils.utils.math import MathError, latex2mathml
from sphinx.util import logging

logger = logging.getLogger(__name__)
ACCENTED = re.compile(r"(\\(?:d+ot|bar|hat) ?(?:\w|\\[a-z]+))(?=_)")  # an index behind an accent: docutils would put it below


def inline(writer, node):
    """A formula within a line."""
    writer.body.append(_mathml(node, False))
    raise nodes.SkipNode


def block(writer, node):
    """A formula in lines of its own."""
    writer.body.append(f'<div class="formula">{_mathml(node, True)}</div>')
    raise nodes.SkipNode


def _mathml(node, as_block):
    try:
        return latex2mathml.tex2mathml(ACCENTED.sub(r"{\1{}}", node.astext()), as_block=as_block)
    except MathError as error:
        logger.warning("formula %s: %s", node.astext(), error, location=node)
        return ""


def setup(app):
    """Called by Sphinx."""
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
