"""What studies/small_systems.py is made of: the peer and the times of steps."""
