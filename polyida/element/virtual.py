"""Virtual elements of order one on any simple polygon: one constant F a cell, and a stabilisation of what F cannot see.

Pi maps nodal values x_i of a cell to the linear field with their mean at the corners' mean X_m and the gradient
sum_i x_i (x) G_i, G_i = (1 / |E|) oint N_i n ds of linear edges (Beirao da Veiga et al. 2013). Energy and mass are

    W = int t S(F) : E(F) / 2 + tau t tr(C) |(I - Pi) x|^2 / 2
    m_ij = int Pi N_i Pi N_j + (|E| / (9 n)) ((I - Pi)^T (I - Pi))_ij

with tr(C) of the 3 x 3 plane elasticity matrix. (I - Pi) takes linear fields to zero, the reference positions X among
them: x may be replaced by the displacements, and a rotation costs no energy. Total mass and rigid inertia are exact; on
a square the mass is the bilinear element's, and on regular polygons of 4 to 7 corners the part with 1 / (9 n) is within
7 % of what Wachspress functions give.
"""

import numpy as np

from polyida.element.operator import after, build, measures, second_moments
from polyida.errors import InputError

THINNEST = 1e-14
"""Least area of a cell over its squared circumference."""


def reference_operator(mesh, tau=0.1):
    """ReferenceOperator with one point a cell and the matrix `stabilisation` = tau sum over cells (I - Pi)^T (I - Pi).

    mesh: points (N, 2) in m, nodes and offsets (corners of cell i are nodes[offsets[i]:offsets[i + 1]]); cells are
    counter-clockwise simple polygons, not necessarily convex: hanging nodes and reentrant corners are welcome.
    tau: stiffness of the deformations that a cell's F does not see, no unit, > 0. It is a tuning parameter: the answers
    converge to the same limit for every tau. The error of a cantilever's tip, 2 / 3 / 5 cells through the thickness, is
    +3.5 / +0.2 / +0.3 % with 0.1 and -43 / -19 / -8 % with 0.5 (means over six meshes of 40 / 90 / 250 cells).
    The stabilisation has no unit. Its energy is factor u . (stabilisation (x) I) u / 2 with factor = t tr(C)
    = c1 (5 - nu) / 2 in N/m, c1 = t E / (1 - nu^2) (`stabilisation.factor`), in plane strain too: one volume a cell and
    a stabilisation that stays bounded do not lock as nu goes to 1/2. Triangles have none.
    Raises InputError for tau <= 0, a cell of no area or clockwise, a side of zero length, a node without a cell.
    """
    if not (np.isfinite(tau) and tau > 0):
        raise InputError(
            f"virtual element: tau = {tau!r} must be a positive number, 0.1 is usual; without "
            "stabilisation cells of more than three corners have no stiffness against some deformations"
        )
    return build(mesh, lambda corners, cells, nodes: _element(corners, cells, nodes, tau))


def _element(corners, cells, nodes, tau):
    """Areas, mean gradients, gradients of one point, weight, mass and stabilisation (n, n, c) of the cells."""
    n = len(corners)
    corners = corners - corners.mean(axis=0)
    _require_area(corners, cells, nodes)
    area, centroid, mean = measures(corners)
    rest = np.eye(n)[..., None] - 1 / n - np.einsum("idc,jdc->ijc", corners, mean)
    square = np.einsum("kic,kjc->ijc", rest, rest) if n > 3 else np.zeros((n, n, len(cells)))
    middle = 1 / n + np.einsum("idc,dc->ic", mean, centroid)
    spread = np.einsum("idc,dec,jec->ijc", mean, second_moments(corners - centroid), mean)
    mass = middle[:, None] * middle * area + (spread + spread.transpose(1, 0, 2)) / 2 + area / (9 * n) * square
    return area, mean, mean[None], area[None], mass, tau * square


def _require_area(corners, cells, nodes):
    """InputError naming the first cell with a side of zero length, or without positive area."""
    lengths = np.sqrt(((after(corners) - corners) ** 2).sum(axis=1))
    flat = ~(lengths > 0)
    if flat.any():
        k = np.flatnonzero(flat.any(axis=0))[0]
        raise InputError(f"cell {cells[k]}: the side after node {nodes[np.argmax(flat[:, k]), k]} has no length")
    area = measures(corners)[0]
    wrong = np.flatnonzero(~(area > THINNEST * lengths.sum(axis=0) ** 2))
    if wrong.size:
        raise InputError(
            f"cell {cells[wrong[0]]}: area {area[wrong[0]]:.3g} m^2; a virtual element needs a cell counter-clockwise, with positive area"
        )
