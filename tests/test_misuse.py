"""What users mistake most often: missing arguments, exchanged sides, text that is no path, modes of a drawing that falls."""

import numpy as np
import pytest

import polyida as pi


@pytest.mark.parametrize("name", ["EnergyMomentum", "NonsmoothAlpha", "MoreauJean"])
def test_a_missing_argument_is_named(name):
    with pytest.raises(pi.InputError, match=f"{name}: h is missing; it takes h, "):
        getattr(pi, name)()
    with pytest.raises(pi.InputError, match="solve: t_end is missing"):
        pi.solve(object())
    assert getattr(pi, name)(1e-3).h == getattr(pi, name)(h=1e-3).h == 1e-3


def test_a_text_that_is_no_path_is_named():
    with pytest.raises(pi.InputError, match="'hello' is no path; write one such as 'M 0 0 h 2 v -1 h -2 z'"):
        pi.mesh.svg_path("hello")


def resting(a, b):
    scene = pi.Scene()
    ball = scene.add(pi.RigidBody(1.0, 0.1, {"c": (0.0, 0.0)}, origin=(0.0, 0.5), name="ball"))
    sides = {"ball": ball.at("c"), "line": pi.ground.at((0.0, 0.0)), "slope": pi.ground.at((0.0, 0.0), (1.0, 0.2))}
    scene.add(pi.Contact(sides[a], sides[b], name="touch"))
    return scene.build()


@pytest.mark.parametrize(
    "line, words", [("line", "within each other at rest.*exchange the sides if the ground is the line"), ("slope", "exchange the sides")]
)
def test_exchanged_sides_of_a_contact_are_told(line, words):
    with pytest.raises(pi.InputError, match=f"ontact.*{words}|touch.*{words}"):
        resting(line, "ball")
    assert "touch" in resting("ball", line).joints


def pendulum(angle, gravity=9.81):
    scene = pi.Scene(gravity=(0.0, -gravity))
    bar = scene.add(pi.RigidBody.bar(1.0, 1.0, angle=angle))
    scene.add(pi.Revolute(pi.ground, bar.at("left")))
    return scene.build()


@pytest.mark.parametrize("angle", [0.0, -np.pi / 2])
def test_modes_of_a_drawing_under_loads_that_it_cannot_bear_warn(angle, recwarn):
    with pytest.warns(UserWarning, match=r"not in balance, its loads act on a mechanism.*state=pi.static\(model\)"):
        pi.modes(pendulum(angle))
    recwarn.clear()
    pi.modes(pendulum(angle, 0.0))
    pi.modes(pendulum(-np.pi / 2), state=pi.static(pendulum(-np.pi / 2)))
    assert not recwarn.list


@pytest.mark.parametrize("stiffness, warned", [(1e2, True), (1e4, False)])
def test_modes_of_a_drawing_that_sags_far_warn(stiffness, warned, recwarn):
    """A sag of 0.1 m, and of 1 mm, of a bar of 1 m."""
    scene = pi.Scene(gravity=(0.0, -10.0))
    bar = scene.add(pi.RigidBody.bar(1.0, 1.0))
    scene.add(pi.Prismatic(pi.ground.at((0.0, 0.0), (0.0, 1.0)), bar.at("left")))
    scene.add(pi.SpringDamper(pi.ground.at((0.0, -1.0)), bar.at("left"), stiffness, 0.0))
    pi.modes(scene.build())
    assert any("its loads move it by 0.1 m" in str(one.message) for one in recwarn.list) is warned
