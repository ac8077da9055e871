"""Velocity and spin of bodies at the start: as rigid bodies move, as far as joints let them, in every integrator, in files."""

import warnings
from dataclasses import dataclass

import numpy as np
import pytest

import polyida as pi
from polyida.assembly import motion as motions
from polyida.problems.literature import n_four_bar

V, SPIN = (0.7, -0.4), 3.0
INTEGRATORS = {
    "alpha": lambda: pi.GeneralizedAlpha(h=1e-3),
    "energy": lambda: pi.EnergyMomentum(h=1e-3),
    "IDA": lambda: pi.IDA(rtol=1e-8, atol=1e-10),
    "Radau": lambda: pi.RadauIIA(rtol=1e-8),
}


@dataclass(frozen=True, eq=False)
class Dumbbell(pi.Body):
    """Two masses, 1 and 3 kg, 0.8 m apart, each a coordinate of its own."""

    velocity: tuple = V
    spin: float = SPIN
    name: str | None = None

    def coordinates(self):
        return [1.0 + 1.0j, 1.8 + 1.0j]

    def mass_matrix(self):
        return np.diag([1.0, 3.0])

    def attachments(self):
        return {"a": [1.0, 0.0], "b": [0.0, 1.0]}

    def translation(self):
        return [1.0, 1.0]

    def rows(self):
        w = self.at("b").x - self.at("a").x
        return [(pi.dot(w, w) - 0.64) * (0.5 / 0.8)]


def plate(scenes, **motion):
    return scenes.plate("bar", 12, angle=0.3, origin=(2.0, 1.0), **motion)


BODIES = {
    "plate": plate,
    "rigid plate": lambda scenes, **motion: pi.Rigid(plate(scenes, **motion)),
    "reduced plate": lambda scenes, **motion: pi.Reduced(plate(scenes, **motion), modes=2),
    "rigid body": lambda scenes, **motion: pi.RigidBody(
        2.0, 0.3, {"left": (0, 0), "right": (1, 0)}, origin=(2, 1), angle=0.3, center=(0.5, 0.1), name="bar", **motion
    ),
}


def energy(model, state):
    return 0.5 * state.v @ (model.mass(state.q) @ state.v)


def with_body(body):
    scene = pi.Scene()
    scene.add(body)
    return scene.build()


def inertia(kind):
    """About the centre of mass, kg m2, in closed form."""
    return {"dumbbell": 0.75 * 0.8**2, "rigid body": 0.3}.get(kind, 1.1 * (1.0**2 + 0.1**2) / 12)


@pytest.mark.parametrize("kind", [*BODIES, "dumbbell"])
def test_a_free_body_moves_as_it_was_given(scenes, kind):
    model = with_body(Dumbbell(name="bar") if kind == "dumbbell" else BODIES[kind](scenes, velocity=V, spin=SPIN))
    mass = {"dumbbell": 4.0, "rigid body": 2.0}.get(kind, 1.1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        state = pi.consistent_state(model)
    assert energy(model, state) == pytest.approx(0.5 * mass * np.dot(V, V) + 0.5 * inertia(kind) * SPIN**2, rel=1e-9)
    assert np.abs(model.phi_rate(0.0, state.q, state.v)).max(initial=0.0) < 1e-14
    for body in model.reduced_bodies:  # the momentum is m V: T^H M v
        z = state.v.reshape(-1, 2)[body.pairs] @ (1, 1j)
        assert np.vdot(body.translation, body.mass @ z) == pytest.approx(mass * complex(*V), rel=1e-9)
    assert not pi.consistent_state(model, v0=np.zeros(model.n)).v.any()


@pytest.mark.parametrize("count", [1, 3, 2 * motions.MANY])
def test_free_rigid_bodies_of_any_mass_and_angle_keep_their_spin(count):
    """The row that keeps a body rigid restricts no rigid motion: in numbers it leaves round-off."""
    random = np.random.default_rng(1)
    for _ in range(20 if count < motions.MANY else 1):
        scene = pi.Scene()
        for k in range(count):
            mass, inertia, angle, *origin = random.uniform(0.1, 3.0, 5)
            scene.add(pi.RigidBody(mass, inertia, {"c": (0.0, 0.0)}, tuple(origin), angle, velocity=V, spin=SPIN, name=str(k)))
        model = scene.build()
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            z = pi.consistent_state(model).v.reshape(count, 2, 2)[:, 1]
        assert np.linalg.norm(z, axis=1) == pytest.approx(
            SPIN * np.linalg.norm(model.reference.reshape(count, 2, 2)[:, 1], axis=1), rel=1e-12
        )


@pytest.mark.parametrize("kind", BODIES)
def test_a_hinge_keeps_the_moment_of_momentum_about_it(scenes, kind):
    scene = pi.Scene()
    bar = scene.add(BODIES[kind](scenes, spin=SPIN))
    side = bar.at("left") if kind == "rigid body" else bar.section("left")
    scene.add(pi.Revolute(pi.ground, side, name="hinge"))
    model = scene.build()
    with pytest.warns(UserWarning, match="'bar' from .* 3 rad/s to "):
        state = pi.consistent_state(model)
    mass, arm = (2.0, np.hypot(0.5, 0.1)) if kind == "rigid body" else (1.1, 0.5)
    spin = SPIN * inertia(kind) / (inertia(kind) + mass * arm**2)
    assert np.abs(model.phi_rate(0.0, state.q, state.v)).max() < 1e-14
    assert energy(model, state) == pytest.approx(0.5 * spin**2 * (inertia(kind) + mass * arm**2), rel=1e-9)


@pytest.mark.parametrize("kind", BODIES)
def test_what_fits_the_joints_is_taken_as_it_is(scenes, kind):
    arm = np.exp(0.3j) * (0.5 + 0.1j if kind == "rigid body" else 0.5)
    velocity = SPIN * np.array([-arm.imag, arm.real])
    scene = pi.Scene()
    bar = scene.add(BODIES[kind](scenes, velocity=velocity, spin=SPIN))
    side = bar.at("left") if kind == "rigid body" else bar.section("left")
    scene.add(pi.Revolute(pi.ground, side, name="hinge"))
    scene.add(pi.AngleMotor(pi.ground, side, pi.profile.polynomial([0.0, SPIN]), name="drive"))
    model = scene.build()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        state = pi.consistent_state(model)
    free = pi.Scene()
    free.add(BODIES[kind](scenes, velocity=velocity, spin=SPIN))
    assert np.allclose(state.v, pi.consistent_state(free.build()).v, atol=1e-13)


@pytest.mark.parametrize("name", INTEGRATORS)
@pytest.mark.parametrize("kind", ["plate", "rigid body"])
def test_every_integrator_begins_with_it(scenes, kind, name, tmp_path):
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = scene.add(BODIES[kind](scenes, velocity=V, spin=0.0 if kind == "plate" else SPIN))
    run = pi.solve(scene.build(), 0.05, INTEGRATORS[name](), out=tmp_path / "run.h5")
    assert run.success
    centre = bar.section(np.arange(bar.mesh.n_nodes)) if kind == "plate" else bar.at("left")
    arm = 0.0 if kind == "plate" else complex(*bar.at("left").point) - bar.coordinates()[0]
    turned = arm * np.exp(1j * SPIN * run.t) - arm
    fallen = np.outer(run.t, V) + np.outer(run.t**2, (0.0, -9.81 / 2)) + np.stack([turned.real, turned.imag], axis=1)
    assert np.allclose(run.position(centre) - centre.point, fallen, atol=1e-5)
    part = pi.load(tmp_path / "run.h5").model.parts["bar"]
    assert tuple(part.velocity) == V and part.spin == bar.spin


class Sliding(pi.Model):
    """A unit mass on the x axis that moves at the start."""

    n, m = 2, 1
    start = (2.0, 0.5)

    def mass(self, q):
        return np.eye(2)

    def force(self, t, q, v):
        return np.zeros(2)

    def phi(self, t, q):
        return q[1:]

    def phi_q(self, t, q):
        return np.array([[0.0, 1.0]])

    def initial_velocity(self, t, q):
        return self.start


def test_a_model_of_ones_own_says_how_it_begins():
    assert np.array_equal(pi.consistent_state(Sliding()).v, [2.0, 0.0])
    wrong = Sliding()
    wrong.start = (1.0, 2.0, 3.0)
    with pytest.raises(pi.InputError, match="initial_velocity: shape"):
        pi.consistent_state(wrong)


@pytest.mark.parametrize("drive", ["motor", "path"])
@pytest.mark.parametrize("kind", BODIES)
def test_the_start_is_continuous_in_the_motion_that_is_given(scenes, kind, drive):
    """Beside a joint that moves at t = 0 a body without a motion begins as one with next to none: as a rigid body that follows it.

    No warning says that this motion was changed: it is nothing beside what the joint makes of it.
    """

    def begun(**motion):
        scene = pi.Scene()
        bar = scene.add(BODIES[kind](scenes, **motion))
        side = bar.at("left") if kind == "rigid body" else bar.section("left")
        if drive == "motor":
            scene.add(pi.Revolute(pi.ground, side, name="hinge"))
            scene.add(pi.AngleMotor(pi.ground, side, pi.profile.polynomial([0.0, 2.0]), name="drive"))
        else:
            scene.add(
                pi.PrescribedPosition(side, pi.profile.polynomial([side.point[0], 0.5]), pi.profile.polynomial([side.point[1], -0.3]))
            )
        model = scene.build()
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            return model, pi.consistent_state(model)

    model, still = begun()
    for motion in (dict(spin=1e-12), dict(velocity=(1e-12, 0.0))):
        assert np.abs(begun(**motion)[1].v - still.v).max() < 1e-10
    mass, arm = (2.0, np.hypot(0.5, 0.1)) if kind == "rigid body" else (1.1, 0.5)
    about_end = inertia(kind) + mass * arm**2
    leads = 0.3 + (np.arctan2(0.1, 0.5) if kind == "rigid body" else 0.0)
    across = 0.5 * -np.sin(leads) - 0.3 * np.cos(leads)
    moved = 0.5 * about_end * 2.0**2 if drive == "motor" else 0.5 * mass * (0.34 - (across * arm) ** 2 * mass / about_end)
    assert energy(model, still) == pytest.approx(moved, rel=1e-9)


def test_many_bodies_start_in_sparse_matrices_as_in_dense_ones(monkeypatch):
    model, found = n_four_bar(40).build(), []
    for rows in (10**9, motions.MANY):
        monkeypatch.setattr(motions, "MANY", rows)
        found.append(pi.consistent_state(model))
    assert np.abs(found[0].v - found[1].v).max() < 1e-12 < np.abs(found[0].v).max()
    monkeypatch.setattr(motions.np.linalg, "lstsq", None)
    monkeypatch.setattr(motions.np.linalg, "eigvalsh", None)
    pi.consistent_state(model)


def test_a_motion_that_is_none_is_told_of_bodies_of_ones_own():
    with pytest.raises(pi.InputError, match="Dumbbell 'd': spin = None must be"):
        pi.consistent_state(with_body(Dumbbell(spin=None, name="d")))
