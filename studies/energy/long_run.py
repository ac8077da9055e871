"""Energy and momentum over long times: the double plate swings, or flies free of ground and gravity."""

from functools import lru_cache

import numpy as np

from polyida.joint.joints import Revolute
from polyida.problems import plates
from polyida.scene import Scene
from polyida.study.invariants import energy
from work_precision.integrators import by_tolerance, integrator

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
    scene_of_plates = plates.double_plate(cells)
    scene = Scene()
    for name, part in scene_of_plates.parts.items():
        if not (isinstance(part, Revolute) and name == "shoulder"):
            scene.add(part)
    model, v0, root = scene.build(), [], np.array(DRIFT)
    for body, spin in zip(model.bodies, SPINS):
        arm = body.points - [body.points[:, 0].min(), 0.0]
        v0.append(root + spin * np.stack([-arm[:, 1], arm[:, 0]], axis=1))
        root = root + spin * plates.LENGTH * np.array([0.0, 1.0])
    return model, np.concatenate(v0).ravel()


def balance(scene, member, x, time, cells, frames=400):
    """One run: change of energy relative to its scale and, for the free flight, of the momenta relative to their size."""
    model, v0 = (thrown if scene == "thrown" else swinging)(cells)
    every = max(1, int((2000 if by_tolerance(member) else time / x) / frames))
    study = energy(model, time, v0=v0, integrators={member: integrator(member, x)}, frames=frames, every=every)
    (row,), (result,) = study.rows, study.histories.values()
    scale = float(result["kinetic"][0]) if scene == "thrown" else WEIGHTS_FALL
    outcome = {
        "dof": model.n,
        "outcome": "done" if row["status"] == "done" else row["message"],
        "steps": row["steps"],
        "cpu_s": row["cpu_s"],
    }
    drift = {"energy_drift": row["energy_drift"] / scale, "energy_change": row["energy_change"]}
    return (
        outcome
        | drift
        | {"t": result["t"], "energy": result["unbalanced"] / scale}
        | (_momenta(row, result, model, v0) if scene == "thrown" else {})
    )


def _momenta(row, result, model, v0):
    """Drifts of momenta of their size; the angular one over time as well."""
    linear, angular = float(np.linalg.norm(model.momenta(np.zeros(model.n), v0)[:2])), float(result["angular_momentum"][0])
    drifts = {"linear_drift": row["momentum_drift"] / linear, "angular_drift": row["angular_drift"] / abs(angular)}
    return drifts | {"angular": (result["angular_momentum"] - angular) / abs(angular)}
