"""What can be found by name: a dictionary for each sort of thing, to which users add what is theirs.

A value is a class, or "module:name" of one that is imported when it is asked for. parts: plates, joints, masses and loads, by the name
that a file calls them; a class of joints enters when it is defined. integrators: by the name that a file calls them. A file holds
names and numbers; what makes objects of them is looked up here.
"""

from importlib import import_module

parts = {
    "Plate": "polyida.body.plate:Plate",
    "PointMass": "polyida.body.point_mass:PointMass",
    "PointLoad": "polyida.body.loads:PointLoad",
    "EdgeTraction": "polyida.body.loads:EdgeTraction",
    "Revolute": "polyida.joint.revolute:Revolute",
    "AngleMotor": "polyida.joint.angle_motor:AngleMotor",
    "Clamp": "polyida.joint.clamp:Clamp",
}
integrators = {
    "GeneralizedAlpha": "polyida.integrate.alpha.generalized_alpha:GeneralizedAlpha",
    "EnergyMomentum": "polyida.integrate.energy.energy_momentum:EnergyMomentum",
    "IDA": "polyida.integrate.ida.integrator:IDA",
}


def name_of(kind):
    """What a file calls a class: its name where it is polyida's, with its module before it where it is a user's."""
    return kind.__name__ if kind.__module__.startswith("polyida.") else f"{kind.__module__}.{kind.__qualname__}"


def find(book, name):
    """What a dictionary has under a name, imported where it must be, or None."""
    known = book.get(name)
    if isinstance(known, str):
        module, _, attribute = known.partition(":")
        known = getattr(import_module(module), attribute)
    return known
