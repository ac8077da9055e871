"""What users call says what it takes and gives: every public function, class and method is annotated, and the wheel says so."""

import inspect
from pathlib import Path

import polyida as pi

MODULES = (pi.mesh, pi.design, pi.profile, pi.sensor, pi.objective, pi.problems, pi.export, pi.study)


def shown(module):
    """{name: function or class} that a module shows: what its __all__ names, or what is its own."""
    own = lambda thing: getattr(thing, "__module__", None) == module.__name__  # noqa: E731
    names = getattr(module, "__all__", None) or [name for name in vars(module) if name[0] != "_" and own(vars(module)[name])]
    return {f"{module.__name__}.{name}": getattr(module, name) for name in names}


def functions(name, thing):
    """{name: function}: itself, or the constructor and the public methods and properties of a class, those of its bases in polyida too."""
    if not inspect.isclass(thing):
        return {name: thing} if callable(thing) else {}
    bases = [base for base in thing.__mro__ if base.__module__.startswith("polyida.")]
    members = {key: value for base in reversed(bases) for key, value in vars(base).items() if key[0] != "_" or key == "__init__"}
    unwrapped = {
        key: getattr(value, "fget", None) or getattr(value, "func", None) or getattr(value, "__func__", value)
        for key, value in members.items()
    }
    return {f"{name}.{key}": value for key, value in unwrapped.items() if inspect.isfunction(value)}


def public():
    things = {f"polyida.{name}": getattr(pi, name) for name in pi.__all__}
    for module in MODULES:
        things |= shown(module)
    return {key: function for name, thing in things.items() for key, function in functions(name, thing).items()}


def untyped(function):
    """Parameters without a type, and "return" where it has none; self, cls and what is a fixed * or ** have none."""
    signature = inspect.signature(function)
    kinds = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    bare = [
        p.name for p in signature.parameters.values() if p.annotation is p.empty and p.name not in ("self", "cls") and p.kind not in kinds
    ]
    return bare + ["return"] * (signature.return_annotation is signature.empty)


def test_public_functions_are_typed_and_checkers_are_told():
    missing = {name: untyped(function) for name, function in public().items()}
    assert len(missing) > 400 and not {name: bare for name, bare in missing.items() if bare}
    assert (Path(pi.__file__).parent / "py.typed").is_file()
