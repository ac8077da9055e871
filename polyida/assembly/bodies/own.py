"""What Python alone can say of bodies of one's own: elastic forces, and masses that are not the same along x and y."""

import numpy as np

from polyida.assembly.own.forces import OwnForce
from polyida.given import complexes, pairs_of


def uneven_mass(placed, n):
    """Mass (n, n) sparse of the bodies whose x and y carry different ones; None where there are none."""
    return _placed([(2 * body.pairs.start, body.uneven) for body in placed if body.uneven is not None], n)


def uneven_drag(placed, n):
    """`drag M` (n, n) sparse of the same bodies, which kernels leave out with their M; None where none of them has a drag."""
    drags = [(body, body.body.damping()[0]) for body in placed if body.uneven is not None]
    return _placed([(2 * body.pairs.start, drag * body.uneven) for body, drag in drags if drag], n)


def _placed(blocks, n):
    """(n, n) sparse of blocks, (first row, matrix) each; None where there are none."""
    from scipy.sparse import coo_array

    if not blocks:
        return None
    entries = [(first + i, first + k, block[i, k]) for first, block in blocks for i in range(len(block)) for k in range(len(block))]
    rows, columns, values = zip(*entries)
    return coo_array((values, (rows, columns)), shape=(n, n)).tocsc()


class Elastic(OwnForce):
    """The elastic force of a body of one's own, as a force on its pairs."""

    strain = True
    switches = False

    def __init__(self, placed, n_pairs):
        from scipy.sparse import eye_array

        self.name, self.element, self.not_finite = placed.name, placed.body, ""
        self.rest = pairs_of(placed.rest)
        self.columns = slice(2 * placed.pairs.start, 2 * placed.pairs.stop)
        self.A = eye_array(2 * n_pairs, format="csr")[self.columns]
        self.sizes = np.full((len(self.rest), 1), float(abs(self.rest).max()) or 1.0)

    def velocities(self, v):
        """Velocities of the pairs, (pairs, 2), m/s."""
        return v[self.columns].reshape(-1, 2)

    def forces(self, t, x, v):
        """Forces on the pairs, (pairs, 2)."""
        return -pairs_of(self._call("elastic", (len(x),), x @ (1, 1j), numbers=complexes))

    def conservative(self, t, x):
        """Its forces: energy(z) is always theirs."""
        return self.forces(t, x, x)

    def energy(self, x):
        """Elastic energy, J."""
        return self._energy(x @ (1, 1j))

    def slopes(self, t, x, v, c_v, c_q):
        """`c_q df/dx`, (2 pairs, 2 pairs)."""
        if not c_q:
            return np.zeros((x.size, x.size))
        if self.element.elastic_z(x @ (1, 1j)) is not None:
            return -c_q * self._call("elastic_z", (x.size, x.size), x @ (1, 1j))
        return c_q * self._differences(x, lambda d: self.forces(t, x + d, v))
