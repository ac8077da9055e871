"""Drawing: what is found in a drawing, before it becomes an outline."""

from dataclasses import dataclass
from importlib import import_module

import numpy as np

from polyida.errors import InputError

CHORDS = 24  # of each curved piece, a quarter or half of a circle at most


@dataclass(frozen=True, eq=False)
class Drawing:
    """rings: closed curves, each (n, 2) in the drawing's unit; metres: of one unit, where the drawing says it; notes: for the user."""

    rings: list[np.ndarray]
    metres: float | None = None
    notes: tuple = ()


def library(name):
    """A module of the extra `mesh`; InputError where it is not installed."""
    try:
        return import_module(name)
    except ImportError:
        raise InputError(f"it needs {name.partition('.')[0]}: pip install 'polyida[mesh]'") from None
