"""The energy-momentum method: energy and momenta exactly kept, second order, joints and motors included."""

from dataclasses import dataclass

import numpy as np
import pytest

import polyida as pi
from polyida.integrate.start import consistent_acceleration

ENERGY = 1e-9  # of the energy exchanged, for Newton's tolerance


def test_energy_is_kept_while_plates_swing(scenes):
    scene, upper, lower = scenes.pair(bend=0.3)
    scene.add(pi.Revolute(pi.ground, upper.section("left")))
    scene.add(pi.Revolute(upper.section("right"), lower.section("left")))
    scene.add(pi.PointMass(lower.section("right"), 0.5))
    run = pi.solve(scene.build(), 1.0, pi.EnergyMomentum(h=4e-3))
    assert run.success, run.message
    assert np.ptp(run.energy.total) < ENERGY * np.ptp(run.energy.potential)
    assert run.counts.factorizations == 1 and run.drift.max() < 1e-12


def test_free_plate_keeps_its_momenta(scenes):
    scene, _ = scenes.single((0.0, 0.0))
    model = scene.build()
    x, y = model.reference.T
    v0 = np.column_stack([1.0 - 8.0 * y, 8.0 * x]).ravel()
    run = pi.solve(model, 0.5, pi.EnergyMomentum(h=5e-3), v0=v0)
    momentum = (model.mass() @ run.v.T).T.reshape(len(run), -1, 2)
    place = model.reference + run.q.reshape(momentum.shape)
    angular = (place[..., 0] * momentum[..., 1] - place[..., 1] * momentum[..., 0]).sum(axis=1)
    assert np.ptp(momentum.sum(axis=1), axis=0).max() < 1e-10 * np.abs(momentum.sum(axis=1)).max()
    assert np.ptp(angular) < 1e-8 * abs(angular[0])
    assert np.ptp(run.energy.total) < ENERGY * run.energy.total[0]


def turning(scenes, **options):
    """Two plates that a motor between them bends smoothly."""
    return scenes.jointed("motor between", pi.profile.ramp(0.0, 0.6, duration=0.25), gravity=(0.0, 0.0), **options).build()


def test_forces_are_of_second_order_too(scenes):
    """At the ends of steps and between them, against another family of integrators."""
    model, times, steps = turning(scenes, cells=8), [0.0413, 0.0871, 0.1], np.array([4e-3, 2e-3, 1e-3])
    exact = pi.solve(model, 0.1, pi.GeneralizedAlpha(h=5e-5, tolerance=1e-8), output=times)
    runs = [pi.solve(model, 0.1, pi.EnergyMomentum(h=h), output=times) for h in steps]
    for part in (slice(0, 2), slice(2, 3)):
        for name in ("v", "a", "lam"):
            errors = [np.abs(getattr(run, name)[part] - getattr(exact, name)[part]).max() for run in runs]
            assert scenes.slope(steps, errors) == pytest.approx(2.0, abs=0.25), name


def test_torque_converges_behind_a_jump_of_a_motor_s_speed(scenes):
    """With an odd number of steps behind the jump, the worst for a velocity that alternates; some damping, as it would ring for ever."""
    scene, plate = scenes.hinged(cells=8, material={"viscosity": 1e-3})
    angle = pi.profile.linear(0.0, 0.15, duration=0.05, begin=0.02)
    scene.add(pi.AngleMotor(pi.ground, plate.section("left"), angle=angle, name="drive"))
    model, steps = scene.build(), 0.04 / np.array([33, 67, 133])
    exact = pi.solve(model, 0.06, pi.IDA(rtol=1e-6, atol=1e-8))
    runs = [pi.solve(model, 0.06, pi.EnergyMomentum(h=h)) for h in steps]
    assert all(run.velocity_drift[-1] < 1e-11 for run in runs)
    errors = [abs(run.reaction("drive")[-1] - exact.reaction("drive")[-1])[0] for run in runs]
    assert errors[-1] < 0.02 and scenes.slope(steps, errors) > 1.5


def test_a_start_off_the_velocity_constraint_is_mended(scenes):
    """Generalized-alpha leaves v off it by the square of its step."""
    model = turning(scenes)
    start = pi.solve(model, 0.1, pi.GeneralizedAlpha(h=2e-3)).state
    run = pi.solve(model, 0.15, pi.EnergyMomentum(h=2e-3), state=start)
    assert run.velocity_drift[0] > 1e-6 and run.velocity_drift[1:].max() < 1e-11


def test_a_run_in_two_parts_is_the_same(scenes, tmp_path):
    """To Newton's tolerance: it starts from the forces that the last step had at its middle, which the file keeps."""
    model, integrator = turning(scenes), pi.EnergyMomentum(h=2e-3)
    whole = pi.solve(model, 0.1, integrator)
    pi.solve(model, 0.05, integrator, out=tmp_path / "run.h5")
    rest = pi.resume(tmp_path / "run.h5", 0.1)
    assert rest.counts.steps == whole.counts.steps and rest.state.memory.keys() == {"a_middle", "lam_middle", "h_middle"}
    for name, bound in (("q", 1e-13), ("v", 1e-10), ("lam", 1e-9)):
        assert np.abs(getattr(rest, name)[-1] - getattr(whole, name)[-1]).max() < bound * max(1.0, np.abs(getattr(whole, name)).max())


def elements():
    """{name: a function that adds an element to a scene with two bars}; the first is beside its bar, with a direction."""
    at = pi.ground.at
    return {
        "spring": lambda a, b: pi.SpringDamper(at((0.5, 0.5)), b.at("right"), stiffness=60.0, preload=2.0),
        "torsion": lambda a, b: pi.TorsionSpring(a.at("right"), b.at("left"), stiffness=8.0, angle=0.1),
        "line": lambda a, b: pi.PenaltyContact(b.at("right"), at((0.0, -0.4)), stiffness=2e4),
        "circle": lambda a, b: pi.PenaltyContact(b.at("right"), at((1.2, -1.0)), stiffness=2e4, radius=0.5),
    }


def two_bars(element):
    """Two hinged bars that fall, with one force element."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    points = {"left": (-0.5, 0.0), "right": (0.5, 0.0)}
    a, b = (scene.add(pi.RigidBody(1.0, 0.1, points=points, origin=(x, 0.0), name=f"bar{x}")) for x in (0.5, 1.5))
    scene.add(pi.Revolute(pi.ground, a.at("left")))
    scene.add(pi.Revolute(a.at("right"), b.at("left")))
    scene.add(element(a, b))
    return scene.build()


@pytest.mark.parametrize("name", elements())
def test_ready_made_elements_keep_their_energy_without_a_new_factor(name):
    model = two_bars(elements()[name])
    run = pi.solve(model, 0.5, pi.EnergyMomentum(h=1e-3, tolerance=1e-12))
    assert run.success, run.message
    exchanged = np.ptp([sum(model.element_energies(q)) for q in run.q])
    assert exchanged > 0.1  # the element acts
    assert np.ptp(run.energy.total) < ENERGY * np.ptp(run.energy.kinetic)
    assert model.switching or run.counts.factorizations == 1


@pytest.mark.parametrize("name", ["spring", "torsion", "line", "damper", "torque"])
def test_compiled_elements_move_as_the_same_ones_on_the_plain_path(name):
    more = {
        "damper": lambda a, b: pi.SpringDamper(pi.ground.at((0.5, 0.5)), b.at("right"), stiffness=60.0, damping=3.0),
        "torque": lambda a, b: pi.Torque(b.at("right"), pi.profile.sine(2.0, 3.0)),
    }
    model, integrator = two_bars((elements() | more)[name]), pi.EnergyMomentum(h=2e-3, tolerance=1e-13)
    fast = pi.solve(model, 0.3, integrator)
    model.compiled = False
    slow = pi.solve(model, 0.3, integrator)
    assert max(slow.counts.factorizations, fast.counts.factorizations) < 10 or model.switching
    assert slow.success and np.abs(fast.q[-1] - slow.q[-1]).max() < 1e-9


def test_frames_of_rigid_bodies_are_consistent_with_their_positions_and_velocities():
    """v, a and lam that the compiled loop makes are those of the model's own functions; also behind the steps of a motor."""
    for drive in (None, pi.profile.ramp(0.0, 0.6, duration=0.25)):
        scene = pi.Scene(gravity=(0.0, -9.81))
        points = {"left": (-0.5, 0.0), "right": (0.5, 0.0)}
        a, b = (scene.add(pi.RigidBody(1.0, 0.1, points=points, origin=(x, 0.0), name=f"bar{x}")) for x in (0.5, 1.5))
        scene.add(pi.AngleMotor(pi.ground, a.at("left"), angle=drive) if drive else pi.Revolute(pi.ground, a.at("left")))
        if drive:
            scene.add(pi.Revolute(pi.ground, a.at("left")))
        scene.add(pi.Revolute(a.at("right"), b.at("left")))
        scene.add(pi.PointMass(b.at("right"), 0.3))
        scene.add(pi.SpringDamper(pi.ground.at((0.5, 0.5)), b.at("right"), stiffness=60.0, damping=1.0))
        model = scene.build()
        run = pi.solve(model, 0.2, pi.EnergyMomentum(h=1e-3))
        assert run.success and run.velocity_drift.max() < 1e-12
        for k in (1, 100, -1):
            a, lam = consistent_acceleration(model, run.t[k], run.q[k], run.v[k])
            assert np.abs(run.a[k] - a).max() < 1e-9 * np.abs(a).max() and np.abs(run.lam[k] - lam).max() < 1e-9 * np.abs(lam).max()


@dataclass(frozen=True, eq=False)
class Magnet(pi.ForceElement):
    """Two points attract with the potential `-1 / (d + 0.5)`, J, d their distance, m."""

    a: object
    b: object
    name: str | None = None

    def sides(self):
        return (self.a, self.b)

    def forces(self, t, x, v):
        d = np.linalg.norm(x[1] - x[0])
        pull = (x[1] - x[0]) / (d * (d + 0.5) ** 2)
        return np.stack([pull, -pull])

    def energy(self, x):
        return -1.0 / (np.linalg.norm(x[1] - x[0]) + 0.5)


def test_a_force_element_in_python_keeps_the_factor_and_its_energy():
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = scene.add(pi.RigidBody(1.0, 0.1, {"left": (-0.5, 0.0), "right": (0.5, 0.0)}, origin=(0.5, 0.0), name="bar"))
    scene.add(pi.Revolute(pi.ground, bar.at("left"), name="pin"))
    scene.add(Magnet(pi.ground.at((0.0, -1.0)), bar.at("right")))
    run = pi.solve(scene.build(), 0.5, pi.EnergyMomentum(h=1e-3))
    assert run.success and run.counts.factorizations < 10 and run.counts.residuals < 2.2 * run.counts.steps
    assert np.ptp(run.energy.total) < ENERGY * np.ptp(run.energy.kinetic)


@pytest.mark.parametrize("name", ["spring", "torsion", "circle"])
def test_forces_between_bodies_keep_momenta(name):
    """Also in the frames, whose velocities are projected and scaled: the bound is Newton's tolerance, 1e-12, over 50 steps, with a factor of 100."""
    between = {
        "spring": lambda a, b: pi.SpringDamper(a.at("p"), b.at("p"), stiffness=200.0, damping=3.0),
        "torsion": lambda a, b: pi.TorsionSpring(a.at("p"), b.at("p"), stiffness=5.0),
        "circle": lambda a, b: pi.PenaltyContact(a.at("p"), b.at("p"), 1e3, radius=1.2),
    }
    scene = pi.Scene()
    a = scene.add(pi.RigidBody(1.0, 0.1, {"p": (0.2, 0.1)}, velocity=(-1.2, 1.6), spin=1.0))
    b = scene.add(pi.RigidBody(2.0, 0.3, {"p": (-0.2, 0.1)}, origin=(1.0, 0.2), spin=-2.0))
    scene.add(between[name](a, b))
    run = pi.solve(scene.build(), 0.5, pi.EnergyMomentum(h=0.02, tolerance=1e-12))
    q, v = (x.reshape(len(run), -1, 2) + start for x, start in ((run.q, run.model.reference), (run.v, 0.0)))
    masses = np.array([1.0, 1.0, 2.0, 2.0])  # of centre and direction of each body
    momentum, angular = masses[::2] @ v[:, ::2], (q[..., 0] * v[..., 1] - q[..., 1] * v[..., 0]) @ masses
    assert run.success and np.ptp(momentum, axis=0).max() < 1e-8 and np.ptp(angular) < 1e-8


def test_a_level_contact_without_friction_leaves_the_speed_along_it():
    scene = pi.Scene(gravity=(0.0, -9.81))
    ball = scene.add(pi.RigidBody(1.0, 0.1, {"c": (0.0, 0.0)}, origin=(0.0, 0.05), velocity=(1.0, 0.0)))
    scene.add(pi.PenaltyContact(ball.at("c"), pi.ground.at((0.0, 0.0)), 1e4))
    run = pi.solve(scene.build(), 0.25, pi.EnergyMomentum(h=5e-3))
    assert run.v[:, 1].max() > 0.5 and np.abs(run.v[:, 0] - 1.0).max() < 1e-9


def test_frames_of_a_free_scene_are_made_at_once(monkeypatch):
    """The compiled loop projects them: the rows of constraints are asked for once a stretch, not once a frame."""
    scene = pi.Scene()
    a = scene.add(pi.RigidBody(1.0, 0.1, {"p": (0.5, 0.0)}, velocity=(-1.2, 1.6), spin=1.0))
    b = scene.add(pi.RigidBody(2.0, 0.3, {"p": (-0.5, 0.0)}, origin=(1.0, 0.0), velocity=(-1.2, 3.6), spin=3.0))
    scene.add(pi.Revolute(a.at("p"), b.at("p")))
    model, calls, phi_q = scene.build(), [], type(scene.build()).phi_q
    monkeypatch.setattr(type(model), "phi_q", lambda *at: calls.append(at) or phi_q(*at))
    run = pi.solve(model, 0.2, pi.EnergyMomentum(h=2e-3, tolerance=1e-12))
    assert run.success and len(calls) < len(run) / 2
    assert np.ptp(run.momentum, axis=0).max() < 1e-9 and np.ptp(run.angular_momentum) < 1e-9
    assert np.ptp(run.energy.total) < 1e-9 and run.velocity_drift[1:].max() < 1e-12
