"""The centre of mass as a point of reduced and rigid plates, and gravity that follows a profile over reduced ones."""

import numpy as np
import pytest

import polyida as pi

PLASTIC = pi.Material(E=50e6, nu=0.3, rho=1100.0)
KINDS = {"rigid": pi.Rigid, "reduced": lambda plate: pi.Reduced(plate, modes=4)}


def hinged(kind, gravity=(0.0, -9.81), thickness=0.01):
    """(scene, body) of a bar hinged at its left end."""
    scene = pi.Scene(gravity)
    body = scene.add(KINDS[kind](pi.Plate(pi.mesh.quads(1.0, 0.1, 6, 2), PLASTIC, thickness, name="bar")))
    scene.add(pi.Revolute(pi.ground, body.section("left"), name="hinge"))
    return scene, body


@pytest.mark.parametrize("kind", KINDS)
def test_files_know_parts_at_the_centre(kind, tmp_path):
    scene, body = hinged(kind)
    scene.add(pi.PointLoad(body.at("center"), (0.0, 1.0), name="load"))
    scene.add(pi.PointMass(body.at("center", direction=(0.0, 1.0)), 0.1, name="mass"))
    run = pi.solve(scene.build(), 0.01, pi.GeneralizedAlpha(h=1e-3))
    run.save(tmp_path / "run.h5")
    known = pi.load(tmp_path / "run.h5")
    assert np.array_equal(known.position("load"), run.position("load"))
    assert np.array_equal(known.model.residual(0.0, *3 * [run.q[-1]], run.lam[-1]), run.model.residual(0.0, *3 * [run.q[-1]], run.lam[-1]))


def test_a_plate_held_by_its_centre_is_held_as_a_whole():
    """Not by the nodes whose numbers are those of the pairs: both ends bend alike under loads, and weight bends nothing."""
    scene = pi.Scene((0.0, -9.81))
    body = scene.add(pi.Reduced(pi.Plate(pi.mesh.quads(1.0, 0.1, 6, 2), PLASTIC, 0.01), modes=4))
    scene.add(pi.Clamp(body.at("center")))
    for side in ("left", "right"):
        scene.add(pi.PointLoad(body.section(side), (0.0, -1.0), pi.profile.ramp(0.0, 1.0, duration=0.02)))
    run = pi.solve(scene.build(), 0.05, pi.GeneralizedAlpha(h=1e-3))
    left, right = (run.position(body.section(side))[:, 1] for side in ("left", "right"))
    assert run.success and np.abs(left - right).max() < 1e-10
    assert -1e-3 < left.min() < -2e-4


def test_gravity_may_follow_a_profile_over_reduced_plates():
    scene, body = hinged("reduced", (0.0, pi.profile.ramp(0.0, -9.81, duration=0.01)))
    other, other_body = hinged("reduced", (0.0, pi.profile.constant(-9.81)))
    steady, steady_body = hinged("reduced")
    run = pi.solve(scene.build(), 0.05, pi.GeneralizedAlpha(h=1e-3))
    switched, plain = (pi.solve(one.build(), 0.05, pi.GeneralizedAlpha(h=1e-3)) for one in (other, steady))
    assert run.success and "leave much out" not in run.summary()
    assert switched.position(other_body.section("right"))[-1] == pytest.approx(plain.position(steady_body.section("right"))[-1], abs=1e-10)
