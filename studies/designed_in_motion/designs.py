"""The designs of a machine: in motion, by statics, and none; each of the same mass, made solid and moved."""

import time

import numpy as np

import polyida as pi
from designed_in_motion import optimiser, solids
from designed_in_motion.densities import Densities
from designed_in_motion.machines import MACHINES, THICKNESS

LOADS = {"static, tip load": {"gravity": (0.0, 0.0), "load": (0.0, -1.0)}, "static, own weight": {"gravity": (0.0, -1.0)}}


def design(machine, design, cells, stages):
    """The row of a design: how it was found, its densities, and how it moves as solid plates.

    design: "in motion", one of LOADS, "uniform" (plates of full size that are thinner) or "bar" (of full thickness that are narrower). cells: of
    a plate; stages: [(beta, evaluations), ...] of the optimiser.
    """
    which, volume = MACHINES[machine], optimiser.VOLUME
    meshes = [which.mesh(cells, which.height * (volume if design == "bar" else 1.0))] * len(which.names)
    found = {}
    if design not in ("uniform", "bar"):
        found = optimised(which, design, meshes, stages)
        meshes, found["at"] = solids.solid_meshes(meshes, found["rho"], volume)
    thickness = solids.thickness_for(which, meshes, volume)
    run = solids.moved(which, meshes, thickness)
    return found | {"thickness": thickness} | solids.judged(which, run)


def optimised(which, design, meshes, stages):
    """Densities of a design and how they came about; kernels are compiled before the clock starts."""
    densities = Densities(which.names, meshes, which.radius)
    model, judge = in_motion(which, meshes) if design == "in motion" else at_rest(which, meshes, LOADS[design])
    clock = Clock(lambda rho: densities.evaluated(model, rho, judge))
    clock(np.full(len(densities.share), optimiser.VOLUME))
    clock.seconds = 0.0
    wall, cpu = time.perf_counter(), time.process_time()
    kept, history = optimiser.minimised(densities, clock, stages)
    spent = {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu, "evaluation_s": clock.seconds}
    rho = kept[-1]
    return spent | {
        "evaluations": len(history),
        "first": history[0],
        "grey_J": min(history[-stages[-1][1] :]),
        "volume": float(densities.share @ rho),
        "grey": float(4.0 * densities.share @ (rho * (1.0 - rho))),
        "history": history,
        "stages": [each.tolist() for each in kept[:-1]],
        "rho": rho.tolist(),
    }


class Clock:
    """A function with the seconds that were spent in it."""

    def __init__(self, function):
        self.function, self.seconds = function, 0.0

    def __call__(self, *given):
        begin = time.perf_counter()
        try:
            return self.function(*given)
        finally:
            self.seconds += time.perf_counter() - begin


def in_motion(which, meshes):
    """(model, function of a model: the gradient of the tip's deviation over the run)."""
    integrator, deviation = pi.GeneralizedAlpha(h=which.h, tolerance=1e-6), pi.objective.Deviation("tip", which.path)

    def judge(model):
        run = pi.solve(model, which.t_end, integrator)
        if run.status != "done":
            raise ArithmeticError(f"a run of the design stopped: {run.message}")
        return pi.gradient(run, deviation)

    return which.scene(meshes, THICKNESS).build(), judge


def at_rest(which, meshes, load):
    """(model, function of a model: the gradient of the compliance under a load, the motors held)."""
    compliance = pi.objective.Compliance()
    return which.scene(meshes, THICKNESS, **load).build(), lambda model: pi.gradient(pi.static(model, linear=True), compliance)
