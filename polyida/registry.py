"""Dictionaries of classes and functions by name, to which users add their own.

A value is the class or function itself, or "module:name" or "module" of what is imported on first use. parts, integrators: classes, by their names
in the files of runs; a class of joints or forces is added when it is defined. problems: functions that return a `polyida.problems.Problem`;
their arguments are its options. studies: a `Study` each.
"""

import sys
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from polyida.errors import InputError

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
    "RollingDisc": "polyida.joint.joints:RollingDisc",
    "Skate": "polyida.joint.joints:Skate",
    "Contact": "polyida.joint.contact:Contact",
    "Clearance": "polyida.joint.contact:Clearance",
    "SpringDamper": "polyida.force.springs:SpringDamper",
    "TorsionSpring": "polyida.force.springs:TorsionSpring",
    "Torque": "polyida.force.loads:Torque",
    "Force": "polyida.force.loads:Force",
    "PenaltyContact": "polyida.force.springs:PenaltyContact",
}
integrators: dict[str, Any] = {
    "GeneralizedAlpha": "polyida.integrate.alpha.generalized_alpha:GeneralizedAlpha",
    "EnergyMomentum": "polyida.integrate.energy.energy_momentum:EnergyMomentum",
    "IDA": "polyida.integrate.ida.integrator:IDA",
    "RadauIIA": "polyida.integrate.radau.radau_iia:RadauIIA",
    "NonsmoothAlpha": "polyida.integrate.nonsmooth.time_stepping:NonsmoothAlpha",
    "MoreauJean": "polyida.integrate.nonsmooth.time_stepping:MoreauJean",
}
problems: dict[str, Any] = {
    "pendulum": "polyida.problems.equations:pendulum_problem",
    "car-axis": "polyida.problems.equations:car_axis_problem",
    "andrews": "polyida.problems.andrews:problem",
    "andrews-parts": "polyida.problems.andrews:parts_problem",
    "wheelset": "polyida.problems.wheelset:problem",
    "double-plate": "polyida.problems.plates:double_plate_problem",
    "double-plate-motors": "polyida.problems.plates:double_plate_motors_problem",
    "plate-chain": "polyida.problems.plates:plate_chain_problem",
    "spin-up-beam": "polyida.problems.literature:spin_up_beam_problem",
    "rigid-limit": "polyida.problems.plates:rigid_limit_problem",
    "rigid-pendulum": "polyida.problems.plates:rigid_pendulum_problem",
    "n-four-bar": "polyida.problems.literature:n_four_bar_problem",
    "slider-crank": "polyida.problems.mechanisms:slider_crank_problem",
    "four-bar": "polyida.problems.mechanisms:four_bar_problem",
    "two-link-arm": "polyida.problems.mechanisms:two_link_arm_problem",
    "peaucellier": "polyida.problems.mechanisms:peaucellier_problem",
}
views: dict[str, Any] = {  # attributes of a run that draw it
    "plot": "polyida.show.plots:RunPlots",
    "drawing": "polyida.show.plots:drawing",
    "animate": "polyida.show.animations:Animation",
}
studies: dict[str, Any] = {}  # users' own; those of the repository are the scripts of ./studies
__all__ = ["find", "integrators", "name_of", "parts", "problems", "studies"]


def __dir__():
    """Return the public names of the module, `__all__`, for `dir()`."""
    return __all__


_BUILT_IN = frozenset([*parts.values(), *integrators.values()])


def _place_of(kind):
    """Module and name of a class, "module:Name", as the registry stores it."""
    return f"{kind.__module__}:{kind.__qualname__}"


def is_built_in(kind: type) -> bool:
    """True if a class of parts or integrators is one of polyida's own."""
    return _place_of(kind) in _BUILT_IN


def name_of(kind: type) -> str:
    """Return the name of a class in files.

    Parameters
    ----------
    kind : type
        Of a part or an integrator.

    Returns
    -------
    str
        Its key in `parts` or `integrators`, or `module.name` if it has none.
    """
    if not isinstance(kind, type):
        raise InputError(f"name_of: kind = {kind!r:.100} must be a class")
    known = {key: name for book in (parts, integrators) for name, key in book.items()}
    return known.get(kind) or known.get(_place_of(kind)) or f"{kind.__module__}.{kind.__qualname__}"


def find(book: dict[str, Any], name: str) -> Any:
    """Look up a name in a dictionary of this module and import its value if necessary.

    Parameters
    ----------
    book : dict
    name : str

    Returns
    -------
    object or None
        The value; None for an unknown name.
    """
    if not isinstance(book, dict):
        raise InputError(f"find: book = {book!r:.100} must be a dictionary of this module")
    known = book.get(name) if isinstance(name, str) else None
    if isinstance(known, str):
        module, _, attribute = known.partition(":")
        known = import_module(module)
        known = getattr(known, attribute) if attribute else known
    return known


def study_folder() -> Path:
    """The folder of the study scripts: within an installed package, or beside the package in a clone."""
    package = Path(__file__).resolve().parent
    installed = package / "studies"
    return installed if installed.is_dir() else package.parent / "studies"


def places(package: str, modules: Mapping[str, Iterable[str]]) -> dict[str, Any]:
    """{name: "package.module:name"} of names that modules of a package define, {module: names}."""
    return {name: f"{package}.{module}:{name}" for module, names in modules.items() for name in names}


def attributes(package: str, book: dict[str, Any]) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """`__getattr__` and `__dir__` of a package whose names are those of a dictionary: they are imported when they are first used."""

    def attribute(name):
        """The value of a name, which becomes an attribute of the package. Raises AttributeError for others."""
        if name not in book:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = find(book, name)
        setattr(sys.modules[package], name, value)
        return value

    return attribute, lambda: sorted(book)
