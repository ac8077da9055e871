"""Viscoelastic plates of a scene: the relaxed strains x as states.

Full plates have them at the points of the elements, reduced ones in y (reduced_kernels.py). Of each term (g, tau) of a plate's Prony series
`x' = (E - x) / tau`, E Green's strain, and the stress is `S = D : (E - sum g x)`. As all states they are velocities of coordinates of mass
`mass`, `x = unit v`, behind all others: `mass (a - (E - x) / (tau unit)) = 0`.

E of a reduced plate is y - y_0, and D its form: since Green's strain is linear in y, the same relaxation as of the full plate in the span
of its fields. Here are residuals, the change of the stiffness, and energies; strain_elimination.py eliminates the strains from a step's
system, and relaxation_slopes.py has the slopes as sparse matrices.

Bodies are numbered as in Relaxation: full plates, then bodies of few coordinates.
"""

import numpy as np

from polyida.assembly import reduced_kernels
from polyida.assembly.arrays import PAIRS, WEIGHTS, cells_of, material_of
from polyida.element import kernels
from polyida.element.operator import Blocks
from polyida.element.relaxation import change_of_strain, relax, strain_square
from polyida.jit import entry, fast, leaf, part


@part
def strains_of(relaxation, body):
    """Number of strains of a body in each of its terms; 0 for a body without terms (max avoids 0 / 0)."""
    return (relaxation.start[body + 1] - relaxation.start[body]) // max(1, relaxation.terms[body + 1] - relaxation.terms[body])


@leaf
def full_plates(scene):
    """Number of full plates; bodies from this number on have few coordinates."""
    return scene.plates.body_node.shape[0] - 1


@part
def relax_body(scene, body, moved, half, viscous_strain, force, strain):
    """Relax the strains of a body, full plate or of few coordinates, by the kernel `relax` of its kind."""
    plates, full = scene.plates, full_plates(scene)
    if body >= full:
        reduced_kernels.relax(scene.reduced, body - full, moved, half, viscous_strain, force, strain)
    else:
        relax(cells_of(plates, body), material_of(plates, body), moved, half, viscous_strain, force, strain)


@part
def change_strain(scene, body, moved, along, strain):
    """Fill the change of the strains of a body along a velocity, by the kernel `change_of_strain` of its kind."""
    full = full_plates(scene)
    if body >= full:
        reduced_kernels.change_of_strain(scene.reduced, body - full, moved, along, strain)
    else:
        change_of_strain(cells_of(scene.plates, body), moved, along, strain)


@part
def strain_square_of(scene, body, strain):
    """Return the integral of E : D : E over a body, J, E the strains (count,)."""
    plates, full = scene.plates, full_plates(scene)
    if body >= full:
        return reduced_kernels.strain_square(scene.reduced, body - full, strain)
    operator = plates.body_operator[body]
    weights = plates.weights[plates.at[operator, WEIGHTS] : plates.at[operator + 1, WEIGHTS]]
    return strain_square(weights, material_of(plates, body), strain)


@part
def pairs_of_body(scene, body):
    """Return (first pair, end) of the pairs of q that move a body."""
    full = full_plates(scene)
    if body >= full:
        return scene.reduced.pair[body - full], scene.reduced.pair[body - full + 1]
    return scene.plates.body_node[body], scene.plates.body_node[body + 1]


@part
def take_viscous_strain(relaxation, body, v, viscous_strain):
    """viscous_strain = sum g x of a body, from the velocities v (numbers,)."""
    at, count = 2 * relaxation.first + relaxation.start[body], viscous_strain.shape[0]
    viscous_strain[:] = 0.0
    for k in range(relaxation.terms[body], relaxation.terms[body + 1]):
        add_real(viscous_strain, relaxation.share[k] * relaxation.unit[body], v[at : at + count], 0)
        at += count


@fast
def add_real(out, factor, numbers, part):
    """out += factor times the real parts (part = 0) or imaginary parts (part = 1) of numbers.

    A loop over whole arrays becomes one over vectors.
    """
    for j in range(out.shape[0]):
        out[j] += factor * (numbers[j].real if part == 0 else numbers[j].imag)


@fast
def add_scaled(out, factor, numbers):
    """Add factor times the numbers to out."""
    for j in range(out.shape[0]):
        out[j] += factor * numbers[j]


@entry
def add_relaxation(scene, moved, half, v, still, residual):
    """Add to residual (n / 2, 2) the forces -B^T D sum g x on the nodes, and behind them the residuals of the strains without inertia.

    The latter are `mass (x - E) / (tau unit)`; B = dE/dq. half: half the change of the displacements in a step, (nodes, 2), or None
    (element/relaxation.py). v (n / 2, 2): velocities of all coordinates, x / unit of the strains. still: 1; 0 leaves out the strain E, so that only the part that is linear in v remains.
    """
    x = scene.relaxation
    speeds, forces = v.reshape(-1), residual.reshape(-1)
    for b in range(x.start.shape[0] - 1):
        if x.terms[b] == x.terms[b + 1]:
            continue
        count = strains_of(x, b)
        viscous_strain, strain = np.empty(count), np.empty(count)
        take_viscous_strain(x, b, speeds, viscous_strain)
        relax_body(scene, b, moved, half, viscous_strain, residual, strain)
        at = 2 * x.first + x.start[b]
        for k in range(x.terms[b], x.terms[b + 1]):
            rate, own = x.mass / x.time[k], forces[at : at + count]
            add_scaled(own, rate, speeds[at : at + count])
            add_scaled(own, -still * rate / x.unit[b], strain)
            at += count


@entry
def add_relaxation_middle(scene, u0, u1, um, vm, residual):
    """Add the forces of relaxation in the middle of a step, with the mean strain of its ends, to the residual."""
    half = np.empty((scene.relaxation.first, 2))
    for i in range(half.shape[0]):
        half[i, 0], half[i, 1] = 0.5 * (u1[i, 0] - u0[i, 0]), 0.5 * (u1[i, 1] - u0[i, 1])
    add_relaxation(scene, um, half, vm, 1.0, residual)


@entry
def add_relaxed_blocks(scene, moved, v, changes, c_q, blocks):
    """Add to blocks (nnz, 2, 2) c_q times what relaxation adds to the stiffness K at the displacements `moved`.

    v: velocities of all coordinates, the last ones those of the strains. changes (bodies,): kappa - 1.
    """
    plates, x, speeds = scene.plates, scene.relaxation, v.reshape(-1)
    full = full_plates(scene)
    for b in range(changes.shape[0]):
        if x.terms[b] < x.terms[b + 1]:
            viscous_strain = np.empty(strains_of(x, b))
            take_viscous_strain(x, b, speeds, viscous_strain)
            if b >= full:
                reduced_kernels.relaxed_blocks(scene.reduced, b - full, moved, viscous_strain, changes[b], c_q, blocks)
                continue
            operator = plates.body_operator[b]
            pairs = plates.pairs[plates.at[operator, PAIRS] : plates.at[operator + 1, PAIRS]]
            own = Blocks(pairs, plates.body_block[b], blocks)
            kernels.relaxed_tangent(cells_of(plates, b), own, material_of(plates, b), moved, c_q, viscous_strain, changes[b])


@entry
def relaxation_energies(scene, moved, v):
    """(energy of relaxation beyond that of the strain E alone, J, the power that each body dissipates (bodies,), W).

    W = sum of E : D : E / 2 over the points with `g_0 E : D : E + sum g (E - x) : D : (E - x)` in place of E : D : E; the power is
    `sum g (E - x) : D : (E - x) / tau`.
    """
    x, speeds = scene.relaxation, v.reshape(-1)
    total, powers, none = 0.0, np.zeros(x.start.shape[0] - 1), np.zeros((x.first, 2))
    for b in range(powers.shape[0]):
        if x.terms[b] < x.terms[b + 1]:
            count, at = strains_of(x, b), 2 * x.first + x.start[b]
            strain, viscous_strain = np.empty(count), np.zeros(count)
            relax_body(scene, b, moved, None, viscous_strain, none, strain)
            for k in range(x.terms[b], x.terms[b + 1]):
                for j in range(count):
                    viscous_strain[j] = strain[j] - x.unit[b] * speeds[at + j]
                size = strain_square_of(scene, b, viscous_strain)
                total += 0.5 * x.share[k] * (size - strain_square_of(scene, b, strain))
                powers[b] += x.share[k] * size / x.time[k]
                at += count
    return total, powers


def stiffness_changes(model, c):
    """kappa - 1 of each body, (bodies,); c real or complex."""
    x = model.arrays.relaxation
    each = x.share / (1.0 + c * x.time)
    return np.array([-each[a:b].sum() for a, b in zip(x.terms, x.terms[1:])])


def relaxed_velocities(model, q):
    """The velocities (n,) of a model in the reference configuration whose strains have relaxed, x = E."""
    x, r = model.arrays.relaxation, np.zeros((model.n_nodes, 2))
    add_relaxation(model.arrays, q.reshape(-1, 2), None, np.zeros_like(r), 1.0, r)
    v, residuals, at = np.zeros(model.n), r.ravel(), 2 * x.first
    for placed in model.strains.values():
        for _, time in placed.terms:
            end = at + placed.padded
            v[at:end] = -time / x.mass * residuals[at:end]
            at = end
    return v
