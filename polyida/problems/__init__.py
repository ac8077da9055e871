"""Ready problems with published references: `get(name)` gives a Problem, `names()` what there is."""

from dataclasses import dataclass, field
from importlib import import_module

import numpy as np

from polyida.errors import InputError
from polyida.given import is_one_of


@dataclass(frozen=True)
class Problem:
    """A model with its initial state and what is known of its solution.

    model: a Model. q0, v0 (n,): initial state at t = 0, or None where the model's own is meant. t_end: s.
    reference: {"q": (n,), "v": (n,), "lam": (m,), ...} at t_end, as far as known, in the model's signs and units.
    source: where the reference comes from. quantity: what is compared, and in which measure.
    """

    name: str
    model: object
    q0: np.ndarray | None
    v0: np.ndarray | None
    t_end: float
    reference: dict = field(default_factory=dict)
    source: str = ""
    quantity: str = ""

    def errors(self, **found):
        """{name: largest absolute deviation from the reference}, for every given array that the reference knows."""
        return {name: float(np.abs(np.asarray(value) - self.reference[name]).max())
                for name, value in found.items() if name in self.reference}


# name -> "module:function"; the function returns a Problem and may take options
MAKERS = {
    "pendulum": "polyida.problems.pendulum:problem",
    "car-axis": "polyida.problems.car_axis:problem",
    "andrews": "polyida.problems.andrews:problem",
    "double-plate": "polyida.problems.plates:double_plate_problem",
    "double-plate-motors": "polyida.problems.plates:double_plate_motors_problem",
    "plate-chain": "polyida.problems.plates:plate_chain_problem",
    "spin-up-beam": "polyida.problems.spin_up_beam:problem",
    "rigid-limit": "polyida.problems.rigid_limit:problem",
}


def names():
    """Names of all problems."""
    return tuple(MAKERS)


def get(name, **options):
    """The Problem of this name, made with `options`; InputError where there is none of that name."""
    if not is_one_of(name, MAKERS):
        raise InputError(f"problem {name!r} is unknown; there are {', '.join(MAKERS)}")
    module, function = MAKERS[name].split(":")
    return getattr(import_module(module), function)(**options)
