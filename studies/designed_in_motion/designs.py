"""The designs of a machine: in motion, by statics, and without optimisation; of equal mass, thresholded and simulated."""

import time
from functools import partial

import numpy as np

import polyida as pi
from designed_in_motion import optimiser, solids
from designed_in_motion.densities import Densities
from designed_in_motion.machines import MACHINES, THICKNESS

LOADS = {  # the motors held; N, m/s2
    "static, tip load": {"load": (0.0, -1.0), "gravity": (0.0, 0.0)},
    "static, tip load and weight": {"load": (0.0, -1.0), "gravity": (0.0, -1.0)},
}


def design(machine, design, cells, effort):
    """The row of a design: its optimisation, its densities, and its motion as solid plates.

    design: "in motion", one of LOADS, "uniform" (thinner plates of full size) or "bar" (narrower plates of full thickness). cells: of a
    plate; effort: a name of optimiser.MOTION.
    """
    which, volume = MACHINES[machine], optimiser.VOLUME
    meshes = [which.mesh(cells, which.height * (volume if design == "bar" else 1.0))] * len(which.names)
    if design in ("uniform", "bar"):
        thickness = solids.thickness_for(which, meshes, volume)
        return {"thickness": thickness} | solids.judged(which, solids.moved(which, meshes, thickness))
    result = optimised(which, design, meshes, optimiser.MOTION[effort])
    meshes, at, judged = solids.solid(which, meshes, result["rho"], volume)
    return result | {"at": at, "thickness": solids.thickness_for(which, meshes, volume)} | judged


def optimised(which, design, meshes, stages):
    """Densities of a design and how they came about; stages: of the one in motion."""
    densities, spent = Densities(which.names, meshes, which.radius), Spent()
    if design == "in motion":
        _, stages_of, history, reached = found_in_motion(which, meshes, densities, stages, spent)
    else:
        _, stages_of, history, reached = found_at_rest(which, meshes, densities, LOADS[design], optimiser.REST, spent)
    rho = stages_of[-1]
    return spent.as_row() | {
        "evaluations": len(history),
        "first": history[0],
        "grey_J": reached,
        "volume": float(densities.share @ rho),
        "grey": float(4.0 * densities.share @ (rho * (1.0 - rho))),
        "history": history,
        "stages": [each.tolist() for each in stages_of[:-1]],
        "rho": rho.tolist(),
    }


def found_at_rest(which, meshes, densities, load, stages, spent):
    """Result of the optimiser for the least compliance under a load, from uniform grey."""
    x = np.full(len(densities.share), optimiser.VOLUME)
    value = compiled(densities, x, *at_rest(which, meshes, load))
    with spent:
        return optimiser.minimised(densities, value, stages, x)


def found_in_motion(which, meshes, densities, stages, spent):
    """Result for the least deviation in motion, instead of the last stage at rest: from uniform grey the optimiser stays in a grey local
    minimum.

    The first stage starts from the designs of each load, the others from the better result.
    """
    rest = [found_at_rest(which, meshes, densities, load, optimiser.REST[:-1], spent) for load in LOADS.values()]
    ways = [(x, stages_of, [], reached) for x, stages_of, _, reached in rest]
    value = compiled(densities, ways[0][0], *in_motion(which, meshes))
    with spent:
        for stage in stages:
            ways = [joined(way, optimiser.minimised(densities, value, [stage], way[0])) for way in ways]
            ways = [min(ways, key=lambda way: way[-1])]
    return ways[0]


def joined(before, after):
    """Two successive searches as one."""
    return after[0], before[1] + after[1], before[2] + after[2], after[3]


def compiled(densities, x, model, judge):
    """Function of rho and q: objective and slopes; its kernels are compiled before time is measured."""
    value = partial(densities.evaluated, model, judge)
    value(densities.of(x, None)[0], optimiser.REST[0][0])
    return value


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
    """(model, function of a model: the gradient of the tip's deviation over the run)."""
    integrator, deviation = pi.GeneralizedAlpha(h=which.h, tolerance=1e-6), pi.objective.Deviation("tip", which.path)

    def judge(model):
        run = pi.solve(model, which.t_end, integrator)
        if run.status != "done":
            raise ArithmeticError(f"a run of the design stopped: {run.message}")
        return pi.gradient(run, deviation, factors(which))

    return which.scene(meshes, THICKNESS).build(), judge


def at_rest(which, meshes, load):
    """(model, function of a model: the gradient of the compliance under a load, the motors held)."""

    def judge(model):
        return pi.gradient(pi.static(model, linear=True), pi.objective.Compliance(), factors(which))

    return which.scene(meshes, THICKNESS, **load).build(), judge


def factors(which):
    """Names of the parameters of a design."""
    return [f"{name}.{what}" for name in which.names for what in ("stiffness", "mass")]
