"""Modules of studies/defaults.py: runs with the settings that integrators choose and with given ones, and their errors."""
