"""The plates of a scene with the displacements of their nodes, whatever coordinates move them."""


def drawn(model):
    """The plates in order: name, plate, operator, mesh, and the slice of their nodes."""
    return model.bodies


def nodal(model, q):
    """Displacements of the nodes of all of them at q, (nodes, 2), m; of v and a velocities and accelerations, for they are linear in q."""
    return q.reshape(-1, 2)
