"""Modules of studies/stress.py: axes, what is driven along them, what counts as right."""
