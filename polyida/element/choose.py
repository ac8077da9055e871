"""The element of a plate, by name."""

from polyida.element import stabilisation
from polyida.element.wachspress import reference_operator


def operator_of(plate):
    """The reference operator of a plate's element on its mesh."""
    if plate.element == "virtual":
        from polyida.element import virtual

        return virtual.reference_operator(plate.placed, plate.tau)
    return reference_operator(plate.placed)


def stabilisation_factor(plate, operator):
    """The factor of a plate's stabilisation, N/m; 0 where its element has none."""
    return 0.0 if operator.stabilisation is None else stabilisation.of_plate(plate)
