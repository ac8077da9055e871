"""Modules of studies/levels.py: scenes with reduced or rigid bodies instead of plates, and the cost of their runs and steps."""
