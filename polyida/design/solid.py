"""From densities to meshes of what is solid, and the design on them, run again beside the optimiser's."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from polyida.design.problem import FailedRun
from polyida.design.variables import BuiltSizeMap, DensityMap, cells_along
from polyida.errors import InputError
from polyida.mesh import MeshWarning, PolygonMesh, topology
from polyida.validation import floats, is_number, is_one_of, named_keywords

if TYPE_CHECKING:
    import pandas as pd

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
    from pandas import DataFrame

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
    table = DataFrame(columns, index=["objective", *problem.labels])
    return SolidDesign(at, meshes, models, runs, table, excess)


def _judged(problem, runs):
    """The objective and the values of the limits of runs by the cases' names."""
    return np.array(
        [np.mean([problem.objective(run) for run in runs.values()]), *(limit.value(runs[case.name]) for limit, case in problem.held)]
    )


def _excess(found, problem):
    return max([(value - limit.upper) / abs(limit.upper) for value, (limit, _) in zip(found[1:], problem.held)], default=0.0)


@named_keywords
def threshold(mesh: PolygonMesh, rho: ArrayLike, at: float = 0.5, keep: Iterable[str] = (), hanging: str = "raise") -> PolygonMesh:
    """Return the mesh of the cells with a density of at least `at`, to analyse the design.

    Sections, supports and loads keep their names and the nodes that remain. Nodes and cells are renumbered.

    Parameters
    ----------
    mesh : PolygonMesh
    rho : (n_cells,) float
    at : float
    keep : str or iterable of str
        Sections whose cells remain whatever their density, so that these sections do not change.
    hanging : "raise" or "leave out"
        For pieces that share no edge with the largest piece: raise an InputError that lists them, or leave them out with a MeshWarning.

    Returns
    -------
    PolygonMesh
        The solid cells.

    Raises
    ------
    InputError
        For wrong values, an unknown section, no solid cell, hanging pieces, or a section of `keep` on a hanging piece.
    """
    if not isinstance(mesh, PolygonMesh):
        raise InputError(f"threshold: mesh is {type(mesh).__name__}, a polyida mesh is needed")
    density = floats(rho)
    if density is None or density.shape != (mesh.n_cells,):
        raise InputError(f"threshold: rho is {repr(rho)[:80]}; it must be {mesh.n_cells} finite numbers, one a cell")
    if not is_number(at):
        raise InputError(f"threshold: at = {at!r} must be a finite number")
    if not is_one_of(hanging, ("raise", "leave out")):
        raise InputError(f"threshold: hanging = {hanging!r} must be 'raise' or 'leave out'")
    cell, cells_of_section = topology.corner_cells(mesh.offsets), cells_along("threshold", mesh, keep)
    solid = density >= at
    for cells in cells_of_section.values():
        solid[cells] = True
    if not solid.any():
        raise InputError(f"threshold: no cell has a density of at least {at:g}; the largest is {density.max():.6g}")
    solid = _main_piece(mesh, solid, cells_of_section, hanging)
    used, nodes = np.unique(mesh.nodes[solid[cell]], return_inverse=True)
    offsets = np.concatenate([[0], np.cumsum(np.diff(mesh.offsets)[solid])])
    points, nodes, offsets, number = topology.renumber(mesh.points[used], nodes, offsets)
    new = np.full(mesh.n_nodes, -1)
    new[used] = number
    named = {name: np.sort(rest) for name, old in mesh.sections.items() if (rest := new[old][new[old] >= 0]).size}
    at_nodes = [{int(new[node]): pair for node, pair in pairs.items() if new[node] >= 0} for pairs in (mesh.supports, mesh.loads)]
    return PolygonMesh(points, nodes, offsets, named, *at_nodes)


def _main_piece(mesh, solid, cells_of_section, hanging, most=5):
    """Mask of the solid cells of the largest piece connected by edges; InputError or a MeshWarning lists at most `most` other pieces."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    pairs = np.sort(topology.directed_edges(mesh.nodes, mesh.offsets).astype(np.int64), axis=1) @ [mesh.n_nodes, 1]
    cell = topology.corner_cells(mesh.offsets)[order := np.argsort(pairs, kind="stable")]
    shared = np.flatnonzero(np.diff(pairs[order]) == 0)
    a, b = cell[shared], cell[shared + 1]
    both = solid[a] & solid[b]
    graph = coo_array((np.ones(both.sum()), (a[both], b[both])), shape=(mesh.n_cells, mesh.n_cells))
    label = connected_components(graph, directed=False)[1]
    piece = np.full(mesh.n_cells, -1)  # number of the piece of each solid cell
    piece[solid] = np.unique(label[solid], return_inverse=True)[1]
    area = np.bincount(piece[solid], weights=mesh.cell_areas[solid])
    main = int(np.argmax(area))
    if len(area) == 1:
        return solid
    for name, cells in cells_of_section.items():
        if (piece[cells] != main).any():
            raise InputError(f"threshold: section {name!r}, which is to be kept, is not connected to the largest piece")
    others, words = [k for k in np.argsort(-area) if k != main], []
    for k in others[:most]:
        cells = np.flatnonzero(piece == k)
        x, y = np.average(mesh.cell_centroids[cells], axis=0, weights=mesh.cell_areas[cells])
        words.append(f"{len(cells)} cell{'s' * (len(cells) > 1)} around ({x:.4g}, {y:.4g})")
    more = f" and {len(others) - most} more" if len(others) > most else ""
    listed = f"{len(others)} hanging piece{'s' * (len(others) > 1)}, {'; '.join(words)}{more}"
    if hanging == "raise":
        raise InputError(f"threshold: {listed}; a lower `at` may join them, hanging='leave out' leaves them out")
    warnings.warn(f"threshold: left out: {listed}", MeshWarning, stacklevel=4)
    return piece == main
