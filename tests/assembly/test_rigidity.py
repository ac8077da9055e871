"""Plates that may as well be rigid are told, and no others."""

import numpy as np
import pytest

import polyida as pi
from polyida.assembly.hints import deformation
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


@pytest.mark.parametrize("E", [50e6, 2e11])
def test_rubber_and_steel_are_not(E):
    """What steel deforms is little, but a run resolves it."""
    assert HINT not in fall(E).summary()


def test_the_tolerance_of_a_run_is_its_measure():
    """Steel deforms by less than a hundred thousandth: nothing for a run with errors of a thousandth, enough for one of a millionth."""
    loose, tight = (fall(2e11, pi.RadauIIA(rtol=rtol)) for rtol in (1e-3, 1e-6))
    assert HINT in loose.summary() and HINT not in tight.summary()


def test_a_run_that_has_hardly_begun_tells_nothing():
    assert HINT not in fall(50e6, t_end=1e-5, integrator=pi.GeneralizedAlpha(h=1e-6)).summary()


def test_models_of_ones_own_and_runs_without_frames_tell_nothing():
    from polyida.problems.pendulum import Pendulum

    assert HINT not in pi.solve(Pendulum(), 0.1, pi.GeneralizedAlpha(h=1e-2), q0=[1.0, 0.0]).summary()


def test_it_reads_a_few_frames_only(monkeypatch):
    from polyida.assembly import hints

    seen = []
    monkeypatch.setattr(hints, "deformation", lambda *given: seen.append(1) or deformation(*given))
    run = fall(5e15)
    assert HINT in run.summary() and len(run) == 51 and len(seen) == 2 * hints.LOOKS
