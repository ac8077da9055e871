"""Densities to stiffness and mass: ends, slopes against differences, and what is refused."""

import numpy as np
import pytest

import polyida as pi
from polyida.errors import InputError

RHO = np.linspace(0.01, 0.99, 50)
FUNCTIONS = {
    "ramp": pi.design.ramp,
    "simp": pi.design.simp,
    "mass": pi.design.mass,
    "mass, low": lambda rho: pi.design.mass(rho, low=0.1),
    "project": lambda rho: pi.design.project(rho, 8.0, eta=0.4),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_slopes_are_those_of_the_values(name):
    step = 1e-5
    value, slope = FUNCTIONS[name](RHO)
    found = (FUNCTIONS[name](RHO + step)[0] - FUNCTIONS[name](RHO - step)[0]) / (2 * step)
    assert np.allclose(slope, found, rtol=1e-6, atol=1e-8) and (np.diff(value) > 0).all() and (slope > 0).all()


@pytest.mark.parametrize("name", FUNCTIONS)
def test_what_is_solid_is_whole(name):
    value, _ = FUNCTIONS[name]([0.0, 1.0])
    assert value == pytest.approx([0.0 if name == "project" else 1e-3, 1.0], abs=1e-15)


def test_the_formulas():
    assert pi.design.ramp(RHO, q=20, void=1e-3)[0] == pytest.approx(1e-3 + (1 - 1e-3) * RHO / (21 - 20 * RHO), rel=1e-14)
    assert pi.design.simp(RHO, p=3, void=1e-9)[0] == pytest.approx(1e-9 + (1 - 1e-9) * RHO**3, rel=1e-14)


def test_light_mass_falls_faster_than_stiffness():
    rho = np.array([1e-3, 5e-3, 1e-2])
    light, _ = pi.design.mass(rho, low=0.1, void=1e-9)
    assert light == pytest.approx(6 * rho**6 / 0.1**5 - 5 * rho**7 / 0.1**6 + 1e-9, rel=1e-6)
    assert (light < pi.design.simp(rho, void=1e-9)[0]).all() and (pi.design.mass(rho, void=1e-9)[0] > light).all()
    assert pi.design.mass(0.1, low=0.1) == pytest.approx(pi.design.mass(0.1))


def test_a_hard_projection_is_a_step():
    value, _ = pi.design.project([0.0, 0.45, 0.5, 0.55, 1.0], beta=200.0)
    assert value == pytest.approx([0.0, 0.0, 0.5, 1.0, 1.0], abs=1e-8)


def test_round_off_of_a_filter_is_taken():
    assert pi.design.ramp([-1e-17, 1.0 + 1e-15])[0] == pytest.approx([1e-3, 1.0])


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: pi.design.ramp([0.5, 1.2]), "ramp: densities rho are 0.5 to 1.2"),
        (lambda: pi.design.simp(["a"]), "simp: densities rho are"),
        (lambda: pi.design.ramp(RHO, q=-1), "ramp: q = -1"),
        (lambda: pi.design.ramp(RHO, void=0), "ramp: void = 0 must be between 0 and 1"),
        (lambda: pi.design.simp(RHO, p=0.5), "simp: p = 0.5"),
        (lambda: pi.design.mass(RHO, low=1.0), "mass: low = 1.0"),
        (lambda: pi.design.project(RHO, beta=0.0), "project: beta = 0.0"),
        (lambda: pi.design.project(RHO, beta=2.0, eta=1.0), "project: eta = 1.0"),
    ],
)
def test_wrong_numbers_are_named(call, message):
    with pytest.raises(InputError, match=message):
        call()
