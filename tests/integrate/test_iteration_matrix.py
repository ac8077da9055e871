"""Iteration matrices and their condition numbers: slopes in h for each scaling, form and choice of unknowns."""

import numpy as np
import pytest

import polyida as pi
from polyida import condition_number
from polyida.integrate.ida.forms import FORMS, System
from polyida.integrate.iteration_matrix import iteration_matrix
from polyida.problems import plates
from polyida.study.kinds import conditioning

SMALL = 10.0 ** -np.arange(5.0, 10.0)


@pytest.fixture(scope="module")
def scene():
    model = plates.double_plate_motors(cells=12).build()
    return model, pi.consistent_state(model)


def at(scene, steps, *choice, **more):
    return np.array([condition_number(scene[0], pi.GeneralizedAlpha(h=h), scene[1], *choice, **more) for h in steps])


@pytest.mark.parametrize("unknown, slope", [("q", -4.0), ("v", -3.0), ("a", -2.0)])
@pytest.mark.parametrize("exact", [True, False])
def test_slopes_without_scaling(scenes, scene, unknown, slope, exact):
    found = at(scene, SMALL, "none", unknown, exact=exact)
    assert scenes.slope(SMALL, found) == pytest.approx(slope, abs=0.1)


@pytest.mark.parametrize("scaling", ["bottasso", "physical"])
def test_flat_with_scaling(scenes, scene, scaling):
    found = at(scene, SMALL, scaling)
    assert scenes.slope(SMALL, found) == pytest.approx(0.0, abs=0.05) and found.max() < 1e5
    assert (at(scene, 10.0 ** -np.arange(3.0, 10.0), "physical") < 1e4).all()


def test_masses_far_from_1_kg_need_the_physical_scaling(scene):
    """Nodes of some grams: beta h^2 alone leaves them beside constraints of size 1."""
    assert (at(scene, SMALL, "physical") < 0.1 * at(scene, SMALL, "bottasso")).all()


def test_the_integrator_s_scaling_is_the_default(scene):
    model, state = scene
    alpha = pi.GeneralizedAlpha(h=1e-3, scaling="bottasso")
    assert condition_number(model, alpha, state) == condition_number(model, alpha, state, "bottasso")


def test_exact_is_the_ratio_of_singular_values(scene):
    model, state = scene
    matrix = iteration_matrix(model, pi.GeneralizedAlpha(h=1e-3), state, "physical")
    assert matrix.shape == (model.n + model.m, model.n + model.m)
    values = np.linalg.svd(matrix.toarray(), compute_uv=False)
    assert condition_number(model, pi.GeneralizedAlpha(h=1e-3), state) == pytest.approx(values[0] / values[-1], rel=1e-6)


def test_the_estimate_is_that_of_the_1_norm(scene):
    model, state = scene
    matrix = iteration_matrix(model, pi.GeneralizedAlpha(h=1e-3), state, "physical").toarray()
    estimate = condition_number(model, pi.GeneralizedAlpha(h=1e-3), state, exact=False)
    assert 0.1 * np.linalg.cond(matrix, 1) < estimate < 1.001 * np.linalg.cond(matrix, 1)


@pytest.mark.parametrize("exact", [True, False])
def test_a_user_s_model_and_a_singular_matrix(exact):
    model = pi.problems.get("pendulum").model
    state = pi.consistent_state(model, 0.0, [-1.0, 0.0])
    assert 1 < condition_number(model, pi.GeneralizedAlpha(h=1e-3), state, exact=exact) < 1e4
    twice = type(
        "Twice",
        (type(model),),
        {"m": 2, "phi_q": lambda self, t, q: np.tile(2 * q, (2, 1)), "phi": lambda self, t, q: np.full(2, q @ q - 1)},
    )
    bad = twice()
    state = type(state)(0.0, state.q, state.v, state.a, np.zeros(2))
    assert condition_number(bad, pi.GeneralizedAlpha(h=1e-3), state, exact=exact) > 1e14


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("given", ["scene", "pendulum"])
def test_idas_matrix_is_the_derivative_of_its_residual(form, given):
    model, state = conditioning.state_of("soft", 4) if given == "scene" else pendulum_state()
    system, cj = System(model, form, 10.0), 50.0
    y, yp = system.pack(state)

    def residual(s, direction):
        res = np.empty(system.size)
        system.residual(state.t, y + s * direction, yp + s * cj * direction, res)
        return res

    J = iteration_matrix(model, pi.IDA(form=form), state, "none", h=1 / cj)
    for seed in range(3):
        direction = np.random.default_rng(seed).standard_normal(system.size)
        difference = (residual(1e-6, direction) - residual(-1e-6, direction)) / 2e-6
        product = J @ direction
        for part in np.split(np.arange(system.size), [model.n, 2 * model.n]):
            assert np.abs(product[part] - difference[part]).max() < 1e-5 * np.abs(product[part]).max()


def pendulum_state():
    model = pi.problems.get("pendulum").model
    return model, pi.consistent_state(model, 0.0, [0.6, -0.8], [0.8, 0.6])


@pytest.mark.parametrize("form, slope", conditioning.IDA_SLOPES.items())
def test_idas_forms_in_the_limit(scenes, scene, form, slope):
    steps = 1e-3 / conditioning.fastest(*scene) ** 2 * 10.0 ** -np.arange(3)
    raw, flat = (
        [condition_number(scene[0], pi.IDA(form=form), scene[1], scaling, h=h, exact=True) for h in steps]
        for scaling in ("none", "characteristic")
    )
    assert scenes.slope(steps, raw) == pytest.approx(slope, abs=0.02)
    assert scenes.slope(steps, flat) == pytest.approx(0, abs=1e-3) and max(flat) < 1e3


def test_far_beyond_what_singular_values_tell(scene):
    """It grows by 1e4 for a tenth of h also past 1e30."""
    raw = at(scene, SMALL[-2:], "none", exact=True)
    assert raw[1] > 1e30 and raw[1] / raw[0] == pytest.approx(1e4, rel=1e-2)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("scaling", ["characteristic", "none"])
@pytest.mark.parametrize("given", ["scene", "pendulum"])
def test_the_whole_matrix_gives_the_run_of_the_border(scene, form, scaling, given):
    model, state = scene if given == "scene" else pendulum_state()
    border, whole = (
        pi.solve(model, 2e-3, pi.IDA(form=form, scaling=scaling, linear=linear, max_order=2), q0=state.q, v0=state.v)
        for linear in ("kkt", "whole")
    )
    assert whole.success and (whole.counts.steps, whole.counts.rejected) == (border.counts.steps, border.counts.rejected)
    assert np.abs(whole.q - border.q).max() < 1e-9 and np.abs(whole.drift).max() < 1e-4
    assert whole.counts.factorizations > 0


def test_a_sparse_mass_beside_dense_differences():
    """A model of one's own may mix them."""
    from scipy.sparse import csc_array

    pendulum = pi.problems.get("pendulum").model
    mixed = type("Mixed", (type(pendulum),), {"mass": lambda self, q: csc_array(np.eye(2)), "force_q": pi.Model.force_q})()
    one, other = (pi.solve(model, 0.1, pi.IDA(linear="whole"), q0=[0.6, -0.8]) for model in (pendulum, mixed))
    assert other.success and np.abs(one.q[-1] - other.q[-1]).max() < 1e-9


def test_what_there_is_not(scene):
    alpha, ida = pi.GeneralizedAlpha(h=1e-3), pi.IDA()
    for integrator, choice, more in (
        (alpha, ("best",), {}),
        (alpha, ("none", "p"), {}),
        (ida, ("bottasso",), {"h": 1e-3}),
        (ida, ("none", "v"), {"h": 1e-3}),
        (ida, ("none",), {"h": -1}),
    ):
        with pytest.raises(pi.InputError, match=str(more.get("h") if choice == ("none",) else choice[-1])):
            condition_number(scene[0], integrator, scene[1], *choice, **more)
    with pytest.raises(pi.InputError, match="h = None must be a positive step"):
        condition_number(scene[0], ida, scene[1])
    with pytest.raises(pi.InputError, match="must be GeneralizedAlpha or IDA"):
        condition_number(scene[0], pi.EnergyMomentum(h=1e-3), scene[1])
    for setting in ({"scaling": "physical"}, {"linear": "sparse"}):
        with pytest.raises(pi.InputError, match=f"{next(iter(setting))}.*must be one of"):
            pi.IDA(**setting)
