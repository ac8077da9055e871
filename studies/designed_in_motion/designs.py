"""The designs of a machine: in motion, by statics, and without optimisation; of equal mass, thresholded and simulated."""

import time

import numpy as np

import polyida as pi
from designed_in_motion import solids
from designed_in_motion.machines import KEPT, MACHINES, THICKNESS, VOLUME

LOADS = {  # the motors held; N, m/s2
    "static, tip load": {"load": (0.0, -1.0), "gravity": (0.0, 0.0)},
    "static, tip load and weight": {"load": (0.0, -1.0), "gravity": (0.0, -1.0)},
}
STAGE = pi.design.Stage
REST = (STAGE(20, 5.0), STAGE(16, 10.0, 4.0), STAGE(16, 20.0, 8.0), STAGE(16, 20.0, 16.0), STAGE(16, 20.0, 32.0))
MOTION = {"full": (STAGE(42, 20.0, 16.0), STAGE(42, 20.0, 32.0)), "short": (STAGE(16, 20.0, 16.0), STAGE(12, 20.0, 32.0))}


def design(machine, design, cells, effort):
    """The row of a design: its optimisation, its densities, and its motion as solid plates.

    design: "in motion", one of LOADS, "uniform" (thinner plates of full size) or "bar" (narrower plates of full thickness). cells: of a
    plate; effort: a name of MOTION.
    """
    which = MACHINES[machine]
    meshes = [which.mesh(cells, which.height * (VOLUME if design == "bar" else 1.0))] * len(which.names)
    if design in ("uniform", "bar"):
        thickness = solids.thickness_for(which, meshes, VOLUME)
        return {"thickness": thickness} | solids.judged(which, solids.moved(which, meshes, thickness))
    result = optimised(which, design, meshes, MOTION[effort])
    meshes, at, judged = solids.solid(which, meshes, result["rho"], VOLUME)
    return result | {"at": at, "thickness": solids.thickness_for(which, meshes, VOLUME)} | judged


def optimised(which, design, meshes, stages):
    """Densities of a design and how they came about; stages: of the one in motion."""
    spent = Spent()
    if design == "in motion":
        found = found_in_motion(which, meshes, stages, spent)
    else:
        with spent:
            found = searched(*at_rest(which, meshes, LOADS[design]), which, uniform(meshes), REST)
    moving = [one for one in found if type(one.problem.objective) is type(found[-1].problem.objective)]  # without the stages at rest
    stages_of, history = [densities_of(one) for one in found], [value for one in moving for value in one.history["objective"]]
    rho, areas = stages_of[-1], np.concatenate([mesh.cell_areas for mesh in meshes])
    return spent.as_row() | {
        "evaluations": len(history),
        "first": history[0],
        "grey_J": found[-1].objective,
        "volume": float(areas @ rho / areas.sum()),
        "grey": float(4.0 * areas @ (rho * (1.0 - rho)) / areas.sum()),
        "history": history,
        "stages": [each.tolist() for each in stages_of[:-1]],
        "rho": rho.tolist(),
    }


def densities_of(design):
    """The densities of all plates of a Design, plate by plate."""
    return np.concatenate(list(design.values.values()))


def uniform(meshes):
    """The variables of uniform grey."""
    return np.full(sum(mesh.n_cells for mesh in meshes), VOLUME)


def found_in_motion(which, meshes, stages, spent):
    """The Designs of the stages for the least deviation in motion, instead of the last stage at rest: from uniform grey the optimiser stays
    in a grey local minimum.

    The first stage starts from the designs of each load, the others from the better result.
    """
    motion = in_motion(which, meshes)
    with spent:
        ways = [searched(*at_rest(which, meshes, load), which, uniform(meshes), REST[:-1]) for load in LOADS.values()]
        for stage in stages:
            ways = [before + searched(*motion, which, before[-1].x, [stage]) for before in ways]
            ways = [min(ways, key=lambda way: way[-1].objective)]
    return ways[0]


def searched(objective, case, which, x, stages):
    """The Design of each stage, from variables x."""
    result = []
    for stage in stages:
        result.append(pi.design.minimise(objective, *bounded(which, case, x), [stage]))
        x = result[-1].x
    return result


def bounded(which, case, x):
    """(limit of the mass, variables that start at x, case) of a machine."""
    plates = [body for body in case.model.bodies if body.name in which.names]
    starts = np.split(x, np.cumsum([body.mesh.n_cells for body in plates])[:-1])
    variables = [pi.design.Densities(name, which.radius, KEPT, start) for name, start in zip(which.names, starts)]
    whole = sum(body.whole_mass for body in plates)
    void = variables[0].void
    limit = pi.objective.Limit(sum(pi.objective.Mass(name) for name in which.names), (void + (1.0 - void) * VOLUME) * whole)
    return [limit], variables, case


class Spent:
    """Total wall and CPU seconds within `with`."""

    def __init__(self):
        self.wall = self.cpu = 0.0

    def __enter__(self):
        self.begun = time.perf_counter(), time.process_time()

    def __exit__(self, *error):
        self.wall += time.perf_counter() - self.begun[0]
        self.cpu += time.process_time() - self.begun[1]

    def as_row(self):
        return {"wall_s": self.wall, "cpu_s": self.cpu}


def in_motion(which, meshes):
    """(deviation of the tip, Case of the run)."""
    integrator = pi.GeneralizedAlpha(h=which.h, tolerance=1e-6)
    case = pi.design.Case(which.scene(meshes, THICKNESS).build(), lambda model: pi.solve(model, which.t_end, integrator))
    return pi.objective.Deviation("tip", which.path), case


def at_rest(which, meshes, load):
    """(compliance under a load, Case of the equilibrium, the motors held)."""
    model = which.scene(meshes, THICKNESS, **load).build()
    return pi.objective.Compliance(), pi.design.Case(model, lambda model: pi.static(model, linear=True))
