"""The wheelset of the IVP test set against its published start and end."""

from dataclasses import replace

import numpy as np
import pytest

import polyida as pi
from polyida.problems import wheelset

PUBLISHED = np.array(
    [-1.975258894011285, -1.0898297102811276e-3, 7.8855083626142589e-2, -5.533362821731549, -0.3487021489546511, -2.132968724380927]
)
RADAU = pi.RadauIIA(h=10.0 / 32000)


def digits(problem, run):
    """-log10 of the largest error over 1 + |y| of places, speeds and contacts."""
    errors = [np.abs(problem.measures[name](run) - y) / (1.0 + np.abs(y)) for name, y in problem.reference.items() if name != "normal"]
    return -np.log10(np.concatenate(errors).max())


def test_published_start():
    q, v, lam = wheelset.Q0, np.zeros(10), np.array([83.593, 74.144, 0.0, 0.0, 0.0, 0.0])
    model = wheelset.Wheelset()
    assert np.abs(model.residual(0.0, q, v, np.append(PUBLISHED, np.zeros(4)), lam)).max() < 1e-12
    state = pi.consistent_state(model, q0=q)
    assert state.lam == pytest.approx(lam, abs=2e-3) and state.a[:6] == pytest.approx(PUBLISHED, abs=2e-3)
    assert np.abs(model.residual(0.0, q, v, state.a, state.lam)).max() < 1e-10


def test_derivatives():
    q = wheelset.Q0 + 1e-2 * np.random.default_rng(0).standard_normal(10)
    assert pi.check_derivatives(wheelset.Wheelset(), q=q)["phi_q"] < 1e-6


def test_published_end():
    problem = pi.problems.get("wheelset")
    run = pi.solve(problem.model, problem.t_end, RADAU, q0=problem.q0, v0=problem.v0, every=1000)
    assert digits(problem, run) >= 6.4 and problem.compare(run)["normal"] < 10.0**-3.9


@pytest.mark.parametrize("integrator, least", [(pi.IDA(rtol=1e-9), 6.8), (pi.GeneralizedAlpha(h=5e-4), 4.0)])
def test_motion_that_comes_to_the_published_end(integrator, least):
    problem = pi.problems.get("wheelset")
    exact, run = (pi.solve(problem.model, 0.5, one, q0=problem.q0, v0=problem.v0, every=1000) for one in (RADAU, integrator))
    moved = replace(problem, t_end=0.5, reference={name: measure(exact) for name, measure in problem.measures.items()})
    assert digits(moved, run) >= least and moved.compare(run)["normal"] < 10.0 ** (2.5 - least)
