"""SymbolicModel: a model whose functions are made of expressions of sympy."""

import math
from collections.abc import Mapping
from copy import copy

import numpy as np
import sympy as sp

from polyida.errors import InputError
from polyida.model import Model
from polyida.profile import Profile, as_profile
from polyida.symbolic.expressions import T, expression_of, number_of, short

_kinds: dict = {}  # {what a class is made of: the class}


class SymbolicModel(Model):
    """A model from expressions of sympy, as `pi.symbolic.lagrangian`, `equations` and `mechanics` make it.

    Its rows of phi are followed by those of psi, and `m` counts both. `pi.gradient` takes its values by the names in `parameters`.

    Attributes
    ----------
    coordinates : tuple
        The coordinates in the order of q.
    lam : tuple
        Symbols of the multipliers, for `evaluate`.
    values : (k,) float
        Those of `parameters`.
    source : str
        The code of its functions.
    """

    equations = None
    source = ""
    coordinates: tuple = ()
    lam: tuple = ()

    def __init__(self, values, profiles):
        """Take the values of the symbols, and the profiles of the functions of time."""
        self._set(values, profiles)

    def _set(self, values, profiles):
        """Take the values of symbols and the profiles of functions of time; both derivatives of a profile are profiles too."""
        self.values = np.array(values, float)
        self.constants = np.array(self.constants_of(*self.values), float)
        for numbers in (self.values, self.constants):
            numbers.flags.writeable = False
        self.profiles = tuple(profiles)
        for k, profile in enumerate(self.profiles):
            slope = Profile(profile.d1, profile.d2, profile.d2, profile.kinks, takes_arrays=profile.takes_arrays or bool(profile.formula))
            bend = Profile(profile.d2, profile.d2, profile.d2, profile.kinks, takes_arrays=slope.takes_arrays)
            for order, one in enumerate((profile, slope, bend)):
                setattr(self, f"f{k}_{order}", one)

    def __reduce__(self):
        """Pickle the model by its equations and source text; its class is made anew when it is loaded."""
        return _made, (type(self).__name__, self.by_numba, self.equations, self.source, self.values, self.profiles)

    def parameter(self, name):
        """Return the value of a symbol by its name, a float; None for an unknown name."""
        return float(self.values[self.parameters.index(name)]) if name in self.parameters else None

    def replaced(self, name, value):
        """Return the model with another value of a symbol or a parameter of the base class, by its name."""
        return self.with_values({name: value}) if name in self.parameters else super().replaced(name, value)

    def with_values(self, values):
        """Return the model with other values; nothing is derived or compiled anew.

        Parameters
        ----------
        values : dict
            {symbol, or its name, or function of time: value}; what is not named keeps its value.

        Returns
        -------
        SymbolicModel
            The copy.

        Raises
        ------
        InputError
            For a symbol that the model does not have.
        """
        if not isinstance(values, Mapping):
            raise InputError(f"with_values: {values!r:.80} must be a dictionary {{symbol: value}}")
        s, numbers, profiles = self.equations.symbols, self.values.copy(), list(self.profiles)
        places = {key: k for k, (key, _, _) in enumerate(s.parameters.values())} | {name: k for k, name in enumerate(self.parameters)}
        functions = {key: k for k, key in enumerate(s.functions)} | {key.func: k for k, key in enumerate(s.functions)}
        for key, value in values.items():
            if key in places:
                numbers[places[key]] = number_of("with_values", key, value)
            elif key in functions:
                profiles[functions[key]] = as_profile(value, f"with_values: {key}")
            else:
                known = ", ".join([*self.parameters, *map(str, s.functions)]) or "none"
                raise InputError(f"with_values: the model has no value {key!r:.80}; it has {known}")
        other = copy(self)
        other._set(numbers, profiles)
        return other

    def evaluate(self, run, expression):
        """Return the values of an expression along a run.

        Parameters
        ----------
        run : Trajectory
            Of this model, or of one that `with_values` gave: its values are those of the run's model.
        expression : expression of sympy, or list
            In t, the coordinates, their first and second derivatives, states, values, `model.lam`, and the speeds of a KanesMethod.

        Returns
        -------
        (frames,) float, or (frames, k) of a list of k
            The values.

        Raises
        ------
        InputError
            For what the model does not know, and a run of another model.
        """
        if isinstance(expression, (list, tuple, sp.MatrixBase)):
            return np.stack([self.evaluate(run, one) for one in expression], axis=-1)
        s, model = self.equations.symbols, self if run.model is None else run.model
        if type(model) is not type(self):
            raise InputError(f"evaluate: the run is of {model!r:.80}, not of this model")
        also = self.equations.also | dict(zip(self.lam, self.equations.lam))
        given = expression_of("evaluate", "expression", expression)
        found = s.read("expression", given.xreplace(also), 2, self.equations.lam)
        t, n = np.asarray(run.t), self.n
        columns = {T: t} | dict(zip(self.equations.lam, np.asarray(run.lam).T))
        for symbols, frames in ((s.q, run.q), (s.v, run.v), (s.a, run.a)):
            columns |= dict(zip(symbols, np.asarray(frames)[:, :n].T))
        columns |= dict(zip(s.x, run.x.T)) if s.x else {}
        columns |= {ours: value for (_, ours, _), value in zip(s.parameters.values(), model.values)}
        for ours, profile in zip(s.functions.values(), model.profiles):
            columns |= {one: profile.over(t, order) for order, one in enumerate(ours[:-1])}
        used = sorted(found.free_symbols, key=str)
        values = sp.lambdify(used, found, "numpy", cse=True)(*(columns[one] for one in used))
        return np.array(np.broadcast_to(np.asarray(values, float), t.shape))

    def constraint_name(self, row):
        """Return the name of a row of the constraints with the user's expression, "phi[0] = ..."."""
        names = [*(f"phi[{k}]" for k in range(len(self.equations.phi))), *(f"psi[{k}]" for k in range(len(self.equations.psi)))]
        return f"{names[row]} = {short(self.equations.given[names[row]])}"

    def _kinks(self, t0, t1):
        """Sorted times of the kinks of all profiles between t0 and t1, s, both excluded."""
        return tuple(sorted({kink for profile in self.profiles for kink in profile.kinks if t0 < kink < t1}))

    def _powers(self, t, q, v, lam, *x):
        """{"forces": power of the forces that have no potential, W} at a state."""
        return {"forces": float(self.power(t, q, v, *x))}

    def _slope(self, function, name, *state):
        """Derivative of a function, "residual_p" or "phi_p", with respect to the value of that name, at a state."""
        return self._slopes_known(function, name)(self, *state)

    def _slopes_known(self, function, name):
        """The compiled derivative of `function` by a value, made at its first use and kept by the class."""
        known = type(self).slopes
        if (function, name) not in known:
            known[function, name] = functions_of(self.equations.slope(function, name))[function]
        return known[function, name]


def functions_of(source):
    """{name: Python function} that the source text defines."""
    space = {"np": np, "math": math, "__name__": __name__}
    exec(compile(source, "<polyida.symbolic>", "exec"), space)
    return {name: value for name, value in space.items() if callable(value)}


def kind_of(name, by_numba, equations, source):
    """The subclass of SymbolicModel with these functions; equal arguments give the same class, so that its functions are compiled once.

    name: of the model. by_numba: True if functions are compiled. equations: its Equations. source: Python text of its functions.
    """
    s = equations.symbols
    users = (*s.user_q, *s.user_x, *(key for key, _, _ in s.parameters.values()), *s.functions, *equations.also)
    key = name, by_numba, source, users
    if key not in _kinds:
        _kinds[key] = _kind(name, by_numba, equations, source)
    return _kinds[key]


def _kind(name, by_numba, equations, source):
    """Make a new subclass of SymbolicModel with these functions and sizes; the arguments are those of `kind_of`."""
    s, body = equations.symbols, functions_of(source)
    if s.functions:
        body["kinks"] = SymbolicModel._kinks
    if "power" in body:
        body["powers"] = SymbolicModel._powers
    if s.x:
        body["k"] = len(s.x)
    else:
        body["residual_p"] = lambda self, name, t, q, v, a, lam: self._slope("residual_p", name, t, q, v, a, lam)
    m, holonomic = len(equations.rows), len(equations.phi)
    if m:
        body["phi_p"] = lambda self, name, t, q: self._slope("phi_p", name, t, q)
    body |= {"n": len(s.q), "m": m, "needs": equations.needs, "velocity_rows": np.arange(holonomic, m), "parameters": tuple(s.parameters)}
    body |= {"equations": equations, "source": source, "coordinates": tuple(s.user_q), "slopes": {}, "by_numba": by_numba}
    parameters = [ours for _, ours, _ in s.parameters.values()]
    body["constants_of"] = staticmethod(sp.lambdify(parameters, list(equations.constants.values()), "math"))
    body["lam"] = tuple(sp.Dummy(f"lam[{k}]", real=True) for k in range(m))
    return type(name, (SymbolicModel,), body)


def _made(name, by_numba, equations, source, values, profiles):
    """Rebuild a pickled model: find or make its class by `kind_of`, and give it values and profiles."""
    return kind_of(name, by_numba, equations, source)(values, profiles)


def model_of(name, equations, compiled):
    """The SymbolicModel of Equations with the values of their symbols."""
    s = equations.symbols
    kind = kind_of(name, compiled, equations, equations.source())
    return kind([value for _, _, value in s.parameters.values()], s.profiles)
