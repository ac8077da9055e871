"""What studies/mesh_convergence.py is made of: cases and their selection."""
