"""Work and dissipation by name: what came in and went out is what the energy has changed by."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import polyida as pi
from polyida.results.motion import unbalanced

RADAU = pi.RadauIIA(h=1e-3)


@dataclass(frozen=True, eq=False)
class Drag(pi.ForceElement):
    """`f = -c |v| v` on a point."""

    at: Any
    c: float = 0.4
    name: str | None = None

    def sides(self):
        return (self.at,)

    def forces(self, t, x, v):
        return -self.c * np.linalg.norm(v, axis=1, keepdims=True) * v


@dataclass(frozen=True, eq=False)
class Damper(Drag):
    """The same, known to dissipate, on a spring of stiffness k to the origin."""

    k: float = 40.0
    dissipates = True

    def forces(self, t, x, v):
        return super().forces(t, x, v) - self.k * x

    def energy(self, x):
        return 0.5 * self.k * float(np.vdot(x, x))


class Told(pi.Model):
    """A coordinate that moves as anybody likes, on which a force and a multiplier work."""

    n, m = 1, 1

    def mass(self, q):
        return np.eye(1)

    def powers(self, t, q, v, lam):
        return {"push": q[0] ** 2 * v[0], "pull": lam[0] * np.cos(t), "steady": 3.0 * v[0]}


def motion(frames):
    """A run of Told along q = sin(2 t), lam = exp(t), at times that are not equally far apart."""
    t = np.linspace(0.0, 1.0, frames) ** 1.5
    q, v, a, lam = (x[:, None] for x in (np.sin(2 * t), 2 * np.cos(2 * t), -4 * np.sin(2 * t), np.exp(t)))
    return pi.Trajectory(Told(), "known", t, q, v, a, lam)


def test_fourth_order_in_the_time_between_frames(scenes):
    exact = {"push": np.sin(2.0) ** 3 / 3, "pull": (np.e * (np.sin(1.0) + np.cos(1.0)) - 1) / 2, "steady": 3 * np.sin(2.0)}
    counts, errors = np.array([9, 17, 33, 65]), []
    for count in counts:
        work = motion(count).energy.work
        errors.append([abs(work[name][-1] - exact[name]) for name in exact])
    push, pull, steady = np.array(errors).T
    assert scenes.slope(1.0 / (counts - 1), push) > 3.9 and scenes.slope(1.0 / (counts - 1), pull) > 3.0
    assert push[-1] < 1e-7 and pull[-1] < 1e-6 and steady.max() < 1e-14


def test_a_steady_load_works_by_where_it_moves(scenes):
    scene, upper = scenes.hinged()
    scene.add(pi.PointLoad(upper.section("right"), (3.0, 5.0), name="push"))
    scene.add(pi.EdgeTraction(upper.section("top"), (0.0, 40.0), name="wind"))
    run = pi.solve(scene.build(), 0.1, RADAU, every=17)
    moved, top = (run.position(at) - run.position(at)[0] for at in ("push", upper.section("top")))
    assert np.allclose(run.energy.work["push"], moved @ [3.0, 5.0], rtol=1e-12, atol=1e-14)
    assert np.allclose(run.energy.work["wind"], top @ [0.0, 40.0] * scenes.THICKNESS, rtol=1e-11, atol=1e-14)


def step(t):
    return float(t > 0.0213)


STEP = pi.profile.from_function(step, lambda t: 0.0, lambda t: 0.0, kinks=[0.0213])


@pytest.mark.parametrize(
    "profile, integrator, every, share",
    [
        (STEP, pi.EnergyMomentum(h=1e-3), 1, 1e-11),
        (STEP, pi.EnergyMomentum(h=1e-3), 4, 3e-3),  # the kink is between two frames
        (pi.profile.linear(0.0, 1.0, 0.0213, 0.01), RADAU, 1, 2e-5),
        (pi.profile.linear(0.0, 1.0, 0.0213, 0.01), RADAU, 4, 2e-4),
        (pi.profile.sine(1.0, 5.0), RADAU, 1, 2e-5),
    ],
)
def test_loads_pay_for_the_energy(scenes, profile, integrator, every, share):
    scene, upper = scenes.hinged()
    scene.add(pi.PointLoad(upper.section("right"), (30.0, 50.0), profile, name="push"))
    run = pi.solve(scene.build(), 0.06, integrator, every=every)
    assert np.abs(unbalanced(run)).max() < share * np.abs(run.energy.work["push"]).max()


@pytest.mark.parametrize(
    "angle, integrator, share",
    [
        (pi.profile.ramp(0.0, 0.5, 0.05, 0.0213), RADAU, 5e-6),
        (pi.profile.quintic(0.0, 0.5, 0.05), pi.GeneralizedAlpha(h=5e-4), 1e-3),
        (pi.profile.sine(0.3, 2.0), RADAU, 2e-4),  # begins with a jump of the acceleration
        (pi.profile.linear(0.0, 0.1, 0.02, 0.0213), pi.RadauIIA(h=2.5e-4), 1e-3),  # blows at both ends
        (pi.profile.linear(0.0, 0.1, 0.02), pi.RadauIIA(h=2.5e-4), 1e-3),  # the first of them where the run begins
    ],
)
def test_motors_pay_for_the_energy(scenes, angle, integrator, share):
    scene, upper = scenes.hinged()
    scene.add(pi.AngleMotor(pi.ground, upper.section("left"), angle, name="drive"))
    run = pi.solve(scene.build(), 0.06, integrator)
    assert run.success, run.message
    assert np.abs(unbalanced(run)).max() < share * np.abs(run.energy.work["drive"]).max()


@pytest.fixture(scope="module")
def braked():
    """A bar with drag and a damper on it, of a material that is damped."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    rubber = pi.Material(50e6, 0.3, 1100.0, viscosity=1e-4, mass_damping=0.5)
    bar = scene.add(pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=20, seed=1), rubber, 0.01, name="bar"))
    scene.add(pi.Revolute(pi.ground, bar.section("left")))
    scene.add(Drag(bar.section("right"), name="air"))
    scene.add(Damper(bar.section("top"), k=0.2, name="damper"))
    return pi.solve(scene.build(), 0.1, RADAU)


P = pi.profile
PARTS = {  # what works on the section at the left or right, and the share of its work that Radau IIA with 0.5 ms loses or gains
    "spring": (lambda left, right: pi.SpringDamper(pi.ground.at((1.0, 0.5)), right, 400.0, 3.0, 0.3, name="part"), 5e-4),
    "torsion spring": (lambda left, right: pi.TorsionSpring(pi.ground, left, 30.0, 0.5, name="part"), 1e-5),
    "torque": (lambda left, right: pi.Torque(left, P.quintic(0.0, 5.0, 0.05), name="part"), 1e-5),
    "force": (lambda left, right: pi.Force(right, (P.sine(5.0, 8.0), 3.0), name="part"), 3e-5),
    "follower": (lambda left, right: pi.Force(right, (0.0, 5.0), follower=True, name="part"), 3e-4),
    "contact": (lambda left, right: pi.PenaltyContact(right, pi.ground.at((0.0, -0.02)), 2e5, 0.3, name="part"), 1e-4),
    "path": (
        lambda left, right: pi.PrescribedPosition(right, None, P.quintic(right.point[1], right.point[1] + 0.2, 0.08), name="part"),
        1e-5,
    ),
}


@pytest.mark.parametrize("kind", PARTS)
def test_every_part_pays_for_the_energy(scenes, kind):
    """A contact goes 0.5 mm deep; what dissipates never gives back."""
    (make, share), (scene, upper) = PARTS[kind], scenes.hinged()
    part = scene.add(make(upper.section("left"), upper.section("right")))
    run = pi.solve(scene.build(), 0.12, pi.RadauIIA(h=5e-4))
    takes = getattr(part, "dissipates", False)
    there = run.energy.dissipated if takes else run.energy.work
    assert run.success and list(there) == ["part"] and np.abs(there["part"]).max() > 1e-2
    assert np.abs(unbalanced(run)).max() < share * np.abs(there["part"]).max()
    assert not takes or (np.diff(there["part"]) >= 0.0).all()


def test_gravity_that_follows_a_profile_works(scenes):
    scene, _ = scenes.hinged((3.0, P.sine(9.81, 8.0)))
    run = pi.solve(scene.build(), 0.05, RADAU)
    assert list(run.energy.work) == ["gravity"] and np.abs(unbalanced(run)).max() < 1e-4 * np.abs(run.energy.work["gravity"]).max()


def test_mass_damping_takes_its_share_of_the_kinetic_energy(scenes):
    """A free plate slows down as exp(-alpha t): 1 - exp(-2 alpha t) of its energy is gone."""
    scene, _ = scenes.single((0.0, 0.0), material={"mass_damping": 2.0})
    model = scene.build()
    run = pi.solve(model, 0.1, RADAU, v0=np.tile([3.0, -1.0], model.n_nodes))
    gone = run.energy.kinetic[0] * (1 - np.exp(-4.0 * run.t))
    assert np.allclose(run.energy.dissipated["upper"], gone, rtol=1e-9)


def test_gravity_and_elements_make_up_the_potential(braked):
    energy = braked.energy
    assert list(energy.elements) == ["damper"]
    assert np.allclose(energy.gravity + energy.elements["damper"], energy.potential, rtol=1e-13)


def test_models_of_one_s_own_tell_or_do_not():
    run = pi.solve(pi.problems.get("pendulum").model, 0.05, RADAU, q0=[-1.0, 0.0])
    assert run.energy.work == run.energy.dissipated == run.energy.elements == {} and np.isnan(run.energy.gravity).all()
    told = motion(9)
    told.model.dissipating = ("push",)
    assert set(told.energy.work) == {"pull", "steady"} and np.array_equal(told.energy.dissipated["push"], -motion(9).energy.work["push"])


def test_compiled_energies_and_powers_are_those_of_the_python_functions():
    """Springs, a contact, elements with states, with a state and an algebraic one, a controller and a motor, at random states."""
    scene, random = pi.Scene(), np.random.default_rng(0)
    car = scene.add(pi.RigidBody(2.0, 0.1, {"axle": (0.2, 0.1), "front": (1.0, 0.0)}, name="car"))
    far, fixed = pi.ground.at((3.0, 2.0)), pi.ground.at((0.0, 0.0), direction=(1.0, 0.0))
    scene.add(pi.SpringDamper(far, car.at("front"), stiffness=20.0, damping=0.3, name="spring"))
    scene.add(pi.TorsionSpring(fixed, car.at("axle"), stiffness=3.0, damping=0.1, name="torsion"))
    scene.add(pi.Maxwell(far, car.at("axle"), stiffness=5.0, damping=2.0, name="rope"))
    scene.add(pi.DCMotor(car.at("axle"), pi.profile.sine(6.0, 1.0), k=0.5, L=0.1, R=1.0, name="motor"))
    scene.add(pi.PID(car.at("axle"), kp=8.0, ki=4.0, kd=2.0, target=0.3, filter=0.1, name="pid"))
    model = scene.build()
    for t, q, v in zip(random.uniform(0.0, 1.0, 5), *random.standard_normal((2, 5, model.n))):
        known = model.compiled_energies(t, q, v)
        exact = np.array([[own.energy(own.places(q), own.velocities(v)), own.power(t, q, v)] for own in model.own_forces])
        assert np.allclose(known, exact, rtol=1e-9, atol=1e-8 * np.abs(exact).max()) and np.abs(exact[:, 1]).min() > 1e-6
        assert model.powers(t, q, v, np.zeros(model.m))["rope"] == known[2, 1]


@pytest.mark.parametrize("integrator", [pi.RadauIIA(rtol=1e-8), pi.IDA(rtol=1e-6)], ids=lambda one: type(one).__name__)
def test_between_long_steps_a_driven_motion_is_on_its_drive(integrator):
    """A motor determines all: steps are as long as a tenth of its motion, and frames between them are exact; so is its work, nearly."""
    scene, turn = pi.Scene(gravity=(0.0, -9.81)), pi.profile.quintic(0.0, 2.0, 0.5)
    bar = scene.add(pi.RigidBody.bar(1.0, 1.0, name="bar"))
    scene.add(pi.Revolute(pi.ground, bar.at("left"), name="pin"))
    scene.add(pi.AngleMotor(pi.ground, bar.at("left"), turn, name="motor"))
    model = scene.build()
    run = pi.solve(model, 1.0, integrator, output=np.linspace(0.0, 1.0, 41))
    angle, torque = turn.over(run.t), turn.over(run.t, 2) / 3 + 0.5 * 9.81 * np.cos(turn.over(run.t))
    assert np.abs(run.position(bar.at("right")) - np.stack([np.cos(angle), np.sin(angle)], axis=1)).max() < 1e-11
    steps = pi.solve(model, 1.0, integrator)
    inner = ~np.isin(run.t, steps.t)
    assert inner.sum() > 30 and np.abs(run.reaction("motor")[:, 0] - torque)[inner].max() < 1e-8
    for one in (run, steps):
        assert one.energy.work["motor"][-1] == pytest.approx(0.5 * 9.81 * np.sin(2.0), rel=5e-4)


def test_the_work_of_a_drive_that_turns_back_between_two_frames():
    """A point on (t^2 / 2, a sin wt) in six steps, the longest of which has most of a period: m (v^2 / 2 + g y) and its change."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    body = scene.add(pi.RigidBody(2.0, 0.1, {"c": (0.0, 0.0)}))
    scene.add(pi.PrescribedPosition(body.at("c"), pi.profile.polynomial([0.0, 0.0, 0.5]), pi.profile.sine(0.1, 2.0), name="path"))
    run = pi.solve(scene.build(), 0.8, pi.RadauIIA(rtol=1e-7))
    w = 4.0 * np.pi
    energy = run.t**2 + (0.1 * w * np.cos(w * run.t)) ** 2 + 2.0 * 9.81 * 0.1 * np.sin(w * run.t)
    assert len(run) < 10 and np.abs(run.energy.work["path"] - (energy - energy[0])).max() < 1e-4


@pytest.mark.parametrize("integrator", [pi.RadauIIA(rtol=1e-7), pi.IDA(rtol=1e-6)], ids=lambda one: type(one).__name__)
def test_until_stops_a_driven_motion_on_its_drive(integrator):
    """A point that is led along (t^2 / 2, a sin wt): the drives determine all, so the last frame and its time are exact."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    body = scene.add(pi.RigidBody(2.0, 0.1, {"c": (0.0, 0.0)}))
    scene.add(pi.PrescribedPosition(body.at("c"), pi.profile.polynomial([0.0, 0.0, 0.5]), pi.profile.sine(0.1, 2.0), name="path"))
    w = 4.0 * np.pi
    for level, t in ((lambda t, q, v: q[0] - 0.05, np.sqrt(0.1)), (lambda t, q, v: q[1] - 0.05, np.arcsin(0.5) / w)):
        run = pi.solve(scene.build(), 0.8, integrator, until=level)
        assert run.status == "stopped" and abs(run.t[-1] - t) < 1e-12 and run.drift[-1] < 1e-12
        assert np.allclose(run.reaction("path")[-1], [2.0, 2.0 * (9.81 - 0.1 * w * w * np.sin(w * t))], rtol=0.0, atol=1e-9)


def test_energy_that_grows_in_impacts_is_told_in_the_summary():
    """A stiff plate that falls flat on the ground, in steps much longer than a wave needs through a cell."""
    scene, stiff = pi.Scene(gravity=(0.0, -9.81)), pi.Material(E=1e10, nu=0.3, rho=1000.0)
    plate = scene.add(pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=40, seed=1), stiff, 0.01, origin=(0.0, 0.06), name="plate"))
    scene.add(pi.Contact(plate.section("bottom"), pi.ground.at((0.0, 0.0)), name="floor"))
    run = pi.solve(scene.build(), 0.06, pi.NonsmoothAlpha(h=1e-4))
    assert run.energy.total.max() > 1.0 and "events: 'floor'" in run.summary() and "the energy grows by" in run.summary()


def test_an_interpolated_state_is_kept_where_constraints_cannot_be_solved(monkeypatch):
    from polyida.integrate import start

    def fails(model, state):
        raise pi.SingularSystem("dependent constraints")

    monkeypatch.setattr(start, "restarted", fails)
    scene = pi.Scene()
    bar = scene.add(pi.RigidBody.bar(1.0, 1.0, name="bar"))
    scene.add(pi.Revolute(pi.ground, bar.at("left"), name="pin"))
    scene.add(pi.AngleMotor(pi.ground, bar.at("left"), pi.profile.quintic(0.0, 2.0, 0.5), name="motor"))
    run = pi.solve(scene.build(), 0.5, pi.RadauIIA(), output=[0.0, 0.12, 0.5])
    assert run.success and len(run) == 3


@pytest.mark.parametrize(
    "frames, seen", [({}, True), ({"every": 5}, True), ({"output": np.linspace(0.0, 5.0, 8)}, False), ({"every": 150}, False)]
)
def test_works_of_frames_that_are_too_far_apart_are_refused(frames, seen):
    """A mass on a spring and a damper at 3 Hz: its dissipated energy is what its own energy loses."""
    scene = pi.Scene()
    mass = scene.add(pi.RigidBody(1.0, 1.0, {"c": (0.0, 0.0)}, velocity=(10.0, 0.0), name="mass"))
    scene.add(pi.Prismatic(pi.ground.at((0.0, 0.0), (1.0, 0.0)), mass.at("c"), name="rail"))
    scene.add(pi.SpringDamper(pi.ground.at((-1.0, 0.0)), mass.at("c"), 400.0, 0.4, name="damper"))
    run = pi.solve(scene.build(), 5.0, pi.GeneralizedAlpha(h=5e-3), **frames)
    if seen:
        lost = run.energy.total[0] - run.energy.total
        assert run.energy.dissipated["damper"] == pytest.approx(lost, abs=0.02 * lost[-1])
        return
    with pytest.raises(pi.InputError, match="too far apart for the work of 'damper': .* store more frames"):
        run.energy.dissipated  # noqa: B018, it is refused
