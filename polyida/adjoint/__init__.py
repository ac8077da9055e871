"""Gradients of runs, of equilibria and of modes in every parameter of a model, by the adjoint of what was solved."""
