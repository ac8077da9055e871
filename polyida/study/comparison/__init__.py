"""What commands are given, a scene and integrators by their names or out of a user's file, and the comparison of them."""
