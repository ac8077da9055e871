"""A user's model with a step matrix of its own: every integrator and statics call it, with the q of the present state."""

import numpy as np
import pytest

import polyida as pi

ROW = np.stack([np.arange(4.0), np.zeros(4)], axis=1).ravel()
DOWN = np.stack([np.zeros(4), -np.arange(4.0)], axis=1).ravel() - ROW
UP = np.stack([np.zeros(4), np.arange(4.0)], axis=1).ravel()


class Chain(pi.Model):
    """Four masses in the plane, from 0 in a row along x, with springs between them and the first on a pin; q: their displacements."""

    n, m = 8, 2
    needs = pi.Needs(mass_varies=False, velocity_forces=False, driven=False, phi_q_varies=False)
    stiffness = 2e3

    def mass(self, q):
        return np.eye(8)

    def force(self, t, q, v):
        w = np.diff((ROW + q).reshape(4, 2), axis=0)
        length = np.linalg.norm(w, axis=1)[:, None]
        pull, g = self.stiffness * (length - 1.0) / length * w, np.tile([0.0, 9.81], (4, 1))
        g[:-1] -= pull
        g[1:] += pull
        return g.ravel()

    def phi(self, t, q):
        return q[:2]

    def phi_q(self, t, q):
        return np.eye(2, 8)

    def potential(self, q):
        w = np.linalg.norm(np.diff((ROW + q).reshape(4, 2), axis=0), axis=1)
        return 0.5 * self.stiffness * np.sum((w - 1.0) ** 2) + 9.81 * q[1::2].sum()


class Fitted(pi.StepMatrix):
    """S of the q of each solve."""

    backend, near_any_state, caution = "of each q", True, 1.0
    c = 0.0

    def factor(self, t, q, v, a, lam, c_m, c_v):
        self.made_at, self.c = np.concatenate([[t], q, v, a, lam]), c_m
        self.model.user.calls.append(("factor", q.copy(), c_m))

    def beside(self, c_m, c_v, change):
        other = Fitted(self.model)
        other.again(self.made_at, c_m, c_v)
        return other

    def stands_alone(self):
        return True

    def solve(self, q, b, transposed=False):
        self.model.user.calls.append(("solve", q.copy(), self.c))
        return np.linalg.solve(self.model.force_q(0.0, q, q) + self.c * np.eye(8), b)


class Own(Chain):
    def __init__(self):
        self.calls = []

    def step_matrix(self):
        from polyida.model.guarded import guard

        return Fitted(guard(self))


@pytest.mark.parametrize(
    "integrator",
    [pi.GeneralizedAlpha(h=2e-3), pi.EnergyMomentum(h=2e-3), pi.RadauIIA(rtol=1e-5), pi.RadauIIA(h=2e-3), pi.IDA(rtol=1e-6)],
    ids=["alpha", "energy", "radau", "radau fixed", "ida"],
)
def test_integrators_take_the_step_matrix_of_a_model(integrator):
    own = Own()
    run, other = (pi.solve(model, 0.15, integrator, v0=UP) for model in (own, Chain()))
    assert run.success and np.abs(run.q[-1] - other.q[-1]).max() < 1e-4
    kinds = [kind for kind, _, c in own.calls if c]
    assert "factor" in kinds and "solve" in kinds
    assert run.counts.backend == "of each q"


def test_radau_solves_at_the_present_q():
    own = Own()
    pi.solve(own, 0.3, pi.RadauIIA(h=2e-3), v0=UP)
    made = [q for kind, q, _ in own.calls if kind == "factor"]
    away = max(min(np.abs(q - at).max() for at in made) for kind, q, _ in own.calls if kind == "solve")
    assert away > 0.05  # a factor serves while the chain turns


def test_statics_take_the_step_matrix_of_a_model():
    own = Own()
    equilibrium, other = (pi.static(model, q0=DOWN + 1e-3) for model in (own, Chain()))
    assert np.abs(equilibrium.q - other.q).max() < 1e-9 and equilibrium.stable
    assert {kind for kind, _, c in own.calls if c == 0.0} == {"factor", "solve"}


def test_a_singular_step_matrix_leaves_statics_to_the_whole_system():
    class Loose(Own):
        def step_matrix(self):
            raise pi.SingularSystem("K is singular without the pin")

    assert np.abs(pi.static(Loose(), q0=DOWN).q - pi.static(Chain(), q0=DOWN).q).max() < 1e-12
