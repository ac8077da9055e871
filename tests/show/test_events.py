"""Events in histories, animations and reports, checked against `run.events`."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import LineCollection

import polyida as pi
from polyida.event import Events, Happened
from polyida.show import html, plates, plots
from polyida.show.animations import FramePicture
from polyida.show.figure_files import csv
from polyida.show.plates import EVENT_FRAMES
from polyida.study.comparison import event_tables


@pytest.fixture(scope="module")
def bounces():
    """A ball falls from 0.1 m; the floor reverses it, and the run stops at x = 0.3."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    points = {"c": (0.0, 0.0), "rim": (0.02, 0.0)}
    ball = scene.add(pi.RigidBody(mass=1.0, inertia=0.01, points=points, origin=(0.0, 0.1), velocity=(1.0, 0.0), name="ball"))
    c = ball.at("c")
    scene.add(pi.PointMass(c, 1e-3, name="c"))
    floor = pi.Event(when=lambda s: s.position(c)[1], then=pi.Impact(restitution=0.8), name="cost $5", direction="falling")
    gate = pi.Event(when=lambda s: s.position(c)[0] - 0.3, then="stop", name="gate")
    run = pi.solve(scene.build(), 1.0, pi.GeneralizedAlpha(h=5e-3), events=[floor, gate])
    assert [event.name for event in run.events] == ["cost $5", "gate"]
    return run


def marks(axes):
    """(times of the marks, (time, name) of each name)."""
    lines = [line for line in axes.collections if isinstance(line, LineCollection) and line.get_label() == "_events"]
    times = [segment[0, 0] for line in lines for segment in line.get_segments()]
    return times, [(text.get_position()[0], text.get_text()) for text in axes.texts]


def with_events(run, times):
    """The run with events "e0", "e1" ... at these times."""
    happened = [Happened(t, f"e{k}", 0.1 * k, np.nan, int(np.searchsorted(run.t, t))) for k, t in enumerate(times)]
    return replace(run, events=Events(happened))


def test_histories_mark_events_with_their_names(bounces):
    figures = [plots.energy({"one": bounces, "other": bounces}), plots.tip({"one": bounces}, "c")]
    axes = [bounces.plot.energy(), bounces.plot.drift(), bounces.plot.position("c")]
    for axis in axes + figures[0].axes + figures[1].axes[:2]:
        times, names = marks(axis)
        assert times == [*bounces.events.t]
        assert names == [(bounces.events[0].t, r"cost \$5"), (bounces.events[1].t, "gate")]
    assert bounces.events[0].t == pytest.approx(np.sqrt(0.2 / 9.81))
    assert "event" not in csv(figures[0])


def test_panels_below_the_first_row_have_marks_without_names(bounces):
    named = [len(marks(axis)[1]) for axis in plots.coordinates({"run": bounces}).axes if axis.get_visible()]
    assert named == [2, 2, 0, 0]


def test_marks_change_no_limits_and_a_run_without_events_has_none(bounces):
    plain = replace(bounces, events=Events())
    limits = [run.plot.position("c").axis() for run in (bounces, plain)]
    assert limits[0] == limits[1]
    assert marks(plain.plot.drift()) == ([], [])


def test_many_events_are_marked_and_few_are_named(bounces):
    """20 names at most, none within 4 % of the time shown of the name before it."""
    times = np.linspace(0.0, bounces.t[-1], 24)
    found, names = marks(with_events(bounces, times).plot.drift())
    assert found == pytest.approx(times) and [name for _, name in names] == [f"e{k}" for k in range(plots.NAMED_EVENTS)]
    found, names = marks(with_events(bounces, np.linspace(0.0, 0.1 * bounces.t[-1], 1000)).plot.drift())
    assert len(found) == 1000 and len(names) == 3


def test_an_animation_names_an_event_for_a_few_frames(bounces):
    frames = [*range(0, len(bounces), 2)]
    picture = FramePicture(bounces, frames, 3.0)
    shown = {"cost": [], "gate": []}
    for k in frames:
        picture.image(k)
        for name in shown:
            shown[name] += [k] * (name in picture.title.get_text())
    first = next(k for k in frames if k >= bounces.events[0].frame)
    assert shown["cost"] == [*range(first, first + 2 * EVENT_FRAMES, 2)] and shown["gate"] == frames[-1:]
    assert picture.title.get_text() == f"t = {bounces.t[frames[-1]]:.3f} s, gate" == plates.clock(bounces, frames)[-1]


def test_a_report_has_a_table_of_the_first_events(bounces):
    assert event_tables({"none": replace(bounces, events=Events())}) == []
    heading, few, many, more = event_tables({"few": bounces, "many": with_events(bounces, np.linspace(0.0, 0.3, 57))})
    assert (heading.text, few.caption, many.caption, more.paragraph) == ("Events", "few", "many", "and 7 more")
    assert len(few.rows) == 2 and len(many.rows) == 50
    assert few.rows[0] == {key: getattr(bounces.events[0], key) for key in ("t", "name", "impulse", "energy_lost")}
    page = html.block_html(few)
    assert "cost $5" in page and f"{bounces.events[0].energy_lost:.4g}" in page
    assert "cost $5" in bounces._repr_html_()
