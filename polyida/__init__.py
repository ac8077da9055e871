"""polyida: flexible multibody dynamics with polygonal elements, one model through three kinds of integrator."""

from importlib import import_module

_PLACES = {
    "InputError": "errors",
    "LockingWarning": "errors",
    "StepFailure": "errors",
    "ReductionWarning": "errors",
    "Model": "model",
    "Needs": "model",
    "StepMatrix": "linear.saddle",
    "SingularSystem": "linear.lu",
    "compiled": "jit.user_functions",
    "check_derivatives": "model.check",
    "Material": "body.plate",
    "Plate": "body.plate",
    "PointMass": "body.rigid_body",
    "Body": "body.body",
    "RigidBody": "body.rigid_body",
    "Rigid": "body.rigid_body",
    "Reduced": "body.reduced",
    "pod_modes": "body.reduced",
    "missing_fields": "body.reduced",
    "ForceElement": "force.force_element",
    "PointLoad": "force.loads",
    "EdgeTraction": "force.loads",
    "SpringDamper": "force.springs",
    "TorsionSpring": "force.springs",
    "Controller": "force.controllers",
    "PID": "force.controllers",
    "LinearController": "force.controllers",
    "DCMotor": "force.controllers",
    "Maxwell": "force.controllers",
    "Torque": "force.loads",
    "Force": "force.loads",
    "PenaltyContact": "force.springs",
    "Revolute": "joint.joints",
    "AngleMotor": "joint.joints",
    "Clamp": "joint.joints",
    "Prismatic": "joint.joints",
    "Slot": "joint.joints",
    "Distance": "joint.joints",
    "Weld": "joint.joints",
    "PrescribedPosition": "joint.joints",
    "RollingDisc": "joint.joints",
    "Skate": "joint.joints",
    "Contact": "joint.contact",
    "Clearance": "joint.contact",
    "NonsmoothAlpha": "integrate.nonsmooth.time_stepping",
    "MoreauJean": "integrate.nonsmooth.time_stepping",
    "RowLaw": "model.row_laws",
    "ground": "joint.attachment",
    "Joint": "joint.joint",
    "cross": "joint.formula",
    "dot": "joint.formula",
    "Scene": "scene",
    "solve": "run.solve",
    "Event": "event",
    "Remove": "event",
    "Impulse": "event",
    "Impact": "event",
    "Events": "event",
    "threads": "environment",
    "resume": "run.resume",
    "Trajectory": "trajectory",
    "von_mises": "results.motion",
    "load": "io.load",
    "consistent_state": "integrate.start",
    "condition_number": "study.conditions",
    "static": "integrate.static",
    "equilibrium_path": "integrate.equilibrium_path",
    "EquilibriumPath": "integrate.equilibrium_path",
    "modes": "modal.modes",
    "Modes": "modal.modes",
    "linearise": "modal.state_space",
    "StateSpace": "modal.state_space",
    "frequency_response": "modal.state_space",
    "FrequencyResponse": "modal.state_space",
    "gradient": "adjoint.gradient",
    "check_gradient": "adjoint.check",
    "Gradient": "adjoint.run",
    "error_of": "adjoint.error_bars",
    "ErrorBars": "adjoint.error_bars",
    "State": "integrate.state",
    "Counts": "integrate.state",
    "Integrator": "integrate.state",
    "GeneralizedAlpha": "integrate.alpha.generalized_alpha",
    "EnergyMomentum": "integrate.energy.energy_momentum",
    "IDA": "integrate.ida.integrator",
    "RadauIIA": "integrate.radau.radau_iia",
}
_MODULES = {
    "mesh": "mesh",
    "design": "design",
    "profile": "profile",
    "sensor": "sensor",
    "objective": "objective",
    "registry": "registry",
    "problems": "problems",
    "export": "show.vtu",
    "study": "study",
    "show": "show",
}

__version__ = "0.1.0"
__all__ = [*_PLACES, *_MODULES]


def __getattr__(name):
    """Names are imported when they are first used: importing polyida costs nothing that a script does not need."""
    if name in _PLACES:
        value = getattr(import_module(f"polyida.{_PLACES[name]}"), name)
    elif name in _MODULES:
        value = import_module(f"polyida.{_MODULES[name]}")
    else:
        raise AttributeError(f"module 'polyida' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__():
    return sorted(__all__)
