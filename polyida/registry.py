"""What can be found by name: a dictionary for each sort of thing, to which users add what is theirs.

A value is the thing itself, or "module:name" of one that is imported when it is asked for. parts, integrators: classes, by the name that
a file of a run calls them; a class of joints or forces enters when it is defined. Files hold names and numbers; what makes objects of
them is looked up here. problems: functions that give a `polyida.problems.Problem`, their arguments its options. studies: a `Study` each.
"""

from importlib import import_module
from typing import Any

parts: dict[str, Any] = {
    "Plate": "polyida.body.plate:Plate",
    "RigidBody": "polyida.body.rigid_body:RigidBody",
    "Rigid": "polyida.body.rigid_body:Rigid",
    "Reduced": "polyida.body.reduced:Reduced",
    "PointMass": "polyida.body.rigid_body:PointMass",
    "PointLoad": "polyida.force.loads:PointLoad",
    "EdgeTraction": "polyida.force.loads:EdgeTraction",
    "Revolute": "polyida.joint.joints:Revolute",
    "AngleMotor": "polyida.joint.joints:AngleMotor",
    "Clamp": "polyida.joint.joints:Clamp",
    "Prismatic": "polyida.joint.joints:Prismatic",
    "Slot": "polyida.joint.joints:Slot",
    "Distance": "polyida.joint.joints:Distance",
    "Weld": "polyida.joint.joints:Weld",
    "PrescribedPosition": "polyida.joint.joints:PrescribedPosition",
    "SpringDamper": "polyida.force.springs:SpringDamper",
    "TorsionSpring": "polyida.force.springs:TorsionSpring",
    "Torque": "polyida.force.loads:Torque",
    "Force": "polyida.force.loads:Force",
    "Contact": "polyida.force.springs:Contact",
}
integrators: dict[str, Any] = {
    "GeneralizedAlpha": "polyida.integrate.alpha.generalized_alpha:GeneralizedAlpha",
    "EnergyMomentum": "polyida.integrate.energy.energy_momentum:EnergyMomentum",
    "IDA": "polyida.integrate.ida.integrator:IDA",
    "RadauIIA": "polyida.integrate.radau.radau_iia:RadauIIA",
}
problems: dict[str, Any] = {
    "pendulum": "polyida.problems.pendulum:problem",
    "car-axis": "polyida.problems.car_axis:problem",
    "andrews": "polyida.problems.andrews:problem",
    "andrews-parts": "polyida.problems.andrews:parts_problem",
    "double-plate": "polyida.problems.plates:double_plate_problem",
    "double-plate-motors": "polyida.problems.plates:double_plate_motors_problem",
    "plate-chain": "polyida.problems.plates:plate_chain_problem",
    "spin-up-beam": "polyida.problems.spin_up_beam:problem",
    "rigid-limit": "polyida.problems.plates:rigid_limit_problem",
    "rigid-pendulum": "polyida.problems.plates:rigid_pendulum_problem",
    "n-four-bar": "polyida.problems.n_four_bar:problem",
    "slider-crank": "polyida.problems.mechanisms:slider_crank_problem",
    "four-bar": "polyida.problems.mechanisms:four_bar_problem",
    "two-link-arm": "polyida.problems.mechanisms:two_link_arm_problem",
    "peaucellier": "polyida.problems.mechanisms:peaucellier_problem",
}
views: dict[str, Any] = {  # of a run, above it: what its attributes of these names give
    "plot": "polyida.show.plots:RunPlots",
    "drawing": "polyida.show.plots:drawing",
}
studies: dict[str, Any] = {}  # those of the repository are the scripts of ./studies


_BUILT_IN = frozenset([*parts.values(), *integrators.values()])


def _place_of(kind):
    return f"{kind.__module__}:{kind.__qualname__}"


def is_built_in(kind: type) -> bool:
    """True if a class of parts or integrators is one of polyida's own."""
    return _place_of(kind) in _BUILT_IN


def name_of(kind: type) -> str:
    """The name of a class in files: its key in `parts` or `integrators`, or `module.name` if it has none there."""
    known = {key: name for book in (parts, integrators) for name, key in book.items()}
    return known.get(kind) or known.get(_place_of(kind)) or f"{kind.__module__}.{kind.__qualname__}"


def find(book, name):
    """What a dictionary has under a name, imported where it must be, or None."""
    known = book.get(name)
    if isinstance(known, str):
        module, _, attribute = known.partition(":")
        known = getattr(import_module(module), attribute)
    return known
