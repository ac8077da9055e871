"""Formulas as MathML, which browsers show by themselves: pages need neither a script nor a network."""

from docutils import nodes
from docutils.utils.math import latex2mathml


def inline(writer, node):
    """A formula within a line."""
    writer.body.append(latex2mathml.tex2mathml(node.astext()))
    raise nodes.SkipNode


def block(writer, node):
    """A formula in lines of its own."""
    writer.body.append(f'<div class="formula">{latex2mathml.tex2mathml(_aligned(node.astext()), as_block=True)}</div>')
    raise nodes.SkipNode


def _aligned(tex):
    r"""More than one line as `\begin{align}`."""
    return rf"\begin{{align}}{tex}\end{{align}}" if "\\\\" in tex and r"\begin" not in tex else tex


def setup(app):
    """Called by Sphinx."""
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
