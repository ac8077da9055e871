"""What studies/gradient_errors.py is made of: scenes, objectives, and gradients beside differences of runs."""
