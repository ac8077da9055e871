"""The motions of the work-precision study and their references.

A reference consists of published digits, or of the values on which two families of methods agree: Radau IIA and explicit runs on the
index-1 equations; for the stiff spin-up beam Radau IIA and the energy-momentum method.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from polyida import problems, profile
from polyida.force.loads import PointLoad
from polyida.problems import plates
from polyida.study.ivp import InitialValueProblem, initial_value_problem
from polyida.study.precision import work_precision
from polyida.study.refinement import BY_ENERGY_MOMENTUM, BY_EXPLICIT, RADAU_RTOL, make_reference, user_reference
from work_precision.integrators import integrator

FINEST = len(RADAU_RTOL) - 1  # the finest level of refinement
SHOWN = {"q": 1e-10, "v": 1e-6, "lam": 1e-4}  # the smallest errors that the study is to show of plates: a tenth of them is to be known
COARSE = {"q": 1e-6, "v": 1e-2, "lam": 1.0}  # and of the blow in the short selection


@dataclass(frozen=True)
class Case:
    """A motion and its reference, in the form of polyida.study.

    sizes: typical (q, v) for absolute tolerances. newton: tolerance of generalized-alpha's Newton iteration, if the default would dominate
    the measured errors.
    """

    ivp: InitialValueProblem
    reference: dict
    sizes: tuple = (1e-2, 10.0)
    newton: float | None = None


def published(name, sizes, newton=1e-9):
    """The Case of a problem with digits of q, v and lam."""
    motion = initial_value_problem("work_precision", name, None)
    return Case(motion, user_reference("work_precision", motion, motion.published), sizes, newton)


def by_two(name, model, t_end, other=BY_EXPLICIT, sizes=(1e-2, 10.0), first=FINEST, shown=SHOWN):
    """The Case of a model whose reference is the agreement of Radau IIA and another family, from a level of refinement on."""
    motion = InitialValueProblem(name, model, t_end)
    reference = make_reference(motion, lambda values: shown, others=(other,), first=first)
    if "q" not in reference:
        raise RuntimeError(f"reference of {name}: {'; '.join(reference['failed'])}")
    return Case(motion, reference, sizes)


def sudden_blow(cells, t_end, duration=0.005, force=40.0):
    """The double plate without gravity; a slowly growing force lifts its tip, and near the end a pulse of 5 ms acts on it."""
    scene = plates.double_plate(cells)
    scene.gravity = (0.0, 0.0)
    tip, at, bump = scene.parts["tip"].at, 0.95 * t_end, np.polynomial.Polynomial([0, 0, 0, 64, -192, 192, -64])

    def blow(t):
        s = (t - at) / duration
        return float(bump(s)) if 0 < s < 1 else 0.0

    scene.add(PointLoad(tip, (0.0, 0.5), profile.ramp(0.0, 1.0, duration=t_end), name="draw"))
    scene.add(PointLoad(tip, (0.0, force), profile.from_function(blow, kinks=(at, at + duration)), name="blow"))
    return scene.build()


def damped_ramp():
    """The slightly damped double plate of 8 cells without gravity; the force on its tip grows smoothly within 20 ms, the period of the
    plates, so that steps that resolve it also resolve them.
    """
    rubber = plates.RUBBER
    scene = plates.double_plate(8, material=plates.Material(E=rubber.E, nu=rubber.nu, rho=rubber.rho, viscosity=1e-5))
    scene.gravity = (0.0, 0.0)
    scene.add(PointLoad(scene.parts["tip"].at, (0.0, 200.0), profile.ramp(0.0, 1.0, duration=0.02), name="draw"))
    return scene.build()


@lru_cache(maxsize=16)
def case(name, quick):
    """The Case of a name; quick cases have coarser meshes and shorter times."""
    cells, time = (8, 0.1) if quick else (12, 0.25)
    blown, of_blow = (8, 0.5) if quick else (20, 2.0)
    makers = {
        "pendulum": lambda: published("pendulum", (1.0, 1.0)),
        "car-axis": lambda: published("car-axis", (1.0, 1.0)),
        "andrews": lambda: published("andrews", (0.1, 100.0)),
        "damped-ramp": lambda: by_two(name, damped_ramp(), 0.02),
        "double-plate": lambda: by_two(name, plates.double_plate(cells).build(), time),
        "double-plate-motors": lambda: by_two(name, plates.double_plate_motors(cells).build(), time),
        "plate-chain": lambda: by_two(name, plates.plate_chain(3, cells).build(), time),
        "rigid-limit": lambda: published("rigid-limit", (1e-2, 10.0), None),
        "spin-up-beam": lambda: by_two(name, problems.get(name).model, 20.0, BY_ENERGY_MOMENTUM, (1e-1, 1.0)),
        "sudden-blow": lambda: by_two(
            name, sudden_blow(blown, of_blow), of_blow, **({"first": 0, "shown": COARSE} if quick else {"first": 1})
        ),
    }
    return makers[name]()


def measure(name, member, x, quick):
    """Errors at the end, CPU seconds and counts of one run; a failed run has its message as outcome and no errors."""
    selected = case(name, quick)
    motion, method = selected.ivp, integrator(member, x, selected.sizes, selected.ivp.t_end / 20, selected.newton)
    start = {"q0": motion.q0, "v0": motion.v0}
    (row,) = work_precision(
        motion.model, motion.t_end, **start, integrators={member: method}, reference=selected.reference, progress=False
    ).rows
    reference_columns = {
        "outcome": "done" if row["status"] == "done" else row["message"],
        "reference": "; ".join(selected.reference["made_by"]),
        "known": selected.reference["known_to"],
    }
    return {key: value for key, value in row.items() if key != "integrator" and value == value} | reference_columns
