"""Studies: many runs become a table."""
