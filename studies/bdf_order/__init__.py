"""Modules of studies/bdf_order.py: runs with a bounded order."""
