"""Symbols of joints and forces: they are where the parts are in each frame, supports stay, and parts of users do not stop a picture."""

import base64
from dataclasses import dataclass

import numpy as np
import pytest
from matplotlib import pyplot

import polyida as pi
from polyida.show import html, plates
from polyida.show.animations import FramePicture
from polyida.show.mechanism import symbols

STEEL = pi.Material(210e9, 0.3, 7850.0)


def crank():
    scene = pi.Scene(gravity=(0.0, -9.81))
    turning = scene.add(pi.RigidBody.bar(0.15, 0.4, angle=np.pi / 2, name="crank"))
    rod = scene.add(pi.RigidBody.bar(0.25, 0.4, origin=(0.0, 0.15), angle=-np.arcsin(0.6), name="rod"))
    slider = scene.add(pi.RigidBody(0.5, 1e-3, {"pin": (0.0, 0.0)}, origin=(0.2, 0.0), name="slider"))
    scene.add(pi.Revolute(pi.ground, turning.at("left"), name="bearing"))
    scene.add(pi.Revolute(turning.at("right"), rod.at("left"), name="crank pin"))
    scene.add(pi.Revolute(rod.at("right"), slider.at("pin"), name="wrist pin"))
    scene.add(pi.Prismatic(pi.ground.at((0.0, 0.0)), slider.at("pin"), name="guide"))
    scene.add(pi.SpringDamper(pi.ground.at((0.5, 0.0)), slider.at("pin"), stiffness=200.0, damping=2.0, name="spring"))
    scene.add(pi.Torque(turning.at("left"), 0.6, name="drive"))
    return scene


@pytest.fixture(scope="module")
def run():
    return pi.solve(crank().build(), 0.2, pi.GeneralizedAlpha(h=2e-3))


def drawn_alone(run, name, frames):
    """The Symbols of one part over frames."""
    q = run.q[frames]
    return symbols({name: run.model.parts[name]}, lambda side, part: run.model.place((side, part), q), 0.01, len(q))


def test_pins_and_springs_follow_the_bodies_and_supports_stay(run):
    frames = np.arange(0, len(run), 20)
    pins = drawn_alone(run, "wrist pin", frames).pins
    assert pins[:, 0] == pytest.approx(run.position("wrist pin")[frames])
    spring = drawn_alone(run, "spring", frames)
    assert spring.forces[:, :, :, 0].min() >= run.position("guide")[frames, 0].min() - 0.01
    assert np.ptp(spring.joints, axis=0).max() == 0.0  # its support
    assert np.ptp(spring.forces, axis=0).max() > 0.01
    bearing = drawn_alone(run, "bearing", frames)
    assert max(np.ptp(bearing.joints, axis=0).max(), np.ptp(bearing.pins, axis=0).max()) < 1e-14  # the drift of the joint


def test_a_rail_is_as_long_as_the_way_of_its_slider(run):
    frames = np.arange(len(run))
    guide, x = drawn_alone(run, "guide", frames), run.position("guide")[:, 0]
    ends = guide.joints[0, 0, :, 0]
    assert ends.min() < x.min() and ends.max() > x.max()
    assert np.ptp(guide.joints[:, 0], axis=0).max() == 0.0


def every_kind():
    """Parts of every kind on a plate and two bars; they need not move together."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    plate = pi.Plate(pi.mesh.rectangle(0.5, 0.1, cells=6, seed=1), STEEL, 0.01, name="plate")
    scene.add(plate)
    bar = scene.add(pi.RigidBody.bar(0.5, 1.0, origin=(0.5, 0.05), name="bar"))
    disc = scene.add(pi.RigidBody(1.0, 0.01, {"hub": (0.0, 0.0)}, origin=(0.3, -0.3), name="disc"))
    left, right, end, hub = plate.section("left"), plate.section("right"), bar.at("right"), disc.at("hub")
    floor = pi.ground.at((0.0, -0.4))
    parts = [
        pi.Clamp(pi.ground, left),
        pi.Weld(right, bar.at("left")),
        pi.Slot(floor, end),
        pi.Distance(pi.ground.at((1.0, 1.0)), end),
        pi.AngleMotor(right, bar.at("left"), lambda t: t),
        pi.PrescribedPosition(hub, x=lambda t: 0.3, y=None),
        pi.RollingDisc(floor, hub, radius=0.1),
        pi.Skate(hub),
        pi.Contact(end, floor),
        pi.Contact(hub, floor, disc=0.1),
        pi.Clearance(pi.ground, hub, gap=1e-3),
        pi.Maxwell(right, end, 1.0, 1.0),
        pi.TorsionSpring(right, bar.at("left"), stiffness=1.0),
        pi.PenaltyContact(end, floor, stiffness=1e4),
        pi.PointMass(end, 0.1),
        pi.PointLoad(end, (0.0, -1.0)),
        pi.EdgeTraction(right, (1.0, 0.0)),
        pi.Force(end, (lambda t: t, 0.0), follower=True),
        pi.Force(end, lambda t, x, v: -v),
        pi.Torque(end, 1.0),
        pi.PID(end, 1.0),
    ]
    return scene, parts


def test_every_kind_of_part_is_drawn_within_reach():
    scene, parts = every_kind()
    for part in parts:
        found = symbols({"part": part}, plates._as_drawn, 0.02)
        points = np.concatenate([lines.reshape(-1, 2) for lines in found])
        of_state = isinstance(part, pi.Force) and callable(part.force)
        assert len(points) or of_state, part
        assert np.isfinite(points).all() and np.abs(points).max(initial=0.0) < 1.6, part
    for part in parts:
        scene.add(part)
    axes = scene.plot()
    pyplot.close(axes.figure)


@dataclass(frozen=True, eq=False)
class Bracket(pi.Joint):
    """A joint of three sides."""

    at: object = None

    def rows(self):
        return [pi.dot(self.b.x - self.a.x, self.b.x - self.a.x)]


def test_a_joint_of_a_user_is_a_line_through_its_places():
    scene, _ = every_kind()
    bar, disc = scene.parts["bar"], scene.parts["disc"]
    found = symbols({"own": Bracket(bar.at("left"), disc.at("hub"), at=pi.ground.at((0.7, 0.3)))}, plates._as_drawn, 0.02)
    assert found.joints[0].reshape(-1, 2).tolist() == [[0.5, 0.05], [0.3, -0.3], [0.3, -0.3], [0.7, 0.3]]


def test_animations_and_pictures_have_the_symbols_of_their_frames(run):
    frames = plates.spread(run, 4)
    picture = FramePicture(run, frames, 3.0)
    drawn, low, high = plates.symbols_of(run, frames)
    for i, k in enumerate(frames):
        picture.image(k)
        assert np.array(picture.forces.get_segments()) == pytest.approx(drawn.forces[i])
        assert np.array(picture.pins.get_xydata()) == pytest.approx(drawn.pins[i])
    (x0, x1), (y0, y1) = picture.axes.get_xlim(), picture.axes.get_ylim()
    assert x0 <= low[0] and x1 >= high[0] and y0 <= low[1] and y1 >= high[1]
    axes = run.plot.deformed()
    assert max(len(lines.get_segments()) for lines in axes.collections if hasattr(lines, "get_segments")) == len(drawn.joints[0])
    pyplot.close(axes.figure)


def test_a_body_of_one_point_is_drawn_where_it_is(tmp_path):
    scene = pi.Scene()
    ball = scene.add(pi.RigidBody(1.0, 0.1, {"centre": (0.0, 0.0)}, velocity=(1.0, 0.0), name="ball"))
    run = pi.solve(scene.build(), 1.0, pi.GeneralizedAlpha(h=0.25))
    drawn, low, high = plates.symbols_of(run, range(5))
    assert drawn.joints.mean(axis=(1, 2)) == pytest.approx(run.position(ball.at("centre")), abs=0.01) and len(drawn.pins) == 5
    assert run.animate().save(tmp_path / "ball.gif", frames=3).exists()
    axes = run.plot.deformed(times=[0.0, 1.0])
    assert [line.get_xydata().tolist() for line in axes.lines if line.get_label() == "_dots"] == [[[0.0, 0.0]], [[1.0, 0.0]]]
    pyplot.close(axes.figure)
    for axes in (scene.plot(), pi.solve(scene.build(), 0.1, pi.GeneralizedAlpha(h=0.1), v0=np.zeros(4)).plot.deformed()):
        assert np.ptp(axes.get_xlim()) > 0.5 < np.ptp(axes.get_ylim())
        pyplot.close(axes.figure)
    scene.add(pi.SpringDamper(pi.ground.at((0.0, 1.0)), ball.at("centre"), stiffness=10.0))
    assert len(symbols(scene.parts, plates._as_drawn, 0.04).pins[0]) == 1
    alone = symbols(scene.parts, plates._as_drawn, 0.04).joints.shape[1]
    scene.add(pi.Prismatic(pi.ground, ball.at("centre")))
    guided = symbols(scene.parts, plates._as_drawn, 0.04).joints
    assert alone > 20 and not np.any(np.all(guided[0, :, 0] == (0.014, 0.0), axis=1))  # its slider shows it


def test_a_page_joins_the_points_of_its_own_frames(run):
    data, _ = html.Movie(run, frames=12).data()
    symbols, *_ = plates.symbols_of(run, plates.spread(run, 12))
    packed = np.frombuffer(base64.b64decode(data["places"]), "<u2").reshape(len(data["t"]), -1, 2)
    places = np.array(data["low"]) + packed * (data["size"] / html.POSITIONS)
    assert len(data["sticks"]) == len(plates.sticks(run, 0)) and symbols.joints.shape[1] > plates.symbols_of(run, [0])[0].joints.shape[1]
    for name, kind in (("joints", symbols.joints), ("forces", symbols.forces), ("pins", symbols.pins)):
        assert places[:, np.array(data[name])] == pytest.approx(kind, abs=data["size"] / html.POSITIONS), name
    assert max(np.max(data[name]) for name in ("joints", "forces", "pins")) == packed.shape[1] - 1


def test_times_that_have_no_room_beside_each_other_are_left_out(run):
    axes = run.plot.deformed(times=np.linspace(0.0, 0.01, 12))
    shown = [text.get_text() for text in axes.texts]
    assert 0 < len(shown) < 12 and shown[0] == "0.01 s"
    pyplot.close(axes.figure)
