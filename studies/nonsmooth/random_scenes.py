"""Random bodies on a rough floor: what a run with contact and friction must keep."""

import numpy as np

import polyida as pi
from nonsmooth.scenes import FLOOR, G, Kerb

CORNERS, END, STEP = "abc", 0.4, 2e-3


def random_body(seed, restitution=True):
    """(scene, mu, e): a body of 1 kg with three random corners, thrown at the floor. restitution: False for e = 0."""
    rng = np.random.default_rng(seed)
    scene, mu, e = pi.Scene(gravity=(0.0, -G)), rng.uniform(0.0, 1.0), rng.uniform(0.0, 1.0) * restitution
    points = {name: tuple(rng.uniform(-0.3, 0.3, 2)) for name in CORNERS}
    place = (0.0, 0.05 - min(y for _, y in points.values()))
    points = {"m": (0.0, 0.0)} | points
    velocity, spin = tuple(rng.uniform(-1.0, 1.0, 2)), rng.uniform(-5.0, 5.0)
    body = scene.add(pi.RigidBody(mass=1.0, inertia=0.02, points=points, origin=place, velocity=velocity, spin=spin, name="body"))
    for name in CORNERS:
        scene.add(Kerb(FLOOR, body.at(name), restitution=e, mu=mu, name=name))
    return scene, mu, e


def kept(seed, integrator=None, restitution=True):
    """What a run of a random body keeps: see the keys. Shares are of the start's energy, and of the sum of all impulses.

    A step's balance is `m (v_1 - v_0) = h m g + sum P`; NonsmoothAlpha has lam at the end of a step in its place, so that a step is off by
    h times a change of lam, and the run by less.
    """
    scene, mu, e = random_body(seed, restitution)
    run = pi.solve(scene.build(), END, integrator or pi.NonsmoothAlpha(h=STEP))
    if not run.success:
        return {"outcome": run.message}
    body, h = scene.parts["body"], np.diff(run.t)
    heights = np.array([run.position(body.at(name))[:, 1] for name in CORNERS])
    forces = np.array([run.reaction(name) for name in CORNERS])  # on the floor's partner, (corners, frames, 2)
    beyond = np.abs(forces[:, :, 0]) - mu * forces[:, :, 1]
    impulses = h[:, None] * forces.sum(axis=0)[1:] - h[:, None] * [0.0, G]
    gained = np.diff(run.v[:, :2], axis=0)
    off, size = gained - impulses, np.abs(h[:, None] * forces.sum(axis=0)[1:]).sum() or np.inf  # impacts at events are not in lam
    growth = np.diff(run.energy.total) / run.energy.total[0]
    return {
        "outcome": "done",
        "mu": mu,
        "restitution": e,
        "impacts": len(run.events),
        "lowest_gap": float(heights.min()),
        "beyond_cone": float(beyond.max()),
        "pull": float(-forces[:, :, 1].min()),
        "energy_growth": float(max(growth.max(), 0.0)),
        "energy_growth_in_all": float(run.energy.total.max() / run.energy.total[0] - 1.0),
        "momentum_in_a_step": float(np.abs(off).max() / size),
        "momentum_in_all": float(np.abs(off.sum(axis=0)).max() / size),
    }
