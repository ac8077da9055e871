"""Modules of studies/least_weight.py: the arm, the rod of a slider crank, the L-bracket."""
