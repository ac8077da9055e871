"""Kernels of two fields on the elements at once: two states, or a state and a change of it."""
