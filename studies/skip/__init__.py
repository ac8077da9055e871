"""Modules of studies/skip.py: the savings."""
