"""Models from a Lagrangian, and from matrices."""

from collections.abc import Mapping

import numpy as np
import sympy as sp

from polyida.errors import InputError
from polyida.symbolic.derivation import Equations
from polyida.symbolic.derivatives import Derivative, jacobian, symmetric_jacobian
from polyida.symbolic.expressions import Symbols, T, entries, expression_of, listed, rows_of
from polyida.symbolic.model import model_of
from polyida.symbolic.sums import as_sum

STATES, SEED, DEPENDENT = 3, 0, 1e-8  # random states at which velocity rows are compared; a smaller rest of a row is round-off
ITERATIONS = 50


def lagrangian(L, q, phi, psi, forces, states, values, compiled, part="symbolic.lagrangian", also=None):
    """The SymbolicModel of a Lagrangian L with coordinates q, constraints phi and psi, and generalised forces.

    also: {the user's symbol: what it stands for}, see Equations; if it is given, values may be unused.
    """
    s, given = _symbols(part, q, states, values), {}
    given["L"] = expression_of(part, "L", L)
    L = s.read("L", given["L"])
    L, constants = as_sum(L, {ours for _, ours, _ in s.parameters.values()})
    momenta = jacobian([L], s.v)[0]
    mass = symmetric_jacobian(momenta, s.v)
    if any(entry.free_symbols & set(s.v) for row in mass for entry in row):
        raise s.error("L", given["L"], "it must be quadratic in the velocities")
    rates, rows = _rates(s, states, given), _rows(s, phi, psi, given)
    extra = _forces(s, forces, given)
    moving = Derivative(s.rates_of_functions() | dict(zip(s.q, s.v)) | dict(zip(s.x, rates)))
    pushes = jacobian([L], s.q)[0]
    force = [sp.Add(moving(p), -push, -F) for p, push, F in zip(momenta, pushes, extra)]
    still = -L.xreplace(dict.fromkeys(s.v, sp.S.Zero))
    potential = None if still.free_symbols & _moving(s) else still
    if also is None:
        s.require_used()
    return model_of("Lagrangian", Equations(s, mass, force, *rows, rates, extra, potential, given, also or {}, constants), compiled)


def equations(M, g, q, phi, psi, states, values, potential, compiled, part="symbolic.equations", also=None):
    """The SymbolicModel of a mass matrix M, forces g and constraints phi and psi.

    also: {the user's symbol: what it stands for}, see Equations; if it is given, rows of psi that follow from phi are left out.
    """
    s, given = _symbols(part, q, states, values), {}
    n = len(s.q)
    M = rows_of(part, "M", M)
    g = listed(part, "g", g)
    if [len(row) for row in M] != [n] * n or len(g) != n:
        shape = len(M), *sorted({len(row) for row in M})
        raise InputError(f"{part}: M has the shape {shape} and g {len(g)} entries; of {n} coordinates they are ({n}, {n}) and {n}")
    for i in range(n):
        for j in range(n):
            given[f"M[{i}, {j}]"] = M[i][j]
    given |= {f"g[{k}]": one for k, one in enumerate(g)}
    mass = [[s.read(f"M[{i}, {j}]", M[i][j], 0) for j in range(n)] for i in range(n)]
    force = [s.read(f"g[{k}]", one) for k, one in enumerate(g)]
    rates, rows = _rates(s, states, given), _rows(s, phi, psi, given)
    if potential is not None:
        given["potential"] = expression_of(part, "potential", potential)
        potential = s.read("potential", given["potential"], 0)
        if found := potential.free_symbols & _moving(s):
            raise s.error("potential", given["potential"], f"it must depend on q alone, not on {min(found, key=str)}")
    if also is None:
        s.require_used()
    else:
        rows = rows[0], independent(s, *rows)
    return model_of("Equations", Equations(s, mass, force, *rows, rates, [], potential, given, also or {}, {}), compiled)


def independent(s, phi, psi):
    """The velocity rows that do not follow from phi and from those before them, at random states on phi = 0."""
    if not (phi and psi):
        return psi
    moving, still = Derivative(s.rates_of_functions() | dict(zip(s.q, s.v))), dict.fromkeys(s.v, sp.S.Zero)
    rates = [*map(moving, phi), *psi]
    values = {ours: value for _, ours, value in s.parameters.values()}
    values |= {one: value for ours, profile in zip(s.functions.values(), s.profiles) for one, value in zip(ours, profile.at(0.0))}
    values[T] = 0.0
    whole = [sp.Matrix(one).xreplace(values) for one in (phi, jacobian(rates, s.v), [rate.xreplace(still) for rate in rates])]
    value, rows, free = (sp.lambdify([s.q], one, "numpy", cse=True) for one in whole)
    random, kept = np.random.default_rng(SEED), [*range(len(phi))]
    states = [_on_rows(value, rows, len(phi), random.standard_normal(len(s.q))) for _ in range(STATES)]
    for k in range(len(phi), len(rates)):
        if any(_apart(np.hstack([rows(q), free(q)]), kept, k) for q in states):
            kept.append(k)
    return [psi[k - len(phi)] for k in kept[len(phi) :]]


def _on_rows(value, rows, count, q):
    """A state near q where the first rows, so many, are zero; q itself if Newton's method finds none."""
    at = q
    for _ in range(ITERATIONS):
        at = at - np.linalg.lstsq(rows(at)[:count], value(at)[:, 0])[0]
    return at if np.isfinite(at).all() and np.abs(value(at)).max() < DEPENDENT else q


def _apart(whole, kept, k):
    """True if row k of `whole` is linearly independent of the rows `kept`."""
    shares = np.linalg.lstsq(whole[kept].T, whole[k])[0]
    return np.abs(whole[k] - shares @ whole[kept]).max() > DEPENDENT * max(1.0, np.abs(whole[k]).max())


def _symbols(part, q, states, values):
    """The Symbols of a model for the user's coordinates q, states {state: derivative} and values. Raises InputError."""
    if states is not None and not isinstance(states, Mapping):
        raise InputError(f"{part}: states = {states!r:.80} must be a dictionary {{state: its derivative}}")
    return Symbols(part, entries(part, "q", q), [*(states or ())], {} if values is None else values)


def _moving(s):
    """The symbols that a potential energy must not contain: t, v, a, x and functions of time."""
    return {T, *s.v, *s.a, *s.x} | {one for ours in s.functions.values() for one in ours}


def _rates(s, states, given):
    """The rates of the states in the model's symbols; the user's expressions are noted in `given`."""
    rates = []
    for state, rate in (states or {}).items():
        given[f"rate of {state}"] = expression_of(s.part, f"states[{state}]", rate)
        rates.append(s.read(f"states[{state}]", given[f"rate of {state}"]))
    return rates


def _forces(s, forces, given):
    """The generalised forces (n,) in the model's symbols, zeros if none are given."""
    forces = listed(s.part, "forces", forces)
    if forces and len(forces) != len(s.q):
        raise InputError(f"{s.part}: forces has {len(forces)} entries; give one for each of the {len(s.q)} coordinates, 0 for none")
    given |= {f"forces[{k}]": one for k, one in enumerate(forces)}
    return [s.read(f"forces[{k}]", one) for k, one in enumerate(forces)] or [sp.S.Zero] * len(s.q)


def _rows(s, phi, psi, given):
    """(phi, psi) in the model's symbols. Raises InputError for rows that are none."""
    result = []
    for name, rows, allowed, moving in (("phi", phi, 0, s.q), ("psi", psi, 1, s.v)):
        result.append([])
        for k, row in enumerate(listed(s.part, name, rows)):
            label = f"{name}[{k}]"
            given[label] = row
            one = s.read(label, row, allowed)
            if states := one.free_symbols & set(s.x):
                raise s.error(label, row, f"a constraint must have no states, but it has {s.user_x[s.x.index(min(states, key=str))]}")
            if not one.free_symbols & set(moving):
                raise s.error(label, row, f"it has no {'velocity' if name == 'psi' else 'coordinate'}, so that it holds nothing")
            if name == "psi" and any(slope.free_symbols & set(s.v) for slope in jacobian([one], s.v)[0]):
                raise s.error(label, row, "it must be linear in the velocities")
            result[-1].append(one)
    return result
