"""The slewing arm of designed_in_motion: least mass at limited tracking error, peak torque and peak stress."""

import time
import warnings
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

import polyida as pi
from designed_in_motion.machines import KEPT, MACHINES

ARM = MACHINES["arm"]
TORQUE, STRESS = 80.0, 1e6  # limits, N m, Pa; that of the deviation varies: its least value of static designs hardly falls with their mass
LOADS = {"tip load": ((0.0, -1.0), (0.0, 0.0)), "tip load and weight": ((0.0, -1.0), (0.0, -1.0))}  # N, m/s2
CHANGES = {"full": 150, "short": 20}  # of solid designs, at most
STAGE = pi.design.Stage
REST = (STAGE(20, 5.0), STAGE(14, 10.0, 2.0), STAGE(14, 15.0, 4.0), STAGE(16, 20.0, 8.0), STAGE(16, 20.0, 16.0))
NEAR = {"full": (STAGE(8, 20.0, 16.0, move=0.2),) * 2 + (STAGE(8, 20.0, 32.0, move=0.1),) * 2}  # the end of static designs
NEAR["short"] = NEAR["full"][::2]
MOTION = {"full": (STAGE(25, 20.0, 8.0), STAGE(25, 20.0, 16.0), STAGE(20, 20.0, 32.0))}
MOTION["short"] = (STAGE(15, 20.0, 8.0), STAGE(10, 20.0, 32.0))
OTHERS = {  # the solid design once more
    "smaller steps": pi.GeneralizedAlpha(h=ARM.h / 2.5, tolerance=1e-6),
    "RadauIIA": pi.RadauIIA(rtol=1e-4),
    "IDA": pi.IDA(rtol=1e-5),
    "EnergyMomentum": pi.EnergyMomentum(h=ARM.h / 2.5),
}


def in_motion(model, integrator=None):
    """The run of the arm."""
    return pi.solve(model, ARM.t_end, integrator or pi.GeneralizedAlpha(h=ARM.h, tolerance=1e-6))


def at_rest(model):
    """The equilibrium of the arm, its motor held."""
    return pi.static(model, linear=True)


def limits(deviation):
    """The limits of the motion."""
    objectives = (pi.objective.Deviation("tip", ARM.path), pi.objective.PeakTorque("arm motor", p=12), pi.objective.PeakStress("arm", p=12))
    return [pi.objective.Limit(one, upper) for one, upper in zip(objectives, (deviation, TORQUE, STRESS))]


def held(load):
    """A function that builds the arm's model on a mesh with its motor held, under a load."""
    force, gravity = LOADS[load]
    return lambda arm: ARM.scene([arm], gravity=gravity, load=force).build()


def static_design(mesh, load, volume, stages):
    """The Design of least compliance under a load, with a share `volume` of the arm's mass."""
    model = held(load)(mesh)
    whole = pi.objective.Mass("arm")(at_rest(model))
    variable = pi.design.Densities("arm", ARM.radius, KEPT, volume)
    limit = pi.objective.Limit(pi.objective.Mass("arm"), volume * whole)
    return quietly(pi.objective.Compliance(), [limit], [variable], pi.design.Case(model, at_rest), stages)


def in_limits(mesh, start, deviation):
    """The objective, limits, variables and case of the least mass in motion."""
    variable = pi.design.Densities("arm", ARM.radius, KEPT, start)
    return pi.objective.Mass("arm"), limits(deviation), [variable], pi.design.Case(ARM.scene([mesh]).build(), in_motion)


def quietly(*arguments):
    """`minimise` without the words on limits that the start exceeds: the rows have them."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return pi.design.minimise(*arguments)


def judged(design, effort, **how):
    """The SolidDesign by the limits of the motion; how: more arguments of `pi.design.solid`."""
    others = OTHERS if effort == "full" else {"smaller steps": OTHERS["smaller steps"]}
    runs = {name: lambda model, integrator=integrator: in_motion(model, integrator) for name, integrator in others.items()}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # the rows have what exceeds limits
        return pi.design.solid(design, lambda arm: ARM.scene([arm]).build(), others=runs, **how)


def judged_static(rest, mesh, load, deviation, effort):
    """(Design by the limits of the motion, SolidDesign) of a static Design: of a level, or moved on by cells to less compliance at its mass."""
    moving = pi.design.Problem(*in_limits(mesh, rest.x, deviation))
    found = moving.evaluate(rest.x, rest.sharp)
    kept = {label: (float(value), limit.upper) for label, value, (limit, _) in zip(moving.labels, found.largest[1:], moving.held)}
    still = pi.design.solid(rest, held(load), changes=CHANGES[effort])
    design = replace(rest, problem=moving, objective=float(found.values[0]), limits=kept)
    return design, judged(design, effort, start=still.meshes)


def nearest(mesh, solid):
    """The numbers of the cells of a solid mesh in the mesh that it was taken from."""
    return cKDTree(mesh.cell_centroids).query(solid.cell_centroids)[1].tolist()


def row(cells, way, effort, deviation, load="tip load and weight", volume=0.5):
    """One row: a static design, or the one in motion that begins there; `deviation` is the limit, of static designs only for what is reported."""
    mesh, begun = ARM.mesh(cells), (time.perf_counter(), time.process_time())
    history, excesses = [], []
    if way == "in motion":
        rest = static_design(mesh, load, volume, REST[:4])
        design = quietly(*in_limits(mesh, rest.x, deviation), MOTION[effort])
        history, excesses = (design.history[name].tolist() for name in ("objective", "excess"))
        start = pi.design.solid(static_design(mesh, load, volume, REST), held(load)).meshes
        solid = judged(design, effort, changes=CHANGES[effort], start=start)
    else:
        design, solid = judged_static(static_design(mesh, load, volume, REST + NEAR[effort]), mesh, load, deviation, effort)
    spent = time.perf_counter() - begun[0], time.process_time() - begun[1]
    names = dict(zip(solid.table.index, ("mass", "deviation", "torque", "stress")))
    rho = np.asarray(design.values["arm"])
    return {
        **{f"{name}_{column}": float(value) for column in solid.table for name, value in zip(names.values(), solid.table[column])},
        "excess": solid.excess,
        "at": solid.at,
        "grey": float(4.0 * (mesh.cell_areas / mesh.area) @ (rho * (1.0 - rho))),
        "evaluations": len(history),
        "history": history,
        "excesses": excesses,
        "rho": rho.tolist(),
        "solid": nearest(mesh, solid.meshes["arm"]),
        "wall_s": spent[0],
        "cpu_s": spent[1],
        "message": design.message,
    }
