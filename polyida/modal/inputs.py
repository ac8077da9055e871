"""What moves a model from outside: loads and motors by the names of their profiles, or directions of force of one's own."""

from polyida.integrate.directions import Direction, direction, known_inputs


def inputs_of(part, model, state, given):
    """A list of Direction with labels, of what a user gives: None (all profiles), one, a list or a dictionary {label: one}.

    Raises InputError in the name of `part`.
    """
    if given is None:
        given = [name for name in known_inputs(model) if name]
    if not isinstance(given, (list, dict)):
        given = [given]
    named = given.items() if isinstance(given, dict) else ((None, one) for one in given)
    return [_labelled(direction(part, model, state, one), label, k) for k, (label, one) in enumerate(named)]


def _labelled(pushed, label, number):
    return Direction(str(label or pushed.label or f"input {number}"), pushed.force, pushed.row)
