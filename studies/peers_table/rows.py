"""The rows of the table, the answer of a check, and the pendulum of most checks."""

from typing import NamedTuple

import numpy as np

MODELS = (
    "bodies in three dimensions",
    "polygonal elements",
    "plates or solids under large rotation",
    "rods or shells under large rotation",
    "flexible bodies reduced to modes",
    "revolute, prismatic, motor",
    "contact with friction",
    "a model from a Lagrangian or Kane's method of sympy",
    "a model of one's own",
)
INTEGRATORS = (
    "generalized-alpha on index 3",
    "matrix scaled by the step",
    "stabilised index 2 (GGL)",
    "BDF of variable order",
    "Radau IIA",
    "energy-momentum",
    "an integrator of one's own",
)
STUDYING = (
    "condition number of the iteration matrix",
    "work-precision studies",
    "counts of the work",
    "statics, modes, linearisation",
    "gradients by adjoints",
    "GPU, or one model on many machines",
    "many runs beside each other",
    "a run that was killed goes on",
)
ROWS = MODELS + INTEGRATORS + STUDYING
GRAVITY, T_END = 9.81, 0.5


class NotThere(Exception):
    """Looked for, and not found: why."""


def require(condition, text):
    """Raise AssertionError with this text if a check gives an unexpected result: neither present nor absent."""
    if not condition:
        raise AssertionError(text)


def only(names, wanted):
    """Raise NotThere with all names if none of them contains one of the wanted words."""
    names = sorted(names)
    if not any(word.lower() in name.lower() for name in names for word in wanted):
        raise NotThere(f"none of: {', '.join(names)}")
    return f"found among {', '.join(names)}"


def pendulum_end():
    """Position (2,) of a mass on a rod of 1 m at T_END, released level and at rest: the angle's own equation, by DOP853."""
    from scipy.integrate import solve_ivp

    run = solve_ivp(lambda t, y: [y[1], -GRAVITY * np.cos(y[0])], (0.0, T_END), [0.0, 0.0], "DOP853", rtol=1e-12, atol=1e-12)
    return np.array([np.cos(run.y[0, -1]), np.sin(run.y[0, -1])])


def swung(end, bound):
    """Description of a pendulum that ended here, (2,). Raises AssertionError if this is farther than the bound, m, from the exact position."""
    away = float(np.linalg.norm(np.asarray(end)[:2] - pendulum_end()))
    require(away < bound, f"the pendulum ends {away:.1e} m from where it should")
    return f"a pendulum ends {away:.1e} m from where it should"


class Peer(NamedTuple):
    """A column of the table."""

    checks: str  # the file of its checks
    imported: str
    distribution: str
    install: str  # a command


PEERS = {
    "polyida": Peer("ours", "polyida", "polyida", "pip install ."),
    "exudyn": Peer("exudyn_calls", "exudyn", "exudyn", "pip install '.[peers]'"),
    "Kratos": Peer(
        "kratos_calls",
        "KratosMultiphysics",
        "KratosMultiphysics",
        "pip install KratosMultiphysics KratosStructuralMechanicsApplication KratosLinearSolversApplication",
    ),
    "cardillo": Peer("cardillo_calls", "cardillo", "cardillo", "pip install git+https://github.com/cardilloproject/cardillo"),
    "SfePy": Peer("sfepy_calls", "sfepy", "sfepy", "pip install sfepy"),
    "solve_dae": Peer("solve_dae_calls", "solve_dae", "solve_dae", "pip install '.[peers]'"),
    "scikit-sundae": Peer("sundae_calls", "sksundae", "scikit-sundae", "pip install ."),
}
