"""The design on meshes of what is solid, run again beside the optimiser's, and the search that moves its edges to its limits.

Densities and solid cells differ: grey cells are softer than their mass, and edges lie between cells. The search is a sequence of linear
integer programs: slopes of the solid design predict what each cell at its edge changes; the cells that promise most, few at a time, are
removed or added; the run decides.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polyida.design.densities import neighbours, threshold
from polyida.design.minimise import MET, limits_in_words
from polyida.design.problem import Case, FailedRun, Problem
from polyida.design.variables import BuiltSizeMap, Densities, DensityMap, Sharpness
from polyida.errors import InputError
from polyida.mesh import MeshWarning, PolygonMesh, density_filter
from polyida.objective.peak_stress import PeakStress
from polyida.validation import named_keywords, whole

if TYPE_CHECKING:
    import pandas as pd

LEVELS = (0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.35, 0.3, 0.25, 0.2, 0.15, 0.1)
KEPT = 0.03  # relative excess of a limit that a solid design may have
FIRST, LEAST = (0.04, 1.6)  # share of the solid area that may change in one step, at first; number of cells that always may
PRICE = 10.0  # of an excess of 1 of a limit, in units of the objective of the first solid design
HOLE = Sharpness(2.0)  # triples the slopes of stiffness: in plane stress, a small hole costs about three times the energy of its material
TRUST = (0.25, 8.0)  # range of the factors of predicted changes of the limits, measured in the steps before


@named_keywords
@dataclass(frozen=True, eq=False)
class SolidDesign:
    """A design on meshes of what is solid, run again.

    Parameters
    ----------
    at : float
        Density from which a cell is solid before edges move; NaN for meshes of `start`.
    meshes : dict of str to PolygonMesh
    models : dict of str to Model
        Of each case.
    runs : dict of str to Trajectory or Equilibrium
        Of each case.
    table : pandas.DataFrame
        A row for the objective and each limit: upper, the value of the optimiser, and that of the solid design by the case's own run and by
        each other one.
    excess : float
        Largest relative excess of a limit; negative if all are kept.
    """

    at: float
    meshes: dict[str, PolygonMesh]
    models: dict[str, Any]
    runs: dict[str, Any]
    table: pd.DataFrame
    excess: float

    def __repr__(self):
        """Return how the edges were chosen, the excess over limits, and the table."""
        words = "from given meshes" if np.isnan(self.at) else f"density from {self.at:g}"
        return f"SolidDesign({words}, {limits_in_words(self.excess)})\n{self.table}"


@named_keywords
def solid(
    design: Any,
    build: Callable[..., Any] | Mapping[str, Callable[..., Any]],
    levels: Sequence[float] = LEVELS,
    others: Mapping[str, Callable[[Any], Any]] | None = None,
    changes: int = 0,
    start: Mapping[str, PolygonMesh] | None = None,
) -> SolidDesign:
    """Return the design on meshes of its solid cells: the lightest, by the objective, of those that keep the limits within 3 %.

    With `changes` a search begins there: cells at the edges are removed and added, limits first (within half a per cent), until no small
    change that it tries is better. The result is a local optimum.

    Parameters
    ----------
    design : Design
        From `minimise`.
    build : function f(**meshes, **sizes) -> Model, or dict of such functions by the cases' names
        Builds the model with meshes in place of those of the plates with densities: arguments are the plates' names, and the sizes that the
        cases' own functions have. Sizes that are parameters are set afterwards.
    levels : sequence of float
        Densities from which a cell is solid, of which one is chosen.
    others : dict of str to function f(model) -> run, optional
        More runs of the result, by other integrators or with smaller steps.
    changes : int
        At most this many steps of the search, each a run and a backward sweep of every case.
    start : dict of str to PolygonMesh, optional
        Solid meshes by the plates' names, such as `meshes` of another SolidDesign on the same cells. They are tried beside the levels: if
        they keep the limits, the result is not heavier than they are.

    Returns
    -------
    SolidDesign

    Raises
    ------
    InputError
        If no level gives plates in one piece with the sections that the densities keep, and a run that succeeds; for wrong `changes`.

    Warns
    -----
    UserWarning
        If the solid design exceeds a limit by more than 3 %.

    Notes
    -----
    Sequence of linear integer programs: Sivapuram, Picelli, Finite Elem. Anal. Des. 139 (2018). A cell is removed only if its solid
    neighbours hang together without it.
    """
    from pandas import DataFrame

    whole("solid", "changes", changes, 0)
    problem = design.problem
    maps = [one for one in problem.maps if isinstance(one, DensityMap)]
    solids, given = _Solids(design, build, maps), {} if start is None else _given(maps, start)
    best = _best_level(solids, design.values, levels, given)
    if changes and maps:
        meshes = _searched(solids, best.meshes, changes)
        best = _tried(problem, best.at, meshes, *solids.ran(meshes))
    if best.excess > KEPT:
        exceeded = (
            f"{label} is {value:.4g}, upper {u:.4g}"
            for label, value, (limit, _) in zip(problem.labels, best.values[1:], problem.held)
            if value > (u := limit.upper) + KEPT * abs(u)
        )
        more = "smaller cells or looser limits" if changes else "`changes`"
        warnings.warn(f"solid: the design exceeds limits: {'; '.join(exceeded)}; try {more}", stacklevel=3)
    optimiser = [design.objective, *(value for value, _ in design.limits.values())]
    uppers = [np.nan, *(limit.upper for limit, _ in problem.held)]
    columns = {"upper": uppers, "optimiser": optimiser, "solid": best.values}
    for name, run in (others or {}).items():
        columns[name] = _judged(problem, {case.name: run(best.models[case.name]) for case in problem.cases})
    table = DataFrame(columns, index=["objective", *problem.labels])
    return SolidDesign(best.at, best.meshes, best.models, best.runs, table, best.excess)


class _Tried(NamedTuple):
    """A design on solid meshes that was run, with fields of a SolidDesign; values: of the objective and the limits."""

    at: float
    meshes: dict
    models: dict
    runs: dict
    values: NDArray
    excess: float


def _best_level(solids, values, levels, given):
    """The lightest _Tried of the levels and of given meshes that keeps the limits, or the one that exceeds them least. Raises InputError if
    none runs.

    values: {plate: densities}; given: {plate: mesh}, or empty.
    """
    tried, reasons = [], []
    for at in (*levels, *([np.nan] if given else [])):
        try:
            meshes = given if np.isnan(at) else {one.name: _solid_mesh(one, values[one.name], at) for one in solids.maps}
            ran = solids.ran(meshes)
        except (InputError, FailedRun) as error:
            reasons.append(f"{at:g}: {error}")
            continue
        tried.append(_tried(solids.problem, at, meshes, *ran))
    if not tried:
        raise InputError(f"solid: no level gives a design that runs; {'; '.join(reasons)}")
    kept = [one for one in tried if one.excess <= KEPT]
    return min(kept, key=lambda one: one.values[0]) if kept else min(tried, key=lambda one: one.excess)


def _given(maps, start):
    """The meshes of `start` in the maps' order. Raises InputError if a plate has none, or cells that its mesh has not."""
    for one in maps:
        mesh = start.get(one.name)
        if not isinstance(mesh, PolygonMesh):
            raise InputError(f"solid: start has no mesh for the plate {one.name!r}; give `meshes` of a SolidDesign")
        cells = _Edges(one).cells(mesh)
        if len(set(cells)) < mesh.n_cells or not np.allclose(one.mesh.cell_centroids[cells], mesh.cell_centroids):
            raise InputError(f"solid: start of the plate {one.name!r} has cells that the mesh of the design does not have")
    return {one.name: start[one.name] for one in maps}


class _Solids:
    """Models of a design on meshes of solid cells, {plate: mesh}, and their runs."""

    def __init__(self, design, build, maps):
        """Take the sizes of the design and the functions that build its models."""
        self.build, self.maps = build, maps
        self.problem = design.problem
        self.setting = self.problem.setting(design.x, design.sharp)
        self.sizes = {one.name: design.values[one.name] for one in self.problem.maps if isinstance(one, BuiltSizeMap)}

    def model(self, case, meshes):
        """The model of a case."""
        function = self.build[case.name] if isinstance(self.build, Mapping) else self.build
        model = function(**meshes, **{name: value for name, value in self.sizes.items() if name in case.arguments})
        for one, x in zip(self.problem.maps, self.setting.parts):
            model = model if isinstance(one, DensityMap) else one.applied(model, x, self.setting.sharp)
        return model

    def ran(self, meshes):
        """({case: model}, {case: run}) with these meshes. Raises FailedRun."""
        models = {case.name: self.model(case, meshes) for case in self.problem.cases}
        return models, {case.name: case.ran(models[case.name]) for case in self.problem.cases}

    def evaluated(self, meshes):
        """The Evaluation with slopes by the cells of these meshes, one after the other."""
        problem = self.problem
        alone = {name: 1e-3 * np.sqrt(mesh.cell_areas.min()) for name, mesh in meshes.items()}  # a radius that no other cell is in
        cells = [Densities(name, radius, start=1.0) for name, radius in alone.items()]
        cases = [Case(self.model(case, meshes), case.run, case.name) for case in problem.cases]
        # the stress at the cell's strain has the same value, but removing the cell with the largest stress does not lower it
        limits = [
            replace(one, objective=replace(one.objective, power=0.0)) if isinstance(one.objective, PeakStress) else one
            for one in problem.limits
        ]
        solid = Problem(problem.objective, limits, cells, cases, problem.executor)
        return solid.evaluate(solid.start, HOLE)


def _searched(solids, meshes, changes):
    """{plate: mesh} after at most this many steps of removing and adding cells."""
    uppers = np.array([limit.upper for limit, _ in solids.problem.held])
    edges, found = [_Edges(one) for one in solids.maps], solids.evaluated(meshes)
    best = [one.cells(meshes[one.name]) for one in edges]
    first, share, trust = abs(float(found.values[0])) or 1.0, FIRST, np.ones(len(uppers))
    least = LEAST * max(one.areas.mean() for one in edges) / sum(one.areas[cells].sum() for one, cells in zip(edges, best))
    spoiled = [np.zeros(len(one.areas), bool) for one in edges]  # cells whose change alone was no gain

    def merit(found):
        """Limits first: no gain of the objective makes up for an excess."""
        return max(0.0, _excess(found.largest[1:], solids.problem) - MET), float(found.values[0])

    for _ in range(changes):
        step = _step(edges, best, found, spoiled, share, trust, uppers, first)
        if step is None:
            if not (trust > TRUST[0]).any():
                break
            trust = np.maximum(0.5 * trust, TRUST[0])
            continue
        flips, predicted = step
        try:
            meshes_there = {one.name: _solid_mesh(one.map, one.mask(cells) ^ flip, 0.5) for one, cells, flip in zip(edges, best, flips)}
            there = solids.evaluated(meshes_there)
        except InputError:  # a kept section would hang
            there = None
        if there is not None and not there.error:
            real = (there.largest - found.largest)[1:] / np.abs(uppers)
            ratio = np.divide(real, predicted, out=np.ones_like(real), where=np.abs(predicted) > 1e-3)
            trust = np.clip(trust * np.clip(ratio, 0.5, 2.0), *TRUST)
            if merit(there) < merit(found):
                meshes, found, share = meshes_there, there, min(1.3 * share, FIRST)
                best = [one.cells(meshes[one.name]) for one in edges]
                spoiled = [np.zeros_like(one) for one in spoiled]
                continue
        share = max(0.6 * share, least)
        if sum(flip.sum() for flip in flips) <= 2:
            spoiled = [old | flip for old, flip in zip(spoiled, flips)]
    return meshes


def _step(edges, best, found, spoiled, share, trust, uppers, first):
    """Choose the cells to remove or add by an integer linear programme.

    Returns (a mask for each plate, predicted changes of the limits over their uppers); None if no choice promises a gain. spoiled: cells
    that must stay as they are; share: largest changed area over the present one; trust: factor of each limit's slopes; first: scale of the
    objective.
    """
    from scipy.optimize import Bounds, LinearConstraint, milp

    scale = np.divide(found.largest, found.values, out=np.ones_like(found.values), where=found.values != 0)
    by_plate = np.split(
        found.slopes * (scale / np.append(first, np.abs(uppers)))[:, None], np.cumsum([len(cells) for cells in best])[:-1], axis=1
    )
    may = [one.movable(one.mask(cells)) & ~no for one, cells, no in zip(edges, best, spoiled)]
    parts = [one.changes(cells, slopes)[:, free] for one, cells, slopes, free in zip(edges, best, by_plate, may)]
    slopes, areas = np.concatenate(parts, axis=1), np.concatenate([one.areas[free] for one, free in zip(edges, may)])
    n, rows = len(areas), trust[:, None] * slopes[1:]
    limits = np.column_stack([rows, -np.ones(len(rows))]), -np.inf, np.sign(uppers) - found.largest[1:] / np.abs(uppers)
    budget = np.append(areas, 0.0)[None], -np.inf, share * sum(one.areas[cells].sum() for one, cells in zip(edges, best))
    chosen = milp(
        np.append(slopes[0], PRICE),  # the last unknown is the largest excess of a limit
        integrality=np.append(np.ones(n), 0),
        bounds=Bounds(0.0, np.append(np.ones(n), np.inf)),
        constraints=[LinearConstraint(*one) for one in (limits, budget, (_pairs(edges, best, may), -np.inf, 1.0)) if one[0].shape[0]],
        options={"mip_rel_gap": 1e-3, "node_limit": 2000},
    )
    flips = np.zeros(0, bool) if chosen.x is None else chosen.x[:n] > 0.5
    if not flips.any():
        return None
    result = [np.zeros(len(free), bool) for free in may]
    for one, free, flip in zip(result, may, np.split(flips, np.cumsum([free.sum() for free in may])[:-1])):
        one[free] = flip
    return result, rows @ flips


def _pairs(edges, best, may):
    """Rows of the pairs of neighbours that must not both be removed in one step: a member of two cells would be cut."""
    from scipy.sparse import coo_array

    count = sum(int(free.sum()) for free in may)
    ends, begin = [], 0
    for one, cells, free in zip(edges, best, may):
        number, (a, b) = begin + np.cumsum(free) - 1, one.pairs
        both = (free & one.mask(cells))[[a, b]].all(axis=0)
        ends.append(number[[a[both], b[both]]])
        begin += int(free.sum())
    columns = np.concatenate(ends, axis=1)
    rows = np.tile(np.arange(columns.shape[1]), 2)
    return coo_array((np.ones(len(rows)), (rows, columns.ravel())), shape=(columns.shape[1], count + 1)).tocsr()


class _Edges:
    """The cells of a plate, those with a density, of which some are solid."""

    def __init__(self, one):
        """Find the neighbours of the cells of a plate, and its cells at the outline of the mesh."""
        from scipy.sparse import coo_array

        self.map = one
        self.name = one.name
        self.areas = one.mesh.cell_areas
        self.pairs = neighbours(one.mesh)
        a, b = (np.concatenate(ends) for ends in (self.pairs, self.pairs[::-1]))
        self.near = coo_array((np.ones(len(a)), (a, b)), shape=(len(self.areas), len(self.areas))).tocsr()
        self.blur = density_filter(one.mesh, max(one.variable.radius, 2.0 * float(np.sqrt(self.areas.mean()))))  # over neighbours at least
        self.outer = np.bincount(a, minlength=len(self.areas)) < np.diff(one.mesh.offsets)

    def cells(self, solid):
        """The cells of a solid mesh, in its order."""
        from scipy.spatial import cKDTree

        return cKDTree(self.map.mesh.cell_centroids).query(solid.cell_centroids)[1]

    def mask(self, cells):
        """An array (all cells,) that is True for these cells."""
        result = np.zeros(len(self.areas), bool)
        result[cells] = True
        return result

    def movable(self, solid):
        """Mask of the free cells at edges; of solid ones if their solid neighbours are connected without them."""
        from scipy.sparse.csgraph import connected_components

        a, b = self.pairs
        beside, result = solid[a] != solid[b], self.outer & solid
        result[a[beside]] = result[b[beside]] = True
        result &= self.map.free
        for k in np.flatnonzero(result & solid):
            around = self.near.indices[slice(*self.near.indptr[k : k + 2])]
            around = around[solid[around]]
            result[k] = len(around) > 0 and connected_components(self.near[around][:, around], directed=False)[0] == 1
        return result

    def changes(self, cells, slopes):
        """Predicted changes (rows, all cells) by flipping each cell, from slopes (rows, solid cells); of cells that are not solid by their
        neighbours'.
        """
        solid, dense = self.mask(cells), np.zeros((len(slopes), len(self.areas)))
        dense[:, cells] = slopes / self.areas[cells]
        smooth = (self.blur @ dense.T).T / np.maximum(self.blur @ solid.astype(float), 1e-9)
        return np.where(solid, -0.5 * (dense + smooth), smooth) * self.areas


def _solid_mesh(one, rho, at):
    """The mesh of the cells of a DensityMap with a density of at least `at`."""
    with warnings.catch_warnings(action="ignore", category=MeshWarning):
        return threshold(one.mesh, np.asarray(rho, float), at, one.variable.keep, hanging="leave out")


def _tried(problem, at, meshes, models, runs):
    """The _Tried of runs by the cases' names."""
    values = _judged(problem, runs)
    return _Tried(at, meshes, models, runs, values, _excess(values[1:], problem))


def _judged(problem, runs):
    """The objective and the values of the limits of runs by the cases' names."""
    return np.array(
        [np.mean([problem.objective(run) for run in runs.values()]), *(limit.value(runs[case.name]) for limit, case in problem.held)]
    )


def _excess(values, problem):
    """Largest relative excess of the limits, negative if all are kept."""
    return max([(value - limit.upper) / abs(limit.upper) for value, (limit, _) in zip(values, problem.held)], default=0.0)
