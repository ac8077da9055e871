"""What studies/step_size_sensitivity.py is made of: slopes."""
