"""Modules of studies/step_cost.py: measurements of a step."""
