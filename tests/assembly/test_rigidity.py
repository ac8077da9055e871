"""Plates that may as well be rigid are told, and no others."""

import numpy as np
import pytest

import polyida as pi
from polyida.assembly.motion import deformation
from polyida.body.plate import Material
from polyida.problems import plates

HINT = "may as well be rigid"
POINTS = np.random.default_rng(3).uniform(-1.0, 1.0, (30, 2))


@pytest.mark.parametrize("angle", [0.0, 0.7, 3.0, 2.5 * np.pi])
def test_a_rigid_motion_deforms_nothing(angle):
    turned = POINTS @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]) + (3.0, -40.0)
    assert deformation(POINTS, turned - POINTS) < 1e-13


def test_a_stretch_is_measured():
    """Twice the length along x of points on a square: its corners leave the best rigid motion, which is none, by half a side."""
    square = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])
    assert deformation(square, square * (1.0, 0.0)) == pytest.approx(1.0)


def fall(E, integrator=None, t_end=0.1, **options):
    material = Material(E=E, nu=0.3, rho=1100.0)
    return pi.solve(plates.double_plate(cells=8, material=material).build(), t_end, integrator or pi.GeneralizedAlpha(h=2e-3), **options)


def test_stiff_plates_are_told_by_name():
    summary = fall(5e15).summary()
    assert f"'upper', 'lower' deform far less than the run resolves: such a plate {HINT}" in summary


def test_the_tolerance_of_a_run_is_its_measure():
    """Steel deforms by less than a hundred thousandth: nothing for a run with errors of a thousandth, enough for one of a millionth."""
    loose, tight = (fall(2e11, pi.RadauIIA(rtol=rtol)) for rtol in (1e-3, 1e-6))
    assert HINT in loose.summary() and HINT not in tight.summary()
