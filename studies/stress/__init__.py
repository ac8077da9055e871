"""What studies/stress.py is made of: axes, what is driven along them, what counts as right."""
