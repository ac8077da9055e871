"""Modules of studies/conditioning.py: the errors of solves."""
