"""Numbers at the axes in letters, "10⁻⁴" and "×10⁻⁵": matplotlib would parse each as a formula, which took two fifths of a figure's time."""

import re

from matplotlib.ticker import LogFormatterSciNotation, ScalarFormatter

RAISED = str.maketrans("0123456789-−", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁻")
SIGNS = str.maketrans("-", "−", "${}")


def letters(formula):
    """A number as matplotlib's formatters write it, in letters: r"$\\mathdefault{2\\times10^{-5}}$" is "2×10⁻⁵"."""
    if not formula.startswith("$"):
        return formula
    raised = re.sub(r"\^\{([-−]?\d+)\}", lambda power: power[1].translate(RAISED), formula)
    return raised.replace(r"\mathdefault", "").replace(r"\times", "×").translate(SIGNS)


class _Letters:
    """What a formatter beside it writes, in letters."""

    def __call__(self, x, pos=None):
        return letters(super().__call__(x, pos))

    def get_offset(self):
        return letters(super().get_offset())


class Numbers(_Letters, ScalarFormatter):
    """Numbers of a linear axis."""


class Powers(_Letters, LogFormatterSciNotation):
    """Numbers of a logarithmic axis."""


KINDS = {ScalarFormatter: Numbers, LogFormatterSciNotation: Powers}


def lettered(figure):
    """Let the axes of a figure that have matplotlib's own formatters write their numbers in letters."""
    for axis in [axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)]:
        for formatter in (axis.get_major_formatter(), axis.get_minor_formatter()):
            formatter.__class__ = KINDS.get(type(formatter), type(formatter))
