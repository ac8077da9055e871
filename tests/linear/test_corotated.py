"""The stale factor in the frame of the nodal rotations: against the whole saddle-point matrix."""

import numpy as np
import pytest

import polyida as pi
from polyida.assembly import corotated, equilibrium
from polyida.linear.lu import SingularSystem
from polyida.linear.saddle import KKT

C_M = 4e6
SINGLE = 2e-4  # the factor is kept in single precision, and loses digits by its condition number


class Point:
    """A state of a model with what a compiled solve takes."""

    def __init__(self, model, t, q, lam):
        self.model, self.t, self.q, self.lam = model, t, q, lam
        self.rotation = np.empty((model.n_nodes, 2))
        self.a = np.zeros(model.n)
        self.r, self.phi, *_ = model.evaluate(t, q, self.a, lam, self.rotation)

    def factored(self):
        blocks = np.empty((len(self.model.pattern[1]), 2, 2))
        equilibrium.tangent_blocks(self.model.arrays, self.q.reshape(-1, 2), None, C_M, 0.0, 1.0, blocks)
        return corotated.corotated(self.model, blocks, self.rotation)

    def solve(self, system, r, phi):
        """(dq, dlam) by the compiled solve."""
        model, room = self.model, corotated.room(self.model, system)
        dq, dlam = np.empty((model.n_nodes, 2)), np.empty(model.m)
        good = corotated.solve(
            model.arrays.links,
            system,
            room,
            model.drives(self.t),
            self.rotation,
            model.dz(self.q),
            self.lam,
            r.reshape(-1, 2),
            phi,
            C_M,
            dq,
            dlam,
        )
        assert good
        return dq.ravel(), dlam

    def exact(self, r, phi):
        """(dq, dlam) by the whole matrix."""
        matrix = self.model.tangent(self.t, self.q, self.a, self.a, self.lam, C_M, 0.0, 1.0)
        return KKT(matrix, self.model.phi_q(self.t, self.q)).solve(r, phi)


def random_point(model, t=0.2, size=1e-3, seed=0):
    random = np.random.default_rng(seed)
    return Point(model, t, size * random.standard_normal(model.n), random.standard_normal(model.m))


def right_sides(model):
    random = np.random.default_rng(7)
    return random.standard_normal(model.n), 1e-6 * random.standard_normal(model.m)


def near(found, exact):
    return np.abs(found - exact).max() <= SINGLE * np.abs(exact).max()


def test_fresh_factor_solves_the_whole_system(scenes, kind):
    model = scenes.jointed(kind, pi.profile.sine(0.5, 1.0, 0.1)).build()
    point, (r, phi) = random_point(model), right_sides(model)
    dq, dlam = point.solve(point.factored(), r, phi)
    exact_q, exact_lam = point.exact(r, phi)
    assert near(dq, exact_q) and near(dlam, exact_lam)


def test_constraints_are_met_to_round_off_however_stale(scenes, kind):
    model = scenes.jointed(kind, pi.profile.sine(0.5, 1.0, 0.1)).build()
    system = random_point(model).factored()
    point, (r, phi) = random_point(model, t=0.9, size=1e-2, seed=4), right_sides(model)
    dq, _ = point.solve(system, r, phi)
    assert np.abs(model.phi_q(point.t, point.q) @ dq + phi).max() < 1e-11 * np.abs(dq).max()


@pytest.mark.parametrize("angle", [0.5, 3.0])
@pytest.mark.parametrize("kind", ["revolute", "clamp between"], indirect=True)
def test_a_rigid_turn_keeps_the_factor(scenes, kind, angle):
    """The stale factor of the unturned scene solves the turned one as well as a fresh factor does."""
    model = scenes.jointed(kind).build()
    system = Point(model, 0.0, np.zeros(model.n), np.zeros(model.m)).factored()
    point, (r, phi) = (Point(model, 0.0, scenes.turned(model, np.zeros(model.n), angle), np.zeros(model.m)), right_sides(model))
    dq, dlam = point.solve(system, r, phi)
    exact_q, exact_lam = point.exact(r, phi)
    assert near(dq, exact_q) and near(dlam, exact_lam)


def test_without_joints(scenes):
    model = scenes.pair()[0].build()
    point = random_point(model)
    r = right_sides(model)[0]
    assert near(point.solve(point.factored(), r, np.zeros(0))[0], point.exact(r, np.zeros(0))[0])


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_has_no_factor(scenes, value):
    model = scenes.single()[0].build()
    blocks = np.full((len(model.pattern[1]), 2, 2), value)
    with pytest.raises(SingularSystem):
        corotated.corotated(model, blocks, np.ones((model.n_nodes, 2)))
