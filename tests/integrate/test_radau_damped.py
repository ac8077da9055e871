"""Radau IIA on plates with damping: its order, C in its matrices, and what of the tangent is left out of them."""

from functools import cache

import numpy as np
import pytest

import polyida as pi
from polyida.integrate.start import consistent_acceleration

T_END = 0.4
ROUND_OFF = 1e-18  # tolerance of Newton, m: it ends at round-off
PARTS = ("q", "v", "lam")


@cache
def driven(angle, E=2e5, **damping):
    """A soft plate on a hinge with a motor that turns it by `angle`, rad, within 0.8 s, by a ramp of class C^4."""
    scene = pi.Scene(gravity=(0.0, 0.0))
    material = pi.Material(E=E, nu=0.3, rho=1100.0, **damping)
    plate = scene.add(pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=4, seed=1), material, thickness=0.01))
    scene.add(pi.Revolute(pi.ground, plate.section("left")))
    scene.add(pi.AngleMotor(pi.ground, plate.section("left"), angle=pi.profile.ramp(0.0, angle, 2 * T_END)))
    return scene.build()


def at_ten_times(model, number, **settings):
    """Each of PARTS at ten times of a run in so many steps."""
    run = pi.solve(model, T_END, pi.RadauIIA(h=T_END / number, **settings))
    assert run.success and run.counts.rejected == 0
    return [getattr(run, part)[number // 10 :: number // 10] for part in PARTS]


@cache
def finest(model):
    return at_ten_times(model, 1280, tolerance=ROUND_OFF)


def errors(model, number, **settings):
    return [np.abs(found - exact).max() for found, exact in zip(at_ten_times(model, number, **settings), finest(model))]


VISCOUS, DRAGGED = {"viscosity": 2e-3}, {"viscosity": 1e-3, "mass_damping": 5.0}


def test_an_explicit_method_of_order_8_says_the_same():
    """DOP853 of the reduced equations: the reference of what follows, and far below its errors."""
    from scipy.integrate import solve_ivp

    model = driven(1.0, **VISCOUS)
    n, start = model.n, pi.consistent_state(model)

    def rates(t, y):
        return np.concatenate([y[n:], consistent_acceleration(model, t, y[:n], y[n:])[0]])

    y = solve_ivp(rates, (0.0, T_END), np.concatenate([start.q, start.v]), method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    lam = consistent_acceleration(model, T_END, y[:n], y[n:])[1]
    for found, exact, known_to in zip(finest(model), (y[:n], y[n:], lam), (1e-13, 1e-12, 2e-11)):
        assert np.abs(found[-1] - exact).max() < known_to


@pytest.mark.parametrize("damping", [VISCOUS, DRAGGED], ids=str)
@pytest.mark.parametrize("settings, order", [({}, 5.0), ({"form": "index3"}, 5.0), ({"stages": 2}, 3.0)], ids=str)
def test_order_on_a_ramp(damping, settings, order):
    """In q, v and lam, where the motion of the mesh is resolved, above what the reference is known to."""
    coarse, fine = (errors(driven(1.0, **damping), number, tolerance=ROUND_OFF, **settings) for number in (80, 160))
    found = np.log2(np.divide(coarse, fine))
    assert found == pytest.approx(order, abs=0.3), found
    assert fine[0] > 2e-13 and fine[1] > 3e-12 and fine[2] > 2e-11


@pytest.mark.parametrize("linear", ["auto", "kkt"])
@pytest.mark.parametrize("damping", [{}, {"viscosity": 0.1}, {"mass_damping": 50.0}, {"viscosity": 1e-2, "mass_damping": 10.0}], ids=str)
def test_symmetric_damping_is_exact_in_the_matrices(damping, linear):
    """Small motions, which are linear, take one iteration a step, however strong the damping is, and one factor of each mode."""
    run = pi.solve(driven(1e-6, **damping), T_END, pi.RadauIIA(h=T_END / 40, linear=linear, tolerance=1e-16))
    assert run.success and run.counts.newton_iterations <= 46
    assert linear == "kkt" or run.counts.factorizations == 2


@pytest.mark.parametrize("viscosity", [1e-2, 0.1])
def test_what_is_not_symmetric_is_left_out_of_the_matrices_without_harm(viscosity):
    """Half a turn in 0.4 s: stresses turn as they relax, and K is not symmetric. The order in q stays, Newton hardly notices."""
    model, undamped = driven(6.0, E=2e6, viscosity=viscosity), driven(6.0, E=2e6)
    runs = [pi.solve(x, T_END, pi.RadauIIA(h=T_END / 40)) for x in (model, undamped)]
    assert runs[0].counts.newton_iterations <= runs[1].counts.newton_iterations and runs[0].counts.factorizations <= 8
    coarse, fine = (errors(model, number, tolerance=ROUND_OFF)[0] for number in (40, 160))
    assert np.log2(coarse / fine) / 2 == pytest.approx(5.0, abs=0.3)
    other = pi.solve(model, T_END, pi.GeneralizedAlpha(h=T_END / 400, extrapolate=True))
    assert np.abs(other.q[-1] - finest(model)[0][-1]).max() < 2e-8
