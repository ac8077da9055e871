"""How much the material has to bear, and how much energy is in the deformation of bodies."""

from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from polyida.assembly.build import compact_of
from polyida.assembly.factors import Shares
from polyida.element import kernels as element
from polyida.jit.intrinsics import LANES
from polyida.objective import kernels
from polyida.objective.slopes import Slopes
from polyida.objective.time_mean import TimeMean, chosen, deforming, named, power, power_mean, relative
from polyida.results.motion import von_mises
from polyida.validation import named_keywords, settle


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


@named_keywords
@dataclass(frozen=True, eq=False)
class StrainEnergy(TimeMean):
    """Time mean of the strain energy, J, of all bodies or of one, as `run.energy.strain`.

    plate: a plate or a body that deforms, by name or itself; None: all. With factors of cells it is that of the scaled cells. Raises
    InputError of a run for what is no such body of its scene.
    """

    plate: Any = None
    _of_material = True

    def named(self, model: Any) -> "StrainEnergy":
        """By the name of its body."""
        return replace(self, plate=named(model, self.plate))

    def _seen(self, model, span):
        """The energy."""
        elastic = Elastic(model, chosen("StrainEnergy", model, self.plate, deforming(model)))

        def look(frames):
            def back(factor):
                return Slopes(q=elastic.forces(frames.q, factor), direct=elastic.by_parameters(frames.q, factor))

            return lambda: elastic.energies(frames.q), back

        return look


class Elastic:
    """The elastic energy of some bodies of a scene and its slopes: the scene's own kernels on arrays that hold nothing else."""

    def __init__(self, model, bodies):
        self.model, names = model, {body.name for body in bodies}
        self.plates = [body for body in model.bodies if body.name in names]
        self.own = [own for own in model.own_forces.each if own.strain and own.name in names]
        s, numbers = model.arrays.plates, [k for k, body in enumerate(model.bodies) if body.name in names]
        of_bodies = {name: getattr(s, name)[numbers] for name in s._fields if name.startswith("body_")}
        self.arrays = model.arrays._replace(
            plates=s._replace(**of_bodies, weight=np.zeros_like(s.weight), load_drive=s.load_drive[:0]),
            links=model.arrays.links._replace(gravity=np.zeros(2)),
            compact=compact_of([_body(placed, names) for placed in model.few], int(model.arrays.compact.pair[0]), 0),
        )
        self.still, self.none, self.drives = np.zeros((model.n_nodes, 2)), np.zeros(model.m), model.drives(0.0)

    def energies(self, q):
        """Of frames q (count, n), (count,), J."""
        found = np.empty(len(q))
        kernels.energies(self.arrays, _pairs(q, self.model), found)
        return found + sum(np.array([own.energy(own.places(each)) for each in q]) for own in self.own)

    def forces(self, q, factor):
        """factor (count,) times their slopes in q, (count, n)."""
        model, found = self.model, np.empty((len(q), *self.still.shape))
        room = np.empty(model.m), np.empty((2, model.n_points, 2))
        kernels.forces(self.arrays, self.drives, _pairs(q, model), self.still, self.none, np.asarray(factor, float), *room, found)
        found = found.reshape(len(q), -1)
        for own in self.own:
            for each, f, r in zip(q, factor, found):
                x = own.places(each)
                r -= f * (own.A.T @ own.forces(0.0, x, np.zeros_like(x)).ravel())
        return found

    def by_parameters(self, q, factor):
        """{parameter: slope of the sum of factor times energy} over frames q (count, n)."""
        found = {}
        for body in self.plates:
            cells = _cell_energies(self.model, body, q, factor)
            found[f"{body.name}.stiffness"] = cells
            whole = float(body.factors[0] @ cells)
            found |= {f"{body.name}.E": whole / body.plate.material.E, f"{body.name}.thickness": whole / body.plate.thickness}
        return found


def _pairs(q, model):
    return np.ascontiguousarray(q, float).reshape(-1, model.n_nodes, 2)


def _body(placed, names):
    """A body of few coordinates, without elastic form unless it is of these names."""
    other = copy(placed)
    other.form = placed.form if placed.name in names else None
    return other


def _cell_energies(model, body, q, factor):
    """Sum over frames q (count, n) of factor times the energy of every cell of a plate at a factor of 1, (cells,), J."""
    s, number = model.arrays.plates, model.bodies.index(body)
    u, operator = q.reshape(len(q), -1, 2)[:, body.nodes], body.operator
    found = np.zeros(operator.n_cells)
    for one, f in zip(u, factor):
        kernels.cell_energies(
            *operator.force_arrays, operator.lane_cells, s.body_c1[number], s.body_nu[number], np.ascontiguousarray(one), f, found
        )
    return found / body.factors[0] + _stabilised(model, number, u, factor)


def _stabilised(model, number, u, factor):
    """The same of a virtual element's stabilisation: `-t tr(C) S_ij |u_i - u_j|^2 / 4` of every pair of nodes."""
    scale, operator = model.arrays.plates.body_stabilisation[number], model.bodies[number].operator
    if not scale:
        return 0.0
    shares = model.once(Shares, of_shape=True)
    rows, squares = np.repeat(np.arange(operator.n_nodes), np.diff(operator.indptr)), np.zeros(len(shares.plates.stabilisation))
    apart = squares[slice(*shares.plates.at[number : number + 2, 6])]
    for one, f in zip(u, factor):
        apart += f * np.sum((one[rows] - one[operator.indices]) ** 2, axis=1)
    return -0.25 * scale * shares.by_plate(shares.stabilisation.slopes(squares, shares.first[-1]))[model.bodies[number].name]
