"""Tables of models for the backward sweep of generalized-alpha: the C function that solves the adjoint of one step."""

from polyida.adjoint.tables.python import PythonAdjoint
from polyida.system.python import small_own, small_table

__all__ = ["PythonAdjoint", "adjoint_table"]


def adjoint_table(model, settings, h, counts):
    """The table of a model for steps of h. counts: what counts its work."""
    if settings.form == "index3" and settings.linear != "kkt":
        if model.compiled:
            from polyida.adjoint.tables.scene import SceneAdjoint

            return SceneAdjoint(model, settings, h, counts)
        if small_own(model):
            from polyida.adjoint.tables.dense import DenseAdjoint

            return DenseAdjoint(small_table(model), settings, h, counts)
    return PythonAdjoint(model, settings, h, counts)
