"""polyida: flexible multibody dynamics in the plane and differential-algebraic equations, one model through six integrators.

A scene of plates, rigid bodies, joints, forces and contacts, or equations of your own, become one residual r = M a + g + phi_q^T lam and one
constraint vector phi. `GeneralizedAlpha`, `EnergyMomentum`, `RadauIIA`, `IDA`, `NonsmoothAlpha` and `MoreauJean` solve these two. Runs have
gradients, estimates of their errors, studies and reports.
"""

from polyida import registry

_BESIDE_REGISTRY = {  # names by the module that defines them; parts and integrators are in the registry
    "errors": ("InputError", "LockingWarning", "StepFailure", "ReductionWarning"),
    "model": ("Model", "Needs"),
    "model.check": ("check_derivatives",),
    "model.row_laws": ("RowLaw",),
    "linear.saddle": ("StepMatrix",),
    "linear.lu": ("SingularSystem",),
    "jit.user_functions": ("compiled",),
    "body.body": ("Body",),
    "body.plate": ("Material",),
    "body.reduced": ("pod_modes", "missing_fields"),
    "force.force_element": ("ForceElement",),
    "force.controllers": ("Controller", "PID", "LinearController", "DCMotor", "Maxwell"),
    "joint.attachment": ("ground",),
    "joint.joint": ("Joint",),
    "joint.formula": ("cross", "dot"),
    "scene": ("Scene",),
    "run.solve": ("solve",),
    "run.resume": ("resume",),
    "event": ("Event", "Remove", "Impulse", "Impact", "Events"),
    "environment": ("threads",),
    "trajectory": ("Trajectory",),
    "results.motion": ("von_mises",),
    "io.load": ("load",),
    "study.conditions": ("condition_number",),
    "modal.modes": ("modes", "Modes"),
    "modal.buckling": ("buckling", "Buckling"),
    "modal.steady": ("steady", "Steady", "Campbell"),
    "modal.state_space": ("linearise", "StateSpace", "frequency_response", "FrequencyResponse"),
    "fitting": ("fit", "Fit"),
    "adjoint.gradient": ("gradient",),
    "adjoint.check": ("check_gradient",),
    "adjoint.run": ("Gradient",),
    "adjoint.error_bars": ("error_of", "ErrorBars"),
    "integrate.start": ("consistent_state",),
    "integrate.static": ("static",),
    "integrate.equilibrium_path": ("equilibrium_path", "EquilibriumPath"),
    "integrate.state": ("State", "Counts", "Integrator"),
}
_PLACES = registry.parts | registry.integrators | registry.places("polyida", _BESIDE_REGISTRY)
_MODULES = {
    name: name for name in ("mesh", "design", "profile", "sensor", "objective", "registry", "problems", "study", "show", "symbolic")
}
_MODULES["export"] = "show.vtu"

__version__ = "0.2.0"
__all__ = [*_PLACES, *_MODULES]
# importing polyida costs nothing that a script does not need
__getattr__, __dir__ = registry.attributes(__name__, _PLACES | {name: f"polyida.{module}" for name, module in _MODULES.items()})
