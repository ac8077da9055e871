"""Scenes, models, runs and profiles go through pickle, as they must to other processes, and give the same results behind it."""

import pickle
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest

import polyida as pi


def swing(t):
    return 0.3 * np.sin(2.0 * t) ** 3


PROFILES = {
    "constant": pi.profile.constant(2.5),
    "polynomial": pi.profile.polynomial([1.0, -2.0, 0.5]),
    "quintic": pi.profile.quintic(0.3, 1.7, 0.8, 0.1),
    "ramp": pi.profile.ramp(0.3, 1.7, 0.8, 0.1),
    "linear": pi.profile.linear(0.3, 1.7, 0.8, 0.1),
    "sine": pi.profile.sine(0.4, 2.0, 0.3),
    "function": pi.profile.from_function(swing, kinks=(0.5,)),
    "difference": pi.profile.difference(pi.profile.sine(0.4, 2.0), pi.profile.from_function(swing)),
}
PARTS = ("t", "q", "v", "a", "lam")


def again(thing):
    return pickle.loads(pickle.dumps(thing))


def rich(scenes):
    """A scene with every kind of part, driven by ready-made profiles and by one of a user's own."""
    scene = scenes.jointed("motor between", angle=swing)
    lower, upper = scene.parts["lower"], scene.parts["upper"]
    scene.add(pi.PointLoad(lower.section("right"), (0.5, 0.0), pi.profile.sine(1.0, 3.0), name="push"))
    scene.add(pi.EdgeTraction(upper.section("top"), (0.0, 10.0), pi.profile.ramp(0.0, 1.0, 0.1), name="wind"))
    end = lower.section("right")
    scene.add(pi.SpringDamper(pi.ground.at((1.0, 1.0)), end, 20.0, 0.1))
    scene.add(pi.TorsionSpring(pi.ground, end, 0.5, 0.01))
    scene.add(pi.PenaltyContact(end, pi.ground.at((0.0, 0.2)), 100.0, 0.1))
    scene.add(pi.Torque(end, swing))
    scene.add(pi.Force(end, (swing, 0.3), follower=True))
    scene.gravity = (pi.profile.sine(1.0, 2.0), -9.81)
    return scene


def solved(model):
    return pi.solve(model, 0.02, pi.GeneralizedAlpha(h=1e-3))


def same(run, other):
    return run.status == other.status and all(np.array_equal(getattr(run, part), getattr(other, part)) for part in PARTS)


@pytest.mark.parametrize("name", PROFILES)
def test_a_profile_keeps_its_values(name):
    given, copy = PROFILES[name], again(PROFILES[name])
    assert all(copy.at(t) == given.at(t) for t in (0.0, 0.1, 0.2345, 0.5, 0.81, 1.3))
    assert (copy.kinks, copy.formula, copy.shortest) == (given.kinks, given.formula, given.shortest)


def test_scenes_and_models_give_the_same_run(scenes):
    scene = rich(scenes)
    model = scene.build()
    run = solved(model)  # the model then keeps factors, which stay at home
    copied = again(model)
    assert same(run, solved(again(scene).build())) and same(run, solved(copied))
    assert copied.labels == model.labels and copied.parts["lower"].section("right").body is copied.parts["lower"]


@pytest.mark.parametrize("integrator", [pi.GeneralizedAlpha(h=1e-3), pi.EnergyMomentum(h=1e-3), pi.IDA(), pi.RadauIIA()], ids=repr)
def test_a_run_knows_what_it_knew(scenes, integrator):
    run = pi.solve(rich(scenes).build(), 0.01, integrator)
    copy = again(run)
    assert same(run, copy) and copy.integrator == integrator and copy.counts == run.counts
    assert np.array_equal(run.position("tip"), copy.position("tip"))
    assert np.array_equal(run.reaction("joint"), copy.reaction("joint"))
    assert np.array_equal(run.energy.total, copy.energy.total)
    further, copied = (pi.solve(each.model, 0.015, integrator, state=each.state) for each in (run, copy))
    assert same(further, copied)


def test_another_process_solves_the_scene_that_it_is_sent(scenes):
    scene = rich(scenes)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        there = pool.submit(pi.solve, scene.build(), 0.02, pi.GeneralizedAlpha(h=1e-3)).result()
    assert np.abs(there.q - solved(scene.build()).q).max() < 1e-12
