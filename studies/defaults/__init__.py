"""What studies/defaults.py is made of: runs with the settings that integrators choose and with given ones, and their errors."""
