"""Entries that compiled code calls where they are: they are compiled once, however many others need them."""

from importlib import import_module
from typing import NamedTuple

from polyida.jit.internals import JITCodeLibrary
from polyida.jit.linked import EntryCompiler


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
