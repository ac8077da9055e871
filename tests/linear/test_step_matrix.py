"""The step matrix and its border: against dense solves, at another state than the factor's, and where S has no inverse."""

import numpy as np
import pytest
from scipy.sparse import csc_array, csr_array, diags_array

import polyida as pi
from polyida import problems
from polyida.linear.lu import SingularSystem
from polyida.linear.saddle import StepMatrix, WholeMatrix


@pytest.fixture
def moving():
    """(model, a state far from rest)."""
    p, random = problems.get("andrews"), np.random.default_rng(1)
    q, v, a, lam = (0.3 * random.standard_normal(k) for k in (7, 7, 7, 6))
    return p.model, (0.0, p.q0 + q, v, a, lam)


def saddle(model, state, S, r, phi):
    B = model.phi_q(*state[:2])
    return np.linalg.solve(np.block([[S, B.T], [B, np.zeros((model.m, model.m))]]), -np.concatenate([r, phi]))


@pytest.mark.parametrize("c_m, c_v", [(1e6, 1e3), (1e6 + 2e6j, 1e3 + 1e3j)])
@pytest.mark.parametrize("make", [StepMatrix, lambda model: WholeMatrix(model, "bottasso")])
def test_the_saddle_is_that_of_the_whole_matrix(moving, make, c_m, c_v):
    model, state = moving
    r, phi, system = *(np.random.default_rng(2).standard_normal(k) for k in (model.n, model.m)), make(model)
    system.factor(*state, c_m, c_v)
    exact = saddle(model, state, model.tangent(*state, c_m, c_v, 1.0), r, phi)
    assert np.allclose(np.concatenate(system.saddle(*state[:2], state[4], r, phi)), exact, rtol=1e-8)


def test_constraints_hold_with_an_old_factor(moving):
    model, state = moving
    system, r, phi = StepMatrix(model), np.ones(model.n), np.linspace(1.0, 2.0, model.m)
    system.factor(*state, 1e6, 1e3)
    dq, _ = system.saddle(0.0, state[1] + 0.2, state[4], r, phi)
    assert np.allclose(model.phi_q(0.0, state[1] + 0.2) @ dq, -phi, rtol=1e-9)


class Massless(pi.Model):
    """A spring pulls a mass along a massless rod's end: S has no inverse, with the constraint it has."""

    n, m = 2, 1
    needs = pi.Needs(mass_varies=False, velocity_forces=False, driven=False, phi_q_varies=False)

    def mass(self, q):
        return np.diag([1.0, 0.0])

    def force(self, t, q, v):
        return np.array([q[0], 0.0])

    def phi(self, t, q):
        return np.array([q[1] - 2.0 * q[0]])

    def phi_q(self, t, q):
        return np.array([[-2.0, 1.0]])


def test_coordinates_without_mass_go_through_the_whole_matrix():
    model = Massless()
    system, state = StepMatrix(model), (0.0, np.array([1.0, 2.0]), np.zeros(2), np.zeros(2), np.zeros(1))
    system.factor(*state, 1e4, 1e2)
    exact = saddle(model, state, np.diag([1e4 + 1.0, 0.0]), np.ones(2), np.ones(1))
    assert np.allclose(np.concatenate(system.saddle(0.0, state[1], state[4], np.ones(2), np.ones(1))), exact)
    with pytest.raises(SingularSystem):
        system.solve(state[1], np.ones(2))


class Chain(pi.Model):
    """Masses hung from one another by sixty rigid links, sparse."""

    links = 60
    n, m = 2 * links, links
    needs = pi.Needs(mass_varies=False, velocity_forces=False, driven=False)

    def mass(self, q):
        return diags_array(np.ones(self.n), format="csc")

    def force(self, t, q, v):
        return np.tile([0.0, 9.81], self.links)

    def phi(self, t, q):
        return 0.5 * ((self.ends(q) ** 2).sum(axis=1) - 1.0)

    def phi_q(self, t, q):
        d, rows = self.ends(q), np.arange(self.links)
        at = [2 * rows, 2 * rows + 1, 2 * rows[:-1], 2 * rows[:-1] + 1]
        values = [d[:, 0], d[:, 1], -d[1:, 0], -d[1:, 1]]
        where = np.concatenate([rows, rows, rows[1:], rows[1:]]), np.concatenate(at)
        return csr_array((np.concatenate(values), where), shape=(self.m, self.n))

    def ends(self, q):
        return np.diff(q.reshape(-1, 2), axis=0, prepend=0.0)

    def force_q(self, t, q, v):
        return csc_array((self.n, self.n))

    def reaction_q(self, t, q, lam):
        main, off = np.repeat(lam + np.append(lam[1:], 0.0), 2), np.repeat(-lam[1:], 2)
        return diags_array([main, off, off], offsets=[0, 2, -2], format="csc")


def test_many_constraints_go_through_one_sparse_matrix():
    """A chain released level: the border of m columns would be dense. The integrators agree, and phi holds."""
    q0 = np.stack([np.arange(1.0, 61.0), np.zeros(60)], axis=1).ravel()
    assert max(pi.check_derivatives(Chain(), 0.0, q0, np.ones(120)).values()) < 1e-6
    runs = [pi.solve(Chain(), 0.2, kind, q0=q0, every=10**9) for kind in (pi.GeneralizedAlpha(h=2e-3), pi.IDA(rtol=1e-7))]
    assert all(run.success and run.drift.max() < 1e-9 for run in runs)
    assert np.abs(runs[0].q[-1] - runs[1].q[-1]).max() < 1e-4
