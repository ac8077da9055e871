"""Compile the kernels that many tests need: `python warm_up.py name` for a name of METHODS, or "own".

A process that compiles a kernel first compiles all that it is made of, which takes longer than the rest, and keeps memory until its end.
"""

import sys
from itertools import product

import polyida as pi

ALPHA, RADAU = pi.GeneralizedAlpha(h=1e-3), pi.RadauIIA()
METHODS = {  # one process each: they take about as long as each other
    "alpha": [ALPHA, pi.EnergyMomentum(h=1e-3), pi.GeneralizedAlpha(h=1e-3, form="stabilised"), pi.IDA()],
    "radau": [RADAU, pi.RadauIIA(form="index3"), pi.RadauIIA(stages=2)],
}


def model(level):
    """A plate on a pin that falls, full or rigid."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    plate = pi.Plate(pi.mesh.rectangle(0.4, 0.1, cells=4), pi.Material(5e7, 0.3, 1100.0), 0.01, name="plate")
    scene.add(level(plate) if level else plate)
    scene.add(pi.Revolute(pi.ground, scene.parts["plate"].section("left")))
    return scene.build()


def of_a_user():
    """Short runs of a model that is no scene."""
    pendulum = pi.problems.get("pendulum").model
    for integrator in (ALPHA, pi.IDA()):
        assert pi.solve(pendulum, 2e-3, integrator, q0=[-1.0, 0.0]).success


def of_scenes(name):
    """Short runs of all methods of a name."""
    for integrator, level in product(METHODS[name], (None, pi.Rigid)):
        run = pi.solve(model(level), 2e-3, integrator)
        assert run.success and run.counts.newton_iterations, "a plate that stays at rest needs no kernel"
        if integrator in (ALPHA, RADAU) and level is None:
            pi.gradient(run, pi.objective.StrainEnergy("plate"))


if __name__ == "__main__":
    name = sys.argv[1]
    of_a_user() if name == "own" else of_scenes(name)
