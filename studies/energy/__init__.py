"""Modules of studies/energy.py: long runs."""
