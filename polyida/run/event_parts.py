"""The model of a run with events: the scene with the parts that its events add, or the user's model as it is.

Each event is checked against the scene before the run starts: what it removes, pushes or replaces must be there.
"""

from dataclasses import replace

from polyida.assembly.factors import given_factors
from polyida.body.body import Body
from polyida.errors import InputError
from polyida.event import Event, Impulse, Remove
from polyida.model import Model
from polyida.model.guarded import guard
from polyida.scene import Scene


def prepared(part, model, events):
    """(model with the rows of all parts that the events add, the events with names). Raises InputError, in the name of `part`."""
    events = _named(part, events)
    if not guard(model, part).is_scene:
        for event in events:
            _require_for_own_model(event, model)
        return model, events
    scene = Scene(model.gravity)
    scene.parts.update(model.parts)
    for event in events:
        for added in event.added:
            if not any(added is known for known in scene.parts.values()):
                scene.add(added)
        for action in event.then:
            _require_in_scene(event, action, scene, model)
    scene.require_sides("solve")
    late = tuple(name for name in scene.parts if name not in model.parts)
    if late or model.redundant:
        late += model.late or ()
        whole = type(model)(scene.parts, model.gravity, model.treats_redundant, False, late)
        model = whole.with_factors(**given_factors(model))
    return model, events


def _named(part, events):
    """The events as a list, each with a name of its own. Raises InputError for anything else, in the name of `part`."""
    events = tuple(events) if isinstance(events, (list, tuple)) else (events,)
    if not all(isinstance(event, Event) for event in events):
        raise InputError(f"{part}: events = {events!r:.80} must be a list of pi.Event")
    names = [event.name or f"event {number}" for number, event in enumerate(events, 1)]
    if len(set(names)) < len(names):
        raise InputError(f"{part}: events: the names {', '.join(map(repr, names))} must differ")
    return [replace(event, name=name) for event, name in zip(events, names)]


def _require_for_own_model(event, model):
    """Raise InputError if an event changes parts, which a user's own model does not have."""
    wrong = [action for action in event.then if isinstance(action, (Remove, Impulse))] or list(event.added)
    if wrong:
        own = type(model).__name__
        raise InputError(
            f"{event.name}: then: {wrong[0]!r:.60} is for scenes; {own} has no parts: give another model, a function of the state or an Impact"
        )


def _require_in_scene(event, action, scene, model):
    """Raise InputError unless a scene, and the model that was built from it, can do an action in `then` of an event."""
    if isinstance(action, Remove):
        known = {*map(id, scene.parts.values()), *scene.parts}
        missing = [part for part in action.parts if (part if isinstance(part, str) else id(part)) not in known]
        if missing:
            raise InputError(
                f"{event.name}: Remove: {missing[0]!r:.60} is no part of the scene; parts: {', '.join(map(repr, scene.parts))}"
            )
        removed = [scene.parts.get(part, part) for part in action.parts]
        if any(isinstance(part, Body) or hasattr(part, "mesh") for part in removed):
            raise InputError(f"{event.name}: Remove: bodies cannot be removed; the number of coordinates does not change")
    if isinstance(action, Impulse) and id(action.at.body) not in model.places:
        raise InputError(f"{event.name}: Impulse: {action.at!r} is of a body that is not in the scene")
    if isinstance(action, Model):
        raise InputError(f"{event.name}: then = {action!r:.60}: a scene changes by parts, only a user's model by another model")
