"""What studies/conditioning.py is made of: the errors of solves."""
