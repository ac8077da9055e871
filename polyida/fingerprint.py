"""Fingerprints of functions: of their code, of what it names in the user's modules, and of their values.

Sweeps find their rows by `fingerprint_of`, compiled functions of users their machine code by `machine_code_fingerprint`. A reader visits a
function and all that it names, each object once, and digests (SHA-256) a text of each in this order: its value, its parts, or its name.
"""

import copyreg
import dis
import hashlib
import importlib.util
import sys
from contextlib import suppress
from functools import cached_property
from inspect import isgetsetdescriptor
from itertools import chain
from pathlib import Path
from types import BuiltinFunctionType, CellType, CodeType, FunctionType, MethodType, ModuleType

import numpy as np

PLAIN = (int, float, complex, str, bytes, bool, type(None), type(Ellipsis))
FILLING = {"append", "extend", "insert", "add", "update", "setdefault", "clear", "pop", "popitem", "remove", "discard"}
LOADS = ("LOAD_GLOBAL", "LOAD_NAME", "LOAD_DEREF", "LOAD_ATTR", "LOAD_METHOD")
STORES = (list, dict, set)  # containers that a function may fill
# constants of compiled code: it is stored under a fingerprint
BY_VALUE = (*STORES, frozenset, np.ndarray, np.generic, np.dtype, np.ufunc, FunctionType, CodeType, ModuleType, type)
BESIDE = ("co_code", "co_names", "co_varnames", "co_freevars", "co_cellvars", "co_argcount", "co_kwonlyargcount", "co_flags")


class NoFingerprint(Exception):
    """It is unknown if a value has changed."""


def fingerprint_of(function):
    """A text that changes with the code of a function and all that it names.

    It is made of the loaded code (without comments and line numbers), defaults, closures, and all functions, classes and values that the
    code names in the user's modules, recursively. Installed modules (Python's library, packages, polyida) are represented by names. A list,
    dictionary or variable that the function itself fills is its log or store and is ignored. Raises NoFingerprint for a value without one.
    """
    return _digested(_Reader(), function)


def machine_code_fingerprint(*functions):
    """A text that changes with all that the machine code of functions depends on in numba; None if that is unknown.

    Python's library, numpy, numba and polyida's compiled functions are represented by names: the folder of kernels has their versions in
    its name. All else is represented by value. Objects with an address in this process, such as C functions, have none, nor has a function
    that is an attribute of a user's module: numba may have compiled it before, with other values. The text is made once while all that the
    functions name stays the same; each time if they name lists, dictionaries, classes or modules of the user.
    """
    text, named, arrays = _known.get(functions, (None, (), ()))
    same = all(space.get(name, space) is value for space, name, value in named)
    if text and same and all(_content(array) == content for array, content in arrays):
        return text
    reader = _MachineCodeReader()
    try:
        text = _digested(reader, functions)
    except NoFingerprint:
        return None
    if reader.constant:
        _known[functions] = text, reader.named, reader.arrays
    return text


_known: dict = {}  # {functions: (their text, [(namespace, name, value)], [(array, its content)])}


def _content(array):
    """(shape, type, bytes) of an array, which are equal for equal arrays."""
    return array.shape, array.dtype, array.tobytes()


def _digested(reader, thing):
    """The digest of a thing by a new reader, in hexadecimal digits."""
    reader.add(thing)
    return reader.digest.hexdigest()


class _Reader:
    """Visits all that a function is made of, each object once, and digests it in this order."""

    def __init__(self):
        """Start a SHA-256 digest that has seen no object."""
        self.digest = hashlib.sha256()
        self.seen = {}  # {id of an object: its number}
        self.alive = []  # the objects: the id of a deleted one would be reused

    def by_name(self, module):
        """True if a module counts as installed, so that its contents are represented by their names."""
        return _installed(module)

    def note(self, *texts):
        """Digest texts or bytes, each with its length, so that no two lists of them give the same."""
        for text in texts:
            data = text if isinstance(text, bytes) else str(text).encode("utf-8", "surrogatepass")
            self.digest.update(b"%d:%s" % (len(data), data))

    def add(self, thing):
        """Digest an object: plain ones by value, others by their parts, and by number when they are met again."""
        if type(thing) in PLAIN:
            self.note(type(thing).__name__, repr(thing))
        elif id(thing) in self.seen:
            self.note("again", self.seen[id(thing)])
        else:
            self.seen[id(thing)] = len(self.seen)
            self.alive.append(thing)
            self._walk(thing)

    def _add_all(self, things):
        """Digest the number of things and each of them, in their order."""
        things = list(things)
        self.note(len(things))
        for thing in things:
            self.add(thing)

    def _walk(self, thing):
        """Digest an object that is not plain by its parts."""
        self.note(type(thing).__name__)
        if isinstance(thing, ModuleType):
            self.note(thing.__name__)
        elif isinstance(thing, (FunctionType, type)) and self.by_name(thing.__module__):
            self.note(thing.__module__, thing.__qualname__)
        elif isinstance(thing, CodeType):
            self.note(*(getattr(thing, name) for name in BESIDE))
            self._add_all(thing.co_consts)
        elif isinstance(thing, FunctionType):
            self._function(thing)
        elif isinstance(thing, type):
            self._class(thing)
        elif type(thing) in (set, frozenset):
            self._add_all(sorted(_digested(type(self)(), one) for one in thing))
        elif type(thing) in (list, tuple):
            self._add_all(thing)
        elif type(thing) is dict:
            self._add_all(chain.from_iterable(thing.items()))
        else:
            self._add_all(_wrapped(thing) or self._reduced(thing))

    def _function(self, function):
        """Digest a function: its code, defaults, and what it names, except what it fills or assigns itself."""
        self.add(function.__code__)
        self._add_all([function.__defaults__, function.__kwdefaults__])
        cells = zip(function.__code__.co_freevars, function.__closure__ or ())
        closed = {name: cell.cell_contents for name, cell in cells if cell != CellType()}
        values = closed | _named(function, closed, self.by_name)
        assigned, filled = self._stores(function.__code__)
        for name, value in values.items():
            last = name.rpartition(".")[2]
            if last not in assigned and not (last in filled and isinstance(value, STORES)):
                self._value(name, value)

    def _value(self, name, value):
        """Digest a name of a function and its value."""
        self._add_all([name, value])

    def _stores(self, code):
        """Ignored names: of variables that a function assigns outside itself, and of containers that it fills."""
        return _stores(code)

    def _class(self, kind):
        """Digest a class: its bases, and the functions and values that it defines."""
        self._add_all(kind.__bases__)
        for name, value in vars(kind).items():
            parts = _wrapped(value)
            if parts or isinstance(value, (FunctionType, type)) or not (isgetsetdescriptor(value) or name.startswith(("__", "_abc_"))):
                self.note(name)
                self._add_all(parts or [value])

    def _reduced(self, thing):
        """The parts of an object that pickle would store, without cached properties."""
        try:
            reduce = copyreg.dispatch_table.get(type(thing))
            reduced = reduce(thing) if reduce else thing.__reduce_ex__(4)
        except Exception as error:  # noqa: BLE001, of a user's object
            raise NoFingerprint(f"a {type(thing).__name__}, of which nobody can say whether it changed ({error})") from None
        if isinstance(reduced, str):
            return [type(thing), reduced]
        make, arguments, state, entries, items = (*reduced, None, None, None)[:5]
        if isinstance(state, dict):
            state = {name: value for name, value in state.items() if not isinstance(getattr(type(thing), name, None), cached_property)}
        return [make, arguments, state, tuple(entries or ()), tuple(items or ())]


class _MachineCodeReader(_Reader):
    """A reader of all that machine code depends on: what is represented neither by value nor by name has no fingerprint."""

    def __init__(self):
        """Begin without anything read; all that is read can stay the same."""
        super().__init__()
        self.named = []  # (namespace, name, value) of all that functions name
        self.arrays = []  # (array, its content) of all arrays
        self.constant = True  # False if anything else that was read can change in place

    def by_name(self, module):
        """True for modules of Python's library, numpy and numba."""
        top = module.partition(".")[0] if isinstance(module, str) and module != "__main__" else ""
        return top in sys.stdlib_module_names or top in ("numpy", "numba")

    def _stores(self, code):
        """No names: machine code holds the values of all names, so none is ignored."""
        return (), ()

    def _function(self, function):
        """Digest a function; note what it names, for the text to be kept while that stays the same."""
        space = function.__globals__
        self.named += [(space, name, space.get(name, space)) for code in _codes(function.__code__) for name in code.co_names]
        self.constant = self.constant and not function.__closure__
        super()._function(function)

    def _class(self, kind):
        """Digest a class, and note that its attributes can change, so that the digest cannot be kept."""
        self.constant = False
        super()._class(kind)

    def _value(self, name, value):
        """Digest a name and its value. Raises NoFingerprint for a function that is an attribute of a user's module."""
        self.constant = self.constant and "." not in name
        if "." in name and (isinstance(value, FunctionType) or is_dispatcher(value)):
            raise NoFingerprint(name)
        super()._value(name, value)

    def _walk(self, thing):
        """Digest an object that machine code holds by value or by name. Raises NoFingerprint for any other."""
        self._track(thing)
        if is_dispatcher(thing) and of_polyida(thing):
            self.note(thing.__module__, thing.__qualname__)
        elif is_dispatcher(thing):
            if not getattr(thing, "_can_compile", False):  # with fixed types
                raise NoFingerprint(thing.__qualname__)
            super()._walk(thing)
        elif isinstance(thing, (BuiltinFunctionType, type(np.dot))) and self.by_name(getattr(thing, "__module__", None)):
            self.note(thing.__module__, thing.__qualname__)
        elif isinstance(thing, tuple):
            self._add_all([type(thing), *thing])
        elif isinstance(thing, BY_VALUE) or type(thing).__module__ == "polyida.jit.user_functions":
            super()._walk(thing)
        else:
            raise NoFingerprint(type(thing).__name__)

    def _track(self, thing):
        """Note an array, whose content is compared later, or that a thing can change in place.

        Raises NoFingerprint for a user's module that makes its attributes when they are asked for.
        """
        if isinstance(thing, STORES) or (isinstance(thing, np.ndarray) and thing.dtype.hasobject):
            self.constant = False
        elif isinstance(thing, np.ndarray):
            self.arrays.append((thing, _content(thing)))
        elif isinstance(thing, ModuleType) and not self.by_name(thing.__name__) and hasattr(thing, "__getattr__"):
            raise NoFingerprint(thing.__name__)


def is_dispatcher(thing):
    """True for a function compiled by numba."""
    return hasattr(thing, "py_func") and hasattr(thing, "targetoptions")


def of_polyida(thing):
    """True for a function of this package."""
    return str(thing.__module__).partition(".")[0] == "polyida"


def _wrapped(thing):
    """The functions in a descriptor or a compiled or cached function; empty for anything else."""
    if isinstance(thing, property):
        return [thing.fget, thing.fset, thing.fdel]
    if isinstance(thing, cached_property):
        return [thing.func]
    if isinstance(thing, (staticmethod, classmethod)):
        return [thing.__func__]
    if isinstance(thing, MethodType):
        return [thing.__func__, thing.__self__]
    inner = getattr(thing, "__wrapped__", None) if callable(thing) else None
    return [inner, getattr(thing, "targetoptions", None)] if isinstance(inner, FunctionType) else []


def _codes(code):
    """A code and those of the functions and classes within it."""
    yield code
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            yield from _codes(inner)


def _stores(code):
    """Names that a function assigns outside itself, `global count`, and of containers that it fills, `log.append(x)`, `store[key] = x`."""
    assigned, filled = set(), set()
    for part in _codes(code):
        steps = list(dis.get_instructions(part))
        for step, after, beyond in zip(steps, steps[1:], steps[2:]):
            called = after.opname in ("LOAD_METHOD", "LOAD_ATTR") and after.argval in FILLING
            stored = beyond.opname == "STORE_SUBSCR" or (beyond.opname, beyond.argval) == ("COPY", 2)  # x[k] = y, x[k] += y
            if step.opname in ("STORE_GLOBAL", "STORE_DEREF"):
                assigned.add(step.argval)
            elif step.opname in LOADS and (called or stored):
                filled.add(step.argval)
    return assigned, filled


def _named(function, closed, by_name):
    """{name: value} of the names in a function's code: globals, and attributes of the user's modules, also of `closed` ones."""
    names = sorted({name for code in _codes(function.__code__) for name in code.co_names})
    known = function.__globals__
    values = {name: known[name] for name in names if name in known}
    modules = {
        value.__name__: value
        for value in [*values.values(), *closed.values(), *_imported(function, by_name)]
        if isinstance(value, ModuleType)
    }
    waiting = list(modules.values())
    while waiting:
        module = waiting.pop(0)
        if not by_name(module.__name__):
            parts = {name: vars(module)[name] for name in names if name in vars(module)}
            values |= {f"{module.__name__}.{name}": value for name, value in parts.items()}
            further = {value.__name__: value for value in parts.values() if isinstance(value, ModuleType)}
            waiting += [value for name, value in further.items() if name not in modules]
            modules |= further
    return values


def _imported(function, by_name):
    """The user's modules that a function imports when it is called."""
    modules = []
    for code in _codes(function.__code__):
        if dis.opmap["IMPORT_NAME"] not in code.co_code[::2]:
            continue
        steps = list(dis.get_instructions(code))
        for level, _, step in zip(steps, steps[1:], steps[2:]):
            if step.opname == "IMPORT_NAME":
                with suppress(Exception):  # a failing import raises when the function is called
                    name = importlib.util.resolve_name("." * level.argval + step.argval, function.__globals__.get("__package__"))
                    modules += [] if by_name(name) else [importlib.import_module(name)]
    return modules


def _installed(name):
    """True if the module of a name is Python's, polyida's or of an installed package; False for the user's."""
    if not isinstance(name, str) or name == "__main__":
        return False
    top = name.partition(".")[0]
    if top in sys.stdlib_module_names or top == "polyida":
        return True
    module = sys.modules.get(name)
    spec = importlib.util.find_spec(top) if module is None else None
    places = [getattr(module, "__file__", None) or getattr(spec, "origin", None), *getattr(module, "__path__", ())]
    return any(part in ("site-packages", "dist-packages") for place in places if place for part in Path(place).parts)
