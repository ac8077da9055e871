"""What studies/work_precision.py is made of: the selection, errors of the tip."""
