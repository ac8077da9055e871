"""Figures of 3.3 inches: no two texts overlap, none is cut, what failed is seen, and names, titles and styles are those that the user gives."""

from itertools import combinations, pairwise

import numpy as np
import pytest
from matplotlib import pyplot, rcParams
from matplotlib.text import Text

import polyida as pi
from polyida.errors import InputError
from polyida.show.axes import finish
from polyida.study.invariants import Drift, EnergyKept
from polyida.study.precision import StepSizes, WorkPrecision

NAMES = ("generalized-alpha", "Radau IIA", "energy-momentum")


def rows():
    """Runs of three integrators with constant steps in no order; the first with the largest step failed."""
    result = []
    for i, name in enumerate(NAMES):
        order = (2, 5, 2)[i]
        for k, h in enumerate((4e-3, 1e-3, 2e-3)):
            error = (1 + i) * 1e-2 * (h / 4e-3) ** order
            row = {
                "integrator": name,
                "setting": f"h={h:g}",
                "h": h,
                "t": 0.1,
                "steps": round(0.1 / h),
                "cpu_s": (0.03 + 0.004 * i) / (1 + k / 5),
            }
            row |= {"error_q": error, "error_v": 10 * error, "error_lam": 1e3 * error, "status": "done", "residuals": 30, "message": ""}
            result.append(row)
    result[0] |= {"status": "newton", "error_q": np.nan, "error_v": np.nan, "error_lam": np.nan}
    return result


def precise(kind):
    values = dict.fromkeys(("q", "v", "lam"), np.ones(2))
    known = dict.fromkeys(("q", "v", "lam"), 1e-5)
    return kind("mechanism", rows(), [], values | {"made_by": ["x"], "known_to": known, "units": {"q": "m", "v": "m/s"}})


def kept(kind):
    t = np.linspace(0.0, 0.3, 50)
    ends = [{"integrator": name, "status": "done"} for name in NAMES]
    ends[1]["status"] = "newton"
    histories = {name: {"t": t, **dict.fromkeys(kind.quantities, 1e-7 * np.sin(9 * t + i))} for i, name in enumerate(NAMES)}
    return kind("mechanism", ends, [], histories)


def swing_scene():
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = scene.add(pi.RigidBody.bar(0.3, 1.0, name="bar"))
    scene.add(pi.Revolute(pi.ground, bar.at("left"), name="bearing"))
    scene.add(pi.PointMass(bar.at("right"), 0.1, name="tip"))
    return scene


@pytest.fixture(scope="module")
def swing():
    return pi.solve(swing_scene().build(), 0.3, pi.GeneralizedAlpha(h=2e-3))


PICTURES = {
    "work": lambda axes, _: precise(WorkPrecision).plot(axes=axes),
    "steps": lambda axes, _: precise(StepSizes).plot("lam", axes),
    "titled": lambda axes, _: precise(StepSizes).plot(axes=axes, title="A slider crank"),
    "energy": lambda axes, _: kept(EnergyKept).plot(axes=axes),
    "drift": lambda axes, _: kept(Drift).plot(axes=axes),
    "energies of a run": lambda axes, run: run.plot.energy(axes),
    "drift of a run": lambda axes, run: run.plot.drift(axes),
    "reactions": lambda axes, run: run.plot.reactions(axes=axes),
    "path": lambda axes, run: run.plot.tip(axes=axes),
    "place": lambda axes, run: run.plot.position(axes=axes),
    "bodies": lambda axes, run: run.plot.deformed(axes=axes),
    "scene": lambda axes, _: swing_scene().plot(axes),
}


def texts(figure):
    """(text, its box in pixels) of all that is written in a figure."""
    figure.draw_without_rendering()
    renderer = figure.canvas.get_renderer()
    found = []
    for artist in figure.findobj(Text):
        ticks = [label for axes in figure.axes for axis in (axes.xaxis, axes.yaxis) for label in _hidden(axes, axis)]
        if artist.get_text().strip() and artist.get_visible() and artist not in ticks:
            found.append((artist.get_text(), Text.get_window_extent(artist, renderer)))
    return found


def _hidden(axes, axis):
    """Tick labels outside the limits, which are not drawn."""
    low, high = sorted(axis.get_view_interval())
    room = 1e-9 * (high - low)
    ticks = [*axis.get_major_ticks(), *axis.get_minor_ticks()]
    return [label for tick in ticks for label in (tick.label1, tick.label2) if not low - room <= tick.get_loc() <= high + room]


def require_apart(figure):
    found = texts(figure)
    for (one, box), (other, near) in combinations(found, 2):
        assert not box.overlaps(near), (one, other)
    for text, box in found:
        assert box.x0 >= -1 and box.y0 >= -1 and box.x1 <= figure.bbox.x1 + 1 and box.y1 <= figure.bbox.y1 + 1, text


@pytest.mark.parametrize("styled", [True, False])
@pytest.mark.parametrize("name", PICTURES)
def test_no_two_texts_overlap_in_a_column(name, styled, swing):
    if styled:
        with pi.show.style("paper"):
            figure, axes = pyplot.subplots()
            PICTURES[name](axes, swing)
    else:
        figure, axes = pyplot.subplots(figsize=(3.3, 2.5), layout="constrained")
        PICTURES[name](axes, swing)
    require_apart(figure)
    pyplot.close(figure)


def test_no_two_texts_overlap_in_panels_across_a_page(swing):
    with pi.show.style("paper", columns=2):
        figure, panels = pyplot.subplots(ncols=2)
        precise(WorkPrecision).plot(axes=panels[0])
        precise(StepSizes).plot(axes=panels[1])
    assert figure.get_figwidth() == 6.9
    require_apart(figure)
    pyplot.close(figure)


def test_errors_stand_upright_in_the_order_of_steps_with_failed_runs_at_the_edge():
    for kind in (WorkPrecision, StepSizes):
        figure, axes = pyplot.subplots()
        precise(kind).plot(axes=axes)
        lines = {line.get_label(): line for line in axes.lines}
        assert axes.get_ylabel() == "error in q, m" and not axes.get_title()
        assert list(lines["Radau IIA"].get_ydata()) == sorted(lines["Radau IIA"].get_ydata(), reverse=True)
        assert list(lines["generalized-alpha: failed"].get_ydata()) == [1.0]
        pyplot.close(figure)


def test_two_curves_of_one_order_have_one_line_of_it():
    figure, axes = pyplot.subplots()
    precise(StepSizes).plot(axes=axes)
    assert sorted(text.get_text() for text in axes.texts) == ["order 2", "order 5"]
    pyplot.close(figure)


def test_a_study_takes_a_title_and_other_names():
    figure, axes = pyplot.subplots()
    precise(WorkPrecision).plot(axes=axes, title="A crank", labels={"Radau IIA": "Radau"})
    shown = [text.get_text() for text in axes.get_legend().get_texts()]
    assert axes.get_title() == "A crank" and "Radau" in shown and "Radau IIA" not in shown
    for wrong in ({"title": 3}, {"labels": {"BDF": "b"}}, {"labels": {"Radau IIA": 1}}, {"labels": ["a"]}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            precise(WorkPrecision).plot(axes=axes, **wrong)
    pyplot.close(figure)


def test_marks_follow_the_settings_of_matplotlib():
    with pyplot.rc_context({"lines.markersize": 9.0, "lines.linewidth": 3.0}):
        figure, axes = pyplot.subplots()
        precise(WorkPrecision).plot(axes=axes)
    assert axes.lines[0].get_markersize() == 9.0 and axes.lines[0].get_linewidth() == 3.0
    pyplot.close(figure)


def test_a_style_holds_within_its_with_and_new_axes_are_a_column_wide(swing):
    before = dict(rcParams)
    with pi.show.style("paper"):
        assert rcParams["font.size"] == 8.0 and rcParams["axes.prop_cycle"].by_key()["color"][0] == "#0072B2"
        axes = swing.plot.energy()
        assert axes.figure.get_figwidth() == 3.3 and axes.xaxis.label.get_size() == 8.0
    assert dict(rcParams) == before
    assert swing.plot.energy().figure.get_figwidth() == 6.4
    for wrong in ({"name": "poster"}, {"columns": 3}, {"name": "screen", "columns": 2}):
        with pytest.raises(InputError), pi.show.style(**wrong):
            pass
    pyplot.close("all")


def test_a_legend_has_as_many_columns_as_fit_by_their_own_names():
    with pi.show.style("paper"):
        figure, axes = pyplot.subplots()
        for name in ("generalized-alpha", "Radau IIA", "IDA"):
            axes.plot([1.0, 2.0], [1.0, 2.0], label=name)
        finish(axes)
        assert axes.get_legend()._ncols == 2  # two columns of the longest name would be too wide
    require_apart(figure)
    pyplot.close(figure)


def test_names_of_parts_stand_beside_bars():
    scene, c, s = pi.Scene(), np.cos(0.8), np.sin(0.8)
    crank = scene.add(pi.RigidBody.bar(0.3, 1.0, angle=0.8, name="crank"))
    rod = scene.add(pi.RigidBody.bar(1.0, 1.0, origin=(0.3 * c, 0.3 * s), angle=-np.arcsin(0.3 * s), name="rod"))
    slider = scene.add(pi.RigidBody(0.5, 0.01, {"pin": (0.0, 0.0)}, origin=(0.3 * c + np.sqrt(1.0 - 0.09 * s**2), 0.0), name="slider"))
    scene.add(pi.Revolute(pi.ground, crank.at("left"), name="bearing"))
    scene.add(pi.Revolute(crank.at("right"), rod.at("left"), name="pin"))
    scene.add(pi.Revolute(rod.at("right"), slider.at("pin"), name="wrist"))
    scene.add(pi.Prismatic(pi.ground, slider.at("pin"), name="guide"))
    with pi.show.style("paper"):
        axes = scene.plot()
    corners = np.array([at.point for at in (crank.at("left"), crank.at("right"), rod.at("right"))])
    along = np.linspace(0.0, 1.0, 500)[:, None]
    pixels = axes.transData.transform(np.concatenate([a + along * (b - a) for a, b in pairwise(corners)]))
    for text in axes.texts:
        box = text.get_window_extent()
        assert not np.any(np.all((pixels > box.min) & (pixels < box.max), axis=1)), text.get_text()
    pyplot.close(axes.figure)
