"""Profiles through measured values, velocities and accelerations: `pi.profile.from_samples`."""

import pickle
import warnings

import numpy as np
import pytest
from scipy.linalg import expm

import polyida as pi
from polyida import profile

DT = 0.02
T = DT * np.arange(11)
RECORD = 3.0 * np.random.default_rng(3).standard_normal(11) * np.sin(np.pi * T / T[-1]) ** 2  # m/s^2, the motion of the ground
K, C, MASS = 400.0, 1.0, 1.0
INTEGRATORS = {  # settings, error of the last place over the largest displacement
    "alpha": (pi.GeneralizedAlpha(h=5e-3), 1e-4),
    "energy-momentum": (pi.EnergyMomentum(h=2e-3), 1e-5),
    "radau": (pi.RadauIIA(), 1e-7),
    "ida": (pi.IDA(), 1e-4),
    "nonsmooth": (pi.NonsmoothAlpha(h=2e-3), 1e-3),
    "moreau": (pi.MoreauJean(h=2e-3), 1e-2),
}


def drifting(**given):
    """`from_samples` of an acceleration whose drift is known."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return profile.from_samples(T, RECORD, derivative=2, **given)


def shaken(motion):
    """A mass on a spring and a damper on a base that moves along x; the base is drawn at x = -1."""
    scene = pi.Scene()
    mass = scene.add(pi.RigidBody.bar(0.2, MASS, name="mass"))
    base = scene.add(pi.RigidBody(1.0, 0.01, {"end": (-1.0, 0.0)}, name="base"))
    scene.add(pi.Prismatic(pi.ground.at((0.0, 0.0), (1.0, 0.0)), mass.at("left"), name="rail"))
    scene.add(pi.Prismatic(pi.ground.at((-1.0, 0.0), (1.0, 0.0)), base.at("end"), name="track"))
    scene.add(pi.PrescribedPosition(base.at("end"), motion, None, name="shaker"))
    scene.add(pi.SpringDamper(base.at("end"), mass.at("left"), K, C, name="column"))
    return scene.build()


def response():
    """Displacement against the base at the end: exact for an acceleration that is linear between samples."""
    A = np.zeros((4, 4))
    A[0, 1] = A[2, 3] = 1.0
    A[1] = -K / MASS, -C / MASS, -1.0, 0.0
    step, state = expm(A * DT), np.zeros(2)
    for now, after in zip(RECORD, RECORD[1:]):
        state = (step @ [*state, now, (after - now) / DT])[:2]
    return state[0]


@pytest.mark.parametrize("name", INTEGRATORS)
def test_base_motion_by_the_record_of_an_earthquake(name):
    integrator, bound = INTEGRATORS[name]
    motion = drifting(start=-1.0)
    run = pi.solve(shaken(motion), T[-1], integrator)
    assert run.success, run.message
    assert np.isin(T, run.t).all()  # steps end at all samples
    stretch = run.q[-1, 0] - (motion.value(T[-1]) + 1.0)
    assert stretch == pytest.approx(response(), abs=bound * 8e-3)


def pushed():
    """A free mass under a force that is linear between samples."""
    scene = pi.Scene()
    mass = scene.add(pi.RigidBody(2.0, 1.0, {"c": (0.0, 0.0)}, name="mass"))
    scene.add(pi.PointLoad(mass.at("c"), (1.0, 0.0), profile.from_samples(T, RECORD, smooth=False), name="push"))
    return scene.build()


@pytest.mark.parametrize("name", ["alpha", "radau", "ida"])
def test_a_load_through_samples(name):
    """The velocity is the area by trapezoids; the last value, 0, is held."""
    run = pi.solve(pushed(), T[-1] + DT, INTEGRATORS[name][0])
    assert run.v[-1, 0] == pytest.approx(np.trapezoid(RECORD, T) / 2.0, rel=1e-4)


def test_the_drift_of_an_acceleration_is_stated():
    with pytest.warns(UserWarning, match=r"the motion ends at -0.01827 with the velocity -0.1834 per second; .* baseline=True"):
        drifted = profile.from_samples(T, RECORD, derivative=2)
    assert "11 samples of the second derivative from 0 to 0.2 s, ends at -0.01827 with the velocity -0.1834" in repr(drifted)
    area = np.trapezoid(RECORD, T)
    assert drifted.d1(T[-1]) == pytest.approx(area, rel=1e-12)
    assert drifted.value(T[-1] + 1.0) - drifted.value(T[-1]) == pytest.approx(area, rel=1e-12)
    assert drifted.kinks == tuple(T)


def test_a_baseline_brings_the_motion_to_rest_where_it_began():
    at_rest = profile.from_samples(T + 0.1, RECORD, derivative=2, baseline=True, start=2.0)
    assert at_rest.at(0.0) == (2.0, 0.0, 0.0)
    assert at_rest.value(0.3) == pytest.approx(2.0, abs=1e-15) and abs(at_rest.d1(0.3)) < 1e-15
    off = at_rest.d2(T[:-1] + 0.1) - RECORD[:-1]
    assert np.diff(off, 2) == pytest.approx(np.zeros(8), abs=1e-12)  # a straight line
    back = profile.from_samples(T, RECORD, derivative=1, baseline=True)
    assert abs(back.value(T[-1])) < 1e-15
    assert np.ptp(back.d1(T[:-1]) - RECORD[:-1]) < 1e-14  # a constant


def test_samples_of_a_smooth_motion_give_its_derivatives():
    t = np.linspace(0.0, 1.0, 201)
    by_value = profile.from_samples(t, np.sin(3.0 * t))
    by_rate = profile.from_samples(t, 3.0 * np.cos(3.0 * t), derivative=1)
    at = np.linspace(0.0, 0.999, 57)
    exact = np.sin(3.0 * at), 3.0 * np.cos(3.0 * at), -9.0 * np.sin(3.0 * at)
    for order, bound in enumerate((1e-8, 1e-5, 1e-2)):
        assert np.abs(by_value.over(at, order) - exact[order]).max() < bound
    for order, bound in enumerate((1e-9, 1e-8, 1e-5)):
        assert np.abs(by_rate.over(at, order) - exact[order]).max() < bound


def test_samples_on_a_line_are_no_kinks():
    corners = profile.from_samples([0.0, 1.0, 2.0, 3.0, 4.0], [0.0, 1.0, 2.0, 2.0, 2.0], smooth=False)
    assert corners.kinks == (0.0, 2.0, 4.0)
    assert [corners.at(t) for t in (-1.0, 0.5, 9.0)] == [(0.0, 0.0, 0.0), (0.5, 1.0, 0.0), (2.0, 0.0, 0.0)]


def test_a_run_with_samples_is_saved_with_its_scene(tmp_path):
    run = pi.solve(shaken(drifting(start=-1.0)), T[-1], pi.GeneralizedAlpha(h=0.02))
    run.save(tmp_path / "shaken.h5")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        loaded = pi.load(tmp_path / "shaken.h5")
    ours, theirs = (one.model.parts["shaker"].x for one in (run, loaded))
    assert theirs.formula == ours.formula and theirs.kinks == ours.kinks
    assert theirs.at(0.033) == ours.at(0.033) == pickle.loads(pickle.dumps(ours)).at(0.033)
    assert np.array_equal(pi.solve(loaded.model, T[-1], pi.GeneralizedAlpha(h=0.02)).q, run.q)


def test_the_scale_of_samples_is_a_parameter():
    run = pi.solve(pushed(), T[-1], pi.GeneralizedAlpha(h=0.01))
    names = [name for name in pi.gradient(run, pi.objective.Deviation("push", (0.1, 0.0))) if name.startswith("push")]
    assert names == ["push.force", "push.scale"]
    names = ["push.scale"]
    assert pi.check_gradient(run, pi.objective.Deviation("push", (0.1, 0.0)), names)[names[0]] < 1e-7


WRONG = {
    "one sample": (dict(t=[0.0], y=[0.0]), "two ascending times or more"),
    "times that repeat": (dict(t=[0.0, 1.0, 1.0], y=[0.0, 1.0, 2.0]), "two ascending times or more"),
    "times that differ by round-off": (dict(t=[1.0, 1.0 + 1e-15], y=[0.0, 1.0]), "two ascending times or more"),
    "another length": (dict(t=[0.0, 1.0], y=[0.0, 1.0, 2.0]), "y has 3 values, t has 2"),
    "gaps": (dict(t=[0.0, 1.0], y=[0.0, np.nan]), "y = .* must be a list of finite numbers"),
    "a third derivative": (dict(t=[0.0, 1.0], y=[0.0, 1.0], derivative=3), "derivative = 3 must be 0 for values"),
    "a baseline of values": (dict(t=[0.0, 1.0], y=[0.0, 1.0], baseline=True), "needs derivative = 1 or 2"),
    "a start of values": (dict(t=[0.0, 1.0], y=[0.0, 1.0], start=1.0), "needs derivative = 1 or 2"),
    "values too large": (dict(t=[0.0, 1e-9], y=[0.0, 1e149]), "too large"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_samples_are_refused(case):
    arguments, words = WRONG[case]
    with pytest.raises(pi.InputError, match=f"profile.from_samples: .*{words}"):
        profile.from_samples(**arguments)
