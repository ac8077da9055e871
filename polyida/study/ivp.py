"""What a study runs: an initial value problem, from a model, a registered problem or a user's file, and a set of integrators."""

import inspect
from contextlib import AbstractContextManager
from dataclasses import MISSING, dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from polyida import registry
from polyida.errors import InputError
from polyida.integrate.start import consistent_state
from polyida.integrate.state import declared
from polyida.model import Model
from polyida.model.guarded import guard
from polyida.reprs import number_text, settings_of
from polyida.run.solve import require_run, solve
from polyida.study.scene_options import typed_options
from polyida.study.user_files import load_object, user_errors
from polyida.validation import SMALLEST, floats, is_number

PARTS = ("q", "v", "lam")  # of models without first-order states
WARM_UP = 2e-4  # of t_end: duration of the warm-up run of an integrator that chooses its steps
MAX_LENGTH = 60  # characters of the text of an integrator's settings
FILE_OPTIONS = {"time": "t_end", "step": "step", "q0": "q0", "v0": "v0", "point": "point"}  # that a function of a scene file may return


def values_of(model, q, v, lam):
    """{part: value} of a guarded model at one time: q, v and lam; and if it has states x, these, with zeros for them in q and v."""
    if not model.k:
        return {"q": q, "v": v, "lam": lam}
    return {"q": model.without_states(q), "v": model.without_states(v), "lam": lam, "x": model.states_of(v)}


@dataclass(frozen=True)
class InitialValueProblem:
    """A model and its motion from (q0, v0) at t = 0 to t_end, s.

    published: {"q", "v", "lam": values at t_end, "known_to": {part: accuracy}, "made_by": [source]}, of problems with published digits.
    quantity: what is compared in place of the end, a Quantity of polyida.study.quantity. step: of integrators without error control, s. point: name of the point that comparisons measure, None: all coordinates. file: the
    user's file, None for other models.
    """

    name: str
    model: Model
    t_end: float = 1.0
    q0: object = None
    v0: object = None
    published: dict = field(default_factory=dict)
    step: float = 1e-3
    point: str | None = None
    file: Path | None = None
    quantity: Any = None

    def user_errors(self) -> AbstractContextManager:
        """Context that names the line of the user's file from which an exception comes."""
        return user_errors(self.file)

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the parts of a motion whose errors studies measure."""
        if self.quantity:
            return tuple(self.quantity.functions)
        return (*PARTS, "x") if self.model.k and guard(self.model).k else PARTS

    def run(self, integrator, t_end=None, **options):
        """The Trajectory of an integrator; it ends early if a user's function raises. Ctrl-C raises KeyboardInterrupt."""
        try:
            run = solve(self.model, t_end or self.t_end, integrator, q0=self.q0, v0=self.v0, **options)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # SystemExit of a user's function, for example
            run = getattr(error, "trajectory", None)
            if run is None:
                raise
        if run.status == "interrupted":
            raise KeyboardInterrupt
        return run

    def warm_up(self, integrator):
        """Run about two steps, so that the time to compile or load kernels is not part of a measurement."""
        self.run(integrator, min(2 * declared(integrator).fixed_step() or WARM_UP * self.t_end, self.t_end))


def _of_problem(problem, t_end=None, q0=None, v0=None):
    """The initial value problem of a Problem; published digits stay if its start and end are unchanged."""
    start = [default if value is None else value for value, default in ((q0, problem.q0), (v0, problem.v0))]
    published = {}
    if t_end in (None, problem.t_end) and start[0] is problem.q0 and start[1] is problem.v0:
        published = dict(problem.reference)
        if set(PARTS) <= set(published) & set(problem.known_to):
            published |= {"known_to": problem.known_to, "made_by": [problem.source]}
    return InitialValueProblem(problem.name, problem.model, problem.t_end if t_end is None else t_end, *start, published)


def initial_value_problem(study, model, t_end, q0=None, v0=None):
    """The InitialValueProblem of the arguments of a study; a Problem's own start and end are the defaults.

    Raises InputError in the name of `study` for an unknown model, an invalid time and an invalid start.
    """
    name, built, problem = resolve_model(study, model)
    ivp = _of_problem(problem, t_end, q0, v0) if problem else InitialValueProblem(name, built, t_end, q0, v0)
    if not (is_number(ivp.t_end) and ivp.t_end > 0):
        raise InputError(f"{study}: t_end = {ivp.t_end!r} must be a positive time in s")
    consistent_state(ivp.model, 0.0, ivp.q0, ivp.v0)
    return ivp


def resolve_model(study, model):
    """(name, Model, Problem or None) of a Model, a Scene, a Problem, or the name of one. Raises InputError for anything else."""
    from polyida import problems
    from polyida.scene import Scene

    if isinstance(model, str):
        model = problems.get(model)
    if isinstance(model, problems.Problem):
        return model.name, model.model, model
    built = model.build() if isinstance(model, Scene) else model
    if not isinstance(built, Model):
        expected = "a Model, a Scene, a Problem or the name of one is needed"
        raise InputError(f"{study}: the model is {type(model).__name__}; {expected}")
    return f"a scene of {built.n} coordinates" if isinstance(model, Scene) or built.is_scene else type(model).__name__, built, None


def load(spec, time=None, step=None, texts=None, known=(), **options):
    """The InitialValueProblem of a registered name or of `my_scene.py:build`; time and step override those of the scene.

    options (such as cells) are arguments of the function that builds the scene; None: default. texts: {option: text} of further ones, as the
    command line gives them; known: its own options. Raises InputError for an unknown name, file, function or option, and for times that are not
    positive.
    """
    from polyida import problems

    build, file, name = _named_function(spec)
    arguments = {key: value for key, value in options.items() if value is not None} | typed_options(spec, build, texts or {}, known)
    _require_arguments(spec, build, arguments)
    with user_errors(file):
        ivp = _of_returned(name, build(**arguments) if file else problems.get(spec, **arguments))
        ivp = replace(ivp, point=_compared_point(name, ivp))
    ivp = replace(ivp, file=file, step=ivp.step if step is None else step)
    if time is not None:
        ivp = replace(ivp, t_end=time, published={})
    for key, value in (("time", ivp.t_end), ("step", ivp.step)):
        if not (is_number(value) and value > 0):
            raise InputError(f"{name}: {key} {value!r} s must be a positive number")
    return ivp


def _named_function(spec):
    """(function that builds the scene, the user's file or None, name of the problem) of a name or of `my_scene.py:build`."""
    if ".py" in spec:
        build, (path, _, function) = load_object(spec, registry.problems, callable, "functions"), spec.rpartition(":")
        file = Path(path)
        return build, file, file.stem if function == "build" else f"{file.stem}-{function}"
    if spec not in registry.problems:
        raise InputError(f"scene {spec!r} is unknown; there are {', '.join(registry.problems)}, or give my_scene.py:build")
    return registry.find(registry.problems, spec), None, spec


def _require_arguments(spec, build, arguments):
    """Raise InputError unless a function takes these arguments and needs no others."""
    signature = inspect.signature(build)
    if unknown := set(arguments) - set(signature.parameters):
        raise InputError(f"{spec} takes no option --{min(unknown)}: its function has no argument of that name")
    try:
        signature.bind(**arguments)
    except TypeError as error:
        raise InputError(f"{spec}: {error}; its function gets no arguments but those of options such as --cells") from None


def _of_returned(name, result):
    """The InitialValueProblem of what a function returned: a Problem, or a Scene or Model, alone or with a dictionary of FILE_OPTIONS."""
    from polyida.problems import Problem
    from polyida.scene import Scene

    if isinstance(result, Problem):
        return replace(_of_problem(result), name=name, step=result.t_end / 1000)
    returned = result if isinstance(result, tuple) else (result,)
    result, settings = returned if len(returned) == 2 else (result, {})
    if not isinstance(result, Scene | Model) or not isinstance(settings, dict):
        kinds = ", ".join(type(one).__name__ for one in returned)
        expected = 'a Scene, a Model, a Problem, or a pair such as (model, {"q0": [...], "v0": [...], "time": 2.0}) is needed'
        raise InputError(f"{name}: its function returned {kinds}; {expected}")
    if unknown := set(settings) - set(FILE_OPTIONS):
        raise InputError(f"{name}: unknown option {min(unknown, key=str)!r}; known: {', '.join(FILE_OPTIONS)}")
    model = result.build() if isinstance(result, Scene) else result
    return InitialValueProblem(name, model, **{FILE_OPTIONS[key]: value for key, value in settings.items()})


def _compared_point(name, ivp):
    """The point that comparisons measure: the one that the user's function named, or the mass "tip", or the last mass, or None."""
    from polyida.body.rigid_body import PointMass

    if ivp.point:
        if not isinstance(ivp.point, str):
            raise InputError(f"{name}: point = {ivp.point!r} must be the name of a mass, load or joint")
        ivp.model.attachment(ivp.point)
        return ivp.point
    masses = [key for key, part in ivp.model.parts.items() if isinstance(part, PointMass)]
    return "tip" if "tip" in masses else masses[-1] if masses else None


def integrator_lists(study, ivp, integrators, several=True):
    """{label: [integrators]} of a user's argument. Raises InputError for anything that cannot run."""
    require_labels(study, integrators, "[integrators]" if several else "integrator")
    lists = {}
    for label, value in integrators.items():
        lists[label] = list(value) if isinstance(value, (list, tuple)) else [value]
        if not lists[label] or not several and len(lists[label]) != 1:
            expected = "one or more integrators" if several else "one integrator"
            raise InputError(f"{study}: integrators[{label!r}] = {value!r} must be {expected}")
        for integrator in lists[label]:
            require_run(ivp.model, ivp.t_end, 0.0, integrator)
    return lists


def require_labels(study, integrators, values):
    """Raise InputError unless this is {label: values} with labels that a legend shows."""
    if not isinstance(integrators, dict) or not integrators:
        raise InputError(f"{study}: integrators = {integrators!r} must be a dictionary {{label: {values}}}")
    for label in integrators:
        if not isinstance(label, str) or not label or label.startswith("_"):
            raise InputError(f"{study}: label {label!r} of an integrator must be a text that does not begin with _")


def step_list(study, h):
    """The steps h, s, as a list, the longest first. Raises InputError for other values."""
    steps = floats(h)
    if steps is None or steps.ndim != 1 or not steps.size or not (steps >= SMALLEST).all():
        raise InputError(f"{study}: h = {h!r:.200} must be positive steps in s, at least one")
    return sorted(steps.tolist(), reverse=True)


def settings_text(integrator, others, used=None):
    """The settings in which an integrator differs from the others, "h=0.001", or else from its defaults, "IDA()".

    used: the settings that its run used; relative tolerances that acted and differ from those given are shown too, "rtol=1e-05, ida_rtol=3.2e-08".
    """
    if not is_dataclass(integrator) and type(integrator).__repr__ is not object.__repr__:
        return repr(integrator)[:MAX_LENGTH]
    kind, values = type(integrator), settings_of(integrator)
    items = fields(integrator) if is_dataclass(integrator) else ()
    defaults = {item.name: item.default for item in items if item.repr and item.init} or dict.fromkeys(values, MISSING)
    tolerances = {name: value for name, value in (used or {}).items() if name.endswith("rtol") and value is not None}
    given = [values[name] for name in tolerances if values[name] is not None]
    acted = {}
    for name, value in tolerances.items():
        if value not in given and value not in acted.values():
            acted[name] = value

    def text(names):
        """A text "h=0.001, rtol=1e-05" of the settings of these names with their values in the run, and of the tolerances that acted."""
        shown = {name: values[name] for name in names} | acted
        return ", ".join(f"{name}={number_text(value)}" for name, value in shown.items())

    if all(type(other) is kind for other in others):
        others = [settings_of(other) for other in others]
        varied = [name for name in defaults if any(not np.array_equal(values[name], other.get(name)) for other in others)]
        if varied:
            return text(varied)[:MAX_LENGTH]
    changed = [name for name, default in defaults.items() if default is MISSING or not np.array_equal(values[name], default)]
    return f"{kind.__name__}({text(changed)})"[:MAX_LENGTH]


def kind_of(integrator):
    """A text that is equal for integrators with the same kernels: class and settings without their numbers."""
    values = settings_of(integrator).items()
    return f"{type(integrator)} { {name: value is None if value is None or is_number(value) else value for name, value in values} }"
