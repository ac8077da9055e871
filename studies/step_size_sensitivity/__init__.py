"""Modules of studies/step_size_sensitivity.py: slopes."""
