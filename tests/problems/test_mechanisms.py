"""Mechanisms of plates at three levels: exact kinematics of rigid ones, flexible ones near to them, energy, digits."""

from functools import lru_cache

import numpy as np
import pytest

import polyida as pi
from polyida import problems
from polyida.problems import mechanisms

NAMES = ("slider-crank", "four-bar", "two-link-arm", "peaucellier")


@lru_cache
def problem(name, level):
    return problems.get(name, level=level)


@lru_cache
def solved(name, level):
    """(problem, its run)."""
    p = problem(name, level)
    run = pi.solve(p.model, p.t_end, pi.RadauIIA(rtol=1e-8))
    assert run.success, run.message
    return p, run


def complex_path(run, name):
    return run.position(name) @ (1, 1j)


def four_bar_positions(angle):
    """(crank pin, rocker pin), complex, m, of rigid links with the crank at an angle, rad: Freudenstein's equation."""
    crank_length, coupler, rocker, frame = mechanisms.FOUR_BAR
    crank = crank_length * np.exp(1j * np.asarray(angle, float))
    across = frame - crank
    along = (abs(across) ** 2 + coupler**2 - rocker**2) / (2 * abs(across))
    return crank, crank + (along + 1j * np.sqrt(coupler**2 - along**2)) * across / abs(across)


def rigid_paths(name, t):
    """{named point: its path, complex, m} of rigid links, from the motors' profiles."""

    def turned(profile):
        return np.array([profile(time) for time in t])

    if name == "four-bar":
        return dict(zip(("crank pin", "pin"), four_bar_positions(mechanisms.FOUR_BAR_START + turned(mechanisms.FOUR_BAR_TURN))))
    if name == "peaucellier":
        pin, upper, _, pen = mechanisms.peaucellier_positions(mechanisms.INVERSOR_START + turned(mechanisms.INVERSOR_TURN))
        return {"upper crank pin": pin, "upper inner pin": upper, "pen": pen}
    shoulder, elbow = (turned(mechanisms.ARM_TURNS[joint]) for joint in ("shoulder", "elbow"))
    first = mechanisms.ARM_LENGTH * np.exp(1j * shoulder)
    return {"elbow": first, "tip": first + mechanisms.ARM_LENGTH * np.exp(1j * (shoulder + elbow))}


@pytest.mark.parametrize("name", NAMES[1:])
def test_rigid_links_follow_their_motors_exactly(name):
    _, run = solved(name, "rigid")
    for point, path in rigid_paths(name, run.t).items():
        assert np.abs(complex_path(run, point) - path).max() < 1e-12, point


@pytest.mark.parametrize(("level", "near"), [("rigid", 1e-13), ("reduced", 1e-3), ("full", 1e-3)])
def test_a_slider_is_where_its_crank_says(level, near):
    """`x = r cos a + sqrt(l^2 - r^2 sin(a)^2)`, to within what bending takes from the distance of the rod's ends."""
    _, run = solved("slider-crank", level)
    pin, slider = complex_path(run, "crank pin"), complex_path(run, "slider")
    assert np.abs(slider.imag).max() < 1e-13
    assert np.abs(slider.real - pin.real - np.sqrt(mechanisms.ROD**2 - pin.imag**2)).max() < near
    assert np.abs(abs(pin) - mechanisms.CRANK).max() < near


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("level", ["full", "reduced", "rigid"])
def test_a_run_of_moderate_accuracy_meets_the_digits(name, level):
    p, run = solved(name, level)
    errors = p.compare(run)
    assert errors["point"] < 1e-6 and errors["velocity"] < 3e-4, errors


def test_a_four_bar_is_drawn_by_hand_and_closes():
    scene = mechanisms.four_bar("rigid")
    state = pi.consistent_state(scene.build())
    assert np.abs(state.q).max() < 1e-12
    pin, rocker = four_bar_positions(np.pi / 3)
    assert abs(scene.build().attachment("crank pin").point @ (1, 1j) - pin) < 1e-12
    assert abs(scene.build().attachment("rocker pin").point @ (1, 1j) - rocker) < 1e-12


def test_freudensteins_equation_holds():
    """`R1 cos(rocker) - R2 cos(crank) + R3 = cos(crank - rocker)` of the angles, R1 = d/a, R2 = d/c, R3 = (a^2 - b^2 + c^2 + d^2)/(2 a c)."""
    a, b, c, d = mechanisms.FOUR_BAR
    angle = np.linspace(0.0, 2 * np.pi, 50)
    pin, rocker = four_bar_positions(angle)
    psi = np.angle(rocker - d)
    assert np.allclose(d / a * np.cos(psi) - d / c * np.cos(angle) + (a * a - b * b + c * c + d * d) / (2 * a * c), np.cos(angle - psi))
    assert np.allclose(np.abs(rocker - pin), b)


def test_other_options_have_no_digits():
    p = problems.get("slider-crank", level="reduced", modes=2)
    assert p.reference == p.known_to == {} and "no reference for these options" in p.source
