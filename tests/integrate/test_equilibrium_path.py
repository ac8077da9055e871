"""Paths of equilibria through turning points: closed forms of a truss that snaps through and of rigid bars that give way."""

from dataclasses import dataclass

import numpy as np
import pytest

import polyida as pi
from polyida.errors import StepFailure

SPAN, RISE, STIFFNESS = 1.0, 0.3, 1000.0
REST = np.hypot(SPAN, RISE)


class Truss(pi.Model):
    """Von Mises' truss: the joint of two springs to (+-1, 0) m, at height 0.3 m + q[1], kept in the middle by a constraint."""

    n, m = 2, 1
    needs = pi.Needs(driven=False, mass_varies=False, velocity_forces=False, phi_q_varies=False)

    def mass(self, q):
        return np.eye(2)

    def force(self, t, q, v):
        bars = np.array([[SPAN + q[0], RISE + q[1]], [q[0] - SPAN, RISE + q[1]]])
        lengths = np.hypot(*bars.T)
        return STIFFNESS * (1 - REST / lengths) @ bars

    def phi(self, t, q):
        return q[:1].copy()

    def phi_q(self, t, q):
        return np.array([[1.0, 0.0]])


def load_of(height):
    """The load down that holds the truss at a height."""
    return 2 * STIFFNESS * (REST / np.hypot(SPAN, height) - 1) * height


CRITICAL = np.sqrt((REST * SPAN**2) ** (2 / 3) - SPAN**2)  # height at which that is greatest


def test_a_truss_snaps_through_as_its_closed_form_says():
    path = pi.equilibrium_path(Truss(), load=[0.0, -1.0], first=1.0, until=40.0)
    height = RISE + path.q[:, 1]
    assert np.abs(load_of(height) - path.factors).max() < 1e-9 and not path.message
    assert path.factors[list(path.turning)] == pytest.approx([load_of(CRITICAL), -load_of(CRITICAL)], rel=1e-12)
    assert height[list(path.turning)] == pytest.approx([CRITICAL, -CRITICAL], abs=1e-7)
    assert path.factors[-1] >= 40.0 > path.factors[-2]


def test_it_is_unstable_between_its_turning_points():
    path = pi.equilibrium_path(Truss(), load=[0.0, -1.0], first=1.0, until=40.0)
    inside = np.abs(RISE + path.q[:, 1]) < CRITICAL * (1 - 1e-6)
    regular = np.delete(np.arange(len(path)), path.turning)
    assert [path.falling[k] for k in regular] == [int(inside[k]) for k in regular]
    assert path.branches == () and "turning at 9.949" in path.summary()


@dataclass(frozen=True, eq=False)
class Bar(pi.Body):
    """A rigid bar of 1 m and 2 kg in natural coordinates, its lower end at the origin, leaning by `lean` to the right."""

    lean: float = 0.0
    name: str | None = None

    def coordinates(self):
        z = 1j * np.exp(-1j * self.lean)
        return [0.5 * z, z]

    def mass_matrix(self):
        return np.diag([2.0, 2.0 / 12])

    def attachments(self):
        return {"foot": [1.0, -0.5], "head": [1.0, 0.5]}

    def rows(self):
        z = self.point_of("axis", [0.0, 1.0]).x
        return [(pi.dot(z, z) - 1.0) * 0.5]


@dataclass(frozen=True, eq=False)
class Sideways(pi.ForceElement):
    """A spring of 30 N/m that stays level."""

    at: object
    name: str | None = None

    def sides(self):
        return (self.at,)

    def forces(self, t, x, v):
        return np.array([[-30.0 * (x[0, 0] - self.at.point[0]), 0.0]])

    def energy(self, x):
        return 15.0 * (x[0, 0] - self.at.point[0]) ** 2


def leaning(lean, mass=None):
    """A rigid bar on a hinge, held by a level spring at its head; the load stands on its head, or is its weight."""
    scene = pi.Scene(gravity=(0.0, 0.0 if mass is None else -9.81))
    bar = scene.add(Bar(lean=lean))
    scene.add(pi.Revolute(pi.ground, bar.at("foot"), name="hinge"))
    scene.add(Sideways(bar.at("head")))
    scene.add(pi.PointMass(bar.at("head"), mass or 1.0, name="head"))
    return scene.build()


def on_head(model):
    """1 N down at the head: as its weight would."""
    down = np.zeros(model.n)
    down[1], down[3] = -1.0, -0.5
    return down


@pytest.mark.parametrize("lean", [0.01, 0.3])
def test_a_rigid_bar_that_leans_gives_way_at_its_closed_form(lean):
    """`P = k L (1 - sin a0 / sin a) cos a`, at most `k L (1 - sin^(2/3) a0)^(3/2)`: all stiffness of the bar is that of multipliers."""
    model = leaning(lean)
    path = pi.equilibrium_path(model, load=lambda q: on_head(model), first=0.5, until=100.0, count=40)
    x, y = path.position("head").T
    angle = np.arctan2(x, y)
    assert np.hypot(x, y) == pytest.approx(np.ones(len(path)), abs=1e-10)
    assert path.factors[1:] == pytest.approx(30.0 * (1 - np.sin(lean) / np.sin(angle[1:])) * np.cos(angle[1:]), abs=1e-7)
    assert path.factors[path.turning[0]] == pytest.approx(30.0 * (1 - np.sin(lean) ** (2 / 3)) ** 1.5, rel=1e-9)
    assert path.falling[0] == 0 and path.falling[path.turning[0] + 1] == 1


def test_a_truss_of_plates_snaps_through_on_its_hinges():
    """Bars of St. Venant-Kirchhoff's material with nu = 0 stretch evenly: `P = E A s (s^2 - 1) y / L`, s the stretch, at any mesh."""
    rest, slope = np.hypot(1.0, 0.1), np.arctan(0.1)
    mesh, rubber = pi.mesh.quads(rest, 0.1, 8, 2), pi.Material(E=50e6, nu=0.0, rho=1100.0)
    scene = pi.Scene()
    left = scene.add(pi.Plate(mesh, rubber, 0.01, origin=(-1.0, 0.0), angle=slope))
    right = scene.add(pi.Plate(mesh, rubber, 0.01, origin=(0.0, 0.1), angle=-slope))
    scene.add(pi.Revolute(pi.ground, left.section("left")))
    scene.add(pi.Revolute(left.section("right"), right.section("left"), name="top"))
    scene.add(pi.Revolute(right.section("right"), pi.ground))
    scene.add(pi.PointLoad(left.section("right"), (0.0, -1.0), pi.profile.constant(0.0), name="push"))
    path = pi.equilibrium_path(scene.build(), load="push", first=2.0, until=40.0)
    x, y = path.position("top").T
    stretch = np.hypot(1.0, y) / rest
    exact = lambda y, s: -50e6 * 1e-3 * s * (s**2 - 1) * y / (s * rest)  # noqa: E731
    assert np.abs(x).max() < 1e-9 and np.abs(exact(y, stretch) - path.factors).max() < 1e-6
    fine = np.linspace(-0.1, 0.1, 200_001)
    top = exact(fine, np.hypot(1.0, fine) / rest).max()
    assert path.factors[list(path.turning)] == pytest.approx([top, -top], rel=1e-8) and path.branches == ()


def test_a_named_load_comes_beside_the_others(scenes):
    scene, plate = scenes.cantilever((0.0, -9.81))
    scene.add(pi.PointLoad(plate.section("right"), (0.0, 1.0), pi.profile.constant(0.5), name="lift"))
    path = pi.equilibrium_path(scene.build(), load="lift", first=0.2, until=0.5)
    scene.add(pi.PointLoad(plate.section("right"), (0.0, path.factors[-1]), name="more"))
    assert np.abs(pi.static(scene.build()).q - path.q[-1]).max() < 1e-8


def test_what_cannot_begin_fails_and_what_ends_early_says_so(scenes):
    with pytest.raises(StepFailure, match="move freely"):
        pi.equilibrium_path(scenes.hinged()[0].build())
    path = pi.equilibrium_path(scenes.cantilever((0.0, -9.81), material={"E": 2e4})[0].build(), first=0.1)
    assert len(path) > 1 and path.factors[-1] < 1.0 and "ended early" in path.summary() and "inside out" in path.message
