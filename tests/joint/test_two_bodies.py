"""Parts between two moving bodies, where the ground as a partner hides signs and offsets: momenta, energy, and friction by closed forms."""

import numpy as np
import pytest

import polyida as pi

G = 9.81
SHIFT, SPIN, TILT = 0.3 - 0.2j, 1.5, 0.3  # m/s, rad/s and rad, of the first body
POINT = np.exp(1j * TILT) * (0.5 + 0.1j)  # where parts act on the first body, whose origin is at 0
ALONG, ACROSS = np.exp(1j * TILT), 1j * np.exp(1j * TILT)
LIMIT = {"friction": 0.3}


def pair_of(z):
    """A complex number as a pair."""
    return z.real, z.imag


def bodies(away=0.0, approach=0.0, turning=0.0):
    """(scene, point of a, point of b): free bodies that move as one, but for b's way off the point, its approach to it and its own spin.

    Both have the centre of mass elsewhere, and none is at rest.
    """
    scene = pi.Scene(gravity=(0.0, 0.0))
    centre, place = np.exp(1j * TILT) * (0.1 - 0.2j), POINT + away
    other = place + np.exp(0.7j) * (0.2 - 0.1j)
    rate = SHIFT + 1j * SPIN * (place - centre) + approach + 1j * (SPIN + turning) * (other - place)
    first = pi.RigidBody(2.0, 0.3, {"p": (0.5, 0.1)}, angle=TILT, center=(0.1, -0.2), velocity=pair_of(SHIFT), spin=SPIN, name="a")
    second = pi.RigidBody(
        1.0, 0.05, {"p": (0.0, 0.0)}, pair_of(place), 0.7, (0.2, -0.1), velocity=pair_of(rate), spin=SPIN + turning, name="b"
    )
    return scene, scene.add(first).at("p"), scene.add(second).at("p")


PROFILE = pi.profile.quintic(0.0, 0.5, duration=0.3)
FILTER = {"A": [[-20.0]], "B": [[1.0, 0.0]], "C": [[3.0]], "D": [[2.0, 0.5]]}
BETWEEN = {  # (what `bodies` is told, the part between a and b)
    "revolute": ({"turning": 2.0}, pi.Revolute),
    "revolute with friction": ({"turning": 2.0}, lambda a, b: pi.Revolute(a, b, **LIMIT, pin_radius=0.05)),
    "slot": ({"turning": 2.0, "approach": 0.4 * ALONG}, lambda a, b: pi.Slot(a, b, **LIMIT)),
    "prismatic": ({"approach": 0.4 * ALONG}, lambda a, b: pi.Prismatic(a, b, **LIMIT)),
    "weld": ({}, pi.Weld),
    "clamp": ({}, pi.Clamp),
    "distance": ({"away": 0.2 * ACROSS, "turning": 2.0}, pi.Distance),
    "motor": ({}, lambda a, b: pi.AngleMotor(a, b, PROFILE)),
    "rolls on a line": ({"away": 0.2 * ACROSS, "approach": -0.4 * ALONG, "turning": 2.0}, lambda a, b: pi.RollingDisc(a, b, radius=0.2)),
    "rolls on a circle": (
        {"away": 0.3 * ACROSS, "approach": -0.4 * ALONG, "turning": 2.0},
        lambda a, b: pi.RollingDisc(a, b, radius=0.2, circle=0.1),
    ),
    "pin with clearance": ({"approach": -0.5 * ACROSS, "turning": 9.0}, lambda a, b: pi.Clearance(a, b, gap=0.01, pin_radius=0.1, **LIMIT)),
    "meets a line": ({"away": 0.01 * ACROSS, "approach": ALONG - ACROSS}, lambda a, b: pi.Contact(b, a, restitution=0.5, **LIMIT)),
    "meets a circle": (
        {"away": 0.11 * ACROSS, "approach": ALONG - ACROSS},
        lambda a, b: pi.Contact(b, a, radius=0.1, restitution=0.5, **LIMIT),
    ),
    "disc on a line": (
        {"away": 0.06 * ACROSS, "approach": ALONG - ACROSS, "turning": 9.0},
        lambda a, b: pi.Contact(b, a, disc=0.05, **LIMIT),
    ),
    "disc on a circle": (
        {"away": 0.16 * ACROSS, "approach": ALONG - ACROSS, "turning": 9.0},
        lambda a, b: pi.Contact(b, a, disc=0.05, radius=0.1, **LIMIT),
    ),
    "spring": ({"away": 0.2 * ACROSS}, lambda a, b: pi.SpringDamper(a, b, 50.0, 3.0, length=0.1, preload=2.0)),
    "torsion spring": ({}, lambda a, b: pi.TorsionSpring(a, b, 5.0, 0.2, angle=0.4)),
    "penalty on a line": (
        {"away": 0.01 * ACROSS, "approach": ALONG - ACROSS},
        lambda a, b: pi.PenaltyContact(b, a, 1e3, damping=0.1, exponent=1.0),
    ),
    "penalty on a circle": (
        {"away": 0.11 * ACROSS, "approach": ALONG - ACROSS},
        lambda a, b: pi.PenaltyContact(b, a, 1e3, damping=0.1, exponent=1.0, radius=0.1),
    ),
    "Maxwell": ({"away": 0.2 * ACROSS, "approach": 0.5 * ALONG + ACROSS}, lambda a, b: pi.Maxwell(a, b, 200.0, 5.0, length=0.15)),
    "PID": ({"turning": 1.0}, lambda a, b: pi.PID(b, 4.0, 2.0, 0.3, target=0.5, against=a, filter=0.02)),
    "DC motor": ({"turning": 1.0}, lambda a, b: pi.DCMotor(b, volts=6.0, k=0.1, L=0.02, R=1.0, gear=3.0, against=a)),
    "torque": ({"turning": 1.0}, lambda a, b: pi.Torque(b, PROFILE, against=a)),
    "torque of state": ({"turning": 1.0}, lambda a, b: pi.Torque(b, lambda t, angle, rate: 2.0 - 3.0 * angle - rate, against=a)),
}


@pytest.mark.parametrize("kind", BETWEEN)
def test_what_acts_between_two_free_bodies_keeps_their_momenta(kind):
    """Force and moment on one body are the opposite of those on the other, and what the energy loses is told."""
    start, make = BETWEEN[kind]
    scene, a, b = bodies(**start)
    scene.add(make(a, b))
    run = pi.solve(scene.build(), 0.15, pi.RadauIIA(rtol=1e-10))
    assert run.success, run.message
    assert run.momentum == pytest.approx(np.tile(run.momentum[0], (len(run), 1)), abs=1e-8)
    assert run.angular_momentum == pytest.approx(run.angular_momentum[0], abs=1e-8)
    moved = run.v[-1] - run.v[0]
    assert np.abs(moved).max() > 1e-2 or kind in ("weld", "clamp")
    energy = run.energy
    if kind not in ("PID", "DC motor", "torque of state"):
        lost = sum(one[-1] for one in energy.dissipated.values())
        worked = sum(one[-1] for one in energy.work.values())
        assert energy.total[-1] - energy.total[0] == pytest.approx(worked - lost, abs=1e-6)


class PinOnARod:
    """A free rod and a disc whose centre is pinned to the rod's end, with friction: closed form of both spins.

    In the pin acts the force that turns the reduced mass m about the centre of both, `N = m L |i rod' - rod^2|`; its moment mu r N takes the
    rod's spin, `rod' = -kappa / sqrt(1 - kappa^2) rod^2`, `kappa = mu r m L / (J + m L^2)`, and gives it to the disc.
    """

    length, radius, mu, heavy, light, rod, disc = 0.5, 0.2, 0.4, 3.0, 1.0, 0.1, 0.02

    def scene(self, spins):
        """Rod and disc at the origin and on the x axis; the centre of mass of both rests."""
        scene, share = pi.Scene(gravity=(0.0, 0.0)), self.light / (self.heavy + self.light)
        velocity = -share * spins[0] * self.length, (1.0 - share) * spins[0] * self.length
        rod = scene.add(
            pi.RigidBody(self.heavy, self.rod, {"end": (self.length, 0.0)}, velocity=(0.0, velocity[0]), spin=spins[0], name="rod")
        )
        start = {"origin": (self.length, 0.0), "velocity": (0.0, velocity[1]), "spin": spins[1]}
        disc = scene.add(pi.RigidBody(self.light, self.disc, {"c": (0.0, 0.0)}, name="disc", **start))
        scene.add(pi.Revolute(rod.at("end"), disc.at("c"), friction=self.mu, pin_radius=self.radius, name="pin"))
        return scene

    @property
    def inertia(self):
        """Moment of inertia of the rod with the masses about the centre of both."""
        return self.rod + self.heavy * self.light / (self.heavy + self.light) * self.length**2

    def spins(self, start, t):
        """Spins at t, before both are equal."""
        kappa = self.mu * self.radius * (self.inertia - self.rod) / self.length / self.inertia
        rod = start[0] / (1.0 + kappa / np.sqrt(1.0 - kappa**2) * start[0] * t)
        return np.array([rod, start[1] + self.inertia / self.disc * (start[0] - rod)])


def spins_of(run):
    """Spins of rod and disc at the end, by the speeds of their directions, which are as long as their radii of gyration."""
    p = PinOnARod
    speeds = np.linalg.norm(run.v[-1].reshape(-1, 2)[[1, 3]], axis=1)
    return speeds / np.sqrt([p.rod / p.heavy, p.disc / p.light])


METHODS = {  # with the relative error of spins
    "Radau": (pi.RadauIIA(rtol=1e-10), 1e-8),
    "alpha": (pi.GeneralizedAlpha(h=1e-3), 1e-5),
    "IDA": (pi.IDA(rtol=1e-9), 1e-7),
    "energy": (pi.EnergyMomentum(h=1e-3), 2e-5),
    "nonsmooth alpha": (pi.NonsmoothAlpha(h=1e-3), 2e-5),
    "Moreau and Jean": (pi.MoreauJean(h=1e-3), 1e-2),
}


@pytest.mark.parametrize("method", METHODS)
def test_a_pin_between_turning_bodies_rubs_by_their_relative_spin(method):
    integrator, error = METHODS[method]
    pin, start = PinOnARod(), (4.0, 1.0)
    run = pi.solve(pin.scene(start).build(), 0.1, integrator)
    expected = pin.spins(start, 0.1)
    assert run.success and spins_of(run) == pytest.approx(expected, rel=error), run.message
    lost = 0.5 * (pin.inertia * (start[0] ** 2 - expected[0] ** 2) + pin.disc * (start[1] ** 2 - expected[1] ** 2))
    assert run.energy.dissipated["pin"][-1] == pytest.approx(lost, rel=10 * error)


@pytest.mark.parametrize("method", METHODS)
def test_a_pin_between_bodies_that_turn_as_one_rubs_nothing(method):
    pin, start = PinOnARod(), (4.0, 4.0)
    run = pi.solve(pin.scene(start).build(), 0.1, METHODS[method][0])
    assert run.success and spins_of(run) == pytest.approx(start, rel=METHODS[method][1]), run.message
    assert abs(run.energy.dissipated["pin"][-1]) < 1e-12
    assert np.abs(run.lam[1:, run.model.rows["pin"].stop - 1]).max() < 1e-3


@pytest.mark.parametrize("method", ["Radau", "alpha", "nonsmooth alpha", "Moreau and Jean"])
@pytest.mark.parametrize("share", [0.99, 1.01])
def test_a_pin_in_a_hole_that_is_lifted_slips_where_the_slope_is_more_than_the_coefficient(method, share):
    """Hole and pin do not turn. The force is that of weight and lift; below the slope mu the pin stays in its place, above it slides down."""
    mu, c, lift = 0.3, 0.01, 2.0
    slope = np.arctan(share * mu)
    scene = pi.Scene(gravity=(0.0, -G))
    hole = scene.add(pi.RigidBody(3.0, 0.1, {"c": (0.0, 0.0)}, name="hole"))
    pin = scene.add(pi.RigidBody(1.0, 0.02, {"c": (0.0, 0.0)}, origin=(c * np.sin(slope), -c * np.cos(slope)), name="pin"))
    scene.add(pi.Clearance(hole.at("c"), pin.at("c"), gap=c, friction=mu, pin_radius=0.05, name="bearing"))
    scene.add(pi.PrescribedPosition(hole.at("c"), x=0.0, y=pi.profile.polynomial([0.0, 0.0, lift / 2]), name="lift"))
    for body in (hole, pin):
        scene.add(pi.AngleMotor(pi.ground.at((0.0, 0.0)), body.at("c"), 0.0, name=f"no spin of {body.name}"))
    run = pi.solve(scene.build(), 0.05, METHODS[method][0])
    assert run.success, run.message
    gap = run.model.rows["bearing"].start
    assert run.lam[-1, gap] == pytest.approx(-(G + lift) * np.cos(slope), rel=2e-3)
    place = run.position(pin.at("c"))[-1] - run.position(hole.at("c"))[-1]
    slid = slope - np.arctan2(place[0], -place[1])
    rate = np.sqrt((G + lift) / c * np.sqrt(1.0 + mu**2))  # of the small motion about where the slope is mu
    slides = (slope - np.arctan(mu)) * (1.0 - np.cos(rate * 0.05)) if share > 1.0 else 0.0
    assert slid == pytest.approx(slides, rel=0.05, abs=1e-6)
