"""Tables of studies in LaTeX: symbols and units in headings, numbers in mathematics, and text that LaTeX shows unchanged."""

import re

import pytest
from matplotlib.mathtext import MathTextParser

import polyida as pi
from polyida.errors import InputError
from polyida.study.precision import WorkPrecision

ROWS = [
    {"integrator": "IDA", "setting": "rtol=1e-05", "error_q": 2.34e-5, "error_v": 1.0, "error_lam": float("nan"), "status": "done"},
    {"integrator": "alpha & co", "setting": "h=0.001", "error_q": 1e-12, "error_v": 0.5, "error_lam": 3e2, "status": "newton"},
]


def study():
    known = dict.fromkeys(("q", "v", "lam"), 1e-14)
    values = dict.fromkeys(("q", "v", "lam"), [1.0])
    rows = [row | {"h": None, "steps": 10, "t": 1.0} for row in ROWS]
    return WorkPrecision("crank", rows, [], values | {"made_by": ["x"], "known_to": known, "units": {"q": "m", "lam": "N"}})


def cells(text):
    """The lines of a tabular as lists of entries."""
    body = text.partition("toprule")[2].partition("\\bottomrule")[0]
    return [[entry.strip() for entry in re.split(r"(?<!\\)&", line.removesuffix(" \\\\"))] for line in body.splitlines() if "&" in line]


def test_headings_have_symbols_and_units_and_numbers_are_mathematics():
    head, ida, alpha = cells(study().to_latex(["integrator", "setting", "error_q", "error_lam"]))
    assert head == ["integrator", "setting", "error in $q$, m", r"error in $\lambda$, N"]
    assert ida == ["IDA", r"$\mathrm{rtol} = 10^{-5}$", r"$2.3 \cdot 10^{-5}$", "--"]
    assert alpha == [r"alpha \& co", "$h = 0.001$", r"$1.0 \cdot 10^{-12}$", r"$3.0 \cdot 10^{2}$"]
    parser = MathTextParser("path")
    for entry in [*head, *ida, *alpha]:
        for formula in re.findall(r"\$.+?\$", entry):
            parser.parse(formula)  # raises for what is no formula


@pytest.mark.parametrize(
    ("setting", "shown"),
    [
        ("rtol=1e-05, ida_rtol=3.2e-08", r"$\mathrm{rtol} = 10^{-5}$, $\mathrm{ida\_rtol} = 3.2 \cdot 10^{-8}$"),
        ("IDA(rtol=1e-05)", r"IDA($\mathrm{rtol} = 10^{-5}$)"),
        ("RadauIIA(h=0.001, form='ggl', stages=2)", r"RadauIIA($h = 0.001$, form='ggl', $\mathrm{stages} = 2$)"),
        ("rtol=0.01, atol=(1e-07, -0.5)", r"$\mathrm{rtol} = 0.01$, $\mathrm{atol} = (10^{-7}, -0.5)$"),
        ("extrapolate=True", "extrapolate=True"),
        ("IDA()", "IDA()"),
        ("IDA(rtol=1e-05", "IDA(rtol=1e-05"),
        ("h=2 is too long", "h=2 is too long"),
    ],
)
def test_numbers_of_settings_are_mathematics(setting, shown):
    assert pi.study.Result([{"setting": setting}]).to_latex().splitlines()[5] == rf"{shown} \\"


def test_columns_of_siunitx_have_room_for_their_numbers():
    text = study().to_latex(siunitx=True)
    assert "siunitx" in text.splitlines()[0]
    kinds = re.search(r"begin{tabular}{(.+)}", text)[1].split()
    head, ida, alpha = cells(text)
    assert len(kinds) == len(head) == len(ida)
    k = head.index("{error in $q$, m}")
    assert (kinds[k], ida[k], alpha[k]) == ("S[table-format=1.1e-2]", "2.3e-5", "1.0e-12")
    assert ida[head.index(r"{error in $\lambda$, N}")] == "{--}"
    assert kinds[head.index("status")] == "l"


def test_rows_of_users_are_shown_unchanged():
    head, first, second = cells(pi.study.Result([{"a_b": -1.5, "what": "50 % of $x^2"}, {"a_b": None, "what": "~{\\x}"}]).to_latex())
    assert head == [r"a\_b", "what"]
    assert first == ["$-1.5$", r"50 \% of \$x\textasciicircum{}2"]
    assert second == ["--", r"\textasciitilde{}\{\textbackslash{}x\}"]


def test_wrong_columns_are_named():
    for wrong in (["error_z"], [3], [], "error_q", 5):
        with pytest.raises(InputError, match="columns"):
            study().to_latex(wrong)
    with pytest.raises(InputError, match="siunitx"):
        study().to_latex(siunitx="yes")
    with pytest.raises(InputError, match="no rows"):
        pi.study.Result([]).to_latex()
