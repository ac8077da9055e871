"""What the backward sweeps of all integrators share: sums of slopes, sweeps by tables, the consistent start, times of events that depend on
parameters.
"""

from collections.abc import ItemsView, Iterator, KeysView
from copy import copy
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from polyida.adjoint.history import stored_state
from polyida.adjoint.parameter import AdjointMultipliers, Parameter, stacked
from polyida.adjoint.parameters import parameters_of
from polyida.adjoint.profile_parameters import in_time
from polyida.adjoint.taped import Tape, TapedModel, add_to
from polyida.errors import InputError
from polyida.integrate.discontinuities import edges
from polyida.integrate.sizes import extent
from polyida.integrate.start import consistent_acceleration, on_velocity
from polyida.integrate.state import Counts
from polyida.model.guarded import guard
from polyida.objective.objective import Slopes, slopes_at
from polyida.reprs import counted, short, table
from polyida.validation import is_number, is_one_of, named_keywords

MOVES = 1e-8  # of the model's size: a parameter moves constraints if doubling it moves them by more
NEAR = 1e-9  # of |v|: an initial velocity farther from the bodies' own was given by the user


@named_keywords
@dataclass(frozen=True, eq=False)
class Gradient:
    """Value of an objective and its slopes dJ/dp: `gradient["arm.stiffness"]`, (cells,).

    Parameters
    ----------
    value : float
        J.
    slopes : dict of str to float or array
        {name: dJ/dp}, of the shape of the parameter, in the unit of J over that of the parameter.
    counts : Counts
        Work of the backward sweep, of all objectives that were swept together.
    left_out : dict of str to str
        {name: reason} of parameters without a slope; `pi.gradient(run, J, parameters=[name])` gives it.
    """

    value: float
    slopes: dict[str, float | NDArray]
    counts: Counts = field(default_factory=Counts)
    left_out: dict[str, str] = field(default_factory=dict)

    def __getitem__(self, name: str) -> float | NDArray:
        """dJ/dp of a parameter. Raises InputError for an unknown name."""
        if name not in self.slopes:
            why = f" ({self.left_out[name]}); ask for it by `parameters`" if is_one_of(name, self.left_out) else ""
            raise InputError(f"gradient: {name!r} is no parameter it was taken for{why}; known: {', '.join(map(repr, self.slopes))}")
        return self.slopes[name]

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names of the parameters."""
        return iter(self.slopes)

    def __len__(self):
        """Return the number of parameters that have slopes."""
        return len(self.slopes)

    def __contains__(self, name):
        """Return True if the parameter of this name has a slope."""
        return name in self.slopes

    def keys(self) -> KeysView[str]:
        """Return the names of the parameters that have slopes."""
        return self.slopes.keys()

    def items(self) -> ItemsView[str, float | NDArray]:
        """(name, slope) of each parameter."""
        return self.slopes.items()

    def __repr__(self):
        """Return J, the slopes of scalar parameters, the names of the others, and the names left out, in one line."""
        more = f"; left out, to be asked for by name: {counted(self.left_out)}" if self.left_out else ""
        slopes = counted(name if np.ndim(slope) else f"{name}: {slope:.6g}" for name, slope in self.slopes.items())
        return f"Gradient(value={self.value:.9g}, {slopes}{more})"

    def _repr_html_(self):
        """Return an HTML table of all slopes, and of the reasons of those left out, for notebooks."""
        rows = [(name, np.shape(slope) or "", short(slope)) for name, slope in self.slopes.items()]
        rows += [(name, "", f"left out: {why}") for name, why in self.left_out.items()]
        return table(f"J = {self.value:.9g}", ("parameter", "shape", "dJ/dp"), rows)


class Totals:
    """Sums of slopes by the names of parameters.

    names: the requested ones, names or Parameters, or None for all inexpensive ones; with_v0: True if v0, the initial velocities of the
    run, is a parameter too. left_out: {name: reason} of parameters that are taken by name only.
    """

    def __init__(self, model, names=None, with_v0=False):
        """Find the parameters of these names, and set their sums to zero."""
        self.own = own = {one.name: one for one in names or () if isinstance(one, Parameter)}
        self.known = known = parameters_of(model) | own
        self.parts = model.parts if model.is_scene else {}
        names = names and [getattr(one, "name", one) for one in names]
        inexpensive = [name for name, parameter in known.items() if not parameter.only_by_name]
        wanted = inexpensive if names is None else [self._find(name, with_v0).name for name in names if not (with_v0 and name == "v0")]
        self.parameters = {name: known[name] for name in wanted}
        self.requested = names is not None
        self.with_v0 = with_v0 and (names is None or "v0" in names)
        self.sums = {name: np.zeros(np.shape(parameter.value)) for name, parameter in self.parameters.items()}
        self.left_out = {} if names is not None else {name: parameter.reason for name, parameter in known.items() if parameter.only_by_name}

    def _find(self, name, with_v0=False):
        """The parameter of a name. Raises InputError for an unknown one, and for a number of a part that has no slope."""
        if is_one_of(name, self.known):
            return self.known[name]
        part, _, key = name.rpartition(".") if isinstance(name, str) else ("", "", "")
        if part in self.parts and is_number(value := getattr(self.parts[part], key, None)):
            raise InputError(
                f"gradient: {name!r}, which is {value:g}, has no slope: numbers of laws of contact and friction, lengths of joints, places of "
                "bodies and whole numbers have none; take the difference of two runs"
            )
        names = [*self.known, "v0"] if with_v0 else self.known
        raise InputError(f"gradient: {name!r} is no parameter here; known: {', '.join(map(repr, names)) or 'none'}")

    def leave_out(self, name, why, advice=""):
        """Leave out a parameter without a slope. Raises InputError, with advice, if parameters were requested by name."""
        if self.requested:
            raise InputError(f"gradient: {name!r} has no slope: {why}{advice}")
        del self.parameters[name], self.sums[name]
        self.left_out[name] = why

    def empty(self):
        """Totals of the same parameters without slopes, for another objective."""
        other = copy(self)
        other.sums = {name: np.zeros_like(total) for name, total in self.sums.items()}
        return other

    def prepare(self, works):
        """Compute together what the AdjointMultipliers of SharedStates share, before `add` for each."""
        for parameter in self.parameters.values():
            parameter.prepare(works)

    def add(self, multipliers):
        """Add the slopes of AdjointMultipliers."""
        for name, parameter in self.parameters.items():
            self.sums[name] = self.sums[name] + parameter.slope(multipliers)

    def add_own(self, slopes):
        """Add the parts of an objective's Slopes that belong to parameters."""
        for name, slope in slopes.direct.items():
            shape = np.shape(self._find(name).value)
            if np.shape(slope) != shape:
                raise InputError(f"gradient: the objective's own slope in {name!r} has shape {np.shape(slope)}, the parameter {shape}")
            if name in self.sums:
                self.sums[name] = self.sums[name] + slope
        if slopes.of_model is not None:
            for name, parameter in self.parameters.items():
                self.sums[name] = self.sums[name] + parameter.of_model(slopes.of_model)
        if slopes.work is not None:
            self.add(AdjointMultipliers(*slopes.work))

    def add_start(self, state, v0, mode=None):
        """Add the slopes of the initial velocities with adjoint v0; mode: the model that gives them, if another one."""
        known = self.known if mode is None else parameters_of(mode)
        for name in self.parameters:
            slope = known[name].start(state.t, state.q, v0) if name in known else None
            if slope is not None:
                self.sums[name] = self.sums[name] + slope
        if self.with_v0:
            self.sums["v0"] = v0

    def slopes(self):
        """{name: slope}, numbers as floats."""
        return {name: float(total) if np.ndim(total) == 0 else total for name, total in self.sums.items()}


class OwnSlopes:
    """An objective's Slopes by the states of a history, some of which are frames of the run."""

    def __init__(self, objective, run, frames, totals):
        """Take the values and Slopes of an objective of a run; frames: number of the frame of each state, negative for none."""
        self.objective, self.run, self.frames, self.totals = objective, run, frames, totals
        self.slopes = objective.slopes(run)
        self.value = float(self.slopes.value if hasattr(self.slopes, "value") else objective(run))

    def at_states(self, first, end):
        """The Slopes at states first to end - 1, zero at states that are no frames; their parts in parameters are added to the totals."""
        frames = self.frames[first:end]
        numbers = frames[frames >= 0]
        if not len(numbers):
            return Slopes()
        own = slopes_at(self.objective, self.slopes, self.run, slice(int(numbers[0]), int(numbers[-1]) + 1))
        self.totals.add_own(own)
        if len(numbers) == len(frames):
            return own

        def at_all(slopes):
            """The rows of slopes of frames at their states, (states, ...), zero at all other states."""
            result = np.zeros((len(frames), *slopes.shape[1:]))
            result[frames >= 0] = slopes
            return result

        each = {name: getattr(own, name) for name in ("q", "v", "a", "lam")} | {"t": own.by_time()}
        arrays = {name: at_all(slopes) for name, slopes in each.items() if slopes is not None}
        return Slopes(**arrays, energies={name: at_all(factor) for name, factor in own.energies.items()})


class RunAdjoint:
    """Base of the backward sweep over a run; the class of an integrator has `history_of(run, model, memory_limit)` and
    `stretches_backward(sweeps)`.

    `stretches_backward` is a generator: it adds the slopes of a stretch of steps to the `totals` of each of the sweeps, this one and those
    beside it, yields the time at which the stretch begins, and returns their adjoints of q, v, a and lam of the run's first state.
    start_is_given: True if the run starts from a given state, which is held constant.
    """

    def __init__(self, run, objective, names, memory_limit):
        """Read the steps of the run, and set all sums to zero."""
        self.model = guard(run.model)
        self.settings = run.integrator
        self.counts = Counts()
        self.start_is_given = run.plan.get("began") == "state"
        history = self.history_of(run, self.model, memory_limit)
        self.history = history._replace(states=lru_cache(maxsize=2)(history.states))
        self.totals = Totals(run.model, names, not self.start_is_given)
        self.objective_slopes = OwnSlopes(objective, run, self.history.frames, self.totals)
        self.events = EventTimeSensitivity(self.model, run, self.totals.parameters)
        self._exclude_start_parameters()

    @staticmethod
    def require_settings(settings):
        """Raise InputError if the integrator has no adjoint with these settings."""

    @classmethod
    def gradients(cls, run, objectives, names, memory_limit, progress):
        """The Gradient of each objective, from one sweep; progress is called with t."""
        sweeps = cls(run, objectives[0], names, memory_limit).with_others(run, objectives[1:])
        return [sweep.gradient(adjoints) for sweep, adjoints in zip(sweeps, together(sweeps, progress))]

    def with_others(self, run, objectives):
        """This sweep, and one for each of more objectives, with the same steps and factors."""
        return [self, *(self.beside(run, objective) for objective in objectives)]

    def beside(self, run, objective):
        """The sweep for another objective."""
        other = copy(self)
        other.totals, other.events = self.totals.empty(), self.events.empty()
        other.objective_slopes = OwnSlopes(objective, run, self.history.frames, other.totals)
        return other

    def start_adjoints(self, adjoints):
        """The adjoints of the first state with the objective's slopes there and `first_state_adjoint`."""
        own = self.objective_slopes.at_states(0, 1)
        adjoints = [adjoint if slope is None else adjoint + slope[0] for adjoint, slope in zip(adjoints, (own.q, own.v, own.a, own.lam))]
        return adjoints[0] + self.first_state_adjoint(), *adjoints[1:]

    def gradient(self, adjoints):
        """The Gradient, from the adjoints of the sweep."""
        adjoints = self.start_adjoints(adjoints)
        if self.events.speeds:
            self.events.add_to(self.totals.sums, self.history)
        if not self.start_is_given:
            state = stored_state(self.history, 0)
            v0, entries = self._start(state, adjoints)
            self.add(stacked(entries), [], False)
            self.totals.add_start(state, v0)
        return Gradient(self.objective_slopes.value, self.totals.slopes(), self.counts, self.totals.left_out)

    def first_state_adjoint(self):
        """Derivative of J with respect to the first q by what a method evaluates once at the start, (n,); 0 unless it overrides this."""
        return 0.0

    def add(self, multipliers, times=None, moving=True):
        """Add AdjointMultipliers, or None; times: the states' times if those of the multipliers lie just beside them."""
        if multipliers is not None:
            self.totals.add(multipliers)
            if moving and self.events.speeds:
                self.events.add(multipliers, times)

    def _start(self, state, adjoints):
        """(adjoint of the given initial velocities, entries for parameters) of the consistent start (integrate/start.py)."""
        tape = Tape()
        taped = TapedModel(self.model, tape)
        q, v0 = tape.var(state.q), tape.var(given_velocity(self.model, state)[0])
        v = on_velocity(taped, state.t, q, v0)
        for var, adjoint in zip((q, v, *consistent_acceleration(taped, state.t, q, v)), adjoints):
            add_to(var, adjoint)
        tape.back()
        if self.model.m and q.adjoint.any():
            _, nu = self.model.mass_system(state.t, state.q).solve(q.adjoint, np.zeros(self.model.m))
            taped.add_entry(state.t, state.q, mu=nu)
        return v0.adjoint, taped.entries

    def _exclude_start_parameters(self):
        """Exclude parameters that move the constraints at a given initial state or change the meaning of coordinates: no run of another
        value starts there. Raises InputError if they were requested by name.
        """
        state, parameters = stored_state(self.history, 0), self.totals.parameters
        phi = constraints_at(self.model, state)
        slopes = {name: one.slope(phi) for name, one in parameters.items() if self.start_is_given or one.changes_coordinates}
        for name in exclude_moving(self.totals, slopes, extent(self.model, state.q)):
            self.events.speeds.pop(name, None)


def constraints_at(model, state):
    """AdjointMultipliers of a sum of the constraints of a state with random factors."""
    zero, none = np.zeros((1, model.n)), np.zeros((1, model.m))
    mu = np.random.default_rng(0).uniform(1.0, 2.0, none.shape)
    return AdjointMultipliers(np.array([state.t]), state.q[None], zero, zero, none, zero, mu)


def exclude_moving(totals, slopes, size):
    """Leave out of totals each parameter whose change moves the constraints at the start; return the list of their names.

    slopes: {name: slope of `constraints_at` the start in this parameter}. size: of the model, m, to which the motion is compared.

    Raises InputError if they were requested by name.
    """
    why = "it moves the constraints of the state that the run begins with, so that no run of another value begins there"
    values = {name: float(np.abs(totals.parameters[name].value).max(initial=0.0)) or 1.0 for name in slopes}
    moving = [name for name, slope in slopes.items() if values[name] * np.abs(slope).max(initial=0.0) > MOVES * size]
    for name in moving:
        totals.leave_out(name, why, "; draw the scene where the run begins")
    return moving


def together(sweeps, progress):
    """The adjoints of the run's first state, of several sweeps over the same steps; progress is called with t."""
    results = []

    def steps():
        """Sweep back over all stretches: yield times for `progress`, and store the adjoints of the first state."""
        results.extend((yield from sweeps[0].stretches_backward(sweeps)))

    for t in steps():
        progress(t)
    return results


def given_velocity(model, state):
    """(initial velocities that the run was given, True if they are the bodies' own)."""
    initial = model.initial_velocity(state.t, state.q)
    consistent = on_velocity(model, state.t, state.q, initial)
    own = np.abs(consistent - state.v).max() <= NEAR * max(np.abs(state.v).max(), 1e-300)
    return (initial if own else state.v), own


class EventTimeSensitivity:
    """Slopes in parameters that move kinks of loads and motors, and with them the steps: each segment between two kinks stretches.

    The time of a state moves by dt/dp, linearly between kinks, and the steps of a segment change by `dh/dp = (dt_end/dp - dt_begin/dp) /
    count`. To the slope at fixed times is added `sum dt/dp d/dt (w . r + mu . phi + J)` and the effect of h in the formulas of the steps.
    speeds: {name: dt/dp at the ends of the segments between kinks}, empty if no parameter moves a kink.
    """

    def __init__(self, model, run, parameters):
        """Find dt/dp at the kinks and samples of the run.

        For each of {name: Parameter} that moves a kink of a load or motor; begin without slopes.
        """
        begin, end = float(run.t[0]), float(run.t[-1])
        moving = {name: parameter.kinks(begin, end) for name, parameter in parameters.items()}
        self.model = model
        self.edges = np.array([*edges(model, begin, end)])
        self.speeds = {name: self._speeds(kinks) for name, kinks in moving.items() if kinks}
        self.times, self.slopes, self.step_slopes = [], [], []

    def empty(self):
        """A copy with these kinks and speeds and without slopes, for another objective."""
        other = copy(self)
        other.times, other.slopes, other.step_slopes = [], [], []
        return other

    def _speeds(self, kinks):
        """dt/dp at the ends of the segments, from {time of a kink: its derivative}."""
        speeds, times = np.zeros(len(self.edges)), np.array(list(kinks))
        for k in range(1, len(self.edges) - 1):
            near = np.abs(times - self.edges[k]) <= 1e-12 * max(1.0, abs(self.edges[k]))
            speeds[k] = sum(np.array(list(kinks.values()))[near])
        return speeds

    def add(self, multipliers, t=None):
        """Add the slopes of AdjointMultipliers in their times; t (k,): the states' times if those lie just beside them."""
        self.add_at(multipliers.t if t is None else t, in_time(self.model, multipliers))

    def add_at(self, t, slopes):
        """Add slopes in the times t, (k,) each."""
        self.times.append(t)
        self.slopes.append(slopes)

    def add_step_slope(self, segment, slope, before=0.0):
        """Add the slope in h of a segment of the history, and in h of the segment before."""
        self.step_slopes.append((segment, slope, before))

    def add_to(self, sums, history):
        """Add all slopes to the sums of the parameters that move kinks."""
        t, slopes = (np.concatenate(parts) if parts else np.zeros(0) for parts in (self.times, self.slopes))
        for name, speeds in self.speeds.items():
            moved = {segment.first: self._change(segment, history, speeds) for segment in history.segments}
            before = dict(zip([segment.first for segment in history.segments[1:]], moved.values()))
            total = slopes @ np.interp(t, self.edges, speeds)
            sums[name] = sums[name] + total + sum(by_h * moved[s.first] + by * before.get(s.first, 0.0) for s, by_h, by in self.step_slopes)

    def _change(self, segment, history, speeds):
        """dh/dp of a segment: the change of its length over its number of steps."""
        ends = [float(history.states(k, k + 1)[0][0]) for k in (segment.first, segment.first + segment.count)]
        return float(np.diff(np.interp(ends, self.edges, speeds))[0]) / segment.count
