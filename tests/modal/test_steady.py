"""Steady rotation: equilibria and modes in the frame that turns, against closed forms, an independent beam and a run in time."""

import numpy as np
import pytest

import polyida as pi
from polyida.problems import literature


def hub(scene, centre, points):
    """A rigid hub on a motor at its centre."""
    body = scene.add(pi.RigidBody(3.0, 0.2, {"c": (0.0, 0.0), **points}, origin=centre, name="hub"))
    scene.add(pi.Revolute(pi.ground.at(centre), body.at("c"), name="bearing"))
    scene.add(pi.AngleMotor(pi.ground.at(centre), body.at("c"), pi.profile.polynomial([0.0, 5.0]), name="motor"))
    return body


def swung(centre=(0.0, 0.0), k=400.0, mass=2.0, gravity=0.0):
    """A block on a radial rail of a hub, on a spring of 1 m."""
    scene = pi.Scene(gravity=(0.0, -gravity))
    block = pi.RigidBody(mass, 0.1, {"c": (0.0, 0.0)}, origin=(centre[0] + 1.0, centre[1]), name="block")
    arm = hub(scene, centre, {})
    scene.add(block)
    scene.add(pi.Prismatic(arm.at("c"), block.at("c"), name="rail"))
    scene.add(pi.SpringDamper(arm.at("c"), block.at("c"), k, 0.0, name="spring"))
    return scene.build()


@pytest.mark.parametrize("centre", [(0.0, 0.0), (0.3, -0.2)])
def test_a_rigid_body_on_a_spring(centre):
    """`k (r - l) = m w^2 r` and `omega^2 = k/m - w^2`."""
    k, mass, spin = 400.0, 2.0, 5.0
    found = pi.steady(swung(centre), spin=spin, about=centre)
    assert found.q.reshape(-1, 2)[2, 0] == pytest.approx(k / (k - mass * spin**2) - 1.0, rel=1e-8)
    modes = pi.modes(found)
    assert modes.frequencies == pytest.approx([np.sqrt(k / mass - spin**2) / (2.0 * np.pi)], rel=1e-8)


def test_a_body_between_four_springs_feels_coriolis_forces():
    """Stiffness 2 k in both directions: `omega = sqrt(2 k / m) -+ w`; that of the torsion spring is `sqrt(c / J)`."""
    k, mass, spin = 400.0, 2.0, 5.0
    scene = pi.Scene()
    places = {"e": (1.0, 0.0), "n": (0.0, 1.0), "w": (-1.0, 0.0), "s": (0.0, -1.0)}
    frame = hub(scene, (0.0, 0.0), places)
    disc = scene.add(pi.RigidBody(mass, 0.1, {"c": (0.0, 0.0)}, name="disc"))
    scene.add(pi.TorsionSpring(frame.at("c"), disc.at("c"), 1000.0, 0.0, name="twist"))
    for name in places:
        scene.add(pi.SpringDamper(frame.at(name), disc.at("c"), k, 0.0))
    root = np.sqrt(2.0 * k / mass)
    found = pi.modes(pi.steady(scene.build(), spin=spin)).frequencies * 2.0 * np.pi
    assert found == pytest.approx([root - spin, root + spin, 100.0], rel=1e-8)


def test_the_steady_state_turns_in_a_run():
    model, spin = swung(), 5.0
    found = pi.steady(model, spin=spin)
    run = pi.solve(model, 0.5, pi.RadauIIA(rtol=1e-9), q0=found.q, v0=found.v)
    place = (1.0 + found.q.reshape(-1, 2)[2, 0]) * np.array([np.cos(0.5 * spin), np.sin(0.5 * spin)])
    assert run.q[-1].reshape(-1, 2)[2] + [1.0, 0.0] == pytest.approx(place, abs=1e-7)


def lead_lag(spin, length, bending, density, count, terms=8):
    """Frequencies, Hz, in the plane of a clamped uniform beam that turns about its clamp, by Ritz' method with polynomials.

    `(EI w'')'' - (N w')' + rho A (w_tt - spin^2 w) = 0`, N = rho A spin^2 (L^2 - x^2) / 2: that of flapping (Wright, Smith, Thresher, Wang 1982)
    with the term -spin^2 w of motions within the plane, so that `lead-lag^2 = flap^2 - spin^2`. Stretching and shear are left out.
    """
    x, weights = np.polynomial.legendre.leggauss(2 * terms + 6)
    x, weights = 0.5 * (x + 1.0), 0.5 * weights  # of the length
    powers = np.arange(2, terms + 2)
    value, slope = x[:, None] ** powers, powers * x[:, None] ** (powers - 1)
    curve = powers * (powers - 1) * x[:, None] ** (powers - 2)
    inner = lambda f, g, by: np.einsum("i,ij,ik->jk", weights * by, f, g)  # noqa: E731
    pull = density * spin**2 * length**2 * (1.0 - x**2) / 2.0
    M = density * length * inner(value, value, 1.0)
    K = bending / length**3 * inner(curve, curve, 1.0) + inner(slope, slope, pull) / length - spin**2 * M
    from scipy.linalg import eigh

    return np.sqrt(eigh(K, M, eigvals_only=True)[:count]) / (2.0 * np.pi)


def test_a_turning_beam_in_its_plane():
    """The spin-up beam at its final speed, 6 rad/s; at rest EI / (rho A L^4) gives 0.604 Hz."""
    model = literature.spin_up_beam_problem(nx=15, order=2).model
    diagram = pi.steady(model, spin=0.0).campbell([0.0, 3.0, 6.0], count=2)
    for spin, frequencies in zip(diagram.speeds, diagram.frequencies):
        assert frequencies == pytest.approx(lead_lag(spin, 10.0, 14000.0, 1.2, 2), rel=5e-3)
    assert diagram.plot().axes[0].get_xlabel() == "speed, rad/s"


def test_the_residual_vibration_of_the_spin_up_beam():
    """Behind 15 s the beam turns with 6 rad/s; the angle of its tip against the root vibrates with the first frequency."""
    model = literature.spin_up_beam_problem(nx=10, order=2).model
    run = pi.solve(model, 23.0, pi.GeneralizedAlpha(h=1e-2, rho_inf=0.9))
    behind = run.t > 15.5
    turned = complex(10.0) * np.exp(1j * (6.0 * run.t - 45.0))
    tip = (run.position("tip") @ [1.0, 1j])[behind] / turned[behind]
    angle, t = tip.imag, run.t[behind]
    wanted = pi.modes(pi.steady(model, spin=6.0), count=1).frequencies[0]

    def left(frequency):
        waves = np.stack([np.cos(2 * np.pi * frequency * t), np.sin(2 * np.pi * frequency * t), np.ones(len(t)), t], axis=1)
        return np.linalg.lstsq(waves, angle, rcond=None)[1][0]

    tried = wanted * np.linspace(0.95, 1.05, 201)
    assert tried[np.argmin([left(one) for one in tried])] == pytest.approx(wanted, rel=5e-3)


WRONG = {
    "gravity": (lambda: pi.steady(swung(gravity=9.81), spin=1.0), "forces do not turn"),
    "another centre": (lambda: pi.steady(swung(), spin=1.0, about=(0.5, 0.0)), "bearing x does not let the bodies turn"),
    "an infinite speed": (lambda: pi.steady(swung(), spin=np.inf), "spin = inf must be a finite number of rad/s"),
    "a state": (lambda: pi.modes(pi.steady(swung(), spin=1.0), damped=True), "leave state and damped out"),
    "speeds that fall": (lambda: pi.steady(swung(), spin=1.0).campbell([2.0, 1.0]), "must be ascending"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_refused(case):
    call, words = WRONG[case]
    with pytest.raises((pi.InputError, pi.StepFailure), match=words):
        call()
