"""Of generalized-alpha: its steps backward, and what they begin from."""
