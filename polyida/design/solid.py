"""A design on meshes of what is solid, run again beside the optimiser's."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from polyida.design.problem import FailedRun
from polyida.design.threshold import threshold
from polyida.design.variables import BuiltSizeMap, DensityMap
from polyida.errors import InputError
from polyida.mesh import MeshWarning, PolygonMesh
from polyida.validation import named_keywords

LEVELS = (0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.35, 0.3, 0.25, 0.2, 0.15, 0.1)
KEPT = 0.03  # relative excess of a limit that a solid design may have


@named_keywords
@dataclass(frozen=True, eq=False)
class SolidDesign:
    """A design on meshes of what is solid, run again.

    Parameters
    ----------
    at : float
        Density from which a cell is solid.
    meshes : dict of str to PolygonMesh
    models : dict of str to Model
        Of each case.
    runs : dict of str to Trajectory or Equilibrium
        Of each case.
    table : pandas.DataFrame
        A row for the objective and each limit: upper, the value of the optimiser, and that of the solid design by the case's own run and by each
        other one.
    excess : float
        Largest relative excess of a limit.
    """

    at: float
    meshes: dict[str, PolygonMesh]
    models: dict[str, Any]
    runs: dict[str, Any]
    table: pd.DataFrame
    excess: float

    def __repr__(self):
        return f"SolidDesign(density from {self.at:g}, limits exceeded by {100 * self.excess:.2g} %)\n{self.table}"


@named_keywords
def solid(
    design: Any,
    build: Callable[..., Any] | Mapping[str, Callable[..., Any]],
    levels: Sequence[float] = LEVELS,
    others: Mapping[str, Callable[[Any], Any]] | None = None,
) -> SolidDesign:
    """Return the design on meshes of its solid cells: the lightest, by the objective, of those that keep the limits within 3 %.

    Parameters
    ----------
    design : Design
        From `minimise`.
    build : function f(**meshes, **sizes) -> Model, or dict of such functions by the cases' names
        Builds the model with meshes in place of those of the plates with densities: arguments are the plates' names, and the sizes that the cases'
        own functions have. Sizes that are parameters are set afterwards.
    levels : sequence of float
        Densities from which a cell is solid, of which one is chosen.
    others : dict of str to function f(model) -> run, optional
        More runs of the result, by other integrators or with smaller steps.

    Returns
    -------
    SolidDesign

    Raises
    ------
    InputError
        If no level gives plates in one piece with the sections that the densities keep, and a run that succeeds.
    """
    problem, values = design.problem, design.values
    maps = [one for one in problem.maps if isinstance(one, DensityMap)]
    sizes = {one.name: values[one.name] for one in problem.maps if isinstance(one, BuiltSizeMap)}
    setting, tried, reasons = problem.setting(design.x, design.sharp), [], []

    def made(case, meshes):
        function = build[case.name] if isinstance(build, Mapping) else build
        model = function(**meshes, **{name: value for name, value in sizes.items() if name in case.arguments})
        for one, x in zip(problem.maps, setting.parts):
            model = model if isinstance(one, DensityMap) else one.applied(model, x, setting.sharp)
        return model

    for at in levels:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", MeshWarning)
                meshes = {one.name: threshold(one.mesh, values[one.name], at, one.variable.keep, hanging="leave out") for one in maps}
            models = {case.name: made(case, meshes) for case in problem.cases}
            runs = {case.name: case.ran(models[case.name]) for case in problem.cases}
        except (InputError, FailedRun) as error:
            reasons.append(f"{at:g}: {error}")
            continue
        found = _judged(problem, runs)
        tried.append((_excess(found, problem), float(found[0]), at, meshes, models, runs, found))
    if not tried:
        raise InputError(f"solid: no level gives a design that runs; {'; '.join(reasons)}")
    kept = [one for one in tried if one[0] <= KEPT]
    excess, _, at, meshes, models, runs, found = min(kept, key=lambda one: one[1]) if kept else min(tried, key=lambda one: one[0])
    optimiser = [design.objective, *(value for value, _ in design.limits.values())]
    uppers = [np.nan, *(limit.upper for limit, _ in problem.held)]
    columns = {"upper": uppers, "optimiser": optimiser, "solid": found}
    for name, run in (others or {}).items():
        columns[name] = _judged(problem, {case.name: run(models[case.name]) for case in problem.cases})
    table = pd.DataFrame(columns, index=["objective", *problem.labels])
    return SolidDesign(at, meshes, models, runs, table, excess)


def _judged(problem, runs):
    """The objective and the values of the limits of runs by the cases' names."""
    return np.array(
        [np.mean([problem.objective(run) for run in runs.values()]), *(limit.value(runs[case.name]) for limit, case in problem.held)]
    )


def _excess(found, problem):
    return max([(value - limit.upper) / abs(limit.upper) for value, (limit, _) in zip(found[1:], problem.held)], default=0.0)
