"""Tables of users' models: callbacks into Python, or compiled code for small models; and the choice of a model's table."""

import ctypes
import time
from contextlib import contextmanager
from functools import cache, partial

import numpy as np
from numba import typeof
from numpy import ndarray

from polyida.errors import DONE, NOT_FINITE, RAISED, REASONS, SINGULAR, StepFailure
from polyida.jit.user_functions import CALLBACK, table_address
from polyida.linear.lu import SingularSystem, dense
from polyida.linear.saddle import StepMatrix
from polyida.model.checked_function import FLOAT, CheckedFunction
from polyida.model.compiled import MOST, Compiled
from polyida.model.functions import OF_STEPS, writes
from polyida.system import ACCEPT, BEGIN, CONSTRAINTS, ENTRIES, FACTOR, INSTANTS, PROJECT, RATE, RESIDUAL, SOLVE, dense_slots
from polyida.system import dense as small

SHORT, LONG = 5e-3, 20e-3  # s: wanted CPU time of a stretch
VIEWS = 4096  # arrays at addresses that are stored
SERVED = small.SERVED | dense_slots.SERVED
ALONE = ctypes.CFUNCTYPE(ctypes.c_int64)  # called without reading its arguments: conversion of these takes 0.7 us a call


class PythonTable:
    """The table of any model: each entry is a callback.

    `prepare` sets the times of a stretch; `at_work` gives the addresses to the driver; `raise_error` follows its return.

    functions: the addresses of the entries. raised: the exception of a callback, until the driver has returned. ends: times of the first and the
    last end, or beside them inside the steps at a kink. factored: the step matrix in `at_work` (of Radau IIA: Matrices in SELECT). rate_state:
    (t, q) of the last RATE that PROJECT may follow.
    """

    longest = 1  # steps of a stretch, chosen by the time that they take, up to `most`
    instants = most = INSTANTS  # rows of `times`; largest `longest`, because a stretch cannot be interrupted
    workspace = stages = 0  # address of the model's arrays, or 0; stages of Radau IIA, whose instants follow that of the step's beginning
    increments = saddle = None  # increments of the constraints, or None; mass system at rate_state, None before PROJECT

    def __init__(self, model, incremental=False):
        """Make the table of a guarded model; incremental: True if its constraints are computed by increments from the step's beginning."""
        self.incremental, self.model, self.raised, self.times = incremental, model, None, np.zeros((self.instants, 2))
        self.unknowns = model.n
        self.functions, self.callbacks, self.views = np.zeros(ENTRIES, np.int64), [], {}
        self._fill()

    def _fill(self):
        """Store the address of each entry in `functions`. __init__ calls it: what it reads must be set before super().__init__."""
        for number, function in self._entries().items():
            self.functions[number] = self._address(function)

    def _entries(self):
        """{number of an entry: the method that answers it}."""
        entries = {RESIDUAL: self._residual, BEGIN: self._begin, CONSTRAINTS: self._constraints, SOLVE: self._solve}
        return entries | {RATE: self._rate, PROJECT: self._project, ACCEPT: self._accept}

    def _address(self, function):
        """The address of a Python function as a C function that stores an exception."""
        return self._kept(CALLBACK(self._protected(function)))

    def _protected(self, function):
        """The function, as a callback that stores an exception."""

        def called(*arguments):
            """Call the function without the workspace; an exception is stored, and the status says so."""
            try:
                return function(*arguments[1:]) or DONE
            except BaseException as error:  # noqa: BLE001 raise_error raises it
                self.raised = error
                return RAISED

        return called

    def _kept(self, callback):
        """The address of a callback, which is stored with the table."""
        self.callbacks.append(callback)
        return ctypes.cast(callback, ctypes.c_void_p).value

    def take_error(self):
        """The exception that a callback stored, or None."""
        error, self.raised = self.raised, None
        return error

    def raise_error(self):
        """Raise the exception that a callback stored."""
        if (error := self.take_error()) is not None:
            raise error

    def system(self, settings):
        """The step matrix, not factored yet."""
        return settings.step_matrix(self.model)

    def prepare(self, times, ends, h):
        """Prepare steps between the times. ends: the first and the last time, or times beside them inside the steps at a kink."""
        count, self.begin, self.last, self.ends, self.h = len(times) - 1, times[0], times[-1], ends, h
        self.times[:count, small.INNER] = self.times[:count, small.END] = times[1:]
        self.times[count - 1, small.INNER] = ends[1]

    def factor(self, system, t, *at):
        """Factor the step matrix near t, an end of the steps. Returns the number of residuals evaluated."""
        system.factor(self.ends[1] if t == self.last else t, *at)
        return 0

    @contextmanager
    def at_work(self, system):
        """(addresses of the functions, address of the workspace) with a factored step matrix."""
        self.factored = system
        with self.timed():
            yield self.functions, self.workspace

    @contextmanager
    def timed(self):
        """Double the length of the next stretch if this one takes less than SHORT; halve it if it takes more than LONG."""
        begun = time.perf_counter()
        yield
        spent = time.perf_counter() - begun
        if spent < SHORT:
            self.longest = min(2 * self.longest, self.most)
        elif spent > LONG:
            self.longest = max(1, self.longest // 2)

    def _array(self, at, size):
        """The array (size,) at an address; stored, because drivers use the same addresses again and again."""
        view = self.views.get((at, size))
        if view is None:
            if len(self.views) == VIEWS:
                self.views.clear()
            view = self.views[at, size] = np.frombuffer((ctypes.c_double * size).from_address(at)) if size else np.zeros(0)
        return view

    def _at(self, instant):
        """(time inside the step, time of its end) of an instant; they differ at a kink only."""
        return float(self.times[instant, small.INNER]), float(self.times[instant, small.END])

    def _state(self, instant, q):
        """(t, q) inside a step."""
        return self._at(instant)[0], self._array(q, self.model.n).copy()

    def _stage(self, instant):
        """Index of the stage of an instant, under which its increments and B are stored."""
        return (instant - 1) % (self.stages + 1)

    def _begin(self, instant, q, v, *_):
        """Make the increments of constraints, if the model has them, for a step that begins at q, v."""
        model = self.model
        if self.incremental:
            q, v = self._array(q, model.n).copy(), self._array(v, model.n).copy()
            self.increments = [model.increments(*span, q, v) for span in self._spans(instant)]

    def _spans(self, instant):
        """(first time, last time, times beside both inside the step, length) of each part of a step that begins."""
        before, (inner, end) = (self.begin if instant == 0 else self.times[instant - 1, small.END]), self._at(instant)
        return [(before, end, (self.ends[0] if instant == 0 else before, inner), self.h)]

    def _residual(self, instant, q, v, a, lam, r, phi):
        """Write r = `M a + g + B^T lam` and, without increments, phi. The status says whether they are finite."""
        model, (inner, end) = self.model, self._at(instant)
        q, v, a = (self._array(at, model.n).copy() for at in (q, v, a))
        rows, out = self._array(phi, model.m), self._array(r, model.n)
        if self.increments is None:
            rows[:] = model.phi(end, q)
        out[:] = model.residual(inner, q, v, a, self._array(lam, model.m).copy())
        return DONE if np.isfinite(out).all() and np.isfinite(rows).all() else NOT_FINITE

    def _constraints(self, instant, q, dq, dv, phi, rate, _):
        """Write phi at the end, from q; with increments, phi and its rate from those at the step's beginning and the changes dq, dv."""
        model = self.model
        rows, rates = self._array(phi, model.m), self._array(rate, model.m)
        if self.increments is None:
            rows[:] = model.phi(self._at(instant)[1], self._array(q, model.n).copy())
        else:
            change = self.increments[self._stage(instant)]
            rows[:], rates[:] = change(self._array(dq, model.n), self._array(dv, model.n), rows.copy(), rates.copy())

    def _solve(self, instant, q, lam, r, phi, dq, dlam):
        """Write dq and dlam of `S dq + B^T dlam = -r`, `B dq = -phi`, by the factored step matrix."""
        n, m = self.model.n, self.model.m
        state = self._array(q, n).copy(), self._array(lam, m).copy(), self._array(r, n).copy(), self._array(phi, m).copy()
        try:
            self._array(dq, n)[:], self._array(dlam, m)[:] = self.factored.saddle(self._at(instant)[0], *state)
        except SingularSystem:
            return SINGULAR
        return DONE

    def _rate(self, instant, q, v, rate, known, *_):
        """Write `phi_q v + phi_t`, and keep the state for `_project`."""
        model, self.rate_state = self.model, self._state(instant, q)
        self._array(rate, model.m)[:] = model.phi_rate(*self.rate_state, self._array(v, model.n).copy())
        self.saddle = None

    def _project(self, instant, rows, x, from_zero, *_):
        """Change x by the least M-norm, so that B x falls by rows; from_zero: x becomes the least one with `B x = B x_before - rows`."""
        model, x = self.model, self._array(x, self.model.n)
        rows = self._array(rows, model.m) - (model.phi_q(*self.rate_state) @ x if from_zero else 0.0)
        self.saddle = self.saddle or model.mass_system(*self.rate_state)
        change = self.saddle.solve(np.zeros(model.n), rows)[0]
        x[:] = change if from_zero else x + change

    def _accept(self, instant, q, *_):
        """Raise StepFailure if the model rejects q at the end of the step."""
        end = self._at(instant)[1]
        if objection := self.model.rejection_reason(end, self._array(q, self.model.n).copy()):
            raise StepFailure("objection", objection, end)


class DenseTable(PythonTable):
    """The table of a small model: compiled code that calls the model's functions.

    Functions that numba compiles are called as C functions, all others as callbacks into Python. names: those that the method calls; entries:
    of the table that it asks. levels: as of Slots in system/dense.py.
    """

    names = OF_STEPS
    entries: tuple[int, ...] = RESIDUAL, BEGIN, CONSTRAINTS, FACTOR, SOLVE, RATE, PROJECT, ACCEPT
    levels = small.NO_LEVELS

    def _fill(self):
        """Make the workspace with the model's functions and what the model needs; the entries are compiled by `serve`.

        __init__ calls it: `stages` and `levels`, which it reads, must be set before super().__init__.
        """
        model, needs = self.model, self.model.needs
        functions, flags = np.zeros(len(small.FUNCTIONS), np.int64), np.zeros(small.FLAGS, np.int64)
        flags[small.MASS_VARIES] = needs.mass_varies
        flags[small.VELOCITY] = needs.velocity_forces
        flags[small.DRIVEN] = needs.driven
        flags[small.ROWS_VARY] = needs.phi_q_varies or needs.driven
        flags[small.ROWS_VARY_WITH_Q] = needs.phi_q_varies
        flags[small.TIED] = self.levels[:, 1:].any()
        flags[small.ENDED] = DONE
        flags[small.OWN] = model.n - model.k
        w = small.workspace(model.n, model.m, functions, 0, flags, self.stages, self.levels)
        self.w = w = w._replace(times=self.times)
        for name, function in self._functions(w).items():
            functions[small.FUNCTIONS.index(name)] = self._kept(ALONE(function)) if function else 0
        if model.by_numba:
            self._take_compiled(functions)
        self.workspace, self.factored, self.has_constants = self.w.address, None, False

    def _take_compiled(self, functions):
        """Replace callbacks by the model's compiled functions; derivatives that it does not write become compiled differences."""
        self.longest, self.compiled = INSTANTS, Compiled(self.model, self.names)
        functions[[small.TANGENT, small.FORCE_V]] = 0
        if not self.model.needs.driven:
            functions[small.PHI_BIAS] = 0
        for name, at in self.compiled.addresses.items():
            functions[small.FUNCTIONS.index(name)] = at
        self.w = self.w._replace(data=self.compiled.data)

    def _functions(self, w):
        """{name of small.FUNCTIONS: callback that reads its arguments from w and writes its result to w, or None}."""
        model, callback = self.model, self._callback
        inner, end = (partial(w.t.item, at) for at in (small.INNER, small.END))
        q, v, a, lam = w.q, w.v, w.a, w.lam

        def accepted():
            """Raise StepFailure if the model rejects q at the end of the step."""
            if objection := model.rejection_reason(end(), q.copy()):
                raise StepFailure("objection", objection, end())

        return {
            "mass": callback(w.M, model.mass, None, q),
            "force": callback(w.g, model.force, inner, q, v),
            "phi": callback(w.phi, model.phi, end, q),
            "phi_q": callback(w.B, model.phi_q, inner, q),
            "phi_t": callback(w.phi_t, model.phi_t, inner, q),
            "phi_bias": callback(w.phi_bias, model.phi_bias, inner, q, v),
            "residual": callback(w.g, model.residual, inner, q, v, a, lam) if writes(model, "residual") else None,
            "rejection_reason": self._protected(accepted) if writes(model, "rejection_reason") else None,
            "tangent": callback(w.S, lambda *state: model.tangent(*state, *w.coefficients.tolist(), 1.0), inner, q, v, a, lam),
            "force_v": callback(w.slope, model.force_v, inner, q, v),
        }

    def _callback(self, out, function, t, *vectors):
        """A callback without arguments that writes function(t, *copies of the vectors) to `out`; its status is DONE or RAISED.

        The vectors are copied because the user may store them. t: the function that gives the time, None if it is no argument. What a
        CheckedFunction does is written here again, because each call in Python takes 0.1 us.
        """
        seen, convert, explain = [(), None], dense, lambda error: error
        if isinstance(function, CheckedFunction):
            seen, convert, explain, function = function.seen, function.array, function.explained, function.function
        (first, *others), shape = [x.copy for x in vectors], out.shape

        def read_only(copy):
            """A read-only copy of a vector of the workspace; copy: its own method."""
            vector = copy()
            vector.setflags(False)
            return vector

        def called():
            """Call the function, and write its result to `out`. An exception is stored, and the status says so."""
            try:
                q = first()
                q.setflags(False)
                seen[0] = arguments = (t(), q, *map(read_only, others)) if others else (t(), q) if t else (q,)
                result = function(*arguments)
                if type(result) is not ndarray or result.dtype is not FLOAT or result.shape != shape:
                    result = dense(convert(result))
                seen[1] = out[...] = result
                return DONE
            except BaseException as error:  # noqa: BLE001 raise_error raises it
                self.raised = explain(error)
                return RAISED

        return called

    def serve(self):
        """Fill the table's functions, once."""
        if not self.functions[self.entries[0]]:
            self.functions[list(self.entries)] = [address_of(number) for number in self.entries]

    def system(self, settings):
        """The step matrix, not factored yet: its numbers are computed in the workspace."""
        return DenseMatrix(self.model, self)

    @contextmanager
    def at_work(self, system):
        """(addresses of the functions, address of the workspace), with S of a step matrix copied to the workspace."""
        self.serve()
        if system is not self.factored:
            self.factored, self.w.S[...], self.w.flags[small.FACTORED] = system, system.S, 0
        with self.timed():
            yield self.functions, self.workspace

    def make(self, t, q, v, a, lam, c_m, c_v):
        """Compute S at a state in the workspace."""
        w, self.w.times[0] = self.w, t
        self.evaluate_constants(t, q)
        arrays = [np.ascontiguousarray(x, float) for x in (q, v, a, lam, (c_m, c_v))]
        ended = dense_slots.factor(w, 0, *arrays)
        self.raise_error()
        if ended != DONE:
            raise StepFailure(*REASONS[ended], t)

    def evaluate_constants(self, t, q):
        """Compute M and B once if they are constant."""
        if not self.has_constants:
            self.has_constants = True
            if not self.w.flags[small.MASS_VARIES]:
                self.w.M[...] = dense(self.model.mass(q))
            if self.model.m and not self.w.flags[small.ROWS_VARY]:
                self.w.B[...] = dense(self.model.phi_q(t, q))


@cache
def address_of(number):
    """The address of an entry, for all Dense: they have one type."""
    example = small.workspace(1, 0, np.zeros(len(small.FUNCTIONS), np.int64), 0, (0,) * small.FLAGS)
    return table_address(SERVED[number], typeof(example))


class DenseMatrix(StepMatrix):
    """S of a small model, computed by its table; compiled code factors it together with B."""

    backend = "dense LU"

    def __init__(self, model, table):
        """Take the model and the table that computes S for it."""
        super().__init__(model)
        self.table = table

    def factor(self, t, q, v, a, lam, c_m, c_v):
        """Compute S at a state; it is factored with B at the first solve."""
        self.table.make(t, q, v, a, lam, c_m, c_v)
        self.read()

    def read(self):
        """Copy the last S of the table."""
        w = self.table.w
        self.S, self.made_at, self.table.factored = w.S.copy(), w.made_at.copy(), self


def small_own(model):
    """True for a user's small model that leaves its linear systems to the package."""
    written = any(writes(model, name) for name in ("step_matrix", "mass_system", "increments"))
    return not (written or model.is_scene or model.n + model.m > MOST)


def small_table(model, incremental=False):
    """A DenseTable of a user's model that is small enough for dense matrices; None for other models.

    incremental: passed on to the table.
    """
    if not small_own(model):
        return None
    return DenseTable(model, incremental)
