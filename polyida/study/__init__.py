"""`pi.study`: studies of models, scenes and problems with every integrator; each returns a `Result` with rows, figures, plots and a report.

`work_precision` and `step_sizes` measure errors against a reference on which two families of methods agree, `conditioning` iteration
matrices, `energy` and `drift` conserved quantities; `sweep` runs a user's function over cases. A `Study` is a script with tasks.
"""

from importlib import import_module

_MODULES = {
    "work_precision": "precision",
    "step_sizes": "precision",
    "conditioning": "conditions",
    "energy": "invariants",
    "drift": "invariants",
    "sweep": "sweeps",
    "Sweep": "sweeps",
    "Isolated": "executors",
    "Result": "result",
    "Study": "tasks",
}
__all__ = list(_MODULES)


def __getattr__(name):
    """Import a name when it is first used."""
    if name not in _MODULES:
        raise AttributeError(f"module 'polyida.study' has no attribute {name!r}")
    return getattr(import_module(f"polyida.study.{_MODULES[name]}"), name)


def __dir__():
    return sorted(__all__)
