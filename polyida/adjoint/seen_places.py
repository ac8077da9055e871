"""What functions of events see of a model with another value of a parameter: the same q may be other places there."""

from copy import copy
from dataclasses import replace
from functools import partial

from polyida.adjoint.resets import behind, on_constraints
from polyida.event import Impact, Impulse, Remove
from polyida.joint.attachment import Attachment
from polyida.model.guarded import guard
from polyida.run.reset import pull_of


class SeenPlaces:
    """The functions of an event and of those that it causes, and the points that they push, at one time of a run.

    event: what locates the time; mode: the model before it. resets: Reset of each event; causes: (Event, the state before) of each.
    """

    def __init__(self, happenings, event, mode, resets, causes):
        """Take the events of one time; a copy of the happenings stays in the mode before them."""
        self.event, self.mode, self.resets, self.causes = event, mode, resets, causes
        self.happenings = copy(happenings)  # in the mode before: it goes on
        self.happenings.mode = mode

    def weighed(self, model, state, adjoints, c):
        """`adjoints . behind + c g` at a state, with the places of another model like the mode and the equations of the mode itself."""
        seen, model = copy(self.happenings), guard(model)
        seen.whole, seen.mode = whole_of(model), model
        value = c * seen.value(with_parts_of(self.event, whole_of(self.mode), seen.whole), state)
        if any(reset.given or reset.pushes for reset in self.resets):
            resets = [self._reset_of(seen, *each) for each in zip(self.resets, self.causes)]
            models = [(reset.mode, reset.equations) for reset in self.resets]
            value += sum(float(adjoint @ x) for adjoint, x in zip(adjoints, behind(resets, models, state.t, state.q, state.v)))
        return value

    def _reset_of(self, seen, reset, cause):
        """A reset with functions and pushes of the other model, `seen.whole`."""
        event, state = with_parts_of(cause[0], whole_of(self.mode), seen.whole), cause[1]
        mode = seen.whole.mode_like(reset.mode) if reset.mode.is_scene and reset.mode.whole is not None else seen.whole
        given = [one for one in event.then if callable(one)]
        functions = partial(on_constraints, mode, seen._functions(event, given, mode, state)) if reset.given else None
        return replace(reset, given=functions, pushes=[self._push_of(seen, event, state, push) for push in reset.pushes])

    def _push_of(self, seen, event, state, push):
        """A push on the place that the other model has for its part."""
        if push.function:
            return push._replace(function=seen._of_position(event, state))
        at = part_of(push.at, whole_of(self.mode), seen.whole)
        return push._replace(at=at, along=pull_of(seen.whole, at, push.impulse))


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
    """An event with the parts of another model of the same names; its functions, which know those of the old one, see the places of the new
    one.
    """
    if not old.is_scene:
        return event

    def other(one):
        """An action of the event for the new model; a function sees the places of the new model."""
        part = part_of(one, old, new)
        return seeing(one, old, new) if part is one and callable(one) else part

    return replace(event, when=seeing(event.when, old, new), then=tuple(map(other, event.then)))


def seeing(function, old, new):
    """A function of a Moment of the model `new` that gives what the user's `function` gives.

    The user's function names parts of the model `old`; for places and velocities it gets those of the parts of the same name in `new`.
    """
    return lambda moment: function(_Seen(moment, old, new))


class _Seen:
    """A Moment of a model whose places are asked for by parts of another."""

    def __init__(self, moment, old, new):
        """Take a Moment of the model `new`, whose user names parts of the model `old`."""
        self._moment = moment
        self._models = (old, new)

    def __getattr__(self, name):
        """Anything else that the Moment has, such as its time."""
        return getattr(self._moment, name)

    def position(self, name):
        """The place of a part or attachment of the old model."""
        return self._moment.position(part_of(name, *self._models))

    def velocity(self, name):
        """The velocity of a part or attachment of the old model."""
        return self._moment.velocity(part_of(name, *self._models))
