"""Guarded: a user's model with read-only arguments and checked, copied results. The model of a scene is called directly."""

from collections import defaultdict
from contextlib import suppress
from dataclasses import replace
from inspect import signature
from itertools import product
from traceback import extract_tb

import numpy as np

from polyida.errors import DONE, REASONS, InputError, StepFailure
from polyida.jit.owner_data import OwnData
from polyida.jit.user_functions import CALLBACK
from polyida.model import Model, Needs
from polyida.model.differences import FIRST_ORDER_STEP
from polyida.model.row_laws import require_laws, with_velocity_rows
from polyida.model.states import HELPERS, OwnStates, arguments_of
from polyida.validation import floats, instance_of, is_number, is_real, is_whole, read_only, takes

FLOAT = np.dtype(float)
SAME = 1e-8  # largest entry of M - M^T, or of a change of M, over that of M: above it M is not symmetric, or varies
REACH = np.arange(-4, 5) * FIRST_ORDER_STEP  # s, range of a second derivative in time by differences of differences
OF_CONSTRAINTS = ("phi", "phi_q", "reaction_q", "phi_t", "phi_rate", "phi_bias", "phi_rate_q", "phi_bias_q")
PASSED = ("rows", "joints", "attachment", "position", "constraint_name", "keeps_body", "initial_velocity")
MOST = 50  # coordinates and constraints of a model with compiled steps
SHAPES = {  # of the returned arrays, in n, m and k
    "rates": "k",
    "mass": "nn",
    "force": "n",
    "phi": "m",
    "phi_q": "mn",
    "phi_t": "m",
    "residual": "n",
    "force_q": "nn",
    "force_v": "nn",
    "mass_a_q": "nn",
    "reaction_q": "nn",
    "phi_bias": "m",
    "potential": "",
    "tangent": "nn",
    "phi_rate": "m",
    "phi_rate_q": "mn",
    "phi_bias_q": "mn",
}
OF_STEPS = tuple(name for name in SHAPES if name not in ("potential", "tangent", "phi_rate", "phi_rate_q", "phi_bias_q"))  # for tables
CHECKED = tuple(name for name in SHAPES if name != "potential")
ANSWERS = {  # {function: (check of its value, description)}
    "potential": (lambda result: result is None or is_real(result), "a number or None"),
    "momenta": (lambda result: result is None or np.shape(floats(result)) == (3,), "three finite numbers px, py, L, or None"),
    "powers": (
        lambda result: isinstance(result, dict) and all(isinstance(name, str) and is_number(value) for name, value in result.items()),
        "{name: finite number}",
    ),
}
OF_PLACES = ("position", "initial_velocity", "potentials")  # get the user's part of q
OWN = ("potentials", "mass_system", "step_matrix", "increments")  # by default they call checked functions
ASKED = (*CHECKED, *ANSWERS, "psi", "psi_v", "gaps", "kinks", "rejection_reason", "initial_velocity", "potentials", "residual_p", "phi_p")


def guard(model, part="solve"):
    """The model of a scene, or a user's model as a Guarded. Raises InputError, in the name of `part`, if it is no model or has no sizes."""
    if isinstance(model, type) and issubclass(model, Model):
        raise InputError(f"{part}: {instance_of(model)}")
    if not isinstance(model, Model):
        hint = "; of a Scene, call its build()"
        if model is None:
            hint = (
                "; a run that was loaded has none where a class of its file is not known, which run.summary() names: import that before "
                "loading, or give the model, polyida.load(path, model=...)"
            )
        raise InputError(f"{part}: the model is {type(model).__name__}, a polyida.Model is needed{hint}")
    if isinstance(model, Guarded) or model.is_scene or model.checked:
        return model
    _require_counted(model)
    _require_arguments(model)
    return Guarded(with_velocity_rows(model) if model.p else model)


def _require_counted(model):
    """Raise InputError for rows that would be ignored, because the class that writes them counts none, and for states without rates.

    A class that inherits from one with rows may set their number to zero, and an object its own.
    """
    name = type(model).__name__
    for size, function, call in (("m", "phi", model.phi), ("p", "psi", model.psi)):
        writer = next(one for one in (model, *type(model).__mro__) if function in vars(one))
        if size in vars(model) or not (writes(model, function) and is_whole(getattr(writer, size, None), 0, 0)):
            continue
        rows, arguments = 0, arguments_of(function)
        with suppress(Exception), np.errstate(all="ignore"):
            rows = np.size(call(0.0, *np.zeros((len(arguments) - 1, model.n))))
        if rows:
            told = f"its class gives {function}({', '.join(arguments)}), but {size} = 0, so it would be ignored"
            raise InputError(f"{name}: {told}: set {size} to the number of its rows")
    if not (is_whole(model.algebraic, 0, 0) or writes(model, "rates")):  # k may be a number of the user's own, such as a stiffness
        raise InputError(f"{name}: algebraic = {model.algebraic!r:.60} states, but its class gives no rates(t, q, v, x)")


def _require_arguments(user):
    """Raise InputError for a function of a user's model that does not take its arguments; OwnStates says which take the states."""
    for name in ASKED:
        if not writes(user, name) or (name in OF_CONSTRAINTS and not user.m) or (name in ("psi", "psi_v") and not user.p):
            continue
        function, arguments = getattr(user, name), arguments_of(name)
        if not (takes(function, len(arguments)) or writes(user, "rates") and takes(function, len(arguments) + 1)):
            given = f"it takes {signature(function)}" if callable(function) else f"it is {type(function).__name__}"
            raise InputError(f"{type(user).__name__}.{name} must be a function {name}({', '.join(['self', *arguments])}); {given}")


def unguarded(model):
    """The user's model."""
    return model.user if isinstance(model, Guarded) else model


def require_functions(model, t, q, v):
    """Call each function of a guarded model once; raise InputError for a wrong or not finite result."""
    if model.compiled and not model.own_forces:
        return
    require_written(model)
    model.call_all(t, q, v)
    if model.not_finite:
        raise InputError(f"{model.not_finite} at t = {t:.9g} s, where the run begins")


def require_written(model):
    """Raise InputError if a guarded model does not write mass and force, and with m > 0 phi and phi_q."""
    for name in ("mass", "force", *("phi", "phi_q") * bool(model.m)) if not model.is_scene else ():
        if not writes(model.user, name):
            rows = f"m = {model.m} constraints, but " * (name in OF_CONSTRAINTS)
            raise InputError(f"{model.name}: {rows}its class gives no {name}({', '.join(arguments_of(name))})")


def blame(model, t, state):
    """The user's functions that returned what is not finite, when last called or around t at the state or ahead of it, in words."""
    if model.compiled and not model.own_forces or model.not_finite:
        return model.not_finite
    for at, ahead in product(t + REACH, (0.0, 1.0)):
        try:
            model.call_all(at, state.q + ahead * (at - state.t) * state.v, state.v)
        except Exception as error:  # noqa: BLE001 whatever a function of a user raises
            if unguarded(model).by_numba and model.n + model.m <= MOST:  # the calls of larger ones name their functions
                where = f"{model.name}.{extract_tb(error.__traceback__)[-1].name} raised {type(error).__name__}: "
                return f"{'' if isinstance(error, InputError) else where}{error} at t = {at:.9g} s"
        if model.not_finite:
            return f"{model.not_finite} at t = {at:.9g} s"
    return ""


def shape_of(name, model):
    """The shape of the array that a function of a guarded model's user returns."""
    states = model.own_states.total if model.own_states else 0
    return tuple({"n": model.n - model.k, "m": model.m, "k": states}[letter] for letter in SHAPES[name])


def _view(argument):
    """A read-only view of an array; anything else as it is."""
    if isinstance(argument, np.ndarray):
        argument = argument.view()
        argument.setflags(False)
    return argument


class Guarded(Model):
    """A user's model whose own functions are called through `_checked`; the others are Model's defaults.

    A function that returns complex numbers, objects, a wrong shape, or an M that is not symmetric or has a negative eigenvalue, raises
    InputError with its name; so does one that writes into its arguments. The integrator handles numbers that are not finite; `not_finite` names their functions.
    """

    def __init__(self, model):
        self.user, self.name = model, type(model).__name__
        n, m = getattr(self.user, "n", None), getattr(self.user, "m", None)
        if not (is_whole(n) and is_whole(m, 0)):
            raise InputError(f"{self.name}: n = {n!r} and m = {m!r} must be whole numbers, n >= 1 and m >= 0")
        if not isinstance(model.needs, Needs):
            raise InputError(f"{self.name}: needs = {model.needs!r} must be a polyida.Needs")
        self.n, self.m, self.needs, self._calls, self._constant = int(n), int(m), model.needs, 0, None
        self.k, written = 0, [name for name in (*CHECKED, *ANSWERS, *OWN, "residual_p") if writes(model, name)]
        self.own_states = own = OwnStates(self.name, model, self.n, written) if "rates" in written else None
        self.flexible, self.uniform_units, self.has_constraint_increments = (
            model.flexible,
            model.uniform_units,
            model.has_constraint_increments,
        )
        self.dissipating, self.parameters, self.velocity_rows = model.dissipating, model.parameters, model.velocity_rows
        self.row_laws = require_laws(self.name, model.row_laws, self.m, self.velocity_rows)
        if own:
            self.k, self.state_columns, self.state_units = own.k, np.arange(self.n, self.n + own.k), own.sizes[: own.k]
            self.n, self.needs, self.uniform_units = self.n + own.k, replace(model.needs, velocity_forces=True), False
        self.state_start = (own.start / own.sizes)[: own.k] if own else np.zeros(0)
        self._last = defaultdict(lambda: [(), np.zeros(0)])  # of each function its arguments and what it gave
        large = model.by_numba and self.n + self.m > MOST
        compiled = Compiled(self, whole=False).calls() if large else {}  # smaller ones get a table of C functions
        for name in CHECKED:
            if name in written and (self.m or name not in OF_CONSTRAINTS):
                function = compiled.get(name) or getattr(self.user, name)
                if name == "mass" and self.needs.mass_varies:
                    function = self._examined_mass(function)
                function = self._checked(name, function, shape_of(name, self))
                if name == "rates":
                    own.rates = function
                setattr(self, name, own.whole(name, SHAPES[name], function, self.rates) if own and name != "rates" else function)
        if "mass" in vars(self) and not self.needs.mass_varies:
            self.written_mass, self.mass = self.mass, self._constant_mass
        if writes(model, "kinks"):
            self.kinks = self._kinks
        if writes(model, "rejection_reason"):
            self.rejection_reason = lambda t, q: model.rejection_reason(t, read_only(q[: self.n - self.k]))
        for name, (right, expected) in ANSWERS.items():
            if name in written:
                setattr(self, name, self._answer(name, right, expected))
        self.gaps = self._gaps
        for name in (*PASSED, *(name for name in OWN if name in written)):
            function = getattr(self.user, name)
            setattr(self, name, own.cut(name, function) if own and name in OF_PLACES else function)
        if own:
            initial = self.initial_velocity
            self.initial_velocity = lambda t, q: np.append(initial(t, q), self.state_start)

    def __getattr__(self, name):
        """Other attributes of the user's model, for a user's own integrator."""
        if name == "user":
            raise AttributeError(name)
        return getattr(self.user, name)

    def _checked(self, name, function, shape):
        """The function with read-only arguments and a copied result: it may return one array again and again."""
        last = self._last[name]

        def array(result):
            self._require(name, result, shape)
            sparse = getattr(result, "format", "csr") not in ("csr", "csc")  # other formats lack operations
            return (result.tocsr() if sparse else result).astype(float)

        def reason(error):
            if not (isinstance(error, ValueError) and "read-only" in str(error)):
                return error
            refused = InputError(f"{self.name}.{name} writes into its arguments, which belong to the integrator: take a copy first")
            refused.__cause__ = error
            return refused

        def checked(*values):
            last[0] = arguments = tuple(map(_view, values))
            try:
                result = function(*arguments)
            except ValueError as error:
                raise reason(error)  # noqa: B904 with its cause
            last[1] = result if type(result) is np.ndarray and result.dtype is FLOAT and result.shape == shape else array(result)
            return last[1].copy()

        checked.parts = function, last, array, reason  # for callers that do the same with arrays of their own, in less time
        return checked

    def _require(self, name, result, shape):
        part = f"{self.name}.{name} must return an array of shape {shape}"
        if getattr(result, "shape", None) != shape:
            raise InputError(f"{part}, not {getattr(result, 'shape', None) or f'another type, {type(result).__name__}'}")
        if getattr(result.dtype, "kind", "O") not in "fiu":
            raise InputError(f"{part} of real numbers, not of {result.dtype}")

    def _mass_is_due(self):
        """True at the 1st, 2nd, 4th, 8th ... call."""
        self._calls += 1
        return not self._calls & (self._calls - 1)

    def _examined_mass(self, function):
        """The user's function of an M that varies; M is checked whenever it is due."""

        def mass(q):
            M = function(q)
            if self._mass_is_due():
                self._require("mass", M, shape_of("mass", self))
                self._require_mass(M)
            return M

        return mass

    def _constant_mass(self, q):
        """M, evaluated and checked only when it is due."""
        if self._mass_is_due():
            M, before = self.written_mass(q), self._constant
            self._require_mass(M)
            changed = 0.0 if before is None else abs(M - before).max()
            if changed > SAME * abs(M).max():
                raise InputError(f"{self.name}.mass changes with q, an entry by {changed:.3g}: its needs must say mass_varies=True")
            self._constant = M
        return self._constant

    def _require_mass(self, M):
        size = abs(M).max()
        if (apart := abs(M - M.T).max()) > SAME * size:
            raise InputError(f"{self.name}.mass must be symmetric; M - M^T has an entry of {apart:.3g}")
        small = isinstance(M, np.ndarray) and len(M) <= MOST and np.isfinite(size)
        kind, least = ("eigenvalue", np.linalg.eigvalsh(M)[0]) if small else ("number on the diagonal", M.diagonal().min())
        if least < -SAME * size:
            raise InputError(f"{self.name}.mass must give no negative kinetic energy; M has the {kind} {least:.3g}")

    def _kinks(self, t0, t1):
        """The model's kinks, sorted."""
        kinks = self.user.kinks(t0, t1)
        if type(kinks) in (tuple, list) and not kinks:
            return ()
        times = floats(kinks)
        if times is None or times.ndim != 1:
            raise InputError(f"{self.name}.kinks must return finite times in s")
        return tuple(np.unique(times).tolist())

    @property
    def switching(self):
        return self.user.switching

    def _gaps(self, t, q):
        gaps = floats(self.user.gaps(t, read_only(q[: self.n - self.k])))
        if gaps is None or gaps.ndim != 1:
            raise InputError(f"{self.name}.gaps must return an array (k,) of finite numbers at t = {t:.9g} s")
        return gaps

    def call_all(self, t, q, v):
        """Evaluate mass, force and, with constraints, phi and phi_q once, so that wrong results raise an error."""
        self.mass(q), self.force(t, q, v)
        if self.m:
            self.phi(t, q), self.phi_q(t, q)

    def replaced(self, name, value):
        return guard(self.user.replaced(name, value), f"{self.name}.replaced")

    def parameter(self, name):
        return self.user.parameter(name)

    def residual_p(self, name, t, q, v, a, lam):
        return self._slope("residual_p", self.n, name, t, q, v, a, lam)

    def phi_p(self, name, t, q):
        return self._slope("phi_p", self.m, name, t, q)

    def _slope(self, function, size, name, t, *state):
        if not writes(self.user, function):
            return getattr(super(), function)(name, t, *state)
        result, shape = (
            getattr(self.user, function)(name, t, *(read_only(x[: self.n - self.k]) for x in state)),
            (size, *np.shape(self.parameter(name))),
        )
        values = floats(result)
        if values is None or values.shape != shape:
            what = getattr(result, "shape", None) or type(result).__name__
            raise InputError(f"{self.name}.{function}({name!r}) must return finite numbers of shape {shape}, not {what}")
        return values

    def _answer(self, name, right, expected):
        """The function with read-only arguments; it raises InputError for a wrong result."""
        function = getattr(self.user, name)
        function = self.own_states.cut(name, function) if self.own_states else function

        def call(*arguments):
            result = function(*map(_view, arguments))
            if not right(result):
                raise InputError(f"{self.name}.{name} must return {expected}, not {result!r:.100}")
            return result

        return call

    @property
    def not_finite(self):
        """The functions that last returned what is not finite for finite arguments, in words; or ""."""
        if self.own_states and self.own_states.why:
            return f"the algebraic states of {self.name} have no solution: {self.own_states.why.replace('start()', 'x0')}"
        bad = [
            f"{self.name}.{name}"
            for name, (arguments, matrix) in self._last.items()
            if not np.isfinite(_entries(matrix)).all() and all(np.isfinite(x).all() for x in arguments)
        ]
        return f"{' and '.join(bad)} gave numbers that are not finite" if bad else ""


def _entries(matrix):
    return matrix if isinstance(matrix, np.ndarray) else matrix.tocsr().data


def writes(model, name):
    """True if a model's class, or the object itself, has a function of this name in place of Model's."""
    return getattr(type(model), name) is not getattr(Model, name) or name in vars(model)


class Compiled:
    """C functions of a model, {name: address}, and `data`, the address of the values that they read from self. Raises InputError.

    whole: True if they have the arguments and results of the whole model, with the coordinates of states; otherwise x follows v in the memory.
    """

    def __init__(self, guarded, names=OF_STEPS, whole=True):
        model, own, m = guarded.user, guarded.own_states, guarded.m
        n = guarded.n - guarded.k
        written = [name for name in names if writes(model, name) and (m or name not in OF_CONSTRAINTS)]
        self.functions = functions = {name: getattr(type(model), name) for name in written}
        self.own, self.guarded = OwnData(model, functions.values(), HELPERS if own else ()), guarded
        kinds = {"t": ("t",), "q": ("b", (n,)), "v": ("c", (n,)), "a": ("d", (n,)), "lam": ("e", (m,))}
        if own and "rates" in functions:
            kinds["x"] = own.read(self.own, functions["rates"], kinds, whole)
        self.addresses = {}
        for name, function in functions.items():
            extra = own.stored(name, SHAPES[name], m, self.own, functions.get("rates")) if own and whole else {}
            self.addresses[name] = self.own.c_function(function, kinds, shape_of(name, guarded), **extra)
        if whole:
            self.addresses.pop("rates", None)  # compiled alone for messages in its name, and within the other functions
        self.data = self.own.words.ctypes.data

    def calls(self):
        """{name: Python function that calls the C function}. They raise StepFailure."""
        return {name: self._call(name, self.functions[name].__qualname__, CALLBACK(address)) for name, address in self.addresses.items()}

    def _call(self, name, label, function):
        arguments, shape, places = (arguments_of(name), shape_of(name, self.guarded), ("t", "q", "v", "a", "lam"))

        def call(*vectors):
            values = {argument: np.ascontiguousarray(value, float) for argument, value in zip(arguments, vectors)}
            if len(vectors) > len(arguments) or name == "rates":  # x is read behind v
                values["v"] = np.concatenate((values["v"], vectors[-1]))
            result = np.empty(shape)
            at = (values[place].ctypes.data if place in values else 0 for place in places)
            if (ended := function(self.data, 0, *at, result.ctypes.data)) != DONE:
                status, reason = REASONS[ended]
                raise StepFailure(status, f"{label}: {reason}", float(values.get("t", [np.nan])[0]))
            return result

        return call
