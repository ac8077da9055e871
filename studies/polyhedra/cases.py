"""Rows of the study: patch test, cantilever, free bar, and the paper's two bars in space.

REFERENCE: the bar of 1 m x 0.1 m x 0.1 m of quadratic tetrahedra with scikit-fem 12.0.2, `MeshTet.init_tensor` with 10, 20 and 40 cubes along
it, `ElementTetP2`, St. Venant-Kirchhoff: mean displacement of the end face under 800 N, m, and frequencies of the free bar, Hz. The results are
z = -0.477639, -0.482650, -0.483803, x = -0.150071, -0.152887, -0.153513; bending 21.2440, 21.1857, 21.1803; torsion 66.229, 61.850, 60.829. Their
changes fall by 4.3 to 4.5, and to 11 in bending; REFERENCE is the limit of that sequence.
"""

import time
from dataclasses import replace

import numpy as np
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
from scipy.spatial.transform import Rotation

import polyida as pi
from polyhedra.mesh import Mesh, box
from polyhedra.model import Pin, Point, Polyhedra
from polyida.integrate.state import Counts

REFERENCE = {"end": (-0.15369, 0.0, -0.48415), "bending": 21.180, "torsion": 60.52}
BAR, RUBBER, END = (1.0, 0.1, 0.1), pi.Material(E=50e6, nu=0.3, rho=1100.0), "end"
MIDDLE, LOAD, SPIN = np.array([0.0, 0.05, 0.05]), 800.0, 1.5  # place of the first pin, N, rad/s about the vertical
INTEGRATORS = {
    "alpha": lambda h: pi.GeneralizedAlpha(h=h),
    "alpha extrapolated": lambda h: pi.GeneralizedAlpha(h=h, extrapolate=True),
    "energy": lambda h: pi.EnergyMomentum(h=h),
    "radau": lambda rtol: pi.RadauIIA(rtol=rtol),
    "ida": lambda rtol: pi.IDA(rtol=rtol),
}


def bars(cells, E=RUBBER.E, seed=1, hinge=False):
    """(two bars end to end with spherical joints and 0.5 kg at the tip, their velocities at the start, the tip). hinge: between them, along y."""
    mesh = box(BAR, cells, seed)
    left, right = mesh.side(0, 0.0), mesh.side(0, 1.0)
    joint = [[mesh.side(0, x, (x, y, 0.05)) for x in BAR[:1] + (0.0,)] for y in (0.025, 0.075)] if hinge else [(right, left)]
    pins, tip = (Pin(Point(0, left), MIDDLE), *[Pin(Point(0, one), Point(1, two)) for one, two in joint]), Point(1, right)
    model = Polyhedra([mesh, Mesh(mesh.points + (1.0, 0.0, 0.0), mesh.cells)], replace(RUBBER, E=E), (0.0, 0.0, -9.81), pins, [(tip, 0.5)])
    return model, np.cross((0.0, 0.0, SPIN), model.places - MIDDLE).ravel(), tip


def timed(call):
    """(CPU seconds, result) of a call."""
    begin = time.process_time()
    result = call()
    return time.process_time() - begin, result


def patch_row(cells, seed):
    """Nodes of the surface have an affine motion with a finite rotation: so have those inside, if they are in equilibrium."""
    mesh, random = box((1.0, 1.0, 1.0), cells, seed, lloyd=0), np.random.default_rng(seed)
    F = Rotation.from_rotvec((0.4, -1.1, 0.7)).as_matrix() @ (np.eye(3) + 0.05 * random.uniform(-1.0, 1.0, (3, 3)))
    held = [(0, node, (F - np.eye(3)) @ mesh.points[node]) for node in {int(node) for face in mesh.outer for node in face}]
    model = Polyhedra([mesh], RUBBER, held=held)
    exact = (model.places @ (F - np.eye(3)).T).ravel()
    equilibrium = pi.static(model, q0=exact + 1e-3 * random.standard_normal(model.n), tolerance=1e-13)
    return {"n": model.n, "deviation": float(np.abs(equilibrium.q - exact).max())}


def cantilever_row(cells, seed=1, least=125):
    """Displacement of the end beside that of quadratic tetrahedra; each mesh begins with the solution of one with an eighth of the cells."""
    places = moved = None
    for count in [cells // 8**k for k in (3, 2, 1) if cells // 8**k >= least] + [cells]:
        mesh = box(BAR, count, seed)
        end, left = Point(0, mesh.side(0, 1.0)), mesh.side(0, 0.0)
        model = Polyhedra([mesh], RUBBER, loads=[(end, (0.0, 0.0, -LOAD))], held=[(0, k, np.zeros(3)) for k in left])
        guess = np.zeros(model.n) if places is None else NearestNDInterpolator(places, moved)(model.places).ravel()
        if places is not None:
            linear = LinearNDInterpolator(places, moved)(model.places).ravel()
            guess = np.where(np.isfinite(linear), linear, guess)
        q = pi.static(model, q0=guess, steps=3 if places is None else 1, tolerance=1e-8).q
        places, moved = mesh.points, model.displacements(q)[model.number]
    shift = model.place(end, q) - model.place(end)
    away = np.linalg.norm(shift - REFERENCE["end"]) / np.linalg.norm(REFERENCE["end"])
    return {"n": model.n, "end": shift.tolist(), "deviation": float(away)}


def free_row(cells, lumped=True, seed=1):
    """First frequencies of bending and torsion over those of quadratic tetrahedra."""
    model = Polyhedra([box(BAR, cells, seed)], RUBBER, lumped=lumped)
    modes = pi.modes(model, pi.State(0.0, *np.zeros((3, model.n)), np.zeros(0)), count=12)
    x, flexible = model.places - model.places.mean(axis=0), modes.frequencies > 1.0
    u = modes.shapes.reshape(12, model.count, 3)
    twist = np.abs(np.sum(np.sign(x[:, 0]) * (x[:, 1] * u[..., 2] - x[:, 2] * u[..., 1]), axis=1))
    bending, torsion = float(modes.frequencies[flexible][0]), float(modes.frequencies[np.argmax(np.where(flexible, twist, 0.0))])
    errors = {f"{name}_error": abs(value / REFERENCE[name] - 1.0) for name, value in (("bending", bending), ("torsion", torsion))}
    return {"n": model.n, "bending": bending, "torsion": torsion} | errors


def run_row(cells, integrator, setting, t_end):
    """A run of the two bars: the tip, drift, energy and CPU time."""
    model, v0, tip = bars(cells)
    method = INTEGRATORS[integrator](setting)
    pi.solve(model, 2e-3, method, v0=v0)
    cpu, run = timed(lambda: pi.solve(model, t_end, method, v0=v0))
    counts = run.counts
    work = {"steps": counts.steps, "iterations": counts.newton_iterations, "factorizations": counts.factorizations, "cpu_s": cpu}
    kept = {"drift": float(np.abs(run.drift).max()), "energy": float(np.ptp(run.energy.total) / np.ptp(run.energy.kinetic))}
    return {"n": model.n, "tip": model.place(tip, run.q[-1]).tolist(), "outcome": run.status} | work | kept


def hinge_row(cells, t_end, seed=1):
    """A bar turns about a vertical hinge of two pins: change of the angular momentum about it, drift of the pins, fall of the end."""
    mesh = box(BAR, cells, seed)
    ends = [np.array([0.0, 0.05, z]) for z in (0.025, 0.075)]
    model = Polyhedra([mesh], RUBBER, (0.0, 0.0, -9.81), [Pin(Point(0, mesh.side(0, 0.0, end)), end) for end in ends])
    run = pi.solve(model, t_end, pi.RadauIIA(rtol=1e-9), v0=np.cross((0.0, 0.0, SPIN), model.places - MIDDLE).ravel())
    x, p = (values.reshape(-1, model.count, 3) for values in (run.q + (model.places - MIDDLE).ravel(), run.v @ model.M))
    L, end = np.cross(x, p).sum(axis=1)[:, 2], model.place(Point(0, mesh.side(0, 1.0)), run.q[-1]) - MIDDLE
    kept = {"momentum": float(np.ptp(L) / L[0]), "drift": float(np.abs(run.drift).max()), "outcome": run.status}
    return {"n": model.n, "angle": float(np.arctan2(end[1], end[0])), "fall": float(-end[2])} | kept


def order_row(cells, integrator, counts, E, t_end=0.05):
    """Errors of q at t_end against steps, and the order between the last two; the reference is Radau IIA in 400 steps."""
    model, v0, _ = bars(cells, E)
    exact = pi.solve(model, t_end, pi.RadauIIA(h=t_end / 400, tolerance=1e-13), v0=v0).q[-1]
    make = {"alpha": lambda h: pi.GeneralizedAlpha(h=h, tolerance=1e-9), "radau": lambda h: pi.RadauIIA(h=h, tolerance=1e-13)}[integrator]
    errors = np.array([np.abs(pi.solve(model, t_end, make(t_end / count), v0=v0).q[-1] - exact).max() for count in counts])
    order = float(np.log2(errors[-2] / errors[-1]))
    return {"n": model.n, "sizes": [t_end / count for count in counts], "errors": errors.tolist(), "order": order}


def step_row(cells, h, steps):
    """CPU time of a step of generalized-alpha over its iterations' residuals and solves, and over one of each."""
    model, v0, _ = bars(cells)
    method, counts, marks, times = pi.GeneralizedAlpha(h=h), Counts(), [], []
    for state in method.steps(model, pi.consistent_state(model, v0=v0), 0.02 + steps * h, counts):  # noqa: B007
        marks.append((time.process_time(), counts.newton_iterations))
    step, each = (np.subtract(marks[-1], marks[-1 - steps]) / steps).tolist()
    system, zero = model.step_matrix(), np.zeros(model.m)
    factor = timed(lambda: system.factor(0.0, state.q, state.v, state.a, zero, *method.coefficients.rates(h)))[0]
    for q in state.q + 1e-9 * np.arange(20)[:, None]:  # other states
        evaluate, r = timed(lambda: model.residual(0.0, q, state.v, state.a, state.lam))  # noqa: B023
        times.append((evaluate, timed(lambda: system.saddle(0.0, q, state.lam, r, zero))[0]))  # noqa: B023
    residual, solve = np.median(times, axis=0).tolist()
    return {
        "n": model.n, "factor_ms": 1e3 * factor, "residual_ms": 1e3 * residual, "solve_ms": 1e3 * solve, "step_ms": 1e3 * step,
        "iterations": each, "step_over_iterations": step / (each * (residual + solve)), "step_over_one": step / (residual + solve),
    }  # fmt: skip


def gradient_row(cells, t_end):
    """Slopes of the tip's height in E and rho by the adjoint, and their distance from differences of runs."""
    model, v0, tip = bars(cells)
    row, (nodes, weights) = np.zeros(model.n), model.nodes_of(tip)
    row[3 * nodes + 2] = weights
    height = pi.objective.UserObjective(lambda run: float(run.q[-1] @ row), lambda run: {"q": np.outer(run.t == run.t[-1], row)})
    run = pi.solve(model, t_end, pi.GeneralizedAlpha(h=1e-3, tolerance=1e-12), v0=v0)
    slopes, errors = pi.gradient(run, height), pi.check_gradient(run, height, ["E", "rho"])
    return {"n": model.n, "slope_E": float(slopes["E"]), "slope_rho": float(slopes["rho"]), "deviation": float(max(errors.values()))}


def conditioning_row(cells, h):
    """Condition numbers of the iteration matrices at the start."""
    model, v0, _ = bars(cells)
    state = pi.consistent_state(model, v0=v0)
    methods = {"alpha": pi.GeneralizedAlpha(h=h), "radau": pi.RadauIIA(h=h), "ida": pi.IDA()}
    return {"n": model.n} | {
        f"{name}_{scaling}": pi.condition_number(model, method, state, h=h, scaling=None if scaling == "scaled" else "none")
        for name, method in methods.items() for scaling in ("scaled", "none")
    }  # fmt: skip
