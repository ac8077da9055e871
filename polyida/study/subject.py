"""What a study runs: a model, a scene, a problem or its name, with its start and end; and with which integrators."""

from dataclasses import MISSING, dataclass, field, fields, is_dataclass

import numpy as np

from polyida.errors import InputError
from polyida.integrate.start import consistent_state
from polyida.integrate.state import declared
from polyida.model import Model
from polyida.run.solve import require_run, solve
from polyida.validation import floats, is_number

PARTS = ("q", "v", "lam")
SHORT = 2e-4  # of the time, for which an integrator that has no step of its own runs beforehand
LONGEST = 60  # characters of a setting


@dataclass(frozen=True)
class Subject:
    """A model and the motion that is studied: from (q0, v0) at t = 0 to t_end, s. published: digits at t_end, as references.given takes them."""

    name: str
    model: Model
    t_end: float
    q0: object = None
    v0: object = None
    published: dict = field(default_factory=dict)

    def run(self, integrator, t_end=None, **options):
        """The Trajectory by an integrator, as far as it came where a user's function raised; Ctrl-C goes on to who asked."""
        try:
            run = solve(self.model, t_end or self.t_end, integrator, q0=self.q0, v0=self.v0, **options)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # SystemExit of a user's function, say
            run = getattr(error, "trajectory", None)
            if run is None:
                raise
        if run.status == "interrupted":
            raise KeyboardInterrupt
        return run

    def warm_up(self, integrator):
        """Two steps, so that compiling or loading kernels counts as nobody's time."""
        h = declared(integrator).fixed_step()
        short = 2 * h or SHORT * self.t_end
        self.run(integrator, min(short, self.t_end))


def kind_of(integrator):
    """What an integrator is, in words, beside its numbers: those choose no kernels."""
    if not is_dataclass(integrator):
        return repr(type(integrator))
    named = {name: value is None if value is None or is_number(value) else value for name, value in _settings(integrator).items()}
    return f"{type(integrator)} {named}"


def subject(study, model, t_end, q0=None, v0=None):
    """The Subject of what a user gives: a Model, a Scene, a Problem, or the name of one, whose start and end are its own where none are
    given.

    Raises InputError for anything else, for a name that is unknown, and for a time or a start that cannot be.
    """
    name, built, problem = studied(study, model)
    return _of_problem(study, problem, t_end, q0, v0) if problem else _checked(study, Subject(name, built, t_end, q0, v0))


def studied(study, model):
    """(name, Model, Problem or None) of a Model, a Scene, a Problem, or the name of one. Raises InputError for anything else."""
    from polyida import problems
    from polyida.scene import Scene

    if isinstance(model, str):
        model = problems.get(model)
    if isinstance(model, problems.Problem):
        return model.name, model.model, model
    built = model.build() if isinstance(model, Scene) else model
    if not isinstance(built, Model):
        wanted = "a Model, a Scene, a Problem or the name of one is needed"
        raise InputError(f"{study}: the model is {type(model).__name__}; {wanted}")
    name = f"a scene of {built.n} coordinates" if isinstance(model, Scene) or built.is_scene else type(model).__name__
    return name, built, None


def _of_problem(study, problem, t_end, q0, v0):
    q0, v0 = (own if given is None else given for given, own in ((q0, problem.q0), (v0, problem.v0)))
    as_it_is = t_end in (None, problem.t_end) and q0 is problem.q0 and v0 is problem.v0
    published = {}
    if as_it_is and set(PARTS) <= set(problem.reference) & set(problem.known_to):
        published = {part: problem.reference[part] for part in PARTS} | {"known_to": problem.known_to, "made_by": [problem.source]}
    return _checked(study, Subject(problem.name, problem.model, problem.t_end if t_end is None else t_end, q0, v0, published))


def _checked(study, given):
    if not (is_number(given.t_end) and given.t_end > 0):
        raise InputError(f"{study}: t_end = {given.t_end!r} must be a positive time in s")
    consistent_state(given.model, 0.0, given.q0, given.v0)
    return given


def members(study, given, integrators, several=True):
    """{label: [integrators]} of what a user gives, each of which can run. Raises InputError for what is none."""
    require_labels(study, integrators, "[integrators]" if several else "integrator")
    found = {}
    for label, settings in integrators.items():
        found[label] = list(settings) if isinstance(settings, (list, tuple)) else [settings]
        if not found[label] or not several and len(found[label]) != 1:
            raise InputError(
                f"{study}: integrators[{label!r}] = {settings!r} must be {'one or more integrators' if several else 'one integrator'}"
            )
        for integrator in found[label]:
            require_run(given.model, given.t_end, 0.0, integrator)
    return found


def require_labels(study, integrators, what):
    """Raises InputError unless these are {label: what}, by labels that a picture's key shows."""
    if not isinstance(integrators, dict) or not integrators:
        raise InputError(f"{study}: integrators = {integrators!r} must be a dictionary {{label: {what}}}")
    for label in integrators:
        if not isinstance(label, str) or not label or label.startswith("_"):
            raise InputError(f"{study}: label {label!r} of an integrator must be a text that does not begin with _")


def steps_of(study, h):
    """Steps, s, the longest first. Raises InputError for what are none."""
    steps = floats(h)
    if steps is None or steps.ndim != 1 or not steps.size or not (steps > 0).all():
        raise InputError(f"{study}: h = {h!r} must be positive steps in s, at least one")
    return sorted(steps.tolist(), reverse=True)


def setting(integrator, beside):
    """In what an integrator differs from those beside it, in words: "h=0.001"; where that does not tell, from its defaults: "IDA()"."""
    if not is_dataclass(integrator):
        return repr(integrator)[:LONGEST]
    shown, kind, values = [item for item in fields(integrator) if item.repr and item.init], type(integrator), _settings(integrator)
    listed = lambda names: ", ".join(f"{name}={_short(values[name])}" for name in names)  # noqa: E731
    if all(type(other) is kind for other in beside):
        others = [_settings(other) for other in beside]
        varied = [item.name for item in shown if any(not _same(values[item.name], other[item.name]) for other in others)]
        if varied:
            return listed(varied)[:LONGEST]
    given = [item.name for item in shown if item.default is MISSING or not _same(values[item.name], item.default)]
    return f"{kind.__name__}({listed(given)})"[:LONGEST]


def _settings(part):
    """{field: value} of a dataclass."""
    return {item.name: getattr(part, item.name) for item in fields(part)}


def _same(one, other):
    return bool(np.array_equal(one, other))


def _short(value):
    return f"{value:g}" if is_number(value) else repr(value)
