"""Radau IIA at steps down to 1e-9 s: stages as clean as the equations of motion, and what scaling keeps of their digits."""

import numpy as np
import pytest

import polyida as pi
from polyida import problems
from polyida.integrate.start import consistent_acceleration, restarted
from polyida.problems import plates


@pytest.fixture(scope="module")
def moving():
    """(model, state): the driven double plate in the midst of its motion, on its constraints."""
    model = plates.double_plate_motors(cells=20).build()
    return model, restarted(model, pi.solve(model, 0.5, pi.GeneralizedAlpha(h=1e-3)).state)


def stages(model, state, integrator, h=1e-9):
    """Largest relative deviation of a and lam of the last stage from those of the equations of motion at its q and v, over 20 steps."""
    found = []
    for s in integrator.steps(model, state, state.t + 20 * h, pi.Counts()):
        a, lam = consistent_acceleration(model, s.t, s.q, s.v)
        found.append(
            [np.abs(s.memory["a_end"] - a).max() / np.abs(a).max(), np.abs(s.memory["stages_lam"][-1] - lam).max() / np.abs(lam).max()]
        )
    return np.max(found, axis=0)


@pytest.mark.parametrize(
    "settings", [{}, {"form": "index3"}, {"stages": 2}, {"linear": "kkt"}, {"linear": "kkt", "form": "index3"}], ids=str
)
def test_clean_at_1e_9(moving, settings):
    a, lam = stages(*moving, pi.RadauIIA(h=1e-9, **settings))
    assert a < 1e-9 and lam < 1e-12


def test_scaling_keeps_digits(moving):
    raw, scaled = (stages(*moving, pi.RadauIIA(h=1e-9, form="index3", linear="kkt", scaling=scaling)) for scaling in ("none", "bottasso"))
    assert (raw > 1e3 * scaled).all() and raw[0] > 1e-8


@pytest.mark.parametrize("name", ["pendulum", "car-axis"])
def test_of_models_whose_phi_comes_from_positions_the_stabilised_form_is_clean(name):
    """Round-off of phi goes into mu there, and into lam by h^-2 in index 3; a and lam of accepted states come from neither."""
    p = problems.get(name)
    state = restarted(p.model, pi.solve(p.model, 0.2, pi.RadauIIA(rtol=1e-6), q0=p.q0, v0=p.v0).state)
    assert (stages(p.model, state, pi.RadauIIA(h=1e-9)) < 1e-5).all()
    assert (stages(p.model, state, pi.RadauIIA(h=1e-9, form="index3")) > 10).all()
    for form in ("ggl", "index3"):
        run = pi.solve(p.model, state.t + 20e-9, pi.RadauIIA(h=1e-9, form=form), state=state)
        assert np.abs(np.diff(run.a, 2, axis=0)).max() < 1e-10 * np.abs(run.a).max() and run.drift.max() < 1e-15


class Softer(pi.Model):
    """1 kg on a spring that is at rest 1e-12 from q = 1; what it says of its stiffness makes Newton contract by 0.6 in long steps."""

    n, m, stiffness = 1, 0, 1e3
    needs = pi.Needs(False, False, False, False)

    def mass(self, q):
        return np.eye(1)

    def force(self, t, q, v):
        return self.stiffness * ((q - 1.0) + 1e-12)

    def force_q(self, t, q, v):
        return np.array([[self.stiffness / 0.4]])


@pytest.mark.parametrize("stages", [2, 3])
def test_newton_that_contracts_slowly_goes_on_to_its_tolerance(stages):
    """Corrections that still shrink are no round-off, though they are below 1e-11 of q: what they leave of q is 1/h times as much in v."""
    run = pi.solve(Softer(), 1e4, pi.RadauIIA(h=1e4, stages=stages, tolerance=1e-16, max_iterations=60), q0=[1.0])
    assert run.success and run.counts.newton_iterations > 12
    assert abs(run.restart.state.memory["stages_e"][-1, 0] + 1e-12) < 1e-15


def test_small_steps_take_little_more_than_one_iteration():
    """The stages begin where the last prediction and the errors of three predictions lead; Newton ends at round-off of v.

    3.5 iterations a step without either, 2.1 with the error of the last prediction alone.
    """
    scene = pi.Scene(gravity=(0.0, -9.81))
    upper = scene.add(pi.RigidBody.bar(1.0, 1.0, (0.0, 0.0), name="upper"))
    lower = scene.add(pi.RigidBody.bar(1.0, 1.0, (1.0, 0.0), name="lower"))
    scene.add(pi.Revolute(pi.ground.at((0.0, 0.0)), upper.at("left"), name="first pin"))
    scene.add(pi.Revolute(upper.at("right"), lower.at("left"), name="second pin"))
    counts = pi.solve(scene.build(), 0.2, pi.RadauIIA(h=1e-3)).counts
    assert counts.newton_iterations <= 1.2 * counts.steps
