"""Designs as solid plates of equal mass, and how they move."""

import warnings

import numpy as np

import polyida as pi
from designed_in_motion.machines import KEPT, THICKNESS

FINER = 2.5  # times smaller steps than in the design
LOWER, LEAST = 0.95, 0.05  # of a density that makes solid


def solid_meshes(meshes, rho, volume):
    """(mesh of what is solid of each plate, the least density that is solid).

    That density gives the volume, or is as much lower, in parts of LOWER, as it takes to hold each plate's end to its hinge.
    """
    rho, areas = np.asarray(rho), np.concatenate([mesh.cell_areas for mesh in meshes])
    order = np.argsort(-rho, kind="stable")
    at = rho[order][np.searchsorted(np.cumsum(areas[order]), volume * areas.sum())]
    ends = np.cumsum([mesh.n_cells for mesh in meshes])[:-1]
    while True:
        try:
            return [_solid(mesh, part, at) for mesh, part in zip(meshes, np.split(rho, ends))], float(at)
        except pi.InputError:
            if at < LEAST:
                raise
            at *= LOWER


def _solid(mesh, rho, at):
    """The mesh of the largest piece; InputError where it has not both of the kept sections."""
    with warnings.catch_warnings(action="ignore", category=pi.mesh.MeshWarning):
        return pi.design.threshold(mesh, rho, at=at, keep=KEPT, hanging="leave out")


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
    """How far the tip is from its path, and the torque of the motors: means, peaks and histories."""
    off = np.linalg.norm(run.position("tip") - [machine.path(t) for t in run.t], axis=1)
    torque = np.array([run.reaction(name)[:, 0] for name in machine.motors])
    return {
        "J": pi.objective.Deviation("tip", machine.path)(run),
        "largest": float(off.max()),
        "torque": float(np.abs(torque).max()),
        "t": run.t.tolist(),
        "off": off.tolist(),
        "torques": torque.tolist(),
    }
