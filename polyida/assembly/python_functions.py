"""Functions of force elements and of users' bodies that are in Python: their checks, and C functions by which compiled code calls them."""

import ctypes
from dis import get_instructions
from inspect import CO_VARARGS, CO_VARKEYWORDS
from math import isfinite, prod
from threading import get_ident
from typing import Any

import numpy as np
from numpy import ndarray

from polyida.errors import DONE, RAISED, InputError
from polyida.jit.user_functions import CALLBACK
from polyida.validation import complexes, is_real, read_only, reals

SORT = {reals: "real", complexes: "complex"}
FLOAT = np.dtype(float)
VIEWS = 4096  # arrays at addresses that are stored
OUT = 7  # the last argument of a C function
KNOWN = 64  # results that are known
FRAMES = {"locals", "vars", "eval", "exec", "_getframe", "currentframe"}  # functions that read arguments without naming them


class Calls:
    """What the callbacks of a model share: what they raised, for each thread, until compiled code has returned, and the last results.

    known: {(number of a callback, bytes of the arguments): result}; the compiled loops ask for the same forces again, for example at other
    velocities for forces that do not read these.
    """

    def __init__(self):
        """Begin without exceptions, without known results and without callbacks."""
        self._errors: dict[int, BaseException] = {}
        self.known: dict[tuple, Any] = {}
        self.count = 0

    def failed(self):
        """True if a function raised in this thread."""
        return bool(self._errors) and get_ident() in self._errors

    def keep(self, error):
        """Keep an exception that a function raised in this thread."""
        self._errors[get_ident()] = error

    def remember(self, key, result):
        """Store the result of a callback in `known` under its key; if `known` is full, all older results are dropped first."""
        if len(self.known) >= KNOWN:
            self.known.clear()
        self.known[key] = result

    def take_error(self):
        """Forget the results. The exception of this thread, or None."""
        self.known.clear()
        return self._errors.pop(get_ident(), None) if self._errors else None


class PythonFunctions:
    """The functions of a part. `call` and `energy` check the results.

    not_finite: the function that last raised, or returned a non-finite value for finite arguments; else empty.
    """

    def __init__(self, name, part):
        """Take the part that has the functions, and its name for messages."""
        self.name, self.part, self.not_finite = name, part, ""

    def call(self, function, shape, *arguments, numbers=reals):
        """The array that a function of the part returns for numbers and arrays that are read-only."""
        try:
            if self.part.by_numba:
                with np.errstate(all="ignore"):
                    result = getattr(self.part, function)(*arguments)
            else:
                result = getattr(self.part, function)(*arguments)
            values = self._checked(function, shape, result, numbers)
        except Exception as error:
            self.not_finite = f"{function} of {self.name!r} raised {type(error).__name__}: {error}"
            if isinstance(error, ValueError) and "read-only" in str(error):
                wrong = "writes into its arguments, which belong to the integrator: take a copy first"
                raise InputError(f"{self.name}: {function} {wrong}") from error
            raise
        if isfinite(np.vdot(values, values).real):
            self.not_finite = ""
            return values
        bad = not np.isfinite(values).all() and all(np.isfinite(x).all() for x in arguments)
        why = self.part.undefined(arguments[1]) if bad and function == "forces" else ""
        self.not_finite = f"{function} of {self.name!r} gave numbers that are not finite{': ' * bool(why)}{why}" if bad else ""
        return values

    def _checked(self, function, shape, result, numbers):
        """The result as an array of its own. Raises InputError unless it is one of real, or complex, numbers of the shape."""
        if type(result) is ndarray and result.dtype is FLOAT and result.shape == shape and numbers is reals:
            return result.copy()
        values = numbers(result)
        if values is None or values.shape != shape:
            try:
                form = np.shape(result)
            except ValueError:
                form = "uneven"
            what = f"{type(result).__name__} of shape {form}"
            raise InputError(f"{self.name}: {function} must return {SORT[numbers]} numbers of shape {shape}, not {what}")
        return values

    def energy(self, *arguments):
        """The energy, J, 0.0 for None. Raises InputError if it is no number."""
        value = self.part.energy(*map(read_only, arguments))
        if value is None:
            return 0.0
        if not is_real(value):
            raise InputError(f"{self.name}: energy(x) must return a number or None, not {value!r:.100}")
        return float(value)


class Callbacks:
    """C functions that call functions of a part in Python; made for each model anew, and kept as long as this object.

    arguments: {argument: (letter, shape)} of forces and rates, of_energy: of the energy, as `laws_of` has them; shape: of the forces. written:
    names of the functions, of "forces" or "elastic", "energy" and "rates". calls: Calls. addresses: {name: address}.
    """

    def __init__(self, functions, calls, arguments, of_energy, shape, written):
        """Make C functions of the Python functions `written`, with arguments of these shapes, {name: (kind, shape)}."""
        self.functions, self.calls, self.written = functions, calls, written
        self.arguments, self.of_energy, self.shape = arguments, of_energy, shape
        call, self._kept, self.addresses = functions.call, [], {}
        if "forces" in written:
            self._add("forces", arguments, lambda *values: call("forces", shape, *values), shape)
        if "rates" in written:
            of_rates = arguments["s"][1]
            self._add("rates", arguments, lambda *values: call("rates", of_rates, *values), of_rates)
        if "elastic" in written:
            self._add("elastic", arguments, lambda z: -call("elastic", shape, z, numbers=complexes), shape, complex)
        if "energy" in written:
            self._add("energy", of_energy, functions.energy, (1,))

    def _add(self, name, arguments, function, shape, kind=float):
        """Make the C function that fills an array by a function of Python."""
        read = arguments_read(getattr(getattr(self.functions.part, name), "__func__", None), list(arguments))
        forms = [Argument(*form, is_read=one) for form, one in zip(arguments.values(), read)]
        self.calls.count += 1
        callback = c_callback(self.calls, self.calls.count, forms, function, shape, kind)
        self._kept.append(callback)
        self.addresses[name] = ctypes.c_void_p.from_buffer(callback).value  # `cast` would make a cycle that only gc collects

    def of(self, functions):
        """These callbacks for other PythonFunctions."""
        return Callbacks(functions, self.calls, self.arguments, self.of_energy, self.shape, self.written)


def arguments_read(function, arguments):
    """Whether a method reads each of its arguments behind self, [bool]; True if that cannot be seen."""
    code = getattr(function, "__code__", None)
    names = code.co_varnames[1 : code.co_argcount] if code else ()
    if len(names) != len(arguments) or code.co_flags & (CO_VARARGS | CO_VARKEYWORDS) or FRAMES & {*code.co_names}:
        return [True] * len(arguments)
    read = {*code.co_cellvars}
    for instruction in get_instructions(code):
        read |= {*instruction.argval} if isinstance(instruction.argval, tuple) else {instruction.argval}
    return [name in read for name in names]


class Argument:
    """An argument of a C function, at the address with a number: a number, or an array of a shape. is_read: True if results depend on it."""

    def __init__(self, letter, shape=(), of_complex=False, is_read=True):
        """Take shape and type; letter: one of t, b, c, d and e, which says at which address the argument is."""
        self.number, self.shape, self.is_read = "__tbcde".index(letter), shape, is_read
        self.kind = complex if of_complex else float
        self.size = np.dtype(self.kind).itemsize * prod(shape)

    def value(self, content):
        """The value whose bytes these are; an array is read-only, and its own, because users may keep it."""
        array = np.frombuffer(content, self.kind) if content else read_only(np.zeros(0, self.kind))
        return array.reshape(self.shape) if self.shape else array.item()


def c_callback(calls, number, arguments, function, shape, kind):
    """A C function that fills the array at its last argument by a function of Python. After an exception it calls the function no more."""
    views: dict[int, ndarray] = {}
    block = ctypes.c_char * (np.dtype(kind).itemsize * prod(shape))
    sources = [(one.number, one.size) for one in arguments]
    values = [one.value for one in arguments]
    read = [k for k, one in enumerate(arguments) if one.is_read]
    known, copied = calls.known, ctypes.string_at

    def array_at(at):
        """The array at an address, stored for the next call."""
        if len(views) >= VIEWS:
            views.clear()
        view = views[at] = np.frombuffer(block.from_address(at), kind).reshape(shape)
        return view

    def called(*at):
        """Call the Python function with copies of its arguments, or take the result that is known for them; DONE or RAISED."""
        if calls.failed():
            return RAISED
        try:
            contents = [copied(at[k], size) for k, size in sources]
            key = number, *[contents[k] for k in read]
            result = known.get(key)
            if result is None:
                result = function(*[value(content) for value, content in zip(values, contents)])
                calls.remember(key, result)
            view = views.get(at[OUT])
            if view is None:
                view = array_at(at[OUT])
            view[...] = result
        except BaseException as error:  # noqa: BLE001 the table of the model raises it
            calls.keep(error)
            return RAISED
        return DONE

    return CALLBACK(called)
