"""Modules of studies/small_systems.py: the peers and the times of steps."""
