import numpy as np
import pytest
from matplotlib.layout_engine import ConstrainedLayoutEngine

from polyida.show import plots
from polyida.show.labels import RAISED, letters
from polyida.show.style import figure, lay_out, rendered, settings


@pytest.mark.parametrize(
    ("formula", "text"),
    [
        (r"$\mathdefault{0.25}$", "0.25"),
        (r"$\mathdefault{−1.5}$", "−1.5"),
        (r"$\mathdefault{10^{-12}}$", "10⁻¹²"),
        (r"$\mathdefault{-10^{3}}$", "−10³"),
        (r"$\mathdefault{2\times10^{-5}}$", "2×10⁻⁵"),
        (r"$\times\mathdefault{10^{−3}}\mathdefault{+1}$", "×10⁻³+1"),
        ("as it is", "as it is"),
        ("", ""),
    ],
)
def test_formulas_become_letters(formula, text):
    assert letters(formula) == text


def value(text):
    """What a label in letters says."""
    number, ten, power = (
        text.replace("−", "-").partition("10") if any(x in text for x in "⁰¹²³⁴⁵⁶⁷⁸⁹") else (text.replace("−", "-"), "", "")
    )
    lowered = power.translate({new: old for old, new in RAISED.items()})
    return float(number.rstrip("×") or 1) * 10.0 ** int(lowered.replace("−", "-") or 0)


@pytest.mark.parametrize(("x", "scale"), [((-3e-5, 2e-5), "linear"), ((0.0, 7.5), "linear"), ((1e-16, 1e3), "log"), ((2.0, 7.0), "log")])
def test_labels_say_where_they_stand(x, scale):
    with settings():
        made, axes = figure(3.0, 2.0)
        axes.plot(x, x)
        axes.set(xscale=scale, yscale=scale)
        lay_out(made)
        factor = value(axes.xaxis.get_offset_text().get_text() or "1")
        count = 0
        for which in ("major", "minor"):
            labels = zip(axes.get_xticks(minor=which == "minor"), axes.get_xticklabels(which=which))
            said = [(at, label.get_text()) for at, label in labels if label.get_text()]
            assert not any("$" in text for _, text in said)
            assert [value(text) * factor for _, text in said] == pytest.approx([at for at, _ in said])
            count += len(said)
        assert count > 1


def test_a_figure_is_laid_out_once_for_all_its_files(runs, run, monkeypatch):
    executed, execute = [], ConstrainedLayoutEngine.execute
    monkeypatch.setattr(ConstrainedLayoutEngine, "execute", lambda self, made: executed.append(made) or execute(self, made))
    for made, times in ((plots.energy(runs), 1), (plots.deformed(run), 2)):
        executed.clear()
        rendered(made, "png")
        places = [axes.get_position().bounds for axes in made.axes]
        rendered(made, "pdf")
        assert len(executed) == times and np.array_equal(places, [axes.get_position().bounds for axes in made.axes])


def test_a_pdf_holds_its_letters_in_one_font(runs):
    assert rendered(plots.energy(runs), "pdf").count(b"/FontFile2") == 1
