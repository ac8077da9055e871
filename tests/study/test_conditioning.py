"""Condition numbers against what is known of them, and what they do to linear solves."""

import numpy as np
import pytest

from conditioning import solve_error
from conditioning import systems as conditioning
from polyida.linear.saddle import assemble, scaling_size
from polyida.study.rows import fit_slope

STEPS = 1e-6 * 10.0 ** -np.arange(4)


@pytest.fixture(scope="module")
def soft():
    return conditioning.state_of("soft", 4)


def test_condition_is_that_of_singular_values_where_these_can_be_had(soft):
    model, state = soft
    tangent, B, step_square = conditioning.alpha_blocks(model, state, 1e-2)
    matrix = assemble(tangent, B, scaling_size("bottasso", step_square, tangent)).toarray()
    assert conditioning.alpha_condition(model, state, 1e-2, "q", "bottasso") == pytest.approx(np.linalg.cond(matrix), rel=1e-6)


@pytest.mark.parametrize("scaling, slope", conditioning.ALPHA_SCALINGS.items())
def test_slopes_of_the_scalings(soft, scaling, slope):
    model, state = soft
    values = [conditioning.alpha_condition(model, state, h, "q", scaling) for h in STEPS]
    assert fit_slope(STEPS, values) == pytest.approx(slope, abs=1e-3)


@pytest.mark.parametrize("unknown, slope", conditioning.ALPHA_UNKNOWNS.items())
def test_slopes_of_the_unknowns(soft, unknown, slope):
    values = [conditioning.alpha_condition(*soft, h, unknown) for h in STEPS]
    assert fit_slope(STEPS, values) == pytest.approx(slope, abs=1e-2)


@pytest.mark.parametrize("mode", ["real", "complex"])
@pytest.mark.parametrize("form, slope", conditioning.RADAU_SLOPES.items())
def test_slopes_of_radaus_forms(soft, form, slope, mode):
    far = 1e-3 / conditioning.fastest(*soft) ** 2 * 10.0 ** -np.arange(3)
    raw, flat = ([conditioning.radau_condition(*soft, h, form, mode, scaling) for h in far] for scaling in ("none", "physical"))
    assert fit_slope(far, raw) == pytest.approx(slope, abs=0.02) and fit_slope(far, flat) == pytest.approx(0, abs=1e-3)


def test_scaling_restores_the_digits_of_weak_back_ends_only(soft):
    model, state = soft

    def error(backend, scaling):
        return max(solve_error.alpha_errors(model, state, 1e-8, backend, scaling))

    assert error("sparse LU, partial pivoting", "none") > 1e-4 > 1e8 * error("sparse LU, partial pivoting", "physical") / 1e2
    assert error("dense LU, partial pivoting", "none") < 1e-11
    assert max(error(backend, "physical") for backend in solve_error.BACKENDS) < 1e-3


def test_what_scaling_does_for_idas_whole_matrix(soft):
    model, state = soft

    def error(backend, scaling):
        return max(solve_error.ida_errors(model, state, 1e-8, "ggl2", backend, scaling))

    assert error("sparse LU, partial pivoting", "none") > 1e-6
    assert all(error(backend, "characteristic") < 1e-9 for backend in solve_error.WHOLE)
