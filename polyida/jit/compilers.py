"""Compilers that do what numba's does in less time (studies/start.py). The package works without them: all of numba's inside that it knows is here.

numba by itself optimises every function and makes machine code of it, and again of every function that calls it, with all below. Here parts
are only lowered, and optimised with the entry that takes them in; entries that are `shared` are called where they are.
"""

import atexit
import gc
from contextlib import contextmanager
from functools import cache, partial
from importlib import import_module
from typing import NamedTuple

import numba
from numba.core import ir, typed_passes, untyped_passes
from numba.core.base import BaseContext
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, Flags
from numba.core.compiler_machinery import PassManager
from numba.core.registry import CPUDispatcher
from numba.core.types.functions import BaseFunction
from numba.extending import overload
from numba.np import arrayobj

from polyida.jit import cache as kernel_cache


class Entry(CPUDispatcher):
    """What Python calls; for compiled code it stands for its part."""

    def __init__(self, function, part, compiler, options):
        super().__init__(function, targetoptions={"nopython": True, "no_cfunc_wrapper": True, **options}, pipeline_class=compiler)
        self.part = part

    @property
    def _numba_type_(self):
        return self.part._numba_type_

    def typeof_pyval(self, val):
        """As numba has it; the type of a pack is on it, where looking for it takes as long as a small kernel."""
        return getattr(val, "_kind", None) or super().typeof_pyval(val)


def entry(outer, part, compiler, options, kept=True):
    """An Entry that is kept in `cache.Files`."""
    made = Entry(outer, part, compiler, options)
    with kernel_cache.kept() as cached:
        if cached and kept:
            made.enable_caching()
            made._cache._cache_file = kernel_cache.Files(made._cache.cache_path, made._cache._impl.filename_base)
    return made


def c_address(outer, part, kinds, options, compiler=None, kept=True):
    """The address of a function as a C function."""
    made = entry(outer, part, compiler or EntryCompiler, options | {"no_cpython_wrapper": True, "no_cfunc_wrapper": False}, kept)
    made.compile(kinds)
    known = made.overloads[kinds.args]
    environments = known._find_referenced_environments()
    for one in environments:  # Python objects that compiled code prints with, of parts: they have a place now
        known.library.codegen.set_env(one.env_name, one)
    _in_use.append((made, environments))
    return known.library.get_pointer_to_function(known.fndesc.llvm_cfunc_wrapper_name)


_in_use: list = []  # what an address of a C function needs


def shared(outer, function, options):
    """An entry whose part is a call of it."""
    made = entry(outer, None, SharedCompiler, options)
    wrappers = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    made.part = numba.njit(pipeline_class=partial(Call, made), **wrappers, **options)(function)
    return made


PASSES = (
    untyped_passes.TranslateByteCode,
    untyped_passes.FixupArgs,
    untyped_passes.IRProcessing,
    untyped_passes.RewriteSemanticConstants,
    untyped_passes.DeadBranchPrune,
    untyped_passes.GenericRewrites,
    untyped_passes.ReconstructSSA,
    untyped_passes.DeadBranchPrune,
    typed_passes.NopythonTypeInference,
    typed_passes.PreLowerStripPhis,
    typed_passes.IRLegalization,
    typed_passes.AnnotateTypes,
    typed_passes.NativeLowering,
    typed_passes.NoPythonBackend,
)


class OwnCompiler(Compiler):
    """numba's compiler with all its passes, for functions of users."""

    def __init__(self, typing, target, library, args, result, flags, local):
        super().__init__(typing, target, library, args, result, Options(flags), local)

    def compile_extra(self, func):
        """The function compiled."""
        with thrifty():
            return super().compile_extra(func)


class EntryCompiler(OwnCompiler):
    """The same with the passes that kernels need."""

    def define_pipelines(self):
        """Passes from bytecode to machine code, for functions without closures, literals, parallel loops and array expressions."""
        passes = PassManager("kernel")
        for one in PASSES:
            passes.add_pass(one, one.name())
        passes.finalize()
        return [passes]


class _ForLinking:
    """Of a compiler whose results are only good for linking."""

    def __init__(self, typing, target, library, *rest):
        super().__init__(typing, target, library or _PartLibrary(target.codegen(), "part"), *rest)


class PartCompiler(_ForLinking, EntryCompiler):
    """The compiler of parts."""


class OwnPartCompiler(_ForLinking, OwnCompiler):
    """The compiler of parts of users."""


class _PartLibrary(JITCodeLibrary):
    """A part and all that it calls, not optimised, without machine code."""

    def finalize(self):
        """Take in what the part calls."""
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalized = True

    @property
    def codegen(self):
        """That a function's environment is set through: without machine code it has no place."""
        return _Nowhere


class _Nowhere:
    @staticmethod
    def set_env(name, environment):
        """Nothing."""


class SharedCompiler(EntryCompiler):
    """Gives a function a name that is the same in every process, so that what calls it can be kept on disk."""

    def _compile_bytecode(self):
        self.state.func_id.unique_id = 0
        return super()._compile_bytecode()


class Call:
    """In place of a compiler, for a function that compiled code calls: the name of the entry, which is compiled where it is not yet."""

    def __init__(self, entry, typing, target, library, args, *rest):
        self.entry, self.target, self.args = entry, target, tuple(args)

    def compile_extra(self, function):
        """What numba knows of the entry, without its code."""
        self.entry.compile(self.args)
        made, ready = self.entry.overloads[self.args], Ready(function.__module__, function.__name__, self.args)
        library = _Elsewhere(self.target.codegen(), ready)
        known = self.target.get_executable(library, made.fndesc, made.environment)
        self.target.insert_user_function(known, made.fndesc, [library])
        return made._replace(entry_point=known, library=library, metadata={})


class Ready(NamedTuple):
    """Done when kept code that calls the entry `name` of a module is loaded: the entry is, too."""

    module: str
    name: str
    args: tuple

    def __call__(self):
        getattr(import_module(self.module), self.name).compile(self.args)


class _Elsewhere(JITCodeLibrary):
    """No code, and what to do before it is called."""

    def __init__(self, codegen, ready):
        super().__init__(codegen, "elsewhere")
        self._reload_init, self._finalized = {ready}, True

    def _get_module_for_linking(self):
        return self._final_module


class Options(Flags):
    """Options of a compilation; numba compares them ten thousand times, each time all that there are."""

    def __hash__(self):
        return hash(tuple(sorted(self._values)))

    def __eq__(self, other):
        return self._values == other._values if isinstance(other, Flags) else NotImplemented


@contextmanager
def thrifty():
    """Python's search for cycles, a tenth of the time, waits, and numba is spared questions asked before; within another, nothing."""
    if BaseFunction.get_call_type is _typed:
        yield
        return
    running = gc.isenabled()
    gc.disable()
    _put(SPARED)
    _forgo_last_search()
    try:
        yield
    finally:
        _put(PLAIN)
        if running:
            _age()
            gc.enable()


def _put(methods):
    for (owner, name), method in methods.items():
        setattr(owner, name, method)


def _age():
    """Put what was made with the old objects, that are looked through rarely; not where a caller keeps some frozen."""
    if not gc.get_freeze_count():
        gc.freeze()
        gc.unfreeze()


@cache
def _forgo_last_search():
    """A process that has compiled ends without a search through what numba made, a second; the system takes it all back."""
    atexit.register(gc.freeze)


def _typed(function, context, args, kws):
    """Signature of a builtin for types of arguments, asked for once: numba tries all versions of an operator, each time it meets one."""
    return _ASK(function, context, args, kws) if kws else _signature(function, context, tuple(args))


@cache
def _signature(function, context, args):
    return _ASK(function, context, args, {})


def _found(context, key, sig, _firstcall=True):
    """The implementation of a function; of arrays' `__array__`, which has none, without a search through all registries at every use."""
    return _FIND(context, key, sig, _firstcall and key != "__array__")


@cache
def _sized(context, kind):
    """Bytes of a type in LLVM, which parses a module to tell."""
    return _SIZE(context, kind)


def _variables(self, value):
    """Variables within a value of numba's representation; most values are places in the source and names, which hold none."""
    kind = type(value)
    if kind is ir.Var:
        return [value]
    if kind is ir.Loc or kind is str or value is None:
        return []
    return _LIST(self, value)


def _wrong_shape(source, target):
    """What an assignment of an array raises, without a text, which takes four seconds to compile."""


def _begun(self, typing, target, library, args, result, flags, local):
    """numba's compiler of its own functions, which are only linked here."""
    if library is None and type(self) is Compiler and flags.no_cpython_wrapper:
        library = _PartLibrary(target.codegen(), "numba")
    _BEGIN(self, typing, target, library, args, result, flags, local)


@overload(_wrong_shape)
def _raising(source, target):
    def found(source, target):
        raise ValueError

    return found


PLAIN = {
    (owner, name): getattr(owner, name)
    for owner, name in (
        (BaseFunction, "get_call_type"),
        (BaseContext, "get_function"),
        (BaseContext, "get_abi_sizeof"),
        (ir.Inst, "_rec_list_vars"),
        (arrayobj, "raise_with_shape_context"),
        (Compiler, "__init__"),
    )
}
_ASK, _FIND, _SIZE, _LIST, _, _BEGIN = PLAIN.values()
SPARED = dict(zip(PLAIN, (_typed, _found, _sized, _variables, _wrong_shape, _begun)))
