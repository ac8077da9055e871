"""What studies/mbb_beam.py is made of: the beam, its elements, the optimality criteria."""
