"""Singular positions are said by every integrator, with the time and the constraints; sound mechanisms are left alone."""

from dataclasses import replace

import numpy as np
import pytest

import polyida as pi

ALL = {
    "alpha": pi.GeneralizedAlpha(h=2e-3),
    "alpha, rho 0.999": pi.GeneralizedAlpha(h=2e-3, rho_inf=0.999),
    "alpha, stabilised": pi.GeneralizedAlpha(h=2e-3, form="stabilised"),
    "alpha, adaptive": pi.GeneralizedAlpha(h=1e-2, rtol=1e-6),
    "alpha, Richardson": pi.GeneralizedAlpha(h=1e-2, extrapolate=True),
    "radau": pi.RadauIIA(),
    "radau, fixed steps": pi.RadauIIA(h=5e-3),
    "radau, index 3": pi.RadauIIA(form="index3"),
} | {f"IDA {form}": pi.IDA(form=form) for form in ("ggl2", "ggl1", "index2", "index1", "baumgarte")}
FLAT = 0.7471212  # s, when the parallelogram lies flat; all integrators at fine steps agree on these digits


class FourBar(pi.Model):
    """N four-bars side by side, masses of 1 kg at the upper points, all links 1 m: parallelograms, which branch where they lie flat."""

    needs = pi.Needs(mass_varies=False, velocity_forces=False, driven=False)

    def __init__(self, bars):
        self.bars, self.n, self.m = bars, 2 * (bars + 1), 2 * bars + 1
        self.feet = np.stack([np.arange(bars + 1.0), np.zeros(bars + 1)], axis=1)

    def mass(self, q):
        return np.eye(self.n)

    def force(self, t, q, v):
        return np.tile([0.0, 9.81], self.bars + 1)

    def _links(self, q):
        points = q.reshape(-1, 2)
        return points - self.feet, np.diff(points, axis=0)

    def phi(self, t, q):
        return 0.5 * (np.concatenate([(link * link).sum(axis=1) for link in self._links(q)]) - 1.0)

    def phi_q(self, t, q):
        (cranks, rods), B, k = self._links(q), np.zeros((self.m, self.n)), self.bars + 1
        for i, crank in enumerate(cranks):
            B[i, 2 * i : 2 * i + 2] = crank
        for i, rod in enumerate(rods):
            B[k + i, 2 * i : 2 * i + 4] = *-rod, *rod
        return B

    def upright(self):
        """q0 and v0: the cranks upright, turning clockwise with 1 rad/s."""
        return {"q0": (self.feet + [0.0, 1.0]).ravel(), "v0": np.tile([1.0, 0.0], self.bars + 1)}


class Toggle(pi.Model):
    """Two rods of 1 m whose end is drawn along x at 1 m/s from 1.6 m: stretched at 0.4 s, and no configuration behind."""

    n, m = 4, 4
    needs = pi.Needs(mass_varies=False, velocity_forces=False)

    def mass(self, q):
        return np.eye(4)

    def force(self, t, q, v):
        return np.zeros(4)

    def phi(self, t, q):
        rod = q[2:] - q[:2]
        return np.array([0.5 * (q[:2] @ q[:2] - 1), 0.5 * (rod @ rod - 1), q[3], q[2] - 1.6 - t])

    def phi_q(self, t, q):
        rod = q[2:] - q[:2]
        return np.array([[*q[:2], 0, 0], [*-rod, *rod], [0, 0, 0, 1], [0, 0, 1.0, 0]])


def named(message):
    """The constraints that a message names."""
    return message.split("constraints ")[1].split(" are ")[0].split(", ")


@pytest.mark.parametrize("name", ALL)
def test_a_parallelogram_stops_where_it_lies_flat(name):
    model = FourBar(1)
    run = pi.solve(model, 1.0, ALL[name], **model.upright())
    assert run.status == "singular" and run.t[-1] <= FLAT + 1e-3
    assert float(run.message.split("at t = ")[1].split()[0]) == pytest.approx(FLAT, abs=1e-3)
    assert named(run.message) == ["phi[0]", "phi[1]", "phi[2]"]
    crank, other = run.q[-1].reshape(2, 2) - model.feet
    assert np.abs(crank - other).max() < 2e-3  # no frame is on the other branch


@pytest.mark.filterwarnings("ignore")  # overflow in steps that are then refused
@pytest.mark.parametrize("name", ALL)
def test_a_mechanism_drawn_beyond_its_reach_names_the_constraints(name):
    integrator = ALL[name]
    if isinstance(integrator, pi.IDA):
        integrator = replace(integrator, max_num_steps=400)  # it would creep up to there in up to 1e5 steps
    run = pi.solve(Toggle(), 1.0, integrator, q0=[0.8, 0.6, 1.6, 0.0])
    assert not run.success and run.t[-1] == pytest.approx(0.4, abs=1.001e-2)  # within a step
    assert "singular position" in run.message and "phi[3]" in named(run.message) and len(named(run.message)) <= 3


def test_a_start_in_a_singular_position_is_refused():
    flat = np.array([1.0, 0.0, 2.0, 0.0])
    with pytest.raises(pi.InputError, match=r"phi\[0\], phi\[1\], phi\[2\] are redundant.*singular"):
        pi.consistent_state(FourBar(1), q0=flat)
    still = pi.integrate.state.State(0.0, flat, np.zeros(4), np.zeros(4), np.zeros(3))
    assert pi.solve(FourBar(1), 0.1, ALL["alpha"], state=still).status == "singular"


@pytest.mark.parametrize("form", ["ggl2", "index2"])
@pytest.mark.parametrize("name", ["pendulum", "car-axis", "andrews"])
def test_sound_mechanisms_run_also_at_a_coarse_tolerance(name, form):
    p = pi.problems.get(name)
    run = pi.solve(p.model, 0.5 * p.t_end, pi.IDA(rtol=1e-3, form=form), q0=p.q0, v0=p.v0)
    assert run.status == "done"


@pytest.mark.parametrize("form, rtol", [("index1", 1e-3), ("index2", 1e-2)])
def test_what_drifts_apart_is_stopped_and_named(form, rtol):
    p = pi.problems.get("pendulum")
    run = pi.solve(p.model, p.t_end, pi.IDA(rtol=rtol, form=form), q0=p.q0, v0=p.v0)
    assert run.status == "drift" and "phi[0] has drifted apart by" in run.message
    assert run.drift.max() < 1e-2 * np.sqrt(0.5) * 1.05 and run.t[-1] < p.t_end


def test_a_pendulum_has_no_singular_position_however_long_the_steps():
    """In one step of 1 s the direction of the bar turns far; its polynomial passes near zero, where the rows of the scene are dependent."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = scene.add(pi.RigidBody.bar(1.0, 1.0))
    scene.add(pi.Revolute(pi.ground, bar.at("left")))
    run = pi.solve(scene.build(), 1.0, pi.RadauIIA(h=1.0))
    assert run.steps == 1 and run.status == "done"


class Links(pi.Model):
    """One parallelogram whose lengths are numbers of the model."""

    n, m = 4, 3
    needs = pi.Needs(mass_varies=False, velocity_forces=False, driven=False)

    def __init__(self, crank, rod):
        self.crank, self.along, self.rise = crank, rod, 0.25 * rod

    def mass(self, q):
        return np.eye(4)

    def force(self, t, q, v):
        return np.array([0.0, 9.81, 0.0, 9.81])

    def phi(self, t, q):
        a, b = q[:2], q[2:] - np.array([self.along, self.rise])
        rod = q[2:] - q[:2]
        return 0.5 * np.array([a @ a - self.crank**2, b @ b - self.crank**2, rod @ rod - self.along**2 - self.rise**2])

    def phi_q(self, t, q):
        B, rod = np.zeros((3, 4)), q[2:] - q[:2]
        B[0, :2], B[1, 2:] = q[:2], q[2:] - np.array([self.along, self.rise])
        B[2, :2], B[2, 2:] = -rod, rod
        return B

    def upright(self):
        """q0 and v0: the cranks upright, turning clockwise with 1 rad/s."""
        return {"q0": [0.0, self.crank, self.along, self.rise + self.crank], "v0": [self.crank, 0.0, self.crank, 0.0]}


@pytest.mark.parametrize("name", ["alpha", "radau"])
def test_compiled_functions_that_read_the_numbers_of_their_model_stop_at_a_dead_centre(name):
    """The proof along the run calls phi_q with the data of this model, not of another one of the class."""
    kind = pi.compiled(Links)
    other, model = kind(2.0, 3.0), kind(1.0, 1.0)
    run, plain = (pi.solve(one, 1.0, ALL[name], **model.upright()) for one in (model, Links(1.0, 1.0)))
    times = [float(one.message.split("at t = ")[1].split()[0]) for one in (run, plain) if one.status == "singular"]
    assert len(times) == 2 and times[0] == pytest.approx(times[1], abs=1e-3)
    longer = pi.solve(other, 0.6, ALL[name], **other.upright())
    assert longer.success, longer.message  # its cranks, of 2 m, lie along its foot later
