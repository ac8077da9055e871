"""Scenes with contact and friction whose motion is known, of the study and of the tests.

Leine, van Campen, Glocker, J. Vib. Control 9 (2003) 25-78; Glocker, Studer, Multibody Syst. Dyn. 13 (2005) 447-463; Genot, Brogliato, Eur. J.
Mech. A/Solids 18 (1999) 653-677.
"""

from dataclasses import dataclass

import numpy as np

import polyida as pi

G = 9.81
FLOOR = pi.ground.at((0.0, 0.0), direction=(1.0, 0.0))


@dataclass(frozen=True, eq=False)
class Kerb(pi.Joint):
    """The point of b stays above the line through a; it bounces and rubs."""

    restitution: float = 0.0
    mu: float = 0.0

    def rows(self):
        """The gap and the way along the line."""
        w = self.b.x - self.a.x
        gap = pi.cross(self.a.d, w).opens(self.restitution)
        return [gap, pi.dot(self.a.d, w).rubs(self.mu, on=[gap])] if self.mu else [gap]


def on_floor(points, origin, e=0.0, mu=0.0, velocity=(0.0, 0.0), spin=0.0, inertia=0.01, gravity=(0.0, -G)):
    """A scene with a body of 1 kg above the x axis, which its points can touch."""
    scene = pi.Scene(gravity=gravity)
    points_of_body = {"c": (0.0, 0.0)} | points
    body = scene.add(
        pi.RigidBody(mass=1.0, inertia=inertia, points=points_of_body, origin=origin, velocity=velocity, spin=spin, name="body")
    )
    for name in points:
        scene.add(Kerb(FLOOR, body.at(name), restitution=e, mu=mu, name=name))
    return scene


class Balls(pi.Model):
    """Two equal balls with e = 1, 0.2 m between their centres at contact: from 0 and 0.52 m, the first with 1 m/s, they meet at 0.32 s."""

    n, m = 2, 1
    needs = pi.Needs(mass_varies=False, velocity_forces=False, driven=False, phi_q_varies=False)
    row_laws = (pi.RowLaw(0, "balls", restitution=1.0),)
    begin, meet = ((0.0, 0.52), (1.0, 0.0)), 0.32

    def mass(self, q):
        return np.eye(2)

    def force(self, t, q, v):
        return np.zeros(2)

    def phi(self, t, q):
        return np.array([q[1] - q[0] - 0.2])

    def phi_q(self, t, q):
        return np.array([[-1.0, 1.0]])

    def potential(self, q):
        return 0.0


class Belt(pi.Model):
    """A block of 1 kg on a belt that runs with 1 m/s, held by a spring of 1 N/m; q is its place, m. It sticks to 3 N.

    From rest at 0: `q = 3 - 3 cos t` to t = asin(1/3), then it sticks for sqrt(8) s to q = 3, then `q = 3 + sin`.
    """

    n, m, p = 1, 0, 1
    needs = pi.Needs(mass_varies=False, velocity_forces=False)
    row_laws = (pi.RowLaw(0, "belt", constant=3.0),)
    sticks, slips = np.arcsin(1 / 3), np.arcsin(1 / 3) + np.sqrt(8.0)  # s

    def mass(self, q):
        return np.eye(1)

    def force(self, t, q, v):
        return np.array(q)

    def psi(self, t, q, v):
        return v - 1.0

    def potential(self, q):
        return 0.5 * q @ q


def pendulum(angle):
    """A bar of 1 m with friction in its pin, from an angle of the vertical; its end is "tip"."""
    scene, d = pi.Scene(gravity=(0.0, -G)), np.array([np.sin(angle), -np.cos(angle)])
    bar = scene.add(pi.RigidBody(mass=1.0, inertia=1 / 12, points={"A": -0.5 * d, "B": 0.5 * d}, origin=0.5 * d, name="bar"))
    scene.add(pi.Revolute(pi.ground, bar.at("A"), friction=0.3, pin_radius=0.02, name="pin"))
    scene.add(pi.PointMass(bar.at("B"), 1e-12, name="tip"))
    return scene


def incline(angle=0.3, mu=0.4):
    """A body of 1 kg at rest on rough ground, gravity inclined by an angle."""
    return on_floor({"p": (0.0, 0.0)}, (0.0, 0.0), mu=mu, gravity=(G * np.sin(angle), -G * np.cos(angle)))


WIDE, HIGH, LEANS = 0.1, 0.4, 0.05  # m, m, half of a block, and rad


def rocking_block():
    """A block of 0.2 m x 0.8 m that leans on its left corner, from rest; corners "left" and "right"."""
    turned = np.array([[np.cos(LEANS), -np.sin(LEANS)], [np.sin(LEANS), np.cos(LEANS)]])
    points = {"left": tuple(turned @ [-WIDE, -HIGH]), "right": tuple(turned @ [WIDE, -HIGH])}
    return on_floor(points, tuple(turned @ [WIDE, HIGH]), mu=10.0, inertia=(WIDE**2 + HIGH**2) / 3)


CRANK, ROD, ANGLE, SPIN = 0.1, 0.3, 1.0, 20.0  # m, m, rad, rad/s
MASSES = 0.2, 0.3, 0.5  # kg, of crank, rod and slider


def slider_crank(mu=0.2):
    """A crank that turns freely, a rod and a slider of 0.5 kg with friction in its guide; the joint "guide"."""
    scene, back = pi.Scene(gravity=(0.0, -9.81)), -np.arcsin(CRANK / ROD * np.sin(ANGLE))
    pin, along = CRANK * np.array([np.cos(ANGLE), np.sin(ANGLE)]), ROD * np.array([np.cos(back), np.sin(back)])
    velocity, turn = SPIN * np.array([-pin[1], pin[0]]), -SPIN * pin[0] / along[0]
    crank = scene.add(pi.RigidBody.bar(CRANK, MASSES[0], angle=ANGLE, velocity=velocity / 2, spin=SPIN, name="crank"))
    middle = velocity + turn / 2 * np.array([-along[1], along[0]])
    rod = scene.add(pi.RigidBody.bar(ROD, MASSES[1], pin, back, velocity=middle, spin=turn, name="rod"))
    speed = (velocity[0] - turn * along[1], 0.0)
    place = (pin[0] + along[0], 0.0)
    points = {"c": (0.0, 0.0)}
    slider = scene.add(pi.RigidBody(mass=MASSES[2], inertia=1e-3, points=points, origin=place, velocity=speed, name="slider"))
    scene.add(pi.Revolute(pi.ground, crank.at("left"), name="bearing"))
    scene.add(pi.Revolute(crank.at("right"), rod.at("left"), name="crank pin"))
    scene.add(pi.Revolute(rod.at("right"), slider.at("c"), name="slider pin"))
    scene.add(pi.Prismatic(pi.ground.at((0.0, 0.0), direction=(1.0, 0.0)), slider.at("c"), friction=mu, name="guide"))
    return scene


PLATE = pi.Material(2e9, nu=0.3, rho=1200.0, viscosity=2e-6)


def plate_crank(mu, cells=40, modes=0, torque=0.0):
    """The slider-crank at rest with a plate as rod, or its `Reduced` with `modes`; a torque acts on its crank from the start, N m."""
    scene, back = pi.Scene(gravity=(0.0, -G)), -np.arcsin(CRANK / ROD * np.sin(ANGLE))
    pin = CRANK * np.array([np.cos(ANGLE), np.sin(ANGLE)])
    crank = scene.add(pi.RigidBody.bar(CRANK, MASSES[0], angle=ANGLE, name="crank"))
    plate = pi.Plate(pi.mesh.rectangle(ROD, 0.02, cells=cells, seed=1), PLATE, 0.01, origin=tuple(pin), angle=back, name="rod")
    rod = scene.add(pi.Reduced(plate, modes=modes) if modes else plate)
    place = (pin[0] + ROD * np.cos(back), 0.0)
    slider = scene.add(pi.RigidBody(mass=MASSES[2], inertia=1e-3, points={"c": (0.0, 0.0)}, origin=place, name="slider"))
    scene.add(pi.Revolute(pi.ground, crank.at("left"), name="bearing"))
    scene.add(pi.Revolute(crank.at("right"), rod.section("left"), name="crank pin"))
    scene.add(pi.Revolute(rod.section("right"), slider.at("c"), name="slider pin"))
    scene.add(pi.Prismatic(FLOOR, slider.at("c"), friction=mu, name="guide"))
    if torque:
        scene.add(pi.Torque(crank.at("left"), torque, name="drive"))
    return scene


def sliding_rod(angle=0.5, spin=0.5, speed=-20.0, mu=5 / 3, held=False):
    """A rod of 1 kg and 2 m leans with an angle over rough ground, its lower tip slides to the left at `speed`, m/s, g = 10 m/s^2.

    The force of its contact "tip" is no longer unique at the angle where `1 + 3 cos^2 - 3 mu sin cos = 0`, pi/4 for mu = 5/3. Motions that
    arrive there do so with `spin^2 sin = g`. held: the tip slides in a slot, which also pulls.
    """
    scene, (x, y) = pi.Scene(gravity=(0.0, -10.0)), (np.cos(angle), np.sin(angle))
    velocity = (speed - spin * y, spin * x)
    points = {"low": (-x, -y), "c": (0.0, 0.0)}
    rod = scene.add(pi.RigidBody(mass=1.0, inertia=1 / 3, points=points, origin=(x, y), velocity=velocity, spin=spin, name="rod"))
    scene.add(pi.Slot(FLOOR, rod.at("low"), friction=mu, name="tip") if held else Kerb(FLOOR, rod.at("low"), mu=mu, name="tip"))
    return scene


class Woodpecker(pi.Model):
    """The woodpecker toy of Pfeiffer with the data of Glocker and Studer; q = (y of the sleeve, its angle, angle of the bird).

    Contacts: beak on the pole, lower and upper edge of the sleeve on the pole, each with friction.
    """

    n, m, p = 3, 3, 3
    needs = pi.Needs(mass_varies=False, velocity_forces=False, driven=False, phi_q_varies=False)
    names = "beak", "lower edge", "upper edge"
    row_laws = tuple(pi.RowLaw(k, name, restitution=e) for k, (name, e) in enumerate(zip(names, (0.5, 0.0, 0.0)))) + tuple(
        pi.RowLaw(3 + k, name, mu=0.3, on=(k,)) for k, name in enumerate(names)
    )
    sleeve, bird, spring = (3e-4, 5e-9), (4.5e-3, 7e-7), 5.6e-3  # kg and kg m^2, N m/rad
    pole, hole, height, arm, neck, beak = 2.5e-3, 3.1e-3, 5.8e-3, 0.01, 0.015, (0.0201, 0.02)  # m
    begin = (0.0, -(3.1e-3 - 2.5e-3) / 5.8e-3, -0.2788), (-0.3394786, 0.0, -7.4620947)  # q and v of the periodic motion
    period, fall = 0.1459761, 0.0194454  # s, m

    def __init__(self):
        (m, inertia), (m_bird, inertia_bird), (a, b) = self.sleeve, self.bird, (self.arm, self.neck)
        w = np.array([1.0, a, b])  # the bird's centre moves with y' + a angle' + b angle_of_bird'
        self._mass = np.diag([m, inertia, inertia_bird]) + m_bird * np.outer(w, w)
        self._weight = 9.81 * np.array([m + m_bird, m_bird * a, m_bird * b])
        room, (length, high) = self.hole - self.pole, self.beak
        self._gaps = np.array([a + b - length - self.pole, room, room])
        self._gap_slopes = np.array([[0.0, 0.0, -high], [0.0, self.height, 0.0], [0.0, -self.height, 0.0]])
        self._slides = np.array([[1.0, a, b - length], [1.0, self.hole, 0.0], [1.0, self.hole, 0.0]])

    def mass(self, q):
        return self._mass

    def force(self, t, q, v):
        moment = self.spring * (q[1] - q[2])
        return self._weight + np.array([0.0, moment, -moment])

    def phi(self, t, q):
        return self._gaps + self._gap_slopes @ q

    def phi_q(self, t, q):
        return self._gap_slopes

    def psi(self, t, q, v):
        return self._slides @ v

    def psi_v(self, t, q):
        return self._slides

    def potential(self, q):
        return self._weight @ q + 0.5 * self.spring * (q[1] - q[2]) ** 2
