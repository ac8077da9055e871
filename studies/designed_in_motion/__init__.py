"""What studies/designed_in_motion.py is made of: the machines, the densities, the optimiser, the analysis of solid designs, the pictures."""
