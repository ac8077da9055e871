"""Ready problems with references: `get(name)` returns a Problem, `names()` lists them; users add theirs to `polyida.registry.problems`."""

from __future__ import annotations

import inspect
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from polyida import registry
from polyida.errors import InputError
from polyida.reprs import brief
from polyida.validation import is_one_of, named_keywords, reals

if TYPE_CHECKING:
    from polyida.trajectory import Trajectory

__path__.append(str(registry.study_folder() / "problems"))  # modules of problems of the literature, beside the studies that use them
__all__ = ["Problem", "get", "names"]

# What each problem compares, with units, and the source of its reference: one line, details after a semicolon.
COMPUTED = (
    "computed by DOP853 on the index-1 equations, rtol 1e-11; Radau IIA, rtol 1e-13, agrees to 3e-12 .. 5e-12 m, 5e-10 m/s, 6e-4 N "
    "(python studies/digits.py)"
)
TIP = '"tip" in m, its velocity in m/s, lam in N and N m, at t = 1 s; largest absolute error'
AT_POINT = '"{}" in m, its velocity in m/s, at t = {} s; largest absolute error'
MECHANISM = "computed by DOP853 on the index-1 equations, rtol 1e-8 to 1e-12; Radau IIA, rtol 1e-12, agrees to 4e-12 m, 3e-9 m/s (python studies/digits.py)"

ABOUT = {
    "pendulum": {
        "quantity": "q in m, v in m/s, lam in N, at t = 10 s; largest absolute error",
        "source": "IFToMM library of benchmark problems, A01; elliptic closed form, v and lam from the energy",
    },
    "car-axis": {
        "quantity": "q in m, v in m/s, lam in N/m, at t = 3 s; largest absolute error",
        "source": "IVP test set, car axis problem (PSIDE)",
    },
    "andrews": {
        "quantity": "q in rad, v in rad/s, a in rad/s2, lam in N, at t = 0.03 s; largest absolute error",
        "source": "computed by extrapolated midpoint steps on the index-1 equations in long double, to 1e-15 rad; DOP853 comes to "
        "2.6e-12 rad, the printed digits of the IVP test set, Andrews' squeezing mechanism (PSIDE), to 1.4e-9 rad",
    },
    "andrews-parts": {
        "quantity": "angles in rad, their rates in rad/s, at t = 0.03 s; largest absolute error",
        "source": "the digits of andrews, computed from its equations in minimal angles; those that are printed are 1.4e-9 rad away",
    },
    "wheelset": {
        "quantity": "places and contacts in m and rad, speeds in m/s and rad/s, multipliers of the contacts in N, at t = 10 s; largest absolute error",
        "source": "IVP test set, wheelset (DASSL, tolerance 1e-9); Radau IIA, 64 000 steps, agrees to 6.4e-9, 1.8e-7 and 1.2e-5 N",
    },
    "double-plate": {"quantity": TIP.replace(" and N m", ""), "source": COMPUTED},
    "double-plate-motors": {"quantity": TIP, "source": COMPUTED},
    "plate-chain": {"quantity": TIP.replace(" and N m", ""), "source": COMPUTED},
    "spin-up-beam": {
        "quantity": "steady extension of the tip in m; mean over t >= 16 s",
        "source": "Simo, Vu-Quoc, J. Appl. Mech. 53 (1986) 849; rho A w^2 L^3 / (3 EA) of the steadily turning bar",
    },
    "rigid-limit": {
        "quantity": "nodal q in m, v in m/s, joint forces lam in N, at t_end; largest absolute error",
        "source": "equation of two rigid bodies by DOP853; the flexible plates come near as 1 / E",
    },
    "rigid-pendulum": {"quantity": AT_POINT.format("tip", "1"), "source": "equation of two rigid bodies by DOP853, rtol 1e-13"},
    "n-four-bar": {
        "quantity": AT_POINT.format("B0", "0.7").replace("at t = 0.7 s", "at t_end"),
        "source": "IFToMM library of benchmark problems, A02; equation of its one angle by DOP853, rtol 1e-13",
    },
    "slider-crank": {"quantity": AT_POINT.format("slider", "0.4"), "source": MECHANISM},
    "four-bar": {"quantity": AT_POINT.format("pin", "0.5"), "source": MECHANISM},
    "two-link-arm": {"quantity": AT_POINT.format("tip", "0.5"), "source": MECHANISM},
    "peaucellier": {"quantity": AT_POINT.format("pen", "0.5"), "source": MECHANISM},
}


def __dir__():
    """Return the public names of the package, `__all__`, for `dir()`."""
    return __all__


@named_keywords
@dataclass(frozen=True)
class Problem:
    """A model with its initial state and a reference solution.

    Parameters
    ----------
    name : str
    model : Model
    q0, v0 : (n,) float or None, initial state at t = 0; None for the default of `pi.solve`
    t_end : float, s
    reference : dict, {"q": (n,), "v": (n,), "lam": (m,), ...} at t_end, in the model's signs and units; empty if unknown
    source : str, of the reference
    quantity : str, the compared values with norm and units
    known_to : dict, {part: accuracy of the reference} in its units; of a computed one the distance of two independent methods
    measures : dict, {part: function(run)} for parts that are not an array of the run's frames
    """

    name: str
    model: object
    q0: np.ndarray | None
    v0: np.ndarray | None
    t_end: float
    reference: dict = field(default_factory=dict)
    source: str = ""
    quantity: str = ""
    known_to: dict = field(default_factory=dict)
    measures: dict = field(default_factory=dict)

    __repr__ = brief

    def errors(self, **values: ArrayLike) -> dict[str, float]:
        """Compare values at the end of a run with those of the reference.

        Parameters
        ----------
        **values : array_like, of the shape of the reference of the same name

        Returns
        -------
        dict
            {name: largest absolute deviation}, in the reference's units.

        Raises
        ------
        InputError
            For a name that is not in the reference, and for another shape.
        """
        return {name: self._error(name, value) for name, value in values.items()}

    def compare(self, run: Trajectory) -> dict[str, float]:
        """`errors` of the last frame of a run, for all parts of the reference. Raises InputError if the run does not end at t_end."""
        if not len(getattr(run, "t", ())):
            raise InputError(f"problem {self.name!r}: {type(run).__name__} is no run with frames; give what solve returns")
        if abs(run.t[-1] - self.t_end) > 1e-9 * self.t_end:
            raise InputError(f"problem {self.name!r}: the run ends at t = {run.t[-1]:g} s, the reference is known at t = {self.t_end:g} s")
        return self.errors(
            **{name: self.measures[name](run) if name in self.measures else getattr(run, name)[-1] for name in self.reference}
        )

    def _error(self, name, value):
        """Largest absolute deviation of one value from the reference. Raises InputError for an unknown name or another shape."""
        if name not in self.reference:
            known = ", ".join(self.reference) or "nothing for these options"
            raise InputError(f"problem {self.name!r}: {name!r} is not in the reference, which knows {known}")
        shape = np.shape(self.reference[name])
        value = reals(value)
        if value is None:
            raise InputError(f"problem {self.name!r}: {name} must be numbers of shape {shape}")
        if value.shape != shape:
            raise InputError(f"problem {self.name!r}: {name} has shape {value.shape}, the reference has {shape}")
        return float(np.abs(value - self.reference[name]).max())


def names() -> tuple[str, ...]:
    """List the names of all problems.

    Returns
    -------
    tuple of str
        Keys of `polyida.registry.problems`.
    """
    return tuple(registry.problems)


def get(name: str, **options: object) -> Problem:
    """Make the problem of a name; options are arguments of its function.

    Parameters
    ----------
    name : str, one of `names()`
    **options
        Options of the problem, such as `cells`.

    Returns
    -------
    Problem
        With its model built.

    Raises
    ------
    InputError
        For an unknown name or option, and for a wrong value of an option; the message lists the options.
    """
    if not is_one_of(name, registry.problems):
        raise InputError(f"problem {name!r} is unknown; there are {', '.join(registry.problems)}")
    make = registry.find(registry.problems, name)
    known = tuple(inspect.signature(make).parameters)
    takes = f"its options are {', '.join(known)}" if known else "it has no options"
    for option in options:
        if option not in known:
            raise InputError(f"problem {name!r} has no option {option!r}; {takes}")
    try:
        return make(**options)
    except InputError as error:
        raise InputError(f"problem {name!r}: {error}; {takes}") from None


def point_measures(name):
    """The `measures` of a problem that compares the place, m, and the velocity, m/s, of a named point at the end of a run."""
    return {"point": lambda run: run.position(name)[-1], "velocity": lambda run: run.model.displacement(name, run.v[-1])}
