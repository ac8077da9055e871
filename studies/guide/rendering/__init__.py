"""What the guide's build adds to Sphinx."""
