"""Modules of studies/gradient_errors.py: scenes, objectives, and gradients beside differences of runs."""
