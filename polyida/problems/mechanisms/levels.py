"""The levels at which a mechanism of plates can be computed, and the Problem that each makes."""

from polyida.body.reduced import Reduced
from polyida.body.rigid_body import Rigid
from polyida.errors import InputError
from polyida.given import is_one_of
from polyida.problems import Problem
from polyida.problems.about import ABOUT
from polyida.problems.mechanisms import digits

LEVELS = ("full", "reduced", "rigid")


def body_at(level, modes=5):
    """The function that makes of a plate the body of a level: "full" the plate itself, "reduced" one of so many modes, "rigid" a rigid one.

    Raises InputError for another level.
    """
    if not is_one_of(level, LEVELS):
        raise InputError(f"level {level!r} is unknown; known: {', '.join(LEVELS)}")
    return {"full": lambda plate: plate, "reduced": lambda plate: Reduced(plate, modes=modes), "rigid": Rigid}[level]


def problem_of(name, scene, t_end, point, level, default):
    """A Problem that looks at the named point of a scene, from rest; default: whether this is the scene that its digits are of."""
    about, reference, known_to = ABOUT[name], {}, {}
    if default:
        reference, known_to = digits.of(name, level)
    else:
        about = about | {"source": "no reference for these options; measure against a refined run"}
    model, looked = scene.build(), measures(point)
    return Problem(name=name, model=model, q0=None, v0=None, t_end=t_end, reference=reference, known_to=known_to, measures=looked, **about)


def measures(name):
    """What the problems compare: place, m, and velocity, m/s, of a named point at the end of a run."""
    return {"point": lambda run: run.position(name)[-1], "velocity": lambda run: run.model.displacement(name, run.v[-1])}
