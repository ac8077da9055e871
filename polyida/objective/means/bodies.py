"""Which bodies of a scene an objective is of."""

from polyida.errors import InputError
from polyida.given import is_one_of
from polyida.model.guarded import unguarded


def chosen(part, model, given, known):
    """The bodies meant among `known`, {name: one placed}: by name or itself, or all for None. Raises InputError in the name of `part`."""
    if not model.is_scene:
        raise InputError(f"{part}: {type(unguarded(model)).__name__} is no scene's model; write it as a pi.objective.Own")
    if given is None and known:
        return list(known.values())
    name = named(model, given)
    if not is_one_of(name, known):
        called = f"called {given!r:.100}" if given is not None else "there"
        raise InputError(f"{part}: no body that deforms is {called}; known: {', '.join(map(repr, known)) or 'none'}")
    return [known[name]]


def named(model, given):
    """The name of a part that is given by itself; what is none of the model's as it is."""
    return next((name for name, part in model.parts.items() if part is given), given)


def deforming(model):
    """{name: one placed} of a scene's bodies that deform."""
    return {body.name: body for body in (*model.bodies, *(placed for placed in model.few if placed.deforms))}
