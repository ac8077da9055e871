"""Of equilibria and of modes."""
