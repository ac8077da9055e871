"""First-order states x of a user's model, `x' = rates`, and algebraic states s, `0 = f(s)` with a regular slope.

First-order states are the velocities of coordinates behind the model's own: their equation, `mass (v' - x'/sizes) = 0`, has the form of an
equation of motion. Algebraic states are solved for where forces are evaluated. So integrators know nothing of states.
"""

import ctypes
from functools import cache, partial

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
FOUND, SINGULAR_SLOPE, DIVERGED = range(3)  # how Newton's method ended
WHY = (  # the text of each; {start}: where it began
    "",
    "their slope d rates/ds is singular",
    "Newton's method from {start} does not converge",
)
LAST = ("rates", "force", "residual", "powers")  # get the states as their last argument
EXCLUDED = ("tangent", "force_q", "force_v", "residual_p", "mass_system", "step_matrix", "increments")  # they know nothing of states


@part
def evaluate(function, data, t, places, v, values, outputs, rates):
    """Fill rates (k,), the rates of first-order states and behind them what is zero for algebraic ones, by a C function; nan if it fails.

    function: its address (jit/user_functions.py). data, t, places, v, values, outputs: its arguments; values (k,): all states.
    """
    if call(function, (data, 0, t, places, v, values, outputs, rates)) != DONE:
        rates[:] = np.nan


@part
def relative_size(change, values, first, sizes):
    """Return max |change_i| sizes_i / (sizes_i + |s_i|).

    change (count,): in sizes. s: the algebraic states, of `values` from number `first` on.
    """
    size = 0.0
    for i in range(change.shape[0]):
        size = max(size, abs(change[i]) * sizes[i] / (sizes[i] + abs(values[first + i])))
    return size


@part
def fill_slope(asked, values, first, sizes, rates, behind, slope):
    """slope (count, count) = the derivatives of the last rates in the algebraic states over their sizes, by central differences.

    asked: (function, data, t, places, v, outputs) of `evaluate`. The algebraic states are those of `values` from number `first` on;
    `values` is unchanged afterwards. rates and behind are scratch.
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
def factor_rows(slope, residual, rows, pivots, change):
    """Factor the slope, its rows divided by their largest entries `rows`, and set change = -slope^-1 residual.

    Returns False if the slope is singular.
    """
    for i in range(residual.shape[0]):
        rows[i] = 0.0
        for j in range(residual.shape[0]):
            rows[i] = max(rows[i], abs(slope[i, j]))
        change[i] = -residual[i] / rows[i] if rows[i] > 0.0 else np.nan
        for j in range(residual.shape[0]):
            slope[i, j] /= rows[i]
    if not factor(slope, pivots):
        return False
    for i in range(residual.shape[0]):
        if not abs(slope[i, i]) < 1.0 / SINGULAR:
            return False
    solve(slope, pivots, change)
    return True


@shared
def fill_algebraic(function, data, t, places, v, outputs, values, first, sizes, rates):
    """Fill the algebraic states s of `values`, from number `first` on, and the rates, so that g(s) = 0, g: the last rates.

    Newton's method: ds = -g_s^-1 g, s += share ds. share is 1, and halved until the next correction, -g_s^-1 g at the new s with the same
    slope g_s, is smaller than ds (natural monotonicity test: Deuflhard, Newton Methods for Nonlinear Problems, 2004). The same slope is used
    again while corrections fall by the factor FAST.

    function, data, t, places, v, outputs: a C function of the rates, and its arguments beside `values` and rates. sizes (count,): typical sizes
    of the algebraic states; `values` holds a guess of them. Returns how it ended: FOUND, SINGULAR_SLOPE or DIVERGED.
    """
    count = sizes.shape[0]
    behind = np.zeros_like(rates)
    free, slope, pivots = values[first : first + count], np.empty((count, count)), np.empty(count, np.int64)
    change = np.empty(count)  # the correction ds, over sizes
    residual = np.empty(count)  # g
    following = residual  # the same memory: the next correction, over sizes
    rows = np.empty(count)  # largest entry of each row of the slope
    evaluate(function, data, t, places, v, values, outputs, rates)
    for i in range(count):
        residual[i] = rates[first + i]
    for _ in range(MOST):
        fill_slope((function, data, t, places, v, outputs), values, first, sizes, rates, behind, slope)
        if not factor_rows(slope, residual, rows, pivots, change):
            return SINGULAR_SLOPE
        ratio = 0.0
        while ratio <= FAST:
            share, share_taken = 1.0, 0.0
            correction, next_correction = 0.0, 0.0  # relative sizes, in one norm, which depends on s
            while True:  # until the next correction is smaller than this one
                for i in range(count):
                    free[i] += (share - share_taken) * change[i] * sizes[i]
                evaluate(function, data, t, places, v, values, outputs, rates)
                for i in range(count):
                    following[i] = -rates[first + i] / rows[i]
                solve(slope, pivots, following)
                next_correction = relative_size(following, values, first, sizes)
                correction = relative_size(change, values, first, sizes)
                if next_correction <= max(CLOSE, (1.0 - 0.25 * share) * correction):
                    break
                share_taken, share = share, 0.5 * share
                if share < LEAST:
                    return DIVERGED
            if next_correction <= ROUND or correction <= CLOSE:
                for i in range(count):
                    free[i] += following[i] * sizes[i]
                evaluate(function, data, t, places, v, values, outputs, rates)
                return FOUND
            put(1.0, following, change)
            ratio = next_correction / correction if share == 1.0 else 1.0  # a shorter step does not show how good the slope is
        for i in range(count):
            residual[i] = rates[first + i]
    return DIVERGED


@part
def with_algebraic(function, data, t, q, v, states, guess, sizes):
    """Return the states (k,) of an own model with the algebraic ones behind them, (total,); these are nan without a solution.

    guess (total - k,): where Newton's method begins.
    """
    k, s = states.shape[0], np.empty(states.shape[0] + guess.shape[0])
    for i in range(s.shape[0]):
        s[i] = states[i] if i < k else guess[i - k]
    if fill_algebraic(function, data, t, q, v, 0, s, k, sizes, np.zeros_like(s)) != FOUND:
        s[k:] = np.nan
    return s


@part
def states_at(numbers, sizes):
    """Return the states, velocities times sizes, (k,), of the velocities at an address."""
    x, v = np.empty(sizes.shape[0]), carray(numbers, sizes.shape)
    for i in range(x.shape[0]):
        x[i] = v[i] * sizes[i]
    return x


@part
def fill_states(out, mass, a, rates, factors):
    """Fill out (k,), the rows of states in r: `mass a - rates factors`, factors = mass over sizes.

    mass is 0 for the force, which is without `mass a`.
    """
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


def solved(f, s, sizes, begun_at="start()"):
    """(the s, (k,), with f(s) = 0, "") or (nan, why there is none), of a Python function f (k,) -> (k,).

    s: the guess, named `begun_at` in messages. sizes (k,): typical sizes of s.
    """
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
    return (s if ended == FOUND else np.full(len(s), np.nan)), WHY[ended].format(start=begun_at)


@cache
def cuts_of(name):
    """For each argument of a function of Model: True for q, v and a, which have the coordinates of states behind the user's."""
    return tuple(argument in ("q", "v", "a") for argument in arguments_of(name))


class OwnStates:
    """The states of a user's model of n coordinates: k with rates, and behind them `total - k` algebraic ones.

    In q, v and a of the whole model the coordinates of the k states are behind the user's n. `in_whole_model` makes of a user's function one
    of the whole model.
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
        self.k = int(k)
        self.total = int(k + algebraic)
        self.own = slice(0, n)  # the user's coordinates
        self.rates = None  # the CheckedFunction of the user's rates
        self.why = ""  # why the last algebraic states have no solution
        self._last = ((), ())  # ((t, q, v), arrays as bytes, the states there)
        self.start = self._numbers(name, "x0", user.x0, 0.0, -np.inf, "finite")  # (total,)
        self.sizes = self._numbers(name, "sizes_x", user.sizes_x, 1.0, 0.0, "positive")  # (total,)
        self.units = self.sizes[: self.k]  # sizes of the states with rates
        if wrong := [function for function in EXCLUDED if function in written]:
            raise InputError(f"{name}: a model with states cannot have {wrong[0]}; leave it out, differences take its place")
        for function in LAST:
            arguments = list(arguments_of(function))
            if function != "rates":
                arguments.append("x")
            if function in written and not takes(getattr(user, function), len(arguments)):
                raise InputError(f"{name}.{function} must take the states as its last argument: {function}({', '.join(arguments)})")
        self.mass = 1.0  # of the coordinates of states: the mean one of the user's model at q = 0, for norms
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
        x, k = v[self.n :] * self.units, self.k
        if self.total == k:
            return x
        state = t, q.tobytes(), v.tobytes()
        if self._last[0] != state:  # forces and rates are asked for at one state
            rates = lambda free: self.rates(t, q[self.own], v[self.own], np.append(x, free))[k:]  # noqa: E731
            free, self.why = solved(rates, self.start[k:], self.sizes[k:], begun_at="x0")
            self._last = state, np.append(x, free)
        return self._last[1].copy()

    def arguments(self, name, at):
        """Return the arguments of the user's function, its part of q, v and a, and x if it takes the states, for those of the whole model."""
        given = self._cut(cuts_of(name), at)
        if name in LAST:
            given.append(self.states(*at[:3]))
        return given

    def _cut(self, cuts, at):
        """The arguments `at` of the whole model with the user's part of those of which `cuts` is True."""
        own = self.own
        return [value[..., own] if cut else value for cut, value in zip(cuts, at)]

    def in_whole_model(self, name, function):
        """Return a user's function of an array as one of the whole model, which gets its q, v and a and returns arrays of its size."""
        shape, cuts = SHAPES[name], cuts_of(name)
        if shape == "n":
            return partial(self._forces, function, cuts, name == "residual")
        if shape == "m":
            return partial(self._rows, function, cuts)
        return partial(self._matrix, function, cuts, shape == "nn", self.mass if name == "mass" else 0.0)

    def _rows(self, function, cuts, *at):
        """What the user's function of phi or psi gives at arguments of the whole model, (m,)."""
        return function(*self._cut(cuts, at))

    def _forces(self, function, cuts, is_residual, *at):
        """The user's force or residual, and behind it the rows of states, (n + k,).

        These are `-mass rates/sizes`, of the residual `mass (a - rates/sizes)`.
        """
        given = self._cut(cuts, at)
        x = self.states(*at[:3])
        result = function(*given, x)
        rates = self.rates(*given[:3], x)[: self.k]
        change = at[3][self.n :] if is_residual else 0.0
        return np.concatenate((result, self.mass * (change - rates / self.units)))

    def _matrix(self, function, cuts, is_square, corner, *at):
        """The user's matrix with zeros in the columns of states, and, if it is square, in their rows, with `corner` on their diagonal."""
        matrix, k = function(*self._cut(cuts, at)), self.k
        if not isinstance(matrix, np.ndarray):
            if is_square:
                return block_diag([matrix, corner * eye_array(k)], format="csr")
            return hstack([matrix, csr_array((matrix.shape[0], k))], format="csr")
        rows, n = len(matrix), self.n
        whole = np.zeros((rows + k if is_square else rows, n + k))
        whole[:rows, :n] = matrix
        if is_square:
            whole[n:, n:] = corner * np.eye(k)
        return whole

    def states_source(self, data, rates, kinds, whole):
        """Source text of the argument x of compiled functions; whole: as of Compiled.

        In the text b, c and d are the addresses of q, v and of a or x, and `out` that of the result (jit/owner_data.py).
        """
        behind, k = f"pointer(c + {8 * self.n})", self.k
        if not whole:
            return f"states_at({behind}, {data.view(np.ones(self.total))})"
        x = f"states_at({behind}, {data.view(self.sizes[:k])})"
        if self.total == k:
            return x
        alone = data.view(np.array(data.c_function(rates, kinds | {"x": ("d", (self.total,))}, (self.total,))))
        return f"with_algebraic({alone}, data, t, b, c, {x}, {data.view(self.start[k:])}, {data.view(self.sizes[k:])})"

    def store_source(self, name, shape, m, data, rates):
        """Arguments of OwnData.c_function with which a compiled function stores the result of the whole model; letters as in `states_source`.

        {"store": source text that writes `found`, the user's result, "other": the function whose result is `also`: rates, or None}.
        """
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
