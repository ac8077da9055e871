"""Cost of a step: integrators, its parts, the lower bound of the machine, memory, start-up, IDA's sparse solver."""

import json
import os
import subprocess
import sys
import tempfile
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

import polyida
from against_peers import peers
from polyida.assembly import corotated, equilibrium
from polyida.environment import one_blas_thread
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.ida.integrator import IDA
from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.integrate.start import consistent_state
from polyida.integrate.state import Counts
from polyida.jit import entry
from polyida.linear.dissection import symbolic_of
from polyida.linear.fronts import factorize, solve_fronts
from polyida.problems import plates
from polyida.run.solve import solve
from polyida.study.executors import run_isolated
from step_cost.side import NO_FRAMES, between, cells_for, cpu

H, RADAU_H = 1e-3, 5e-3  # steps of generalized-alpha and Radau IIA, s
MEMBERS = {"alpha": GeneralizedAlpha(h=H), "ida": IDA(rtol=1e-5), "radau": RadauIIA(h=RADAU_H)}
SCENES = {"scene 1": plates.double_plate, "scene 2": plates.double_plate_motors}


@lru_cache(maxsize=3)
def model_of(scene, dof):
    """The model of "scene 1" or "scene 2" with about `dof` coordinates."""
    return SCENES[scene](cells_for(dof)).build()


def median_cpu(call, repeats):
    """Median of the CPU seconds of `repeats` calls."""
    return float(np.median([cpu(call)[0] for _ in range(repeats)]))


def step_row(scene, dof, integrator, short, long, repeats):
    """Cost of a step within a run without frames, between the times `short` and `long`, s: medians of runs.

    start_ms is the cost of a run before its steps: consistent initial values and the first factorization.
    """
    model, member = model_of(scene, dof), MEMBERS[integrator]
    solve(model, short, member)  # compiles or loads the kernels
    pairs = [between(model, member, short, long) for _ in range(repeats)]
    first, last = pairs[-1][0][1], pairs[-1][1][1]
    steps = last.steps - first.steps
    ms = 1e3 * float(np.median([b[0] - a[0] for a, b in pairs])) / steps
    row = {
        "n": model.n,
        "steps": steps,
        "ms_per_step": ms,
        "ms_per_iteration": ms * steps / (last.newton_iterations - first.newton_iterations),
        "backend": last.backend,
        "start_ms": 1e3 * float(np.median([a[0] for a, _ in pairs])) - ms * first.steps,
    }
    for name in ("newton_iterations", "residuals", "tangents", "factorizations"):
        row[f"{name}_per_step"] = (getattr(last, name) - getattr(first, name)) / steps
    row["factorizations_in_all"] = last.factorizations
    return row | (parts_of_a_step(model, row) if integrator == "alpha" else {})


@entry
def _residuals(count, s, drives, u, a, lam, r, phi, rotation, dz, forces):
    for _ in range(count):
        equilibrium.equilibrium(s, drives, u, a, lam, r, phi, rotation, dz, forces)


@entry
def _tangents(count, plates, u, c_m, blocks):
    for _ in range(count):
        equilibrium.tangent_blocks(plates, u, None, c_m, 0.0, 1.0, blocks)


@entry
def _solves(count, links, c, workspace, drives, rotation, dz, lam, r, phi, c_m, dq, dlam):
    for _ in range(count):
        corotated.solve(links, c, workspace, drives, rotation, dz, lam, r, phi, c_m, dq, dlam)


def moved(model, steps=5):
    """(State, c_m) of a short run of generalized-alpha at which the kernels are measured."""
    method, state = GeneralizedAlpha(h=H), consistent_state(model, 0.0, None, None)
    c = method.coefficients
    *_, state = method.steps(model, state, steps * H, Counts())
    return state, c.rates(H)[0]


def kernels_ms(model):
    """Milliseconds of residual, tangent, factor (with the joints' columns), solve at one moved state.

    They are called in compiled loops of some tenths of a second; state and c_m are those of a run with h = 1 ms.
    """
    state, c_m = moved(model)
    nodal, points = (model.n_nodes, 2), (model.n_points, 2)
    u, a = state.q.reshape(nodal).copy(), state.a.reshape(nodal).copy()
    r, phi, rotation, dz, forces = (np.empty(shape) for shape in (nodal, model.m, nodal, points, points))
    drives, blocks = model.drives(state.t), np.empty((len(model.pattern[1]), 2, 2))
    residual = (model.arrays, drives, u, a, state.lam.copy(), r, phi, rotation, dz, forces)
    tangent = (model.arrays, u, c_m, blocks)
    _residuals(1, *residual)
    _tangents(1, *tangent)
    system = corotated.corotated(model, blocks, rotation)
    correction = (
        model.arrays.links,
        system,
        corotated.solve_workspace(model, system),
        drives,
        rotation,
        dz,
        state.lam.copy(),
        r,
        phi,
        c_m,
        np.empty(nodal),
        np.empty(model.m),
    )
    count = max(3, 200_000 // model.n)
    timed = {"residual": (_residuals, residual), "tangent": (_tangents, tangent), "solve": (_solves, correction)}
    times = {}
    for name, (loop, arguments) in timed.items():
        loop(1, *arguments)
        times[name] = 1e3 * median_cpu(partial(loop, count, *arguments), 3) / count
    times["factor"] = 1e3 * median_cpu(lambda: corotated.corotated(model, blocks, rotation), 3)
    return times


def parts_of_a_step(model, row):
    """Share of each kernel in a step, ms, from its own time and the row's counts; ns per coordinate."""
    one = kernels_ms(model)
    counted = {"residual": "residuals", "tangent": "tangents", "factor": "factorizations", "solve": "newton_iterations"}
    shares = {f"{name}_ms": one[name] * row[f"{count}_per_step"] for name, count in counted.items()}
    return shares | {
        "rest_ms": row["ms_per_step"] - sum(shares.values()),
        "one_solve_ms": one["solve"],
        "one_factor_ms": one["factor"],
        "residual_ns_per_dof": 1e6 * one["residual"] / model.n,
        "residual_tangent_ns_per_dof": 1e6 * (one["residual"] + one["tangent"]) / model.n,
    }


def fronts(model, blocks):
    """(factor, solve) of this package's multifrontal factor: computed in double, stored and solved in single precision."""
    known, factors, b, x = model.once(symbolic_of), {}, np.ones(model.n, np.float32), np.empty(model.n, np.float32)

    def factor():
        factors["panels"] = factorize(known, blocks)

    def solved():
        x[:] = b
        solve_fronts(known, factors["panels"], x)
        return x

    return factor, solved


BACKENDS = {"fronts": fronts} | peers.BACKENDS


def floor_row(dof, backend, repeats):
    """One factorization and 3 solves of S = c_m M + K of scene 1 with a back-end, called from Python.

    The symbolic analysis is not included if the back-end separates it. Raises peers.Missing if the back-end is not installed.
    """
    model = model_of("scene 1", dof)
    state, c_m = moved(model, 2)
    blocks = np.empty((len(model.pattern[1]), 2, 2))
    equilibrium.tangent_blocks(model.arrays, state.q.reshape(-1, 2).copy(), None, c_m, 0.0, 1.0, blocks)
    with one_blas_thread():
        factor, solved = BACKENDS[backend](model, blocks)
        factor()
        solution = np.array(solved(), float)
        factor_s, solve_s = median_cpu(factor, repeats), median_cpu(solved, 3 * repeats)
    solution = solution[model.once(symbolic_of).order] if backend == "fronts" else solution
    error = np.abs(peers.matrix_of(model, blocks) @ solution - 1.0).max()
    return {
        "n": model.n,
        "factor_ms": 1e3 * factor_s,
        "solve_ms": 1e3 * solve_s,
        "floor_ms": 1e3 * (factor_s + 3 * solve_s),
        "relative_residual": float(error),
    }


def sparse_row(dof, t_end, repeats):
    """IDA to t_end, s, on scene 1: this package against SUNDIALS' sparse solver, in separate processes."""
    model, settings = model_of("scene 1", dof), IDA(rtol=1e-5)
    solve(model, min(t_end, 1e-3), settings)
    runs = [cpu(lambda: solve(model, t_end, settings, every=NO_FRAMES)) for _ in range(repeats)]
    others = [run_isolated(sparse_alone, {"dof": dof, "t_end": t_end}, 300.0) for _ in range(repeats)]
    good = [row for row in others if not row["error"]]
    ours = float(np.median([seconds for seconds, _ in runs]))
    row = {"n": model.n, "steps": runs[0][1].counts.steps, "cpu_s": ours, "status": runs[0][1].status}
    if not good:
        return row | {"error": others[0]["error"]}
    sparse = float(np.median([other["cpu_s"] for other in good]))
    return row | {"sparse_cpu_s": sparse, "sparse_steps": good[0]["steps"], "speedup": sparse / ours}


def sparse_alone(dof, t_end):
    """The other side of `sparse_row`, for a separate process."""
    model = model_of("scene 1", dof)
    peers.sparse_ida(model, min(t_end, 1e-3))
    return peers.sparse_ida(model, t_end)


def memory_row(dof, integrator, steps):
    """Peak memory of a process that imports, meshes, builds and runs equal steps on scene 1 with every frame."""
    return run_isolated(memory_alone, {"dof": dof, "integrator": integrator, "steps": steps}, 900.0)


def memory_alone(dof, integrator, steps):
    """`memory_row` in its own process; frames beyond the limit of `solve` go to a file, as by default."""
    imported = peak_bytes()
    model = model_of("scene 1", dof)
    member = MEMBERS[integrator]
    built, (seconds, run) = peak_bytes(), cpu(lambda: solve(model, steps * member.h, member))
    peak = peak_bytes()
    return {
        "n": model.n,
        "steps": run.counts.steps,
        "status": run.status,
        "imported_bytes": imported,
        "built_bytes": built,
        "peak_bytes": peak,
        "bytes_per_dof": peak / model.n,
        "frame_bytes": 8 * len(run) * (3 * model.n + model.m + 1),
        "ms_per_step": 1e3 * seconds / steps,
        "newton_iterations_per_step": run.counts.newton_iterations / steps,
    }


def peak_bytes():
    """Peak resident memory of this process so far, from the kernel if possible, because getrusage inherits that of the parent."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
        return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
    except (OSError, StopIteration):
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


START = """
import json, sys, time
sys.path[:0] = json.loads(sys.argv[1])
import polyida as pi
from polyida.problems.plates import double_plate
seconds = [time.process_time()]
model = double_plate(int(sys.argv[2])).build()
seconds.append(time.process_time())
run = pi.solve(model, 1e-3, pi.GeneralizedAlpha(h=1e-3))
seconds.append(time.process_time())
print(json.dumps(seconds))
"""


def start_rows(dof, warm):
    """CPU seconds of a fresh process for import, mesh, first step: kernel cache empty, then `warm` times filled."""
    with tempfile.TemporaryDirectory(prefix="polyida-kernels-") as folder:
        cold = _started(dof, folder)
        filled = np.median([_started(dof, folder) for _ in range(warm)], axis=0)
    names = ("import_s", "mesh_s", "first_step_s", "start_s")
    return {f"{kind}_{name}": float(value) for kind, values in (("cold", cold), ("warm", filled)) for name, value in zip(names, values)}


def _started(dof, folder):
    paths = json.dumps([str(Path(polyida.__file__).parents[1])])
    command = [sys.executable, "-c", START, paths, str(cells_for(dof))]
    cache = os.environ | {"NUMBA_CACHE_DIR": folder}
    done = subprocess.run(command, env=cache, capture_output=True, text=True, check=True)
    seconds = json.loads(done.stdout.splitlines()[-1])
    return [*np.diff([0.0, *seconds]), seconds[-1]]
