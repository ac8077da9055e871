"""Modules of studies/against_peers.py: other solvers."""
