"""Angles of joints over frames."""

import numpy as np
import pytest

import polyida as pi

ALPHA = pi.GeneralizedAlpha(h=1e-3)


@pytest.mark.parametrize("kind", ["motor to ground", "motor, ground as b", "motor between"])
def test_a_motor_s_angle_is_its_profile(scenes, kind):
    angle = pi.profile.ramp(0.0, -0.8, 0.05)
    run = pi.solve(scenes.jointed(kind, angle=angle).build(), 0.05, ALPHA)
    assert np.allclose(run.angle("joint"), angle.value(run.t), atol=1e-9)


def test_turns_are_counted(scenes):
    """Two turns and a half, by a stiff plate that spins about its hinge, read by name, part, and from a file."""
    scene, upper = scenes.hinged((0.0, 0.0), material={"E": 5e9})
    model = scene.build()
    arm = model.reference - upper.section("left").point
    run = pi.solve(model, 0.1, ALPHA, v0=(50 * np.pi * np.stack([-arm[:, 1], arm[:, 0]], axis=1)).ravel(), every=7)
    found = run.angle("shoulder")
    assert found[0] == 0.0 and found[-1] == pytest.approx(5 * np.pi, rel=2e-2) and (np.diff(found) > 0).all()
    assert np.array_equal(found, run.angle(model.parts["shoulder"]))


def test_between_two_plates_it_is_the_difference(scenes):
    scene = scenes.jointed("revolute")
    run = pi.solve(scene.build(), 0.1, ALPHA)
    upper, lower = (scene.parts[name] for name in ("upper", "lower"))
    ways, first = [], {body.name: body.nodes.start for body in run.model.bodies}
    for side in (upper.section("right"), lower.section("left")):
        u = run.q.reshape(len(run), -1, 2)[:, side.nodes + first[side.body.name]]
        ways.append(np.einsum("fkd,k->fd", u, side.turn_weights) + side.direction)
    turned = [np.unwrap(np.arctan2(way[:, 1], way[:, 0])) for way in ways]
    assert np.allclose(run.angle("joint"), turned[1] - turned[0] - (turned[1] - turned[0])[0], atol=1e-12)
