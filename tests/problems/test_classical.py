"""The classical problems: their equations against differences and against their references."""

import numpy as np
import pytest

from polyida import check_derivatives, problems
from polyida.errors import InputError
from polyida.integrate.ida.integrator import IDA
from polyida.integrate.start import consistent_acceleration, consistent_state
from polyida.run.solve import solve

CLASSICAL = ("pendulum", "car-axis", "andrews")


@pytest.mark.parametrize("name", CLASSICAL)
def test_derivatives_are_right(name):
    errors = check_derivatives(problems.get(name).model, t=0.3)
    assert max(errors.values()) < 5e-9, errors


@pytest.mark.parametrize("name", CLASSICAL)
def test_the_start_is_consistent(name):
    p = problems.get(name)
    state = consistent_state(p.model, 0.0, p.q0, p.v0)
    assert np.allclose(state.q, p.q0, rtol=0, atol=1e-15) and np.allclose(state.v, p.v0, rtol=0, atol=1e-15)


@pytest.mark.parametrize("name", CLASSICAL)
def test_the_reference_meets_both_constraints(name):
    p = problems.get(name)
    q, v = p.reference["q"], p.reference["v"]
    assert np.abs(p.model.phi(p.t_end, q)).max() < 1e-12
    rate = p.model.phi_q(p.t_end, q) @ v + p.model.phi_t(p.t_end, q)
    assert np.abs(rate).max() < 1e-11 * max(1.0, np.abs(v).max())


@pytest.mark.parametrize("name", CLASSICAL)
def test_reference_multipliers_follow_from_the_reference_state(name):
    p = problems.get(name)
    a, lam = consistent_acceleration(p.model, p.t_end, p.reference["q"], p.reference["v"])
    found = {"a": a, "lam": lam}
    assert all(error < p.known_to[part] for part, error in p.errors(**{part: found[part] for part in found if part in p.reference}).items())


@pytest.mark.parametrize("name", ["pendulum", "andrews"])
def test_energy_at_the_reference_is_that_of_the_start(name):
    p = problems.get(name)
    q, v = p.reference["q"], p.reference["v"]
    kinetic = v @ p.model.mass(q) @ v / 2
    assert kinetic + p.model.potential(q) == pytest.approx(p.model.potential(p.q0), abs=1e-9 * kinetic)


def test_forces_are_the_slope_of_the_potential():
    p = problems.get("andrews")
    q, step = p.q0 + 0.1, 1e-6
    slope = [(p.model.potential(q + e) - p.model.potential(q - e)) / (2 * step) for e in step * np.eye(7)]
    assert np.allclose(p.model.force(0.0, q, np.zeros(7)), slope, atol=1e-7)


def test_andrews_starts_with_the_published_acceleration():
    p = problems.get("andrews")
    state = consistent_state(p.model, 0.0, p.q0, p.v0)
    assert state.a[:2] == pytest.approx([14222.443919954114, -10666.832939965585], rel=1e-9)
    assert state.lam[:2] == pytest.approx([98.56687039624109, -6.122688344255662], rel=1e-9)


def test_problems_have_a_reference_a_source_and_a_quantity_with_units():
    for name in problems.names():
        p = problems.get(name)
        assert p.name == name and p.source and " in " in p.quantity
        assert p.reference and set(p.known_to) == set(p.reference)
        assert name not in CLASSICAL or p.model.n == p.q0.size == p.v0.size


@pytest.mark.parametrize("name", CLASSICAL)
def test_a_fine_run_comes_as_near_as_the_reference_is_known(name):
    p = problems.get(name)
    run = solve(p.model, p.t_end, IDA(rtol=1e-9, atol=1e-11), q0=p.q0, v0=p.v0, every=10**9)
    for part, error in p.compare(run).items():
        assert error < 1e-5 * np.abs(p.reference[part]).max() and p.known_to[part] < error


def test_unknown_name_lists_the_known_ones():
    with pytest.raises(InputError, match="'trebuchet' is unknown; there are pendulum, car-axis, andrews"):
        problems.get("trebuchet")
    assert set(CLASSICAL) <= set(problems.names())
