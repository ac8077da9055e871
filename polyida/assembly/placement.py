"""Bodies and loads in their places among the pairs of q."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from polyida.body.body import Body, coordinates_of, form_of, mass_of, translation_of, writes
from polyida.body.plate import Plate
from polyida.body.rigid_body import PointMass
from polyida.element.operator import ReferenceOperator
from polyida.force.loads import EdgeTraction, PointLoad
from polyida.profile import Profile
from polyida.validation import complex_of_pairs, pairs_of, read_only, settle

NOTHING = 1e-12  # of the largest mass of a body: that is none
GRAVITY = "gravity"  # what its work is called


@dataclass(frozen=True, eq=False)
class PlacedPlate:
    """A plate: `nodes` is its slice of the pairs, or of the nodes that are drawn; factors: of the stiffness and of the mass of its cells,
    (cells,) each; operator: its element's on its mesh, weights, mass and stabilisation times these.
    """

    name: str
    plate: Plate
    operator: ReferenceOperator
    nodes: slice
    factors: tuple = ()

    def __post_init__(self):
        settle(self, factors=self.factors or 2 * (read_only(np.ones(self.mesh.n_cells)),))

    @property
    def pairs(self):
        """Its slice of the pairs of q."""
        return self.nodes

    @property
    def damped(self):
        """Whether its material brakes motion."""
        return self.plate.material.damped

    @property
    def mesh(self):
        """The plate's mesh, turned by its angle."""
        return self.plate.placed

    @property
    def points(self):
        """Reference positions, (N, 2), m."""
        return self.plate.points

    @cached_property
    def translation(self):
        """T: each node moves as the whole."""
        return np.ones(self.mesh.n_nodes)

    @cached_property
    def pull(self):
        """M T, (nodes,), kg."""
        return np.add.reduceat(self.operator.mass, self.operator.indptr[:-1]) * self.plate.material.rho * self.plate.thickness

    @property
    def whole_mass(self):
        """Its mass, kg."""
        return float(self.pull.sum())

    def weight(self, gravity):
        """Gravity on its nodes, (nodes, 2), N."""
        return np.outer(self.pull, gravity)

    def held(self, side, part):
        """(pairs of q, complex weights) of which an attachment's "point" or "direction" is the sum."""
        weights = side.weights if part == "point" else side.turn_weights
        return side.nodes + self.nodes.start, weights.astype(complex)

    def loaded(self, side, forces):
        """(pairs of q, forces (., 2) on them) of forces on an attachment's nodes."""
        return side.nodes + self.nodes.start, forces


class PlacedBody:
    """A body of few coordinates: `pairs` is its slice of the pairs of q; rest (pairs,) complex.

    user: the body as it was given, which attachments know; body: as `settled` by what the scene's parts hold on to. mass: Hermitian, or
    None where x and y carry different ones: `uneven`, (2 pairs, 2 pairs), then.
    """

    def __init__(self, name, user, first, held):
        self.name, self.user, self.body = name, user, user.prepared(held)
        self.rest = coordinates_of(self.body)
        self.pairs = slice(first, first + len(self.rest))
        self.mass, self.uneven = mass_of(self.body)
        self.translation, self.form = translation_of(self.body), form_of(self.body)

    @property
    def python(self):
        """Whether kernels cannot do without Python."""
        return self.uneven is not None or (self.elastic and not self.body.compiled_functions())

    @cached_property
    def massless(self):
        """Whether some of its coordinates have no mass."""
        matrix = self.mass if self.uneven is None else self.uneven
        sizes = np.linalg.eigvalsh(matrix)
        return bool(sizes[0] <= NOTHING * sizes[-1])

    @cached_property
    def pull(self):
        """M T, (pairs,), complex, kg."""
        return complex_of_pairs(self.weight((1.0, 0.0)))

    @property
    def whole_mass(self):
        """Its mass, kg: `T^H M T`."""
        return float(abs(np.vdot(self.translation, self.pull)))

    @property
    def spread(self):
        """The centre of mass, moved to either side by the radius of gyration, (2, 2), m; nothing, (0, 2), where it has no mass as a whole."""
        mass = self.whole_mass
        if self.uneven is not None or not mass > 0:
            return np.zeros((0, 2))
        centre = np.vdot(self.pull, self.rest) / mass
        square = np.vdot(self.rest, self.mass @ self.rest).real / mass - abs(centre) ** 2
        return pairs_of(centre + np.array([1.0, -1.0]) * np.sqrt(max(0.0, square)))

    @property
    def elastic(self):
        """Whether it has an elastic force of its own: kernels take a form in place of it."""
        return self.form is None and writes(self.body, Body, "elastic")

    @property
    def damped(self):
        """Whether its material brakes motion."""
        return any(self.body.damping())

    @property
    def deforms(self):
        """Whether it deforms at all."""
        return self.elastic or self.form is not None

    @cached_property
    def axis(self):
        """Weights (pairs,) of the vector that turns with it."""
        given = self.body.x_axis()
        return np.zeros(len(self.rest), complex) if given is None else np.asarray(given, complex)

    def weight(self, gravity):
        """Gravity on its pairs, `M T g`, (pairs, 2), N."""
        pull = self.translation * complex(*gravity)
        return pairs_of(self.mass @ pull) if self.uneven is None else (self.uneven @ pairs_of(pull).ravel()).reshape(-1, 2)

    def held(self, side, part):
        """(pairs of q, complex weights) of which an attachment's "point" or "direction" is the sum."""
        weights = self.body.weights_of(side, part)
        used = np.flatnonzero(weights)
        return (used + self.pairs.start).astype(np.int32), weights[used]

    def loaded(self, side, forces):
        """(pairs of q, forces (., 2) on them) of forces on an attachment's nodes."""
        shares = self.body.pair_forces(side, complex_of_pairs(forces))
        return np.arange(self.pairs.start, self.pairs.stop, dtype=np.int32), pairs_of(shares)


def steady(gravity):
    """(gx, gy), m/s^2, of numbers and profiles: zero for a profile."""
    return tuple(0.0 if isinstance(g, Profile) else float(g) for g in gravity)


def gravity_at(gravity, t):
    """(gx, gy), m/s^2, of numbers and profiles, at time t."""
    return tuple(float(g(t)) if isinstance(g, Profile) else float(g) for g in gravity)


def largest(gravity):
    """|g|, m/s^2, the largest of profiles at the start and at their kinks."""
    values = [max(abs(g(t)) for t in (0.0, *g.kinks)) if isinstance(g, Profile) else abs(g) for g in gravity]
    return float(np.hypot(*values))


@dataclass(frozen=True)
class Dead:
    """Forces (k, 2), N, on pairs of q, times a profile."""

    name: str
    profile: Profile
    pairs: np.ndarray
    forces: np.ndarray

    def power(self, t, v):
        """W, of velocities v (n,)."""
        return float(self.profile.value(t) * np.vdot(self.forces, v.reshape(-1, 2)[self.pairs]))


def dead_loads(parts, gravity, places):
    """The loads among the parts, and gravity's components that are profiles, all as Dead. places: {id of a body: its place}."""
    loads = [(name, part) for name, part in parts.items() if isinstance(part, (PointLoad, EdgeTraction))]
    found = [Dead(name, load.profile, *places[id(load.at.body)].loaded(load.at, load.nodal())) for name, load in loads]
    return found + [_pull(g, parts, places, axis) for g, axis in zip(gravity, np.eye(2)) if isinstance(g, Profile)]


def _pull(profile, parts, places, axis):
    """An acceleration of one along an axis, on all that has mass."""
    forces = np.zeros((max(place.pairs.stop for place in places.values()), 2))
    for place in places.values():
        forces[place.pairs] += place.weight(axis)
    for mass in parts.values():
        if isinstance(mass, PointMass):
            pairs, values = places[id(mass.at.body)].loaded(mass.at, mass.at.share(mass.mass * axis))
            np.add.at(forces, pairs, values)
    return Dead(GRAVITY, profile, np.arange(len(forces)), forces)
