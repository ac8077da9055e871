"""What functions of events give with another value of a parameter, where the same q may be other places.

Example: the length of a bar is a parameter, and q holds the place of its root. With another length the same q puts its tip elsewhere; an event
that reads the tip then happens at another time. So the functions are evaluated with another model: the one with the other value.
"""

from dataclasses import replace
from functools import partial

from polyida.adjoint.resets import behind, on_constraints
from polyida.event import Impact, Impulse, Remove
from polyida.joint.attachment import Attachment
from polyida.model.guarded import guard
from polyida.run.reset import pull_of


class OtherPlaces:
    """The functions of an event and of those that it causes, and the points that they push, at one time of a run, with another model."""

    def __init__(self, handler, event, mode, resets, causes):
        """Take the EventHandler of the run, what locates the time, and the events at it.

        event: the first Event; mode: the model before it. resets: Reset of each event; causes: (Event, the State before it) of each.
        """
        self.handler = handler
        self.event = event
        self.mode = mode
        self.resets = resets
        self.causes = causes

    def weighted_sum(self, model, state, adjoints, c):
        """`adjoints . behind + c g` at a state, a float, with the places of another model like the mode and the equations of the mode itself.

        behind: q, v and the positions that joints hold on to after the resets (see `resets.behind`); adjoints: one of each, (n,).
        """
        model = guard(model)
        other = self.handler.of_model(whole_of(model), model)
        value = c * other.value(with_parts_of(self.event, whole_of(self.mode), other.whole), state)
        if any(reset.given or reset.pushes for reset in self.resets):
            resets = [self._reset_of(other, reset, *cause) for reset, cause in zip(self.resets, self.causes)]
            models = [(reset.mode, reset.equations) for reset in self.resets]
            value += sum(float(adjoint @ x) for adjoint, x in zip(adjoints, behind(resets, models, state.t, state.q, state.v)))
        return value

    def _reset_of(self, other, reset, event, state):
        """The Reset of an event at a state, with the functions and pushes of another handler's model."""
        event = with_parts_of(event, whole_of(self.mode), other.whole)
        mode = other.whole.mode_like(reset.mode) if reset.mode.is_scene and reset.mode.whole is not None else other.whole
        given = [action for action in event.then if callable(action)]
        functions = partial(on_constraints, mode, other.functions_of(event, given, mode, state)) if reset.given else None
        return replace(reset, given=functions, pushes=[self._push_of(other, event, state, push) for push in reset.pushes])

    def _push_of(self, other, event, state, push):
        """A push on the place that another handler's model has for its part."""
        if push.function:
            return push._replace(function=other.function_of_position(event, state))
        at = part_of(push.at, whole_of(self.mode), other.whole)
        return push._replace(at=at, along=pull_of(other.whole, at, push.impulse))


def whole_of(model):
    """The model of all parts, of a mode or of itself."""
    return model.whole if model.is_scene and model.whole is not None else model


def part_of(one, old, new):
    """What stands in another model, with parts of the same names, for a part, an attachment or what an event does."""
    names = {id(part): name for name, part in old.parts.items()}

    def moved(part):
        """The part of the same name in the new model for a part of the old one; anything else as it is."""
        return new.parts[names[id(part)]] if id(part) in names else part

    if isinstance(one, Attachment):
        return one.on(moved(one.body))
    if isinstance(one, Remove):
        return Remove(*(names.get(id(part), part) for part in one.parts))
    if isinstance(one, Impulse):
        return replace(one, at=part_of(one.at, old, new))
    if isinstance(one, Impact):
        return replace(one, rest=tuple(map(moved, one.rest)))
    return moved(one)


def with_parts_of(event, old, new):
    """An event with the parts of the new model that have the names of those of the old one.

    Its functions name parts of the old model, and are given their places in the new one.
    """
    if not old.is_scene:
        return event

    def other(one):
        """An action of the event for the new model; a function is given the places of the new model."""
        part = part_of(one, old, new)
        return given_places(one, old, new) if part is one and callable(one) else part

    return replace(event, when=given_places(event.when, old, new), then=tuple(map(other, event.then)))


def given_places(function, old, new):
    """A function of a Moment that asks the new model for places of the old one's parts."""
    return lambda moment: function(_MomentOfOther(moment, old, new))


class _MomentOfOther:
    """A Moment of a model whose places are asked for by parts of another."""

    def __init__(self, moment, old, new):
        """Take a Moment of the model `new`, whose user names parts of the model `old`."""
        self._moment = moment
        self._old = old
        self._new = new

    def __getattr__(self, name):
        """Anything else that the Moment has, such as its time."""
        return getattr(self._moment, name)

    def position(self, name):
        """The place of a part or attachment of the old model."""
        return self._moment.position(part_of(name, self._old, self._new))

    def velocity(self, name):
        """The velocity of a part or attachment of the old model."""
        return self._moment.velocity(part_of(name, self._old, self._new))
