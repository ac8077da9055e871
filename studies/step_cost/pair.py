"""Lower bound of a step of Radau IIA with three stages: a real and a complex factorization and three solves with each."""

import numpy as np

from against_peers import peers
from polyida.assembly import equilibrium
from polyida.environment import one_blas_thread
from polyida.integrate.radau.tableau import radau
from polyida.linear.dissection import symbolic_of
from polyida.linear.fronts import factorize, single, solve_fronts
from step_cost.measure import RADAU_H, median_cpu, model_of, moved

SOLVES = 3  # with each factor, one an iteration


def fronts(model, blocks):
    """(factor, solve) of this package's multifrontal factor, stored and solved in single precision."""
    known, factors, b = model.once(symbolic_of), {}, np.ones(model.n, single(blocks))
    x = b.copy()

    def factor():
        factors["panels"] = factorize(known, blocks)

    def solved():
        x[:] = b
        solve_fronts(known, factors["panels"], x)
        return x[known.order]

    return factor, solved


BACKENDS = {"fronts": fronts, "superlu": peers.superlu}


def blocks_of(model):
    """[blocks of K + c^2 M] for the eigenvalues c = l / h of both modes at one moved state."""
    state, made = moved(model, 2)[0], []
    for c_m in (0.0, 1.0):
        made.append(np.empty((len(model.pattern[1]), 2, 2)))
        equilibrium.tangent_blocks(model.arrays, state.q.reshape(-1, 2).copy(), None, c_m, 0.0, 1.0, made[-1])
    K, M = made[0], made[1] - made[0]
    return [K + (mode.value / RADAU_H) ** 2 * M for mode in radau(3).modes]


def pair_row(dof, backend, repeats):
    """Milliseconds of both factorizations, of a solve with both, of the floor; the larger relative residual."""
    model, row = model_of("scene 1", dof), {"factor_ms": 0.0, "solve_ms": 0.0, "relative_residual": 0.0}
    for blocks in blocks_of(model):
        with one_blas_thread():
            factor, solved = BACKENDS[backend](model, blocks)
            factor()
            error = np.abs(peers.matrix_of(model, blocks) @ solved() - 1.0).max()
            row["factor_ms"] += 1e3 * median_cpu(factor, repeats)
            row["solve_ms"] += 1e3 * median_cpu(solved, 3 * repeats)
        row["relative_residual"] = max(row["relative_residual"], float(error))
    return row | {"n": model.n, "floor_ms": row["factor_ms"] + SOLVES * row["solve_ms"]}
