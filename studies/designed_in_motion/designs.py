"""The designs of a machine: in motion, by statics, and none; each of the same mass, made solid and moved."""

import time
from functools import partial

import numpy as np

import polyida as pi
from designed_in_motion import optimiser, solids
from designed_in_motion.densities import Densities
from designed_in_motion.machines import MACHINES, THICKNESS

TIP = {"gravity": (0.0, 0.0), "load": (0.0, -1.0)}  # of the motors held, 1 N
LOADS = {"static, tip load": TIP, "static, tip load and weight": TIP | {"gravity": (0.0, -1.0)}}


def design(machine, design, cells, effort):
    """The row of a design: how it was found, its densities, and how it moves as solid plates.

    design: "in motion", one of LOADS, "uniform" (plates of full size that are thinner) or "bar" (of full thickness that are narrower). cells: of
    a plate; effort: a name of optimiser.MOTION.
    """
    which, volume = MACHINES[machine], optimiser.VOLUME
    meshes = [which.mesh(cells, which.height * (volume if design == "bar" else 1.0))] * len(which.names)
    found = {}
    if design not in ("uniform", "bar"):
        found = optimised(which, design, meshes, optimiser.MOTION[effort])
        meshes, found["at"] = solids.solid_meshes(meshes, found["rho"], volume)
    thickness = solids.thickness_for(which, meshes, volume)
    run = solids.moved(which, meshes, thickness)
    return found | {"thickness": thickness} | solids.judged(which, run)


def optimised(which, design, meshes, stages):
    """Densities of a design and how they came about; stages: of the one in motion.

    One in motion takes the place of the last stage at rest, under a load on the tip: from grey alone it gets stuck in grey.
    """
    densities = Densities(which.names, meshes, which.radius)
    x, spent = np.full(len(densities.share), optimiser.VOLUME), Spent()
    kept, history = [densities.of(x, None)[0]], []
    ways = [(optimiser.REST, at_rest(which, meshes, LOADS.get(design, TIP)))]
    if design == "in motion":
        ways = [(optimiser.REST[:-1], ways[0][1]), (stages, in_motion(which, meshes))]
    for steps, (model, judge) in ways:
        value = partial(densities.evaluated, model, judge)
        value(kept[0], optimiser.REST[0][0])  # kernels are compiled before the clock starts
        with spent:
            x, rhos, history = optimiser.minimised(densities, value, steps, x)
        kept += rhos
    rho = kept[-1]
    return spent.told() | {
        "evaluations": len(history),
        "first": history[0],
        "grey_J": history[-1],
        "volume": float(densities.share @ rho),
        "grey": float(4.0 * densities.share @ (rho * (1.0 - rho))),
        "history": history,
        "stages": [each.tolist() for each in kept[:-1]],
        "rho": rho.tolist(),
    }


class Spent:
    """Wall and CPU seconds within `with`, in all."""

    def __init__(self):
        self.wall = self.cpu = 0.0

    def __enter__(self):
        self.begun = time.perf_counter(), time.process_time()

    def __exit__(self, *error):
        self.wall += time.perf_counter() - self.begun[0]
        self.cpu += time.process_time() - self.begun[1]

    def told(self):
        return {"wall_s": self.wall, "cpu_s": self.cpu}


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
