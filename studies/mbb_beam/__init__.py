"""Modules of studies/mbb_beam.py: the beam, its elements, the optimality criteria."""
