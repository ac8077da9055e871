"""What studies/gradient_over_run.py is made of: times of runs, of their gradients and of what these are made of."""
