"""Gradients of runs of Radau IIA against differences of the very same steps."""

import numpy as np
import pytest

import polyida as pi
from polyida.adjoint import radau
from polyida.adjoint.radau_history import step_history
from polyida.errors import REFACTOR
from polyida.problems import andrews
from polyida.problems.equations import Pendulum

CLOSE = 1e-6  # asked of every parameter; at a tolerance of 1e-12 errors are about 1e-10
TIGHT = 1e-12


def arm(**material):
    """A soft plate that a motor turns, with two kinks in the run, and one that slides on it."""
    scene, soft = pi.Scene(gravity=(0.0, -9.81)), pi.Material(E=3e7, nu=0.3, rho=1100.0, **material)
    plate = scene.add(pi.Plate(pi.mesh.quads(1.0, 0.25, 3, 1), soft, thickness=0.01, name="arm"))
    fore = scene.add(pi.Plate(pi.mesh.quads(0.5, 0.2, 2, 1), soft, thickness=0.01, origin=(1.0, 0.0), element="virtual", name="fore"))
    scene.add(pi.Revolute(pi.ground, plate.section("left"), name="hub"))
    scene.add(pi.Prismatic(plate.section("right"), fore.section("left"), name="slide"))
    scene.add(pi.AngleMotor(pi.ground, plate.section("left"), angle=pi.profile.ramp(0.0, 0.5, 0.031, 0.011), name="motor"))
    scene.add(pi.PointMass(plate.section("right"), 0.05, name="tip"))
    return scene.build()


MODEL = arm()
ALL = (
    pi.objective.Deviation("tip", (1.0, 0.3))
    + 1e-6 * pi.objective.PeakReaction("motor", p=4)
    + 1e-3 * pi.objective.StrainEnergy("arm")
    + pi.objective.UserObjective(lambda run: 1e-9 * float(np.sum(run.a**2)), lambda run: {"a": 2e-9 * run.a})
)
NAMES = ["arm.stiffness", "fore.mass", "tip.mass", "motor.begin", "v0"]
WAYS = {
    "fixed": ({"h": 4e-3}, {}),
    "few frames": ({"h": 4e-3, "stages": 2}, {"every": 3}),
    "index 3": ({"h": 4e-3, "form": "index3"}, {}),
    "v left alone": ({"h": 4e-3, "form": "index3", "project": False}, {}),
    "cut steps": ({"h": 2e-2, "max_iterations": 7}, {}),
    "adaptive": ({"rtol": 1e-3}, {}),
    "by default": ({}, {}),
}


@pytest.mark.parametrize("way", WAYS)
def test_a_gradient_is_that_of_the_steps_that_were_taken(way):
    settings, asked = WAYS[way]
    run = pi.solve(MODEL, 0.05, pi.RadauIIA(tolerance=TIGHT, **settings), **asked)
    assert run.success and (way != "cut steps" or run.counts.rejected > 0)
    errors = pi.check_gradient(run, ALL, parameters=NAMES)
    assert set(errors) == set(NAMES)
    assert max(errors.values()) < CLOSE, errors


def test_a_damped_scene():
    run = pi.solve(arm(viscosity=1e-3, mass_damping=2.0), 0.03, pi.RadauIIA(h=4e-3, tolerance=TIGHT))
    errors = pi.check_gradient(run, ALL, parameters=["arm.stiffness", "fore.E", "fore.thickness", "arm.rho", "motor.duration"])
    assert max(errors.values()) < CLOSE, errors


def test_errors_do_not_grow_as_steps_become_short():
    """A body that a controller turns: bars of its joint's forces are large in short steps."""
    scene = pi.Scene()
    body = scene.add(pi.RigidBody(1.0, 0.5, {"centre": (0.0, 0.0), "rim": (1.0, 0.0)}, name="rotor"))
    scene.add(pi.Revolute(pi.ground.at((0.0, 0.0)), body.at("centre"), name="axle"))
    scene.add(pi.PID(body.at("centre"), kp=20.0, ki=30.0, kd=4.0, target=0.5, filter=0.02, name="drive"))
    run = pi.solve(scene.build(), 0.25, pi.RadauIIA(h=5e-3, tolerance=1e-13))
    goal = pi.objective.Deviation(body.at("rim"), (np.cos(0.5), np.sin(0.5)))
    errors = pi.check_gradient(run, goal, parameters=["drive.kp", "drive.ki", "drive.kd"])
    assert max(errors.values()) < 1e-8, errors


def same(found, wanted):
    return all(np.allclose(found[name], wanted[name], rtol=1e-7, atol=1e-9 * np.abs(wanted[name]).max()) for name in NAMES)


@pytest.mark.parametrize("form", ["ggl", "index3"])
def test_refined_and_factored_equations_agree(form, monkeypatch):
    run = pi.solve(MODEL, 0.03, pi.RadauIIA(h=4e-3, form=form))
    refined = pi.gradient(run, ALL, parameters=NAMES)
    assert refined.counts.factorizations < 5 * run.counts.factorizations
    compiled, calls = radau.sweep_back, iter(range(99))
    monkeypatch.setattr(radau, "sweep_back", lambda *given: (given[3], REFACTOR) if next(calls) in (0, 2) else compiled(*given))
    partly = pi.gradient(run, ALL, parameters=NAMES)
    monkeypatch.setattr(radau.RadauAdjoint, "_table", radau.RadauAdjoint._exact)
    factored = pi.gradient(run, ALL, parameters=NAMES)
    assert same(refined, factored) and same(partly, factored)


def test_stages_that_the_simplified_newton_does_not_find(monkeypatch):
    run = pi.solve(MODEL, 0.02, pi.RadauIIA(h=4e-3, tolerance=TIGHT))
    found = pi.gradient(run, ALL, parameters=NAMES)
    monkeypatch.setattr(radau, "solve_stages", lambda *given: (given[-2], REFACTOR))
    again = pi.gradient(run, ALL, parameters=NAMES)
    assert same(again, found)


def test_models_of_ones_own():
    """Andrews' coordinates are unlike, so that mu moves them by their masses; all of q, v, a and lam are read."""
    problem = andrews.problem()
    sizes = {"q": 1.0, "v": 1e-2, "a": 1e-8, "lam": 1e-4}
    read = pi.objective.UserObjective(
        lambda run: sum(float(np.sum(size * getattr(run, name)[1:] ** 2)) for name, size in sizes.items()),
        lambda run: {name: 2 * size * getattr(run, name) * (np.arange(len(run)) > 0)[:, None] for name, size in sizes.items()},
    )
    compiled = pi.compiled(type("CompiledPendulum", (Pendulum,), {}))()
    for model, t_end, h, begin in (
        (Pendulum(), 0.5, 0.05, {}),
        (compiled, 0.5, 0.05, {}),
        (problem.model, 0.004, 5e-4, {"q0": problem.q0, "v0": problem.v0}),
    ):
        begin = begin or {"q0": [1.0, 0.0]}
        run = pi.solve(model, t_end, pi.RadauIIA(h=h, tolerance=1e-14), **begin)
        errors = pi.check_gradient(run, read)
        assert errors and max(errors.values()) < CLOSE, errors


def test_segments_between_checkpoints_are_the_same_bit_by_bit():
    run = pi.solve(Pendulum(), 6.0, pi.RadauIIA(rtol=1e-6), q0=[1.0, 0.0], every=7)
    whole, parts = step_history(run, run.model), step_history(run, run.model, 3e4)
    assert len(whole.frames) > 200 and np.array_equal(parts.frames, whole.frames)
    for first in range(0, len(whole.frames) - 100, 100):
        for one, other in zip(whole.states(first, first + 100), parts.states(first, first + 100)):
            assert np.array_equal(one, other)
