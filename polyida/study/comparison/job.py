"""What a command solves: a registered scene by name, or what a function of a user's file returns."""

import inspect
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path

from polyida import registry
from polyida.errors import InputError
from polyida.given import is_number
from polyida.study.comparison import scene_file

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
        return scene_file.users_code(self.file) if self.file else nullcontext()


def load(spec, time=None, step=None, **build_options):
    """The job of a registered name or of `my_scene.py:build`; time and step override what the scene says.

    build_options (such as cells) are handed to the function that builds the scene; those that are None are left out.
    Raises InputError for an unknown name, file or function, for an option that the function does not take, and for
    times that are not positive.
    """
    given = {key: value for key, value in build_options.items() if value is not None}
    if ".py" in spec:
        file, build = Path(spec.rpartition(":")[0]), scene_file.named(spec, registry.problems, callable, "functions")
        with scene_file.users_code(file):
            job = _job(_name(file, spec), _call(spec, build, given), file)
    else:
        job = _registered(spec, given)
    for key, value in (("time", time), ("step", step)):
        if value is not None:
            job = replace(job, **{key: value}, published=job.published if key != "time" else {})
        if not (is_number(getattr(job, key)) and getattr(job, key) > 0):
            raise InputError(f"{job.name}: {key} {getattr(job, key)!r} s must be a positive number")
    return job


def _name(file, spec):
    function = spec.rpartition(":")[2]
    return file.stem if function == "build" else f"{file.stem}-{function}"


def _registered(name, options):
    """The job of a registered problem."""
    from polyida import problems

    if name not in registry.problems:
        raise InputError(f"scene {name!r} is unknown; there are {', '.join(registry.problems)}, or give my_scene.py:build")
    _require_taken(name, registry.find(registry.problems, name), options)
    return _job(name, problems.get(name, **options))


def _call(spec, build, options):
    _require_taken(spec, build, options)
    return build(**options)


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
        _require_point(name, model, point)
    return Job(name, model, file=file, **{key: value for key, value in options.items() if key != "point"}, point=point)


def _require_point(name, model, point):
    if not isinstance(point, str):
        raise InputError(f"{name}: point = {point!r} must be the name of a mass, load or joint")
    model.attachment(point)


def _default_point(model):
    """The mass "tip", else the last mass of a scene, else None."""
    from polyida.body.point_mass import PointMass

    masses = [name for name, part in model.parts.items() if isinstance(part, PointMass)]
    return "tip" if "tip" in masses else masses[-1] if masses else None
