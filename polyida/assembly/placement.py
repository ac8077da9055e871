"""Bodies and loads in their places among the pairs of q."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from polyida.body.body import Body, coordinates_of, form_of, mass_of, points_of, translation_of, writes
from polyida.body.plate import prony_series
from polyida.body.rigid_body import PointMass
from polyida.force.controllers import Controller
from polyida.force.force_element import Side
from polyida.force.loads import EdgeTraction, PointLoad
from polyida.profile import Profile
from polyida.validation import complex_of_pairs, pairs_of, read_only

NO_MASS = 1e-12  # of the largest mass of a body
GRAVITY = "gravity"  # name of its work


class PlacedPlate:
    """A plate. nodes: its slice of the pairs of q, or of the drawn nodes. operator: weights, mass and stabilisation include the factors.

    factors: (stiffness (cells,), mass (cells,)) of its cells. mesh: turned by the plate's angle. translation, T (nodes,): velocity of each
    node for a unit velocity of the body. user: the plate too, as of PlacedBody.
    """

    is_full = True  # the plates of a scene come first in q, behind them its bodies of few coordinates

    def __init__(self, name, plate, operator, nodes, factors=None):
        """nodes: slice of its nodes among all pairs of the scene. factors: of stiffness and mass of its cells, 1 by default."""
        self.name, self.plate, self.user, self.operator = name, plate, plate, operator
        self.nodes = self.pairs = nodes
        self.extreme_points = plate.points  # (., 2), m, between which the body lies
        self.mesh, self.points, self.damped = plate.placed, plate.points, plate.material.damped
        self.factors = factors or 2 * (read_only(np.ones(self.mesh.n_cells)),)
        self.translation, self.strain_size = np.ones(self.mesh.n_nodes), 1.0

    def scaled(self, operator, factors):
        """This plate with other factors, and the operator that includes them."""
        return PlacedPlate(self.name, self.plate, operator, self.nodes, factors)

    @cached_property
    def translation_momentum(self):
        """M T, the momentum of a unit velocity of the body, (nodes,), kg."""
        return np.add.reduceat(self.operator.mass, self.operator.indptr[:-1]) * self.plate.material.rho * self.plate.thickness

    @property
    def prony(self):
        """Terms (g, tau) of its relaxation."""
        return self.plate.material.prony

    @property
    def strains(self):
        """Number of strains that relax: three at each point."""
        return 3 * len(self.operator.weights)

    @property
    def whole_mass(self):
        """Mass of the whole plate, kg."""
        return float(self.translation_momentum.sum())

    @property
    def trace_of_mass(self):
        """Sum of the masses of its pairs, kg."""
        return self.whole_mass

    def weight(self, gravity):
        """Gravity on the nodes, (nodes, 2), N."""
        return np.outer(self.translation_momentum, gravity)

    def pairs_and_weights(self, side, part):
        """(pairs of q, complex weights) whose sum is an attachment's "point" or "direction"."""
        weights = side.weights if part == "point" else side.turn_weights
        return side.nodes + self.nodes.start, weights.astype(complex)

    def loaded(self, side, forces):
        """(pairs of q, forces (., 2) on them) of forces on an attachment's nodes."""
        return side.nodes + self.nodes.start, forces


class PlacedBody:
    """A body of few coordinates. pairs: its slice of the pairs of q; rest (pairs,): complex coordinates in the reference configuration.

    user: the body as the user made it, which attachments refer to; body: as `prepared` by what the scene's parts hold on to. mass: Hermitian
    matrix of the pairs, or None if x and y have different masses; then `uneven`, (2 pairs, 2 pairs). elastic: True if the user wrote its
    elastic force, which has no form for the kernels. axis (pairs,): weights of the vector that turns with the body; zero without one.
    """

    is_full = False

    def __init__(self, name, user, first, attachments):
        """first: number of its first pair. attachments: of the parts that use the body."""
        self.name, self.user, self.body = name, user, user.prepared(attachments)
        self.rest = coordinates_of(self.body)
        self.pairs = slice(first, first + len(self.rest))
        self.mass, self.uneven = mass_of(self.body)
        self.translation, self.form = translation_of(self.body), form_of(self.body)
        self.elastic = self.form is None and writes(self.body, Body, "elastic")
        self.deforms, self.damped = self.elastic or self.form is not None, any(self.body.damping())
        weights = self.body.x_axis()
        self.axis = np.zeros(len(self.rest), complex) if weights is None else np.asarray(weights, complex)

    def damping(self):
        """(Rayleigh mass coefficient, 1/s; Kelvin-Voigt time, s)."""
        return self.body.damping()

    @property
    def prony(self):
        """Terms (g, tau) of its relaxation."""
        return prony_series(self.body.label, "prony", self.body.prony()) if self.form is not None else ()

    @property
    def strains(self):
        """Number of strains that relax: those of y."""
        return len(self.form[1])

    @property
    def strain_size(self):
        """Size of y in the reference configuration, m^2 of a reduced plate."""
        return float(np.vdot(self.rest[1:], self.rest[1:]).real) or 1.0

    @property
    def python(self):
        """True if its forces or its mass need Python."""
        return self.uneven is not None or (self.elastic and not self.body.compiled_functions())

    @cached_property
    def massless(self):
        """True if some of its coordinates have no mass."""
        sizes = np.linalg.eigvalsh(self.mass if self.uneven is None else self.uneven)
        return bool(sizes[0] <= NO_MASS * sizes[-1])

    @cached_property
    def translation_momentum(self):
        """M T, (pairs,), complex, kg."""
        return complex_of_pairs(self.weight((1.0, 0.0)))

    @property
    def whole_mass(self):
        """Mass `T^H M T`, kg."""
        return float(abs(np.vdot(self.translation, self.translation_momentum)))

    @property
    def trace_of_mass(self):
        """Sum of the masses of its pairs, kg; zero if x and y have different masses."""
        return 0.0 if self.mass is None else float(np.trace(self.mass).real)

    @property
    def extreme_points(self):
        """Points (., 2), m, between which the body lies: the nodes of its plate, or its named points and those of `_gyration_points`."""
        if self.body.plate is not None:
            return self.body.plate.points
        return np.concatenate([*(point.point[None] for point in points_of(self.body)), self._gyration_points])

    @property
    def _gyration_points(self):
        """The centre of mass plus and minus the radius of gyration, (2, 2), m; (0, 2) if the body has no mass as a whole."""
        mass = self.whole_mass
        if self.uneven is not None or not mass > 0:
            return np.zeros((0, 2))
        centre = np.vdot(self.translation_momentum, self.rest) / mass
        square = np.vdot(self.rest, self.mass @ self.rest).real / mass - abs(centre) ** 2
        return pairs_of(centre + np.array([1.0, -1.0]) * np.sqrt(max(0.0, square)))

    def weight(self, gravity):
        """Gravity on the pairs, `M T g`, (pairs, 2), N."""
        acceleration = self.translation * complex(*gravity)
        if self.uneven is None:
            return pairs_of(self.mass @ acceleration)
        return (self.uneven @ pairs_of(acceleration).ravel()).reshape(-1, 2)

    def pairs_and_weights(self, side, part):
        """(pairs of q, complex weights) whose sum is an attachment's "point" or "direction"."""
        weights = self.body.weights_of(side, part)
        used = np.flatnonzero(weights)
        return (used + self.pairs.start).astype(np.int32), weights[used]

    def loaded(self, side, forces):
        """(pairs of q, forces (., 2) on them) of forces on an attachment's nodes."""
        shares = self.body.pair_forces(side, complex_of_pairs(forces))
        return np.arange(self.pairs.start, self.pairs.stop, dtype=np.int32), pairs_of(shares)


class PlacedStates:
    """The states of a force element: the velocities of auxiliary coordinates of mass `mass`, `s_k = units_k v`.

    The equation of such a coordinate, `mass (v' - s'/units) = 0`, has the form of an equation of motion, so that integrators know nothing
    of states. pairs: their slice of the pairs of q; an odd number of states leaves the last component unused. speed: the velocity that
    stands for a state of typical size, m/s.
    """

    form = None

    def __init__(self, name, element, first, mass, speed):
        """first: number of its first pair. mass, speed: those that stand for a state of typical size."""
        outputs = element.outputs if isinstance(element, Controller) else ()
        self.name, self.own, self.names = name, len(element.states), (*element.states, *outputs)
        count, self.controls = len(self.names), bool(outputs)
        sizes, start = (
            np.append(np.array(values, float)[: self.own], fill(len(outputs)))
            for values, fill in ((element.sizes(), np.ones), (element.start(), np.zeros))
        )
        self.units, self.start = sizes / speed, start
        self.speed, self.scale = speed, mass / self.units
        self.pairs = slice(first, first + (count + 1) // 2)
        self.columns = np.arange(2 * first, 2 * first + count)
        self.rest = self.translation = self.axis = np.zeros(self.pairs.stop - first, complex)
        self.mass = mass * np.eye(len(self.rest), dtype=complex)

    def damping(self):
        """(0, 0): states have no damping."""
        return 0.0, 0.0

    def weight(self, gravity):
        """(pairs, 2) zeros: states have no weight."""
        return np.zeros((len(self.rest), 2))

    def pairs_and_weights(self, side, part):
        """(pairs of q, complex weights) of one of `sides`."""
        return np.array([side.pair], np.int32), np.ones(1, complex)

    def sides(self):
        """The coordinates as sides of the element."""
        return tuple(StateSide(StatePair(self, pair), "point", np.zeros(2)) for pair in range(self.pairs.start, self.pairs.stop))

    def states_of(self, rows):
        """(states,), and of a controller (states, outputs), from velocities of the sides, (pairs, 2)."""
        values = self.units * rows.ravel()[: len(self.units)]
        return (values[: self.own], values[self.own :]) if self.controls else (values,)

    def forces_of(self, rates):
        """The forces on the sides, (pairs, 2), of the states' derivatives."""
        forces = np.zeros(2 * len(self.rest))
        forces[: len(rates)] = self.scale[: len(rates)] * rates
        return forces.reshape(-1, 2)


class PlacedStrains(PlacedStates):
    """The relaxed strains of a viscoelastic plate, states of no force element (relaxation.py). terms: (g, tau) of each; mass: of each pair."""

    def __init__(self, body, first, mass, unit):
        """first: number of its first pair. mass: of these coordinates. unit: strain for a velocity of 1."""
        self.name, self.terms, strains = body.name, body.prony, body.strains
        self.padded = strains + strains % 2  # numbers of a term
        whole = self.padded * len(self.terms)
        self.columns = 2 * first + np.arange(whole).reshape(len(self.terms), -1)[:, :strains].ravel()
        self.units, self.start = np.full(len(self.columns), unit), np.zeros(len(self.columns))
        self.pairs = slice(first, first + whole // 2)
        self.rest = self.translation = np.zeros(whole // 2, complex)
        self.mass = mass

    def viscous_strain_of(self, v):
        """sum g x, (strains,), of velocities v (n,) of a scene."""
        return np.array([g for g, _ in self.terms]) @ (self.units * v[self.columns]).reshape(len(self.terms), -1)


@dataclass(frozen=True, eq=False)
class StatePair:
    """A pair of states as an attachment."""

    body: PlacedStates
    pair: int


class StateSide(Side):
    """A pair of states as a side of a force element."""

    def size(self, extent):
        """The velocity that stands for a state of typical size."""
        return self.at.body.speed


def steady(gravity):
    """(gx, gy), m/s^2, of numbers and profiles: zero for a profile."""
    return tuple(0.0 if isinstance(g, Profile) else float(g) for g in gravity)


def gravity_at(gravity, t):
    """(gx, gy), m/s^2, of numbers and profiles, at time t."""
    return tuple(float(g(t)) if isinstance(g, Profile) else float(g) for g in gravity)


def gravity_over(gravity, t):
    """(gx, gy), m/s^2, of numbers and profiles, at times t (k,), (k, 2)."""
    return np.stack([g.over(t) if isinstance(g, Profile) else np.full(len(t), float(g)) for g in gravity], axis=1)


@dataclass(frozen=True)
class Dead:
    """Dead load: forces (k, 2), N, on pairs of q, times a profile."""

    name: str
    profile: Profile
    pairs: np.ndarray
    forces: np.ndarray

    def power(self, t, v):
        """Power, W, of the load at velocities v (n,)."""
        return float(self.profile.value(t) * np.vdot(self.forces, v.reshape(-1, 2)[self.pairs]))


def dead_loads(parts, gravity, places):
    """The loads among the parts, and the components of gravity that are profiles, as Dead. places: {id of a body: its place}."""
    loads = [(name, part) for name, part in parts.items() if isinstance(part, (PointLoad, EdgeTraction))]
    result = [Dead(name, load.profile, *places[id(load.at.body)].loaded(load.at, load.nodal())) for name, load in loads]
    for g, axis in zip(gravity, np.eye(2)):
        if isinstance(g, Profile):  # a unit acceleration of all that has mass
            forces = np.zeros((max(place.pairs.stop for place in places.values()), 2))
            for place in places.values():
                forces[place.pairs] += place.weight(axis)
            for mass in (part for part in parts.values() if isinstance(part, PointMass)):
                pairs, values = places[id(mass.at.body)].loaded(mass.at, mass.at.share(mass.mass * axis))
                np.add.at(forces, pairs, values)
            result.append(Dead(GRAVITY, g, np.arange(len(forces)), forces))
    return result
