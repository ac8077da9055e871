"""A scene with other plates: with factors of the stiffness and mass of their cells, or elastic ones in place of viscoelastic ones."""

from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.assembly.factors import given_factors, scaled
from polyida.assembly.relaxation import stiffness_changes


class ScaledScene:
    """Mixed into SceneModel: models of the same parts with other plates."""

    bodies: Any

    @property
    def factors(self) -> dict[str, tuple[NDArray, NDArray]]:
        """{plate: (stiffness, mass)}, each (cells,): the factors of all full plates, 1 by default."""
        return {body.name: body.factors for body in self.bodies}

    def with_factors(self, /, **factors: tuple[ArrayLike | None, ArrayLike | None]) -> Self:
        """This model with factors of the plates' cells: `with_factors(arm=(stiffness, mass))`.

        Parameters
        ----------
        **factors : (stiffness, mass)
            For each plate that changes: two positive numbers, or arrays (cells,) of them, or None for 1. A factor refers to the full plate,
            whatever factors this model has. Other plates keep theirs.

        Returns
        -------
        SceneModel
            A model that shares with this one all that does not depend on factors.

        Raises
        ------
        InputError
            Names the plate and the value.

        Notes
        -----
        Stiffness scales the elastic force, its viscosity and the stabilisation of virtual elements; mass scales inertia, weight and
        mass-proportional damping. A cell with factor f in both is a cell of thickness f t. Stresses are those of the scaled material.
        """
        return scaled(self, factors)

    def elastic(self, relaxed):
        """This model with elastic plates in place of viscoelastic ones, with fewer coordinates behind the same first ones.

        Their modulus is that of a sudden strain, or if `relaxed` that of a constant one after a long time.
        """
        without_strains = True
        model = type(self)(self.parts, self.gravity, self.treats_redundant, without_strains, self.late).with_factors(**given_factors(self))
        if relaxed:
            plates, reduced = model.arrays.plates, model.arrays.reduced
            of_plates, of_reduced = np.split(1.0 + stiffness_changes(self, 0.0), [len(self.bodies)])
            forms = reduced.form * np.repeat(of_reduced, np.diff(reduced.form_start[: len(of_reduced) + 1]))
            model.arrays = model.arrays._replace(
                plates=plates._replace(membrane_stiffness=plates.membrane_stiffness * of_plates), reduced=reduced._replace(form=forms)
            )
        return model
