"""Modules of studies/bdf_order.py: runs of bounded order."""
