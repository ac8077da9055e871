"""What studies/skip.py is made of: the savings."""
