"""Absolute tolerances follow the model's own length and speed: the error follows rtol, in metres and in millimetres."""

import numpy as np
import pytest

import polyida as pi
from polyida.integrate.sizes import typical_sizes
from polyida.integrate.state import State
from polyida.study.references import explicit

LADDER = np.array([1e-3, 1e-5, 1e-7])


def slope(errors, ladder=LADDER):
    return np.polyfit(np.log(ladder), np.log(errors), 1)[0]


def double_plate(unit=1.0):
    """The undamped double plate with lengths and gravity times `unit`, E times its square: the same motion, times unit."""
    scene, mesh = pi.Scene(gravity=(0.0, -9.81 * unit)), pi.mesh.rectangle(unit, 0.1 * unit, cells=8, seed=1)
    rubber, end = pi.Material(E=50e6 * unit**2, nu=0.3, rho=1100.0), pi.ground
    for k, name in enumerate(("upper", "lower")):
        plate = scene.add(pi.Plate(mesh, rubber, 0.01 * unit, origin=(k * unit, 0.0), name=name))
        scene.add(pi.Revolute(end, plate.section("left")))
        end = plate.section("right")
    scene.add(pi.PointMass(end, 0.5 * unit**3, name="tip"))
    return scene.build()


def test_the_error_of_a_flexible_scene_follows_rtol():
    model = double_plate()
    exact = explicit(model, 0.1, 1e-9)[0][0]
    ends = [pi.solve(model, 0.1, pi.IDA(rtol=rtol), every=10**9).q[-1] for rtol in LADDER]
    errors = [np.linalg.norm(model.displacement("tip", q - exact)) for q in ends]
    assert slope(errors) >= 0.8 and errors[0] < 1e-3


def test_a_scene_of_millimetres_takes_the_same_steps():
    large, small = (pi.solve(double_plate(unit), 0.1, pi.IDA(rtol=1e-4)) for unit in (1.0, 1e-3))
    assert large.counts == small.counts
    apart = np.abs(1e3 * small.q[-1] - large.q[-1]).max(), np.abs(small.t - large.t).max()
    assert max(apart) < 1e-8  # the factor is in single precision, and steps follow what it leaves


@pytest.mark.parametrize("name, share, order, least", [("pendulum", 0.2, 5, 0.8), ("andrews", 1.0, 5, 0.8), ("car-axis", 0.15, 2, 0.6)])
def test_the_error_of_rigid_systems_follows_rtol(name, share, order, least):
    p = pi.problems.get(name)
    at = np.linspace(0.0, share * p.t_end, 21)[1:]
    runs = [
        pi.solve(p.model, at[-1], pi.IDA(rtol=rtol, max_order=order if rtol > 1e-10 else 5), q0=p.q0, v0=p.v0, output=at)
        for rtol in (*LADDER, 1e-11)
    ]
    assert slope([np.abs(run.q - runs[-1].q).max() for run in runs[:-1]]) >= least


def test_sizes_of_a_scene_are_its_extent_and_how_fast_it_falls():
    model = double_plate()
    at_rest = State(0.0, *np.zeros((3, model.n)), np.zeros(model.m))
    assert typical_sizes(model, at_rest, 1.0) == pytest.approx([2.0, np.sqrt(2.0 * 9.81)])
    assert typical_sizes(model, at_rest, 1e-10)[1] == typical_sizes(model, at_rest, 1.0)[1], "however short the run is"
    model.gravity = (0.0, 0.0)
    assert typical_sizes(model, at_rest, 4.0) == pytest.approx([2.0, 0.5])
    moving = State(0.0, np.zeros(model.n), np.full(model.n, 3.0), np.zeros(model.n), np.zeros(model.m))
    assert typical_sizes(model, moving, 4.0) == pytest.approx([2.0, 3.0])


class Spring(pi.Model):
    """A mass of 2 kg on a spring of w = 10 rad/s."""

    n, m = 1, 0
    needs = pi.Needs(False, False, False, False)

    def mass(self, q):
        return np.array([[2.0]])

    def force(self, t, q, v):
        return 200.0 * q


@pytest.mark.parametrize(
    "q, v, a, expected",
    [(0.5, 0.0, -50.0, [0.5, 5.0]), (0.0, 3.0, 0.0, [0.3, 3.0]), (0.0, 0.0, 5.0, [0.05, 0.5]), (0.0, 0.0, 0.0, [1.0, 0.25])],
)
def test_sizes_of_a_model_of_ones_own_come_from_its_first_state(q, v, a, expected):
    state = State(0.0, *np.array([[q], [v], [a]]), np.zeros(0))
    assert typical_sizes(Spring(), state, 4.0) == pytest.approx(expected, rel=1e-6)


def test_the_summary_says_them_and_a_run_that_goes_on_keeps_them():
    run = pi.solve(Spring(), 0.5, pi.IDA(rtol=1e-4), q0=[0.5])
    assert "atol 5.0e-05 of q, 5.0e-04 of v" in run.summary()
    assert "atol" not in pi.solve(Spring(), 0.5, pi.IDA(atol=1e-6), q0=[0.5]).summary()
    again = pi.solve(Spring(), 0.6, pi.IDA(rtol=1e-4), state=run.state)
    assert again.state.memory["sizes"].tolist() == run.state.memory["sizes"].tolist()


@pytest.mark.parametrize("gap", [1e-15, 1e-13])
def test_round_off_of_a_start_at_zero_is_no_length(gap):
    class Rod(pi.Model):
        """A point on a rod, q its displacement from (1, 0), where phi is not zero to the last bit."""

        n, m = 2, 1

        def mass(self, q):
            return np.eye(2)

        def force(self, t, q, v):
            return np.array([0.0, 9.81])

        def phi(self, t, q):
            return np.array([((1 + q[0]) ** 2 + q[1] ** 2 - 1) / 2 + gap])

        def phi_q(self, t, q):
            return np.array([[1 + q[0], q[1]]])

    run = pi.solve(Rod(), 0.5, pi.IDA(rtol=1e-6))
    assert run.success, run.message
    assert 9.81 * run.q[-1, 1] + run.v[-1] @ run.v[-1] / 2 == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("integrator", [pi.GeneralizedAlpha(rtol=1e-5), pi.RadauIIA(rtol=1e-6, linear="kkt")], ids=["alpha", "radau"])
def test_a_rigid_body_is_as_exact_in_millimetres(integrator):
    """Its q holds places and a direction, its M masses and inertias."""
    tips, steps = [], []
    for length, mass in ((1.0, 2.0), (1000.0, 0.002)):
        scene = pi.Scene((0.0, -9.81 * length))
        body = scene.add(pi.RigidBody.bar(length, mass))
        scene.add(pi.Revolute(pi.ground, body.at("left")))
        run = pi.solve(scene.build(), 0.5, integrator)
        tips.append(run.position(body.at("right"))[-1] / length)
        steps.append(run.steps)
    assert steps[0] == pytest.approx(steps[1], rel=0.02)
    assert np.abs(tips[0] - tips[1]).max() < 1e-6
