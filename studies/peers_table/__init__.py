"""Modules of studies/peers_table.py: a file of checks for each peer, small calls that show a thing or show that it is not there."""
