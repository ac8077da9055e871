"""Contacts and other declared switches: no integrator steps over one, or gains energy at it."""

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest

import polyida as pi
from polyida.integrate.switches import Switches

INTEGRATORS = {
    "radau": (pi.RadauIIA(), 1e-2),
    "radau, tight": (pi.RadauIIA(rtol=1e-9), 1e-5),
    "radau, h": (pi.RadauIIA(h=0.02), 1e-3),
    "radau, long h": (pi.RadauIIA(h=0.05), 1e-4),
    "alpha": (pi.GeneralizedAlpha(), 1e-3),
    "alpha, h": (pi.GeneralizedAlpha(h=1e-3), 1e-2),
    "alpha, long h": (pi.GeneralizedAlpha(h=0.02), 1e-2),
    "IDA": (pi.IDA(), 1e-3),
    "IDA, tight": (pi.IDA(rtol=1e-9), 1e-6),
    "energy": (pi.EnergyMomentum(h=0.02), 1e-4),
}


def thrown(stop, gravity=0.0, at=(0.0, 0.0), velocity=(1.0, 0.0)):
    """The model of a body of 1 kg that is thrown; stop: a function of its point, for the force element that it meets."""
    scene = pi.Scene(gravity=(0.0, -gravity))
    body = scene.add(pi.RigidBody(1.0, 1.0, {"c": (0.0, 0.0)}, origin=at, velocity=velocity, name="body"))
    scene.add(stop(body.at("c")))
    return scene.build()


def ball(x=0.5, y=0.0, **settings):
    return lambda point: pi.PenaltyContact(point, pi.ground.at((x, y)), **{"stiffness": 1e6, "radius": 0.01, "name": "stop"} | settings)


def speeds(run):
    return run.v.reshape(len(run), -1, 2)[:, 0]


@pytest.mark.parametrize("name", INTEGRATORS)
def test_a_body_comes_back_from_an_elastic_ball(name):
    integrator, near = INTEGRATORS[name]
    run = pi.solve(thrown(ball()), 1.0, integrator)
    assert run.status == "done" and speeds(run)[-1] == pytest.approx([-1.0, 0.0], abs=near)


@pytest.mark.parametrize("name", ["radau", "alpha, long h", "IDA"])
def test_a_glancing_blow_keeps_energy_and_turns_the_way(name):
    """From the ball's centre nothing but central force acts: energy and moment of momentum about it are kept."""
    run = pi.solve(thrown(ball(y=-0.008)), 1.0, INTEGRATORS[name][0])
    (vx, vy), (x, y) = speeds(run)[-1], run.q.reshape(len(run), -1, 2)[-1, 0]
    assert vy > 0.3 and vx**2 + vy**2 == pytest.approx(1.0, abs=2e-3)
    assert (x - 0.5) * vy - (y + 0.008) * vx == pytest.approx(-0.008, abs=2e-4)


@pytest.mark.parametrize("name", ["radau, tight", "alpha, long h", "energy"])
def test_bounces_on_a_line_keep_energy(name):
    run = pi.solve(
        thrown(lambda p: pi.PenaltyContact(p, pi.ground.at((0.0, 0.0)), 1e5, exponent=1.0), 9.81, (0.0, 0.2)), 1.0, INTEGRATORS[name][0]
    )
    energy = run.energy
    assert run.success and abs(energy.total - energy.total[0]).max() < 5e-3 * energy.kinetic.max()


@pytest.mark.parametrize("name", ["alpha, h", "radau", "IDA"])
def test_a_body_that_passes_the_centre_of_a_soft_ball_keeps_its_energy(name):
    """The force turns round there within no time; behind it no integrator may go on with what it remembers of the force before."""
    run = pi.solve(thrown(ball(stiffness=2e4)), 0.7, INTEGRATORS[name][0])
    assert run.status == "done" and speeds(run)[-1] == pytest.approx([1.0, 0.0], abs=2e-3)


@pytest.mark.parametrize("name", ["alpha, long h", "radau, h", "energy"])
def test_a_run_names_the_contact_that_its_shortest_steps_are_too_long_for(name, tmp_path):
    run = pi.solve(thrown(ball(stiffness=1e12)), 0.6, INTEGRATORS[name][0], out=tmp_path / "run.h5")
    told = r"at t = 0\.490\d* s the shortest step, h/256, is too long for 'stop'"
    for found in (run, pi.load(tmp_path / "run.h5")):
        assert re.search(told, found.message) and re.search(told, found.summary())
    assert "too long" not in pi.solve(thrown(ball()), 0.6, INTEGRATORS[name][0]).message


def test_a_damped_blow_loses_what_hunt_and_crossley_say():
    """Slow blows at a speed v come back with about (1 - c v) v."""
    run = pi.solve(thrown(ball(damping=0.05)), 1.0, pi.RadauIIA(rtol=1e-8))
    assert speeds(run)[-1, 0] == pytest.approx(-0.95, abs=5e-3)


def test_a_body_at_rest_in_contact_takes_no_more_steps():
    """Pressed in by its weight, it stays there and nothing switches."""
    depth = (9.81 / 1e6) ** (2 / 3)
    model = thrown(lambda p: pi.PenaltyContact(p, pi.ground.at((0.0, 0.0)), 1e6), 9.81, (0.0, -depth), (0.3, 0.0))
    run = pi.solve(model, 2.0, pi.GeneralizedAlpha(h=0.02))
    assert run.success and run.steps == 100 and abs(run.v.reshape(-1, 2)[:, 1]).max() < 1e-6


@dataclass(frozen=True, eq=False)
class Push(pi.ForceElement):
    """A constant force to the left beyond x = 0.5 m: it jumps there."""

    at: object
    force: float = 100.0
    name: str | None = None

    def sides(self):
        return (self.at,)

    def forces(self, t, x, v):
        return np.array([[-self.force if x[0, 0] > 0.5 else 0.0, 0.0]])

    def energy(self, x):
        return self.force * max(0.0, x[0, 0] - 0.5)

    def gap(self, x):
        return 0.5 - x[0, 0]


@pytest.mark.parametrize("name", ["radau, tight", "radau, h", "energy"])
def test_an_own_force_that_jumps_where_its_gap_closes(name):
    """It turns the body round in 2 v m / F."""
    run = pi.solve(thrown(Push), 1.0, INTEGRATORS[name][0])
    assert run.q[-1, 0] == pytest.approx(0.02, abs=1e-6)
    assert speeds(run)[-1, 0] == pytest.approx(-1.0, abs=1e-6)


class Window(pi.Model):
    """A point of 1 kg on a line; a constant force within a window of 1 mm: v^2 grows by 2 F d."""

    n, m = 1, 0
    needs = pi.Needs(mass_varies=False, velocity_forces=False, driven=False, phi_q_varies=False)

    def __init__(self, middle=0.4942, half=0.0005, force=1500.0):
        self.middle, self.half, self.push = middle, half, force

    def mass(self, q):
        return np.eye(1)

    def force(self, t, q, v):
        return np.array([-self.push if abs(q[0] - self.middle) < self.half else 0.0])

    def gaps(self, t, q):
        return np.array([abs(q[0] - self.middle) - self.half])


@pytest.mark.parametrize(
    "h, window", [(2e-3, {"middle": 0.255022, "half": 0.0011928, "force": -113.18659625792287}), (1e-3, {})], ids=["within", "short of"]
)
def test_a_step_does_not_end_within_a_jump(h, window):
    """Not with a force between those of both sides, which solves the equations of a step that ends on the jump; nor short of it."""
    run = pi.solve(Window(**window), 0.55, pi.GeneralizedAlpha(h=h), v0=[1.0])
    force, half = run.model.push, run.model.half
    assert run.success and run.v[-1, 0] == pytest.approx(np.sqrt(1.0 + 4.0 * force * half), rel=1e-6)


def test_gradients_through_jumps_of_forces_are_refused():
    run = pi.solve(thrown(Push), 0.6, pi.GeneralizedAlpha(h=0.02))
    with pytest.raises(pi.InputError, match="forces jump at t = 0.5"):
        pi.gradient(run, pi.objective.Deviation("body", lambda t: (0.0, 0.0)), ["body.mass"])


@pytest.mark.parametrize("name", ["radau", "alpha, long h", "IDA"])
def test_an_own_model_is_seen_through_two_roots_within_one_step(name):
    run = pi.solve(Window(), 1.0, INTEGRATORS[name][0], v0=[1.0])
    assert Window().switching and run.v[-1, 0] == pytest.approx(2.0, rel=1e-3)


@pytest.mark.parametrize("integrator", [pi.GeneralizedAlpha(h=0.02), pi.RadauIIA()], ids=["alpha", "radau"])
def test_a_run_that_stops_anywhere_about_a_contact_goes_on_bit_by_bit(tmp_path, integrator):
    model = thrown(ball())
    whole = pi.solve(model, 1.0, integrator)
    near = np.searchsorted(whole.t, 0.489)
    for stop in (near, near + 1, near + 3):
        taken = iter(range(stop))
        part = pi.solve(model, 1.0, integrator, out=tmp_path / f"{stop}.h5", progress=lambda t, taken=taken: _stop(taken), flush_every=1)
        assert part.status == "interrupted"
        for run in (pi.resume(tmp_path / f"{stop}.h5"), pi.solve(model, 1.0, integrator, state=part.state)):
            assert np.array_equal(run.q[-1], whole.q[-1]) and np.array_equal(run.v[-1], whole.v[-1])


def _stop(taken):
    if next(taken, None) is None:
        raise KeyboardInterrupt


def test_a_gap_that_is_no_number_is_refused():
    class Wrong(Push):
        def gap(self, x):
            return "closed"

    with pytest.raises(pi.InputError, match="push.*gap"):
        pi.solve(thrown(lambda p: Wrong(p, name="push")), 1.0, pi.RadauIIA())


@pytest.mark.parametrize("integrator", [pi.GeneralizedAlpha(h=0.005), pi.RadauIIA(rtol=1e-7)], ids=["alpha", "radau"])
def test_gradients_take_the_steps_that_end_at_contacts_again(integrator):
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = scene.add(pi.RigidBody.bar(1.0, 1.0, angle=0.3, name="bar"))
    scene.add(pi.Revolute(bar.at("left"), pi.ground.at((0.0, 0.0)), name="pin"))
    scene.add(pi.PenaltyContact(bar.at("right"), pi.ground.at((0.0, -0.99)), 1e3, radius=0.05, name="stop"))
    run = pi.solve(scene.build(), 0.8, integrator)
    assert run.counts.rejected
    deviation = pi.objective.Deviation(bar.at("right"), lambda t: (0.3, -0.2))
    assert max(pi.check_gradient(run, deviation, ["stop.stiffness"]).values()) < 1e-3


def test_a_summary_names_energy_that_comes_from_nowhere():
    run = pi.solve(thrown(ball()), 0.7, pi.RadauIIA(rtol=1e-7))
    faster = replace(run, v=np.where(run.t[:, None] > 0.6, 2.0 * run.v, run.v))
    assert "the energy grows" not in run.summary()
    assert "the energy grows by 1.5 J up to t = 0." in faster.summary()


def test_steps_that_are_discarded_about_a_contact_are_counted(monkeypatch):
    """Each crossing, and each step that is too long, discards one; EnergyMomentum itself discards none."""
    discarded = []
    for name in ("_to_switch", "_shorter"):
        own = getattr(Switches, name)
        monkeypatch.setattr(Switches, name, lambda self, *given, own=own: discarded.append(own) or own(self, *given))
    run = pi.solve(thrown(Push), 0.6, pi.EnergyMomentum(h=0.02))
    assert run.success and run.counts.rejected == len(discarded) > 1


def test_a_failure_of_a_step_before_a_switch_tells_of_no_parts():
    """These steps are made shorter, not taken in parts; a single iteration solves none in which the contact's force acts."""
    run = pi.solve(thrown(ball()), 0.7, pi.EnergyMomentum(h=0.02, max_iterations=1))
    assert run.status == "newton" and 0.48 < run.t[-1] < 0.5 and "parts" not in run.message


DROPS = [  # mass, inertia, height, velocity, stiffness, exponent, damping, rtol
    (
        2.5125073093634507,
        0.41081692964534017,
        0.0742688160717454,
        (-0.23326223842896354, -1.1830535891600027),
        35154.156607642646,
        1.5,
        0.0,
        1e-5,
    ),
    (
        0.7141229178590609,
        0.03927247306910754,
        0.09235788900817964,
        (-0.1337461195270524, -1.041897403718332),
        253409.79386006063,
        2.0,
        0.1,
        1e-8,
    ),
    (
        2.6756230099252116,
        0.17256502771191892,
        0.3722335833216044,
        (0.8307602409810151, -0.27921270163423073),
        64482.883566784185,
        2.0,
        0.1,
        1e-8,
    ),
]


@pytest.mark.parametrize("drop", DROPS, ids=["1e-5", "heavy contact, 1e-8", "fast drop, 1e-8"])
def test_newton_does_not_stop_early_behind_a_contact(drop):
    """v + g t stays the same in free flight; with a contraction measured inside the contact it changes by more than 1000 rtol."""
    mass, inertia, height, velocity, stiffness, exponent, damping, rtol = drop
    scene = pi.Scene(gravity=(0.0, -9.81))
    ball = scene.add(pi.RigidBody(mass, inertia, {"c": (0.0, 0.0)}, origin=(0.0, height), velocity=velocity))
    scene.add(pi.PenaltyContact(ball.at("c"), pi.ground.at((0.0, 0.0)), stiffness, damping=damping, exponent=exponent))
    run = pi.solve(scene.build(), 1.0, pi.RadauIIA(rtol=rtol))
    free, level = height + run.q[:, 1] > 1e-12, run.v[:, 1] + 9.81 * run.t
    flying = free[1:] & free[:-1]
    changes = np.where(flying, np.diff(level), 0.0)
    assert run.success and flying.sum() < len(flying) and np.abs(changes).max() < 20.0 * rtol
