"""The integrators that a command names: known ones, those of the registry, and what a user's file has: classes, functions of h, instances."""

import inspect
from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from polyida import registry
from polyida.errors import InputError
from polyida.study.comparison import scene_file

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
        return scene_file.users_code(self.file) if self.file else nullcontext()


def choice(name: str) -> Choice:
    """What a name means: of `KNOWN`, of the registry, or `my_file.py:NAME`. Raises InputError that lists what there is for another one."""
    if ".py" in name:
        path, _, own = name.rpartition(":")
        return _choice(name, own, scene_file.named(name, registry.integrators, could_be, "integrators"), file=Path(path))
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
