"""The machines whose plates are designed: a slewing arm, and the two arms of scene 2 in glass fibre at twice the speed.

The tip is to follow the path of the machine with rigid plates. The objective is the mean square of its distance from this path.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

import polyida as pi
from polyida.problems import plates

THICKNESS = plates.THICKNESS
KEPT = ("left", "end")  # sections of joints and masses
VOLUME = 0.45  # of full plates, the mass of every design


@dataclass(frozen=True)
class Machine:
    """names: of the plates, which lie in a row, each 1 m x height, m, and end in the middle of their right edges, `end`, m, wide.

    turn: angle of each motor over time, all the same, until `move`, s. t_end, s; h, s, of generalized-alpha; radius, m, of the filter.
    """

    names: tuple
    material: pi.Material
    height: float
    end: float
    tip_mass: float
    turn: Callable
    move: float
    t_end: float
    gravity: tuple = (0.0, 0.0)
    h: float = 2.5e-3
    radius: float = 0.03

    @property
    def motors(self):
        return tuple(f"{name} motor" for name in self.names)

    def mesh(self, cells, height=None):
        """A mesh of `cells` polygons; of less height on request, m."""
        return _mesh(cells, self.height if height is None else height, self.end)

    def path(self, t):
        """Position of the tip at time t with rigid plates, (2,), m."""
        angles = self.turn.at(t)[0] * np.arange(1, len(self.names) + 1)
        return np.array([np.cos(angles).sum(), np.sin(angles).sum()])

    def scene(self, meshes, thickness=THICKNESS, gravity=None, load=None):
        """The Scene; meshes: one a plate. load: force on the tip, N; gravity: m/s2 instead of the machine's own."""
        scene = pi.Scene(self.gravity if gravity is None else gravity)
        end = self.add_to(scene, meshes, thickness)
        if load is not None:
            scene.add(pi.PointLoad(end, load, name="load"))
        return scene

    def add_to(self, scene, meshes, thickness, prefix="", x=0.0):
        """Add the machine to a Scene with its first hinge at (x, 0) and `prefix` before all names; returns where its tip is."""
        end = pi.ground
        for k, (name, mesh) in enumerate(zip(self.names, meshes)):
            plate = pi.Plate(mesh, self.material, thickness=thickness, origin=(x + k * plates.LENGTH, 0.0), name=prefix + name)
            begin = scene.add(plate).section("left")
            scene.add(pi.Revolute(end, begin, name=f"{prefix}{name} hinge"))
            scene.add(pi.AngleMotor(end, begin, angle=self.turn, name=f"{prefix}{name} motor"))
            end = plate.section("end")
        scene.add(pi.PointMass(end, self.tip_mass, name=f"{prefix}tip"))
        return end


@lru_cache(maxsize=8)
def _mesh(cells, height, end):
    mesh = pi.mesh.rectangle(plates.LENGTH, height, cells=cells, seed=1)
    right = mesh.sections["right"]
    middle = right[np.abs(mesh.points[right, 1]) <= 0.5 * end]
    return pi.mesh.PolygonMesh(mesh.points, mesh.nodes, mesh.offsets, dict(mesh.sections) | {"end": middle})


MACHINES = {
    "arm": Machine(
        names=("arm",),
        material=pi.Material(E=300e6, nu=0.3, rho=1100.0),
        height=0.25,
        end=0.06,
        tip_mass=0.05,
        turn=pi.profile.ramp(0.0, np.pi / 2, duration=0.3),
        move=0.3,
        t_end=0.5,
    ),
    "two arms": Machine(
        names=("upper", "lower"),
        material=pi.Material(E=20e9, nu=0.3, rho=1900.0),
        height=plates.HEIGHT,
        end=plates.HEIGHT,
        tip_mass=plates.TIP_MASS,
        turn=pi.profile.quintic(0.0, np.pi / 4, duration=0.5),
        move=0.5,
        t_end=0.7,
        gravity=plates.GRAVITY,
        radius=0.018,
    ),
}
