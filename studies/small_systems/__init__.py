"""Modules of studies/small_systems.py: the peer and the times of steps."""
