"""Modules of studies/designed_in_motion.py: the machines, the densities, the optimiser, the analysis of solid designs, the pictures."""
