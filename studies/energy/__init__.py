"""What studies/energy.py is made of: long runs."""
