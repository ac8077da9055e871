"""The rigid double pendulum by Radau IIA of this package and by the Radau of solve_dae: CPU seconds at an error of the tip.

Both solve the same equations, each in its form.
"""

from functools import partial

import numpy as np

import polyida as pi
from small_systems.own_models import NO_FRAMES, cpu

ERROR, T_END = 1e-8, 1.0  # m, s
RTOL = 10.0 ** np.arange(-5, -11.1, -0.5)
MASSES = np.array([1.0, 1.0, 1 / 12, 1.0, 1.0, 1 / 12])  # kg and kg m^2 of two bars of 1 m
WEIGHT = np.array([0.0, 9.81, 0.0, 0.0, 9.81, 0.0])  # N
Q0 = np.array([0.5, 0.0, 0.0, 1.5, 0.0, 0.0])


def rows(q):
    """(phi, phi_q) of both pins, in places and angles."""
    cos, sin = 0.5 * np.cos(q[2::3]), 0.5 * np.sin(q[2::3])
    phi = np.array([q[0] - cos[0], q[1] - sin[0], q[3] - cos[1] - q[0] - cos[0], q[4] - sin[1] - q[1] - sin[0]])
    B = np.array([[1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0], [-1, 0, 0, 1, 0, 0], [0, -1, 0, 0, 1, 0]], float)
    B[:, 2], B[2:, 5] = [sin[0], -cos[0], sin[0], -cos[0]], [sin[1], -cos[1]]
    return phi, B


def residual(t, y, yp):
    """F of q, v and the integrals of both multipliers, in the stabilised form of Gear, Gupta and Leimkuhler."""
    v, (phi, B) = y[6:12], rows(y[:6])
    return np.concatenate([yp[:6] - v + B.T @ yp[12:16], MASSES * yp[6:12] + WEIGHT + B.T @ yp[16:], phi, B @ v])


def theirs(rtol):
    """(CPU seconds, tip) of solve_dae. Raises ImportError if it is not installed."""
    from solve_dae.integrate import solve_dae

    y, yp, B = np.zeros(20), np.zeros(20), rows(Q0)[1]
    y[:6], yp[16:] = Q0, -np.linalg.solve(B / MASSES @ B.T, B @ (WEIGHT / MASSES))
    yp[6:12] = -(WEIGHT + B.T @ yp[16:]) / MASSES
    seconds, result = cpu(lambda: solve_dae(residual, (0.0, T_END), y, yp, method="Radau", rtol=rtol, atol=rtol, t_eval=[0.0, T_END]))
    x, y, angle = result.y[3:6, -1]
    return seconds, np.array([x + 0.5 * np.cos(angle), y + 0.5 * np.sin(angle)])


def ours(model, rtol):
    """(CPU seconds, tip) of a run here."""
    seconds, run = cpu(lambda: pi.solve(model, T_END, pi.RadauIIA(rtol=rtol), every=NO_FRAMES))
    centre, turned = (model.reference + run.q[-1].reshape(-1, 2))[2:]
    return seconds, centre + 0.5 * turned / np.linalg.norm(turned)


def peer_row(model, rounds):
    """CPU seconds of both at the largest tolerance whose tip is within ERROR, and the ratio. Raises ImportError without solve_dae."""
    sides, row, least = {"radau": partial(ours, model), "solve_dae": theirs}, {"n": model.n, "m": model.m}, {}
    exact = ours(model, 1e-12)[1]
    for name, side in sides.items():
        errors = {rtol: float(np.abs(side(rtol)[1] - exact).max()) for rtol in RTOL}
        least[name] = next(rtol for rtol, error in errors.items() if error < ERROR)
        row |= {f"{name}_rtol": least[name], f"{name}_error_m": errors[least[name]]}
    times = [{name: side(least[name])[0] for name, side in sides.items()} for _ in range(rounds)]
    row |= {f"{name}_s": float(np.median([result[name] for result in times])) for name in sides}
    return row | {"radau_over_solve_dae": float(np.median([result["radau"] / result["solve_dae"] for result in times]))}
