"""What a step costs: both integrators, the parts of a step, the floor of the machine, memory, start-up and IDA's sparse solver."""

import json
import os
import subprocess
import sys
import tempfile
import time
from functools import lru_cache
from pathlib import Path

import numpy as np

from polyida.assembly import equilibrium
from polyida.compiled import entry
from polyida.errors import InputError
from polyida.integrate.generalized_alpha import GeneralizedAlpha
from polyida.integrate.ida import IDA
from polyida.integrate.solve import solve
from polyida.integrate.start import consistent_state
from polyida.integrate.state import Counts
from polyida.linear import corotated
from polyida.linear.factor import symbolic_of
from polyida.linear.fronts import factorize, solve_fronts
from polyida.linear.triangular import fill_band
from polyida.problems import plates
from polyida.threads import one_blas_thread

H = 1e-3  # step of generalized-alpha, s
NO_FRAMES = 10**9  # keep every so many steps: the first and the last frame alone
WIDEST_BAND = 30_000  # DOF beyond which a band factor is out of the question
SCENES = {"scene 1": plates.double_plate, "scene 2": plates.double_plate_motors}


class Missing(InputError):
    """An optional package is not installed: that part of a study is left out."""


def cells_for(dof):
    """Cells a plate that give two plates together about so many coordinates."""
    return max(4, round(dof / 7.7 + 15 * min(1.0, dof / 1000)))


@lru_cache(maxsize=2)
def model_of(scene, dof):
    """The model of "scene 1" or "scene 2" with about `dof` coordinates."""
    return SCENES[scene](cells_for(dof)).build()


def cpu(call):
    """(CPU seconds of this process that call() takes, what it returns)."""
    begin = time.process_time()
    result = call()
    return time.process_time() - begin, result


def median_cpu(call, repeats):
    """Median of the CPU seconds of `repeats` calls."""
    return float(np.median([cpu(call)[0] for _ in range(repeats)]))


def step_row(scene, dof, integrator, short, long, repeats):
    """Cost of a step in the midst of a run: what a run to `long` costs beyond one to `short`, s, by the steps between them.

    start_ms is what the shorter run costs beyond its own steps: consistent start and first factor. No frames are kept.
    """
    model, member = model_of(scene, dof), GeneralizedAlpha(h=H) if integrator == "alpha" else IDA(rtol=1e-5)

    def run(t_end):
        return solve(model, t_end, member, every=NO_FRAMES)

    run(short)  # compiles or loads the kernels
    pairs = [(cpu(lambda: run(short)), cpu(lambda: run(long))) for _ in range(repeats)]
    first, last = pairs[-1][0][1], pairs[-1][1][1]
    steps = last.counts.steps - first.counts.steps
    ms = 1e3 * float(np.median([b[0] - a[0] for a, b in pairs])) / steps
    row = {"n": model.n, "steps": steps, "ms_per_step": ms,
           "start_ms": 1e3 * float(np.median([a[0] for a, _ in pairs])) - ms * first.counts.steps,
           "status": last.status, "backend": last.counts.backend}
    for name in ("newton_iterations", "residuals", "tangents", "factorizations"):
        row[f"{name}_per_step"] = (getattr(last.counts, name) - getattr(first.counts, name)) / steps
    row["factorizations_in_all"] = last.counts.factorizations
    return row | (parts_of_a_step(model, row) if integrator == "alpha" else {})


@entry
def _residuals(count, s, drives, u, a, lam, r, phi, rotation, dz, forces):
    for _ in range(count):
        equilibrium.equilibrium(s, drives, u, a, lam, r, phi, rotation, dz, forces)


@entry
def _tangents(count, plates, u, c_m, blocks):
    for _ in range(count):
        equilibrium.tangent_blocks(plates, u, c_m, 1.0, blocks)


@entry
def _solves(count, links, c, room, drives, rotation, dz, lam, r, phi, c_m, dq, dlam):
    for _ in range(count):
        corotated.solve(links, c, room, drives, rotation, dz, lam, r, phi, c_m, dq, dlam)


@entry
def _triangular(count, fronts, panels, x):
    for _ in range(count):
        solve_fronts(fronts, panels, x)


def moved(model, steps=5):
    """(State, c_m) of a short generalized-alpha run: where the kernels are measured."""
    method, state = GeneralizedAlpha(h=H), consistent_state(model, 0.0, None, None)
    c = method.coefficients
    for state in method.steps(model, state, steps * H, Counts()):
        pass
    return state, (1 - c.alpha_m) / (c.beta * H * H * (1 - c.alpha_f))


def kernels_ms(model):
    """Milliseconds of residual, tangent, factor (with the joints' columns), solve (with its triangular part) at one moved state.

    They are called in compiled loops, at most some tenths of a second each; the state and c_m are those of a run with h = 1 ms.
    """
    state, c_m = moved(model)
    nodal, points = (model.n_nodes, 2), (model.n_points, 2)
    u, a = state.q.reshape(nodal).copy(), state.a.reshape(nodal).copy()
    r, phi, rotation, dz, forces = np.empty(nodal), np.empty(model.m), np.empty(nodal), np.empty(points), np.empty(points)
    drives, blocks = model.drives(state.t), np.empty((len(model.pattern[1]), 2, 2))
    residual = (model.arrays, drives, u, a, state.lam.copy(), r, phi, rotation, dz, forces)
    tangent = (model.arrays.plates, u, c_m, blocks)
    _residuals(1, *residual)
    _tangents(1, *tangent)
    system, _ = corotated.corotated(model, blocks, rotation)
    correction = (model.arrays.links, system, corotated.room(model, system), drives, rotation, dz, state.lam.copy(), r, phi, c_m,
                  np.empty(nodal), np.empty(model.m))
    x, count = np.ones(model.n, np.float32), max(3, 200_000 // model.n)
    timed = {"residual": (_residuals, residual), "tangent": (_tangents, tangent), "solve": (_solves, correction),
             "triangular": (_triangular, (system.factor.fronts, system.factor.panels, x))}
    times = {}
    for name, (loop, arguments) in timed.items():
        loop(1, *arguments)
        times[name] = 1e3 * median_cpu(lambda: loop(count, *arguments), 3) / count
    times["factor"] = 1e3 * median_cpu(lambda: corotated.corotated(model, blocks, rotation), 3)
    return times


def parts_of_a_step(model, row):
    """Share of each kernel in a step, ms, from its own time and the row's counts; and ns per coordinate of the two assemblies."""
    one = kernels_ms(model)
    used = {"residual": row["residuals_per_step"], "tangent": row["tangents_per_step"], "factor": row["factorizations_per_step"],
            "solve": row["newton_iterations_per_step"]}
    shares = {f"{name}_ms": one[name] * times for name, times in used.items()}
    return shares | {
        "rest_ms": row["ms_per_step"] - sum(shares.values()), "one_triangular_ms": one["triangular"], "one_factor_ms": one["factor"],
        "residual_ns_per_dof": 1e6 * one["residual"] / model.n,
        "residual_tangent_ns_per_dof": 1e6 * (one["residual"] + one["tangent"]) / model.n,
    }


def floor_row(dof, backend, repeats):
    """One factorization + 3 solves of S = c_m M + K of scene 1 with a back-end: numeric work, the analysis apart where it can be.

    Raises Missing where the back-end is not installed.
    """
    model = model_of("scene 1", dof)
    state, c_m = moved(model, 2)
    blocks = np.empty((len(model.pattern[1]), 2, 2))
    equilibrium.tangent_blocks(model.arrays.plates, state.q.reshape(-1, 2).copy(), c_m, 1.0, blocks)
    with one_blas_thread():
        factor, solved = BACKENDS[backend](model, blocks)
        factor()
        error = _error_of(model, blocks, solved())
        factor_s, solve_s = median_cpu(factor, repeats), median_cpu(solved, 3 * repeats)
    return {"n": model.n, "factor_ms": 1e3 * factor_s, "solve_ms": 1e3 * solve_s, "floor_ms": 1e3 * (factor_s + 3 * solve_s),
            "solve_error": error}


def _error_of(model, blocks, x):
    b = np.ones(model.n)
    return float(np.abs(_matrix(model, blocks) @ x - b).max())


def _matrix(model, blocks):
    from scipy.sparse import bsr_array

    indptr, indices = model.pattern
    return bsr_array((blocks, indices, indptr), shape=(model.n, model.n)).tocsc()


def _fronts(model, blocks):
    known, kept = model.once(symbolic_of), {}

    def factor():
        kept["panels"] = factorize(known, blocks)

    def solved():
        x = np.ones(model.n, np.float32)
        solve_fronts(known, kept["panels"], x)
        return x[known.order]

    return factor, solved


def _superlu(model, blocks):
    from scipy.sparse.linalg import splu

    matrix, kept, b = _matrix(model, blocks), {}, np.ones(model.n)

    def factor():
        kept["lu"] = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})

    return factor, lambda: kept["lu"].solve(b)


def _band(model, blocks):
    from scipy.linalg.lapack import dpbtrf, dpbtrs

    if model.n > WIDEST_BAND:
        raise Missing(f"no band factor beyond {WIDEST_BAND} coordinates")
    indptr, indices = model.pattern
    width = 2 * int(np.max(np.abs(indices - np.repeat(np.arange(model.n_nodes), np.diff(indptr))))) + 1
    kept, b, band = {}, np.ones(model.n), np.empty((model.n, width + 1))

    def factor():
        fill_band(indptr, indices, blocks, band)
        kept["factor"] = dpbtrf(band.T, lower=1, overwrite_ab=1)[0]

    return factor, lambda: dpbtrs(kept["factor"], b, lower=1)[0]


def _pardiso(model, blocks, dtype=np.float64):
    """MKL PARDISO, symmetric positive definite (mtype 2), one thread: phase 11 here, 22 and 33 in the two calls."""
    import ctypes

    try:
        from pypardiso.pardiso_wrapper import PyPardisoSolver
    except ImportError:
        raise Missing("pypardiso is not installed (extra mkl)") from None
    from scipy.sparse import triu

    solver = PyPardisoSolver(mtype=2)
    solver.libmkl.MKL_Set_Num_Threads(1)
    upper = triu(_matrix(model, blocks), format="csr")
    upper.sort_indices()
    arrays = [upper.data.astype(dtype), (upper.indptr + 1).astype(np.int32), (upper.indices + 1).astype(np.int32)]
    b, x, iparm, error = np.ones(model.n, dtype), np.empty(model.n, dtype), np.zeros(64, np.int32), ctypes.c_int32(0)
    if dtype == np.float32:
        iparm[[0, 1, 27]] = 1, 2, 1

    def phase(number):
        whole = [ctypes.byref(ctypes.c_int32(value)) for value in (1, 1, 2, number, model.n)]
        pointers = [array.ctypes.data_as(kind) for array, kind in zip([*arrays, solver.perm], solver._mkl_pardiso.argtypes[6:10])]
        solver._mkl_pardiso(solver.pt.ctypes.data_as(solver._mkl_pardiso.argtypes[0]), *whole, *pointers,
                            ctypes.byref(ctypes.c_int32(1)), iparm.ctypes.data_as(solver._mkl_pardiso.argtypes[11]),
                            ctypes.byref(ctypes.c_int32(0)), b.ctypes.data_as(ctypes.c_void_p), x.ctypes.data_as(ctypes.c_void_p),
                            ctypes.byref(error))
        if error.value:
            raise RuntimeError(f"PARDISO: error {error.value} in phase {number}")
        return x

    phase(11)
    return lambda: phase(22), lambda: phase(33)


BACKENDS = {
    "fronts": _fronts, "superlu": _superlu, "band": _band, "pardiso": _pardiso,
    "pardiso single": lambda model, blocks: _pardiso(model, blocks, np.float32),
}
