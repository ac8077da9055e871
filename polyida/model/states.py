"""First-order states x of a user's model, `x' = rates`, and algebraic states s, `0 = f(s)` with a regular slope.

First-order states are the velocities of coordinates behind the model's own: their equation, `mass (v' - x'/sizes) = 0`, has the form of an
equation of motion. Algebraic states are solved for where forces are evaluated. So integrators know nothing of states.
"""

import ctypes

import numpy as np
from numba import carray
from scipy.sparse import block_diag, csr_array, eye_array, hstack

from polyida.errors import DONE, RAISED, WRONG_SHAPE, InputError
from polyida.jit import part, shared
from polyida.jit.intrinsics import call
from polyida.jit.user_functions import CALLBACK
from polyida.linear.dense import factor, put, solve
from polyida.model.functions import SHAPES, arguments_of
from polyida.validation import floats, is_whole, takes

# constants of compiled code
STEP = 1e-7  # relative step of central differences
ROUND, CLOSE = 1e-13, 1e-9  # relative corrections of which the next one, or the one after it, is the last
FAST = 1e-3  # ratio of corrections with which a slope is used again
SINGULAR = 1e-7  # least pivot of the slope, with rows and columns of size one, of a regular slope
MOST, LEAST = 50, 2.0**-12  # iterations, and share of a step
FOUND, FLAT, LOST = range(3)  # how it ended
WHY = "", "their slope d rates/ds is singular", "Newton's method from start() does not converge"
LAST = ("rates", "force", "residual", "powers")  # get the states as their last argument
EXCLUDED = ("tangent", "force_q", "force_v", "residual_p", "mass_system", "step_matrix", "increments")  # they know nothing of states


@part
def evaluate(function, data, t, places, v, values, outputs, rates):
    """Fill rates by a C function (jit/user_functions.py); nan if it fails."""
    if call(function, (data, 0, t, places, v, values, outputs, rates)) != DONE:
        rates[:] = np.nan


@part
def largest(change, values, first, sizes):
    """The largest of `|change_i| sizes_i / (sizes_i + |values_(first + i)|)`.

    change: of the algebraic states, in units of their sizes. values: all states, the algebraic ones from number `first` on.
    """
    size = 0.0
    for i in range(change.shape[0]):
        size = max(size, abs(change[i]) * sizes[i] / (sizes[i] + abs(values[first + i])))
    return size


@part
def fill_slope(asked, values, first, sizes, rates, behind, slope):
    """slope (count, count) = the derivatives of the last rates in the algebraic states, in their sizes, by central differences.

    asked: the C function and its arguments before `values`, as of `fill_algebraic`.
    """
    function, data, t, places, v, outputs = asked
    for j in range(sizes.shape[0]):
        middle, step = values[first + j], STEP * max(sizes[j], abs(values[first + j]))
        values[first + j] = middle + step
        evaluate(function, data, t, places, v, values, outputs, rates)
        values[first + j] = middle - step
        evaluate(function, data, t, places, v, values, outputs, behind)
        values[first + j] = middle
        for i in range(sizes.shape[0]):
            slope[i, j] = (rates[first + i] - behind[first + i]) / (2.0 * step) * sizes[j]


@part
def factor_rows(slope, left, rows, pivots, change):
    """Factor the slope, its rows divided by their largest entries `rows`, and set change = -slope^-1 left. False if it is singular."""
    for i in range(left.shape[0]):
        rows[i] = 0.0
        for j in range(left.shape[0]):
            rows[i] = max(rows[i], abs(slope[i, j]))
        change[i] = -left[i] / rows[i] if rows[i] > 0.0 else np.nan
        for j in range(left.shape[0]):
            slope[i, j] /= rows[i]
    if not factor(slope, pivots):
        return False
    for i in range(left.shape[0]):
        if not abs(slope[i, i]) < 1.0 / SINGULAR:
            return False
    solve(slope, pivots, change)
    return True


@shared
def fill_algebraic(function, data, t, places, v, outputs, values, first, sizes, rates):
    """Fill the algebraic states of `values`, from number `first` on, and the rates: Newton's method with shorter steps where corrections do not fall.

    function, data, t, places, v, outputs: a C function of the rates, and its arguments beside `values` and rates. sizes: typical sizes of the
    algebraic states; `values` holds a guess of them. Returns how it ended.
    """
    count, behind = sizes.shape[0], np.zeros_like(rates)
    free, slope, pivots = values[first : first + count], np.empty((count, count)), np.empty(count, np.int64)
    change, left, rows = np.empty(count), np.empty(count), np.empty(count)
    evaluate(function, data, t, places, v, values, outputs, rates)
    for i in range(count):
        left[i] = rates[first + i]
    for _ in range(MOST):
        fill_slope((function, data, t, places, v, outputs), values, first, sizes, rates, behind, slope)
        if not factor_rows(slope, left, rows, pivots, change):
            return FLAT
        ratio = 0.0
        while ratio <= FAST:
            share, moved, before, size = 1.0, 0.0, 0.0, 0.0
            while True:  # until the next correction, left, is smaller than this one
                for i in range(count):
                    free[i] += (share - moved) * change[i] * sizes[i]
                evaluate(function, data, t, places, v, values, outputs, rates)
                for i in range(count):
                    left[i] = -rates[first + i] / rows[i]
                solve(slope, pivots, left)
                size, before = largest(left, values, first, sizes), largest(change, values, first, sizes)  # in one norm, which depends on s
                if size <= max(CLOSE, (1.0 - 0.25 * share) * before):
                    break
                moved, share = share, 0.5 * share
                if share < LEAST:
                    return LOST
            if size <= ROUND or before <= CLOSE:
                for i in range(count):
                    free[i] += left[i] * sizes[i]
                evaluate(function, data, t, places, v, values, outputs, rates)
                return FOUND
            put(1.0, left, change)
            ratio = size / before if share == 1.0 else 1.0  # a shorter step does not show how good the slope is
        for i in range(count):
            left[i] = rates[first + i]
    return LOST


@part
def with_algebraic(function, data, t, q, v, states, guess, sizes):
    """The states of an own model with the algebraic ones behind them; nan for these without a solution."""
    k, s = states.shape[0], np.empty(states.shape[0] + guess.shape[0])
    for i in range(s.shape[0]):
        s[i] = states[i] if i < k else guess[i - k]
    if fill_algebraic(function, data, t, q, v, 0, s, k, sizes, np.zeros_like(s)) != FOUND:
        s[k:] = np.nan
    return s


@part
def states_at(numbers, sizes):
    """The states whose velocities are at a pointer."""
    x, v = np.empty(sizes.shape[0]), carray(numbers, sizes.shape)
    for i in range(x.shape[0]):
        x[i] = v[i] * sizes[i]
    return x


@part
def fill_states(out, mass, a, rates, factors):
    """Fill r of the states: -rates times factors, plus mass times their accelerations."""
    for i in range(out.shape[0]):
        out[i] = -rates[i] * factors[i]
        if mass != 0.0:
            out[i] += mass * a[i]


@part
def embed(whole, found, corner):
    """whole = found in its first rows and columns, and corner on the diagonal behind them."""
    for i in range(whole.shape[0]):
        for j in range(whole.shape[1]):
            inside = i < found.shape[0] and j < found.shape[1]
            whole[i, j] = found[i, j] if inside else corner if i == j else 0.0


HELPERS = ("with_algebraic", with_algebraic), ("states_at", states_at), ("fill_states", fill_states), ("embed", embed)  # of source texts


def solved(f, s, sizes):
    """(the s, (k,), with f(s) = 0, "") or (nan, why there is none), of a Python function f (k,) -> (k,). s: the guess; sizes (k,)."""
    s, raised, vector = np.array(s, float), [], ctypes.c_double * len(s)

    def called(*arguments):
        """Write f(s) where the kernel reads it, as a C function; keep what f raises."""
        try:
            np.frombuffer(vector.from_address(arguments[-1]))[:] = f(s.copy())
        except BaseException as error:  # noqa: BLE001 it is raised below
            raised.append(error)
            return RAISED
        return DONE

    callback = CALLBACK(called)
    ended = fill_algebraic(ctypes.cast(callback, ctypes.c_void_p).value, 0, 0, 0, 0, 0, s, 0, np.array(sizes, float), np.empty_like(s))
    if raised:
        raise raised[0]
    return (s if ended == FOUND else np.full(len(s), np.nan)), WHY[ended]


class OwnStates:
    """The states of a user's model of n coordinates: k, and behind them `total - k` algebraic ones.

    start, sizes (total,): x0 and sizes_x. why: why the last algebraic states have no solution, or "". mass: of the coordinates whose
    velocities they are; the mean one of the model at q = 0, for norms.
    """

    def __init__(self, name, user, n, written):
        """Store numbers k of states, start values and sizes of the states of a user's model of n coordinates, and a typical mass.

        name: of its class. user: the model. written: names of the functions that it gives. The mass is the mean diagonal of M at q = 0, or
        1. Raises InputError for a wrong number, or for functions that a model with states cannot have or that do not take the states.
        """
        self.n, k, algebraic = n, user.k, user.algebraic
        if not (is_whole(k, 0) and is_whole(algebraic, 0) and k + algebraic > 0):
            given = f"k = {k!r} and algebraic = {algebraic!r}" if algebraic else f"k = {k!r}"
            raise InputError(f"{name} has rates: {given} must be the whole number of its states, at least 1")
        self.k, self.total, self.own, self.rates, self.why, self._last = int(k), int(k + algebraic), slice(0, n), None, "", ((), ())
        self.start = self._numbers(name, "x0", user.x0, 0.0, -np.inf, "finite")
        self.sizes = self._numbers(name, "sizes_x", user.sizes_x, 1.0, 0.0, "positive")
        if wrong := [function for function in EXCLUDED if function in written]:
            raise InputError(f"{name}: a model with states cannot have {wrong[0]}; leave it out, differences take its place")
        for function in LAST:
            arguments = [*arguments_of(function), *(() if function == "rates" else "x")]
            if function in written and not takes(getattr(user, function), len(arguments)):
                raise InputError(f"{name}.{function} must take the states as its last argument: {function}({', '.join(arguments)})")
        self.mass = 1.0
        try:
            with np.errstate(all="ignore"):
                mean = float(np.abs(user.mass(np.zeros(n)).diagonal()).mean())
        except Exception:  # noqa: BLE001 whatever a function of a user raises at q = 0
            mean = 0.0
        if 0.0 < mean < np.inf:
            self.mass = mean

    def _numbers(self, name, field, value, default, least, kind):
        """x0 or sizes_x as an array (total,), `default` if it is None. Raises InputError unless they are above `least`."""
        numbers = np.full(self.total, default) if value is None else floats(value)
        if np.shape(numbers) != (self.total,) or not (numbers > least).all():
            raise InputError(f"{name}: {field} = {value!r} must be {self.total} {kind} numbers")
        return numbers

    def states(self, t, q, v):
        """All states, (total,), at q and v of the whole model; algebraic ones without a solution are nan."""
        x, k = v[self.n :] * self.sizes[: self.k], self.k
        if self.total == k:
            return x
        state = t, q.tobytes(), v.tobytes()
        if self._last[0] != state:  # forces and rates are asked for at one state
            rates = lambda free: self.rates(t, q[self.own], v[self.own], np.append(x, free))[k:]  # noqa: E731
            free, self.why = solved(rates, self.start[k:], self.sizes[k:])
            self._last = state, np.append(x, free)
        return self._last[1].copy()

    def arguments(self, name, at):
        """The arguments of the user's function for those of the whole model: its part of q, v and a, and the states if it takes them."""
        own = [value[..., self.own] if argument in ("q", "v", "a") else value for argument, value in zip(arguments_of(name), at)]
        if name in LAST:
            own.append(self.states(*at[:3]))
        return own

    def of_whole(self, name, result, at):
        """The result of the user's function at arguments of the whole model, in the size of the whole model."""
        shape = SHAPES[name]
        if shape == "m":
            return result
        if shape == "n":
            rates = self.rates(*self.arguments("rates", at[:3]))[: self.k]
            change = at[3][self.n :] if name == "residual" else 0.0
            return np.concatenate((result, self.mass * (change - rates / self.sizes[: self.k])))
        corner = self.mass if name == "mass" else 0.0
        if not isinstance(result, np.ndarray):
            if shape == "mn":
                return hstack([result, csr_array((result.shape[0], self.k))], format="csr")
            return block_diag([result, corner * eye_array(self.k)], format="csr")
        whole = np.zeros((result.shape[0] + (shape == "nn") * self.k, self.n + self.k))
        whole[: result.shape[0], : self.n] = result
        if shape == "nn":
            whole[self.n :, self.n :] = corner * np.eye(self.k)
        return whole

    def read(self, data, rates, kinds, whole):
        """Source text of the argument x of compiled functions; whole: as of Compiled."""
        behind, k = f"pointer(c + {8 * self.n})", self.k
        if not whole:
            return f"states_at({behind}, {data.view(np.ones(self.total))})"
        x = f"states_at({behind}, {data.view(self.sizes[:k])})"
        if self.total == k:
            return x
        alone = data.view(np.array(data.c_function(rates, kinds | {"x": ("d", (self.total,))}, (self.total,))))
        return f"with_algebraic({alone}, data, t, b, c, {x}, {data.view(self.start[k:])}, {data.view(self.sizes[k:])})"

    def stored(self, name, shape, m, data, rates):
        """Arguments of OwnData.c_function with which a compiled function stores the result of the whole model."""
        n, N = self.n, self.n + self.k
        sizes = {"n": f"({N},)", "nn": f"({N}, {N})", "mn": f"({m}, {N})"}
        if shape not in sizes:
            return {}
        lines = [f"whole = carray(pointer(out), {sizes[shape]})"]
        if shape == "n":
            mass, factors = data.view(np.array(self.mass if name == "residual" else 0.0)), data.view(self.mass / self.sizes[: self.k])
            a = f"carray(pointer(d), ({N},))[{n}:]" if name == "residual" else "whole"
            lines += ["require_result(also)", f"if also.shape != ({self.total},):", f"    return {WRONG_SHAPE}"]
            lines += [f"fill_states(whole[{n}:], {mass}, {a}, also, {factors})", f"fill_vector(whole[:{n}], found, 1.0)"]
        else:
            lines += [f"embed(whole, found, {data.view(np.array(self.mass if name == 'mass' else 0.0))})"]
        return {"store": "\n    ".join(lines), "other": rates if shape == "n" else None}
