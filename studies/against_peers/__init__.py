"""What studies/against_peers.py is made of: other people's solvers."""
