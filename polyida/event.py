"""Events that change a run, what they do, and the table of those that happened, `run.events`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.body.rigid_body import PointMass
from polyida.errors import InputError, printable
from polyida.fields import check, check_fields
from polyida.force.force_element import ForceElement
from polyida.force.loads import EdgeTraction, PointLoad
from polyida.joint.attachment import require_attachment
from polyida.joint.joint import Joint
from polyida.model import Model
from polyida.results.motion import reaction_of
from polyida.validation import is_number, is_one_of, labelled, named_keywords, number, read_only, settle, takes, vector2, whole

if TYPE_CHECKING:
    from pandas import DataFrame

    from polyida.integrate.state import State

DIRECTIONS = ("both", "rising", "falling")
ADDABLE = (Joint, ForceElement, PointMass, PointLoad, EdgeTraction)
FORMS = '"stop", parts, pi.Remove, pi.Impulse, pi.Impact, a model, or a function of the state'


class Moment:
    """A state of a run as functions of events see it: `t`, s, `q`, `v`, `a` (n,), `lam` (m,), first-order states `x` (k,), and points by name.

    lam has an entry for each row of phi of the run, 0 for rows that do not act.
    """

    def __init__(self, model: Any, state: State, mode: Any) -> None:
        """model: of the run. state: of all its coordinates. mode: the model of the parts that act."""
        self._model, self._mode, self._all, self.t = model, mode, state, state.t
        self._own = slice(model.n - model.k if model.k and not model.is_scene else None)
        self.q, self.v = (read_only(x)[self._own] for x in (state.q, state.v))
        self._reads_forces = False  # True once accelerations or multipliers were read

    @property
    def a(self) -> NDArray:
        """Accelerations of the coordinates, (n,), m/s^2 for places."""
        self._reads_forces = True
        return read_only(self._all.a)[self._own]

    @property
    def lam(self) -> NDArray:
        """Multipliers of all rows of phi, (m,), N for places."""
        self._reads_forces = True
        return read_only(self._all.lam)

    @property
    def x(self) -> NDArray:
        """First-order states of the model, (k,)."""
        return self._model.states_of(self._all.v)

    def position(self, name: object) -> NDArray:
        """Return the place, (2,), m, of a mass, load or joint, by name or itself, or of an attachment."""
        return self._model.position(name, self._all.q[None])[0]

    def velocity(self, name: object) -> NDArray:
        """Return the velocity, (2,), m/s, of a mass, load or joint, by name or itself, or of an attachment."""
        if not self._model.is_scene:
            raise InputError(f"velocity({name!r:.60}): the model is no scene's; read v")
        return self._model.velocity(name, self._all.v)

    def reaction(self, name: str) -> NDArray:
        """Return the reaction of a joint, as `run.reaction`; 0 while it does not act."""
        lam = self.lam[None][:, self._mode.columns]
        return reaction_of(self._mode, name, np.array([self.t]), self._all.q[None], lam)[0]


@named_keywords
@dataclass(frozen=True, eq=False)
class Event:
    """Change a run where a function of the state changes its sign: `pi.solve(model, t_end, integrator, events=[pi.Event(...)])`.

    The time is located on the motion within the step; two changes of sign within one step are found too. A start at a zero does not count. A
    function that jumps because of another event at the same time counts. Events at one time act in the order of the list.

    Parameters
    ----------
    when : function of a state -> float
        The state has `t`, `q`, `v`, `a`, `lam`, `x`, and of a scene `position(name)`, `velocity(name)` and `reaction(name)`:
        `when=lambda s: s.position("tip")[0]`.
    then : what happens, or a list
        A joint, force element, load or point mass: it is added. A joint takes from the present places of the bodies what others take from the
        drawing: plain `ground` is the present place of its other side, angles stay as they are. Places must fit, to 1e-6 of the scene's size.
        Velocities jump by the plastic impact law, the least change in the metric of M. `pi.Remove`: parts are removed. `pi.Impulse`,
        `pi.Impact`: velocities jump. A function of the state: it returns new velocities (n,), a model, None, or a `pi.State`, whose
        q and v count; first-order states change with a `pi.State` only, as of `pi.consistent_state(model, s.t, s.q, s.v, x0=...)`. A `pi.Model` of the same n: own models only. "stop": the run ends with status "stopped".
    name : str, optional
        By default "event" and its number in the list.
    direction : "both", "rising" or "falling"
        The changes of sign that count.
    most : int
        So many times it may happen; then the run stops with its name.

    Raises
    ------
    InputError
        For a wrong type or value, and bodies in `then`: the number of coordinates does not change.
    """

    when: Callable[[Moment], float]
    then: Any = "stop"
    name: str | None = None
    direction: str = "both"
    most: int = 1000

    def __post_init__(self):
        """Check the fields; `then` becomes a tuple."""
        label = labelled("Event", self.name)
        if not takes(self.when, 1):
            raise InputError(f"{label}: when = {self.when!r:.60} must be a function of one argument, a state, that gives a number")
        if not is_one_of(self.direction, DIRECTIONS):
            raise InputError(f"{label}: direction = {self.direction!r:.60} must be one of {', '.join(map(repr, DIRECTIONS))}")
        whole(label, "most", self.most)
        then = tuple(self.then) if isinstance(self.then, (list, tuple)) else (self.then,)
        for one in then:
            if not (is_one_of(one, ("stop",)) or isinstance(one, (*ADDABLE, Model, Remove, Impulse, Impact)) or takes(one, 1)):
                advice = "; bodies must be in the scene from the start" if hasattr(one, "mesh") or hasattr(one, "coordinates") else ""
                raise InputError(f"{label}: then = {one!r:.60} must be {FORMS}, or a list of these{advice}")
        settle(self, then=then)

    @property
    def added(self) -> tuple:
        """The parts that the event may add to the model."""
        rests = [part for one in self.then if isinstance(one, Impact) for part in one.rest]
        return (*(one for one in self.then if isinstance(one, ADDABLE)), *rests)


@named_keywords
class Remove:
    """Remove parts at an event: joints, force elements, loads or point masses. States of a removed element keep their values.

    Parameters
    ----------
    *parts : str or part
        By name or themselves.
    """

    def __init__(self, *parts: Any) -> None:
        """Take the parts, by name or themselves, at least one. Raises InputError."""
        if not parts or not all(isinstance(part, (str, *ADDABLE)) for part in parts):
            raise InputError(f"Remove: {parts!r:.80} must be names of parts, or parts, at least one")
        self.parts = parts


@named_keywords
@dataclass(frozen=True, eq=False)
class Impulse:
    """Apply an impulse to a point at an event. Joints react with impulses of their own.

    Parameters
    ----------
    at : Attachment
    impulse : (2,) float, N s

    Raises
    ------
    InputError
        For another type.
    """

    at: Any
    impulse: ArrayLike = field(metadata=check(vector2))

    def __post_init__(self):
        """Check that `at` is an attachment, and the other fields. Raises InputError."""
        require_attachment("Impulse", self.at)
        check_fields(self, "Impulse")


@named_keywords
@dataclass(frozen=True, eq=False)
class Impact:
    """Reverse the rate of the event's function g(t, q) by Newton's law, `g'+ = -e g'-`, with an impulse along dg/dq. Joints stay closed.

    dg/dq is found by differences, so that g must not depend on velocities.

    Parameters
    ----------
    restitution : float
        0 <= e <= 1.
    least_speed : float
        Below this rate |g'|, m/s if g is a distance, the impact is plastic.
    rest : parts
        Added then, to hold what came to rest. Without them the run stops there, since nothing else keeps g from changing its sign.

    Raises
    ------
    InputError
        For other values.
    """

    restitution: float = 0.0
    least_speed: float = 1e-3
    rest: Any = ()

    def __post_init__(self):
        """Check the fields; `rest` becomes a tuple."""
        number("Impact", "least_speed", self.least_speed, "m/s", 0.0)
        if not (is_number(self.restitution) and 0.0 <= self.restitution <= 1.0):
            raise InputError(f"Impact: restitution = {self.restitution!r:.60} must be a number from 0 to 1")
        rest = tuple(self.rest) if isinstance(self.rest, (list, tuple)) else (self.rest,)
        if not all(isinstance(part, ADDABLE) for part in rest):
            raise InputError(f"Impact: rest = {self.rest!r:.80} must be joints, forces, loads or masses, or a list of them")
        settle(self, rest=rest)


@dataclass(frozen=True, eq=False)
class Happened:
    """An event that happened.

    Parameters
    ----------
    t : float, s
    name : str
        Of the event.
    impulse : float, N s
        The largest of `impulses`, without moments; for a model of a user the largest multiplier, in its own unit.
    energy_lost : float, J
        By the event, negative if it gave energy; nan if the model has no potential.
    frame : int
        Index of the first frame after it.
    impulses : dict
        {name: (fx, fy, m)} of the joints that it added, on their side b, N s and N m s; of "impulse" and "impact" what they applied.
    absent : tuple of str
        Parts that do not act after it.
    held : dict
        {name: (1 + n,)}, time and q, of the joints that it added.
    model : int
        Number of the model after it, for models of users: 0 is the first, then those that the events name, in their order.
    """

    t: float
    name: str
    impulse: float
    energy_lost: float
    frame: int
    impulses: dict[str, tuple] = field(default_factory=dict)
    absent: tuple[str, ...] = field(default=(), repr=False)
    held: dict[str, NDArray] = field(default_factory=dict, repr=False)
    model: int = field(default=0, repr=False)


class Events(Sequence):
    """The events of a run, in the order in which they happened: a sequence of Happened.

    Parameters
    ----------
    happened : list of Happened
    first : tuple of str
        Names of the parts that do not act at the start.
    models : list of Model
        Of a user, in the order of their numbers; empty if there is one only, that of the run.
    given : bool
        True if `solve` got events; without, there are impacts of time stepping alone.
    """

    def __init__(self, happened: Any = (), first: Any = (), models: Any = (), given: bool = False) -> None:
        """Take the events that happened, the parts that are absent at the start, the models, and whether `solve` got events."""
        self.happened, self.first, self.models, self.given = list(happened), tuple(first), list(models), given
        self.causes: Any = None  # the Event objects of the run, for its gradient; no file holds them
        self.watch_seconds = np.nan  # CPU time spent on looking for changes of contact and friction; of a run in this process alone

    def __len__(self):
        """The number of events that happened."""
        return len(self.happened)

    def __getitem__(self, k: Any) -> Any:
        """The event number k that happened, or a list of those of a slice."""
        return self.happened[k]

    def __iter__(self) -> Iterator[Happened]:
        """Iterate over the events that happened, in their order."""
        return iter(self.happened)

    @property
    def t(self) -> NDArray:
        """Times of the events, (events,), s."""
        return np.array([one.t for one in self.happened])

    def __repr__(self):
        """A table with time, name, impulse and lost energy of each event; of more than 20, the first and the last ten."""
        rows = [f"{one.t:14.9g} s  {one.name:20} {one.impulse:12.5g} N s {one.energy_lost:12.5g} J" for one in self.happened]
        rows = [*rows[:10], *([f"... {len(rows) - 20} more ..."] if len(rows) > 20 else []), *rows[max(10, len(rows) - 10) :]]
        return "\n".join([f"<Events: {len(self)}; time, name, impulse, energy lost>", *map(printable, rows)])

    def to_dataframe(self) -> DataFrame:
        """Return a pandas.DataFrame with a row for each event that happened: columns t (s), name, impulse (N s) and energy_lost (J)."""
        from pandas import DataFrame

        columns = ("t", "name", "impulse", "energy_lost")
        return DataFrame({name: [getattr(one, name) for one in self.happened] for name in columns})

    def summary(self) -> str:
        """Return how often each event happened, in words; empty without events."""
        names = [one.name for one in self.happened]
        return ", ".join(f"{name!r} {names.count(name)} times" if names.count(name) > 1 else f"{name!r}" for name in dict.fromkeys(names))

    def summary_of_laws(self, cpu_seconds: float) -> str:
        """Return in words the numbers of impacts and of changes of contact and friction, and the share of the CPU time that looking for them took."""
        impacts = sum(one.impulse > 0.0 for one in self.happened)
        share = 100.0 * self.watch_seconds / max(cpu_seconds, 1e-9)
        took = "" if np.isnan(share) else f", {share:.0f} % of the CPU time to look for them"
        return f"contact and friction: impacts {impacts}, changes of status {len(self) - impacts}{took}"

    def modes(self, model: Any, upto: int | None = None) -> list[Any]:
        """Return the models before the first event, after it, after the second ... up to number `upto`."""
        if not model.is_scene:
            models = self.models or [model]
            return [models[k] for k in (0, *(one.model for one in self.happened[:upto]))]
        since: dict[str, NDArray] = {}
        result = [model.mode(frozenset(self.first), since)]
        for one in self.happened[:upto]:
            since = {name: q for name, q in {**since, **one.held}.items() if name not in one.absent}
            result.append(model.mode(frozenset(one.absent), since))
        return result

    def pieces(self, model: Any, frames: int) -> Iterator[tuple[int, int, Any]]:
        """Yield (first frame, last frame + 1, model) of the parts of a run between events; some may have no frame."""
        ends = [0, *(min(one.frame, frames) for one in self.happened), frames]
        yield from zip(ends, ends[1:], self.modes(model))

    def to_data(self) -> list:
        """Return plain data for files: a list [given, *absent parts], then a dictionary for each event."""
        return [[self.given, *self.first], *(asdict(one) for one in self.happened)]

    @classmethod
    def from_data(cls, data: list) -> Events:
        """Return the Events of the plain data that `to_data` gave."""
        (given, *first), *rest = data or [(False,)]
        happened = [Happened(**one | {"held": {name: np.array(at, float) for name, at in one["held"].items()}}) for one in rest]
        return cls(happened, first, given=given)
