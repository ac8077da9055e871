"""The points that joints, masses and loads hold on to, collected once each."""

import numpy as np

from polyida.assembly.arrays import concatenated, starts
from polyida.errors import InputError


class Points:
    """Collects weighted sums of pairs of q; equal sums are one point. places: {id of a body: its place in the scene}."""

    def __init__(self, places):
        self._places, self._index = places, {}
        self.nodes, self.weights, self.mass = [], [], []

    def add(self, attachment, part="point"):
        """Number of the point ("point") or direction ("direction") of an attachment."""
        if id(attachment.body) not in self._places:
            raise InputError(f"a row of phi is made of {attachment.body.label}, which is not in the scene; add it with scene.add")
        pairs, weights = self._places[id(attachment.body)].held(attachment, part)
        key = (pairs.tobytes(), weights.tobytes())
        if key not in self._index:
            self._index[key] = len(self.nodes)
            self.nodes.append(pairs)
            self.weights.append(weights)
            self.mass.append(0.0)
        return self._index[key]

    def arrays(self):
        """The fields of Links that describe the points."""
        weights = concatenated(self.weights, complex)
        return {
            "point_ptr": starts(self.nodes),
            "point_nodes": concatenated(self.nodes, np.int32),
            "point_weights": np.stack([weights.real, weights.imag], axis=1),
            "point_mass": np.array(self.mass, float),
        }
