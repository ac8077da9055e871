"""Cost of a gradient relative to its run, parts of its backward sweep, and its error from Newton's tolerance."""

from functools import lru_cache, partial

import numpy as np

import polyida as pi
from polyida.adjoint import products
from polyida.adjoint import scene_table as scene
from polyida.adjoint.alpha_sweep import AdjointState, Sweep
from polyida.adjoint.scene_modes import correct
from polyida.environment import one_blas_thread
from polyida.integrate.state import Counts
from polyida.jit import entry
from polyida.problems import plates
from step_cost.side import cells_for, cpu

H = 1e-3  # s
TIGHT = 1e-10  # Newton's tolerance of what errors are measured against
SCENES = {"scene 1": plates.double_plate, "scene 2": plates.double_plate_motors}
OBJECTIVES = {
    "deviation": lambda: pi.objective.Deviation("tip", lambda t: (2.0 * np.cos(t), -2.0 * np.sin(t))),
    "strain energy": lambda: pi.objective.StrainEnergy("upper"),
    "peak reaction": lambda: pi.objective.PeakReaction("shoulder", p=8),
}


@lru_cache(maxsize=2)
def model_of(scene, dof):
    """The model of "scene 1" or "scene 2" with about `dof` coordinates."""
    return SCENES[scene](cells_for(dof)).build()


def ratio_row(scene, dof, objective, t_end, repeats):
    """Medians over `repeats` alternations of the CPU microseconds of a step in a run with all frames and in its gradient, and of their
    ratio.

    A short alternation before loads the kernels.
    """
    model, settings, own = model_of(scene, dof), pi.GeneralizedAlpha(h=H), OBJECTIVES[objective]()
    pi.gradient(pi.solve(model, 0.02, settings), own)
    times = []
    with one_blas_thread():
        for _ in range(repeats):
            run_s, run = cpu(partial(pi.solve, model, t_end, settings))
            gradient_s, result = cpu(partial(pi.gradient, run, own))
            times.append((run_s, gradient_s))
        parts = sweep_us(model, settings, run, own, repeats)
    run_s, gradient_s = np.transpose(times)
    steps, solves = run.counts.steps, result.counts.solves / run.counts.steps
    per_step = 1e6 / steps
    return {
        "n": model.n,
        "steps": steps,
        "run_us": per_step * float(np.median(run_s)),
        "gradient_us": per_step * float(np.median(gradient_s)),
        "ratio": float(np.median(gradient_s / run_s)),
        "run_solves": run.counts.solves / steps,
        "solves": solves,
        "run_factorizations": run.counts.factorizations,
        "factorizations": result.counts.factorizations,
        "sweep_us": parts["sweep"],
        "solve_us": solves * parts["solve"],
        "product_us": (solves + 1.0) * parts["product"],
    }


def several_row(scene, dof, t_end, repeats):
    """Medians over `repeats` alternations of the CPU microseconds of a step in the gradient of one objective, of four together, and of four one after the
    other, and of their ratios to one.
    """
    model = model_of(scene, dof)
    objectives = [*(make() for make in OBJECTIVES.values()), pi.objective.StrainEnergy("lower")]
    run = pi.solve(model, t_end, pi.GeneralizedAlpha(h=H))
    ways = {
        "one": lambda: pi.gradient(run, objectives[0]),
        "four": lambda: pi.gradient(run, objectives),
        "apart": lambda: [pi.gradient(run, one) for one in objectives],
    }
    pi.gradient(run, objectives)
    with one_blas_thread():
        times = np.array([[cpu(way)[0] for way in ways.values()] for _ in range(repeats)])
    per_step = 1e6 * np.median(times, axis=0) / run.counts.steps
    return {
        "n": model.n,
        "steps": run.counts.steps,
        **dict(zip(("gradient_us", "four_us", "apart_us"), per_step.tolist())),
        "several_over_one": float(np.median(times[:, 1] / times[:, 0])),
        "several_over_apart": float(np.median(times[:, 1] / times[:, 2])),
    }


@entry
def _products(count, s, u, v, w, x):
    which = np.zeros(1, np.int64)
    for _ in range(count):
        products.body_products(s, s.plates.body_viscosity[:0], u, v, (which, which), w, x.rotation[:0], x)


@entry
def _solves(count, work, u):
    for _ in range(count):
        correct(work.scene, work.real, None, u, work.r, work.rows, work.unconstrained, np.zeros(1, np.int64))


def sweep_us(model, settings, run, objective, repeats):
    """CPU microseconds of the sweep back in a step of the run, of one product and of one solve in it."""
    sweep, count = Sweep(model, settings, H, Counts()), max(20, 500_000 // model.n)
    t, *frames = (np.array(x[1:]) for x in (run.t, run.q, run.v, run.a, run.lam))
    slopes, none = [objective.slopes(run)(slice(1, len(run)))], [AdjointState(*np.zeros((4, model.n)))]
    swept = partial(sweep.back, t, *frames, slopes, none)
    u, v, w = (x[-1].reshape(-1, 2).copy() for x in (*frames[:2], swept()[0].w))
    work = scene.SceneAdjointWork(**sweep.table.w)
    loops = {"product": (_products, (work.scene, u, v, w[None], work.first)), "solve": (_solves, (work, u))}
    result = {"sweep": cpu(swept)[0] / len(t)}
    for name, (loop, arguments) in loops.items():
        loop(1, *arguments)
        result[name] = float(np.median([cpu(partial(loop, count, *arguments))[0] for _ in range(repeats)])) / count
    return {name: 1e6 * seconds for name, seconds in result.items()}


def error_row(scene, dof, objective, tolerance, t_end):
    """Relative distances of the slopes in each polygon's stiffness and mass from those of a run at Newton's tolerance `TIGHT`."""
    loose, tight = (slopes_of(scene, dof, objective, each, t_end) for each in (tolerance, TIGHT))
    far = {
        f"{kind}_error": float(np.linalg.norm(loose[kind] - tight[kind]) / np.linalg.norm(tight[kind])) for kind in ("stiffness", "mass")
    }
    return {"n": model_of(scene, dof).n, "solves": loose["solves"]} | far


@lru_cache(maxsize=2)
def slopes_of(scene, dof, objective, tolerance, t_end):
    """Slopes in stiffness and mass of all polygons, (cells,) each, and solves a step."""
    model = model_of(scene, dof)
    run = pi.solve(model, t_end, pi.GeneralizedAlpha(h=H, tolerance=tolerance))
    result = pi.gradient(run, OBJECTIVES[objective]())
    slopes = {kind: np.concatenate([result[f"{body.name}.{kind}"] for body in model.bodies]) for kind in ("stiffness", "mass")}
    return slopes | {"solves": result.counts.solves / run.counts.steps}
