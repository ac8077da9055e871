"""The levels at which a mechanism of plates can be computed, and the Problem that each makes.

Digits of the mechanisms' named points at their ends, at every level, on the default meshes, by two methods of different form.

`python studies/digits.py slider-crank four-bar two-link-arm peaucellier` makes and prints them: DOP853 on the index-1 equations, rtol 1e-8
or 1e-9, 1e-12 of rigid ones, put back on the constraints 31 times. They are known as well as Radau IIA on the stabilised form, rtol 1e-12,
agrees. Space is not converged: these are digits of the semi-discrete equations on that mesh, or in those modes.
"""

import numpy as np

from polyida.body.reduced import Reduced
from polyida.body.rigid_body import Rigid
from polyida.errors import InputError
from polyida.problems import Problem
from polyida.problems.about import ABOUT
from polyida.validation import is_one_of

DIGITS = {  # name: level: part: (digits, how well they are known)
    "slider-crank": {
        "full": {"point": ([0.1516796343327, 0.0], 3.3e-12), "velocity": ([1.494136230098, 0.0], 1.1e-09)},
        "reduced": {"point": ([0.1516681287828, 0.0], 2.9e-12), "velocity": ([1.473734619611, 0.0], 8.1e-10)},
        "rigid": {"point": ([0.1609723356128, 0.0], 1e-13), "velocity": ([3.530063026946, 0.0], 1.9e-12)},
    },
    "four-bar": {
        "full": {"point": ([0.3012871805664, 0.2500204598015], 1.4e-13), "velocity": ([-0.01886140987872, -1.654431691634e-05], 8.6e-11)},
        "reduced": {"point": ([0.3012874901226, 0.2500211468107], 1.4e-13), "velocity": ([-0.0167953711629, -0.001435871302817], 5.8e-10)},
        "rigid": {"point": ([0.3016007650437, 0.24999487505], 1e-13), "velocity": ([0.0, 0.0], 1e-13)},
    },
    "two-link-arm": {
        "full": {"point": ([0.4393735295091, 0.267900295898], 8.3e-13), "velocity": ([-0.009720147784984, 1.732987914593], 3.3e-10)},
        "reduced": {"point": ([0.4393721180096, 0.2679038027252], 1.1e-12), "velocity": ([-0.009905561857127, 1.732883595664], 2.3e-09)},
        "rigid": {"point": ([0.4330127018922, 0.25], 1e-13), "velocity": ([0.0, 0.0], 1e-13)},
    },
    "peaucellier": {
        "full": {"point": ([0.3999806027084, 0.2297359205277], 2e-13), "velocity": ([0.001637343455889, 0.1049229539454], 5e-10)},
        "reduced": {"point": ([0.3999807137328, 0.2297404178252], 1.7e-13), "velocity": ([0.001327334341297, 0.1047347082782], 4.5e-10)},
        "rigid": {"point": ([0.4, 0.2309401076758], 1e-13), "velocity": ([0.0, 0.0], 1e-13)},
    },
}


def digits_of(name, level):
    """(reference, known_to) of a mechanism at a level."""
    found = DIGITS[name][level]
    return {part: np.array(value) for part, (value, _) in found.items()}, {part: known for part, (_, known) in found.items()}


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
        reference, known_to = digits_of(name, level)
    else:
        about = about | {"source": "no reference for these options; measure against a refined run"}
    model, looked = scene.build(), measures(point)
    return Problem(name=name, model=model, q0=None, v0=None, t_end=t_end, reference=reference, known_to=known_to, measures=looked, **about)


def measures(name):
    """What the problems compare: place, m, and velocity, m/s, of a named point at the end of a run."""
    return {"point": lambda run: run.position(name)[-1], "velocity": lambda run: run.model.displacement(name, run.v[-1])}
