"""Densities to stiffness and mass: ends, slopes against differences, and what is refused."""

import numpy as np
import pytest

import polyida as pi

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


def test_the_formulas():
    assert pi.design.ramp(RHO, q=20, void=1e-3)[0] == pytest.approx(1e-3 + (1 - 1e-3) * RHO / (21 - 20 * RHO), rel=1e-14)
    assert pi.design.simp(RHO, p=3, void=1e-9)[0] == pytest.approx(1e-9 + (1 - 1e-9) * RHO**3, rel=1e-14)
