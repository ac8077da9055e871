"""Digits of the mechanisms' named points at their ends, at every level, on the default meshes, by two methods of different form and time stepping.

`python studies/digits.py slider-crank four-bar two-link-arm peaucellier` makes and prints them: DOP853 on the index-1 equations, rtol 1e-9, put back
on the constraints 31 times. KNOWN_TO is how far Radau IIA on the stabilised form, rtol 1e-12, is from them. Space is not converged: these
are digits of the semi-discrete equations on that mesh, or in those modes.
"""

import numpy as np

DIGITS: dict[str, dict] = {}

KNOWN_TO: dict[str, dict] = {}


def of(name, level):
    """(reference, known_to) of a mechanism at a level."""
    return {part: np.array(value) for part, value in DIGITS.get(name, {}).get(level, {}).items()}, dict(KNOWN_TO.get(name, {}).get(level, {}))
