"""Modules of studies/defaults.py: runs with default and explicit settings, and their errors."""
