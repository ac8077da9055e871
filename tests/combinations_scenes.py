"""Random scenes of all parts of polyida, by recipe: two or three bodies in a chain, what joins, drives, loads and changes them.

A Recipe holds names and seeds alone, so that `repr` of it is a reproduction; `build` makes its scene in any World: another place, turn or
mirror image, other units, another order of its parts.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from combinations_own import OwnBar, Stretchy
from combinations_parts import ENDS, EVENTS, LINKS, PARTS, PLAIN_PARTS

import polyida as pi

UNITS = {  # powers of (length, mass, time)
    "1": (0, 0, 0),
    "m": (1, 0, 0),
    "kg": (0, 1, 0),
    "s": (0, 0, 1),
    "1/s": (0, 0, -1),
    "m/s": (1, 0, -1),
    "m/s2": (1, 0, -2),
    "N": (1, 1, -2),
    "N s": (1, 1, -1),
    "N/m": (0, 1, -2),
    "N s/m": (0, 1, -1),
    "N m": (2, 1, -2),
    "N m s": (2, 1, -1),
    "kg m2": (2, 1, 0),
    "kg/m3": (-3, 1, 0),
    "Pa": (-1, 1, -2),
    "V s": (2, 1, -1),  # of motors in units where a coulomb is a coulomb
    "V": (2, 1, -2),
    "N/m^1.5": (-0.5, 1, -2),
    "s/m": (-1, 0, 1),
}
DURATION = 0.3  # s
RIGID = "RigidBody", "Rigid", "OwnBar"
BODIES = (*RIGID, *RIGID, "Reduced", "Plate", "Stretchy")


@dataclass(frozen=True)
class World:
    """Where a scene is, how it is turned and mirrored, its units as numbers of m, kg and s, and the order of its parts (a seed)."""

    shift: tuple = (0.0, 0.0)
    turn: float = 0.0
    mirrored: bool = False
    units: tuple = (1.0, 1.0, 1.0)
    order: int = 0

    def of(self, value, unit):
        """A number of a unit of SI in the units of the world."""
        return value * float(np.prod([size**-power for size, power in zip(self.units, UNITS[unit])]))

    def vector(self, x, y, unit):
        """Components of a vector (x, y)."""
        z = np.exp(1j * self.turn) * complex(x, -y if self.mirrored else y)
        return self.of(z.real, unit), self.of(z.imag, unit)

    def place(self, x, y):
        """Coordinates of a place (x, y)."""
        moved = np.add(self.vector(x, y, "m"), np.multiply(self.of(1.0, "m"), self.shift))
        return tuple(moved.tolist())

    def angle(self, value):
        """An angle, or a moment, seen from the other side of a mirror."""
        return -value if self.mirrored else value

    def back(self, x):
        """Places (..., 2) of the world as they are in the world as drawn, in m."""
        z = np.asarray(x) @ [1.0, 1j] * self.units[0] - complex(*self.shift)
        z = z * np.exp(-1j * self.turn)
        return np.stack([z.real, -z.imag if self.mirrored else z.imag], axis=-1)


PLAIN = World()


@dataclass(frozen=True)
class Recipe:
    """Bodies, what holds each to the one before (the first: to the ground), other parts, and events: pairs (name, seed)."""

    seed: int
    bodies: tuple
    links: tuple
    parts: tuple = ()
    events: tuple = ()

    def without(self):
        """Simpler recipes: one part or event less, or a rigid body in place of another."""
        for name in ("parts", "events"):
            items = getattr(self, name)
            for k in range(len(items)):
                yield replace(self, **{name: items[:k] + items[k + 1 :]})
        for k, (kind, seed) in enumerate(self.bodies):
            if kind != "RigidBody":
                yield replace(self, bodies=(*self.bodies[:k], ("RigidBody", seed), *self.bodies[k + 1 :]))


def recipe(seed):
    """The recipe of a seed."""
    random = np.random.default_rng(seed)

    def some(names, count):
        return tuple((str(random.choice(names)), int(random.integers(10**6))) for _ in range(count))

    bodies = some(BODIES if seed % 4 == 0 else RIGID, random.choice([2, 2, 3]))
    laws = seed % 3 == 0  # most scenes without: few integrators and no gradient take events beside laws
    slow = seed % 5 == 0  # parts in Python: so are the loops of all integrators
    links = [name for name in LINKS if laws or not has_law(name)]
    parts = [name for name in PARTS if (laws or not has_law(name)) and (slow or name not in PLAIN_PARTS)]
    first = [name for name in links if name not in ("Weld", "Clamp")]
    events = some([*EVENTS], random.choice([0, 0, 1] if laws else [0, 1, 2]))
    return Recipe(seed, bodies, (*some(first, 1), *some(links, len(bodies) - 1)), some(parts, random.integers(1, 5)), events)


def has_law(name):
    """True if what a name stands for has contact or dry friction."""
    return name.endswith("friction") or name in ("Contact", "Clearance")


@dataclass
class Built:
    """What is made of a recipe in a world: `ends` (bodies of the chain, 2) are attachments, `points` where they are drawn."""

    world: World
    parts: list = field(default_factory=list)
    events: list = field(default_factory=list)
    points: list = field(default_factory=list)
    bodies: list = field(default_factory=list)
    model: object = None

    def at(self, k, name, across=False):
        """An attachment of body k, with a direction: along the body, or across it as of a plate's ends."""
        body = self.bodies[k]
        if isinstance(body, (pi.Plate, pi.Rigid, pi.Reduced)):
            return body.section(name)
        return body.at(name, (0.0, 1.0)) if across else body.at(name)

    @property
    def ends(self):
        """All ends of all bodies."""
        return [self.at(k, name) for k in range(len(self.bodies)) for name in ENDS]

    def drawn(self, k, name):
        """Where an end of body k is drawn, complex."""
        return self.points[k][ENDS.index(name)]

    def ground(self, place, direction=None):
        """A place of the ground, drawn at a complex number; a line keeps its left side on the left also in a mirror."""
        at = self.world.place(place.real, place.imag)
        if direction is None:
            return pi.ground.at(at)
        sign = -1.0 if self.world.mirrored else 1.0
        return pi.ground.at(at, self.world.vector(sign * direction.real, sign * direction.imag, "1"))


def build(recipe, world=PLAIN):
    """The Built of a recipe. Raises InputError of polyida."""
    made = Built(world)
    corner = 0j
    for k, (kind, seed) in enumerate(recipe.bodies):
        random = np.random.default_rng(seed)
        length, angle = random.uniform(0.6, 1.2), random.uniform(-1.2, 1.2)
        made.points.append((corner, corner + length * np.exp(1j * angle)))
        made.bodies.append(_body(kind, random, world, corner, length, angle, f"body {k}"))
        corner = made.points[-1][1]
    for k, (kind, seed) in enumerate(recipe.links):
        made.parts += LINKS[kind](made, k, np.random.default_rng(seed))
    for k, (kind, seed) in enumerate(recipe.parts):
        made.parts += [replace(part, name=f"{kind} {k}") for part in PARTS[kind](made, np.random.default_rng(seed))]
    for k, (kind, seed) in enumerate(recipe.events):
        made.events.append(EVENTS[kind](made, np.random.default_rng(seed), f"{kind} {k}"))
    gx, gy = world.vector(0.5, -9.81, "m/s2")
    scene = pi.Scene(gravity=(gx, gy))
    everything = [*made.bodies, *made.parts]
    for k in np.random.default_rng([recipe.seed, world.order]).permutation(len(everything)):
        scene.add(everything[k])
    made.model = scene.build()
    return made


def _body(kind, random, world, corner, length, angle, name):
    mass, height, spin = random.uniform(0.5, 2.0), 0.2, random.choice([0.0, random.uniform(-2, 2)])
    still = spin == 0.0
    velocity = world.vector(*([0.0, 0.0] if still else random.uniform(-1, 1, 2)), "m/s")
    pose = {"angle": world.angle(angle) + world.turn, "velocity": velocity, "spin": world.angle(world.of(spin, "1/s")), "name": name}
    m, size = world.of(mass, "kg"), world.of(length, "m")
    if kind == "RigidBody":
        points = {"left": (0.0, 0.0), "center": (0.5 * size, 0.0), "right": (size, 0.0)}
        inertia = world.of(mass * length**2 / 10, "kg m2")
        return pi.RigidBody(m, inertia, points, origin=world.place(corner.real, corner.imag), center=(0.45 * size, 0.0), **pose)
    if kind in ("OwnBar", "Stretchy"):
        more = {"stiffness": world.of(random.uniform(100, 1000), "N/m")} if kind == "Stretchy" else {}
        make = {"OwnBar": OwnBar, "Stretchy": Stretchy}[kind]
        return make(m, size, world.place(corner.real, corner.imag), **more, **pose)
    mesh = pi.mesh.quads(size, world.of(height, "m"), 2, 2)
    damping = random.choice(["none", "damped", "prony"])
    damped = {"viscosity": world.of(1e-3, "s"), "mass_damping": world.of(0.5, "1/s")} if damping == "damped" else {}
    prony = ((0.3, world.of(0.05, "s")), (0.2, world.of(0.4, "s")))[: random.integers(1, 3)] if damping == "prony" else ()
    material = pi.Material(world.of(10 ** random.uniform(6, 7), "Pa"), 0.3, world.of(1000.0, "kg/m3"), prony=prony, **damped)
    plate = pi.Plate(mesh, material, world.of(0.01, "m"), origin=world.place(corner.real, corner.imag), **pose)
    return {"Plate": lambda: plate, "Rigid": lambda: pi.Rigid(plate), "Reduced": lambda: pi.Reduced(plate, modes=2)}[kind]()
