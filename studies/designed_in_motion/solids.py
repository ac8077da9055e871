"""Designs as solid plates of equal mass, and their motion. Members thinner than a cell stay grey, so several thresholds are tried."""

import warnings

import numpy as np

import polyida as pi
from designed_in_motion.machines import KEPT, THICKNESS

FINER = 2.5  # times smaller steps than in the design
LEVELS = (0.7, 0.5, 0.35, 0.25, 0.15, 0.1, 0.05)  # densities from which a cell is solid


def solid(machine, meshes, rho, volume):
    """(meshes of the solid part of each plate, threshold, measures of the run): the one of LEVELS with the smallest objective."""
    result = [_solid(machine, meshes, rho, volume, at) for at in LEVELS]
    return min((one for one in result if one), key=lambda one: one[-1]["J"])


def _solid(machine, meshes, rho, volume, at):
    """The same for this threshold; None if a plate's end is not connected to its hinge, or too weakly."""
    solids = solid_meshes(meshes, rho, at)
    try:
        return solids and (solids, at, judged(machine, moved(machine, solids, thickness_for(machine, solids, volume))))
    except ArithmeticError:
        return None


def solid_meshes(meshes, rho, at):
    """The mesh of the largest connected part of each plate; None if one lacks one of the fixed sections."""
    parts = np.split(np.asarray(rho), np.cumsum([mesh.n_cells for mesh in meshes])[:-1])
    with warnings.catch_warnings(action="ignore", category=pi.mesh.MeshWarning):
        try:
            return [pi.design.threshold(mesh, part, at=at, keep=KEPT, hanging="leave out") for mesh, part in zip(meshes, parts)]
        except pi.InputError:
            return None


def thickness_for(machine, meshes, volume):
    """Thickness, m, at which plates on these meshes have the mass of plates of full size and `volume` of the thickness."""
    full = len(machine.names) * machine.height
    return THICKNESS * volume * full / sum(mesh.area for mesh in meshes)


def moved(machine, meshes, thickness):
    """The Trajectory of a machine with plates on these meshes."""
    model = machine.scene(meshes, thickness).build()
    run = pi.solve(model, machine.t_end, pi.GeneralizedAlpha(h=machine.h / FINER, tolerance=1e-6))
    if run.status != "done":
        raise ArithmeticError(f"the solid design stopped: {run.message}")
    return run


def judged(machine, run):
    """Distance of the tip from its path, and torques of the motors: means, peaks and histories."""
    off = np.linalg.norm(run.position("tip") - [machine.path(t) for t in run.t], axis=1)
    torque = np.array([run.reaction(name)[:, 0] for name in machine.motors])
    return {
        "J": pi.objective.Deviation("tip", machine.path)(run),
        "largest": float(off.max()),
        "after": float(off[run.t >= machine.move].max()),
        "torque": float(np.abs(torque).max()),
        "t": run.t.tolist(),
        "off": off.tolist(),
        "torques": torque.tolist(),
    }
