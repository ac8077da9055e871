"""Roots and state space of models with first-order states."""

import numpy as np
import pytest

import polyida as pi

INERTIA, KP, KI, KD = 0.5, 20.0, 30.0, 4.0


def rotor(*parts):
    scene = pi.Scene()
    body = scene.add(pi.RigidBody(mass=1.0, inertia=INERTIA, points={"c": (0.0, 0.0), "rim": (1.0, 0.0)}, name="rotor"))
    scene.add(pi.Revolute(pi.ground.at((0.0, 0.0)), body.at("c"), name="axle"))
    scene.add(pi.PointMass(body.at("rim"), 1e-9, name="rim"))
    for part in parts:
        scene.add(part(body))
    return scene.build()


def pid(body):
    return pi.PID(body.at("c"), kp=KP, ki=KI, kd=KD, target=pi.profile.constant(0.0), name="pid")


def right_roots():
    roots = np.roots([INERTIA, KD, KP, KI])
    return np.append(roots, 0.0)  # the state of the filter, which is not used


def test_roots_of_a_pid_loop():
    modes = pi.modes(rotor(pid), count=9, damped=True)
    right = right_roots()
    right = right[right.imag >= 0.0]
    assert np.sort_complex(modes.roots) == pytest.approx(np.sort_complex(right), abs=1e-6)


def test_state_space_of_a_pid_loop():
    model = rotor(pid)
    system = pi.linearise(model, outputs=["rim"])
    assert system.states == ("pid integral", "pid filtered") and system.A.shape == (4, 4)
    assert np.sort_complex(np.linalg.eigvals(system.A)) == pytest.approx(np.sort_complex(right_roots()), abs=1e-6)
    row = system.A[2]
    place = system.shapes @ np.eye(model.n)
    assert row[3] == 0.0 and abs(row[2]) < 1e-9 and abs(row[0]) == pytest.approx(KI / np.sqrt(INERTIA), rel=1e-6)
    assert place.shape == (1, model.n)


def test_undamped_modes_hold_the_states():
    spring = lambda body: pi.TorsionSpring(pi.ground.at((0.0, 0.0)), body.at("c"), stiffness=KP, name="spring")  # noqa: E731
    motor = lambda body: pi.DCMotor(body.at("c"), volts=1.0, k=0.5, L=0.1, R=1.0, name="motor")  # noqa: E731
    modes = pi.modes(rotor(spring, motor), count=3)
    assert modes.frequencies == pytest.approx([np.sqrt(KP / INERTIA) / (2 * np.pi)], rel=1e-6)


def test_frequency_response_of_a_driven_motor():
    J, k, L, R = INERTIA, 0.5, 0.1, 1.0
    model = rotor(lambda body: pi.DCMotor(body.at("c"), volts=pi.profile.sine(1.0, 1.0), k=k, L=L, R=R, name="motor"))
    f = np.array([0.3, 1.0, 3.0])
    s = 2j * np.pi * f
    right = k / (s * (J * s * (L * s + R) + k * k))  # of the angle on the voltage
    found = pi.frequency_response(model, None, "motor", "rim", f).values[:, 1]
    assert found == pytest.approx(right, rel=1e-6)


def test_the_input_of_a_controller_is_linearised_at_its_states():
    """`J w' = kp e + I - kd (angle - z)/T - m g cos(angle)/2`: with z at rest the torque is far below its limit, with z = 0 far above."""
    kp, ki, kd, T, at, J, pull = 40.0, 30.0, 8.0, 0.01, 0.3, 1.0 / 3.0, 0.5 * 9.81
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = scene.add(pi.RigidBody.bar(1.0, 1.0, name="bar"))
    scene.add(pi.Revolute(pi.ground, bar.at("left"), name="hinge"))
    scene.add(pi.PointMass(bar.at("right"), 1e-12, name="tip"))
    scene.add(pi.PID(bar.at("left"), kp=kp, ki=ki, kd=kd, target=at, filter=T, limit=12.0, name="pid"))
    model = scene.build()
    A = np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [(pull * np.sin(at) - kp - kd / T) / J, 0.0, 1.0 / J, kd / T / J],
            [-ki, 0.0, 0.0, 0.0],
            [1 / T, 0.0, 0.0, -1 / T],
        ]
    )
    frequencies = np.array([0.1, 1.0, 5.0])
    exact = [np.linalg.solve(2j * np.pi * f * np.eye(4) - A, [0.0, kp / J, ki, 0.0])[0] for f in frequencies]
    response = pi.frequency_response(model, pi.static(model), "pid", "tip", frequencies)
    assert np.allclose(response.values, np.outer(exact, [-np.sin(at), np.cos(at)]), rtol=1e-5, atol=0.0)


def test_few_modes_of_an_arm_have_the_roots_of_its_controller():
    """The filter of a PID, held, would be a spring of kd / filter = 10 kp, in which the modes would hardly turn."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    mesh, rubber = pi.mesh.rectangle(1.0, 0.1, cells=60, seed=1), pi.Material(E=50e6, nu=0.3, rho=1100.0)
    arm = scene.add(pi.Plate(mesh, rubber, thickness=0.01, name="arm"))
    scene.add(pi.Revolute(pi.ground, arm.section("left"), name="hub"))
    scene.add(pi.PID(arm.section("left"), kp=80.0, ki=100.0, kd=8.0, target=0.3, filter=0.01, name="pid"))
    scene.add(pi.PointMass(arm.section("right"), 0.1, name="tip"))
    model = scene.build()
    state = pi.static(model)
    slow = pi.modes(model, state=state, damped=True, count=2).roots
    for root in slow[np.argsort(np.abs(slow))][:2]:
        assert np.abs(np.linalg.eigvals(pi.linearise(model, state, modes=8).A) - root).min() < 0.1 * abs(root)
