"""Virtual elements of order one on polyhedra, St. Venant-Kirchhoff, large displacement: what a cell is, and its compiled sums.

F is constant in a cell and follows from the displacements of its faces, `F = I + sum_i u_i (x) b_i`, `b_i = 1/V int_surface phi_i n dA`, phi_i
linear on the triangles between a face's edges and its mean point. The rest of the displacements, `s_i = u_i - mean(u) - (F - I) d_i`, d_i the
place from the mean of the corners, has the energy `k/2 sum |s_i|^2`: k such that the six pure bendings and three twists of the cell have on
average their energies, `E/2 int y^2 dV` and `G/2 int y^2 + z^2 dV`. Sources: Beirao da Veiga, Brezzi, Marini, SIAM J. Numer. Anal. 51 (2013) 794-812; Chi, Beirao da Veiga, Paulino,
Comput. Methods Appl. Mech. Eng. 318 (2017) 148-192; Cangiani et al., Comput. Mech. 55 (2015) for the energy of bending.
"""

from itertools import permutations
from typing import NamedTuple

import numpy as np
from numba import njit

from polyhedra.mesh import triangulated


class Cells(NamedTuple):
    """Cells one behind the other: cell c has the entries first[c]:first[c + 1] of nodes, b and d (entries, 3).

    volume: V; bending: k/(E + G), m. lumped (entries,): shares of the volume, in which the first moment is exact.
    """

    first: np.ndarray
    nodes: np.ndarray
    b: np.ndarray
    d: np.ndarray
    volume: np.ndarray
    bending: np.ndarray
    lumped: np.ndarray


def cells_of(mesh):
    """(the Cells of a mesh, [(n, n) consistent mass matrix of each at density 1])."""
    parts, masses = [], []
    for faces in mesh.cells:
        nodes = np.unique(np.concatenate(faces))
        x = mesh.points[nodes]
        d, n = x - x.mean(axis=0), len(nodes)
        b, lumped, volume, inertia, moment = np.zeros((n, 3)), np.zeros(n), 0.0, np.zeros((3, 3)), np.zeros(3)
        for face in faces:
            at = np.searchsorted(nodes, face)
            corners, areas = triangulated(d[at])
            b[at] += areas
            tets = np.linalg.det(corners) / 6.0
            volume += tets.sum()
            sums = corners.sum(axis=1)
            moment += tets @ sums / 4.0
            inertia += np.einsum("t,tki,tkj->ij", tets, corners, corners) / 20.0 + np.einsum("t,ti,tj->ij", tets, sums, sums) / 20.0
            lumped[at] += (tets + np.roll(tets, 1)) / 4.0 + tets.sum() / (4.0 * len(at))
            lumped += tets.sum() / (4.0 * n)
        b /= volume
        rest = np.eye(n) - 1.0 / n - d @ b.T  # s = rest u
        modes = np.zeros((9, n, 3))
        for mode, (i, j) in zip(modes, permutations(range(3), 2)):
            mode[:, i], mode[:, j] = d[:, i] * d[:, j], -0.5 * d[:, i] ** 2
            modes[6 + 3 - i - j, :, i] = (1.0 if (j - i) % 3 == 1 else -1.0) * d[:, 3 - i - j] * d[:, j]
        spread = np.sum((rest @ modes) ** 2) / 6.0
        parts.append((nodes, b, d, volume, np.trace(inertia) / 3.0 / spread, lumped))
        linear = volume / n**2 + ((b @ moment)[:, None] + (b @ moment)[None]) / n + b @ inertia @ b.T
        masses.append(linear + volume / n * rest.T @ rest)
    nodes, b, d, volume, bending, lumped = zip(*parts)
    first = np.append(0, np.cumsum([len(one) for one in nodes]))
    return Cells(first, *map(np.concatenate, (nodes, b, d)), np.array(volume), np.array(bending), np.concatenate(lumped)), masses


@njit(cache=True)
def strained(c, cells, u, E, nu):
    """(nodes of cell c, their b, their d, their s, F, second Piola-Kirchhoff stress S, energy per volume, k); u (nodes, 3)."""
    of = slice(cells.first[c], cells.first[c + 1])
    nodes, b, d, one = cells.nodes[of], cells.b[of], cells.d[of], np.eye(3)
    U = u[nodes]
    G, mean = np.dot(U.T, b), np.sum(U, axis=0) / len(nodes)
    strain, lame, shear = 0.5 * (G + G.T + np.dot(G.T, G)), E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), E / (2.0 + 2.0 * nu)
    trace = np.trace(strain)
    energy = 0.5 * lame * trace * trace + shear * np.sum(strain * strain)
    s, S = U - mean - np.dot(d, G.T), lame * trace * one + 2.0 * shear * strain
    return nodes, b, d, s, G + one, S, energy, (E + shear) * cells.bending[c]


@njit(cache=True)
def forces(cells, E, nu, u):
    """(elastic forces (nodes, 3), elastic energy)."""
    f, total = np.zeros_like(u), 0.0
    for c in range(cells.volume.shape[0]):
        nodes, b, d, s, F, S, energy, k = strained(c, cells, u, E, nu)
        V = cells.volume[c]
        total += V * energy + 0.5 * k * np.sum(s * s)
        of_cell = np.dot(b, (V * np.dot(F, S) - k * np.dot(s.T, d)).T) + k * s
        for i in range(len(nodes)):
            f[nodes[i]] += of_cell[i]
    return f, total


@njit(cache=True)
def tangent(cells, pairs, count, E, nu, u):
    """Derivatives of the elastic forces, blocks (count, 3, 3). pairs: the block of each two corners of a cell, -1 without."""
    blocks, at, lame, shear = np.zeros((count, 3, 3)), 0, E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), E / (2.0 + 2.0 * nu)
    for c in range(cells.volume.shape[0]):
        nodes, b, d, _, F, S, _, k = strained(c, cells, u, E, nu)
        V, n = cells.volume[c], len(nodes)
        Fb, bb, left, rest = np.dot(b, F.T), np.dot(b, b.T), np.dot(F, F.T), np.eye(n) - 1.0 / n - np.dot(d, b.T)
        same = V * np.dot(np.dot(b, S), b.T) + k * np.dot(rest.T, rest)
        for i in range(n):
            for j in range(n):
                p = pairs[at + i * n + j]
                if p >= 0:
                    for x in range(3):
                        blocks[p, x, x] += same[i, j]
                        for y in range(3):
                            blocks[p, x, y] += V * (lame * Fb[i, x] * Fb[j, y] + shear * (left[x, y] * bb[i, j] + Fb[j, x] * Fb[i, y]))
        at += n * n
    return blocks


@njit(cache=True)
def rotations(cells, u, count):
    """(count, 3, 3): the rotations in the mean F of the cells around each of the first nodes, by Newton's method for the polar factor."""
    R, C = np.zeros((count, 3, 3)), np.empty((3, 3))
    for c in range(cells.volume.shape[0]):
        nodes, _, _, _, F, _, _, _ = strained(c, cells, u, 1.0, 0.0)
        for node in nodes:
            if node < count:
                R[node] += F
    for A in R:
        for step in range(4):
            for i in range(3):
                for j in range(3):
                    p, q, r, s = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
                    C[i, j] = A[p, r] * A[q, s] - A[p, s] * A[q, r]
            det = A[0, 0] * C[0, 0] + A[0, 1] * C[0, 1] + A[0, 2] * C[0, 2]
            scale = np.cbrt(det) if step == 0 else 1.0  # a sum becomes a mean
            for i in range(3):
                for j in range(3):
                    A[i, j] = 0.5 * (A[i, j] / scale + C[i, j] / det * scale)
    return R
