"""Compilers that do the work of numba's in less time (studies/start.py). All use of numba's internals is here; the package works without them.

numba optimises each function, makes machine code of it, and repeats this for each function that calls it, with all its callees. Here a part
is only lowered; it is optimised with the entries that take it in. `shared` entries are not taken in but called.
"""

import atexit
import gc
from contextlib import contextmanager
from functools import cache, partial
from hashlib import sha256
from importlib import import_module
from typing import NamedTuple

import numba
from numba import types
from numba.core import typed_passes, untyped_passes
from numba.core.base import BaseContext
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, Flags
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.lowering import Lower
from numba.core.registry import CPUDispatcher
from numba.core.types.functions import BaseFunction
from numba.extending import overload
from numba.np import arrayobj

from polyida.jit import cache as kernel_cache
from polyida.jit.pack import form_of


class KernelLower(Lower):
    """Lowers kernels: their indices of arrays are not negative, and code that would count negative ones from the end is a fifth of a step."""

    def setup_function(self, fndesc):
        """Begin a function, and mark its builder: indices of arrays count from zero, never from the end."""
        super().setup_function(fndesc)
        self.builder.counts_from_zero = True


@register_pass(mutates_CFG=True, analysis_only=False)
class KernelLowering(typed_passes.NativeLowering):
    """numba's pass that generates LLVM code, with KernelLower in place of its class."""

    _name = "kernel_lowering"
    lowering_class = KernelLower


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
    KernelLowering,
    typed_passes.NoPythonBackend,
)
_in_use: list = []  # objects that the address of a C function needs


class Entry(CPUDispatcher):
    """A function that Python calls. Compiled code that calls it takes in its part."""

    def __init__(self, function, part, compiler, options):
        """Make a dispatcher of a function. part: what compiled code takes in. compiler: pipeline class. options: of numba.njit."""
        super().__init__(function, targetoptions={"nopython": True, "no_cfunc_wrapper": True, **options}, pipeline_class=compiler)
        self.part, self.known = part, {}

    def __call__(self, *args):
        """Return the result of the function for these arguments; the machine code for their types is compiled if there is none yet.

        This code is kept by a form of the arguments that is found fast: numba looks through all arrays of a pack, which takes as long as a
        small kernel.
        """
        forms = tuple(map(form_of, args))
        found = self.known.get(forms)
        if found is None:
            if None in forms:
                return super().__call__(*args)
            found = self.known[forms] = self.compile(tuple(map(numba.typeof, args)))
        return found(*args)

    @property
    def _numba_type_(self):
        """The numba type of the part: compiled code that calls the entry sees the part in its place."""
        return self.part._numba_type_

    def typeof_pyval(self, val):
        """The type of an argument; a pack stores its type, because looking it up takes as long as a small kernel."""
        return getattr(val, "_kind", None) or super().typeof_pyval(val)


def entry(outer, part, compiler, options, cached=True):
    """Make an Entry of a Python function and its part; its code is stored in `cache.Files` if cached."""
    new = Entry(outer, part, compiler, options)
    with kernel_cache.cache_folder() as writable:
        if writable and cached:
            new.enable_caching()
            new._cache._cache_file = kernel_cache.Files(new._cache.cache_path, new._cache._impl.filename_base)
    return new


def c_address(outer, part, kinds, options, cached=True):
    """Compile a function as a C function of these types and return its address."""
    new = entry(outer, part, EntryCompiler, options | {"no_cpython_wrapper": True, "no_cfunc_wrapper": False}, cached)
    new.compile(kinds)
    result = new.overloads[kinds.args]
    environments = result._find_referenced_environments()
    for one in environments:  # Python objects that parts print with: the machine code has a place for them from now on
        result.library.codegen.set_env(one.env_name, one)
    _in_use.append((new, environments))
    return result.library.get_pointer_to_function(result.fndesc.llvm_cfunc_wrapper_name)


def shared(outer, function, options):
    """Make an entry whose part is a call of its own compiled code, which is not copied into callers."""
    new = entry(outer, None, SharedCompiler, options)
    wrappers = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    new.part = numba.njit(pipeline_class=partial(Call, new), **wrappers, **options)(function)
    return new


class OwnCompiler(Compiler):
    """numba's compiler with all its passes, for functions of users."""

    def __init__(self, typing, target, library, args, result, flags, local):
        """Take the arguments of numba's compiler, with the flags as Options, which are compared faster."""
        super().__init__(typing, target, library, args, result, Options(flags), local)

    def compile_extra(self, func):
        """Compile a Python function within `faster_numba`."""
        with faster_numba():
            return super().compile_extra(func)


class EntryCompiler(OwnCompiler):
    """The compiler of kernels: functions without closures, literals, parallel loops and array expressions."""

    def define_pipelines(self):
        """A list of one PassManager with the passes that kernels need, from bytecode to machine code."""
        passes = PassManager("kernel")
        for one in PASSES:
            passes.add_pass(one, one.name())
        passes.finalize()
        return [passes]


class _ForLinking:
    """A compiler whose results are linked into callers, without machine code."""

    def __init__(self, typing, target, library, *rest):
        """Take the arguments of numba's compiler, with a _PartLibrary in place of a missing library."""
        super().__init__(typing, target, library or _PartLibrary(target.codegen(), "part"), *rest)


class PartCompiler(_ForLinking, EntryCompiler):
    """The compiler of parts: kernels' functions that are linked into callers."""


class OwnPartCompiler(_ForLinking, OwnCompiler):
    """The compiler of users' parts."""


class _PartLibrary(JITCodeLibrary):
    """The code of a part and of its callees, not optimised."""

    def finalize(self):
        """Link the callees, so that callers take in both."""
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalized = True

    @property
    def codegen(self):
        """Ignores the environment of a function: there is no machine code that holds it."""
        return _NoEnvironment


class _NoEnvironment:
    @staticmethod
    def set_env(name, environment):
        """Do nothing in place of storing the environment of a function."""


class SharedCompiler(EntryCompiler):
    """Gives a function the same name in each process, so that the code of its callers can be stored on disk."""

    def _compile_bytecode(self):
        """Set the number in the function's unique name to 0, then compile its bytecode."""
        self.state.func_id.unique_id = 0
        return super()._compile_bytecode()


class Call:
    """Takes the place of a compiler for a call of a shared entry, which is compiled if it is not yet."""

    def __init__(self, entry, typing, target, library, args, *rest):
        """Take the shared entry, and of the arguments of numba's compiler the target and the argument types."""
        self.entry, self.target, self.args = entry, target, tuple(args)

    def compile_extra(self, function):
        """The result of the entry's compilation, without its code."""
        self.entry.compile(self.args)
        new = self.entry.overloads[self.args]
        library = _NoCode(self.target.codegen(), "call of a shared entry")
        library._reload_init, library._finalized = {CompileShared(function.__module__, function.__name__, self.args)}, True
        result = self.target.get_executable(library, new.fndesc, new.environment)
        self.target.insert_user_function(result, new.fndesc, [library])
        return new._replace(entry_point=result, library=library, metadata={})


class _NoCode(JITCodeLibrary):
    """A library to link that has no code."""

    def _get_module_for_linking(self):
        """The LLVM module to link into callers: the library's own, which is empty."""
        return self._final_module


class CompileShared(NamedTuple):
    """Compiles a shared entry when code that calls it is loaded from disk."""

    module: str
    name: str
    args: tuple

    def __call__(self):
        """Import the entry from its module and compile it for the argument types."""
        getattr(import_module(self.module), self.name).compile(self.args)


class Options(Flags):
    """Options of a compilation. numba compares them ten thousand times; this comparison is faster."""

    def __hash__(self):
        """Hash of the names of the options that are set."""
        return hash(tuple(sorted(self._values)))

    def __eq__(self, other):
        """True if the same options are set to the same values."""
        return self._values == other._values if isinstance(other, Flags) else NotImplemented

    def get_mangle_string(self):
        """The part of a function's name that stands for its options. In numba's, each process prints sets in another order."""
        text = " ".join(f"{name}={sorted(str(value))}" for name, value in self._summary_args())
        return sha256(text.encode()).hexdigest()[:16]


@contextmanager
def faster_numba():
    """Store answers that numba would search for again, and stop Python's garbage collection: a quarter of the time. Nested: no effect."""
    if BaseFunction.get_call_type is _call_type:
        yield
        return
    collecting = gc.isenabled()
    gc.disable()
    _freeze_at_exit()
    for (owner, name), method in FASTER.items():
        setattr(owner, name, method)
    try:
        yield
    finally:
        for (owner, name), method in PLAIN.items():
            setattr(owner, name, method)
        if collecting:
            if not gc.get_freeze_count():  # move new objects to the oldest generation, unless the caller has frozen some
                gc.freeze()
                gc.unfreeze()
            gc.enable()


@cache
def _freeze_at_exit():
    """Skip the last garbage collection of a process that has compiled: it takes a second."""
    atexit.register(gc.freeze)


def _call_type(function, context, args, kws):
    """Signature of a builtin, stored: numba tries all versions of an operator each time."""
    return _get_call_type(function, context, args, kws) if kws else _stored_call_type(function, context, tuple(args))


@cache
def _stored_call_type(function, context, args):
    """Signature of a call of a builtin with these argument types, stored after the first search."""
    return _get_call_type(function, context, args, {})


def _function(context, key, sig, _firstcall=True):
    """The implementation of a function; for `__array__`, which has none, without a search through all registries."""
    return _get_function(context, key, sig, _firstcall and key != "__array__")


@cache
def _sizeof(context, kind):
    """Number of bytes of a numba type, stored: LLVM parses a module each time."""
    return _get_abi_sizeof(context, kind)


def _require_shape(src_shapes, index_shape):
    """Raise ValueError for an assignment of arrays of different shapes, without a message with both: it takes a second to compile."""
    raise ValueError


@overload(_require_shape)
def _compiled_require_shape(src_shapes, index_shape):
    """The version of `_require_shape` for compiled code; it always raises, so the caller calls it only for wrong shapes."""

    def require_shape(src_shapes, index_shape):
        """Raise ValueError with a text that does not depend on the shapes."""
        raise ValueError("cannot assign slice from input of different size")

    return require_shape


def _index(context, builder, kind, index, size):
    """An index of an array in machine code, from the end if it is negative; of kernels without this."""
    if kind.signed and getattr(builder, "counts_from_zero", False):
        return context.cast(builder, index, kind, types.intp)
    return _get_index(context, builder, kind, index, size)


METHODS = (
    (BaseFunction, "get_call_type"),
    (BaseContext, "get_function"),
    (BaseContext, "get_abi_sizeof"),
    (arrayobj, "fix_integer_index"),
    (arrayobj, "raise_with_shape_context"),
)
PLAIN = {(owner, name): getattr(owner, name) for owner, name in METHODS}
_get_call_type, _get_function, _get_abi_sizeof, _get_index, _ = PLAIN.values()
FASTER = dict(zip(METHODS, (_call_type, _function, _sizeof, _index, _require_shape)))
