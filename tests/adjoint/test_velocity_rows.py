"""Gradients of runs of models with velocity rows, of joints and of own models, against differences."""

import numpy as np
import pytest

import polyida as pi

SIZES = {"q": 1.0, "v": 0.1, "a": 1e-2, "lam": 1e-2}
ALL = pi.objective.UserObjective(
    lambda run: sum(float(np.sum(size * getattr(run, name)[1:] ** 2)) for name, size in SIZES.items()),
    lambda run: {name: 2 * size * getattr(run, name) * (np.arange(len(run)) > 0)[:, None] for name, size in SIZES.items()},
)
INTEGRATORS = {
    "alpha": pi.GeneralizedAlpha(h=0.01, tolerance=1e-12),
    "Radau": pi.RadauIIA(h=0.02, tolerance=1e-12),
    "Radau index3": pi.RadauIIA(h=0.02, form="index3", tolerance=1e-12),
    "v left alone": pi.RadauIIA(h=0.02, form="index3", project=False, tolerance=1e-12),
}


def disc():
    """A disc on a slope that a spring holds."""
    scene, along = pi.Scene(gravity=(0.0, -9.81)), np.array([np.cos(0.4), -np.sin(0.4)])
    at = 0.1 * np.array([-along[1], along[0]])
    rim = {"c": (0.0, 0.0), "rim": (0.1, 0.0)}
    body = scene.add(
        pi.RigidBody(mass=2.0, inertia=0.013, points=rim, origin=tuple(at), spin=-3.0, velocity=tuple(0.3 * along), name="disc")
    )
    scene.add(pi.RollingDisc(pi.ground.at((0.0, 0.0), direction=along), body.at("c"), radius=0.1, name="contact"))
    scene.add(pi.SpringDamper(pi.ground.at((0.5, 0.0)), body.at("rim"), stiffness=200.0, name="spring"))
    return scene.build(), ["disc.mass", "disc.inertia", "spring.stiffness", "disc.spin", "v0"]


def sleigh():
    """Chaplygin's sleigh, whose knife is steered."""
    scene, steering = pi.Scene(), pi.profile.quintic(0.0, 0.3, 0.05)
    points, start = {"knife": (-0.4, 0.0)}, {"velocity": (0.7, 0.44), "spin": 1.1}
    body = scene.add(pi.RigidBody(mass=1.3, inertia=0.2, points=points, name="sleigh", **start))
    scene.add(pi.Skate(body.at("knife"), angle=steering, name="knife"))
    return scene.build(), ["sleigh.mass", "sleigh.inertia", "knife.end", "knife.duration", "sleigh.velocity"]


class Skate(pi.Model):
    """A skate on a belt that shakes; its angle to the belt depends on the place."""

    n, m, p = 3, 0, 1
    parameters = ("pull", "tilt", "belt")
    needs = pi.Needs(mass_varies=False, velocity_forces=False)

    def __init__(self):
        self.pull, self.tilt, self.belt = 2.0, 0.3, 0.2

    def mass(self, q):
        return np.diag([1.0, 1.0, 0.4])

    def force(self, t, q, v):
        return np.array([-self.pull, 0.0, -0.2 * np.cos(q[0])])

    def psi(self, t, q, v):
        angle = q[2] + self.tilt * q[0]
        return np.array([v[1] * np.cos(angle) - v[0] * np.sin(angle) - self.belt * np.sin(3.0 * t)])

    def initial_velocity(self, t, q):
        return np.array([0.0, 0.0, 1.5])


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("made", [disc, sleigh, lambda: (Skate(), ["pull", "tilt", "belt", "v0"])], ids=["disc", "sleigh", "own"])
def test_gradients_of_few_steps(made, integrator):
    model, names = made()
    run = pi.solve(model, 0.04, INTEGRATORS[integrator])
    errors = pi.check_gradient(run, ALL, parameters=names)
    assert set(errors) == set(names)
    assert max(errors.values()) < 1e-6, errors


def test_a_plate_on_a_skate():
    scene = pi.Scene(gravity=(1.0, -2.0))
    plate = scene.add(pi.Plate(pi.mesh.quads(0.4, 0.1, 8, 2), pi.Material(E=1e6, nu=0.3, rho=1e3), thickness=0.01, spin=2.0, name="plate"))
    scene.add(pi.Skate(plate.section("left"), name="skate"))
    run = pi.solve(scene.build(), 0.03, pi.GeneralizedAlpha(h=0.01, tolerance=1e-12))
    errors = pi.check_gradient(run, ALL, parameters=["plate.stiffness", "plate.rho", "v0"])
    assert max(errors.values()) < 1e-6, errors


def test_what_has_no_adjoint_says_what_has():
    run = pi.solve(Skate(), 0.02, pi.GeneralizedAlpha(h=0.01, form="stabilised"))
    with pytest.raises(pi.InputError, match=r'psi\[0\] is a velocity row, for which form "stabilised" has no adjoint; form "index3" has'):
        pi.gradient(run, ALL)
