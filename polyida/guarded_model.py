"""The one place through which a user's model is called: arguments read-only, results looked at and copied.

A scene is compiled and tested; it is called as it is and pays nothing.
"""

from contextlib import suppress

import numpy as np

from polyida.differences import FIRST_ORDER_STEP
from polyida.errors import InputError
from polyida.given import floats, is_number, is_whole, read_only
from polyida.model import Model, Needs, require_model

FLOAT = np.dtype(float)
SYMMETRIC = 1e-8  # largest entry of M - M^T over that of M, above which M is not symmetric
REACH = np.arange(-4, 5) * FIRST_ORDER_STEP  # s, of a second derivative in time by differences of differences
OF_CONSTRAINTS = ("phi", "phi_q", "reaction_q", "phi_t", "phi_bias")


def guard(model, part="solve"):
    """The model as integrators call it: Guarded where it is a user's own, itself where it is a scene or guarded already.

    Raises InputError, in the name of `part`, for what is no model or has no sizes.
    """
    require_model(part, model)
    return model if isinstance(model, Guarded) or hasattr(model, "arrays") else Guarded(model)


def require_functions(model, t, q, v):
    """Call each function of a guarded model once; raise InputError for one whose result is wrong or not finite."""
    if model.compiled:
        return
    try:
        model.call_all(t, q, v)
    except NotImplementedError as error:
        raise InputError(f"{model.name} has not all of the functions mass, force, phi and phi_q") from error
    if model.not_finite:
        raise InputError(f"{model.not_finite} at t = {t:.9g} s, where the run begins")


def blame(model, t, state):
    """Which of a user's functions gave what is not finite, when last called or within the reach of differences around t."""
    if not isinstance(model, Guarded) or model.not_finite:
        return getattr(model, "not_finite", "")
    for at in t + REACH:
        with suppress(Exception):
            model.call_all(at, state.q, state.v)
        if model.not_finite:
            return f"{model.not_finite} at t = {at:.9g} s"
    return ""


def _functions(n, m):
    """{name: (which of its arguments are arrays, shape of its result)}."""
    square, vector, rows, q, qv = (n, n), (n,), (m,), (1,), (1, 2)
    return {"mass": ((0,), square), "force": (qv, vector), "phi": (q, rows), "phi_q": (q, (m, n)), "force_q": (qv, square),
            "force_v": (qv, square), "mass_a_q": ((0, 1), square), "reaction_q": (qv, square), "phi_t": (q, rows),
            "phi_bias": (qv, rows), "residual": ((1, 2, 3, 4), vector), "tangent": ((1, 2, 3, 4), square)}


class Guarded(Model):
    """A user's model whose functions, as far as it writes them, are called through `_checked`; the others are Model's own.

    A function that returns complex numbers, objects, another shape than it must, or an M that is not symmetric, is an
    InputError that names it; so is one that writes into its arguments. Numbers that are not finite are the integrator's
    to refuse, with a shorter step perhaps: `not_finite` says who gave them last. All else is the user's model's.
    """

    def __init__(self, model):
        self.user, self.name = model, type(model).__name__
        n, m = getattr(model, "n", None), getattr(model, "m", None)
        if not (is_whole(n) and is_whole(m, 0)):
            raise InputError(f"{self.name}: n = {n!r} and m = {m!r} must be whole numbers, n >= 1 and m >= 0")
        if not isinstance(model.needs, Needs):
            raise InputError(f"{self.name}: needs = {model.needs!r} must be a polyida.Needs")
        self.n, self.m, self.needs, self.flexible, self._last, self._calls = int(n), int(m), model.needs, model.flexible, {}, 0
        for name, (arrays, shape) in _functions(self.n, self.m).items():
            if _written(model, name) and (self.m or name not in OF_CONSTRAINTS):
                setattr(self, name, self._checked(name, getattr(model, name), arrays, shape))
        if _written(model, "kinks"):
            self.kinks = self._kinks
        self.objection = self._objection if hasattr(model, "objection") else _none

    def __getattr__(self, name):
        """What integrators ask of some models only."""
        if name == "user":
            raise AttributeError(name)
        return getattr(self.user, name)

    def _checked(self, name, function, arrays, shape):
        """The function with its arguments read-only; its result is a copy, for it may fill one array again and again."""
        last, symmetric = self._last, name == "mass"

        def call(*given):
            seen = list(given)
            for k in arrays:
                seen[k] = view = np.asarray(seen[k]).view()
                view.setflags(False)
            try:
                found = function(*seen)
            except ValueError as error:
                if "read-only" not in str(error):
                    raise
                wrong = "writes into its arguments, which belong to the integrator: take a copy first"
                raise InputError(f"{self.name}.{name} {wrong}") from error
            if not (type(found) is np.ndarray and found.dtype is FLOAT and found.shape == shape):
                self._require(name, found, shape)
            result = found.copy() if found.dtype is FLOAT else found.astype(float)
            last[name] = seen, result
            if symmetric:
                self._look_at_mass(result)
            return result

        return call

    def _require(self, name, found, shape):
        part = f"{self.name}.{name} must return an array of shape {shape}"
        if getattr(found, "shape", None) != shape:
            raise InputError(f"{part}, not {getattr(found, 'shape', None) or f'another type, {type(found).__name__}'}")
        if getattr(found.dtype, "kind", "O") not in "fiu":
            raise InputError(f"{part} of real numbers, not of {found.dtype}")

    def _look_at_mass(self, M):
        """Whether M is symmetric, at the 1st, 2nd, 4th, 8th ... call."""
        self._calls += 1
        if self._calls & (self._calls - 1):
            return
        apart, size = abs(M - M.T).max(), abs(M).max()
        if apart > SYMMETRIC * size:
            raise InputError(f"{self.name}.mass must be symmetric; M - M^T has an entry of {apart:.3g}")

    def _kinks(self, t0, t1):
        """As the model says, sorted."""
        given = self.user.kinks(t0, t1)
        if type(given) in (tuple, list) and not given:
            return ()
        times = floats(given)
        if times is None or times.ndim != 1:
            raise InputError(f"{self.name}.kinks must return finite times in s")
        return tuple(np.unique(times).tolist())

    def _objection(self, t, q):
        return self.user.objection(t, read_only(q))

    def call_all(self, t, q, v):
        """Each of the four functions once."""
        self.mass(q), self.force(t, q, v)
        if self.m:
            self.phi(t, q), self.phi_q(t, q)

    def potential(self, q):
        """As the model says, J or None."""
        value = self.user.potential(read_only(q))
        if value is not None and not is_number(value):
            raise InputError(f"{self.name}.potential must return a finite number or None, not {value!r}")
        return value

    def constraint_name(self, row):
        """As the model says."""
        return self.user.constraint_name(row)

    @property
    def not_finite(self):
        """Which of the model's functions last gave what is not finite for arguments that are, in words; empty where none."""
        bad = [f"{self.name}.{name}" for name, (given, found) in self._last.items()
               if not np.isfinite(_entries(found)).all() and all(np.isfinite(x).all() for x in given)]
        return f"{' and '.join(bad)} gave numbers that are not finite" if bad else ""


def _none(t, q):
    """No objection."""


def _entries(found):
    return found if isinstance(found, np.ndarray) else found.tocsr().data


def _written(model, name):
    return getattr(type(model), name) is not getattr(Model, name) or name in getattr(model, "__dict__", ())
