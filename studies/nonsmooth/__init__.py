"""Modules of studies/nonsmooth.py: contact and friction."""
