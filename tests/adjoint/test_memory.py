"""A gradient keeps nothing alive: a design evaluates hundreds, each on a model of its own."""

import gc
import weakref

import polyida as pi


def made():
    """A factored model, a run of it, its gradient."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    arm = scene.add(pi.Plate(pi.mesh.quads(1.0, 0.1, 4, 2), pi.Material(E=50e6, nu=0.3, rho=1100.0), 0.01, name="arm"))
    scene.add(pi.Revolute(pi.ground, arm.section("left"), name="hinge"))
    scene.add(pi.PointMass(arm.section("right"), 0.1, name="tip"))
    model = scene.build().with_factors(arm=(0.5, 0.5))
    run = pi.solve(model, 0.01, pi.GeneralizedAlpha(h=1e-3))
    return model, run, pi.gradient(run, pi.objective.Deviation("tip", (1.0, 0.0)))


def test_model_and_run_go_with_their_gradient():
    made()  # the first time loads kernels, and exceptions of that hold frames until they are collected
    gc.disable()
    try:
        model, run, found = made()
        kept = [weakref.ref(model), weakref.ref(run)]
        del model, run
        assert found.value > 0.0 and [thing() for thing in kept] == [None, None]
    finally:
        gc.enable()
