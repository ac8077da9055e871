"""The centre of mass as a point of reduced and rigid plates, and gravity that follows a profile over reduced ones."""

import numpy as np

import polyida as pi

PLASTIC = pi.Material(E=50e6, nu=0.3, rho=1100.0)


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


def test_all_modes_of_a_small_mesh_are_the_full_plate():
    tips = []
    for body_of in (lambda plate: plate, lambda plate: pi.Reduced(plate, modes=40)):
        scene = pi.Scene((0.0, -9.81))
        body = scene.add(body_of(pi.Plate(pi.mesh.quads(1.0, 0.1, 3, 1), PLASTIC, 0.01, element="virtual")))
        scene.add(pi.Revolute(pi.ground, body.section("left")))
        model = scene.build()
        tips.append(pi.solve(model, 0.1, pi.GeneralizedAlpha(h=1e-3)).position(body.section("right")))
    assert model.n == 16
    assert np.abs(tips[0] - tips[1]).max() < 1e-8
