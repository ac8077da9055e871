"""A user's model as integrators ask it: `guard(model)` makes its Equations. The model of a scene is asked directly."""

from dataclasses import replace
from itertools import product
from traceback import extract_tb

import numpy as np

from polyida.errors import InputError
from polyida.model import Model, Needs
from polyida.model.checked_function import CheckedFunction, read_only_view, require_array
from polyida.model.compiled import MOST, Compiled, shape_of
from polyida.model.differences import FIRST_ORDER_STEP
from polyida.model.functions import CHECKED, FUNCTIONS, OF_CONSTRAINTS, arguments_of, require_arguments, require_counted, writes
from polyida.model.row_laws import require_laws
from polyida.model.states import OwnStates
from polyida.model.velocity_rows import WITHOUT_ROWS, VelocityRows
from polyida.validation import floats, instance_of, is_number, is_real, is_whole, read_only

SAME = 1e-8  # largest entry of M - M^T, or of a change of M, over that of M: above it M is not symmetric, or varies
REACH = np.arange(-4, 5) * FIRST_ORDER_STEP  # s, range of a second derivative in time by differences of differences
ANSWERS = {  # {function: (check of its value, description)}
    "potential": (lambda result: result is None or is_real(result), "a number or None"),
    "momenta": (lambda result: result is None or np.shape(floats(result)) == (3,), "three finite numbers px, py, L, or None"),
    "powers": (
        lambda result: isinstance(result, dict) and all(isinstance(name, str) and is_number(value) for name, value in result.items()),
        "{name: finite number}",
    ),
}


def guard(model, part="solve"):
    """The model of a scene, or a user's model as Equations. Raises InputError, in the name of `part`, if it is no model or has no sizes."""
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
    if isinstance(model, Equations) or model.is_scene or model.checked:
        return model
    require_counted(model)
    require_arguments(model)
    return Equations(model)


def unguarded(model):
    """The model as it was given: the user's one behind Equations, or the model itself."""
    return model.user if isinstance(model, Equations) else model


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
    if model.is_scene:
        return
    for name in ("mass", "force", "phi", "phi_q") if model.m else ("mass", "force"):
        if not writes(model, name):
            rows = f"m = {model.m} constraints, but " if name in OF_CONSTRAINTS else ""
            raise InputError(f"{model.name}: {rows}its class gives no {name}({', '.join(arguments_of(name))})")


def blame(model, t, state):
    """A text that names the user's functions whose last result was not finite or that do so near a State, with the time; "" if none does.

    All functions are called at times around t, with q of the state and with q moved on by v to that time. An exception that they raise
    is returned as text for small compiled models, and ignored for others.
    """
    if model.compiled and not model.own_forces or model.not_finite:
        return model.not_finite
    for at, ahead in product(t + REACH, (0.0, 1.0)):
        try:
            model.call_all(at, state.q + ahead * (at - state.t) * state.v, state.v)
        except Exception as error:  # noqa: BLE001 whatever a function of a user raises
            if model.by_numba and model.n + model.m <= MOST:  # the calls of larger ones name their functions
                where = f"{model.name}.{extract_tb(error.__traceback__)[-1].name} raised {type(error).__name__}: "
                return f"{'' if isinstance(error, InputError) else where}{error} at t = {at:.9g} s"
        if model.not_finite:
            return f"{model.not_finite} at t = {at:.9g} s"
    return ""


class Equations(Model):
    """A user's model as integrators ask it, made once by `guard`.

    The user's functions get read-only arguments, and their results are checked and copied (CheckedFunction). A function that returns complex
    numbers, objects, a wrong shape, or an M that is not symmetric or has a negative eigenvalue, raises InputError with its name; so does one
    that writes into its arguments. The integrator handles numbers that are not finite; `not_finite` names their functions. Behind the rows of
    phi are those of psi (VelocityRows), and behind the user's q, v and a those of states (OwnStates). What the user does not write is Model's
    default.

    user: the model as it was given. name: of its class. written_names: of the functions that it gives. checked_functions: {name:
    CheckedFunction} of the user's part of q, v and a. own_states: OwnStates or None. psi_rows: VelocityRows or None.
    """

    def __init__(self, user):
        """Take the user's sizes, attributes, states and functions. Raises InputError for wrong ones."""
        self.user, self.name = user, type(user).__name__
        self.psi_rows = VelocityRows(user) if user.p else None
        self._take_sizes()
        self._take_attributes()
        self.written_names = self._names_of_written()
        self.own_states = None
        if "rates" in self.written_names:
            self._add_states(OwnStates(self.name, user, self.n, self.written_names))
        self.mass_calls = 0  # of `mass`
        self.constant_mass = None  # M at its last check if it is constant
        self.checked_functions = self._checked_functions()
        self._take_functions()

    def _take_functions(self):
        """Make the user's checked functions those of this object, for the whole model; a constant mass is asked for by `_constant_mass`."""
        for name, function in self.checked_functions.items():
            if self.own_states is None:
                setattr(self, name, function)
            elif name == "rates":
                self.own_states.rates = function
            else:
                setattr(self, name, self.own_states.in_whole_model(name, function))
        self.written_mass = self.mass  # M by the user's function, also if `needs` says that it is constant
        if "mass" in self.checked_functions and not self.needs.mass_varies:
            self.mass = self._constant_mass

    def _take_sizes(self):
        """Set n, m and the numbers of the velocity rows. Raises InputError for wrong ones."""
        n, m = getattr(self.user, "n", None), getattr(self.user, "m", None)
        self.velocity_rows = self.user.velocity_rows
        if self.psi_rows:
            self.velocity_rows = np.arange(m, m + self.psi_rows.count)
            m = m + self.psi_rows.count
        if not (is_whole(n) and is_whole(m, 0)):
            raise InputError(f"{self.name}: n = {n!r} and m = {m!r} must be whole numbers, n >= 1 and m >= 0")
        self.n, self.m, self.k = int(n), int(m), 0

    def _take_attributes(self):
        """Take the attributes that say what kind of model it is. Raises InputError for wrong ones."""
        user = self.user
        if not isinstance(user.needs, Needs):
            raise InputError(f"{self.name}: needs = {user.needs!r} must be a polyida.Needs")
        self.needs = replace(user.needs, phi_q_varies=True) if self.psi_rows else user.needs
        self.by_numba = user.by_numba and not self.psi_rows
        self.has_constraint_increments = user.has_constraint_increments and not self.psi_rows
        self.flexible, self.uniform_units = user.flexible, user.uniform_units
        self.dissipating, self.parameters = user.dissipating, user.parameters
        self.rows, self.joints = user.rows, user.joints
        self.row_laws = require_laws(self.name, user.row_laws, self.m, self.velocity_rows)

    def _names_of_written(self):
        """The names of the functions of Model that the user gives; with velocity rows, of those that know of these."""
        names = {name for name in FUNCTIONS if writes(self.user, name)}
        return names - WITHOUT_ROWS | {*self.psi_rows.functions} if self.psi_rows else names

    def _add_states(self, own):
        """Add the coordinates of the user's states, whose velocities are the states over their sizes."""
        self.own_states, self.k = own, own.k
        self.state_columns, self.state_units = np.arange(self.n, self.n + own.k), own.sizes[: own.k]
        self.state_start = (own.start / own.sizes)[: own.k]
        self.n, self.needs, self.uniform_units = self.n + own.k, replace(self.needs, velocity_forces=True), False

    def _checked_functions(self):
        """{name: CheckedFunction} of what the user gives; functions of large models that numba compiles are called as C functions."""
        large = self.by_numba and self.n + self.m > MOST  # smaller ones get a table of C functions
        given = self.psi_rows.functions if self.psi_rows else Compiled(self, whole=False).calls() if large else {}
        functions = {}
        for name in CHECKED:
            if name in self.written_names and (self.m or name not in OF_CONSTRAINTS):
                function = given.get(name) or getattr(self.user, name)
                if name == "mass" and self.needs.mass_varies:
                    function = self._examined_mass(function)
                functions[name] = CheckedFunction(f"{self.name}.{name}", function, shape_of(name, self))
        return functions

    def __getattr__(self, name):
        """Other attributes of the user's model, for a user's own integrator."""
        if name == "user":
            raise AttributeError(name)
        return getattr(self.user, name)

    def _constant_mass(self, q):
        """Return M, (n, n), evaluated and checked only at the 1st, 2nd, 4th, 8th ... call."""
        if self._mass_is_due():
            M, before = self.written_mass(q), self.constant_mass
            self._require_mass(M)
            changed = 0.0 if before is None else abs(M - before).max()
            if changed > SAME * abs(M).max():
                raise InputError(f"{self.name}.mass changes with q, an entry by {changed:.3g}: its needs must say mass_varies=True")
            self.constant_mass = M
        return self.constant_mass

    def call_all(self, t, q, v):
        """Evaluate mass, force and, with constraints, phi and phi_q once, so that wrong results raise an error."""
        self.mass(q)
        self.force(t, q, v)
        if self.m:
            self.phi(t, q)
            self.phi_q(t, q)

    def _mass_is_due(self):
        """True at the 1st, 2nd, 4th, 8th ... call."""
        self.mass_calls += 1
        return self.mass_calls.bit_count() == 1

    def _examined_mass(self, function):
        """The user's function of an M that varies; M is checked whenever it is due."""

        def mass(q):
            """M of the user, checked if it is due."""
            M = function(q)
            if self._mass_is_due():
                require_array(f"{self.name}.mass", M, shape_of("mass", self))
                self._require_mass(M)
            return M

        return mass

    def _require_mass(self, M):
        """Raise InputError unless M is symmetric and has no negative eigenvalue; of a large one the diagonal is examined."""
        size = abs(M).max()
        if (apart := abs(M - M.T).max()) > SAME * size:
            raise InputError(f"{self.name}.mass must be symmetric; M - M^T has an entry of {apart:.3g}")
        small = isinstance(M, np.ndarray) and len(M) <= MOST and np.isfinite(size)
        kind, least = ("eigenvalue", np.linalg.eigvalsh(M)[0]) if small else ("number on the diagonal", M.diagonal().min())
        if least < -SAME * size:
            raise InputError(f"{self.name}.mass must give no negative kinetic energy; M has the {kind} {least:.3g}")

    def _of_user(self, name, *at):
        """What the user's function gives for its part of q and v, and the states if it takes them."""
        return getattr(self.user, name)(*(self.own_states.arguments(name, at) if self.own_states else at))

    def _answer(self, name, *at):
        """What the user's function gives for read-only arguments, Model's default if there is none. Raises InputError for a wrong result."""
        if name not in self.written_names:
            return getattr(super(), name)(*at)
        right, expected = ANSWERS[name]
        result = self._of_user(name, *map(read_only_view, at))
        if not right(result):
            raise InputError(f"{self.name}.{name} must return {expected}, not {result!r:.100}")
        return result

    def potential(self, q):
        """Return the user's potential energy at q, J, checked, or None if it is unknown."""
        return self._answer("potential", q)

    def momenta(self, q, v):
        """Return the user's (px, py, L), N s and N m s, checked, or None if they are unknown."""
        return self._answer("momenta", q, v)

    def powers(self, t, q, v, lam):
        """Return the user's {name: power, W}, checked, or the default of Model."""
        return self._answer("powers", t, q, v, lam)

    def potentials(self, q):
        """Return (potential of loads, strain energy), J, of the user's function or of Model."""
        return self._of_user("potentials", q) if "potentials" in self.written_names else super().potentials(q)

    def initial_velocity(self, t, q):
        """Return the user's initial velocities with the start of the states behind them, (n,)."""
        v = self._of_user("initial_velocity", t, q)
        return np.append(v, self.state_start) if self.own_states else v

    def attachment(self, name):
        """Return the attachment of this name of the user's model."""
        return self.user.attachment(name)

    def position(self, name, q):
        """Return the path of a named point over frames q, (frames, 2), m, by the user's function."""
        return self._of_user("position", name, q)

    def constraint_name(self, row):
        """Return the name of a row of phi, or of a velocity row, for messages."""
        return (self.psi_rows or self.user).constraint_name(row)

    def keeps_body(self, row):
        """Return True if a row of phi keeps a body rigid, as the user's model says."""
        return self.user.keeps_body(row)

    def mass_system(self, t, q):
        """Return the factored `[[M, B^T], [B, 0]]` at (t, q), of the user's function or of Model."""
        return (self.user if "mass_system" in self.written_names else super()).mass_system(t, q)

    def step_matrix(self):
        """Return a StepMatrix that is not factored yet, of the user's function or of Model."""
        return (self.user if "step_matrix" in self.written_names else super()).step_matrix()

    def increments(self, t0, t1, ends, h, q, v):
        """Return the user's function (dd, dv, phi, rate) -> (phi, rate) behind a step of h from (q, v) at t0."""
        return self.user.increments(t0, t1, ends, h, q, v)

    def kinks(self, t0, t1):
        """The user's kinks, sorted. Raises InputError unless they are finite times."""
        kinks = self.user.kinks(t0, t1)
        if type(kinks) in (tuple, list) and not kinks:
            return ()
        times = floats(kinks)
        if times is None or times.ndim != 1:
            raise InputError(f"{self.name}.kinks must return finite times in s")
        return tuple(np.unique(times).tolist())

    def rejection_reason(self, t, q):
        """Return why the user's model rejects (t, q), or None; the function gets q without states."""
        if "rejection_reason" not in self.written_names:
            return None
        return self.user.rejection_reason(t, read_only(q[: self.n - self.k]))

    @property
    def switching(self):
        """True if the user's model has switching functions."""
        return self.user.switching

    def gaps(self, t, q):
        """The user's switching functions. Raises InputError unless they are a vector of finite numbers."""
        gaps = floats(self.user.gaps(t, read_only(q[: self.n - self.k])))
        if gaps is None or gaps.ndim != 1:
            raise InputError(f"{self.name}.gaps must return an array (k,) of finite numbers at t = {t:.9g} s")
        return gaps

    def replaced(self, name, value):
        """Return the Equations of a copy of the user's model with another value of an attribute."""
        return guard(self.user.replaced(name, value), f"{self.name}.replaced")

    def parameter(self, name):
        """Return the value of one of the user's `parameters`."""
        return self.user.parameter(name)

    def residual_p(self, name, t, q, v, a, lam):
        """Return dr/dp of one of the user's `parameters`, checked: (n,), of an array (n, ...)."""
        return self._slope("residual_p", self.n, name, t, q, v, a, lam)

    def phi_p(self, name, t, q):
        """Return dphi/dp of one of the user's `parameters`, checked: (m,), of an array (m, ...)."""
        return self._slope("phi_p", self.m, name, t, q)

    def _slope(self, function, size, name, t, *state):
        """The user's residual_p or phi_p, (size, ...); Model's default if there is none. Raises InputError for another shape."""
        if function not in self.written_names:
            return getattr(super(), function)(name, t, *state)
        result = getattr(self.user, function)(name, t, *(read_only(x[: self.n - self.k]) for x in state))
        shape, values = (size, *np.shape(self.parameter(name))), floats(result)
        if values is None or values.shape != shape:
            what = getattr(result, "shape", None) or type(result).__name__
            raise InputError(f"{self.name}.{function}({name!r}) must return finite numbers of shape {shape}, not {what}")
        return values

    @property
    def not_finite(self):
        """A text that names the functions whose last result was not finite for finite arguments, or unsolved algebraic states; else ""."""
        if self.own_states and self.own_states.why:
            return f"the algebraic states of {self.name} have no solution: {self.own_states.why}"
        bad = [function.label for function in self.checked_functions.values() if not function.is_finite]
        return f"{' and '.join(bad)} gave numbers that are not finite" if bad else ""
