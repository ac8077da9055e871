"""Points of a scene by name: what masses, loads and joints hold on to, where these are, and what joints do there."""

import numpy as np

from polyida.errors import InputError
from polyida.joint.attachment import Attachment
from polyida.model import Model


class NamedPoints(Model):
    """A model with `parts`, `joints`, `bodies` and `reference`; q are nodal displacements, (x, y) a node, in m."""

    def attachment(self, name):
        """What a mass, load or joint holds on to (a joint: its side b, or a where b is ground); InputError for another name."""
        part = self.parts.get(name)
        side = getattr(part, "at", None) if name not in self.joints else part.a if part.b.body is None else part.b
        if side is None:
            known = ", ".join(repr(other) for other, part in self.parts.items() if hasattr(part, "at") or other in self.joints)
            raise InputError(f"no mass, load or joint is called {name!r}; known: {known}")
        return side

    def nodes_of(self, side):
        """Numbers in the scene of an attachment's nodes; InputError where its body is another scene's."""
        body = next((body for body in self.bodies if body.plate is side.body), None)
        if body is None:
            raise InputError(f"{side!r}: its body is not in the scene")
        return side.nodes + body.nodes.start

    def displacement(self, name, q):
        """Displacement of the point that a mass, load or joint holds on to, (2,), m; of q = v its velocity."""
        side = self.attachment(name)
        return side.weights @ q.reshape(-1, 2)[self.nodes_of(side)]

    def position(self, name, q):
        """Path of a mass, load or joint, by name or itself, or of an attachment, over frames q (frames, n): (frames, 2), m.

        Raises InputError for what is not in the scene.
        """
        side = self._side(name)
        nodes = self.nodes_of(side)
        rest = self.reference[nodes]
        place = rest[0] + side.weights @ (rest - rest[0])
        return place + np.einsum("k,fkx->fx", side.weights, q.reshape(len(q), -1, 2)[:, nodes])

    def _side(self, name):
        """The attachment that is meant: itself, or of a part, or of the part of a name."""
        if isinstance(name, Attachment):
            return name
        name = next((known for known, part in self.parts.items() if part is name), name)
        if not isinstance(name, str):
            raise InputError(f"position({name!r}): give the name of a mass, load or joint, the part itself, or an attachment")
        return self.attachment(name)

    def reactions(self, name, q, lam):
        """What a joint does to its side b over frames q (frames, n), lam (frames, k): force, N, or torque, N m (motors)."""
        return self.joints[name].reaction(lam, lambda vector: self._values(vector, q))

    def _values(self, vector, q):
        """A vector of a joint's formula, its profiles at zero, over frames q (frames, n): (frames, 2)."""
        values = np.full(len(q), complex(vector.rest))
        for side, part, w in (term for piece in vector.pieces for term in piece.terms):
            weights = side.weights if part == "point" else side.turn_weights
            u = q.reshape(len(q), -1, 2)[:, self.nodes_of(side)] @ np.array([1.0, 1j])
            values += w * (u @ weights)
        return np.stack([values.real, values.imag], axis=1)
