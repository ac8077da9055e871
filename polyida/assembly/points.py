"""The points that joints, masses and loads hold on to, collected once each."""

import numpy as np

from polyida.assembly.arrays import concatenated, starts


class Points:
    """Collects weighted sums of nodes; equal sums of one body are one point."""

    def __init__(self, first_node):
        self._first_node = first_node  # {plate: its first node in the scene}
        self._index = {}
        self.nodes, self.weights, self.rest, self.mass = [], [], [], []

    def add(self, attachment, part="point"):
        """Number of the point ("point") or direction ("direction") of an attachment."""
        weights = attachment.weights if part == "point" else attachment.turn_weights
        key = (id(attachment.body), attachment.nodes.tobytes(), weights.tobytes())
        if key not in self._index:
            self._index[key] = len(self.nodes)
            self.nodes.append(attachment.nodes + self._first_node[attachment.body])
            self.weights.append(weights)
            self.rest.append(getattr(attachment, part))
            self.mass.append(0.0)
        return self._index[key]

    def arrays(self):
        """The fields of SceneArrays that describe the points."""
        return {
            "point_ptr": starts(self.nodes),
            "point_nodes": concatenated(self.nodes, np.int32),
            "point_weights": concatenated(self.weights, float),
            "point_rest": concatenated(self.rest, float, (2,)),
            "point_mass": np.array(self.mass, float),
        }
