"""Names on the command line: objects of a user's file, `my_file.py:NAME`, and integrators. Such a file is executed."""

import importlib.util
import inspect
import sys
import traceback
from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from polyida import registry
from polyida.errors import InputError, text_of


class SceneFileError(InputError):
    """An exception of the user's code. trace: its traceback reduced to the lines of the user's file; empty for an InputError."""

    def __init__(self, message, trace):
        """Take the message, and the traceback reduced to the user's file as a text."""
        super().__init__(message)
        self.trace = trace


def load_object(spec, book, accepts, plural):
    """The object NAME of `file.py:NAME`, or the entry of that name that the file adds to `book`, a dictionary of the registry.

    accepts(value): True for objects of the wanted kind; plural: their name in messages. Raises InputError if file or object is missing or
    the file fails.
    """
    path, _, name = spec.rpartition(":")
    if not path.endswith(".py"):
        raise InputError(f"{spec}: name one of its {plural}, as in {spec}:NAME")
    module = run_file(Path(path))
    value = getattr(module, name, None) or registry.find(book, name)
    if not accepts(value):
        names = [
            key
            for key, other in vars(module).items()
            if accepts(other) and (not hasattr(other, "__qualname__") or other.__module__ == module.__name__)
        ]
        raise InputError(f"{path}: it has no {name!r}; {plural} there: {', '.join(names) or 'none'}")
    return value


def run_file(path):
    """Execute a user's file and return its module. Raises InputError as `load_object` does."""
    if not path.is_file():
        raise InputError(f"{path}: there is no such file")
    _require_text(path)
    with user_errors(path):
        # the module gets the name under which `import` finds it, if it does: then other processes and result files find its functions
        place, known = path.resolve(), None
        sys.path.insert(0, str(place.parent))
        importlib.invalidate_caches()
        with suppress(ImportError, ValueError):
            known = importlib.util.find_spec(path.stem)
        name = path.stem if known and known.origin == str(place) else f"scene_file_{path.stem}"
        spec = importlib.util.spec_from_file_location(name, path)
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
        return module


def _require_text(path):
    """Raise InputError unless the file at path is text, without NUL, in UTF-8 or in the encoding that its Python comment names."""
    try:
        text = importlib.util.decode_source(path.read_bytes())
    except (SyntaxError, UnicodeError) as error:
        raise InputError(f"{path}: it is no Python file in UTF-8 ({error}); save it with this encoding") from None
    if "\0" in text:
        raise InputError(f"{path}: it holds the character NUL; save it as text in UTF-8")


@contextmanager
def user_errors(path):
    """Context that turns exceptions that pass through the user's file into SceneFileError with the line number. None: no file."""
    try:
        yield
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        if path is None:
            raise
        is_syntax = isinstance(error, SyntaxError)
        if is_syntax and error.filename and Path(error.filename).resolve() == path.resolve():
            frames = [traceback.FrameSummary(str(path), error.lineno or 0, path.stem, line=(error.text or "").strip())]
        else:
            frames = [f for f in traceback.extract_tb(error.__traceback__) if Path(f.filename).resolve() == path.resolve()]
        if not frames:
            raise
        is_input = isinstance(error, InputError)
        kind = "" if is_input else f"{type(error).__name__}: "
        trace = traceback.format_list(frames) + ([] if is_syntax else traceback.format_exception_only(error))
        message = f"{path}, line {frames[-1].lineno}: {kind}{error.msg if is_syntax else text_of(error)}"
        raise SceneFileError(message, "" if is_input else "".join(trace).rstrip()) from error


KNOWN = {  # name: (class in the registry, label, settings that the commands pass to it)
    "alpha": ("GeneralizedAlpha", "generalized-alpha", ("step", "rho_inf")),
    "ida": ("IDA", "IDA", ("rtol", "atol")),
    "radau": ("RadauIIA", "Radau IIA", ("step", "rtol", "atol")),
    "energy": ("EnergyMomentum", "energy-momentum", ("step",)),
}
COMPARED = ("alpha", "ida", "radau")  # default of `polyida compare`
SETTINGS = {"step": "h", "rho_inf": "rho_inf", "rtol": "rtol", "atol": "atol"}  # setting of a command: argument of a class
USES_SCENE_STEP = "GeneralizedAlpha"  # gets the scene's step, although it could control its error


@dataclass(frozen=True)
class IntegratorChoice:
    """An integrator that a command names.

    make: class or function that creates it. settings: {setting of a command: argument of `make`}. required: settings without a default.
    uses_scene_step: True if it gets the scene's step by default. file: the user's file, None for registered integrators.
    """

    name: str
    label: str
    make: Callable[..., Any]
    settings: dict
    required: set
    uses_scene_step: bool
    file: Path | None = None

    def create(self, problem, **values):
        """The integrator with these settings. Raises InputError for an unknown or a missing setting."""
        if unknown := [key for key in values if key not in self.settings]:
            settings = f"its settings are {', '.join(self.settings)}" if self.settings else "it has no settings"
            raise InputError(f"--{_option(unknown[0])} is no setting of {self.name}; {settings}")
        if values.get("step") == "auto":
            if "step" in self.required:
                raise InputError(f"--step auto is no setting of {self.name}, which must have a step, s")
            del values["step"]
        elif self.uses_scene_step:
            values.setdefault("step", problem.step)
        if missing := self.required - set(values):
            raise InputError(f"{self.name} must have --{_option(min(missing))}")
        with user_errors(self.file):
            integrator = self.make(**{self.settings[key]: value for key, value in values.items()})
        from polyida.integrate.state import declared

        declared(integrator, self.name)  # raises InputError if it is no integrator
        return integrator


def choose_integrator(name: str) -> IntegratorChoice:
    """The integrator of a name in `KNOWN` or the registry, or of `my_file.py:NAME`. Raises InputError with the known names."""
    label, settings, file = name, tuple(SETTINGS), None
    if ".py" in name:
        path, _, label = name.rpartition(":")
        source, file = load_object(name, registry.integrators, _can_be_integrator, "integrators"), Path(path)
    elif name in KNOWN:
        of_class, label, settings = KNOWN[name]
        source = registry.find(registry.integrators, of_class)
    elif name in registry.integrators:
        label = {of_class: label for of_class, label, _ in KNOWN.values()}.get(name, name)
        source = registry.find(registry.integrators, name)
    else:
        raise InputError(f"integrator {name!r} is unknown; there are {', '.join([*KNOWN, *registry.integrators])}, or give my_file.py:NAME")
    if hasattr(source, "steps") and not isinstance(source, type):
        return IntegratorChoice(name, label, lambda: source, {}, set(), False, file)
    arguments, required = inspect.signature(source).parameters, _required_arguments(source)
    accepted = {key: argument for key, argument in SETTINGS.items() if key in settings and argument in arguments}
    if "step" not in accepted and len(required) == 1 and required[0] not in accepted:
        accepted["step"] = required[0]
    if unknown := [argument for argument in required if argument not in accepted.values()]:
        raise InputError(f"{name} needs {', '.join(unknown)}: give a function of h that returns it, or an integrator object")
    needed = {key for key, argument in accepted.items() if argument in required}
    uses_scene_step = "step" in needed or source is registry.find(registry.integrators, USES_SCENE_STEP)
    return IntegratorChoice(name, label, source, accepted, needed, uses_scene_step, file)


def choose_integrators(names: Iterable[str]) -> dict[str, IntegratorChoice]:
    """{label: IntegratorChoice}; equal labels of two files get the files' names. Raises InputError if a name occurs twice."""
    choices = [choose_integrator(name) for name in names]
    count = Counter(choice.label for choice in choices)
    labels = [f"{c.label} ({c.file.stem})" if c.file and count[c.label] > 1 else c.label for c in choices]
    if duplicates := [choice.name for choice, label in zip(choices, labels) if labels.count(label) > 1]:
        raise InputError(f"integrators: {' and '.join(duplicates)} are the same; name each once")
    return dict(zip(labels, choices))


def create_integrators(choices: dict[str, IntegratorChoice], problem: Any, **settings: Any) -> dict[str, Any]:
    """Make {label: integrator} of the choices, each with those of the settings that it accepts; None: default.

    An integrator with error control chooses its steps itself. Raises InputError for a setting that no integrator accepts.
    """
    values = {key: value for key, value in settings.items() if value is not None}
    accepted = {key for choice in choices.values() for key in choice.settings}
    if unused := [key for key in values if key not in accepted]:
        raise InputError(f"--{_option(unused[0])} is no setting of {', '.join(choice.name for choice in choices.values())}")
    integrators = {}
    for label, choice in choices.items():
        adaptive = "rtol" in choice.settings and not choice.uses_scene_step
        own = {key: value for key, value in values.items() if key in choice.settings and not (adaptive and key == "step")}
        integrators[label] = choice.create(problem, **own)
    return integrators


def errors_of_all(choices: Iterable[IntegratorChoice]) -> ExitStack:
    """Context in which exceptions of the users' files of all choices become SceneFileErrors."""
    stack = ExitStack()
    for choice in choices:
        stack.enter_context(user_errors(choice.file))
    return stack


def _can_be_integrator(value: object) -> bool:
    """True for an integrator, a class of integrators, or a function of a step that may return one."""
    of_step = inspect.isfunction(value) and ("h" in inspect.signature(value).parameters or len(_required_arguments(value)) == 1)
    return of_step or hasattr(value, "steps")


def _required_arguments(function):
    """Names of the arguments without a default that a function takes by name."""
    kinds = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    return [p.name for p in inspect.signature(function).parameters.values() if p.kind in kinds and p.default is p.empty]


def _option(setting):
    """The name of a setting as an option on the command line shows it: with hyphens for underscores."""
    return setting.replace("_", "-")
