"""Modules of studies/conditioning.py: errors of linear solves."""
