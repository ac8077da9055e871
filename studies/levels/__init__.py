"""The three levels of a plate: scenes with other bodies in place of their plates, and what their runs and steps cost."""
