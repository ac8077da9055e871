"""The slewing arm of designed_in_motion: least mass at limited tracking error, peak torque and peak stress."""

import time
import warnings
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

import polyida as pi
from designed_in_motion.machines import KEPT, MACHINES
from polyida.design.solid import KEPT as KEPT_SOLID

ARM = replace(MACHINES["arm"], radius=0.05)  # of the filter, m, the same for all meshes
UPPER = {"Deviation tip": 4e-5, "PeakTorque arm motor": 80.0, "PeakStress arm": 1e6}  # m2, N m, Pa
LOADS = {"tip load": ((0.0, -1.0), (0.0, 0.0)), "tip load and weight": ((0.0, -1.0), (0.0, -1.0))}  # N, m/s2
VOLUME = {"full": (0.5, (0.05, 0.025, 0.0125, 0.00625)), "short": (0.5, ())}  # of static designs: the first, and the steps of its search
CHANGES = {"full": 150, "short": 20}  # of solid designs, at most
STAGE = pi.design.Stage
REST = (STAGE(20, 5.0), STAGE(14, 10.0, 2.0), STAGE(14, 15.0, 4.0), STAGE(16, 20.0, 8.0), STAGE(16, 20.0, 16.0))
NEAR = {  # then, in motion or not; larger moves exceed the limits and end with heavier designs
    "full": (STAGE(8, 20.0, 16.0, move=0.2),) * 5 + (STAGE(8, 20.0, 32.0, move=0.1),) * 6,
    "short": (STAGE(7, 20.0, 16.0, move=0.2),) * 2 + (STAGE(5, 20.0, 32.0, move=0.1),) * 2,
}
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


def limits():
    """The limits of the motion."""
    objectives = (pi.objective.Deviation("tip", ARM.path), pi.objective.PeakTorque("arm motor", p=12), pi.objective.PeakStress("arm", p=12))
    return [pi.objective.Limit(one, upper) for one, upper in zip(objectives, UPPER.values())]


def static_design(mesh, load, volume, stages, start=None):
    """The Design of least compliance under a load, with a share `volume` of the arm's mass."""
    force, gravity = LOADS[load]
    model = ARM.scene([mesh], gravity=gravity, load=force).build()
    whole = pi.objective.Mass("arm")(at_rest(model))
    variable = pi.design.Densities("arm", ARM.radius, KEPT, volume if start is None else start)
    limit = pi.objective.Limit(pi.objective.Mass("arm"), volume * whole)
    return quietly(pi.objective.Compliance(), [limit], [variable], pi.design.Case(model, at_rest), stages)


def moving_design(mesh, start, stages):
    """The Design of least mass within the limits of the motion, from variables `start`."""
    model = ARM.scene([mesh]).build()
    variable = pi.design.Densities("arm", ARM.radius, KEPT, start)
    return quietly(pi.objective.Mass("arm"), limits(), [variable], pi.design.Case(model, in_motion), stages)


def quietly(*arguments):
    """`minimise` without the words on limits that the start exceeds: the rows have them."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return pi.design.minimise(*arguments)


def judged(design, effort="short", changes=0, mesh=None):
    """The SolidDesign by the limits of the motion: of a level, or on a mesh."""
    others = OTHERS if effort == "full" else {"smaller steps": OTHERS["smaller steps"]}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # the rows have what exceeds limits
        solid = pi.design.solid(
            design,
            lambda arm: ARM.scene([arm if mesh is None else mesh]).build(),
            others={name: lambda model, integrator=integrator: in_motion(model, integrator) for name, integrator in others.items()},
            changes=changes,
            **({} if mesh is None else {"levels": [0.0]}),
        )
    return solid if mesh is None else replace(solid, meshes={"arm": mesh})


def lightest(mesh, load, effort):
    """(volume, its `judged_static`) of the lightest solid static design that keeps the limits within 3 %: a pattern search over volumes."""
    best, steps = VOLUME[effort]
    known = {best: judged_static(mesh, load, best, effort)}
    for step in steps:
        for volume in (round(best - step, 6), round(best + step, 6)):
            if volume not in known:
                known[volume] = judged_static(mesh, load, volume, effort)
        best = min(known, key=lambda one: merit(known[one][1]))
    return best, known[best]


def merit(solid):
    """Limits first, then the mass."""
    return max(solid.excess, KEPT_SOLID), solid.table.loc["objective", "solid"]


def judged_static(mesh, load, volume, effort):
    """(Design by the limits of the motion, SolidDesign) of the least compliance: of a level, or moved on by cells to less compliance at its mass."""
    rest = static_design(mesh, load, volume, REST + NEAR[effort])
    variable, case = pi.design.Densities("arm", ARM.radius, KEPT), pi.design.Case(ARM.scene([mesh]).build(), in_motion)
    moving = pi.design.Problem(pi.objective.Mass("arm"), limits(), [variable], case)
    found = moving.evaluate(rest.x, rest.sharp)
    kept = {label: (float(value), limit.upper) for label, value, (limit, _) in zip(moving.labels, found.largest[1:], moving.held)}
    design = replace(rest, problem=moving, objective=float(found.values[0]), limits=kept)
    force, gravity = LOADS[load]
    still = pi.design.solid(rest, lambda arm: ARM.scene([arm], gravity=gravity, load=force).build(), changes=CHANGES[effort])
    return design, min((judged(design), judged(design, mesh=still.meshes["arm"])), key=merit)


def nearest(mesh, solid):
    """The numbers of the cells of a solid mesh in the mesh that it was taken from."""
    return cKDTree(mesh.cell_centroids).query(solid.cell_centroids)[1].tolist()


def row(cells, way, effort, load="tip load and weight", volume=0.5):
    """One row: a design in motion that begins with the static one of a load and volume, or the lightest static design under that load."""
    mesh, begun = ARM.mesh(cells), (time.perf_counter(), time.process_time())
    history, excesses = [], []
    if way == "in motion":
        design = moving_design(mesh, static_design(mesh, load, volume, REST).x, NEAR[effort])
        history, excesses = (design.history[name].tolist() for name in ("objective", "excess"))
        solid = judged(design, effort, changes=CHANGES[effort])
    else:
        volume, (design, solid) = lightest(mesh, load, effort)
    spent = time.perf_counter() - begun[0], time.process_time() - begun[1]
    names = dict(zip(solid.table.index, ("mass", "deviation", "torque", "stress")))
    rho = np.asarray(design.values["arm"])
    return {
        **{f"{name}_{column}": float(value) for column in solid.table for name, value in zip(names.values(), solid.table[column])},
        "volume_found": volume,
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
