"""The density filter of topology optimisation: what a design variable of one polygon gives to its neighbours."""

from typing import TYPE_CHECKING

import numpy as np

from polyida.errors import InputError
from polyida.mesh.polygon_mesh import PolygonMesh
from polyida.validation import is_number, named_keywords

if TYPE_CHECKING:
    from scipy.sparse import csr_array


@named_keywords
def density_filter(mesh: PolygonMesh, radius: float) -> "csr_array":
    """Sparse (cells, cells) matrix F of hat weights: `rho = F @ x`, and slopes in x are `F.T @ (slopes in rho)`.

    `F_ij = A_j max(0, radius - |c_i - c_j|) / sum_k A_k max(0, radius - |c_i - c_k|)` with the centroids c and the areas A of the cells:
    rows sum to one, so that a constant stays what it is. radius: m; one below the distance of neighbours gives the identity.
    Raises InputError for what is no mesh and a radius that is not positive.
    Source: Bruns, Tortorelli, Comput. Methods Appl. Mech. Engrg. 190 (2001); Bourdin, Int. J. Numer. Meth. Engng. 50 (2001).
    """
    from scipy.sparse import coo_array, diags_array
    from scipy.spatial import cKDTree

    if not isinstance(mesh, PolygonMesh):
        raise InputError(f"density_filter: mesh is {type(mesh).__name__}, a polyida mesh is needed")
    if not (is_number(radius) and radius > 0):
        raise InputError(f"density_filter: radius = {radius!r} must be a positive number of metres")
    i, j = cKDTree(mesh.cell_centroids).query_pairs(radius, output_type="ndarray").T
    hat = radius - np.linalg.norm(mesh.cell_centroids[i] - mesh.cell_centroids[j], axis=1)
    own = np.arange(mesh.n_cells)
    rows, columns = np.concatenate([own, i, j]), np.concatenate([own, j, i])
    weights = np.concatenate([np.full(mesh.n_cells, radius), hat, hat]) * mesh.cell_areas[columns]
    found = coo_array((weights, (rows, columns)), shape=(mesh.n_cells, mesh.n_cells)).tocsr()
    return (diags_array(1.0 / found.sum(axis=1)) @ found).tocsr()
