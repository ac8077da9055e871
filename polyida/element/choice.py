"""The reference operator of a plate, by its element and order."""

from functools import partial

from polyida.element.elements import lighter, virtual, wachspress
from polyida.element.operator import build
from polyida.element.quadratic import quadratic


def operator_of(plate, kept=None):
    """Return the reference operator of a plate's element on its mesh. kept (nodes,): the share of its mass that a node keeps; see `lighter`."""
    if plate.order == 2:
        return build(plate.placed, lighter(partial(quadratic, tau=plate.tau), kept, order=2))
    return virtual(plate.placed, plate.tau, kept) if plate.element == "virtual" else wachspress(plate.placed, kept)
