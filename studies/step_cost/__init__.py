"""What studies/step_cost.py is made of: measurements of a step."""
