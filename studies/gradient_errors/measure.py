"""Gradients of runs at one Newton tolerance compared with finite differences of the same steps at a small one, by kinds of parameters."""

from functools import lru_cache

import numpy as np

import polyida as pi
from polyida.adjoint.parameters import parameters_of
from polyida.problems.plates import double_plate, double_plate_motors

TIGHT = 1e-12  # Newton's tolerance of the runs that differences are made of
LITTLE = 1e-3  # of J: what J changes by with a whole parameter, below which that is no measure of errors
STEP = 1e-3  # of a parameter, between the runs of a difference
KINDS = {  # endings of parameters' names
    "stiffness": (".stiffness",),
    "mass": (".mass",),
    "plate": (".E", ".thickness", ".rho"),
    "load": (".force", ".traction", ".amplitude", ".frequency"),
    "motor": (".end", ".duration"),
}
H = 2e-3  # s


def slewing_arm(cells):
    """A damped plate, virtual elements, that a motor turns within 0.08 s while a load shakes its tip."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    material = pi.Material(E=3e8, nu=0.3, rho=1100.0, viscosity=1e-4, mass_damping=0.5)
    arm = scene.add(pi.Plate(pi.mesh.rectangle(1.0, 0.25, cells=cells, seed=1), material, 0.01, name="arm", element="virtual"))
    scene.add(pi.Revolute(pi.ground, arm.section("left"), name="shoulder"))
    scene.add(pi.AngleMotor(pi.ground, arm.section("left"), pi.profile.quintic(0.0, 0.6, duration=0.0811), name="shoulder motor"))
    scene.add(pi.PointMass(arm.section("right"), 0.05, name="tip"))
    scene.add(pi.PointLoad(arm.section("right"), (5.0, 20.0), pi.profile.sine(1.0, 25.0), name="push"))
    return scene


SCENES = {"scene 1": double_plate, "scene 2": double_plate_motors, "slewing arm": slewing_arm}
OBJECTIVES = {
    "deviation": lambda model: pi.objective.Deviation("tip", lambda t: (1.0, 0.2)),
    "strain energy": lambda model: pi.objective.StrainEnergy(model.bodies[0].name),
    "peak reaction": lambda model: pi.objective.PeakReaction("shoulder", p=8),
    "peak stress": lambda model: pi.objective.PeakStress(model.bodies[0].name, p=8),
    "acceleration": lambda model: pi.objective.UserObjective(lambda run: float((run.a[1:] ** 2).mean()), _slopes_of_acceleration),
}


def _slopes_of_acceleration(run):
    slopes = 2.0 * np.array(run.a) / run.a[1:].size
    slopes[0] = 0.0
    return {"a": slopes}


@lru_cache(maxsize=1)
def setting(scene, cells):
    """(model, its objectives by name) of a scene with about so many polygons a plate."""
    model = SCENES[scene](cells).build()
    return model, {name: make(model) for name, make in OBJECTIVES.items()}


@lru_cache(maxsize=1)
def run_at(scene, cells, t_end, tolerance):
    """The run; tolerance None: the default, by the local error."""
    return pi.solve(setting(scene, cells)[0], t_end, pi.GeneralizedAlpha(h=H, tolerance=tolerance))


@lru_cache(maxsize=1)
def differences(scene, cells, t_end):
    """{parameter: (way, {objective: change of J along it})}, of fourth order, of runs at a tight tolerance."""
    model, objectives = setting(scene, cells)
    result = {}
    for name, parameter in parameters_of(model).items():
        if parameter.only_by_name or not kind_of(name):
            continue
        way = np.abs(parameter.value) if np.ndim(parameter.value) else abs(parameter.value)
        runs = {s: _changed(parameter, s * STEP * way, t_end) for s in (-2, -1, 1, 2)}
        values = {s: {each: objective(run) for each, objective in objectives.items()} for s, run in runs.items()}
        change = {
            each: (8 * (values[1][each] - values[-1][each]) - values[2][each] + values[-2][each]) / (12 * STEP) for each in objectives
        }
        result[name] = way, change
    return result


def _changed(parameter, change, t_end):
    return pi.solve(parameter.replaced(parameter.value + change), t_end, pi.GeneralizedAlpha(h=H, tolerance=TIGHT))


def kind_of(name):
    """The kind of a parameter, or None."""
    return next((kind for kind, endings in KINDS.items() if name.endswith(endings)), None)


def error_row(scene, objective, tolerance, cells, t_end):
    """Largest relative error of the slopes of each kind, relative to the difference or to J over a thousand parameters, whichever is
    larger.
    """
    run, (_, objectives) = run_at(scene, cells, t_end, tolerance), setting(scene, cells)
    result, errors = pi.gradient(run, objectives[objective]), {}
    for name, (way, change) in differences(scene, cells, t_end).items():
        apart = abs(float(np.sum(result[name] * way)) - change[objective])
        error = apart / max(abs(change[objective]), LITTLE * abs(result.value))
        errors[kind_of(name)] = max(error, errors.get(kind_of(name), 0.0))
    iterations = run.counts.newton_iterations / run.counts.steps
    return {"n": run.model.n, "steps": run.counts.steps, "iterations": iterations, **errors, "slope_error": max(errors.values())}
