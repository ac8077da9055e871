"""Modules of studies/designed_in_motion.py: machines, densities, optimiser, analysis of solid designs, pictures."""
