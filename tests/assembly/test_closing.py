"""Loops that are drawn nearly closed: `scene.assemble()` closes them to round-off, moves little, and says what cannot close."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import polyida as pi

PLACES = {"A": (0.0, 0.0), "B": (0.1, 0.3), "C": (0.6, 0.5), "D": (0.7, 0.0)}
LINKS = {"crank": "AB", "coupler": "BC", "rocker": "CD"}
STEEL = pi.Material(E=2e9, nu=0.3, rho=1200.0)
AS_IS = np.zeros((3, 3))
DRAWN = {name: np.subtract(PLACES[b], PLACES[a]) for name, (a, b) in LINKS.items()}
MESHES = {name: pi.mesh.rectangle(float(np.hypot(*way)), 0.02, cells=12, seed=1) for name, way in DRAWN.items()}


@dataclass(frozen=True, eq=False)
class Bar(pi.RigidBody):
    """A rigid bar whose ends are called as a plate's sections are."""

    def section(self, name):
        return self.at(name)


@dataclass(frozen=True, eq=False)
class Fixed(Bar):
    """One whose coordinates do not follow its angle."""

    def coordinates(self):
        return [complex(*self.origin), self.gyration]


def plate(name, origin, angle):
    return pi.Plate(MESHES[name], STEEL, 0.01, origin=origin, angle=angle, name=name)


def bar(name, origin, angle, kind=Bar, length=None):
    return kind.bar(length or float(np.hypot(*DRAWN[name])), 1.0, origin=origin, angle=angle, name=name)


def rigid(name, origin, angle):
    return pi.Rigid(plate(name, origin, angle))


def too_long(name, origin, angle):
    return bar(name, origin, angle, length=1.6)


def fixed(name, origin, angle):
    return bar(name, origin, angle, Fixed)


def four_bar(errors=AS_IS, make=plate, at=0.0, **others):
    """A four-bar on the ground whose links are drawn with errors (m, m, rad); others: {name: link} in the place of one."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    sides = {}
    for (name, (a, _)), (x, y, turn) in zip(LINKS.items(), errors):
        origin, angle = np.add(PLACES[a], (at + x, y)), np.arctan2(*DRAWN[name][::-1]) + turn
        link = scene.add(others.get(name, make)(name, origin, angle))
        sides |= {f"{name} {end}": link.section(end) for end in ("left", "right")}
    ground = [pi.ground.at(np.add(PLACES[end], (at, 0.0))) for end in "AD"]
    pins = [ground[0], *sides.values(), ground[1]]
    for name, a, b in zip("ABCD", pins[::2], pins[1::2]):
        scene.add(pi.Revolute(a, b, name=name))
    return scene


def apart(scene):
    """The widest gap of its pins, m."""
    return max(np.linalg.norm(pin.a.point - pin.b.point) for pin in scene.parts.values() if isinstance(pin, pi.Revolute))


@pytest.mark.parametrize("make", [plate, bar, rigid])
@settings(max_examples=5)
@given(st.lists(st.floats(-1.0, 1.0), min_size=9, max_size=9), st.sampled_from([1e-6, 1e-3, 2e-2]))
def test_a_four_bar_closes_and_its_links_move_by_as_little_as_they_were_off(make, errors, size):
    scene = four_bar(size * np.reshape(errors, (3, 3)), make)
    drawn = apart(scene)
    report = scene.assemble()
    assert apart(scene) < 1e-14
    assert report.gap <= drawn * (1 + 1e-9) <= report.gap * 1.5 + 1e-13
    assert report.largest <= 3.0 * size
    assert max(report.turn.values()) <= 10 * size
    assert scene.assemble().summary() == "all joints are closed as drawn; nothing moved"


def test_what_holds_on_to_a_body_goes_with_it(scenes):
    scene = four_bar(np.full((3, 3), 4e-3))
    coupler = scene.parts["coupler"]
    held = {name: coupler.section(name) for name in ("left", "right", "top")} | {"node": coupler.node(3)}
    before = {name: (side.point, side.direction) for name, side in held.items()}
    origin, angle = np.array(coupler.origin), coupler.angle
    report = scene.assemble()
    turn = scenes.rotation(coupler.angle - angle)
    for name, side in held.items():
        assert np.allclose(side.point, turn @ (before[name][0] - origin) + coupler.origin, atol=1e-14)
        assert before[name][1] is None or np.allclose(side.direction, turn @ before[name][1], atol=1e-13)
    assert report.turn["coupler"] == pytest.approx(coupler.angle - angle, rel=1e-9)
    model = scene.build()
    assert np.abs(model.phi(0.0, np.zeros(model.n))).max() < 1e-14
    assert np.array_equal(model.bodies[1].points, coupler.points)
    assert max(pi.check_derivatives(model).values()) < 1e-6


def test_a_closed_scene_runs_and_comes_back_from_its_file(tmp_path):
    scene = four_bar(np.full((3, 3), 2e-3))
    with pytest.raises(pi.InputError, match=r"A: it does not hold at rest.*or let scene.assemble\(\) move them"):
        scene.build()
    scene.assemble()
    run = pi.solve(scene.build(), 0.02, pi.GeneralizedAlpha(h=1e-3))
    assert run.success and run.drift.max() < 1e-10
    run.save(tmp_path / "run.h5")
    again = pi.load(tmp_path / "run.h5")
    assert np.array_equal(again.q, run.q) and np.array_equal(again.position("C"), run.position("C"))


def test_what_is_clamped_stays_and_plain_ground_is_where_it_was_drawn():
    scene = pi.Scene()
    base, arm = scene.add(plate("crank", (0.2, 0.1), 0.3)), scene.add(plate("coupler", (0.5, 0.21), 0.1))
    before, root = base.points, base.section("left")
    scene.add(pi.Clamp(root))
    scene.add(pi.Revolute(base.section("right"), arm.section("left"), name="elbow"))
    scene.add(pi.Revolute(pi.ground, arm.section("right"), name="end"))
    end, wide = arm.section("right").point, np.linalg.norm(base.section("right").point - arm.section("left").point)
    with pytest.raises(pi.InputError, match="'elbow' by .* m.* stay open"):
        scene.assemble()  # both of its ends are held where they were drawn, which are too far apart for it
    assert np.array_equal(base.points, before) and np.array_equal(arm.section("right").point, end)
    del scene.parts["end"]
    report = scene.assemble()
    assert report.shift["crank"] == 0.0 and np.array_equal(base.points, before)
    assert report.shift["coupler"] < wide < report.largest * 2


def test_a_point_within_a_circle_moves_out_by_as_little_as_it_was_within():
    scene = pi.Scene()
    body = scene.add(pi.RigidBody(1.0, 0.01, {"center": (0.0, 0.0)}, origin=(0.06, 0.08), name="body"))
    scene.add(pi.Contact(body.at("center"), pi.ground.at((0.0, 0.0)), radius=0.2, name="circle"))
    report = scene.assemble()
    assert report.gap == pytest.approx(0.1, rel=1e-12) and report.largest == pytest.approx(0.1, rel=1e-9)
    assert body.at("center").point == pytest.approx([0.12, 0.16], rel=1e-9)


@pytest.mark.parametrize("offset", [0.4, -0.2])
@pytest.mark.parametrize("swapped", [False, True])
def test_a_motor_begins_where_its_profile_does(offset, swapped):
    scene = four_bar(np.full((3, 3), 1e-3), bar)
    crank = scene.parts["crank"]
    drawn, sides = crank.angle, (pi.ground, crank.at("left"))
    motor = scene.add(pi.AngleMotor(*sides[:: -1 if swapped else 1], angle=pi.profile.sine(0.5, 0.5, np.arcsin(2 * offset)), name="drive"))
    begin = motor.angle(0.0)
    assert begin == pytest.approx(offset)
    scene.assemble()
    assert crank.angle - drawn == pytest.approx(-begin if swapped else begin, abs=1e-12)
    model = scene.build()
    assert np.abs(model.phi(0.0, np.zeros(model.n))).max() < 1e-13
    assert pi.solve(model, 0.01, pi.GeneralizedAlpha(h=1e-3)).success


@dataclass(frozen=True, eq=False)
class Turning(pi.Joint):
    """A motor of one's own that does not keep the drawing."""

    angle: pi.profile.Profile = pi.profile.constant(0.2)

    def rows(self):
        return [pi.cross(self.a.d.onto(self.b.d).turned(self.angle), self.b.d)]


def with_joint(make):
    scene = pi.Scene()
    link = scene.add(bar("crank", (0.0, 0.0), 0.1))
    scene.add(make(link))
    return scene


def half_a_turn():
    scene = with_joint(lambda link: pi.AngleMotor(pi.ground, link.at("left"), angle=pi.profile.constant(2.8), name="drive"))
    scene.assemble()


def built():
    scene = with_joint(lambda link: pi.PointMass(link.at("left"), 1.0))
    scene.build()
    scene.add(pi.Revolute(pi.ground.at((0.1, 0.0)), scene.parts["crank"].at("left")))
    scene.assemble()


@pytest.mark.parametrize(
    "call, told",
    [
        (lambda: four_bar(coupler=too_long).assemble(), "'[ABCD]' by 0.0.* m.* stay open .* as drawn"),
        (lambda: four_bar(np.full((3, 3), 0.01), coupler=fixed).assemble(), "'coupler' has origin and"),
        (lambda: with_joint(lambda link: Turning(pi.ground.at((0.0, 0.0)), link.at("left"), name="own")).assemble(), "'own' is open again"),
        (half_a_turn, "'drive' would close on the wrong half-turn"),
        (built, "'crank' would have to move, but there is a model"),
        (lambda: pi.Scene().assemble(), "Scene.assemble: the scene has no plate"),
        (lambda: pi.AngleMotor(pi.ground, bar("crank", (0, 0), 0).at("left"), 1.0, offset="x"), "offset = 'x' must be a finite number"),
    ],
)
def test_what_cannot_be(call, told):
    with pytest.raises(pi.InputError, match=told):
        call()
