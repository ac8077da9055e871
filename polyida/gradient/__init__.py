"""Gradients of a run in the parameters of its model, by the discrete adjoint."""
