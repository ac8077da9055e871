"""What studies compare: the end of a motion, or a quantity of it over time, in a norm."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from polyida.errors import InputError, text_of
from polyida.integrate.start import consistent_state
from polyida.integrate.state import State
from polyida.joint.attachment import Attachment
from polyida.model.guarded import guard
from polyida.sensor import Sensor
from polyida.trajectory import Trajectory
from polyida.validation import one_of

NORMS = ("end", "max", "rms")
MOST_TIMES = 200  # of a run, at which it is compared
WORDS = {"end": "at the end", "max": "the largest over the run", "rms": "the root mean square over the run"}


@dataclass(frozen=True)
class Quantity:
    """Functions of a run, {name: function(run) -> (frames, ...)}, which studies compare in a norm at some times.

    times: increasing, s; those of the steps of all runs that are compared. of: what the user named; it identifies the functions. unit: of the
    values, empty if unknown. lengths: True if a difference is measured by its length, otherwise by its largest entry. words: for the names in
    headings, {name: text}.
    """

    functions: dict[str, Callable]
    times: np.ndarray
    norm: str
    of: object = None
    unit: str = ""
    lengths: bool = False
    words: dict[str, str] = field(default_factory=dict)

    def of_run(self, run):
        """{name: (times, ...)} of a run with a frame at each of the times."""
        return {name: np.asarray(function(run), float) for name, function in self.functions.items()}

    def every(self, run):
        """Every how many steps a run like this one has a frame: it has at most 200 of them and, for the norm at the end, one."""
        return 10**9 if self.norm == "end" else max(1, -(-run.counts.steps // MOST_TIMES))

    def at_steps_of(self, runs):
        """The Quantity at the frames of these runs, without the start, and at the end of the study."""
        steps = [self._steps(run) for run in runs if run.success]
        return replace(self, times=np.unique(np.concatenate([self.times[-1:], *steps])))

    def errors(self, run, reference):
        """{name: norm of the error} at the frames of a run that are among the times; reference: values at the times."""
        places = np.searchsorted(self.times, self._steps(run))
        return self.distance(
            {name: values[1:] for name, values in self.of_run(run).items()}, {name: reference[name][places] for name in reference}
        )

    def _steps(self, run):
        """Times of a run's frames after the first one, none beyond the end of the reference."""
        return np.minimum(run.t[1:], self.times[-1])

    def size(self, difference):
        """The norm of a difference (times, ...), a float: at the end, the largest one, or the root mean square over the times."""
        flat = np.abs(np.reshape(difference, (len(difference), -1)))
        each = np.linalg.norm(flat, axis=1) if self.lengths else flat.max(axis=1, initial=0.0)
        if self.norm == "end":
            return float(each[-1])
        return float(each.max()) if self.norm == "max" else float(np.sqrt(np.mean(each**2)))

    def distance(self, one, other):
        """{name: norm of the difference} of the quantities that both have."""
        return {name: self.size(one[name] - other[name]) for name in one if name in other}


def quantity_of(study, ivp, of, norm):
    """The Quantity of a study's arguments `of` and `norm`; None for q, v and lam at the end. Raises InputError for others.

    A function is tried on a run of two frames at the start.
    """
    one_of(study, "norm", norm, NORMS)
    if of is None and norm == "end":
        return None
    model, times = guard(ivp.model), np.array([ivp.t_end])
    if of is None:
        without = lambda rows: np.array([model.without_states(np.asarray(row, float)) for row in rows])  # noqa: E731
        functions = {"q": lambda run: without(run.q), "v": lambda run: without(run.v), "lam": lambda run: run.lam}
        functions |= {"x": lambda run: run.x} if model.k else {}
        return Quantity(functions, times, norm)
    unit, lengths, words = "", False, {}
    if isinstance(of, (str, Attachment)):
        if not model.is_scene:
            raise InputError(f"{study}: of = {of!r} names a point of a scene; the model is none: give a sensor or a function of the run")
        try:
            model.pairs_and_weights(of if isinstance(of, Attachment) else model.attachment(of))
        except InputError as error:
            raise InputError(f"{study}: of = {of!r}: {error}") from None
        name = of if isinstance(of, str) else f"{of.body.name or of.body.label} {of.name}"
        function, unit, lengths = lambda run: run.position(of), "m", True
    elif isinstance(of, Sensor):
        name, function, unit = "sensor", lambda run: np.array([of.read(model, state) for state in _states(run)]), of.unit
        words = {"sensor": of.name}
    elif callable(of):
        name, function = getattr(of, "__name__", "of"), of
        name = "quantity" if name == "<lambda>" or name in ("q", "v", "lam", "x", "J") else name
    else:
        raise InputError(
            f"{study}: of = {of!r:.80} must be the name of a point or joint, an attachment of a body, a sensor, or a function of the run"
        )
    _try(study, ivp, name, function)
    return Quantity({name: function}, times, norm, of, unit, lengths, words)


def _states(run):
    """A State for each frame of a run, as a list."""
    return [State(float(t), *(np.asarray(x, float) for x in frame)) for t, *frame in zip(run.t, run.q, run.v, run.a, run.lam)]


def _try(study, ivp, name, function):
    """Raise InputError unless the function gives finite real numbers for each frame of a run."""
    start = consistent_state(ivp.model, 0.0, ivp.q0, ivp.v0)
    rows = (np.array([x, x]) for x in (start.q, start.v, start.a, start.lam))
    run = Trajectory(ivp.model, "start", np.array([0.0, ivp.t_end]), *rows)
    try:
        values = np.asarray(function(run), float)
    except Exception as error:
        raise InputError(f"{study}: of = {name} fails: {type(error).__name__}: {text_of(error)}") from error
    if values.ndim == 0 or len(values) != 2 or not np.isfinite(values).all():
        expected = f"must give finite numbers for each of the run's {len(run)} frames, an array (frames, ...)"
        raise InputError(f"{study}: of = {name} {expected}; it gives an array {values.shape}")
