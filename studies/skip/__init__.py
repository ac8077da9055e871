"""Modules of studies/skip.py: the optimisations."""
