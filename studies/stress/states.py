"""Cases of the stress study with first-order states, sampled controllers and rolling, against closed forms."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import expm

from polyida.body.rigid_body import PointMass, RigidBody
from polyida.force.controllers import Controller, Maxwell
from polyida.force.loads import Force
from polyida.joint.attachment import ground
from polyida.joint.joints import Prismatic, RollingDisc
from polyida.run.solve import solve
from polyida.scene import Scene
from stress.outcome import Check, integrator

END, PERIOD = 1.0, 0.05  # s
ALLOWED = 5e-3  # of the motion: the usual steps and tolerances of the table


@dataclass(frozen=True, eq=False)
class Brake(Controller):
    """Force along x, N: `-20 (x - 0.3) - 3 x'`, held between samples."""

    at: Any
    period: float
    name: str | None = None

    def sides(self):
        return (self.at,)

    def sample(self, t, x, v, s, u):
        return np.array([-20.0 * (x[0, 0] - 0.3) - 3.0 * v[0, 0]])

    def forces(self, t, x, v, s, u):
        return np.array([[u[0], 0.0]])


def _cart(*parts):
    """A body of 1 kg on a rail that begins at 1 m/s."""
    scene = Scene()
    cart = scene.add(RigidBody(mass=1.0, inertia=0.1, points={"c": (0.0, 0.0)}, velocity=(1.0, 0.0), name="cart"))
    scene.add(Prismatic(ground.at((0.0, 0.0), direction=(1.0, 0.0)), cart.at("c"), name="rail"))
    scene.add(PointMass(cart.at("c"), 1e-12, name="c"))
    for part in parts:
        scene.add(part(cart.at("c")))
    return scene.build()


def relaxation(time, name):
    """A mass on a Maxwell element with that relaxation time: the place agrees with the matrix exponential."""
    stiffness = 50.0
    far = ground.at((-1.0, 0.0))
    model = _cart(lambda at: Maxwell(far, at, stiffness=stiffness, damping=stiffness * time, name="element"))
    run = solve(model, END, integrator(name))
    A = np.array([[0.0, 1.0, 0.0], [-stiffness, 0.0, stiffness], [1.0 / time, 0.0, -1.0 / time]])
    right = (expm(END * A) @ [0.0, 1.0, 0.0])[0]
    return run, [Check("place, of 1 m", abs(run.position("c")[-1, 0] - right), ALLOWED)]


def samples(period, name):
    """A sampled brake of that period, for at most 300 samples: the motion between samples is a parabola."""
    end = min(END, 300 * period)
    run = solve(_cart(lambda at: Brake(at, period, name="brake")), end, integrator(name))
    x, v, t = 0.0, 1.0, 0.0
    while t < end - 1e-12:
        u, step = -20.0 * (x - 0.3) - 3.0 * v, min(period, end - t)
        x, v, t = x + step * v + step * step / 2 * u, v + step * u, t + step
    return run, [Check("place, of 1 m", abs(run.position("c")[-1, 0] - x), 1e-6)]


def rolling(speed, name):
    """A disc that begins with that speed, or at rest, rolls under a force: it has gone `v t + F t^2 / 3m`, and does not slip."""
    scene, radius = Scene(gravity=(0.0, -9.81)), 0.1
    spin = -speed / radius
    disc = scene.add(
        RigidBody(mass=2.0, inertia=0.01, points={"c": (0.0, 0.0)}, origin=(0.0, radius), velocity=(speed, 0.0), spin=spin, name="disc")
    )
    scene.add(RollingDisc(ground.at((0.0, 0.0), direction=(1.0, 0.0)), disc.at("c"), radius=radius, name="contact"))
    scene.add(PointMass(disc.at("c"), 1e-12, name="c"))
    scene.add(Force(disc.at("c"), (0.3, 0.0), name="push"))
    run = solve(scene.build(), END, integrator(name))
    gone = speed * END + 0.3 * END**2 / 6.0
    size = max(abs(gone), radius)
    return run, [
        Check("way, of itself or the radius", abs(run.position("c")[-1, 0] - gone) / size, ALLOWED),
        Check("slip speed, of the speed", float(run.velocity_drift.max()) / max(speed, 0.1), 1e-4),
    ]
