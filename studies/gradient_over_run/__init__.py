"""Modules of studies/gradient_over_run.py: times of runs, of their gradients and of the parts of these."""
