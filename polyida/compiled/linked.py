"""Compiling each function once: parts are only lowered, and optimised with the entry that takes them in.

numba by itself optimises every function and makes machine code of it, and again of every function that calls it, with all below.
"""

import gc
from contextlib import contextmanager

from polyida.compiled.internals import Compiler, CPUDispatcher, JITCodeLibrary


class Entry(CPUDispatcher):
    """What Python calls; for compiled code it stands for its part."""

    def __init__(self, function, part, options):
        super().__init__(function, targetoptions=options, pipeline_class=EntryCompiler)
        self.part = part

    @property
    def _numba_type_(self):
        return self.part._numba_type_


class EntryCompiler(Compiler):
    """numba's compiler; Python's search for cycles, a tenth of the time that it takes, waits."""

    def compile_extra(self, func):
        """The function compiled."""
        with _without_collection():
            return super().compile_extra(func)


class PartCompiler(EntryCompiler):
    """A compiler whose results are only good for linking."""

    def __init__(self, typing, target, library, *rest):
        super().__init__(typing, target, library or _PartLibrary(target.codegen(), "part"), *rest)


@contextmanager
def _without_collection():
    running = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if running:
            gc.enable()


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
