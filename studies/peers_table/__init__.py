"""What studies/peers_table.py is made of: a file of checks for each peer, small calls that show a thing or show that it is not there."""
