"""Estimated and measured errors of quantities of runs: of time steps, meshes and modes, of falling pendulums and of random scenes."""

import time
from functools import lru_cache

import numpy as np

import polyida as pi
from polyida import profile
from polyida.problems.mechanisms import slider_crank
from polyida.problems.plates import double_plate

P = pi.objective
TIGHT = 1e-10  # Newton's tolerance
FACTOR = 1.5  # by which a trusted estimate may be wrong
FINER = 8  # steps of the coarser of the two runs that a reference is extrapolated from, in a step of the finest run
STEPS = {"slider crank": (4e-3, 2e-3, 1e-3, 5e-4), "damped arm": (5e-3, 2.5e-3, 1.25e-3), "double plate": (4e-3, 2e-3, 1e-3, 5e-4)}
CELLS = {"double plate": (60, 120, 240), "broad arm": (60, 120, 240)}
MODES = (3, 5, 10)
FALLS = {"rho_inf": (0.9, 0.5), "h": (5e-3, 1e-2, 2e-2, 4e-2), "t_end": (0.2, 0.4, 0.6, 0.8, 1.0, 1.2, 1.4, 1.6, 2.0)}
NOTCH = [(0.35, 0.125), (0.35, 0.125 - 0.15), (0.3, 0.125 - 0.15), (0.3, 0.125)]  # m
NOTCHED = pi.mesh.Outline([(0.0, -0.125), (1.0, -0.125), (1.0, 0.125), *NOTCH, (0.0, 0.125)])
FINEST = 6  # refinements of the finest mesh of the notched arm


def at_end(model, name="q"):
    """x of "tip", or the first multiplier, at the end."""
    weights = np.array([model.displacement("tip", unit)[0] for unit in np.eye(model.n)]) if name == "q" else np.eye(model.m)[0]

    def slopes(run):
        result = np.zeros(getattr(run, name).shape)
        result[-1] = weights
        return {name: result}

    return P.UserObjective(lambda run: float(weights @ getattr(run, name)[-1]), slopes)


def crank():
    """A slider crank of rigid links, driven by a torque with kinks."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    for name, part in slider_crank("rigid").parts.items():
        if name != "drive":
            scene.add(part)
    scene.add(pi.Torque(scene.parts["crank"].section("left"), profile.linear(0.0, 0.3, duration=0.2, begin=0.1), name="drive"))
    scene.add(pi.PointMass(scene.parts["rod"].section("right"), 0.01, name="tip"))
    return scene


def arm(height=0.1, cells=60, viscosity=2e-3, body=lambda plate: plate, mass=0.3, mesh=None):
    """A plate that a motor turns by 90 degrees within 0.5 s."""
    mesh = pi.mesh.rectangle(1.0, height, cells=cells, seed=1) if mesh is None else mesh
    scene, material = pi.Scene(gravity=(0.0, -9.81)), pi.Material(E=50e6, nu=0.3, rho=1100.0, viscosity=viscosity)
    plate = scene.add(body(pi.Plate(mesh, material, thickness=0.01, name="upper")))
    scene.add(pi.Revolute(pi.ground, plate.section("left"), name="shoulder"))
    scene.add(pi.AngleMotor(pi.ground, plate.section("left"), profile.quintic(0.0, np.pi / 2, duration=0.5), name="motor"))
    scene.add(pi.PointMass(plate.section("right"), mass, name="tip"))
    return scene


SCENES = {
    "slider crank": (crank, 0.4, "crank pin"),
    "damped arm": (arm, 0.8, "shoulder"),
    "double plate": (lambda: double_plate(60), 1.0, "elbow"),
}


@lru_cache(maxsize=4)
def setting(scene):
    """(model, end of the run, {name: objective})."""
    make, t_end, joint = SCENES[scene]
    model = make().build()
    result = {"mean place": P.Deviation("tip", (30.0, 0.0)), "mean lam^2": P.PeakReaction(joint, p=2)}
    result |= {"mean strain energy": P.StrainEnergy("upper")} if model.bodies else {"peak reaction": P.PeakReaction("bearing", p=8)}
    result |= {"place at the end": at_end(model), "lam at the end": at_end(model, "lam")}
    return model, t_end, result


def reference(model, t_end, objectives, h, **settings):
    """{name: value}, extrapolated from runs with steps of h and h / 2."""
    coarse, fine = (pi.solve(model, t_end, pi.GeneralizedAlpha(h=step, tolerance=TIGHT, **settings)) for step in (h, h / 2))
    return {name: (4 * each(fine) - each(coarse)) / 3 for name, each in objectives.items()}


@lru_cache(maxsize=4)
def known(scene):
    """The reference values of a scene."""
    model, t_end, objectives = setting(scene)
    return reference(model, t_end, objectives, min(STEPS[scene]) / FINER)


def row(value, bars, part, **more):
    """A row of an estimate of one part."""
    estimate, error = getattr(bars, part), value - bars.value
    trusted = not bars.reasons.get(part)
    ratio = estimate / error if error else float("nan")
    outside = not 1 / FACTOR <= ratio <= FACTOR
    result = {"exact_error": error, "estimate": estimate, "ratio": ratio, "trusted": trusted, "outside": outside}
    return result | {"fast_share": bars.fast_share} | more


def time_row(scene, h, objective):
    """Error of time of a scene, and the cost of its estimate over that of the gradient, in CPU time."""
    model, t_end, objectives = setting(scene)
    run, one = pi.solve(model, t_end, pi.GeneralizedAlpha(h=h, tolerance=TIGHT)), objectives[objective]
    seconds = []
    for function in (pi.gradient, pi.error_of):
        begin = time.process_time()
        bars = function(run, one)
        seconds.append(time.process_time() - begin)
    return row(known(scene)[objective], bars, "time", cost=seconds[1] / seconds[0], steps=run.steps)


@lru_cache(maxsize=12)
def mesh_run(scene, cells):
    """A run on a mesh."""
    model = (double_plate(cells) if scene == "double plate" else arm(0.25, cells, 1e-3)).build()
    return pi.solve(model, 0.3, pi.GeneralizedAlpha(h=4e-3, tolerance=1e-8))


def mesh_row(scene, cells, objective):
    """Error of the meshes; the reference is extrapolated from 480 and 960 cells."""
    one = {"mean place": P.Deviation("tip", (30.0, 0.0)), "mean strain energy": P.StrainEnergy()}[objective]
    value = 2 * one(mesh_run(scene, 960)) - one(mesh_run(scene, 480))
    return row(value, pi.error_of(mesh_run(scene, cells), one), "mesh")


def notched_bars(mesh):
    """The ErrorBars of an arm with a notch: the stress at its two sharp corners is singular."""
    run = pi.solve(arm(viscosity=1e-3, mesh=mesh).build(), 0.3, pi.GeneralizedAlpha(h=1e-2, tolerance=1e-8))
    return pi.error_of(run, P.Deviation("tip", (30.0, 0.0)))


@lru_cache
def adapted(refinements):
    """(mesh, its ErrorBars): 60 cells, each time refined in the quarter of the cells with the largest shares."""
    if refinements:
        coarser, bars = adapted(refinements - 1)
        mesh = pi.mesh.refine(coarser, np.argsort(np.abs(bars.cells["upper"]))[-(coarser.n_cells // 4) :])
    else:
        mesh = pi.mesh.polygonize(NOTCHED, cells=60, seed=1)
    return mesh, notched_bars(mesh)


@lru_cache
def uniform_error(cells):
    """Error of a mesh of equal cells beside the value of the mesh that is refined most, corrected by its own estimate."""
    finest = adapted(FINEST)[1]
    return finest.value + finest.mesh - notched_bars(pi.mesh.polygonize(NOTCHED, cells=cells, seed=1)).value


def adapted_row(refinements):
    """Error of an adapted mesh, and the number of equal cells with that error: from those of 240 to 1920 by a power law."""
    (mesh, bars), finest, counts = adapted(refinements), adapted(FINEST)[1], (240, 480, 960, 1920)
    value = finest.value + finest.mesh
    slope, level = np.polyfit(np.log(np.abs([uniform_error(count) for count in counts])), np.log(counts), 1)
    equal = float(np.exp(level + slope * np.log(abs(value - bars.value))))
    return row(value, bars, "mesh", cells=mesh.n_cells, uniform_over_adapted=equal / mesh.n_cells)


def modes_row(modes):
    """Error of the modes of a reduced arm beside the full one, by three missing fields and by twice the modes."""
    settings, one = pi.GeneralizedAlpha(h=2.5e-3, tolerance=1e-8), P.Deviation("tip", (30.0, 0.0))
    bodies = lambda plate: plate, *(lambda plate, k=k: pi.Reduced(plate, modes=k) for k in (modes, 2 * modes))  # noqa: E731
    full, run, twice = (pi.solve(arm(viscosity=1e-3, body=body, mass=0.05).build(), 0.5, settings) for body in bodies)
    bars = pi.error_of(run, one, again=True)
    return row(one(full), bars, "modes", twice=(one(twice) - bars.value) / (one(full) - bars.value))


def fall_row(rho_inf, h, t_end):
    """Error of time of the force in the pin of a falling pendulum at the end: what the start of the method leaves in it decays slowly."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = scene.add(pi.RigidBody.bar(1.0, 1.0, name="bar"))
    scene.add(pi.Revolute(pi.ground, bar.at("left"), name="pin"))
    scene.add(pi.PointMass(bar.at("right"), 0.5, name="tip"))
    model = scene.build()
    force, run = at_end(model, "lam"), pi.solve(model, t_end, pi.GeneralizedAlpha(h=h, tolerance=TIGHT, rho_inf=rho_inf))
    value = reference(model, t_end, {"force": force}, h / FINER, rho_inf=rho_inf)["force"]
    return row(value, pi.error_of(run, force), "time")


def random_row(seed):
    """Error of time of a random chain of bars and plates with motors, springs and masses; drawn again if a run of it fails."""
    while True:
        rng = np.random.default_rng(seed)
        model, h, objectives = random_scene(rng, int(rng.integers(1, 10**6)))
        run = pi.solve(model, 0.6, pi.GeneralizedAlpha(h=h, tolerance=TIGHT))
        if run.success:
            break
        seed += 1000
    name = list(objectives)[int(rng.integers(3))]
    value = reference(model, 0.6, {name: objectives[name]}, h / FINER)[name]
    return row(value, pi.error_of(run, objectives[name]), "time", objective=name, h=h, n=model.n)


def random_scene(rng, seed):
    """(model, step, {name: objective}). seed: of the mesh."""
    scene, side = pi.Scene(gravity=(0.0, -9.81)), pi.ground
    count, flexible = int(rng.integers(1, 4)), bool(rng.integers(2))
    for k in range(count):
        length = float(rng.uniform(0.4, 1.0))
        origin = (side.point[0] if k else 0.0, 0.0)
        if flexible and not k:
            material = pi.Material(E=float(10 ** rng.uniform(7.5, 9)), nu=0.3, rho=1100.0, viscosity=float(10 ** rng.uniform(-4, -2.7)))
            body = scene.add(pi.Plate(pi.mesh.rectangle(length, 0.1, cells=20, seed=seed), material, 0.01, origin=origin, name="body 0"))
            ends = body.section("left"), body.section("right")
        else:
            body = scene.add(pi.RigidBody.bar(length, float(rng.uniform(0.5, 2.0)), origin=origin, name=f"body {k}"))
            ends = body.at("left"), body.at("right")
        scene.add(pi.Revolute(side, ends[0], name=f"joint {k}"))
        if rng.random() < 0.4:
            joint = scene.parts[f"joint {k}"]
            if rng.random() < 0.5 or k:
                base = joint.a if k else pi.ground.at((0.0, 0.0), direction=(1.0, 0.0))
                scene.add(pi.TorsionSpring(base, joint.b, stiffness=float(rng.uniform(1, 30)), name=f"spring {k}"))
            else:
                scene.add(pi.AngleMotor(joint.a, joint.b, profile.quintic(0.0, float(rng.uniform(-1.5, 1.5)), duration=0.3), name="motor"))
        side = ends[1]
    scene.add(pi.PointMass(side, float(rng.uniform(0.1, 1.0)), name="tip"))
    model, h = scene.build(), float(rng.choice([1e-3, 2e-3, 4e-3]))
    return (
        model,
        h,
        {"mean place": P.Deviation("tip", (3.0, 0.0)), "mean lam^2": P.PeakReaction("joint 0", p=2), "place at the end": at_end(model)},
    )
