"""Modules of studies/peers_table.py: for each peer a file of small calls that confirm a feature or its absence."""
