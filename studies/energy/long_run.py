"""Energy and momentum over long times: the double plate swinging, and thrown free of ground and gravity."""

from functools import lru_cache

import numpy as np

from polyida.integrate.solve import solve
from polyida.joint.revolute import Revolute
from polyida.problems import plates
from polyida.scene import Scene
from polyida.study.members import by_tolerance, integrator

WEIGHTS_FALL = 9.81 * (
    2 * plates.RUBBER.rho * plates.LENGTH**2 * plates.HEIGHT * plates.THICKNESS + 2 * plates.LENGTH * plates.TIP_MASS
)  # J, to hang straight down
SPINS, DRIFT = (4.0, -2.0), (1.0, 0.5)  # rad/s of the two plates, m/s of the first one's left edge


@lru_cache(maxsize=4)
def swinging(cells):
    """(model, None): scene 1."""
    return plates.double_plate(cells).build(), None


@lru_cache(maxsize=4)
def thrown(cells):
    """(model, v0): the double plate without its shoulder and without gravity, both plates turning."""
    given = plates.double_plate(cells)
    scene = Scene()
    for name, part in given.parts.items():
        if not (isinstance(part, Revolute) and name == "shoulder"):
            scene.add(part)
    model, v0, root = scene.build(), [], np.array(DRIFT)
    for body, spin in zip(model.bodies, SPINS):
        arm = body.points - [body.points[:, 0].min(), 0.0]
        v0.append(root + spin * np.stack([-arm[:, 1], arm[:, 0]], axis=1))
        root = root + spin * plates.LENGTH * np.array([0.0, 1.0])
    return model, np.concatenate(v0).ravel()


def momenta(model, q, v):
    """(linear momentum x, y in kg m/s, angular momentum about the origin in kg m2/s) of every frame, (frames, 3)."""
    M, found = model.mass(), []
    for place, velocity in zip(q, v):
        push = (M @ velocity).reshape(-1, 2)
        x = model.reference + place.reshape(-1, 2)
        found.append([*push.sum(axis=0), np.sum(x[:, 0] * push[:, 1] - x[:, 1] * push[:, 0])])
    return np.array(found)


def balance(scene, member, x, time, cells, frames=400):
    """One run: how far energy (of its scale) and, thrown, momenta (of their size) go from where they began."""
    model, v0 = (thrown if scene == "thrown" else swinging)(cells)
    steps = 2000 if by_tolerance(member) else time / x
    run = solve(model, time, integrator(member, x), v0=v0, every=max(1, int(steps / frames)))
    energy, keep = run.energy, slice(None, None, max(1, len(run.t) // frames))
    scale = float(energy.kinetic[0]) if scene == "thrown" else WEIGHTS_FALL
    change = (energy.total - energy.total[0]) / scale
    outcome = {"dof": model.n, "outcome": "done" if run.success else run.message, "steps": run.counts.steps, "cpu_s": run.cpu_seconds}
    drift = {"energy_drift": float(np.abs(change).max()), "energy_change": float(change[-1]) * scale}
    row = outcome | drift | {"t": run.t[keep], "energy": change[keep]}
    return row | momentum_drift(momenta(model, run.q, run.v), keep) if scene == "thrown" else row


def momentum_drift(found, keep):
    """How far momenta (frames, 3) go from the first, of its size; the angular one over time as well."""
    drift, angular = np.abs(found - found[0]).max(axis=0), abs(found[0, 2])
    linear = float(drift[:2].max() / np.linalg.norm(found[0, :2]))
    return {"linear_drift": linear, "angular_drift": float(drift[2] / angular), "angular": (found[keep, 2] - found[0, 2]) / angular}
