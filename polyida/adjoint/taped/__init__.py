"""Vectors on a tape, and a model whose functions take them."""
