"""The bodies of one's own of a scene: constant mass, weight, and elastic forces that are Python, on pairs of q behind the plates' nodes."""

import numpy as np

from polyida.assembly.own.forces import OwnForce
from polyida.body.body import Body, BodyPoint, mass_of, on_pairs, rest_of, translation_of
from polyida.body.own_part import writes
from polyida.body.point_mass import PointMass
from polyida.given import complexes


class OwnBody:
    """A body of one's own in its place among the scene's nodes: `nodes` is the slice of its pairs; rest (pairs,) complex."""

    def __init__(self, name, body, first):
        self.name, self.body, self.rest = name, body, rest_of(body)
        self.nodes = slice(first, first + len(self.rest))
        self.mass, self.translation = mass_of(body), translation_of(body)

    @property
    def pairs(self):
        """The same as (pairs, 2)."""
        return _pairs(self.rest)

    @property
    def elastic(self):
        """Whether it deforms."""
        return writes(self.body, Body, "elastic")

    def weight(self, gravity):
        """Gravity on its pairs, `M T g`, (pairs, 2), N."""
        return (self.mass @ _pairs(self.translation * complex(*gravity)).ravel()).reshape(-1, 2)


def own_bodies_of(parts, first):
    """The bodies of one's own in order, their pairs numbered from `first`."""
    found = []
    for name, body in parts.items():
        if isinstance(body, Body):
            found.append(OwnBody(name, body, first))
            first = found[-1].nodes.stop
    return found


def own_mass(own, parts, first_node, n):
    """Mass of bodies of one's own and of the masses at their points, (n, n) sparse."""
    from scipy.sparse import coo_array

    blocks = [(body.nodes.start, body.mass) for body in own]
    for mass in carried_by_own(parts):
        weights = mass.at.weights
        blocks.append((first_node[id(mass.at.body)], mass.mass * on_pairs(np.outer(weights.conj(), weights))))
    entries = [(2 * first + i, 2 * first + k, block[i, k]) for first, block in blocks for i, k in np.argwhere(block)]
    rows, columns, values = zip(*entries) if entries else ((), (), ())
    return coo_array((values, (rows, columns)), shape=(n, n)).tocsc()


def at_own(mass):
    """Whether a mass is carried by a body of one's own."""
    return isinstance(mass.at, BodyPoint)


def carried_by_own(parts):
    """The masses at points of bodies of one's own."""
    return [part for part in parts.values() if isinstance(part, PointMass) and at_own(part)]


class Elastic(OwnForce):
    """The elastic force of a body of one's own, as a force on its pairs."""

    strain = True

    def __init__(self, own, n_nodes):
        from scipy.sparse import eye_array

        self.name, self.element, self.not_finite = own.name, own.body, ""
        self.rest = own.pairs
        self.A = eye_array(2 * n_nodes, format="csr")[2 * own.nodes.start : 2 * own.nodes.stop]
        self.sizes = np.full((len(own.rest), 1), float(np.abs(own.rest).max()) or 1.0)

    def forces(self, t, x, v):
        """Forces on the pairs, (pairs, 2)."""
        return -_pairs(self._call("elastic", (len(x),), _complex(x), numbers=complexes))

    def energy(self, x):
        """Elastic energy, J."""
        return self._energy(_complex(x))

    def slopes(self, t, x, v, c_v, c_q):
        """`c_q df/dx`, (2 pairs, 2 pairs)."""
        if not c_q:
            return np.zeros((x.size, x.size))
        if self.element.elastic_z(_complex(x)) is not None:
            return -c_q * self._call("elastic_z", (x.size, x.size), _complex(x))
        return c_q * self._differences(x, lambda d: self.forces(t, x + d, v))


def _pairs(z):
    return np.stack([z.real, z.imag], axis=-1)


def _complex(x):
    return x[:, 0] + 1j * x[:, 1]
