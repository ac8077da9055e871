"""The rod of a slider crank: least mass at limited peak reaction, stress and torque, by its heights and thickness."""

import time

import numpy as np

import polyida as pi

CRANK, ROD, HEIGHT, SLIDER = 0.15, 0.3, 0.02, 0.5  # m, m, m, kg
UPPER = {"PeakReaction pin": 730.0, "PeakStress rod": 12e6, "PeakTorque drive": 60.0}  # N, Pa, N m
STATIONS = ("left", "middle", "right")
T_END, H = 0.3, 1e-3


def build(cells, **heights):
    """The model: a rigid crank at constant speed after a start, the rod, a mass on a rail; heights at three stations over the first."""
    mesh = pi.mesh.rectangle(ROD, HEIGHT, cells=cells, seed=1)
    x, y = mesh.points.T
    factor = np.interp(x, [0.0, 0.5 * ROD, ROD], [heights.get(name, 1.0) for name in STATIONS])
    scene = pi.Scene()
    crank = scene.add(pi.RigidBody(0.2, 1e-3, {"hub": (-CRANK, 0.0), "pin": (0.0, 0.0)}, center=(-0.5 * CRANK, 0.0), name="crank"))
    rod = scene.add(
        pi.Plate(pi.mesh.moved(mesh, np.stack([x, y * factor], axis=1)), pi.Material(2e9, 0.3, 1200.0, viscosity=2e-6), 0.01, name="rod")
    )
    scene.add(pi.Revolute(pi.ground, crank.at("hub"), name="hub"))
    scene.add(pi.AngleMotor(pi.ground, crank.at("hub"), angle=pi.profile.quintic(0.0, 4 * np.pi, T_END), name="drive"))
    scene.add(pi.Revolute(crank.at("pin"), rod.section("left"), name="pin"))
    scene.add(pi.Slot(pi.ground.at((ROD, 0.0), direction=(1.0, 0.0)), rod.section("right"), name="rail"))
    scene.add(pi.PointMass(rod.section("right"), SLIDER, name="slider"))
    return scene.build()


def moved(model):
    """The run."""
    return pi.solve(model, T_END, pi.GeneralizedAlpha(h=H, tolerance=1e-6))


def row(cells, effort):
    """One row: the least rod by thickness alone, and by thickness and heights together."""
    objectives = (
        pi.objective.PeakReaction("pin", p=12, unit="N"),
        pi.objective.PeakStress("rod", p=12),
        pi.objective.PeakTorque("drive", p=12),
    )
    limits = [pi.objective.Limit(one, upper) for one, upper in zip(objectives, UPPER.values())]
    first = 1e-2
    heights = [pi.design.Size(name, 0.4, 2.0, start=1.0, log=True) for name in STATIONS]
    case = pi.design.Case(lambda left=1.0, middle=1.0, right=1.0: build(cells, left=left, middle=middle, right=right), moved)
    result, begun = {}, (time.perf_counter(), time.process_time())
    evaluations = 6 if effort == "short" else 25
    stages = [pi.design.Stage(evaluations, move=0.4), pi.design.Stage(evaluations, move=0.2)]
    for way, more in (("thickness", []), ("heights", heights)):  # the second begins with the thickness that the first found
        variables = [pi.design.Size("rod.thickness", 2e-3, 2e-2, start=first, log=True), *more]
        design = pi.design.minimise(pi.objective.Mass("rod"), limits, variables, case, stages)
        first = design.values["rod.thickness"]
        result |= {f"mass_{way}": design.objective, f"excess_{way}": float(design.history["excess"].iloc[-1])}
        result |= {f"sizes_{way}": {name: float(value) for name, value in design.values.items()}}
        result |= {f"history_{way}": design.history["objective"].tolist(), f"message_{way}": design.message}
        result |= {f"limits_{way}": {name: value for name, (value, _) in design.limits.items()}}
    return result | {"wall_s": time.perf_counter() - begun[0], "cpu_s": time.process_time() - begun[1]}
