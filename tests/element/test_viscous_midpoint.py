import numpy as np
import pytest

from polyida.element import viscous_midpoint
from polyida.element.operator import Blocks

TAU = 0.03


def rotated(points, angle):
    """Displacement of a rotation."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return points @ turn.T - points


def wavy(points):
    """A smooth, finite, inhomogeneous displacement on top of a rotation."""
    return rotated(points, 0.7) + 0.04 * np.sin(3 * points[:, ::-1] + [0.2, 0.9])


def later(points):
    """The displacement a step later: turned further and strained otherwise."""
    return rotated(points, 1.1) + 0.05 * np.sin(2 * points + [0.5, -0.3])


def spinning(points):
    """Velocity of a rigid spin about (0.3, -0.4) with a translation, at the deformed positions."""
    return 5.0 * (points - [0.3, -0.4]) @ [[0.0, 1.0], [-1.0, 0.0]] + [2.0, 3.0]


class TwoStates:
    """A body with its two-state kernels; every method takes displacements with padding and returns the body's part."""

    def __init__(self, plate):
        self.plate, self.op, self.first = plate, plate.op, plate.first

    def force(self, kernel, number, a, b):
        """(force, rotation sums, status) of a kernel."""
        f, rotation, plate = np.zeros_like(a), np.zeros_like(a), self.plate
        status = kernel(self.op.cells(self.first), plate.material(number), a, b, f, rotation)
        assert not f[: self.first].any() and not rotation[: self.first].any()
        return f[self.first :], rotation[self.first :], status

    def tangent(self, kernel, number, a, b, *factors):
        """Dense tangent (2 n, 2 n)."""
        blocks, plate = np.zeros((5 + len(self.op.indices), 2, 2)), self.plate
        kernel(self.op.cells(self.first), Blocks(self.op.pairs, 5, blocks), plate.material(number), a, b, *factors)
        assert not blocks[:5].any()
        return plate.dense(blocks[5:])

    def viscous(self, u, v, tau=TAU):
        return self.force(viscous_midpoint.internal_force_viscous, tau, u, v)[0]

    def viscous_tangent(self, u, v, c_q, c_v, tau=TAU):
        return self.tangent(viscous_midpoint.tangent_viscous, tau, u, v, c_q, c_v)

    def midpoint(self, u0, u1, viscosity=0.0):
        return self.force(viscous_midpoint.internal_force_midpoint, viscosity, u0, u1)[0]


@pytest.fixture
def plate(shape, body):
    """A body on every mesh in turn, two nodes of another one before it."""
    return TwoStates(body(shape, padding=2))


def velocity(plate):
    """A velocity with rotation and strain rate."""
    return plate.plate.displacement(lambda x: spinning(x) + 3.0 * np.cos(2 * x + [0.1, 0.7]))


def assert_gradient(matrix, function, at, first):
    """Columns of the matrix against central differences of function(at)."""
    h = 1e-6
    for column in range(0, matrix.shape[1], max(1, matrix.shape[1] // 30)):
        step = np.zeros_like(at)
        step.reshape(-1)[2 * first + column] = h
        difference = (function(at + step) - function(at - step)).ravel() / (2 * h)
        assert abs(difference - matrix[:, column]).max() < 1e-6 * abs(matrix).max()


def test_without_relaxation_time_the_force_is_the_elastic_one(plate):
    u = plate.plate.displacement(wavy)
    f, rotation, status = plate.force(viscous_midpoint.internal_force_viscous, 0.0, u, velocity(plate))
    elastic, elastic_rotation, elastic_status = plate.plate.force(u)
    assert abs(f - elastic).max() < 1e-14 * abs(elastic).max()
    assert abs(rotation - elastic_rotation).max() < 1e-14
    assert status == pytest.approx(elastic_status, rel=1e-14)
    k = plate.plate.tangent(u)
    assert abs(plate.viscous_tangent(u, velocity(plate), -0.5, 2.0, tau=0.0) + 0.5 * k).max() < 1e-14 * abs(k).max()


def test_rigid_spin_has_no_viscous_stress_at_any_deformation(plate):
    u = plate.plate.displacement(wavy)
    v = plate.plate.displacement(lambda x: spinning(x + wavy(x)))
    elastic = plate.plate.force(u)[0]
    scale = plate.plate.c1 * abs(v).max()
    assert abs(plate.viscous(u, v) - elastic).max() < 1e-14 * scale
    damping = plate.viscous_tangent(u, v, 0.0, 1.0)
    assert abs(damping @ v[plate.first :].ravel()).max() < 1e-13 * abs(damping).max() * abs(v).max()


def test_tangents_of_the_viscous_force(plate):
    u, v = plate.plate.displacement(wavy), velocity(plate)
    stiffness, damping = plate.viscous_tangent(u, v, 1.0, 0.0), plate.viscous_tangent(u, v, 0.0, 1.0)
    assert_gradient(stiffness, lambda x: plate.viscous(x, v), u, plate.first)
    assert_gradient(damping, lambda x: plate.viscous(u, x), v, plate.first)
    both = plate.viscous_tangent(u, v, 0.7, -20.0)
    assert abs(both - 0.7 * stiffness + 20.0 * damping).max() < 1e-13 * abs(both).max()


def test_damping_is_symmetric_positive_and_tau_times_the_stiffness_at_rest(plate):
    u, zero = plate.plate.displacement(wavy), plate.plate.displacement(lambda x: 0 * x)
    damping = plate.viscous_tangent(u, velocity(plate), 0.0, 1.0)
    assert abs(damping - damping.T).max() < 1e-14 * abs(damping).max()
    values = np.linalg.eigvalsh(damping)
    assert values[0] > -1e-13 * values[-1] and values[3] > 1e-9 * values[-1]
    k = plate.plate.tangent(zero)
    assert abs(plate.viscous_tangent(zero, zero, 0.0, 1.0) - TAU * k).max() < 1e-14 * TAU * abs(k).max()


def test_viscous_force_dissipates(plate):
    u, rng = plate.plate.displacement(wavy), np.random.default_rng(3)
    elastic, scale = plate.plate.force(u)[0], abs(plate.viscous_tangent(u, u, 0.0, 1.0)).max()
    for v in (velocity(plate), rng.standard_normal(u.shape), 1e3 * rng.standard_normal(u.shape)):
        own = v[plate.first :]
        power = (own * (plate.viscous(u, v) - elastic)).sum()
        assert power > 0
        damping = plate.viscous_tangent(u, v, 0.0, 1.0)
        assert power == pytest.approx(own.ravel() @ damping @ own.ravel(), rel=1e-9, abs=1e-13 * scale * (own**2).sum())


def test_forces_have_no_resultant(plate, shape):
    u0, u1, v = plate.plate.displacement(wavy), plate.plate.displacement(later), velocity(plate)
    mean = (u0 + u1) / 2
    for f, u in ((plate.viscous(u0, v), u0), (plate.midpoint(u0, u1), mean), (plate.midpoint(u0, u1, 0.4), mean)):
        place = shape.points + u[plate.first :]
        assert abs(f.sum(axis=0)).max() < 1e-14 * abs(f).sum()
        assert abs((place[:, 0] * f[:, 1] - place[:, 1] * f[:, 0]).sum()) < 1e-13 * abs(f).sum()


def test_midpoint_force_works_exactly_the_change_of_energy(plate):
    u0 = plate.plate.displacement(wavy)
    for u1 in (plate.plate.displacement(later), u0 + 0.01 * np.random.default_rng(2).standard_normal(u0.shape)):
        f, way = plate.midpoint(u0, u1), (u1 - u0)[plate.first :]
        gained = plate.plate.energy(u1) - plate.plate.energy(u0)
        assert (f * way).sum() == pytest.approx(gained, abs=1e-13 * abs(f * way).sum())


def test_midpoint_force_with_viscosity_works_more_by_the_dissipation(plate):
    u0, u1 = plate.plate.displacement(wavy), plate.plate.displacement(later)
    f, way = plate.midpoint(u0, u1, 0.4), (u1 - u0)[plate.first :]
    gained = plate.plate.energy(u1) - plate.plate.energy(u0)
    strained = plate.viscous_tangent((u0 + u1) / 2, u0, 0.0, 1.0, tau=1.0)
    lost = 0.4 * way.ravel() @ strained @ way.ravel()
    assert lost > 0
    assert (f * way).sum() - gained == pytest.approx(lost, abs=1e-13 * abs(f * way).sum())


def test_midpoint_costs_nothing_between_rigid_positions(plate):
    u0, u1 = (plate.plate.displacement(lambda x, angle=angle: rotated(x, angle) + 7 * angle) for angle in (0.4, 1.9))
    assert abs(plate.midpoint(u0, u1, 3.0)).max() < 1e-13 * plate.plate.c1
