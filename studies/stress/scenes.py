"""Scenes of the stress study: each function takes the varied value and returns a built model."""

import numpy as np

from polyida import mesh, profile
from polyida.body.plate import Material, Plate
from polyida.body.rigid_body import PointMass
from polyida.force.loads import EdgeTraction, PointLoad
from polyida.joint.attachment import ground
from polyida.joint.joints import AngleMotor, Clamp, Revolute
from polyida.problems import plates
from polyida.scene import Scene

CELLS, PLATE_MASS, TIP = 12, 1.1, 0.01  # polygons and kg of a plate of the row; kg at the tip of a single plate
STIFF = Material(E=5e9, nu=0.3, rho=1100.0)
DOWN = (0.0, -9.81)
PRESSING, SLOW = profile.ramp(0.0, 1.0, duration=0.5), 2e-3  # load on a pressed block over time; its viscosity, s


def rubber(modulus, **options):
    """The row's material with another modulus."""
    return Material(modulus, 0.3, 1100.0, **options)


def swing(material=plates.RUBBER, tip_mass=plates.TIP_MASS, cells=CELLS):
    """Two plates that swing freely."""
    return plates.double_plate(cells, material=material, tip_mass=tip_mass).build()


def driven(angle, material=STIFF, gravity=(0.0, 0.0)):
    """One plate on a hinge, turned by a motor: parts "board", "hinge", "drive", "tip" (10 g)."""
    scene, board = _hinged(mesh.rectangle(1.0, 0.1, CELLS, seed=1), material, gravity)
    scene.add(AngleMotor(ground, board.section("left"), angle, name="drive"))
    return scene.build()


def _hinged(of, material, gravity):
    scene = Scene(gravity)
    board = scene.add(Plate(of, material, thickness=0.01, name="board"))
    scene.add(Revolute(ground, board.section("left"), name="hinge"))
    scene.add(PointMass(board.section("right"), TIP, name="tip"))
    return scene, board


def chain(links):
    """`links` plates of few cells that swing freely."""
    return plates.plate_chain(links, cells=6).build()


def heavy(factor):
    """The swinging plates under gravity times a factor."""
    scene = plates.double_plate(CELLS)
    scene.gravity = scene.gravity * factor
    return scene.build()


def slender(ratio):
    """One hinged plate of length over height `ratio`, E = 5 GPa, 20 x 2 quadrilaterals."""
    return _hinged(mesh.quads(1.0, 1.0 / ratio, 20, 2), STIFF, DOWN)[0].build()


def sliver(width):
    """One hinged plate of quadrilaterals, 1 m x 0.1 m, with one column of the width `width`."""
    x = np.sort(np.r_[np.linspace(0.0, 1.0, 11), 0.45, 0.45 + width])
    points = np.array([(at, y) for at in x for y in (-0.05, 0.05)])
    first = 2 * np.arange(len(x) - 1)
    nodes = np.stack([first, first + 2, first + 3, first + 1], axis=1).ravel()
    return _of_polygons(points, nodes, np.arange(0, len(nodes) + 1, 4))


def short_edge(length):
    """One hinged plate of 10 x 2 quadrilaterals. One inner node is split into two at the distance `length`, which gives two pentagons."""
    points = np.array([(x, y) for x in np.linspace(0.0, 1.0, 11) for y in (-0.05, 0.0, 0.05)] + [(0.5, 0.0)])
    points[16], points[33] = points[16] - length / np.sqrt(8), points[33] + length / np.sqrt(8)
    low = [[3 * k, 3 * k + 3, 3 * k + 4, 3 * k + 1] for k in range(10)]
    high = [[node + 1 for node in cell] for cell in low]
    low[5], high[4], high[5] = [15, 18, 19, 33, 16], [13, 16, 33, 17, 14], [33, 19, 20, 17]
    cells = low + high
    return _of_polygons(points, np.concatenate(cells), np.cumsum([0, *map(len, cells)]))


def _of_polygons(points, nodes, offsets):
    sides = {"left": np.flatnonzero(points[:, 0] == 0.0), "right": np.flatnonzero(points[:, 0] == 1.0)}
    return _hinged(mesh.PolygonMesh(points, nodes, offsets, sides), STIFF, DOWN)[0].build()


def one_polygon(corners, element="wachspress"):
    """One element, a regular polygon of 1 m diameter, that swings about its left corner; E = 5 GPa."""
    angle = np.pi + 2 * np.pi * np.arange(corners) / corners
    points = 0.5 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    scene = Scene(DOWN)
    cell = mesh.PolygonMesh(points, np.arange(corners), [0, corners], {"tip": [corners // 2]})
    board = scene.add(Plate(cell, STIFF, thickness=0.01, name="board", element=element))
    scene.add(Revolute(ground, board.node(0), name="hinge"))
    scene.add(PointMass(board.section("tip"), 1e-3, name="tip"))
    return scene.build()


def blocks(count):
    """A swinging row of `count` plates of one quadrilateral each; E = 5 GPa."""
    block, scene, end = mesh.quads(1.0, 0.1, 1, 1), Scene(DOWN), ground
    for k in range(count):
        board = scene.add(Plate(block, STIFF, thickness=0.01, origin=(float(k), 0.0)))
        scene.add(Revolute(end, board.section("left")))
        end = board.section("right")
    scene.add(PointMass(end, 0.5, name="tip"))
    return scene.build()


def four_bar(start, material=plates.RUBBER):
    """Crank, coupler and rocker of 1 m each form a parallelogram on pivots with a distance of 1 m. At crank angle 0 it is flat, and
    singular if rigid.

    start: initial crank angle, rad. The point "tip" is the right end of the coupler.
    """
    of, scene = mesh.rectangle(1.0, 0.1, CELLS, seed=1), Scene(DOWN)
    end = np.array([np.cos(start), np.sin(start)])
    places = {"crank": ((0.0, 0.0), start), "coupler": (end, 0.0), "rocker": ((1.0, 0.0), start)}
    crank, coupler, rocker = (
        scene.add(Plate(of, material, 0.01, origin=tuple(at), angle=angle, name=name)) for name, (at, angle) in places.items()
    )
    for a, b in (
        (ground, crank.section("left")),
        (crank.section("right"), coupler.section("left")),
        (coupler.section("right"), rocker.section("right")),
        (ground, rocker.section("left")),
    ):
        scene.add(Revolute(a, b))
    scene.add(PointMass(coupler.section("right"), 0.1, name="tip"))
    return scene.build()


def redundant(kind):
    """Two plates with more joints than necessary, so that their reactions are not unique."""
    of, scene = mesh.rectangle(1.0, 0.1, CELLS, seed=1), Scene(DOWN)
    one, other = (scene.add(Plate(of, plates.RUBBER, 0.01, origin=(x, 0.0), name=name)) for x, name in ((0.0, "one"), (1.0, "other")))
    left, right, next_left = one.section("left"), one.section("right"), other.section("left")
    turn = profile.quintic(0.0, 1.0, duration=1.0)
    parts = {
        "hinge twice": [Revolute(ground, left), Revolute(ground, left), Revolute(right, next_left)],
        "hinge and clamp": [Clamp(left), Revolute(ground, left), Revolute(right, next_left)],
        "motor and clamp": [Clamp(left), AngleMotor(ground, left, turn), Revolute(right, next_left)],
        "two motors": [Revolute(ground, left), AngleMotor(ground, left, turn), AngleMotor(left, ground, 0.5), Revolute(right, next_left)],
        "weld and motor": [Clamp(left), Clamp(right, next_left), AngleMotor(right, next_left, turn)],
    }[kind]
    for part in [*parts, PointMass(other.section("right"), 0.5, name="tip")]:
        scene.add(part)
    return scene.build()


def struck(duration):
    """A free plate with a triangular pulse of 1 N s in y at its right end, from t = 10 ms on, with a kink at each corner."""
    t0, t1, t2 = 0.01, 0.01 + duration / 2, 0.01 + duration
    scene = Scene()
    board = scene.add(Plate(mesh.rectangle(1.0, 0.1, CELLS, seed=1), STIFF, 0.01, name="board"))
    pulse = profile.from_function(lambda t: float(np.interp(t, (t0, t1, t2), (0.0, 2 / duration, 0.0))), kinks=(t0, t1, t2))
    scene.add(PointLoad(board.section("right"), (0.0, 1.0), pulse, name="strike"))
    scene.add(PointMass(board.section("right"), 1e-3, name="tip"))
    return scene.build()


def pressed(pressure):
    """A short clamped plate, nu = 0, with damping, is pressed slowly along its axis by `pressure` times its modulus of 1 MPa.

    The stretch s is uniform, `E (s - s^3)/2 = pressure`, up to the largest possible pressure `E / (3 sqrt 3) = 0.19245 E` at s = 0.577.
    """
    scene = Scene()
    board = scene.add(Plate(mesh.quads(0.05, 0.1, 2, 4), Material(1e6, 0.0, 1100.0, viscosity=SLOW), 0.01, name="board"))
    scene.add(Clamp(board.section("left"), name="wall"))
    scene.add(EdgeTraction(board.section("right"), (-1e6 * pressure, 0.0), PRESSING, name="press"))
    scene.add(PointMass(board.section("right"), 1e-3, name="tip"))
    return scene.build()


def collapsing(modulus):
    """The motor-driven double plate with another modulus."""
    return plates.double_plate_motors(CELLS, material=rubber(modulus)).build()


def damped(viscosity):
    """The swinging plates with Kelvin-Voigt time `viscosity`, s."""
    return swing(rubber(50e6, viscosity=viscosity))


def zigzag(rate, h):
    """Angle profile of `rate` rad/s that reverses within a step of h at t = 0.05 s; its rate changes smoothly."""
    t0 = 0.05

    def s(t):
        return float(np.clip((t - t0) / h, 0.0, 1.0))

    def value(t):
        x = s(t)
        return rate * (min(t, t0) + h * (x - 2 * (x**3 - x**4 / 2)) - max(t - t0 - h, 0.0))

    return profile.Profile(
        value, lambda t: rate * (1 - 2 * s(t) ** 2 * (3 - 2 * s(t))), lambda t: -12 * rate / h * s(t) * (1 - s(t)), (t0, t0 + h)
    )


def backwards(angle, t_end):
    """The angle profile in reversed time from t_end."""
    kinks = tuple(sorted(t_end - t for t in angle.kinks if t < t_end))
    return profile.Profile(lambda t: angle(t_end - t), lambda t: -angle.d1(t_end - t), lambda t: angle.d2(t_end - t), kinks)
