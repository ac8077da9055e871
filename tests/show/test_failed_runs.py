"""Pictures of runs that failed, of failed cases of a sweep, of zeros on logarithmic axes, and with long names."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib import pyplot

import polyida as pi
from polyida.show import plots
from polyida.show.styles import FAILED, finish_layout

LONG = "a name of a joint that goes on and on until nobody wants to read it any more " * 2


@pytest.fixture(scope="module")
def whole():
    scene = pi.Scene(gravity=(0.0, -9.81))
    body = scene.add(pi.RigidBody(mass=1.0, inertia=0.1, points={"tip": (0.5, 0.0), "pin": (0.0, 0.0)}, name="bar"))
    scene.add(pi.Revolute(pi.ground, body.at("pin"), name=LONG))
    scene.add(pi.PointMass(body.at("tip"), 0.1, name="tip"))
    return pi.solve(scene.build(), 0.02, pi.GeneralizedAlpha(h=1e-3))


@pytest.fixture
def failed(whole):
    return replace(whole, status="newton", **{part: getattr(whole, part)[:11] for part in ("t", "q", "v", "a", "lam")})


@pytest.fixture(autouse=True)
def closed():
    yield
    pyplot.close("all")


def ends(axes):
    """Times of the marks of failed runs."""
    return [line.get_xdata()[0] for line in axes.get_lines() if line.get_label() == "_end"]


@pytest.mark.parametrize("picture", ["energy", "position", "reactions", "drift", "tip", "deformed"])
def test_a_picture_of_a_failed_run_says_so(whole, failed, picture):
    axes = getattr(failed.plot, picture)()
    assert axes.get_title("right") == "newton at t = 0.01 s"
    if picture not in ("tip", "deformed"):
        assert ends(axes) == [failed.t[-1]]
    done = getattr(whole.plot, picture)()
    assert not done.get_title("right") and not ends(done)


def test_a_legend_of_several_runs_says_which_failed(whole, failed):
    runs = {"one": whole, "other": failed}
    for figure in (plots.energy(runs), plots.drift(runs), plots.tip(runs), plots.reactions(runs, [LONG])):
        labels = [text.get_text() for text in figure.legends[0].get_texts()]
        assert labels == ["one", "other (newton at t = 0.01 s)"]
        assert any(ends(axes) == [failed.t[-1]] for axes in figure.axes)


def test_long_names_cover_no_curve(whole):
    own = whole.plot.reactions()
    several = plots.drift({LONG: whole, f"{LONG} 2": whole})
    for figure, legend in ((own.figure, own.get_legend()), (several, several.legends[0])):
        finish_layout(figure)
        box = legend.get_window_extent()
        assert box.x0 >= 0 and box.x1 <= figure.bbox.x1
        assert all(box.y0 >= axes.get_window_extent().y1 for axes in figure.axes)


def test_a_drift_has_its_unit(whole):
    assert [axes.get_ylabel() for axes in plots.drift({"a": whole}).axes] == ["max|φ|, m or rad", "max|dφ/dt|, m/s or rad/s"]
    assert [line.get_label() for line in whole.plot.drift().get_lines()] == ["max|φ|, m or rad", "max|dφ/dt|, m/s or rad/s"]


def test_a_distance_of_zero_is_drawn_at_the_edge():
    t = np.linspace(0.0, 1.0, 5)
    axes = plots.errors({"none": (t, 0 * t), "some": (t, t)}).axes[0]
    low, high = axes.get_ylim()
    for line in axes.get_lines():
        assert (line.get_ydata() > low).all() and (line.get_ydata() < high).all()
    assert axes.get_lines()[0].get_ydata() == pytest.approx(1e-6)


def test_failed_cases_of_a_sweep_are_apart():
    def run(number):
        if number % 3 == 0:
            raise ValueError("no")
        return {"square": number**2}

    axes = pi.study.sweep(run, [{"number": k} for k in range(1, 8)]).plot()
    points, crosses = axes.get_lines()
    assert list(points.get_xdata()) == [1, 2, 4, 5, 7]
    assert list(crosses.get_xdata()) == [3, 6] and crosses.get_color() == FAILED and crosses.get_label() == "2 failed"
