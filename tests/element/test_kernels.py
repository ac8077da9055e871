from functools import partial

import numpy as np
import pytest

from polyida.element import kernels

SHIFT = np.array([[0.03, 0.05], [-0.02, 0.04]])


def rotated(points, angle, shift=(0.0, 0.0)):
    """Displacement of a rigid motion."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return points @ turn.T - points + shift


def wavy(points):
    """A smooth, finite, inhomogeneous displacement on top of a rotation."""
    return rotated(points, 0.7) + 0.04 * np.sin(3 * points[:, ::-1] + [0.2, 0.9])


def test_patch(shape, body):
    plate = body(shape, padding=3)
    u = plate.displacement(lambda x: x @ SHIFT.T + [3.0, -2.0])
    strain = (SHIFT + SHIFT.T + SHIFT.T @ SHIFT) / 2
    second = plate.E / (1 - plate.NU**2) * ((1 - plate.NU) * strain + plate.NU * np.trace(strain) * np.eye(2))
    deformation = np.eye(2) + SHIFT
    cauchy = deformation @ second @ deformation.T / np.linalg.det(deformation)
    f, _, status = plate.force(u)
    assert status == pytest.approx(np.linalg.det(deformation), abs=1e-13)
    exact = [cauchy[0, 0], cauchy[1, 1], cauchy[0, 1]]
    assert abs(plate.stress(u) - exact).max() < 1e-13 * plate.E
    volume = plate.THICKNESS * plate.op.areas.sum()
    assert plate.energy(u) == pytest.approx(volume * (second * strain).sum() / 2, rel=1e-12)
    ends = np.stack([shape.points[plate.op.nodes], shape.points[following(plate.op)]])
    edge_load = np.zeros_like(f)
    np.add.at(edge_load, plate.op.nodes, half_tractions(ends, deformation @ second, plate.THICKNESS))
    np.add.at(edge_load, following(plate.op), half_tractions(ends, deformation @ second, plate.THICKNESS))
    assert abs(f - edge_load).max() < 1e-13 * plate.E * plate.THICKNESS


def following(op):
    """The next corner of its cell for every corner."""
    after = np.roll(op.nodes, -1)
    after[op.offsets[1:] - 1] = op.nodes[op.offsets[:-1]]
    return after


def half_tractions(ends, first_piola, thickness):
    """Half the traction on every edge from ends[0] to ends[1]; on inner edges the two cells' cancel."""
    edges = ends[1] - ends[0]
    return thickness * np.stack([edges[:, 1], -edges[:, 0]], axis=1) @ first_piola.T / 2


def test_rigid_motion_costs_nothing(plate):
    for angle in (0.4, 2.5, 6 * np.pi + 1.0):
        u = plate.displacement(partial(rotated, angle=angle, shift=(10.0, -7.0)))
        f, rotation, status = plate.force(u)
        assert abs(plate.stress(u)).max() < 1e-12 * plate.E
        assert abs(f).max() < 1e-12 * plate.E * plate.THICKNESS
        assert abs(plate.energy(u)) < plate.RIGID * plate.E * plate.THICKNESS
        assert status == pytest.approx(1.0, abs=1e-12)
        turn = np.arctan2(rotation[:, 1], rotation[:, 0])
        assert abs(np.exp(1j * turn) - np.exp(1j * angle)).max() < 1e-12


def test_force_is_the_gradient_of_the_energy(plate):
    u = plate.displacement(wavy)
    f = plate.force(u)[0]
    h, direction = 1e-5, np.random.default_rng(1).standard_normal(f.shape)
    for own in (direction, *np.eye(f.size)[:6].reshape(-1, *f.shape)):
        step = np.zeros_like(u)
        step[plate.first :] = own
        difference = (plate.energy(u + h * step) - plate.energy(u - h * step)) / (2 * h)
        assert difference == pytest.approx((f * own).sum(), abs=1e-6 * abs(f).sum())


def test_tangent_is_the_gradient_of_the_force(plate):
    u = plate.displacement(wavy)
    k = plate.tangent(u)
    assert (k == k.T).all()
    assert abs(plate.tangent(u, scale=-0.25) + 0.25 * k).max() < 1e-14 * abs(k).max()
    h, columns = 1e-6, range(0, k.shape[1], max(1, k.shape[1] // 40))
    for column in columns:
        step = np.zeros_like(u)
        step.reshape(-1)[2 * plate.first + column] = h
        difference = (plate.force(u + step)[0] - plate.force(u - step)[0]).ravel() / (2 * h)
        assert abs(difference - k[:, column]).max() < 1e-6 * abs(k).max()


def test_exactly_three_zero_modes(plate):
    values = np.linalg.eigvalsh(plate.tangent(plate.displacement(lambda x: 0 * x)))
    assert abs(values[:3]).max() < plate.ZERO * values[-1]
    assert values[3] > plate.LEAST * values[-1]


def test_internal_force_has_no_resultant(plate):
    u = plate.displacement(wavy)
    f, place = plate.force(u)[0], plate.points + u[plate.first :]
    assert abs(f.sum(axis=0)).max() < 1e-14 * abs(f).sum()
    assert abs((place[:, 0] * f[:, 1] - place[:, 1] * f[:, 0]).sum()) < 1e-13 * abs(f).sum()


def test_status_tells_inverted_and_undefined_displacements(shape, body):
    plate = body(shape)
    u = plate.displacement(wavy)
    assert plate.force(u)[2] > 0
    assert plate.force(plate.displacement(lambda x: x * [-2.0, 0.0]))[2] == pytest.approx(-1.0)
    for value in (np.nan, np.inf, -np.inf):
        for node in (0, len(u) // 2, -1):
            bad = u.copy()
            bad[node, 1] = value
            assert not plate.force(bad)[2] > 0


def test_mass_product(meshes, body):
    plate = body(meshes.mixed(), padding=4)
    op, a = plate.op, np.random.default_rng(0).standard_normal((plate.first + plate.op.n_nodes, 2))
    dense = np.zeros((op.n_nodes, op.n_nodes))
    dense[np.repeat(np.arange(op.n_nodes), np.diff(op.indptr)), op.indices] = op.mass
    r = np.ones_like(a)
    kernels.mass_product(op.indptr, op.indices, op.mass, 7.0, plate.first, a, r)
    assert (r[:4] == 1).all()
    assert abs(r[4:] - 1 - 7.0 * dense @ a[4:]).max() < 1e-14


def cantilever_tip(plate, shape, length):
    """Deflection of the right end under a shear traction of 1 N in all, the left end clamped; small displacements."""
    k = plate.tangent(plate.displacement(lambda x: 0 * x))
    right = np.flatnonzero(abs(shape.points[:, 0] - length) < 1e-9)
    load = np.zeros((plate.op.n_nodes, 2))
    right = right[np.argsort(shape.points[right, 1])]
    spacing = np.diff(shape.points[right, 1])
    load[right, 1] = np.convolve(spacing, [0.5, 0.5]) / spacing.sum()
    free = np.flatnonzero(np.repeat(shape.points[:, 0] > 1e-9, 2))
    return load.ravel()[free] @ np.linalg.solve(k[np.ix_(free, free)], load.ravel()[free])


def test_bending_is_accurate_on_two_cells_through_the_thickness(meshes, body):
    length, height = 1.0, 0.1
    for layers in (2, 5):
        shape = meshes.quads(10 * layers, layers, length, height)
        plate = body(shape)
        inertia, area = plate.THICKNESS * height**3 / 12, plate.THICKNESS * height
        beam = length**3 / (3 * plate.E * inertia) + 6 / 5 * length * 2 * (1 + plate.NU) / (plate.E * area)
        assert cantilever_tip(plate, shape, length) == pytest.approx(beam, rel=3e-3)
