"""Random scenes with laws: mechanisms and bodies with contact and friction, of which each integrator must end its run or say why it cannot.

Bodies are rigid, reduced or full, friction coefficients are 0 to 2, restitutions 0 to 1. What moves a scene is its weight, a torque that sets in
at once, a motor that dwells, or a controller whose output jumps.
"""

from dataclasses import dataclass
from time import process_time

import numpy as np

import polyida as pi
from nonsmooth.scenes import FLOOR, G, Kerb

END = 0.06  # s
HEIGHT, DENSITY, RADIUS = 0.02, 1200.0, 0.01  # of links, m, kg/m^3, and of pins, m
KINDS, DRIVES = ("rigid", "reduced", "full"), ("weight", "torque", "motor", "controller")
WAYS = {
    "Radau IIA": pi.RadauIIA(rtol=1e-7),
    "Radau IIA, coarse": pi.RadauIIA(rtol=1e-4),
    "alpha": pi.GeneralizedAlpha(h=5e-4),
    "alpha, tolerance": pi.GeneralizedAlpha(rtol=1e-4),
    "IDA": pi.IDA(rtol=1e-6),
    "energy-momentum": pi.EnergyMomentum(h=5e-4),
    "nonsmooth alpha": pi.NonsmoothAlpha(h=2.5e-4),
    "Moreau-Jean": pi.MoreauJean(h=2.5e-4),
}
COARSE = "Radau IIA, coarse", "alpha, tolerance"
REASONS = {"no unique force": "singular friction", "impacts": "impacts that accumulate"}  # in messages: why no integrator of events goes on


@dataclass(frozen=True, eq=False)
class Switched(pi.Controller):
    """A force along x at a point, N, that changes its sign at samples."""

    at: object
    size: float
    period: float = 0.02
    name: str | None = None

    def sides(self):
        return (self.at,)

    def sample(self, t, x, v, s, u):
        return np.array([-self.size if u[0] > 0.0 else self.size])

    def forces(self, t, x, v, s, u):
        return np.array([[u[0], 0.0]])


class Drawn:
    """A random scene. kind, drive: of its links and of what moves it; mu; ends: attachments whose places are compared."""

    def __init__(self, seed):
        random = self.random = np.random.default_rng([57, seed])
        self.scene, self.ends = pi.Scene(gravity=(0.0, -G)), []
        self.kind, self.drive = KINDS[random.integers(3)], DRIVES[random.integers(4)]
        self.mu = float(random.choice([0.05, random.uniform(0.0, 0.5), random.uniform(0.5, 2.0)]))
        make = (self.crank, self.chain, self.rail, self.thrown, self.block)[seed % 5]
        make()
        self.name = f"{make.__name__}, {self.kind}, {self.drive}, mu = {self.mu:.2g}"

    def link(self, length, place, angle, name):
        """A link at rest from a place on."""
        if self.kind == "rigid":
            return self.scene.add(pi.RigidBody.bar(length, DENSITY * length * HEIGHT * 0.01, place, angle, name=name))
        material = pi.Material(10 ** self.random.uniform(8.0, 10.0), 0.3, DENSITY, viscosity=float(self.random.choice([0.0, 1e-5])))
        plate = pi.Plate(pi.mesh.quads(length, HEIGHT, 6, 1), material, 0.01, origin=place, angle=angle, name=name)
        return self.scene.add(plate if self.kind == "full" else pi.Reduced(plate, modes=int(self.random.integers(1, 4))))

    def side(self, link, name):
        """The end "left" or "right" of a link."""
        return link.at(name) if self.kind == "rigid" else link.section(name)

    def pin(self, a, b, name):
        """A pin, half of them with friction."""
        friction = {"friction": self.mu, "pin_radius": RADIUS} if self.random.random() < 0.5 else {}
        self.scene.add(pi.Revolute(a, b, name=name, **friction))

    def driven(self, at, force=1.0):
        """Drive an end of a body that turns; force: of a controller, N."""
        size = self.random.uniform(-1.5, 1.5)
        if self.drive == "torque":
            self.scene.add(pi.Torque(at, 0.5 * size, name="drive"))
        elif self.drive == "motor":
            self.scene.add(pi.AngleMotor(FLOOR, at, pi.profile.quintic(0.0, size, 0.05, begin=0.02), name="drive"))
        elif self.drive == "controller":
            self.scene.add(Switched(self.ends[0], force * size, name="drive"))

    def crank(self):
        """A slider-crank with friction in its guide, and perhaps in its pins."""
        crank, rod, angle = 0.1, self.random.uniform(0.2, 0.4), self.random.uniform(0.3, 2.8)
        back, pin = -np.arcsin(crank / rod * np.sin(angle)), (crank * np.cos(angle), crank * np.sin(angle))
        first = self.scene.add(pi.RigidBody.bar(crank, 0.2, angle=angle, name="crank"))
        second = self.link(rod, pin, back, "rod")
        place = (pin[0] + rod * np.cos(back), 0.0)
        slider = self.scene.add(pi.RigidBody(mass=0.5, inertia=1e-3, points={"c": (0.0, 0.0)}, origin=place, name="slider"))
        self.pin(FLOOR, first.at("left"), "bearing")
        self.pin(first.at("right"), self.side(second, "left"), "crank pin")
        self.pin(self.side(second, "right"), slider.at("c"), "slider pin")
        self.scene.add(pi.Prismatic(FLOOR, slider.at("c"), friction=self.mu, name="guide"))
        self.ends = [slider.at("c")]
        self.driven(first.at("left"), 10.0)

    def chain(self):
        """A pendulum of one to three links with friction in its pins."""
        end, place = FLOOR, np.zeros(2)
        for k in range(int(self.random.integers(1, 4))):
            length, angle = self.random.uniform(0.1, 0.4), self.random.uniform(-np.pi, np.pi)
            link = self.link(length, tuple(place), angle, f"link {k}")
            self.scene.add(pi.Revolute(end, self.side(link, "left"), friction=self.mu, pin_radius=RADIUS, name=f"pin {k}"))
            end, place = self.side(link, "right"), place + length * np.array([np.cos(angle), np.sin(angle)])
            self.ends.append(end)
        self.driven(self.side(link, "left") if k == 0 else self.ends[-1])

    def rail(self):
        """A block on a rail that carries a pendulum; a spring holds it."""
        block = self.scene.add(pi.RigidBody(mass=self.random.uniform(0.2, 2.0), inertia=1e-3, points={"c": (0.0, 0.0)}, name="block"))
        self.scene.add(pi.Prismatic(FLOOR, block.at("c"), friction=self.mu, name="rail"))
        angle, length = self.random.uniform(-np.pi, np.pi), self.random.uniform(0.1, 0.4)
        arm = self.link(length, (0.0, 0.0), angle, "arm")
        self.pin(block.at("c"), self.side(arm, "left"), "pin")
        ground = pi.ground.at((-1.0, 0.0))
        stiffness, rest = 10 ** self.random.uniform(1.0, 4.0), self.random.uniform(0.9, 1.1)
        self.scene.add(pi.SpringDamper(ground, block.at("c"), stiffness, length=rest, name="spring"))
        self.ends = [block.at("c"), self.side(arm, "right")]
        self.driven(self.side(arm, "left"), 10.0)

    def thrown(self):
        """A body that is thrown on a rough floor: rigid with three corners, or a plate with those of its lower side."""
        restitution = float(self.random.uniform(0.0, 1.0) * (self.random.random() < 0.5))
        velocity, spin = (self.random.uniform(-1.0, 1.0), self.random.uniform(-1.5, 0.0)), self.random.uniform(-5.0, 5.0)
        if self.kind == "rigid":
            points = {name: tuple(self.random.uniform(-0.3, 0.3, 2)) for name in "abc"}
            place = (0.0, 0.02 - min(y for _, y in points.values()))
            points = {"m": (0.0, 0.0)} | points
            body = self.scene.add(
                pi.RigidBody(mass=1.0, inertia=0.02, points=points, origin=place, velocity=velocity, spin=spin, name="body")
            )
            for name in "abc":
                self.scene.add(Kerb(FLOOR, body.at(name), restitution=restitution, mu=self.mu, name=name))
            self.ends = [body.at("m")]
        else:
            material = pi.Material(10 ** self.random.uniform(6.0, 8.0), 0.3, DENSITY, viscosity=1e-4)
            angle = self.random.uniform(-0.1, 0.1)
            motion = {"origin": (0.0, 0.055 + 0.3 * abs(angle)), "angle": angle, "velocity": velocity, "spin": spin}
            plate = pi.Plate(pi.mesh.quads(0.3, 0.1, 3, 1), material, 0.02, name="body", **motion)
            body = self.scene.add(plate if self.kind == "full" else pi.Reduced(plate, modes=3))
            self.scene.add(pi.Contact(body.section("bottom"), FLOOR, friction=self.mu, name="floor"))
            self.ends = [body.section("top")]
        if self.drive == "controller":
            self.scene.add(Switched(self.ends[0], self.random.uniform(0.0, 20.0), name="drive"))

    def block(self):
        """A rigid block on two feet that a controller or a growing force pushes, perhaps on its way up or at the edge."""
        points = {"left": (-0.1, -0.05), "right": (0.1, -0.05), "m": (0.0, self.random.uniform(-0.05, 0.3))}
        body = self.scene.add(pi.RigidBody(1.0, 0.01, points, origin=(0.0, 0.05), name="block"))
        for name in ("left", "right"):
            self.scene.add(pi.Contact(body.at(name), FLOOR, friction=self.mu, restitution=float(self.random.uniform(0.0, 0.9)), name=name))
        self.ends = [body.at("m"), body.at("left")]
        size = self.random.uniform(0.0, 30.0)
        if self.drive == "controller":
            self.scene.add(Switched(body.at("m"), size, name="drive"))
        else:
            growing = pi.profile.quintic(0.0, size, 0.05) if self.drive == "motor" else size
            self.scene.add(pi.Force(body.at("m"), (growing, 0.0), name="drive"))


def places(drawn, run):
    """Places of the ends at the end of a run, (2 ends,), m."""
    return np.concatenate([run.position(end)[-1] for end in drawn.ends])


def outcome(run):
    """ "done", "stated: " and the reason, or "stop: " and the message."""
    if run.success:
        return "done"
    reason = next((REASONS[words] for words in REASONS if words in run.message), None)
    return f"stated: {reason}" if reason else f"stop: {run.message}"


def measure(seed, ways=WAYS):
    """{way: (outcome, distance of the ends from those of the first way that is done, m, CPU s)} of a random scene, and its name."""
    drawn, rows, first = Drawn(seed), {}, None
    model = drawn.scene.build()
    for way, method in ways.items():
        begin = process_time()
        run = pi.solve(model, END, method)
        result = outcome(run)
        apart = np.nan
        if result == "done":
            first = places(drawn, run) if first is None else first
            apart = float(np.abs(places(drawn, run) - first).max())
        rows[way] = result, apart, process_time() - begin
    return drawn.name, rows
