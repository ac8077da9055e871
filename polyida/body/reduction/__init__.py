"""From a plate and what holds it to few fields: modes, and the exact energy of their span."""
