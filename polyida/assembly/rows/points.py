"""The points that joints, masses and loads hold on to, collected once each."""

import numpy as np

from polyida.assembly.arrays import concatenated, starts
from polyida.errors import InputError


class Points:
    """Collects weighted sums of nodes; equal sums of one body are one point."""

    def __init__(self, first_node):
        self._first_node = first_node  # {id of a body: its first node in the scene}
        self._index = {}
        self.nodes, self.weights, self.mass = [], [], []

    def add(self, attachment, part="point"):
        """Number of the point ("point") or direction ("direction") of an attachment."""
        weights = attachment.weights if part == "point" else attachment.turn_weights
        return self._number(attachment.body, attachment.nodes, weights)

    def parts(self, attachment, part):
        """(number, complex weight) of the points whose sum it is: itself, or each coordinate of its body where weights are complex."""
        weights = attachment.weights if part == "point" else attachment.turn_weights
        if not np.iscomplexobj(weights):
            return [(self.add(attachment, part), 1 + 0j)]
        nodes, one = attachment.nodes, np.ones(1)
        return [(self._number(attachment.body, nodes[k : k + 1], one), w) for k, w in enumerate(weights) if w]

    def _number(self, body, nodes, weights):
        key = (id(body), nodes.tobytes(), weights.tobytes())
        if key not in self._index:
            if id(body) not in self._first_node:
                raise InputError(f"a row of phi is made of {body.label}, which is not in the scene; add it with scene.add")
            self._index[key] = len(self.nodes)
            self.nodes.append(nodes + self._first_node[id(body)])
            self.weights.append(weights)
            self.mass.append(0.0)
        return self._index[key]

    def arrays(self):
        """The fields of SceneArrays that describe the points."""
        return {
            "point_ptr": starts(self.nodes),
            "point_nodes": concatenated(self.nodes, np.int32),
            "point_weights": concatenated(self.weights, float),
            "point_mass": np.array(self.mass, float),
        }
