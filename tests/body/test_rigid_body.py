"""Rigid bodies: against ordinary differential equations and closed forms, in all integrators, and what is wrong with one."""

import pickle

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import polyida as pi

G, LENGTH, MASS = 9.81, 1.0, 2.0
STEEL = pi.Material(E=2e11, nu=0.3, rho=7800.0)
METHODS = {  # name: integrator and what it leaves of a swing of 1 s, m
    "alpha": (pi.GeneralizedAlpha(h=1e-3), 1e-5),
    "energy-momentum": (pi.EnergyMomentum(h=1e-3), 1e-5),
    "ida": (pi.IDA(rtol=1e-11, atol=1e-13), 1e-8),
    "radau": (pi.RadauIIA(rtol=1e-10), 1e-8),
}
each_method = pytest.mark.parametrize("method, off", METHODS.values(), ids=METHODS)


def bar(**options):
    return pi.RigidBody.bar(LENGTH, MASS, **options)


def hinged(*parts):
    """(scene, bar) of a bar hinged at its left end; parts: functions of it that give what else there is."""
    scene = pi.Scene(gravity=(0.0, -G))
    body = scene.add(bar(name="bar"))
    scene.add(pi.Revolute(pi.ground, body.at("left"), name="hinge"))
    for part in parts:
        scene.add(part(body))
    return scene, body


def swing(times, pull=1.5 * G / LENGTH):
    """Angles of `angle'' = -pull cos(angle)`, released level."""
    found = solve_ivp(lambda _, y: [y[1], -pull * np.cos(y[0])], (0.0, times[-1]), [0.0, 0.0], "DOP853", times, rtol=1e-13, atol=1e-13)
    return found.y[0]


def circle(angle):
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


@each_method
def test_a_pendulum_follows_its_differential_equation(method, off):
    scene, body = hinged()
    times = np.linspace(0.0, 1.0, 11)
    run = pi.solve(scene.build(), 1.0, method, output=times)
    assert run.success and "plain" not in run.summary()
    assert np.abs(run.position(body.at("right")) - circle(swing(times))).max() < (off if off < 1e-6 else 10 * off)
    assert np.abs(run.position(body.at("right"))[-1] - circle(swing(times)[-1])).max() < off


def test_orders(scenes):
    scene, body = hinged()
    steps = [2e-2, 1e-2, 5e-3]
    for method in (pi.GeneralizedAlpha, pi.EnergyMomentum):
        ends = [pi.solve(scene.build(), 1.0, method(h=h)).position(body.at("right"))[-1] for h in steps]
        errors = np.linalg.norm(ends - circle(swing([0.0, 1.0])[-1]), axis=1)
        assert scenes.slope(steps, errors) == pytest.approx(2.0, abs=0.1)


@each_method
def test_a_free_body_flies_along_a_parabola_and_keeps_its_spin(method, off):
    """Many turns; the centre of mass is not where the body's axes begin."""
    scene, spin, start, t = pi.Scene(gravity=(0.3, -G)), 7.0, np.array([2.0, 5.0]), 2.0
    body = scene.add(pi.RigidBody(3.0, 0.4, {"A": (0.5, 0.1)}, (1.0, -2.0), 0.8, center=(0.2, -0.3), velocity=start, spin=spin))
    run = pi.solve(scene.build(), t, method)
    z = np.exp(0.8j)
    centre = np.array([1.0, -2.0]) + start * t + np.array([0.3, -G]) * t * t / 2
    turned = z * np.exp(1j * spin * run.t) * (0.3 + 0.4j)
    free = centre + start * (run.t - t)[:, None] + np.array([0.3, -G]) * (run.t**2 - t**2)[:, None] / 2
    free += np.stack([(z * (0.2 - 0.3j)).real, (z * (0.2 - 0.3j)).imag])
    rate = (spin * method.h) ** 2 / 12 * spin * t if hasattr(method, "h") and method.h else 0.0  # of the second-order methods' turn
    assert run.success
    assert np.abs(run.position(body.at("A")) - free - np.stack([turned.real, turned.imag], axis=1)).max() < 3 * off + rate
    mass = run.model.mass()
    assert np.allclose((run.v @ mass)[:, :2], 3.0 * (start + np.outer(run.t, [0.3, -G])), atol=1e-6)
    turn = run.model.reference[1] + run.q[:, 2:]
    angular = turn[:, 0] * (run.v @ mass)[:, 3] - turn[:, 1] * (run.v @ mass)[:, 2]
    assert np.abs(angular - 0.4 * spin).max() < 1e-5 * 0.4 * spin


def test_masses_loads_and_profiles_act_at_its_points():
    """A mass at the tip; a dead load that carries it and half of the bar; one across a free bar, and what it does at once."""
    mass, up = (
        (lambda b: pi.PointMass(b.at("right"), 3.0, name="tip")),
        (lambda b: pi.PointLoad(b.at("right"), (0.0, (3.0 + MASS / 2) * G))),
    )
    scene, body = hinged(mass, up)
    state = pi.consistent_state(scene.build())
    assert np.abs(state.a).max() < 1e-12 and np.allclose(state.lam[scene.build().rows["hinge"]], [0.0, MASS / 2 * G])
    scene, body = hinged(mass)
    run = pi.solve(scene.build(), 0.5, METHODS["ida"][0])
    pull = (MASS * LENGTH / 2 + 3.0 * LENGTH) * G / (MASS * LENGTH**2 / 3 + 3.0 * LENGTH**2)
    assert np.abs(run.position("tip")[-1] - circle(swing([0.0, 0.5], pull)[-1])).max() < 1e-8
    scene = pi.Scene()
    body = scene.add(bar(angle=0.4))
    scene.add(pi.PointLoad(body.at("right"), (1.0, 2.0), pi.profile.polynomial([1.5, 1.0])))
    a = pi.consistent_state(scene.build()).a
    moment = LENGTH / 2 * (np.cos(0.4) * 3.0 - np.sin(0.4) * 1.5)
    turning = body.gyration * moment / (MASS * LENGTH**2 / 12)
    assert np.allclose(a, [1.5 / MASS, 3.0 / MASS, *(turning * np.array([-np.sin(0.4), np.cos(0.4)]))])


def polygon(count, radius=0.5):
    """A regular polygon as one cell."""
    points = radius * circle(2 * np.pi * np.arange(count) / count)
    return pi.mesh.PolygonMesh(points + (3.0, 1.0), np.arange(count), [0, count])


def frame():
    """A rectangle 3 x 2 around a hole 1 x 1 in its middle: eight quadrilaterals."""
    x, y = np.array([0.0, 1.0, 2.0, 3.0]), np.array([0.0, 0.5, 1.5, 2.0])
    points = np.array([(px, py) for py in y for px in x])
    cells = [[4 * j + i, 4 * j + i + 1, 4 * j + i + 5, 4 * j + i + 4] for j in range(3) for i in range(3) if (i, j) != (1, 1)]
    return pi.mesh.PolygonMesh(points, np.ravel(cells), np.arange(0, 33, 4))


def ellipse_of(area, a, b):
    """Second moment of a rectangle a x b about its centre, over rho t."""
    return area * (a * a + b * b) / 12


@pytest.mark.parametrize(
    "mesh, area, centre, second",
    [
        (lambda: pi.mesh.rectangle(2.0, 0.6, cells=30, seed=3), 1.2, (1.0, 0.0), ellipse_of(1.2, 2.0, 0.6)),
        (frame, 5.0, (1.5, 1.0), ellipse_of(6.0, 3.0, 2.0) - ellipse_of(1.0, 1.0, 1.0)),
        (lambda: polygon(16), 8 * 0.25 * np.sin(np.pi / 8), (3.0, 1.0), 8 * 0.25 * np.sin(np.pi / 8) * 0.25 * (2 + np.cos(np.pi / 8)) / 6),
    ],
    ids=["rectangle", "frame", "16-gon"],
)
def test_mass_centre_and_inertia_of_a_mesh(mesh, area, centre, second):
    body = pi.RigidBody.from_mesh(mesh(), STEEL, 0.01, points={"A": (0.1, 0.2)})
    assert body.mass == pytest.approx(78.0 * area, rel=1e-12)
    assert np.allclose(body.center, centre, rtol=1e-12, atol=1e-14) and body.points["center"] == body.center
    assert body.inertia == pytest.approx(78.0 * second, rel=1e-12)
    assert body.points["A"] == (0.1, 0.2)


def test_a_rigid_plate_is_a_rigid_body_of_its_mesh(scenes):
    mesh, pose = scenes.mesh(), {"origin": (0.5, -0.2), "angle": 0.7}
    runs = []
    for make, hold in (
        (lambda: pi.Rigid(scenes.plate("it", **pose)), lambda body, name: body.section(name)),
        (lambda: pi.RigidBody.from_mesh(mesh, pi.Material(**scenes.RUBBER), scenes.THICKNESS, name="it", **pose), pi.RigidBody.at),
    ):
        scene = pi.Scene(gravity=(0.0, -G))
        body = scene.add(make())
        scene.add(pi.Revolute(pi.ground, hold(body, "left"), name="hinge"))
        scene.add(pi.PointMass(hold(body, "right"), 0.3, name="tip"))
        runs.append(pi.solve(scene.build(), 0.3, pi.GeneralizedAlpha(h=1e-3, tolerance=1e-13)))
    assert runs[0].model.n == 4 and np.allclose(runs[0].position("tip"), runs[1].position("tip"), atol=1e-12)
    assert np.allclose(runs[0].reaction("hinge"), runs[1].reaction("hinge"), atol=1e-8)
    assert np.allclose(runs[0].energy.total, runs[1].energy.total, atol=1e-10)
    assert np.abs(runs[0].stress(-1)).max() < 1e-6 and runs[0].stress(-1).shape == (mesh.n_cells, 3)
    nodes = runs[0].node_positions(-1)
    assert np.allclose(np.linalg.norm(nodes - nodes[0], axis=1), np.linalg.norm(mesh.points - mesh.points[0], axis=1), atol=1e-13)


def test_drag_slows_a_rigid_plate():
    """`mass_damping` alone: velocity and spin fall as exp(-drag t)."""
    scene, drag = pi.Scene(), 1.5
    plate = pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=12, seed=1), pi.Material(5e7, 0.3, 1100.0, mass_damping=drag), 0.01)
    body = scene.add(pi.Rigid(plate))
    model, spin, velocity = scene.build(), 4.0, np.array([1.0, -0.5])
    run = pi.solve(model, 1.0, pi.IDA(rtol=1e-10, atol=1e-12), v0=[*velocity, 0.0, body.gyration * spin])
    gone = (1 - np.exp(-drag)) / drag
    assert np.allclose(
        run.q[-1], [*(velocity * gone), *(body.gyration * np.array([np.cos(spin * gone) - 1, np.sin(spin * gone)]))], atol=1e-8
    )
    assert body.damping() == (drag, 0.0)


def linked():
    """A scene of a rigid body, a rigid and a reduced plate with complex weights, drag and viscosity in it, all joints driven or held."""
    rubber = pi.Material(5e7, 0.3, 1100.0, viscosity=1e-3, mass_damping=0.4)
    mesh, scene = pi.mesh.rectangle(1.0, 0.1, cells=12, seed=1), pi.Scene(gravity=(0.5, -G))
    crank = scene.add(pi.RigidBody(1.0, 0.2, {"O": (-0.1, 0.3), "A": (0.4, -0.2)}, (0.3, -0.4), 0.5, (0.05, 0.1), name="crank"))
    end = crank.at("A").point
    rigid = scene.add(pi.Rigid(pi.Plate(mesh, rubber, 0.01, origin=end, angle=0.4, name="rigid")))
    tip = rigid.section("right").point
    soft = scene.add(pi.Reduced(pi.Plate(mesh, rubber, 0.01, origin=tip, angle=-0.3, name="soft"), modes=3))
    scene.add(pi.Revolute(pi.ground, crank.at("O"), name="bearing"))
    scene.add(pi.AngleMotor(pi.ground, crank.at("O", direction=(1.0, 2.0)), pi.profile.sine(0.4, 1.0), name="drive"))
    scene.add(pi.Revolute(crank.at("A"), rigid.section("left"), name="pin"))
    scene.add(pi.Revolute(rigid.section("right"), soft.section("left"), name="elbow"))
    scene.add(pi.PointMass(soft.section("right"), 0.2, name="tip"))
    scene.add(pi.EdgeTraction(soft.section("top"), (3.0, -20.0), pi.profile.polynomial([1.0, 0.5]), name="wind"))
    scene.add(pi.PointLoad(rigid.section("right"), (1.0, 1.0), name="push"))
    return scene


def test_derivatives():
    model, random = linked().build(), np.random.default_rng(4)
    q, v, a = (0.02 * random.standard_normal(model.n) for _ in range(3))
    found = pi.check_derivatives(model, 0.2, q=q, v=v, a=a)
    assert max(found.values()) < 1e-6, found


def test_files_and_pickles_hold_it(tmp_path):
    scene = linked()
    run = pi.solve(scene.build(), 0.02, pi.GeneralizedAlpha(h=1e-3), out=tmp_path / "run.h5")
    for other in (pi.load(tmp_path / "run.h5"), pickle.loads(pickle.dumps(run))):
        assert np.array_equal(other.q, run.q) and np.array_equal(other.energy.total, run.energy.total)
        assert [type(part) for part in other.model.parts.values()] == [type(part) for part in scene.parts.values()]
        crank, known = other.model.parts["crank"], scene.parts["crank"]
        assert crank.points == known.points and crank.center == known.center and crank.inertia == known.inertia
        assert np.array_equal(other.position("tip"), run.position("tip")) and np.array_equal(other.reaction("drive"), run.reaction("drive"))
        assert np.array_equal(other.stress(-1), run.stress(-1))
        again = pi.solve(other.model, 0.02, pi.GeneralizedAlpha(h=1e-3))
        assert np.allclose(again.q, run.q, atol=1e-14)
