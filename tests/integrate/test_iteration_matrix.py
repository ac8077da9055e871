"""Iteration matrices and their condition numbers: slopes in h for each scaling, form and choice of unknowns."""

from dataclasses import replace

import numpy as np
import pytest

import polyida as pi
from conditioning import systems as conditioning
from polyida import condition_number
from polyida.errors import StepFailure
from polyida.integrate.ida.forms import FORMS, System
from polyida.integrate.ida.newton import Correction
from polyida.integrate.radau.tableau import radau
from polyida.linear.saddle import SCALINGS
from polyida.problems import plates
from polyida.study.conditions import iteration_matrix

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


def test_exact_is_the_ratio_of_singular_values(scene):
    model, state = scene
    matrix = iteration_matrix(model, pi.GeneralizedAlpha(h=1e-3), state, "physical")
    assert matrix.shape == (model.n + model.m, model.n + model.m)
    values = np.linalg.svd(matrix.toarray(), compute_uv=False)
    assert condition_number(model, pi.GeneralizedAlpha(h=1e-3), state) == pytest.approx(values[0] / values[-1], rel=1e-6)


@pytest.mark.parametrize("integrator, more", [(pi.GeneralizedAlpha(h=1e-3), {}), (pi.RadauIIA(h=1e-3), {"mode": "complex"})])
def test_the_estimate_is_that_of_the_1_norm(scene, integrator, more):
    model, state = scene
    matrix = iteration_matrix(model, integrator, state, "physical", **more).toarray()
    estimate = condition_number(model, integrator, state, exact=False, **more)
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
    (y, yp), equations = system.pack(state), Correction(system, pi.Counts(), 5, "kkt")
    equations.begin(state.t, y)

    def residual(s, direction):
        res = np.empty(system.size)
        equations.F(state.t, y + s * direction, yp + s * cj * direction, res)
        return res

    J = iteration_matrix(model, pi.IDA(form=form), state, "none", h=1 / cj)
    for seed in range(3):
        direction = np.random.default_rng(seed).standard_normal(system.size)
        difference = (residual(1e-6, direction) - residual(-1e-6, direction)) / 2e-6
        product = J @ direction
        for part in np.split(np.arange(system.size), [model.n, 2 * model.n]):
            assert np.abs(product[part] - difference[part]).max() < 1e-5 * np.abs(product[part]).max()


RADAU = [
    (pi.RadauIIA(h=0.02, stages=stages, form=form), mode)
    for stages, mode in ((3, "real"), (3, "complex"), (2, "complex"))
    for form in ("ggl", "index3")
]


@pytest.mark.parametrize("integrator, mode", RADAU, ids=lambda x: x if isinstance(x, str) else f"{x.form}-{x.stages}")
@pytest.mark.parametrize("given", ["scene", "pendulum", "damped"])
def test_radaus_matrix_is_the_derivative_of_its_equations(scene, integrator, mode, given):
    """With q' and v' that grow with q and v by c = l/h, a complex direction's parts one after the other."""
    model, state = {"scene": lambda: scene, "pendulum": pendulum_state, "damped": damped_state}[given]()
    n, m, tied = model.n, model.m, integrator.form == "ggl"
    values = np.linalg.eigvals(radau(integrator.stages).W)
    c = (values[values.imag > 1e-9] if mode == "complex" else values[np.abs(values.imag) < 1e-9].real)[0] / integrator.h
    lift = np.ones(n) if model.uniform_units else np.mean(model.mass(state.q).diagonal()) / model.mass(state.q).diagonal()

    def equations(dq, dv, da, dlam, dmu, rate):
        t, q, v, B = state.t, state.q + dq, state.v + dv, model.phi_q(state.t, state.q + dq)
        first = rate - dv + lift * (B.T @ dmu) if tied else rate - dv
        rows = [first, model.residual(t, q, v, state.a + da, state.lam + dlam), model.phi(t, q), model.phi_rate(t, q, v)]
        return np.concatenate(rows if tied else rows[:3])

    def along(*direction):
        return (equations(*(1e-6 * x for x in direction)) - equations(*(-1e-6 * x for x in direction))) / 2e-6

    J, random = iteration_matrix(model, integrator, state, "none", mode=mode), np.random.default_rng(0)
    for _ in range(3):
        dq, dv, dlam, dmu = (random.standard_normal(size) for size in (n, n, m, m))
        full = (dq, dv, c * dv, dlam, dmu, c * dq)
        difference = along(*map(np.real, full)) + 1j * along(*map(np.imag, full))
        product = J @ np.concatenate([dq, dv, dlam, dmu] if tied else [dq, dv, dlam])
        for part in np.split(np.arange(len(product)), [n, 2 * n, 2 * n + m]):
            assert np.abs(product[part] - difference[part]).max(initial=0) < 1e-5 * np.abs(product[part]).max(initial=1e-9)


def damped_state():
    """Plates whose C is not zero, on their way."""
    material = pi.Material(E=50e6, nu=0.3, rho=1100.0, viscosity=1e-3)
    model = plates.double_plate_motors(cells=4, material=material).build()
    return model, pi.solve(model, 0.05, pi.GeneralizedAlpha(h=5e-3)).state


FALLS = {  # of the double plate at its start: raw at h = 1e-1, 1e-6, scaled there, and the slope of the raw one in the limit
    ("index3", "real"): (3.6e10, 8.8e18, 1.3e5, 45, -3),
    ("index3", "complex"): (4.8e10, 1.1e19, 1.0e5, 45, -3),
    ("ggl", "real"): (3.5e10, 8.2e13, 1.3e5, 45, -2),
    ("ggl", "complex"): (4.7e10, 9.3e13, 1.0e5, 45, -2),
}


@pytest.mark.parametrize("form, mode", FALLS)
def test_radaus_matrices_fall_with_h_once_they_are_scaled(scenes, form, mode):
    model = plates.double_plate(cells=8).build()
    state, integrator, far = pi.consistent_state(model), pi.RadauIIA(form=form), 10.0 ** -np.arange(7.0, 10.0)

    def found(steps, scaling):
        return np.array([condition_number(model, integrator, state, scaling, h=h, mode=mode, exact=True) for h in steps])

    *published, slope = FALLS[form, mode]
    assert [*found((1e-1, 1e-6), "none"), *found((1e-1, 1e-6), "physical")] == pytest.approx(published, rel=0.03)
    assert scenes.slope(far, found(far, "none")) == pytest.approx(slope, abs=0.02)
    for scaling in ("physical", "bottasso"):
        assert scenes.slope(far, found(far, scaling)) == pytest.approx(0, abs=1e-3) and found(far, scaling).max() < 500


def test_a_radau_matrix_without_constraints():
    free = type("Free", (pi.Model,), {"n": 2, "m": 0, "mass": lambda self, q: np.eye(2), "force": lambda self, t, q, v: 4.0 * q})()
    state = pi.consistent_state(free, 0.0, [1.0, 0.0])
    for form in ("ggl", "index3"):
        c = radau(3).modes[0].value / 0.1
        expected = np.linalg.cond(np.kron([[c, -1.0], [4.0, c]], np.eye(2)))
        assert condition_number(free, pi.RadauIIA(h=0.1, form=form), state, "none") == pytest.approx(expected, rel=1e-6)


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


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("scaling, given", [("characteristic", "scene"), ("none", "pendulum")])
def test_the_whole_matrix_gives_the_run_of_the_border(scene, form, scaling, given):
    model, state = scene if given == "scene" else pendulum_state()
    border, whole = (
        pi.solve(model, 2e-3, pi.IDA(form=form, scaling=scaling, linear=linear, max_order=2), q0=state.q, v0=state.v)
        for linear in ("kkt", "whole")
    )
    assert whole.success and border.success
    if form != "index3":  # there round-off decides the steps if nothing is scaled
        assert (whole.counts.steps, whole.counts.rejected) == (border.counts.steps, border.counts.rejected)
    error = 1e-6 if form == "index3" else 1e-9
    assert np.abs(whole.q[-1] - border.q[-1]).max() < error and np.abs(whole.drift).max() < 1e-4
    assert whole.counts.factorizations > 0


@pytest.mark.parametrize("settings, scaling", list(zip([{}, {"form": "index3"}, {"stages": 2}], SCALINGS)), ids=str)
@pytest.mark.parametrize("given", ["scene", "pendulum"])
def test_radaus_whole_matrices_give_the_run_of_the_border(scene, settings, scaling, given):
    model, state = scene if given == "scene" else pendulum_state()
    integrator = pi.RadauIIA(h=1e-3, tolerance=1e-15, **settings)
    border, whole = (pi.solve(model, 0.02, x, state=state) for x in (integrator, replace(integrator, linear="kkt", scaling=scaling)))
    assert whole.success and whole.counts.steps == border.counts.steps == 20 and whole.counts.rejected == 0
    assert np.abs(whole.q - border.q).max() < 1e-11 and np.abs(whole.lam - border.lam).max() < 1e-6 * np.abs(border.lam).max()
    assert whole.counts.factorizations == (20 if model.needs.phi_q_varies or model.needs.driven else 1) * len(
        radau(integrator.stages).modes
    )


def test_a_whole_matrix_that_is_singular_ends_the_run():
    """A second constraint that depends on no coordinate."""

    class Loose(type(pi.problems.get("pendulum").model)):
        m = 2

        def phi(self, t, q):
            return np.array([q @ q - 1.0, 0.0])

        def phi_q(self, t, q):
            return np.array([2 * q, 0 * q])

    state = pi.State(0.0, np.array([0.6, -0.8]), np.zeros(2), np.zeros(2), np.zeros(2))
    with pytest.raises(StepFailure, match="singular"):
        next(pi.RadauIIA(h=1e-3, linear="kkt").steps(Loose(), state, 0.01, pi.Counts()))
