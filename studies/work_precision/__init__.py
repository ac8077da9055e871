"""Modules of studies/work_precision.py: the selection, errors of the tip."""
