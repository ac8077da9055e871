"""Buckling factors: Euler's columns, a column under its weight, a frame, a motion, an arch at its limit point, wrong input."""

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import polyida as pi

E, NU, THICKNESS, LENGTH, HEIGHT = 1e9, 0.3, 0.01, 1.0, 0.02
MATERIAL = pi.Material(E, NU, 1e3)
BENDING, SHEAR = E * THICKNESS * HEIGHT**3 / 12.0, 5.0 / 6.0 * E / (2.0 * (1.0 + NU)) * THICKNESS * HEIGHT
MESH = pi.mesh.rectangle(LENGTH, HEIGHT, cells=40, seed=1)
AXIS = pi.ground.at((LENGTH, 0.0), (1.0, 0.0))


@dataclass(frozen=True, eq=False)
class Push(pi.Joint):
    """The point of b is `move` away from that of a, along the direction of a."""

    move: Any = None

    def rows(self):
        return [pi.dot(self.a.d, self.b.x - self.a.x) - self.move]


def column(foot, top=None, gravity=(0.0, 0.0), material=MATERIAL, **options):
    """(scene, plate) of a column along x, held by these joints."""
    scene = pi.Scene(gravity)
    plate = scene.add(pi.Plate(MESH, material, THICKNESS, name="column", order=2, **options))
    scene.add(foot(plate.section("left")))
    if top:
        scene.add(top(AXIS, plate.section("right"), name="guide"))
    return scene, plate


def clamp(at):
    return pi.Clamp(at, name="foot")


def pin(at):
    return pi.Revolute(pi.ground, at, name="foot")


@pytest.mark.parametrize(
    "foot, top, share", [(clamp, None, 2.0), (pin, pi.Slot, 1.0), (clamp, pi.Slot, 0.699156), (clamp, pi.Prismatic, 0.5)]
)
def test_the_four_columns_of_euler(foot, top, share):
    scene, plate = column(foot, top)
    scene.add(pi.PointLoad(plate.section("right"), (-2.0, 0.0), name="push"))
    scene.add(pi.PointLoad(plate.section("right"), (0.0, 0.0), name="nothing"))
    found = pi.buckling(scene.build(), load="push", count=2)
    euler = np.pi**2 * BENDING / (share * LENGTH) ** 2
    assert 2.0 * found.factors[0] == pytest.approx(euler / (1.0 + euler / SHEAR), rel=0.005)
    assert found.along[0] < 1e-3 and len(found.factors) == 2 and "factor" in found.summary()
    assert np.abs(found.shapes).max(axis=1) == pytest.approx([1.0, 1.0])


@pytest.mark.parametrize("load", [None, "gravity"])
def test_a_column_under_its_weight(load):
    scene, _ = column(clamp, gravity=(-9.81, 0.0))
    model = scene.build()
    greenhill = 7.83735 * BENDING / (MATERIAL.rho * THICKNESS * HEIGHT * 9.81 * LENGTH**3)
    first = pi.buckling(model, load=load, count=1).factors[0]
    assert first == pytest.approx(greenhill, rel=0.005)
    beyond = pi.buckling(model, load=load, state=pi.static(model), count=1).factors[0]
    assert 1.0 + beyond == pytest.approx(first, rel=1e-3), "a state under the load: what is added to it"


def test_viscoelastic_plates_buckle_by_their_long_time_modulus():
    factors = []
    for material in (pi.Material(E, NU, 1e3, prony=[(0.5, 1.0)]), pi.Material(0.5 * E, NU, 1e3)):
        scene, _ = column(clamp, gravity=(-9.81, 0.0), material=material)
        found = pi.buckling(scene.build(), count=1)
        factors.append(found.factors[0])
    assert factors[0] == pytest.approx(factors[1], rel=2e-3), "their stabilisation does not relax"


def test_a_motion_that_compresses():
    scene, plate = column(clamp, pi.Prismatic)
    scene.add(Push(AXIS, plate.section("right"), move=pi.profile.linear(0.0, -1e-4, duration=1.0), name="press"))
    found = pi.buckling(scene.build(), load="press", t=1.0, count=1)
    assert 1e-4 * found.factors[0] == pytest.approx(4.0 * np.pi**2 * BENDING / (E * THICKNESS * HEIGHT), rel=0.01)


@pytest.mark.parametrize("clamped, factor", [(True, 7.379), (False, 1.821)])
def test_a_portal_frame_sways(clamped, factor):
    """Two columns and a beam of length 1: `k L tan k L = 6` on pins, `k L cot k L = -6` clamped, factor (k L)^2."""
    corners, cells = {}, []

    def add(x0, x1, y0, y1):
        places = ((x0, y0), (x1, y0), (x1, y1), (x0, y1))
        cells.append([corners.setdefault((round(x, 9), round(y, 9)), len(corners)) for x, y in places])

    along = np.linspace(HEIGHT, 1.0, 21)
    upwards = np.append(np.linspace(0.0, 0.99, 21), 1.01)
    for low, high in zip(upwards, upwards[1:]):
        add(0.0, HEIGHT, low, high)
        add(1.0, 1.0 + HEIGHT, low, high)
    for left, right in zip(along, along[1:]):
        add(left, right, 0.99, 1.01)
    mesh = pi.mesh.PolygonMesh(np.array(list(corners)), np.ravel(cells), np.arange(0, 4 * len(cells) + 1, 4))
    scene = pi.Scene((0.0, 0.0))
    frame = scene.add(pi.Plate(mesh, MATERIAL, THICKNESS, name="frame", order=2))
    for side in (0, 1):
        mine = lambda x, side=side: (x[:, 0] > 0.99) == bool(side)  # noqa: E731
        foot = frame.section(lambda x, mine=mine: (x[:, 1] < 1e-9) & mine(x))
        scene.add(pi.Clamp(foot) if clamped else pi.Revolute(pi.ground, foot))
        top = frame.section(lambda x, mine=mine: (x[:, 1] > 1.01 - 1e-9) & mine(x) & ((x[:, 0] < 0.021) | (x[:, 0] > 0.999)))
        scene.add(pi.EdgeTraction(top, (0.0, -1.0 / (THICKNESS * HEIGHT)), name=f"load {side}"))
    found = pi.buckling(scene.build(), load=["load 0", "load 1"], count=2)
    assert found.factors[0] / BENDING == pytest.approx(factor, rel=0.015)


def arch(rise):
    """A pinned sine arch under a force on its top."""
    strip = pi.mesh.quads(1.0, 0.01, 20, 1, order=2)
    x, y = strip.points.T
    mesh = pi.mesh.moved(strip, np.column_stack([x, y + rise * np.sin(np.pi * x)]))
    scene = pi.Scene((0.0, 0.0))
    plate = scene.add(pi.Plate(mesh, MATERIAL, THICKNESS, name="arch"))
    scene.add(pi.Revolute(pi.ground, plate.section("left"), name="left"))
    scene.add(pi.Revolute(pi.ground, plate.section("right"), name="right"))
    scene.add(pi.PointLoad(plate.node((0.5, rise + 0.005)), (0.0, -1.0), name="top"))
    return scene.build()


def test_at_a_limit_point_the_path_is_named():
    with pytest.warns(UserWarning, match="pi.equilibrium_path"):
        found = pi.buckling(arch(0.01), load="top", count=1)
    assert found.along[0] > 0.5 and "limit point" in found.title(0)


def test_loads_of_the_default_profile_are_separate_inputs():
    """One load grows, the other stays: both had shared one profile."""
    scene, plate = column(clamp)
    scene.add(pi.PointLoad(plate.section("right"), (-1.0, 0.0), name="push"))
    scene.add(pi.PointLoad(plate.section("right"), (-5.0, 0.0), name="steady"))
    both, alone = (pi.buckling(scene.build(), load=load, count=1).factors[0] for load in (("push", "steady"), "push"))
    assert alone + 5.0 == pytest.approx(6.0 * both, rel=1e-3)


def test_reduced_and_rigid_bodies_buckle():
    scene = pi.Scene((0.0, 0.0))
    board = scene.add(pi.Reduced(pi.Plate(MESH, MATERIAL, THICKNESS, order=2), modes=6, name="board"))
    scene.add(pi.Clamp(board.section("left"), name="foot"))
    scene.add(pi.PointLoad(board.section("right"), (-1.0, 0.0), name="push"))
    euler = np.pi**2 * BENDING / (2.0 * LENGTH) ** 2
    assert pi.buckling(scene.build(), load="push", count=1).factors[0] == pytest.approx(euler, rel=0.01)
    inverted = pi.Scene((0.0, -1.0))
    bar = inverted.add(pi.RigidBody.bar(1.0, 1.0, angle=np.pi / 2.0, name="bar"))
    inverted.add(pi.Revolute(pi.ground, bar.at("left"), name="pin"))
    inverted.add(pi.TorsionSpring(pi.ground, bar.at("left"), stiffness=3.0))
    assert pi.buckling(inverted.build(), load="gravity", count=1).factors[0] == pytest.approx(6.0, rel=1e-6), "k / (m g l / 2)"


def test_two_controllers_without_targets_have_separate_inputs():
    scene = pi.Scene()
    for name in ("first", "second"):
        bar = scene.add(pi.RigidBody.bar(1.0, 1.0, name=f"bar of {name}"))
        scene.add(pi.Revolute(pi.ground, bar.at("left"), name=f"pin of {name}"))
        scene.add(pi.PID(bar.at("left"), kp=1.0, name=name))
    assert [name for name, _ in scene.build().named_profiles if name] == ["first", "second"]


def test_a_load_that_pulls_has_no_factor():
    scene, plate = column(clamp)
    scene.add(pi.PointLoad(plate.section("right"), (1.0, 0.0), name="pull"))
    with pytest.warns(UserWarning, match="other direction"):
        assert not len(pi.buckling(scene.build(), load="pull").factors)


def test_wrong_input():
    scene, plate = column(clamp)
    scene.add(pi.PointLoad(plate.section("right"), (-1.0, 0.0), name="push"))
    model = scene.build()
    for load, said in (
        ("pull", "'pull'; known: 'push'"),
        ("gravity", "no gravity"),
        (np.zeros(model.n), "zero"),
        (np.zeros(3), "finite numbers"),
        (["push", 3], "buckling"),
    ):
        with pytest.raises(pi.InputError, match=said):
            pi.buckling(model, load=load)
    with pytest.raises(pi.InputError, match="count"):
        pi.buckling(model, load="push", count=0)
    with pytest.raises(pi.InputError, match="not that of the state"):
        pi.buckling(model, load="push", state=pi.static(model), t=1.0)
    loose = pi.Scene((0.0, -9.81))
    loose.add(pi.Plate(MESH, MATERIAL, THICKNESS, name="loose", order=2))
    with pytest.raises(pi.StepFailure, match="move freely"):
        pi.buckling(loose.build())
    with warnings.catch_warnings(action="error"):
        picture = pi.buckling(model, load="push", count=2).plot()
    assert len(picture.axes) == 2
