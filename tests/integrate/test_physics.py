"""One physical test over all integrators and all joints, and what must hold between integrators."""

from functools import cache

import numpy as np
import pytest

import polyida as pi
from polyida.problems.plates import double_plate
from polyida.results.motion import unbalanced

INTEGRATORS = {
    "alpha": pi.GeneralizedAlpha(h=5e-4),
    "alpha, whole matrix": pi.GeneralizedAlpha(h=5e-4, linear="kkt"),
    "ida ggl2": pi.IDA(rtol=1e-6, atol=1e-8),
    "ida ggl1": pi.IDA(rtol=1e-6, atol=1e-8, form="ggl1"),
    "ida, whole matrix": pi.IDA(rtol=2e-7, atol=2e-9, linear="whole"),
    "radau": pi.RadauIIA(max_step=5e-4),  # as short as the others': what is measured is summed by trapezoids
    "radau, index 3": pi.RadauIIA(max_step=5e-4, form="index3"),
    "energy-momentum": pi.EnergyMomentum(h=5e-4),
}
EVERY_JOINT = "alpha", "ida ggl2", "radau", "energy-momentum"
SLOW = "ida, whole matrix"  # factors it in every step; its runs are those of the border (test_iteration_matrix.py)
OTHERS = [(kind, name) for name in INTEGRATORS if name not in (*EVERY_JOINT, SLOW) for kind in ("motor between", "clamp to ground", "path")]


@pytest.fixture(params=[name for name in INTEGRATORS if name != SLOW])
def integrator(request):
    """Every integrator in turn but the slow one, which is asked for by name."""
    return INTEGRATORS[request.param]


def momenta(run, about=(0.0, 0.0)):
    """(linear momentum (frames, 2), angular momentum about a point (frames,))."""
    model = run.model
    p = (model.mass() @ run.v.T).T.reshape(len(run), -1, 2)
    x = model.reference + run.q.reshape(p.shape) - about
    return p.sum(axis=1), (x[..., 0] * p[..., 1] - x[..., 1] * p[..., 0]).sum(axis=1)


@pytest.fixture(scope="module")
def by_alpha(scenes):
    """Function (kind, level) -> run of a jointed scene by generalized-alpha, made once."""
    return cache(lambda kind, level="full": pi.solve(scenes.jointed(kind, level=level).build(), 0.04, INTEGRATORS["alpha"]))


def require_balance(other, integrator, kind=""):
    """Joints hold, the energy is accounted for, and the motion is that of another run."""
    run = pi.solve(other.model, 0.04, integrator)
    loose = getattr(integrator, "linear", None) == "whole" and kind.startswith(("prismatic", "slot"))
    held = integrator.atol if loose else 1e-10  # where Newton's method stops on rows that are not linear
    assert run.success, run.message
    assert run.drift.max() < held and run.velocity_drift.max() < 1e-4
    assert np.abs(unbalanced(run)).max() < 1e-4 * np.abs(run.energy.potential).max()
    assert np.abs(run.q[-1] - other.q[-1]).max() < 3e-5
    assert np.abs(run.position("joint")[-1] - other.position("joint")[-1]).max() < 3e-5


@pytest.mark.parametrize("integrator", EVERY_JOINT, indirect=True)
def test_joints_hold_between_rigid_plates(by_alpha, kind, integrator):
    require_balance(by_alpha(kind, "rigid"), integrator)


@pytest.mark.parametrize("level", ["full", "reduced"])
@pytest.mark.parametrize("integrator", EVERY_JOINT, indirect=True)
def test_joints_hold_and_energy_balances(by_alpha, kind, level, integrator):
    require_balance(by_alpha(kind, level), integrator)


@pytest.mark.parametrize("kind, integrator", [*OTHERS, *(("slot", name) for name in INTEGRATORS if name not in EVERY_JOINT)], indirect=True)
def test_joints_hold_in_other_forms(by_alpha, kind, integrator):
    require_balance(by_alpha(kind), integrator, kind)


def test_free_plates_keep_their_momentum(scenes, integrator):
    """Two plates joined in flight, without gravity: linear and angular momentum, and the energy."""
    scene, upper, lower = scenes.pair((0.0, 0.0), bend=0.5)
    scene.add(pi.Revolute(upper.section("right"), lower.section("left"), name="elbow"))
    model = scene.build()
    x, y = model.reference.T
    v0 = np.column_stack([2.0 - 4.0 * y, -1.0 + 4.0 * x]).ravel()
    run = pi.solve(model, 0.2, integrator, v0=v0)
    linear, angular = momenta(run)
    assert run.success, run.message
    assert np.abs(linear - linear[0]).max() < 1e-6 * np.abs(linear[0]).max()
    assert np.abs(angular - angular[0]).max() < 3e-4 * abs(angular[0])
    assert np.abs(run.energy.total - run.energy.total[0]).max() < 3e-4 * run.energy.total[0]


def test_reactions_change_the_momentum(scenes, integrator):
    """Force of the hinge plus weight is the slope of the momentum; the motor's torque that of the angular momentum."""
    scene, upper = scenes.hinged(material={"E": 1e9})
    scene.add(pi.AngleMotor(pi.ground, upper.section("left"), angle=pi.profile.ramp(0.0, 0.3, duration=0.2), name="drive"))
    run = pi.solve(scene.build(), 0.1, integrator)
    linear, angular = momenta(run)
    weight = run.model.arrays.plates.weight
    x = run.model.reference + run.q.reshape(len(run), -1, 2)
    impulse = lambda f: np.sum(np.diff(run.t)[:, None] * (f[1:] + f[:-1]) / 2, axis=0)  # noqa: E731
    assert run.success, run.message
    gained, given = linear[-1] - linear[0], impulse(run.reaction("shoulder") + weight.sum(axis=0))
    assert np.allclose(gained, given, atol=2e-3 * np.abs(weight.sum()) * 0.1)
    torque = run.reaction("drive")[:, 0] + (x[..., 0] @ weight[:, 1])
    assert angular[-1] - angular[0] == pytest.approx(impulse(torque[:, None])[0], abs=1e-3)


def test_stiff_plates_are_a_double_pendulum():
    """Rigid limit: two bars of length 1 with a mass at the tip, by their ordinary differential equation."""
    from scipy.integrate import solve_ivp

    stiff = pi.Material(E=50e9, nu=0.3, rho=1100.0)
    model = double_plate(cells=40, material=stiff).build()
    run = pi.solve(model, 0.5, pi.GeneralizedAlpha(h=5e-4))
    m, M, g, inertia = 1.1, 0.5, 9.81, 1.1 * (1.0 + 0.01) / 12

    def slopes(t, y):
        (a, b), w = y[:2], y[2:]
        c, s = np.cos(a - b), np.sin(a - b)
        k = m / 2 + M
        mass = np.array([[m / 4 + m + M + inertia, k * c], [k * c, m / 4 + M + inertia]])
        force = [-k * s * w[1] ** 2 - (1.5 * m + M) * g * np.cos(a), k * s * w[0] ** 2 - k * g * np.cos(b)]
        return np.concatenate([w, np.linalg.solve(mass, force)])

    a, b = solve_ivp(slopes, (0.0, 0.5), np.zeros(4), rtol=1e-10, atol=1e-12).y[:2, -1]
    tip = [np.cos(a) + np.cos(b), np.sin(a) + np.sin(b)]
    assert np.abs(run.position("tip")[-1] - tip).max() < 3e-3
