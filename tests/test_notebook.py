"""What a notebook shows: a short line or a table for everything, a run as a table of numbers, its pictures on axes, a bar while it runs."""

import sys
from html.parser import HTMLParser
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib import pyplot

import polyida as pi
from polyida.problems.equations import Pendulum

VOID = {"br", "img", "path", "meta"}
NASTY = '<script>alert(1)</script> & "it\'s" $x$'


class Parser(HTMLParser):
    """Tags open and closed in their order, and the text between them."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.text = [], [], ""
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.open += [] if tag in VOID else [tag]

    def handle_startendtag(self, tag, attributes):
        self.tags.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


@pytest.fixture
def everything(run, scenes):
    """{name: a thing that users have in their hands}."""
    model, cantilever = run.model, scenes.cantilever()[0].build()
    still = pi.static(cantilever)
    plate = scenes.plate("free")
    end = model.parts["lower"].section("right")
    parts = [
        pi.Reduced(plate, modes=4),
        pi.Rigid(plate),
        pi.RigidBody(mass=1.0, inertia=1.0, points={f"p{k}": (0.0, k) for k in range(20)}),
        pi.SpringDamper(pi.ground.at((1.0, 1.0)), end, 20.0, 0.1),
        pi.TorsionSpring(pi.ground, end, 0.5, 0.01),
        pi.PenaltyContact(end, pi.ground.at((0.0, 0.2)), 100.0, 0.1),
        pi.Torque(end, np.sin),
        pi.Force(end, (np.sin, 0.3), follower=True),
    ]
    own = pi.solve(Pendulum(), 0.1, pi.IDA(), q0=[1.0, 0.0])
    problems = [pi.problems.get(name) for name in ("pendulum", "double-plate")]
    things = [model, run, run.state, run.counts, run.energy, run.sensors, run.plot, own, own.model, own.state, still, *parts, *problems]
    things += [pi.modes(cantilever), pi.linearise(cantilever), model.needs]
    things += [*model.parts.values(), plate.mesh, plate.material, end, pi.ground, pi.ground.at((0.0, 1.0)), scenes.jointed("weld")]
    things += [
        pi.GeneralizedAlpha(h=1e-3),
        pi.EnergyMomentum(h=1e-3),
        pi.IDA(),
        pi.RadauIIA(),
        pi.profile.sine(1.0, 2.0),
        run.section_forces("upper", (0.5, 0.0), (1.0, 0.0)),
    ]
    return {f"{k} {type(thing).__name__}": thing for k, thing in enumerate(things)}


def test_everything_shows_itself_in_short(everything):
    lengths = {name: len(repr(thing)) for name, thing in everything.items()}
    assert max(lengths.values()) <= 600, {name: length for name, length in lengths.items() if length > 600}
    long = {name for name, length in lengths.items() if length > 150}
    assert not long & {
        name for name in everything if name.split()[1] in ("Trajectory", "SceneModel", "Scene", "Profile", "AngleMotor", "Energy")
    }
    shown = {name: thing._repr_html_() for name, thing in everything.items() if hasattr(thing, "_repr_html_")}
    assert {name.split()[1] for name in shown} >= {"Scene", "SceneModel", "Pendulum", "Trajectory"}
    for text in shown.values():
        assert len(text) < 20_000 and Parser(text).tags[:2] == ["div", "p"]


def test_names_are_text_in_a_table(scenes):
    scene = scenes.cantilever()[0]
    scene.add(pi.PointMass(scene.parts["upper"].section("right"), 0.1, name=NASTY))
    run = pi.solve(scene.build(), 2e-3, pi.GeneralizedAlpha(h=1e-3))
    for thing in (scene, run.model):
        found = Parser(thing._repr_html_())
        assert "script" not in found.tags and NASTY in found.text
    axes = run.plot.position(NASTY)
    axes.figure.canvas.draw()
    assert NASTY.replace("$", r"\$") in axes.get_ylabel()
    pyplot.close(axes.figure)


def test_a_runs_last_frame_is_drawn(run):
    text = run._repr_html_()
    picture = ElementTree.fromstring(text[text.index("<svg") :])
    segments = picture[0].get("d").count("M")
    assert segments == sum(len(body.mesh.boundary_edges) for body in run.model.drawn)
    assert picture.get("aria-label") == "last frame, t = 0.03 s" and len(text) < 8000


@pytest.mark.parametrize("change", [{"model": None}, {"status": "error", "message": NASTY}])
def test_what_a_run_lacks_is_left_out(run, change):
    from dataclasses import replace

    changed = replace(run, **change)
    assert Parser(changed._repr_html_()).open == [] and len(repr(changed)) < 150
    empty = replace(run, **{part: np.asarray(getattr(run, part))[:0] for part in ("t", "q", "v", "a", "lam")})
    assert "no frame" in repr(empty) and "svg" not in Parser(empty._repr_html_()).tags


def test_a_run_as_a_data_frame(run):
    frame = run.to_dataframe()
    assert frame.columns[0] == "t" and len(frame) == len(run) and frame.notna().all(axis=None)
    assert np.array_equal(frame[["tip.x", "tip.y"]], run.position("tip")) and np.array_equal(frame["drift"], run.drift)
    assert np.array_equal(frame["joint.torque"], run.reaction("joint")[:, 0])
    assert np.array_equal(frame[["revolute 1.force_x", "revolute 1.force_y"]], run.reaction("revolute 1"))
    assert np.array_equal(frame["energy.total"], run.energy.total)
    own = pi.solve(Pendulum(), 0.1, pi.IDA(), q0=[1.0, 0.0])
    assert list(own.to_dataframe().columns) == ["t", "q[0]", "q[1]", "v[0]", "v[1]", "lam[0]"]


def test_a_run_as_a_data_set(run, monkeypatch):
    data = run.to_xarray()
    assert all(np.array_equal(data[part], getattr(run, part)) for part in ("t", "q", "v", "a", "lam", "drift"))
    assert np.array_equal(data.position.sel(point="tip"), run.position("tip")) and data.t.units == "s" and data.q.units == "m"
    assert np.array_equal(data.reaction.sel(component="joint.torque"), run.reaction("joint")[:, 0])
    assert data.unit.sel(component="joint.torque") == "N m" and list(data.constraint.values) == list(run.model.labels)
    assert np.array_equal(data.total, run.energy.total) and data.status == "done" and data.steps == run.steps
    sensed = pi.solve(Pendulum(), 0.1, pi.IDA(), q0=[1.0, 0.0], sensors={"x": lambda t, q, v: q[0], "v": lambda t, q, v: v}, every=2)
    data = sensed.to_xarray()
    assert np.array_equal(data["sensor.v"], sensed.sensors["v"]) and np.array_equal(data.t_step, sensed.sensors.t)
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(pi.InputError, match=r"xarray is not installed; pip install 'polyida\[xarray\]'"):
        run.to_xarray()


PICTURES = {
    "energy": lambda plot, axes: plot.energy(axes=axes),
    "position": lambda plot, axes: plot.position("tip", axes=axes),
    "tip": lambda plot, axes: plot.tip(axes=axes),
    "reactions": lambda plot, axes: plot.reactions("joint", "revolute 1", axes=axes),
    "drift": lambda plot, axes: plot.drift(axes=axes),
    "deformed": lambda plot, axes: plot.deformed([0.0, 0.03], axes=axes),
}


@pytest.mark.parametrize("name", PICTURES)
def test_pictures_take_and_return_axes(run, name):
    given = pyplot.subplots()[1]
    assert PICTURES[name](run.plot, given) is given
    new = PICTURES[name](run.plot, None)
    assert new is not given and new.get_xlabel() and new.get_ylabel()
    for axes in (given, new):
        axes.figure.canvas.draw()
        pyplot.close(axes.figure)


def test_a_bar_shows_how_far_a_run_is(capsys, monkeypatch, tmp_path):
    told = []
    plain = pi.solve(Pendulum(), 0.1, pi.GeneralizedAlpha(h=1e-3), q0=[1.0, 0.0], progress=told.append)
    shown = pi.solve(Pendulum(), 0.1, pi.GeneralizedAlpha(h=1e-3), q0=[1.0, 0.0], progress=True, out=tmp_path / "run.h5")
    assert "0%" in capsys.readouterr().err and np.array_equal(plain.q, shown.q) and len(told) == 100
    pi.resume(tmp_path / "run.h5", 0.2, model=Pendulum(), progress=True)
    assert "0%" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "tqdm.auto", None)
    for call in (lambda: pi.solve(Pendulum(), 0.1, pi.IDA(), progress=True), lambda: pi.resume(tmp_path / "run.h5", 0.3, progress=True)):
        with pytest.raises(pi.InputError, match=r"progress = True needs tqdm; pip install 'polyida\[notebook\]'"):
            call()
