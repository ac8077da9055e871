"""Meshes in and out: a module a format, one dictionary of them, and what every mesh from elsewhere goes through."""
