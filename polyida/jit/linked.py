"""Compiling each function once: parts are only lowered, and optimised with the entry that takes them in.

numba by itself optimises every function and makes machine code of it, and again of every function that calls it, with all below.
"""

from numba import typeof

from polyida.jit.internals import Compiler, CPUDispatcher, JITCodeLibrary, PassManager, typed_passes, untyped_passes
from polyida.jit.thrift import Options, thrifty

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


class Entry(CPUDispatcher):
    """What Python calls; for compiled code it stands for its part."""

    def __init__(self, function, part, options, compiler):
        super().__init__(function, targetoptions=options, pipeline_class=compiler)
        self.part = part

    @property
    def _numba_type_(self):
        return self.part._numba_type_

    def bound(self, *args):
        """The compiled function for arguments of these very types."""
        return self.compile(tuple(map(typeof, args)))

    def compiled_for(self, *kinds):
        """What numba knows of the compiled function for arguments of these types."""
        self.compile(kinds)
        return self.overloads[kinds]

    def typed(self):
        """The same for arguments whose types are those of its first call, and not looked at again: that costs as much as a small kernel."""
        return Typed(self)


class Typed:
    """An entry that was compiled for the types of its first call."""

    def __init__(self, entry):
        self.entry, self.compiled = entry, None

    def __call__(self, *args):
        if self.compiled is None:
            self.compiled = self.entry.bound(*args)
        return self.compiled(*args)


class EntryCompiler(Compiler):
    """numba's compiler with the passes that kernels need."""

    def __init__(self, typing, target, library, args, result, flags, local):
        super().__init__(typing, target, library, args, result, Options(flags), local)

    def define_pipelines(self):
        """Passes from bytecode to machine code, for functions without closures, literals, parallel loops and array expressions."""
        passes = PassManager("kernel")
        for one in PASSES:
            passes.add_pass(one, one.name())
        passes.finalize()
        return [passes]

    def compile_extra(self, func):
        """The function compiled."""
        with thrifty():
            return super().compile_extra(func)


class PartCompiler(EntryCompiler):
    """A compiler whose results are only good for linking."""

    def __init__(self, typing, target, library, *rest):
        super().__init__(typing, target, library or _PartLibrary(target.codegen(), "part"), *rest)


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
