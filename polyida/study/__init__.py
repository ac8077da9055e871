"""`pi.study`: studies of models, scenes and problems with every integrator; each returns a `Result` with rows, figures, plots and a report.

`work_precision` and `step_sizes` measure errors against a reference on which two methods agree, `conditioning` iteration
matrices, `energy` and `drift` conserved quantities; `sweep` runs a user's function over cases. A `Study` is a script with tasks.
"""

from polyida import registry

_PLACES = registry.places(
    __name__,
    {
        "precision": ("work_precision", "step_sizes"),
        "conditions": ("conditioning",),
        "invariants": ("energy", "drift"),
        "sweeps": ("sweep", "Sweep"),
        "executors": ("Isolated",),
        "result": ("Result",),
        "tasks": ("Study",),
    },
)
__all__ = list(_PLACES)
__getattr__, __dir__ = registry.attributes(__name__, _PLACES)
