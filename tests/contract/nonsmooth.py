"""Events, friction and contact as users write them: runs unchanged, from any folder."""

from dataclasses import dataclass

import numpy as np

import polyida as pi


@dataclass(frozen=True, eq=False)
class Kerb(pi.Joint):
    """The point of b stays above the line through a; it bounces and rubs."""

    a: object
    b: object
    restitution: float = 0.0
    mu: float = 0.3
    name: str | None = None

    def rows(self):
        w = self.b.x - self.a.x
        gap = pi.cross(self.a.d, w).opens(self.restitution)
        return [gap, pi.dot(self.a.d, w).rubs(self.mu, on=[gap])]


def ball(e, mu, vx=0.0):
    scene = pi.Scene(gravity=(0.0, -9.81))
    body = scene.add(pi.RigidBody(mass=1.0, inertia=0.01, points={"c": (0.0, 0.0)}, origin=(0.0, 0.1), velocity=(vx, 0.0), name="ball"))
    scene.add(Kerb(pi.ground.at((0.0, 0.0), direction=(1.0, 0.0)), body.at("c"), restitution=e, mu=mu, name="kerb"))
    scene.add(pi.PointMass(body.at("c"), 1e-9, name="centre"))
    return scene.build()


# 1. a ball bounces: closed form, event-driven and time-stepping
g, e, fall = 9.81, 0.8, np.sqrt(0.2 / 9.81)
t_end = 0.45
times, t, v = [], fall, g * fall
while t < t_end:
    times.append(t)
    v *= e
    t += 2 * v / g
u, tau = v, t_end - times[-1]
exact = u * tau - 0.5 * g * tau**2
for name, integrator, aim in (
    ("Radau", pi.RadauIIA(rtol=1e-9), 1e-8),
    ("alpha", pi.GeneralizedAlpha(h=1e-3), 1e-6),
    ("NonsmoothAlpha", pi.NonsmoothAlpha(h=2e-4), 5e-3),
    ("MoreauJean", pi.MoreauJean(h=2e-4), 2e-2),
):
    run = pi.solve(ball(e, 0.0), t_end, integrator)
    assert run.success, (name, run.message)
    assert abs(run.position("centre")[-1, 1] - exact) < aim, (name, run.position("centre")[-1, 1], exact)
    assert len(run.events) == len(times), (name, len(run.events))
    assert run.position("centre")[:, 1].min() > -1e-9 - (2e-3 if name == "MoreauJean" else 0.0)

# 2. a block that slides to rest: v0^2 / (2 mu g), then stays
scene = pi.Scene(gravity=(0.0, -9.81))
block = scene.add(pi.RigidBody(mass=1.0, inertia=0.01, points={"c": (0.0, 0.0)}, origin=(0.0, 0.0), velocity=(0.5, 0.0), name="block"))
scene.add(pi.Prismatic(pi.ground.at((0.0, 0.0), direction=(1.0, 0.0)), block.at("c"), friction=0.3, name="guide"))
scene.add(pi.PointMass(block.at("c"), 1e-9, name="centre"))
for integrator in (pi.RadauIIA(rtol=1e-8), pi.NonsmoothAlpha(h=5e-4)):
    run = pi.solve(scene.build(), 0.3, integrator)
    assert run.success, run.message
    assert abs(run.position("centre")[-1, 0] - 0.5**2 / (2 * 0.3 * g)) < 1e-5, run.position("centre")[-1]
    assert abs(run.energy.dissipated["guide"][-1] - 0.125) < 1e-4

# 3. an event that changes the scene: a pendulum is caught by a weld when it passes the vertical
scene = pi.Scene(gravity=(0.0, -9.81))
rod = scene.add(pi.RigidBody(mass=1.0, inertia=1 / 12, points={"A": (-0.5, 0.0), "B": (0.5, 0.0)}, origin=(0.5, 0.0), name="rod"))
scene.add(pi.Revolute(pi.ground, rod.at("A"), name="pin"))
scene.add(pi.PointMass(rod.at("B"), 1e-9, name="tip"))
hang = pi.Event(when=lambda s: s.position("tip")[0], then=pi.Clamp(rod.at("A")), name="caught")
run = pi.solve(scene.build(), 1.0, pi.RadauIIA(rtol=1e-8), events=[hang])
assert run.success and len(run.events) == 1, run.message
assert abs(run.position("tip")[-1, 0]) < 1e-6 and abs(run.position("tip")[-1, 1] + 1.0) < 1e-6
print("nonsmooth:", run.events.to_dataframe().to_string())
