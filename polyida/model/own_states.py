"""First-order states of a user's model: the velocities of coordinates behind its own.

The equation of such a coordinate, `mass (v' - x'/sizes) = 0`, has the form of an equation of motion: integrators know nothing of states.
"""

from inspect import signature

import numpy as np
from scipy.sparse import block_diag, csr_array, eye_array, hstack

from polyida.errors import WRONG_SHAPE, InputError
from polyida.model import Model
from polyida.model.algebraic import solved, with_algebraic
from polyida.validation import floats, is_whole, takes

LAST = ("rates", "force", "residual", "powers")  # get the states as their last argument
EXCLUDED = ("tangent", "force_q", "force_v", "residual_p", "mass_system", "step_matrix", "increments")  # they know nothing of states


def arguments_of(name):
    """Names of the arguments of a function of Model, without self."""
    return list(signature(getattr(Model, name)).parameters)[1:]


class OwnStates:
    """The states of a user's model of n coordinates: k, and behind them `total - k` algebraic ones.

    start, sizes (total,): x0 and sizes_x. why: why the last algebraic states have no solution, or "". mass: of the coordinates whose
    velocities they are; the mean one of the model at q = 0, for norms.
    """

    def __init__(self, name, user, n, written):
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

    def cut(self, name, function):
        """A function of the user as one of the whole model: it gets the user's part of q, v and a, and the states if it needs them."""
        cuts = [argument in ("q", "v", "a") for argument in arguments_of(name)]

        def call(*values):
            own = [value[..., self.own] if cut else value for cut, value in zip(cuts, values)]
            return function(*own, *((self.states(*values[:3]),) if name in LAST else ()))

        return call

    def whole(self, name, shape, function, rates):
        """A checked function of the user whose result has the shape of the whole model. shape: of the user's result, in letters."""
        own = self.cut(name, function)
        if shape == "m":
            return own
        if shape == "n":
            rates = self.cut("rates", rates)

            def below(t, q, v, a=None, *others):
                return self.mass * ((0.0 if a is None else a[self.n :]) - rates(t, q, v)[: self.k] / self.sizes[: self.k])

            return lambda *values: np.concatenate((own(*values), below(*values)))

        def call(*values):
            matrix, size = own(*values), self.mass if name == "mass" else 0.0
            if not isinstance(matrix, np.ndarray):
                if shape == "mn":
                    return hstack([matrix, csr_array((matrix.shape[0], self.k))], format="csr")
                return block_diag([matrix, size * eye_array(self.k)], format="csr")
            result = np.zeros((matrix.shape[0] + (shape == "nn") * self.k, self.n + self.k))
            result[: matrix.shape[0], : self.n] = matrix
            result[self.n :, self.n :] = size * np.eye(self.k) if shape == "nn" else 0.0
            return result

        return call

    def read(self, data, rates, kinds, whole):
        """Source text of the argument x of compiled functions; whole: as of Compiled."""
        behind, k = f"pointer(c + {8 * self.n})", self.k
        if not whole:
            return f"carray({behind}, ({self.total},)) * {data.view(np.ones(self.total))}"
        x = f"carray({behind}, ({k},)) * {data.view(self.sizes[:k])}"
        if self.total == k:
            return x
        data.helpers = (("with_algebraic", with_algebraic),)
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
            inertia = f"{data.view(np.array(self.mass))} * carray(pointer(d), ({N},))[{n}:] " if name == "residual" else ""
            lines += ["require_result(also)", f"if also.shape != ({self.total},):", f"    return {WRONG_SHAPE}"]
            lines += [f"whole[:{n}] = found", f"whole[{n}:] = {inertia}- also[:{self.k}] * {data.view(self.mass / self.sizes[: self.k])}"]
        else:
            lines += ["whole[:, :] = 0.0", f"whole[:{n if shape == 'nn' else m}, :{n}] = found"]
            if name == "mass":
                lines += [f"whole[{n}:, {n}:] = {data.view(self.mass * np.eye(self.k))}"]
        return {"store": "\n    ".join(lines), "other": rates if shape == "n" else None}
