"""The performance studies: their counts, what they compare, and how figures follow from rows. No times are judged."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from against_peers import peers
from gradient_over_run import measure as of_gradient
from polyida.integrate.ida.forms import System
from polyida.integrate.ida.integrator import IDA
from polyida.integrate.ida.newton import Correction
from polyida.integrate.state import Counts
from polyida.run.solve import solve
from skip import savings
from step_cost import measure

SMALL = 120


def script(name):
    """A script of studies/ as a module."""
    spec = importlib.util.spec_from_file_location(f"study_{name}", Path(__file__).parents[2] / "studies" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


against_peers, of_cost, of_skip, of_start = map(script, ("against_peers", "step_cost", "skip", "start"))


@pytest.fixture(scope="module")
def model():
    return measure.model_of("scene 1", SMALL)


@pytest.mark.parametrize("backend", measure.BACKENDS)
def test_every_back_end_solves_the_same_system(backend):
    try:
        row = measure.floor_row(SMALL, backend, 1)
    except peers.Missing as missing:
        pytest.skip(str(missing))
    assert row["relative_residual"] < (1e-3 if backend in ("fronts", "pardiso single") else 1e-10)


def test_the_rows_of_gradients_are_measured():
    row = of_gradient.ratio_row("scene 1", SMALL, "deviation", 0.01, 1)
    assert row["steps"] == 10 and row["factorizations"] >= 0 and row["solves"] >= 1 and row["ratio"] > 0
    error = of_gradient.error_row("scene 1", SMALL, "peak reaction", 1e-6, 0.01)
    assert max(error["stiffness_error"], error["mass_error"]) < 1e-4


def slope(residual, y, yp, along_y, along_yp):
    s = 1e-6
    return (residual(y + s * along_y, yp + s * along_yp) - residual(y - s * along_y, yp - s * along_yp)) / (2 * s)


def test_the_whole_jacobian_is_the_slope_of_the_residual(model):
    system, jacobian, cj = System(model, "ggl2", 0.0), peers.WholeJacobian(model), 30.0
    equations = Correction(system, Counts(), 5)
    random = np.random.default_rng(1)

    def residual(y, yp):
        res = np.empty(system.size)
        equations.F(0.0, y, yp, res)
        return res

    y, yp = 1e-3 * random.standard_normal((2, system.size))
    direction, values = random.standard_normal(system.size), np.empty(jacobian.pattern.nnz)
    jacobian(0.0, y, yp, None, cj, values)
    matrix = jacobian.pattern.copy()
    matrix.data[:] = values
    expected = slope(residual, y, yp, direction, cj * direction)
    assert np.abs(matrix @ direction - expected).max() < 1e-6 * np.abs(expected).max()
    assert matrix.indices.dtype == np.int32


@pytest.mark.parametrize("scene", measure.SCENES)
def test_both_jacobians_of_the_first_order_form_are_slopes(scene):
    first, random = peers.FirstOrder(measure.model_of(scene, SMALL)), np.random.default_rng(2)
    y, yp, direction = np.array([[1e-3], [1e-3], [1.0]]) * random.standard_normal((3, first.system.size))
    zero = np.zeros_like(y)
    for matrix, along in zip(first.jacobians(0.3, y, yp), ((direction, zero), (zero, direction))):
        expected = slope(lambda a, b: first.residual(0.3, a, b), y, yp, *along)
        assert np.abs(matrix @ direction - expected).max() < 1e-5 * np.abs(expected).max()


def test_the_sparse_solver_takes_the_same_steps(model):
    run = solve(model, 5e-3, IDA(rtol=1e-5))
    other = measure.run_isolated(measure.sparse_alone, {"dof": SMALL, "t_end": 5e-3}, 60.0)
    assert not other["error"] and abs(other["steps"] - run.counts.steps) <= 3


@pytest.mark.parametrize("solver", ["solve_dae", "exudyn", "exudyn modified"])
def test_peers_find_the_same_motion(model, solver):
    look, times = against_peers.tip_of(model), np.linspace(0.0, 0.02, 3)
    own = solve(model, times[-1], against_peers.GeneralizedAlpha(h=2e-4), output=times).position("tip")
    try:
        if solver == "solve_dae":
            _, seen = peers.radau(model, times, 1e-5, look)
        else:
            _, seen = peers.ExudynScene(model, look).run(times, 1e-3, solver != "exudyn")
    except peers.Missing as missing:
        pytest.skip(str(missing))
    assert np.abs(seen - own).max() < 2e-5


SAVED = {
    "co-rotated factor",
    "constant mass",
    "linear joints",
    "no motors: phi_t, bias",
    "no motors: reaction_q",
    "no damping: dg/dv",
    "no border",
    "stale matrix",
    "factor kept",
    "single precision",
    "shared operator",
    "no energies, no stresses",
    "no frames",
    "rest",
    "rest, residuals",
    "no frames: v",
    "no frames: a, lam",
}


@pytest.mark.parametrize("saving", savings.SAVINGS)
def test_a_saving_that_is_switched_off_is_counted(saving):
    row = savings.measure(saving, 6, 0.3 if saving == "co-rotated factor" else 0.01, 1)  # plates must turn until the factor is too old
    assert row["count_off"] > row["count_on"] if saving in SAVED else row["count_off"] >= row["count_on"] > 0
