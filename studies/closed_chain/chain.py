"""A chain of bars pinned at both ends, in the angles of the bars: its model, and the same equations by hand for other packages."""

import time
from functools import cache

import numpy as np
import sympy as sp
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from sympy.physics.mechanics import dynamicsymbols

import polyida as pi

SPAN = sp.Rational(3, 5)  # of the chain's length, between its pins
VALUES = {"m": 1.0, "l": 1.0, "g": 9.81}
T_END = 1.0  # s
ENOUGH = 1e-7  # rad: a side stops at its first run with a smaller error
NO_FRAMES = 10**9
RTOL = tuple(10.0 ** np.arange(-4, -10, -1))
STEPS = 10.0 ** np.arange(-2, -4.1, -0.5)  # s
BY_IVP = ("DOP853", "RK45", "LSODA", "Radau", "BDF")


def cpu(call):
    """(CPU seconds of a call in this process, its result)."""
    begin = time.process_time()
    result = call()
    return time.process_time() - begin, result


def expressions(links):
    """(L, q, phi, {symbol: value})."""
    t, q = dynamicsymbols._t, dynamicsymbols(f"q:{links}")
    m, l, g = symbols = sp.symbols("m l g")  # noqa: E741
    x = y = lagrangian = 0
    for one in q:
        cx, cy = x + l / 2 * sp.cos(one), y + l / 2 * sp.sin(one)
        x, y = x + l * sp.cos(one), y + l * sp.sin(one)
        lagrangian += m / 2 * (cx.diff(t) ** 2 + cy.diff(t) ** 2) + m * l**2 / 24 * one.diff(t) ** 2 - m * g * cy
    return lagrangian, q, [x - SPAN * links * l, y], dict(zip(symbols, VALUES.values()))


def model_of(links):
    """The model; it is derived anew."""
    lagrangian, q, phi, values = expressions(links)
    return pi.symbolic.lagrangian(lagrangian, q, phi, values=values)


def start(links):
    """Angles of an arc that hangs between the pins, (links,)."""
    angles = np.linspace(-1.0, 1.0, links)
    size = brentq(lambda s: np.cos(s * angles).sum() - float(SPAN) * links, 0.1, 3.0)
    return size * angles


@cache
def functions(links):
    """(M, g, phi, phi_q, phi_bias) as numpy functions of q and v, by sympy's lambdify from the equations of the model."""
    equations = type(model_of(links)).equations
    s, values = equations.symbols, {}
    for _, ours, value in s.parameters.values():
        values[ours] = value
    values |= {one: meaning.xreplace(values) for one, meaning in equations.constants.items()}
    of_rows = equations.functions_of_rows
    entries = sp.Matrix(equations.mass), of_column(equations.force), of_column(of_rows["phi"]), sp.Matrix(equations.rows)
    made = [sp.lambdify([s.q, s.v], one.xreplace(values), "numpy", cse=True) for one in (*entries, of_column(of_rows["phi_bias"]))]
    flat = (False, True, True, False, True)
    return [(lambda q, v, f=f: f(q, v)[:, 0]) if column else f for f, column in zip(made, flat)]


def of_column(entries):
    """A matrix with one column."""
    return sp.Matrix(len(entries), 1, entries)


def accelerations(links):
    """y' of y = (q, v), with accelerations from one solve of M and phi_q."""
    M, g, _, B, bias = functions(links)
    whole = np.zeros((links + 2, links + 2))

    def rates(t, y):
        q, v = y[:links], y[links:]
        whole[:links, :links], whole[links:, :links] = M(q, v), B(q, v)
        whole[:links, links:] = whole[links:, :links].T
        return np.concatenate([v, np.linalg.solve(whole, -np.concatenate([g(q, v), bias(q, v)]))[:links]])

    return rates


def stabilised(links):
    """F(t, y, y') of q, v, mu and lam in the form of Gear, Gupta and Leimkuhler, and (y, y') at the start."""
    M, g, phi, B, _ = functions(links)
    n, two = links, slice(2 * links, 2 * links + 2)

    def residual(t, y, yp):
        q, v, rows = y[:n], y[n : 2 * n], B(y[:n], y[n : 2 * n])
        r = M(q, v) @ yp[n : 2 * n] + g(q, v) + rows.T @ y[2 * n + 2 :]
        return np.concatenate([yp[:n] - v + rows.T @ y[two], r, phi(q, v), rows @ v])

    y = np.concatenate([start(links), np.zeros(n + 4)])
    yp = np.zeros_like(y)
    zero = np.zeros(n)
    rows = B(y[:n], zero)
    whole = np.block([[M(y[:n], zero), rows.T], [rows, np.zeros((2, 2))]])
    found = np.linalg.solve(whole, -np.append(g(y[:n], zero), np.zeros(2)))
    yp[n : 2 * n], y[2 * n + 2 :] = found[:n], found[n:]
    return residual, y, yp


def runs_of(side, links, model):
    """Yield (setting, function that runs and returns q and v at the end) of a side. Raises ImportError if its package is missing."""
    if side in ("alpha", "radau", "ida"):
        made = {"alpha": [pi.GeneralizedAlpha(h=h) for h in STEPS], "radau": map(lambda rtol: pi.RadauIIA(rtol=rtol), RTOL)}
        made["ida"] = (pi.IDA(rtol=rtol) for rtol in RTOL)
        for one in made[side]:
            yield repr(one), lambda one=one: ended(pi.solve(model, T_END, one, q0=start(links), every=NO_FRAMES))
        return
    y0 = np.concatenate([start(links), np.zeros(links)])
    for rtol in RTOL:
        if side in BY_IVP:
            rates = accelerations(links)
            yield f"rtol {rtol:.0e}", lambda rtol=rtol, rates=rates: solve_ivp(rates, (0.0, T_END), y0, side, rtol=rtol, atol=rtol).y[:, -1]
        elif side == "solve_dae":
            yield f"rtol {rtol:.0e}", lambda rtol=rtol: by_solve_dae(links, rtol)
        else:
            yield f"rtol {rtol:.0e}", lambda rtol=rtol: by_sundae(links, rtol)


def ended(run):
    """q and v at the end of a run."""
    return np.append(run.q[-1], run.v[-1])


def with_integrals(links):
    """The same of q, v and the integrals of mu and lam, so that no unknown is without a derivative; (F, y, y')."""
    residual, y, yp = stabilised(links)
    yp[2 * links :], y[2 * links :] = y[2 * links :], 0.0
    return lambda t, y, yp: residual(t, np.append(y[: 2 * links], yp[2 * links :]), yp), y, yp


def by_solve_dae(links, rtol):
    """q and v at the end by solve_dae's Radau."""
    from solve_dae.integrate import solve_dae

    move, y, yp = with_integrals(links)
    made = solve_dae(move, (0.0, T_END), y, yp, method="Radau", rtol=rtol, atol=rtol, t_eval=[0.0, T_END])
    if not made.success:
        raise RuntimeError(str(made.message))
    return made.y[: 2 * links, -1]


def by_sundae(links, rtol):
    """q and v at the end by the IDA of scikit-sundae."""
    from sksundae.ida import IDA

    move, y, yp = with_integrals(links)

    def filled(t, y, yp, res):
        res[:] = move(t, y, yp)

    made = IDA(filled, rtol=rtol, atol=rtol, max_num_steps=100_000).solve([0.0, T_END], y, yp)
    if not made.success:
        raise RuntimeError(str(made.message))
    return np.asarray(made.y)[-1, : 2 * links]


def row(links, side, rounds):
    """Rows {error of q, rad; CPU seconds, median; energy error, J; |phi|, m} of all settings of a side."""
    model = model_of(links)
    exact = pi.solve(model, T_END, pi.RadauIIA(rtol=1e-12), q0=start(links), every=NO_FRAMES)
    before = pi.solve(model, 1e-3, pi.RadauIIA(rtol=1e-6), q0=start(links)).energy.total[0]
    rows = []
    for setting, go in runs_of(side, links, model):
        try:
            go()
            seconds, end = zip(*(cpu(go) for _ in range(rounds)))
        except RuntimeError as error:
            rows.append({"setting": setting, "outcome": str(error)})
            continue
        q, v = end[-1][:links], end[-1][links:]
        kinetic = 0.5 * v @ model.mass(q) @ v
        rows.append(
            {
                "setting": setting,
                "outcome": "done",
                "cpu_s": float(np.median(seconds)),
                "error_rad": float(np.abs(q - exact.q[-1]).max()),
                "energy_J": float(abs(kinetic + model.potential(q) - before)),
                "phi_m": float(np.abs(model.phi(T_END, q)).max()),
            }
        )
        if rows[-1]["error_rad"] < ENOUGH:
            break
    return rows


def derive_row(links):
    """CPU seconds to derive the model, and of the first runs, with compiling unless the machine code is on disk."""
    seconds, model = cpu(lambda: model_of(links))
    integrators = {"alpha": pi.GeneralizedAlpha(h=1e-3), "radau": pi.RadauIIA(rtol=1e-6), "ida": pi.IDA(rtol=1e-6)}
    first = {f"first_{name}_s": cpu(lambda one=one: pi.solve(model, T_END, one, q0=start(links)))[0] for name, one in integrators.items()}
    return {"derive_s": seconds, "first_s": sum(first.values())} | first
