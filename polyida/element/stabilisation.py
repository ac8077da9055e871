"""Numba kernels of a virtual element's stabilisation S: a constant scalar matrix on the node pattern, rows sum to 0.

f = factor (S (x) I) u, W = factor u . (S (x) I) u / 2. Differences of neighbours replace displacements, so that large
translations cost no digits. Its tangent, factor S on the diagonal of each 2 x 2 block, is constant. There is no viscous
counterpart: S v is not zero in the rigid spin of a warped cell and would brake it.
"""

from polyida.element.material import scaled
from polyida.jit import entry
from polyida.jit.intrinsics import add_pair, load_float, load_integer, load_pair, pair, traced, zero_pair


def factor(c1, nu):
    """t tr(C) in N/m, the sum C11 + C22 + C33 of plane elasticity times the thickness; c1 = t E_mod / (1 - nu^2)."""
    return c1 * (5.0 - nu) / 2.0


def of_plate(plate):
    """The factor of a plate, N/m: t tr(C) of plane stress in both planes, `t G (5 - nu) / (1 - nu)`.

    Plane strain's own tr(C) grows without bound towards nu = 1/2 and would lock the corners' modes, which change no volume.
    """
    material = plate.material
    return factor(plate.thickness * material.E / (1 - material.nu**2), material.nu)


@traced(1, pair)
def _add_pull(total, weight, other, own):
    """total + weight (other - own)."""
    return total + weight * (other - own)


@entry
def force(indptr, indices, stabilisation, factor, node_offset, u, f):
    """f (N, 2) += factor (stabilisation (x) I2) u of a body's nodes."""
    for row in range(indptr.shape[0] - 1):
        total, own = zero_pair(), load_pair(u, 2 * (row + node_offset))
        for k in range(load_integer(indptr, row), load_integer(indptr, row + 1)):
            other = load_pair(u, 2 * (load_integer(indices, k) + node_offset))
            total = _add_pull(total, load_float(stabilisation, k), other, own)
        add_pair(f, 2 * (row + node_offset), scaled(factor, total))


@entry
def energy(indptr, indices, stabilisation, factor, node_offset, u):
    """factor u . (stabilisation (x) I2) u / 2 in J: compensated sum of -factor S_ij |u_i - u_j|^2 / 2, i < j."""
    total, lost = 0.0, 0.0
    for row in range(indptr.shape[0] - 1):
        i = row + node_offset
        for k in range(indptr[row], indptr[row + 1]):
            j = indices[k] + node_offset
            if j > i:
                x, y = u[j, 0] - u[i, 0], u[j, 1] - u[i, 1]
                term = -0.5 * factor * stabilisation[k] * (x * x + y * y) - lost
                bigger = total + term
                lost, total = (bigger - total) - term, bigger
    return total
