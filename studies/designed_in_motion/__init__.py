"""Modules of studies/designed_in_motion.py: machines, designs, analysis of solid designs, pictures."""
