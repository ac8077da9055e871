"""What a command names: a scene and integrators, registered ones or those of a user's file. The file is code and is executed: give what you trust."""

import importlib.util
import inspect
import sys
import traceback
from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from polyida import registry
from polyida.errors import InputError
from polyida.validation import is_number


class SceneFileError(InputError):
    """An exception of the user's own code.

    trace: its traceback, shortened to the lines of that file; empty for an input error.
    """

    def __init__(self, message, trace):
        super().__init__(message)
        self.trace = trace


def named(spec, book, is_one, what):
    """What `file.py:name` names: one of the file's, or one that it has added to `book`, a dictionary of the registry.

    is_one: tells of a value whether it can be what is meant; what: the word for these. Raises InputError where file or name is missing or
    the file fails.
    """
    path, _, name = spec.rpartition(":")
    if not path.endswith(".py"):
        raise InputError(f"{spec}: say which of its {what} is meant, as in {spec}:NAME")
    module = executed(Path(path))
    found = getattr(module, name, None) or registry.find(book, name)
    if not is_one(found):
        own = [
            key
            for key, value in vars(module).items()
            if is_one(value) and (not hasattr(value, "__qualname__") or value.__module__ == module.__name__)
        ]
        raise InputError(f"{path}: it has no {name!r}; {what} there: {', '.join(own) or 'none'}")
    return found


def executed(path):
    """The module that a user's file makes; what it adds to the registry is there then. Raises InputError as `named` does."""
    if not path.is_file():
        raise InputError(f"{path}: there is no such file")
    with users_code(path):
        # it gets the name that `import` gives it, where that is free: other processes find its functions so, and result files its classes
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


@contextmanager
def users_code(path):
    """Turn exceptions that pass through the user's file into SceneFileError; input errors gain the line number."""
    try:
        yield
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        lines = _lines_of(error, path)
        if not lines:
            raise
        kind = "" if isinstance(error, InputError) else f"{type(error).__name__}: "
        message = f"{path}, line {lines[-1].lineno}: {kind}{error.msg if isinstance(error, SyntaxError) else error}"
        raise SceneFileError(message, "" if isinstance(error, InputError) else _shortened(error, lines)) from error


def _lines_of(error, path):
    """Frames of the traceback that lie in the user's file; for a syntax error in it, the place of the error."""
    if isinstance(error, SyntaxError) and error.filename and Path(error.filename).resolve() == path.resolve():
        return [traceback.FrameSummary(str(path), error.lineno or 0, path.stem, line=(error.text or "").strip())]
    frames = traceback.extract_tb(error.__traceback__)
    return [frame for frame in frames if Path(frame.filename).resolve() == path.resolve()]


def _shortened(error, lines):
    parts = traceback.format_list(lines)
    if not isinstance(error, SyntaxError):
        parts += traceback.format_exception_only(error)
    return "".join(parts).rstrip()


OPTIONS = ("time", "step", "q0", "v0", "point")


@dataclass(frozen=True)
class Job:
    """A model and how to run it.

    time: simulated, s. step: of fixed-step integrators, s. q0, v0: initial values, zero where None. point: whose path
    is looked at (the mass "tip", or the last mass of the scene; all coordinates where None). published: {"q": (n,),
    ...} at the end, of a problem that has it. file: the user's, where there is one.
    """

    name: str
    model: object
    time: float = 1.0
    step: float = 1e-3
    q0: object = None
    v0: object = None
    point: str | None = None
    file: Path | None = None
    published: dict = field(default_factory=dict)

    def code(self):
        """Context that names the line of the user's file where an exception came from."""
        return users_code(self.file) if self.file else nullcontext()


def load(spec, time=None, step=None, **build_options):
    """The job of a registered name or of `my_scene.py:build`; time and step override what the scene says.

    build_options (such as cells) are handed to the function that builds the scene; those that are None are left out.
    Raises InputError for an unknown name, file or function, for an option that the function does not take, and for
    times that are not positive.
    """
    given = {key: value for key, value in build_options.items() if value is not None}
    if ".py" in spec:
        file, build = Path(spec.rpartition(":")[0]), named(spec, registry.problems, callable, "functions")
        with users_code(file):
            function = spec.rpartition(":")[2]
            _require_taken(spec, build, given)
            job = _job(file.stem if function == "build" else f"{file.stem}-{function}", build(**given), file)
    else:
        from polyida import problems

        if spec not in registry.problems:
            raise InputError(f"scene {spec!r} is unknown; there are {', '.join(registry.problems)}, or give my_scene.py:build")
        _require_taken(spec, registry.find(registry.problems, spec), given)
        job = _job(spec, problems.get(spec, **given))
    for key, value in (("time", time), ("step", step)):
        if value is not None:
            job = replace(job, **{key: value}, published=job.published if key != "time" else {})
        if not (is_number(getattr(job, key)) and getattr(job, key) > 0):
            raise InputError(f"{job.name}: {key} {getattr(job, key)!r} s must be a positive number")
    return job


def _require_taken(name, function, options):
    taken = inspect.signature(function).parameters
    if unknown := set(options) - set(taken):
        raise InputError(f"{name} takes no option --{min(unknown)}: its function has no argument of that name")


def _job(name, result, file=None):
    """A Job from a Scene, a model, or a pair of one of them and a dictionary of options; or a Problem: its step is a thousandth of its time."""
    from polyida.model import Model
    from polyida.problems import Problem
    from polyida.scene import Scene

    if isinstance(result, Problem):
        point, time = _default_point(result.model), result.t_end
        return Job(name, result.model, time, time / 1000, result.q0, result.v0, point, file, result.reference)
    made, options = result if isinstance(result, tuple) and len(result) == 2 else (result, {})
    if not isinstance(made, Scene | Model) or not isinstance(options, dict):
        wanted = "a Scene, a Model, (one of them, options) or a Problem is needed"
        raise InputError(f"{name}: its function returned {type(result).__name__}; {wanted}")
    if unknown := set(options) - set(OPTIONS):
        raise InputError(f"{name}: unknown option {min(unknown, key=str)!r}; known: {', '.join(OPTIONS)}")
    model = made.build() if isinstance(made, Scene) else made
    point = options.get("point") or _default_point(model)
    if point is not None:
        if not isinstance(point, str):
            raise InputError(f"{name}: point = {point!r} must be the name of a mass, load or joint")
        model.attachment(point)
    return Job(name, model, file=file, **{key: value for key, value in options.items() if key != "point"}, point=point)


def _default_point(model):
    """The mass "tip", else the last mass of a scene, else None."""
    from polyida.body.rigid_body import PointMass

    masses = [name for name, part in model.parts.items() if isinstance(part, PointMass)]
    return "tip" if "tip" in masses else masses[-1] if masses else None


KNOWN = {  # name: (class in the registry, label, settings that a command gives it)
    "alpha": ("GeneralizedAlpha", "generalized-alpha", ("step", "rho_inf")),
    "ida": ("IDA", "IDA", ("rtol", "atol")),
    "radau": ("RadauIIA", "Radau IIA", ("step", "rtol", "atol")),
    "energy": ("EnergyMomentum", "energy-momentum", ("step",)),
}
COMPARED = ("alpha", "ida", "radau")  # where nothing else is asked for
SETTINGS = {"step": "h", "rho_inf": "rho_inf", "rtol": "rtol", "atol": "atol"}  # setting of a command: argument of a class
STEPPED = "GeneralizedAlpha"  # is given the scene's step, though it could choose its own


@dataclass(frozen=True)
class Choice:
    """An integrator as it was named. make: what gives it. takes: {setting: argument of that}. required: settings that it must have.
    stepped: whether it gets the scene's step where no other is given. file: the user's, of one that comes from there."""

    name: str
    label: str
    make: Callable[..., Any]
    takes: dict
    required: set
    stepped: bool
    file: Path | None = None

    def made(self, job, **given):
        """The integrator with the settings given. Raises InputError for one that it does not take, and for one that it lacks."""
        if strange := [key for key in given if key not in self.takes]:
            takes = f"its settings are {', '.join(self.takes)}" if self.takes else "it takes none"
            raise InputError(f"--{_option(strange[0])} is no setting of {self.name}; {takes}")
        if given.get("step") == "auto":
            if "step" in self.required:
                raise InputError(f"--step auto is no setting of {self.name}, which must have a step, s")
            del given["step"]
        elif self.stepped:
            given.setdefault("step", job.step)
        if lacking := self.required - set(given):
            raise InputError(f"{self.name} must have --{_option(min(lacking))}")
        with self.code():
            found = self.make(**{self.takes[key]: value for key, value in given.items()})
        if isinstance(found, type) or not callable(getattr(found, "steps", None)):
            raise InputError(f"{self.name}: {found!r} is no integrator, which has `steps(model, state, t_end, counts)`")
        return found

    def compared(self, job, **given):
        """The same with those of the settings that it takes; one that controls its error goes on choosing its steps."""
        adapts = "rtol" in self.takes and not self.stepped
        return self.made(job, **{key: value for key, value in given.items() if key in self.takes and not (adapts and key == "step")})

    def code(self):
        """Context that names the line of the user's file where an exception came from."""
        return users_code(self.file) if self.file else nullcontext()


def choice(name: str) -> Choice:
    """What a name means: of `KNOWN`, of the registry, or `my_file.py:NAME`. Raises InputError that lists what there is for another one."""
    if ".py" in name:
        path, _, own = name.rpartition(":")
        return _choice(name, own, named(name, registry.integrators, could_be, "integrators"), file=Path(path))
    if name in KNOWN:
        of_class, label, settings = KNOWN[name]
        return _choice(name, label, registry.find(registry.integrators, of_class), settings)
    if name not in registry.integrators:
        raise InputError(f"integrator {name!r} is unknown; there are {', '.join(names())}, or give my_file.py:NAME")
    labels = {of_class: label for of_class, label, _ in KNOWN.values()}
    return _choice(name, labels.get(name, name), registry.find(registry.integrators, name))


def names() -> list[str]:
    """All names that need no file."""
    return [*KNOWN, *registry.integrators]


def choices(given: Iterable[str]) -> dict[str, Choice]:
    """{label: Choice} of names; those of two files that have one name are told apart by their files. Raises InputError for one that comes twice."""
    found = [choice(name) for name in given]
    often = Counter(one.label for one in found)
    labels = [f"{one.label} ({one.file.stem})" if one.file and often[one.label] > 1 else one.label for one in found]
    if twice := [one.name for one, label in zip(found, labels) if labels.count(label) > 1]:
        raise InputError(f"integrators: {' and '.join(twice)} are the same; name each once")
    return dict(zip(labels, found))


def compared(chosen: dict[str, Choice], job: Any, **settings: Any) -> dict[str, Any]:
    """{label: integrator} with those of the settings that each takes, None left out. Raises InputError for one that none of them takes."""
    given = {key: value for key, value in settings.items() if value is not None}
    taken = {key for one in chosen.values() for key in one.takes}
    if idle := [key for key in given if key not in taken]:
        raise InputError(f"--{_option(idle[0])} is no setting of {', '.join(one.name for one in chosen.values())}")
    return {label: one.compared(job, **given) for label, one in chosen.items()}


def code(chosen: dict[str, Choice]) -> ExitStack:
    """Context that names the line of any of the users' files where an exception came from."""
    stack = ExitStack()
    for one in chosen.values():
        stack.enter_context(one.code())
    return stack


def could_be(value: object) -> bool:
    """Whether it is an integrator, a class of them, or a function of a step that may return one."""
    return hasattr(value, "steps") or (
        inspect.isfunction(value) and ("h" in inspect.signature(value).parameters or len(_required(value)) == 1)
    )


def _choice(name, label, found, settings=tuple(SETTINGS), file=None):
    """A Choice of a class, a function or an integrator."""
    if hasattr(found, "steps") and not isinstance(found, type):
        return Choice(name, label, lambda: found, {}, set(), False, file)
    known, required = inspect.signature(found).parameters, _required(found)
    takes = {key: argument for key, argument in SETTINGS.items() if key in settings and argument in known}
    if "step" not in takes and len(required) == 1 and required[0] not in takes:
        takes["step"] = required[0]
    if strange := [argument for argument in required if argument not in takes.values()]:
        raise InputError(f"{name} needs {', '.join(strange)}: give a function of h that returns it, or an integrator that is made already")
    must = {key for key, argument in takes.items() if argument in required}
    stepped = "step" in must or found is registry.find(registry.integrators, STEPPED)
    return Choice(name, label, found, takes, must, stepped, file)


def _required(function):
    """Names of the arguments without a default."""
    plain = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    return [p.name for p in inspect.signature(function).parameters.values() if p.kind in plain and p.default is p.empty]


def _option(setting):
    return setting.replace("_", "-")
