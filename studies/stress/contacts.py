"""Cases of the stress study with contacts: the run must detect the contact and must not gain energy."""

import numpy as np

from polyida import mesh
from polyida.body.plate import Material, Plate
from polyida.body.rigid_body import RigidBody
from polyida.force.springs import PenaltyContact
from polyida.joint.attachment import ground
from polyida.joint.joints import Revolute
from polyida.run.solve import solve
from polyida.scene import Scene
from stress.outcome import Check, balance, drift_check, integrator

G = 9.81
ALLOWED = 5e-3  # of the motion, as of the other cases
ROUGH = 3e-2  # of steps of order 1 to 2 of 1 ms or rtol = 1e-5, behind a blow of some ms


def thrown_at_a_ball(offset, name):
    """A body of 1 kg flies with 1 m/s at an elastic ball, whose centre is `offset` beside its path: energy and angular momentum about the
    centre are conserved. Without an offset the body returns with -1 m/s.
    """
    scene = Scene()
    body = scene.add(RigidBody(mass=1.0, inertia=0.1, points={"c": (0.0, 0.0)}, origin=(0.0, offset), velocity=(1.0, 0.0), name="body"))
    scene.add(PenaltyContact(body.at("c"), ground.at((0.5, 0.0)), stiffness=1e6, radius=0.01, name="ball"))
    run = solve(scene.build(), 0.8, integrator(name, 0.02))
    (vx, vy), (x, y) = run.v.reshape(len(run), -1, 2)[-1, 0], run.position(body.at("c"))[-1]
    spin = (x - 0.5) * vy - y * vx
    return run, [
        Check("speed at the end", float(abs(np.hypot(vx, vy) - 1.0)), ALLOWED),
        Check("moment of momentum about the ball, of the ball's radius", float(abs(spin + offset)) / 0.01, ROUGH),
        Check("is not turned aside", float(vy < 1e-3 and vx > 0.0), 0.5),
    ]


def bouncing(exponent, name):
    """A body falls 0.2 m onto elastic ground twice: the height agrees with a one-dimensional solution, and energy is conserved."""
    scene, k = Scene(gravity=(0.0, -G)), 1e5
    body = scene.add(RigidBody(mass=1.0, inertia=0.1, points={"c": (0.0, 0.0)}, origin=(0.0, 0.2), name="body"))
    scene.add(PenaltyContact(body.at("c"), ground.at((0.0, 0.0)), stiffness=k, exponent=exponent, name="ground"))
    run = solve(scene.build(), 0.7, integrator(name))
    height = _exact(lambda y: -G + k * max(0.0, -y) ** exponent, 0.2, 0.0, 0.7)
    off = abs(run.position(body.at("c"))[-1, 1] - height) / 0.2
    return run, [Check("height against the exact one", float(off), ROUGH), *balance(run, ALLOWED, ALLOWED)]


def pendulum_at_a_stop(stiffness, name):
    """A bar swings against an elastic ball: the angle agrees with a one-dimensional solution, and energy is conserved."""
    scene, radius = Scene(gravity=(0.0, -G)), 0.05
    bar = scene.add(RigidBody.bar(1.0, 1.0, name="bar"))
    scene.add(Revolute(ground, bar.at("left"), name="pin"))
    scene.add(PenaltyContact(bar.at("right"), ground.at((0.0, -1.0)), stiffness=stiffness, radius=radius, name="stop"))
    run = solve(scene.build(), 0.8, integrator(name))

    def pull(angle):
        away = np.array([np.cos(angle), np.sin(angle) + 1.0])
        d = np.hypot(*away)
        push = stiffness * max(0.0, radius - d) ** 1.5 / d * (away @ [-np.sin(angle), np.cos(angle)])
        return 3.0 * (push - 0.5 * G * np.cos(angle))

    angle = _exact(pull, 0.0, 0.0, 0.8)
    off = np.linalg.norm(run.position(bar.at("right"))[-1] - [np.cos(angle), np.sin(angle)])
    return run, [Check("tip against the exact one", float(off), ROUGH), drift_check(run), *balance(run, ALLOWED, ALLOWED)]


def plate_at_a_stop(speed, name):
    """A corner of an elastic plate hits a wall: the plate leaves the wall, energy is conserved, and there is no force along the wall."""
    scene = Scene()
    plate = scene.add(Plate(mesh.rectangle(0.3, 0.1, 6, seed=1), Material(1e9, 0.3, 1000.0), 0.01, velocity=(speed, 0.0), name="plate"))
    scene.add(PenaltyContact(plate.node((0.3, 0.0)), ground.at((0.32, 0.0), direction=(0.0, 1.0)), stiffness=1e6, name="wall"))
    run = solve(scene.build(), 0.1 / speed, integrator(name, 2e-4))
    model, start = run.model, run.model.momenta(run.q[0], run.v[0])
    end = model.momenta(run.q[-1], run.v[-1])
    return run, [
        Check("flies through it", float(end[0] > 0.5 * start[0]), 0.5),
        Check("momentum along the wall, of that at the start", float(abs(end[1]) / start[0]), 1e-6),
        *balance(run, ALLOWED, 0.1),
    ]


def _exact(acceleration, x, v, t_end):
    """x(t_end) for `x'' = acceleration(x)`."""
    from scipy.integrate import solve_ivp

    result = solve_ivp(lambda t, y: [y[1], acceleration(y[0])], (0.0, t_end), [x, v], "DOP853", rtol=1e-11, atol=1e-13, max_step=1e-3)
    return float(result.y[0, -1])
