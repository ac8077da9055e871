"""Modules of studies/against_peers.py: solvers of other packages."""
