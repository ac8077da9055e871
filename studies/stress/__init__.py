"""Modules of studies/stress.py: the axes, the runs along them, and the checks of the runs."""
