"""Random scenes of all parts of polyida, by recipe: two or three bodies in a chain, what joins, drives, loads and changes them.

A Recipe holds names and seeds alone, so that `repr` of it is a reproduction; `build` makes its scene in any World: another place, turn or
mirror image, other units, another order of its parts.
"""

from dataclasses import dataclass, field, replace

import numpy as np

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
ENDS = "left", "right"


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


@dataclass(frozen=True, eq=False)
class OwnBar(pi.Body):
    """A rigid bar whose first pair is a point ahead of the centre of mass: M is not diagonal."""

    mass: float
    length: float
    origin: tuple
    angle: float
    velocity: tuple = (0.0, 0.0)
    spin: float = 0.0
    name: str | None = None

    def coordinates(self):
        z = np.exp(1j * self.angle)
        return [complex(*self.origin) + 0.3 * self.length * z, self.length * z]

    def mass_matrix(self):
        off = 0.2
        return self.mass * np.array([[1.0, off], [off, 1.0 / 12.0 + off**2]])

    def attachments(self):
        return {name: [1.0, at - 0.3] for name, at in (("left", 0.0), ("center", 0.5), ("right", 1.0))}

    def x_axis(self):
        return [0.0, 1.0 / self.length]

    def rows(self):
        d = self.at("left").d
        return [(pi.dot(d, d) - 1.0) * (0.5 * self.length)]


@pi.compiled
@dataclass(frozen=True, eq=False)
class Stretchy(pi.Body):
    """A straight bar that stretches evenly: z_1 is its own length."""

    mass: float
    length: float
    origin: tuple
    angle: float
    stiffness: float
    velocity: tuple = (0.0, 0.0)
    spin: float = 0.0
    name: str | None = None

    def coordinates(self):
        z = self.length * np.exp(1j * self.angle)
        return [complex(*self.origin) + 0.5 * z, z]

    def mass_matrix(self):
        return self.mass * np.diag([1.0, 1.0 / 12.0])

    def attachments(self):
        return {name: [1.0, at - 0.5] for name, at in (("left", 0.0), ("center", 0.5), ("right", 1.0))}

    def x_axis(self):
        return [0.0, 1.0 / self.length]

    def elastic(self, z):
        size = np.abs(z[1])
        pull = self.stiffness * (size - self.length) / size * z[1]
        return np.array([0.0 * pull, pull])

    def energy(self, z):
        return 0.5 * self.stiffness * (np.abs(z[1]) - self.length) ** 2


class Rod(pi.Joint):
    """A joint of one's own: the distance of two points."""

    def rows(self):
        w = self.b.x - self.a.x
        square = abs(w.rest) ** 2
        return [((pi.dot(w, w) - square) / (2.0 * square**0.5)).named("", "N")]


@dataclass(frozen=True, eq=False)
class Band(pi.ForceElement):
    """A force of one's own with an energy: a spring of rest length 0."""

    a: object
    b: object
    k: float
    name: str | None = None

    def sides(self):
        return self.a, self.b

    def forces(self, t, x, v):
        pull = self.k * (x[1] - x[0])
        return np.stack((pull, -pull))

    def energy(self, x):
        w = x[1] - x[0]
        return 0.5 * self.k * (w[0] * w[0] + w[1] * w[1])


@pi.compiled
@dataclass(frozen=True, eq=False)
class FastBand(Band):
    """The same, compiled."""


@dataclass(frozen=True, eq=False)
class Lag(pi.ForceElement):
    """A force of one's own with a state: a tension `k s` that follows the elongation, `s' = (e - s) / tau`."""

    a: object
    b: object
    k: float
    tau: float
    length: float
    name: str | None = None
    states = ("late",)

    def sides(self):
        return self.a, self.b

    def rates(self, t, x, v, s):
        w = x[1] - x[0]
        return np.array([(np.sqrt(w[0] * w[0] + w[1] * w[1]) - self.length - s[0]) / self.tau])

    def forces(self, t, x, v, s):
        w = x[1] - x[0]
        pull = self.k * s[0] / np.sqrt(w[0] * w[0] + w[1] * w[1]) * w
        return np.stack((pull, -pull))


@pi.compiled
@dataclass(frozen=True, eq=False)
class FastLag(Lag):
    """The same, compiled."""


@dataclass(frozen=True, eq=False)
class Held(pi.Controller):
    """A sampled controller: the tension between two points is held at that of a spring when it was sampled."""

    a: object
    b: object
    k: float
    length: float
    period: float
    name: str | None = None
    outputs = ("tension",)

    def sides(self):
        return self.a, self.b

    def sample(self, t, x, v, s, u):
        return [self.k * (np.linalg.norm(x[1] - x[0]) - self.length)]

    def forces(self, t, x, v, s, u):
        w = x[1] - x[0]
        pull = u[0] / np.sqrt(w[0] * w[0] + w[1] * w[1]) * w
        return np.stack((pull, -pull))


@pi.compiled
@dataclass(frozen=True, eq=False)
class FastHeld(Held):
    """The same, compiled."""


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


# --- links: what holds body k to the one before, or to the ground; each returns parts ---


def _sides(made, k, across=False):
    """The end of the body before, or the ground, and the beginning of body k."""
    return made.at(k - 1, "right", across) if k else pi.ground, made.at(k, "left", across)


def _of_joint(kind, across=False, directed=False, **options):
    def make(made, k, random):
        a, b = _sides(made, k, across)
        if directed and not k:
            a = made.ground(made.drawn(0, "left"), np.exp(1j * random.uniform(-3, 3)))
        more = {key: draw(made.world, random) for key, draw in options.items()}
        return [kind(a, b, name=f"link {k}", **more)]

    return make


def _friction(world, random):
    return random.uniform(0.05, 0.4)


def _pin_radius(world, random):
    return world.of(0.03, "m")


def _motor(made, k, random):
    a, b = _sides(made, k)
    return [pi.Revolute(a, b, name=f"link {k}"), pi.AngleMotor(a, b, _turning(made.world, random), name=f"motor {k}")]


def _turning(world, random):
    """A profile of an angle, rad."""
    size = world.angle(random.uniform(-0.6, 0.6))
    if random.integers(2):
        return pi.profile.quintic(0.0, size, world.of(0.2, "s"), world.of(random.uniform(0.0, 0.1), "s"))
    return pi.profile.sine(size, world.of(random.uniform(0.5, 3.0), "1/s"))


def _spring_link(made, k, random):
    """No joint: a spring and a damper from somewhere else."""
    world, to = made.world, made.drawn(k, "left") + 0.5 * np.exp(1j * random.uniform(-3, 3))
    a = made.at(k - 1, "left") if k else made.ground(to)
    stiffness, damping = world.of(random.uniform(5, 60), "N/m"), world.of(random.uniform(0, 2), "N s/m")
    return [pi.SpringDamper(a, made.at(k, "left"), stiffness, damping, name=f"link {k}")]


def _path(made, k, random):
    """A prescribed path of the point."""
    world, z = made.world, made.drawn(k, "left")
    way = 0.2 * np.exp(1j * random.uniform(-3, 3))
    ends = zip(world.place(z.real, z.imag), world.place((z + way).real, (z + way).imag))
    x, y = (pi.profile.quintic(*pair, world.of(0.25, "s"), world.of(0.02, "s")) for pair in ends)
    return [pi.PrescribedPosition(made.at(k, "left"), x, y, name=f"link {k}")]


def _rolling(made, k, random):
    """A disc about the point rolls on a line or a circle of the ground."""
    world, z, radius = made.world, made.drawn(k, "left"), 0.2
    way = np.exp(1j * random.uniform(-0.5, 0.5))
    if random.integers(2):
        return [pi.RollingDisc(made.ground(z - 1j * radius * way, way), made.at(k, "left"), radius=world.of(radius, "m"), name=f"link {k}")]
    circle = {"radius": world.of(radius, "m"), "circle": world.of(0.5, "m")}
    return [pi.RollingDisc(made.ground(z - 0.7j * way, way), made.at(k, "left"), name=f"link {k}", **circle)]


def _skate(made, k, random):
    return [pi.Skate(made.at(k, "left", across=True), name=f"link {k}")]


def _distance(made, k, random):
    """A rod to a place beside the point."""
    kind, to = random.choice([pi.Distance, Rod]), made.drawn(k, "left") + 0.4 * np.exp(1j * random.uniform(-3, 3))
    return [kind(made.at(k - 1, "left") if k else made.ground(to), made.at(k, "left"), name=f"link {k}")]


def _clearance(made, k, random):
    world = made.world
    a = made.at(k - 1, "right") if k else made.ground(made.drawn(k, "left"), 1 + 0j)
    more = {"friction": random.uniform(0.1, 0.3), "pin_radius": world.of(0.03, "m")} if random.integers(2) else {}
    return [pi.Clearance(a, made.at(k, "left"), gap=world.of(0.01, "m"), restitution=random.choice([0.0, 0.4]), name=f"link {k}", **more)]


LINKS = {
    "Revolute": _of_joint(pi.Revolute),
    "Revolute, friction": _of_joint(pi.Revolute, friction=_friction, pin_radius=_pin_radius),
    "Prismatic": _of_joint(pi.Prismatic, across=True, directed=True),
    "Prismatic, friction": _of_joint(pi.Prismatic, across=True, directed=True, friction=_friction),
    "Slot": _of_joint(pi.Slot, across=True, directed=True),
    "Slot, friction": _of_joint(pi.Slot, across=True, directed=True, friction=_friction),
    "Weld": _of_joint(pi.Weld),
    "Clamp": _of_joint(pi.Clamp),
    "AngleMotor": _motor,
    "PrescribedPosition": _path,
    "RollingDisc": _rolling,
    "Skate": _skate,
    "Distance": _distance,
    "Clearance": _clearance,
    "spring": _spring_link,
}


# --- other parts; each returns a list of parts ---


def _end(made, random):
    """An end of a body: (attachment, where it is drawn)."""
    k, name = int(random.integers(len(made.bodies))), str(random.choice(ENDS))
    return made.at(k, name), made.drawn(k, name)


def _two(made, random):
    """Two points of different bodies, or a place of the ground and a point."""
    b, z = _end(made, random)
    others = [k for k, body in enumerate(made.bodies) if body is not b.body]
    if random.integers(2):
        return made.ground(z + random.uniform(0.3, 0.8) * np.exp(1j * random.uniform(-3, 3))), b
    return made.at(int(random.choice(others)), str(random.choice(ENDS))), b


def _turned(made, random):
    """at=, against= of rotations."""
    k = int(random.integers(len(made.bodies)))
    against = made.at((k + 1) % len(made.bodies), "left") if random.integers(2) else None
    return {"at": made.at(k, "right"), "against": against}


def _spring(made, random):
    world = made.world
    more = {"preload": world.of(random.uniform(-2, 2), "N"), "damping": world.of(random.uniform(0, 3), "N s/m")}
    length = world.of(random.uniform(0.2, 0.6), "m")
    return [pi.SpringDamper(*_two(made, random), world.of(random.uniform(10, 100), "N/m"), length=length, **more)]


def _torsion(made, random):
    world, turned = made.world, _turned(made, random)
    k, c, angle = world.of(random.uniform(1, 5), "N m"), world.of(random.uniform(0, 0.2), "N m s"), random.uniform(-0.5, 0.5)
    return [pi.TorsionSpring(turned["against"] or pi.ground, turned["at"], k, c, angle=world.angle(angle))]


def _wave(world, random):
    """A profile of a load, no unit."""
    if random.integers(2):
        return pi.profile.sine(1.0, world.of(random.uniform(1, 5), "1/s"))
    return pi.profile.linear(0.0, 1.0, world.of(0.1, "s"), world.of(0.05, "s"))


def _load(made, random):
    return [pi.PointLoad(_end(made, random)[0], made.world.vector(*random.uniform(-5, 5, 2), "N"), _wave(made.world, random))]


def _traction(made, random):
    """On the first plate; a load without one."""
    plates = [body for body in made.bodies if isinstance(body, (pi.Plate, pi.Rigid, pi.Reduced))]
    if not plates:
        return _load(made, random)
    return [pi.EdgeTraction(plates[0].section("right"), made.world.vector(*random.uniform(-900, 900, 2), "Pa"), _wave(made.world, random))]


def _force(made, random):
    wave, components = _wave(made.world, random), made.world.vector(*random.uniform(-5, 5, 2), "N")
    force = tuple(pi.profile.scaled(wave, size) for size in components)
    return [pi.Force(_end(made, random)[0], force, follower=bool(random.integers(2)))]


def _torque(made, random):
    moment = made.world.angle(made.world.of(random.uniform(-2, 2), "N m"))
    return [pi.Torque(moment=pi.profile.scaled(_wave(made.world, random), moment), **_turned(made, random))]


def _mass(made, random):
    return [pi.PointMass(_end(made, random)[0], made.world.of(random.uniform(0.1, 1.0), "kg"))]


def _line(made, random, depth):
    """A point and a line of the ground below it, on the far side of gravity or beside."""
    point, z = _end(made, random)
    way = np.exp(1j * random.uniform(-0.6, 0.6))
    return point, made.ground(z - 1j * depth * way, way)


def _penalty(made, random):
    world = made.world
    stiffness, damping = world.of(random.uniform(500, 3000), "N/m^1.5"), world.of(random.uniform(0, 0.3), "s/m")
    return [pi.PenaltyContact(*_line(made, random, random.uniform(0.005, 0.1)), stiffness, damping)]


def _single(made, side):
    """A point of a section for contact: a node of its plate."""
    body = side.body
    return body.node(int(side.nodes[0])) if isinstance(body, (pi.Plate, pi.Reduced, pi.Rigid)) else side


def _contact(made, random):
    """A point on a line of the ground; of a plate the end's mean is no point, so its first body that is none serves."""
    others = [k for k, body in enumerate(made.bodies) if not isinstance(body, (pi.Plate, pi.Reduced, pi.Rigid))]
    if not others:
        return _penalty(made, random)
    k, name, way = int(random.choice(others)), str(random.choice(ENDS)), np.exp(1j * random.uniform(-0.6, 0.6))
    depth, law = random.uniform(0.01, 0.1), {"restitution": random.choice([0.0, 0.5]), "friction": random.choice([0.0, 0.3])}
    z = made.drawn(k, name)
    if random.integers(3) == 0:
        law["disc"] = made.world.of(0.2, "m")
        depth += 0.2
    return [pi.Contact(made.at(k, name), made.ground(z - 1j * depth * way, way), **law)]


def _pid(made, random):
    world = made.world
    gains = {"kp": world.of(random.uniform(2, 10), "N m"), "kd": world.of(random.uniform(0, 0.5), "N m s")}
    gains["ki"] = world.of(world.of(random.uniform(0, 20), "N m"), "1/s")
    gains["filter"] = random.choice([0.0, world.of(0.01, "s")])
    limit = {"limit": world.of(2.0, "N m")} if random.integers(2) else {}
    return [pi.PID(target=_turning(world, random), **gains, **limit, **_turned(made, random))]


def _linear(made, random):
    world = made.world
    rate, gain = world.of(random.uniform(5, 30), "1/s"), world.of(random.uniform(1, 5), "N m")
    return [
        pi.LinearController(A=[[-rate]], B=[[rate]], C=[[gain]], D=[[0.2 * gain]], target=_turning(world, random), **_turned(made, random))
    ]


def _dc(made, random):
    """Units of electricity: 1 A everywhere."""
    world = made.world
    R, L = world.of(1.0, "N m") * world.of(1.0, "1/s"), world.of(random.choice([0.0, 0.02]), "N m")
    volts = world.angle(world.of(world.of(random.uniform(2, 10), "N m"), "1/s"))
    k = world.of(random.uniform(0.05, 0.2), "N m")
    return [pi.DCMotor(volts=pi.profile.scaled(_wave(world, random), volts), k=k, L=L, R=R, gear=3.0, **_turned(made, random))]


def _maxwell(made, random):
    world = made.world
    return [pi.Maxwell(*_two(made, random), world.of(random.uniform(10, 100), "N/m"), world.of(random.uniform(1, 10), "N s/m"))]


def _of_length(made, random):
    a, b = _two(made, random)
    return a, b, float(np.linalg.norm(np.subtract(a.point, b.point)))


def _band(kind):
    return lambda made, random: [kind(*_two(made, random), made.world.of(random.uniform(5, 30), "N/m"))]


def _lag(kind):
    def make(made, random):
        a, b, length = _of_length(made, random)
        k, tau = made.world.of(random.uniform(10, 50), "N/m"), made.world.of(random.uniform(0.01, 0.2), "s")
        return [kind(a, b, k, tau, length)]

    return make


def _held(kind):
    def make(made, random):
        a, b, length = _of_length(made, random)
        return [kind(a, b, made.world.of(random.uniform(10, 50), "N/m"), length, made.world.of(0.04, "s"))]

    return make


PARTS = {
    "SpringDamper": _spring,
    "TorsionSpring": _torsion,
    "PointLoad": _load,
    "EdgeTraction": _traction,
    "Force": _force,
    "Torque": _torque,
    "PointMass": _mass,
    "PenaltyContact": _penalty,
    "Contact": _contact,
    "PID": _pid,
    "LinearController": _linear,
    "DCMotor": _dc,
    "Maxwell": _maxwell,
    "Band": _band(Band),
    "FastBand": _band(FastBand),
    "Lag": _lag(Lag),
    "FastLag": _lag(FastLag),
    "Held": _held(Held),
    "FastHeld": _held(FastHeld),
}
PLAIN_PARTS = "Band", "Lag", "Held"


# --- events ---


def _when(made, random):
    """A time, or a way of an end since the start: a function of the state."""
    world = made.world
    if random.integers(2):
        time = world.of(random.uniform(0.05, 0.25), "s")
        return lambda s: s.t - time
    point, z = _end(made, random)
    n = np.exp(1j * random.uniform(-3, 3))
    normal, wall = np.array(world.vector(n.real, n.imag, "1")), z + random.uniform(0.01, 0.1) * n
    place = world.place(wall.real, wall.imag)
    return lambda s: (s.position(point) - place) @ normal


def _remove(made, random, name):
    names = [part.name for part in made.parts]
    return pi.Event(_when(made, random), pi.Remove(str(random.choice(names))), name=name, most=1)


def _add(made, random, name):
    part = random.choice([_spring, _band(FastBand), _mass, _maxwell])(made, random)[0]
    return pi.Event(_when(made, random), replace(part, name=f"part of {name}"), name=name)


def _catch(made, random, name):
    end = made.at(len(made.bodies) - 1, "right")
    return pi.Event(_when(made, random), random.choice([pi.Revolute, pi.Weld])(pi.ground, end, name=f"part of {name}"), name=name)


def _impulse(made, random, name):
    return pi.Event(
        _when(made, random), pi.Impulse(_end(made, random)[0], made.world.vector(*random.uniform(-0.5, 0.5, 2), "N s")), name=name
    )


def _impact(made, random, name):
    """A wall that an end meets."""
    world, (point, z) = made.world, _end(made, random)
    n = np.exp(1j * random.uniform(-3, 3))
    wall = z + random.uniform(0.005, 0.08) * n
    normal, place = np.array(world.vector(n.real, n.imag, "1")), world.place(wall.real, wall.imag)
    speed = world.of(1e-3, "m/s")
    return pi.Event(lambda s: (s.position(point) - place) @ normal, pi.Impact(0.6, least_speed=speed), name=name)


def _slower(made, random, name):
    return pi.Event(_when(made, random), lambda s: 0.7 * s.v, name=name)


EVENTS = {"remove": _remove, "add": _add, "catch": _catch, "impulse": _impulse, "impact": _impact, "function": _slower}
