"""Design of what moves: variables, limits, the method of moving asymptotes, and solid designs.

`minimise` searches densities of the cells of plates, and sizes, for the least value of an objective within limits; `Problem` gives values
and slopes to any other optimiser. `ramp`, `simp` and `mass` map densities to the factors that `model.with_factors(plate=(stiffness, mass))`
takes, `project` drives them to 0 and 1, `threshold` returns the solid mesh, `solid` runs it again.
"""

from polyida.design.densities import mass, project, ramp, simp, threshold
from polyida.design.minimise import Design, Stage, minimise
from polyida.design.problem import Case, Evaluation, Problem
from polyida.design.solid import SolidDesign, solid
from polyida.design.variables import Densities, Sharpness, Size

__all__ = [
    "Case",
    "Densities",
    "Design",
    "Evaluation",
    "Problem",
    "Sharpness",
    "Size",
    "SolidDesign",
    "Stage",
    "mass",
    "minimise",
    "project",
    "ramp",
    "simp",
    "solid",
    "threshold",
]


def __dir__():
    """Return the public names of the package."""
    return __all__
