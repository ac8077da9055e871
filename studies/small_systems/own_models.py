"""User-defined models: cost of a run relative to their functions, in Python and compiled; cost of a step relative to a loop in numba."""

import time
from functools import partial

import numpy as np
from numba import njit

import polyida as pi
from polyida.problems import get

NO_FRAMES = 10**9
RTOL = {"alpha": pi.GeneralizedAlpha(rtol=1e-6), "radau": pi.RadauIIA(rtol=1e-6), "ida": pi.IDA(rtol=1e-6)}
SPANS = {"pendulum": 1.0, "car-axis": 0.3, "andrews": 0.03}  # s
H = 1e-3  # s
STEPS = {"alpha": 100_000, "radau": 20_000, "energy": 20_000}  # of the compiled pendulum
FUNCTIONS = ("mass", "force", "phi", "phi_q", "force_q", "force_v", "mass_a_q", "reaction_q", "phi_t", "phi_bias")


def compiled(model):
    """The model with its functions compiled."""
    kind = type(model)
    return pi.compiled(type(kind.__name__, (kind,), {}))()


def cpu(call):
    """(CPU seconds of a call in this process, its result)."""
    begin = time.process_time()
    result = call()
    return time.process_time() - begin, result


def functions_row(name, rounds):
    """Of each integrator at rtol 1e-6: a run in Python over the time inside the model's functions, and over a run with these compiled."""
    problem, row = get(name), {}
    start, fast = {"q0": problem.q0, "v0": problem.v0, "every": NO_FRAMES}, compiled(problem.model)
    for key, integrator in RTOL.items():
        go = partial(pi.solve, t_end=SPANS[name], integrator=integrator, **start)
        go(fast), inside(problem.model, go)
        turns = [(cpu(partial(go, problem.model))[0], inside(problem.model, go), cpu(partial(go, fast))[0]) for _ in range(rounds)]
        python, own, quick = np.array(turns).T
        row |= {f"{key}_over_own": float(np.median(python / own)), f"{key}_python_over_compiled": float(np.median(python / quick))}
    return {"n": problem.model.n, "m": problem.model.m} | row


def inside(model, go):
    """Seconds that a run spends inside the functions of a model: each call of the run is timed, less what timing an empty function gives."""
    kind, seconds = type(model), []

    def timed(function):
        def call(self, *arguments):
            begin = time.perf_counter()
            result = function(self, *arguments)
            seconds.append(time.perf_counter() - begin)
            return result

        return call

    go(type(kind.__name__, (kind,), {name: timed(getattr(kind, name)) for name in FUNCTIONS if name in vars(kind)})())
    total, count, empty = sum(seconds), len(seconds), timed(lambda self, t, q: None)
    for _ in range(count):
        empty(model, 0.0, None)
    return total - sum(seconds[count:])


@njit
def pendulum_loop(steps, iterations, h, rho):
    """Generalized-alpha on the pendulum as one would write it in C, its matrices dense and eliminated with exchanges: the place behind so many
    steps of so many iterations.
    """
    alpha_m, alpha_f = (2 * rho - 1) / (rho + 1), rho / (rho + 1)
    gamma = 0.5 + alpha_f - alpha_m
    beta, M, K, force = 0.25 * (0.5 + gamma) ** 2, np.eye(2), np.zeros((2, 2)), np.array([0.0, 9.81])
    c_a, c_v, c_s = (1 - alpha_m) / ((1 - alpha_f) * beta * h * h), gamma / (beta * h), 1 / (beta * h * h)
    q, v, a, s, lam, A = np.array([-1.0, 0.0]), np.zeros(2), -force, -force, 0.0, np.zeros((3, 4))
    for _ in range(steps):
        for i in range(2):
            ahead = (alpha_f * a[i] - alpha_m * s[i]) / (1 - alpha_m)
            q[i] += h * v[i] + h * h * ((0.5 - beta) * s[i] + beta * ahead)
            v[i] += h * ((1 - gamma) * s[i] + gamma * ahead)
            s[i], a[i] = ahead, 0.0
        for _ in range(iterations):
            A[2, 2], A[2, 3] = 0.0, -0.5 * (q[0] * q[0] + q[1] * q[1] - 1.0)
            for i in range(2):
                A[i, 2] = A[2, i] = q[i]
                A[i, 3] = -force[i] - q[i] * lam
                for j in range(2):
                    A[i, 3] -= M[i, j] * a[j]
                    A[i, j] = c_a * M[i, j] + K[i, j] + (lam if i == j else 0.0)
            eliminate(A)
            lam += A[2, 3]
            for i in range(2):
                d = A[i, 3]
                q[i], v[i], s[i], a[i] = q[i] + d, v[i] + c_v * d, s[i] + c_s * d, a[i] + c_a * d
    return q


@njit
def eliminate(A):
    """Solve `A[:, :n] x = A[:, n]` in place, x in the last column, by rows of the largest pivot."""
    n = len(A)
    for k in range(n):
        p = k
        for i in range(k + 1, n):
            p = i if abs(A[i, k]) > abs(A[p, k]) else p
        for j in range(k, n + 1):
            A[k, j], A[p, j] = A[p, j], A[k, j]
        for i in range(k + 1, n):
            share = A[i, k] / A[k, k]
            for j in range(k + 1, n + 1):
                A[i, j] -= share * A[k, j]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            A[k, n] -= A[k, j] * A[j, n]
        A[k, n] /= A[k, k]


def pendulum_row(rounds, stepped):
    """Microseconds of a step of the compiled pendulum, and of the loop with as many iterations. stepped: as of mechanisms."""
    problem, model = get("pendulum"), compiled(get("pendulum").model)
    start = {"q0": problem.q0, "v0": problem.v0}
    run = pi.solve(model, 1.0, pi.GeneralizedAlpha(h=H), **start)
    iterations = round(run.counts.newton_iterations / run.counts.steps)
    loop, steps = partial(pendulum_loop, STEPS["alpha"], iterations, H, 0.9), STEPS["alpha"]
    loop()
    rows = [
        {name: stepped(model, name, count, **start) for name, count in STEPS.items()} | {"loop": 1e6 * cpu(loop)[0] / steps}
        for _ in range(rounds + 1)
    ]
    result = {f"{name}_us": float(np.median([row[name] for row in rows[1:]])) for name in rows[0]}
    return {
        "n": 2,
        "m": 1,
        "iterations": iterations,
        "alpha_over_loop": float(np.median([row["alpha"] / row["loop"] for row in rows[1:]])),
    } | result
