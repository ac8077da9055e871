"""Points of a scene by name: what masses, loads and joints hold on to, where these are, and what joints do there."""

import numpy as np

from polyida.errors import InputError
from polyida.given import complex_of_pairs, pairs_of
from polyida.joint.attachment import Attachment
from polyida.joint.formula import rest_of
from polyida.joint.joint import Joint
from polyida.joint.reaction import Reaction
from polyida.model import Model


class NamedPoints(Model):
    """A model with `parts`, `joints` and `places` of its bodies among the pairs of q."""

    @property
    def named(self):
        """{name: what a mass, load or joint holds on to (a joint: its side b, or a where b is ground)}."""
        joints = {name: part.a if part.b.body is None else part.b for name, part in self.parts.items() if isinstance(part, Joint)}
        sides = {name: joints.get(name, getattr(part, "at", None)) for name, part in self.parts.items()}
        return {name: side for name, side in sides.items() if isinstance(side, Attachment)}

    def attachment(self, name):
        """One of `named`; InputError for another name."""
        held = self.named
        if name not in held:
            raise InputError(f"no mass, load or joint is called {name!r}; known: {', '.join(map(repr, held))}")
        return held[name]

    def held(self, side, part="point"):
        """(pairs of q, complex weights) of an attachment's "point" or "direction"; InputError where its body is another scene's."""
        if id(side.body) not in self.places:
            raise InputError(f"{side!r}: its body is not in the scene")
        return self.places[id(side.body)].held(side, part)

    def displacement(self, name, q):
        """Displacement of the point that a mass, load or joint holds on to, (2,), m; of q = v its velocity."""
        side = self.attachment(name)
        return self._moved(side, "point", q[None])[0]

    def position(self, name, q):
        """Path of a mass, load or joint, by name or itself, or of an attachment, over frames q (frames, n): (frames, 2), m.

        Raises InputError for what is not in the scene.
        """
        side = self.side(name)
        return side.point + self._moved(side, "point", q)

    def _moved(self, side, part, q):
        """The change of an attachment's "point" or "direction" over frames q (frames, n), (frames, 2)."""
        pairs, weights = self.held(side, part)
        return pairs_of(complex_of_pairs(q.reshape(len(q), -1, 2)[:, pairs]) @ weights)

    def side(self, name):
        """The attachment that is meant: itself, or of a part, or of the part of a name."""
        if isinstance(name, Attachment):
            return name
        name = next((known for known, part in self.parts.items() if part is name), name)
        if not isinstance(name, str):
            raise InputError(f"position({name!r}): give the name of a mass, load or joint, the part itself, or an attachment")
        return self.attachment(name)

    def reactions(self, name, q, lam, t=0.0, whole=False):
        """What a joint does to its side b over frames q (frames, n), lam (frames, k), and t (frames,), s, or one for all: force, N, and
        moment, N m; `whole`: (fx, fy, m) of every joint. Of a body the multipliers of its own rows.
        """
        reaction = self.reaction_of(name, whole)
        return lam.copy() if reaction is None else reaction(np.broadcast_to(t, len(q)), lam, lambda place: self.place(place, q))

    def reaction_of(self, name, whole=False):
        """The Reaction of a joint; None of a body."""
        if (name, whole) not in self._reactions:
            self._reactions[name, whole] = Reaction(self.joints[name], whole) if isinstance(self.joints[name], Joint) else None
        return self._reactions[name, whole]

    def place(self, place, q):
        """Where the "point" of an attachment is, or its "direction", over frames q (frames, n): (frames,), complex."""
        rest = np.full(len(q), rest_of(*place))
        return rest if place[0].body is None else rest + complex_of_pairs(self._moved(*place, q))

    def turn(self, name, q):
        """How far side b of a joint has turned against side a since rest, over frames q (frames, n): (frames,), rad in [-pi, pi].

        Raises InputError where a side has no direction.
        """
        joint = self.joints[name]
        joint.require_directions()
        a, b = (self.place((side, "direction"), q) / side.d.rest for side in (joint.a, joint.b))
        return np.angle(b * a.conj())

    def pulled(self, place, forces):
        """What forces (frames,), complex, on a place do to each coordinate, (frames, n): the transpose of its slope in q."""
        found = np.zeros((len(forces), self.n_nodes), complex)
        pairs, weights = self.held(*place)
        np.add.at(found, (slice(None), pairs), forces[:, None] * np.conj(weights))
        return found.view(float)
