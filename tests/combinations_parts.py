"""Links, other parts and events of random scenes (combinations_scenes.py), each drawn from a random generator for a Built."""

from dataclasses import replace

import numpy as np
from combinations_own import Band, FastBand, FastHeld, FastLag, Held, Lag, Rod

import polyida as pi

ENDS = "left", "right"


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
