"""Modules of studies/work_precision.py: cases, selection, errors of the tip."""
