"""Outlines from drawings: a module a format, and what their closed curves become."""
