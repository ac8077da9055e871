"""Studies as a library: models, scenes and problems in every integrator, as rows, figures, plots and reports.

`work_precision` and `step_sizes` measure errors against a reference that two families of methods agree on, `conditioning` the iteration
matrices, `energy` and `drift` what is kept over a run, `sweep` a function of one's own over cases. Each gives a `Result`.
"""

from importlib import import_module

_PLACES = {
    "work_precision": "precision",
    "step_sizes": "precision",
    "conditioning": "conditions",
    "energy": "kept",
    "drift": "kept",
    "sweep": "sweeps",
    "Sweep": "sweeps",
    "Isolated": "isolation",
    "Result": "result",
    "Study": "harness",
}
__all__ = list(_PLACES)


def __getattr__(name):
    """Names are imported when they are first used."""
    if name not in _PLACES:
        raise AttributeError(f"module 'polyida.study' has no attribute {name!r}")
    return getattr(import_module(f"polyida.study.{_PLACES[name]}"), name)


def __dir__():
    return sorted(__all__)
