"""How much the material has to bear."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from polyida.element import kernels as element
from polyida.element.lanes import LANES
from polyida.given import settle
from polyida.keywords import named_keywords
from polyida.objective.means import kernels
from polyida.objective.means.time_mean import TimeMean, chosen, deforming, named, power, power_mean, relative
from polyida.objective.slopes import Slopes
from polyida.results.motion import von_mises


@named_keywords
@dataclass(frozen=True, eq=False)
class PeakStress(TimeMean):
    """`(time mean of the area mean of s^p)^(1/p)`, Pa, s the von Mises stress of a cell, as `run.von_mises`.

    It lies below the largest stress, the nearer the larger p. plate: a plate or a reduced one, by name or itself; None: all. With factors
    of cells it is the stress of the scaled cells. Raises InputError for a p below 1, and of a run for what is no such plate of its scene.
    """

    plate: Any = None
    _of_material = True
    p: float = 8.0

    def __post_init__(self):
        settle(self, p=power("PeakStress", self.p))

    def named(self, model: Any) -> "PeakStress":
        """By the name of its body."""
        return replace(self, plate=named(model, self.plate))

    def _seen(self, model, span):
        """The area mean of order p."""
        known = deforming(model) if model.is_scene else {}
        known = {body.name: body for body in model.drawn if body.name in known}
        bodies = [Stressed(body) for body in chosen("PeakStress", model, self.plate, known)]
        areas = np.concatenate([body.operator.areas for body in bodies])
        share, splits = areas / areas.sum(), np.cumsum([body.operator.n_cells for body in bodies])[:-1]

        def look(frames):
            moved = [model.nodal(q) for q in frames.q]
            stresses = [[body.stress(u) for body in bodies] for u in moved]
            sizes = np.array([np.concatenate([body.von_mises(one) for body, one in zip(bodies, each)]) for each in stresses])
            means = np.array([power_mean(share, s, self.p) for s in sizes])

            def back(factor):
                """ds/dvm = share (vm / s)^(p - 1)."""
                rates = [relative(one, mean) ** (self.p - 1.0) for one, mean in zip(sizes, means)]
                toward = factor[:, None] * share * np.array(rates).reshape(sizes.shape)
                pulls = zip(moved, stresses, (np.split(one, splits) for one in toward))
                pull = [model.of_nodal(_pull(bodies, *each)) for each in pulls]
                works = np.split(np.sum(toward * sizes, axis=0), splits)
                direct = [slopes for body, work in zip(bodies, works) if body.body in model.bodies for slopes in body.by_parameters(work)]
                return Slopes(q=np.array(pull).reshape(-1, model.n), direct=dict(direct))

            return lambda: means, back

        return look


def _pull(bodies, u, stresses, wanted):
    """What acts on the nodes (nodes, 2)."""
    forces = np.zeros_like(u)
    for body, stress, one in zip(bodies, stresses, wanted):
        body.pull(u, stress, one, forces)
    return forces


class Stressed:
    """The stress of a body's cells at displacements u (nodes, 2) of all that is drawn."""

    def __init__(self, body):
        modulus, nu = body.plate.material.in_plane
        self.body, self.operator, self.moduli, self.across = body, body.operator, (modulus / (1 - nu**2), nu), body.plate.material.across

    def von_mises(self, stress):
        """(cells,), Pa."""
        return von_mises(stress, self.across * (stress[:, 0] + stress[:, 1]))

    def stress(self, u):
        """Cauchy's, (cells, 3): xx, yy, xy, Pa."""
        operator, out = self.operator, np.empty((self.operator.n_cells, 3))
        element.stress(*operator.force_arrays, operator.lane_cells, operator.areas, self.body.nodes.start, *self.moduli, u, out)
        return out

    def pull(self, u, stress, wanted, forces):
        """forces (nodes, 2) += the slope in u of `wanted (cells,) . von Mises stress`; no slope where that is zero."""
        xx, yy, xy = stress.T
        zz, size = self.across * (xx + yy), self.von_mises(stress)
        out = self.across * (2.0 * zz - xx - yy)
        squares = np.stack([2.0 * xx - yy - zz + out, 2.0 * yy - xx - zz + out, 6.0 * xy])
        toward = squares * np.divide(wanted, 2.0 * size * self.operator.areas, out=np.zeros_like(size), where=size > 0)
        by_lanes = np.moveaxis(toward[:, self.operator.lane_cells].reshape(3, -1, LANES), 0, 1)
        arrays = *self.operator.force_arrays, np.ascontiguousarray(by_lanes), *self.moduli
        kernels.stress_pull(*arrays, np.ascontiguousarray(u[self.body.nodes]), forces[self.body.nodes])

    def by_parameters(self, work):
        """(parameter, slope) of a sum whose parts `work` (cells,) grow with the stress of the cells."""
        yield f"{self.body.name}.stiffness", work / self.body.factors[0]
        yield f"{self.body.name}.E", float(work.sum()) / self.body.plate.material.E
