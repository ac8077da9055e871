"""Modules of studies/gradient_errors.py: scenes, objectives, and comparison of gradients with differences of runs."""
