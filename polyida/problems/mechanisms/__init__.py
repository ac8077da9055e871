"""Mechanisms of bodies and joints, the flexible ones at three levels: full plates, reduced ones, rigid ones."""
