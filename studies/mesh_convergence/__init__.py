"""Modules of studies/mesh_convergence.py: cases and their selection."""
