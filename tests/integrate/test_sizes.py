"""Absolute tolerances follow the model's own length and speed: the error follows rtol, in metres and in millimetres."""

import numpy as np
import pytest

import polyida as pi
from polyida.study.families import explicit

LADDER = np.array([1e-3, 1e-4, 1e-5, 1e-6, 1e-7])


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


class Spring(pi.Model):
    """A mass of 2 kg on a spring of w = 10 rad/s."""

    n, m = 1, 0
    needs = pi.Needs(False, False, False, False)

    def mass(self, q):
        return np.array([[2.0]])

    def force(self, t, q, v):
        return 200.0 * q


def test_the_summary_says_them_and_a_run_that_goes_on_keeps_them():
    run = pi.solve(Spring(), 0.5, pi.IDA(rtol=1e-4), q0=[0.5])
    assert "atol 5.0e-05 of q, 5.0e-04 of v" in run.summary()
    assert "atol" not in pi.solve(Spring(), 0.5, pi.IDA(atol=1e-6), q0=[0.5]).summary()
    again = pi.solve(Spring(), 0.6, pi.IDA(rtol=1e-4), state=run.state)
    assert again.state.memory["sizes"].tolist() == run.state.memory["sizes"].tolist()
