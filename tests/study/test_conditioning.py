"""Condition numbers: the matrices against differences of what they are the derivative of, the numbers against what is
known.
"""

import numpy as np
import pytest

from polyida.integrate.ida_forms import FORMS, System
from polyida.linear.kkt import assemble, scaling_factors
from polyida.study import conditioning, solve_error
from polyida.study.drawing import fitted

STEPS = 1e-6 * 10.0 ** -np.arange(4)


@pytest.fixture(scope="module")
def soft():
    return conditioning.state_of("soft", 4)


@pytest.mark.parametrize("form", FORMS)
def test_idas_matrix_is_the_derivative_of_its_residual(soft, form):
    model, state = soft
    system, cj = System(model, form, 10.0), 50.0
    y, yp = system.pack(state)

    def residual(s, direction):
        res = np.empty(system.size)
        system.residual(state.t, y + s * direction, yp + s * cj * direction, res)
        return res

    J = conditioning.ida_matrix(model, state, 1 / cj, form).raw
    for seed in range(3):
        direction = np.random.default_rng(seed).standard_normal(system.size)
        difference = (residual(1e-6, direction) - residual(-1e-6, direction)) / 2e-6
        product = J @ direction
        for part in np.split(np.arange(system.size), [model.n, 2 * model.n]):
            assert np.abs(product[part] - difference[part]).max() < 1e-5 * np.abs(product[part]).max()


def test_condition_is_that_of_singular_values_where_these_can_be_had(soft):
    model, state = soft
    made = conditioning.ida_matrix(model, state, 1e-2, "index1")
    assert made.condition() == pytest.approx(np.linalg.cond(made.raw), rel=1e-4)
    tangent, B, step_square = conditioning.alpha_blocks(model, state, 1e-2)
    matrix = assemble(tangent, B, scaling_factors("bottasso", step_square, tangent)).toarray()
    assert conditioning.alpha_condition(model, state, 1e-2, "q", "bottasso") == pytest.approx(
        np.linalg.cond(matrix), rel=1e-6
    )


@pytest.mark.parametrize("scaling, slope", conditioning.ALPHA_SCALINGS.items())
def test_slopes_of_the_scalings(soft, scaling, slope):
    model, state = soft
    values = [conditioning.alpha_condition(model, state, h, "q", scaling) for h in STEPS]
    assert fitted(STEPS, values) == pytest.approx(slope, abs=1e-3)


@pytest.mark.parametrize("unknown, slope", conditioning.ALPHA_UNKNOWNS.items())
def test_slopes_of_the_unknowns(soft, unknown, slope):
    values = [conditioning.alpha_condition(*soft, h, unknown) for h in STEPS]
    assert fitted(STEPS, values) == pytest.approx(slope, abs=1e-2)


@pytest.mark.parametrize("form, slope", conditioning.IDA_SLOPES.items())
def test_slopes_of_idas_forms_in_the_limit(soft, form, slope):
    model, state = soft
    steps = 1e-3 / conditioning.fastest(model, state) ** 2 * 10.0 ** -np.arange(3)
    made = [conditioning.ida_matrix(model, state, h, form) for h in steps]
    assert fitted(steps, [matrix.condition() for matrix in made]) == pytest.approx(slope, abs=0.02)
    assert fitted(steps, [np.linalg.cond(matrix.matrix) for matrix in made]) == pytest.approx(0, abs=1e-3)


def test_the_border_adds_little_once_it_is_scaled(soft):
    model, state = soft
    for h in (1e-1, 1e-3, 1e-6):
        scaled = conditioning.alpha_condition(model, state, h, "q", "physical")
        assert scaled < 10 * conditioning.inherent_condition(model, state, h)


def test_springs_of_any_stiffness_stay_well_conditioned():
    model, state = conditioning.state_of("springs", 0)
    assert max(conditioning.alpha_condition(model, state, h, "q", "physical") for h in 10.0 ** -np.arange(1, 10)) < 100


def test_scaling_restores_the_digits_of_weak_back_ends_only(soft):
    model, state = soft

    def error(backend, scaling):
        return max(solve_error.solve_errors(model, state, 1e-8, backend, scaling))

    assert (
        error("sparse LU, partial pivoting", "none")
        > 1e-4
        > 1e8 * error("sparse LU, partial pivoting", "physical") / 1e2
    )
    assert error("dense LU, partial pivoting", "none") < 1e-11
    assert max(error(backend, "physical") for backend in solve_error.BACKENDS) < 1e-3
