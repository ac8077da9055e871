from functools import partial

import numpy as np
import pytest

import polyida as pi
from polyida.element import stabilisation, virtual
from polyida.element.wachspress import reference_operator as wachspress
from polyida.errors import InputError

SHIFT = np.array([[0.03, 0.05], [-0.02, 0.04]])


def rotated(points, angle, shift=(0.0, 0.0)):
    """Displacement of a rigid motion."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return points @ turn.T - points + shift


def wavy(points):
    """A smooth, finite, inhomogeneous displacement on top of a rotation."""
    return rotated(points, 0.7) + 0.04 * np.sin(3 * points[:, ::-1] + [0.2, 0.9])


class Virtual:
    """A body of virtual elements: constant strains and stabilisation together."""

    def __init__(self, body, mesh, padding=0, tau=0.1):
        self.plain = body(mesh, padding, partial(virtual.reference_operator, tau=tau))
        self.op, self.first, self.displacement = self.plain.op, padding, self.plain.displacement
        self.factor = stabilisation.factor(self.plain.c1, self.plain.NU)
        self.on_pattern = self.op.indptr, self.op.indices, self.op.stabilisation, self.factor, padding

    def force(self, u):
        f = np.zeros_like(u)
        stabilisation.force(*self.on_pattern, u, f)
        assert not f[: self.first].any()
        return self.plain.force(u)[0] + f[self.first :]

    def energy(self, u):
        return self.plain.energy(u) + stabilisation.energy(*self.on_pattern, u)

    def tangent(self, u):
        return self.plain.tangent(u) + self.factor * np.kron(self.plain.dense(self.op.stabilisation), np.eye(2))


@pytest.fixture
def flexible(body):
    """Virtual(mesh, padding, tau)."""
    return partial(Virtual, body)


@pytest.fixture(params=["shape", "hanging"])
def cells(request, meshes):
    """Convex cells of every kind, and cells with straight and reentrant corners."""
    return meshes.mixed() if request.param == "shape" else meshes.hanging()


def test_factor_is_thickness_times_the_trace_of_the_plane_elasticity_matrix():
    modulus, nu, thickness = 7.0, 0.3, 0.4
    matrix = modulus / (1 - nu**2) * np.array([[1, nu, 0], [nu, 1, 0], [0, 0, (1 - nu) / 2]])
    c1 = thickness * modulus / (1 - nu**2)
    assert stabilisation.factor(c1, nu) == pytest.approx(thickness * np.trace(matrix), rel=1e-15)


def test_patch(meshes, flexible, body):
    """In a linear field all elements have the forces of the same edge tractions."""
    shape = meshes.mixed()
    plate, other = flexible(shape, padding=3), body(shape, padding=3)
    u = plate.displacement(lambda x: x @ SHIFT.T + [3.0, -2.0])
    assert abs(plate.force(u) - other.force(u)[0]).max() < 1e-13 * other.E * other.THICKNESS
    assert plate.energy(u) == pytest.approx(other.energy(u), rel=1e-12)


def test_linear_fields_on_cells_that_are_not_convex(meshes, flexible):
    shape = meshes.hanging()
    plate = flexible(shape, tau=5.0)
    f = plate.force(plate.displacement(lambda x: x @ SHIFT.T + [3.0, -2.0]))
    stress = plate.plain.stress(plate.displacement(lambda x: x @ SHIFT.T))
    assert abs(stress - stress[0]).max() < 1e-13 * plate.plain.E
    deformation = np.eye(2) + SHIFT
    cauchy = np.array([[stress[0, 0], stress[0, 2]], [stress[0, 2], stress[0, 1]]])
    kirchhoff = np.linalg.det(deformation) * plate.op.areas.sum() * plate.plain.THICKNESS * cauchy
    assert abs((shape.points @ deformation.T).T @ f - kirchhoff).max() < 1e-13 * plate.plain.E


def test_rigid_motion_costs_nothing(cells, flexible):
    plate = flexible(cells)
    stiffness = plate.plain.E * plate.plain.THICKNESS
    for angle in (0.4, 2.5, 6 * np.pi + 1.0):
        u = plate.displacement(partial(rotated, angle=angle, shift=(10.0, -7.0)))
        assert abs(plate.force(u)).max() < 1e-12 * stiffness
        assert abs(plate.energy(u)) < 1e-13 * stiffness


@pytest.mark.parametrize("corners", [None, 3, 4, 5, 8, 30])
def test_exactly_three_zero_modes(corners, meshes, flexible):
    plate = flexible(meshes.hanging() if corners is None else meshes.polygon(corners))
    values = np.linalg.eigvalsh(plate.tangent(plate.displacement(lambda x: 0 * x)))
    assert abs(values[:3]).max() < 1e-13 * values[-1]
    assert values[3] > 1e-3 * values[-1]


def test_force_is_the_gradient_of_the_energy(cells, flexible):
    plate = flexible(cells)
    u = plate.displacement(wavy)
    f = plate.force(u)
    direction = np.random.default_rng(1).standard_normal(u.shape)
    for step in (direction, *np.eye(f.size)[:6].reshape(-1, *f.shape)):
        h = 1e-5
        difference = (plate.energy(u + h * step) - plate.energy(u - h * step)) / (2 * h)
        assert difference == pytest.approx((f * step).sum(), abs=1e-6 * abs(f).sum())


def test_tangent_is_the_gradient_of_the_force(cells, flexible):
    plate = flexible(cells, padding=2)
    u, h = plate.displacement(wavy), 1e-6
    k = plate.tangent(u)
    for column in range(0, k.shape[1], max(1, k.shape[1] // 30)):
        step = np.zeros_like(u)
        step.reshape(-1)[2 * plate.first + column] = h
        difference = (plate.force(u + step) - plate.force(u - step)).ravel() / (2 * h)
        assert abs(difference - k[:, column]).max() < 1e-6 * abs(k).max()


def test_forces_have_no_resultant(cells, flexible):
    plate = flexible(cells)
    u = plate.displacement(wavy)
    f, place = plate.force(u), cells.points + u
    assert abs(f.sum(axis=0)).max() < 1e-14 * abs(f).sum()
    assert abs((place[:, 0] * f[:, 1] - place[:, 1] * f[:, 0]).sum()) < 1e-13 * abs(f).sum()


def test_stabilisation_is_symmetric_scales_with_tau_and_spares_triangles(meshes, body):
    shape = meshes.mixed()
    soft, stiff = (body(shape, operator=partial(virtual.reference_operator, tau=tau)) for tau in (0.1, 0.5))
    matrix = soft.dense(soft.op.stabilisation)
    assert (matrix == matrix.T).all()
    assert abs(soft.dense(stiff.op.stabilisation) - 5 * matrix).max() < 1e-15
    triangle, usual = virtual.reference_operator(meshes.polygon(3)), wachspress(meshes.polygon(3))
    assert not triangle.stabilisation.any()
    assert usual.stabilisation is None
    assert (triangle.gradients == usual.gradients).all() and (triangle.weights == usual.weights).all()
    assert abs(triangle.mass - usual.mass).max() < 1e-15


def test_mass_is_exact_for_rigid_bodies_and_positive(meshes, body):
    convex = meshes.mixed(1.0, 0.7, seed=9)
    for shape, area, polar in ((convex, 0.7, 0.7 * (1 + 0.49) / 12), (meshes.hanging(), 6.0, 6 * 13 / 12)):
        plate = body(shape, operator=virtual.reference_operator)
        mass = plate.dense(plate.op.mass)
        x, y = (shape.points - (shape.points.max(axis=0) + shape.points.min(axis=0)) / 2).T
        assert mass.sum() == pytest.approx(area, rel=1e-13)
        assert max(abs(x @ mass.sum(axis=0)), abs(y @ mass.sum(axis=0))) < 1e-14 * area
        assert x @ mass @ x + y @ mass @ y == pytest.approx(polar, rel=1e-12)
        assert (mass == mass.T).all()
        assert np.linalg.eigvalsh(mass)[0] > 1e-3 * area / len(x)
        assert mass.sum(axis=0).min() > 0
    many = body(meshes.polygon(30), operator=virtual.reference_operator)
    assert np.linalg.eigvalsh(many.dense(many.op.mass))[0] > 1e-4 * many.op.areas[0]


def test_mass_of_a_square_is_the_bilinear_one(meshes, body):
    square = body(meshes.mesh([[0, 0], [2, 0], [2, 2], [0, 2]], [[0, 1, 2, 3]]), operator=virtual.reference_operator)
    bilinear = np.array([[4, 2, 1, 2], [2, 4, 2, 1], [1, 2, 4, 2], [2, 1, 2, 4]]) / 9
    assert abs(square.dense(square.op.mass) - bilinear).max() < 1e-15


def test_the_force_is_that_of_the_matrix(cells, flexible):
    plate, op = flexible(cells, padding=3), flexible(cells).op
    u = np.random.default_rng(0).standard_normal((3 + op.n_nodes, 2))
    f = np.zeros_like(u)
    stabilisation.force(*plate.on_pattern, u, f)
    assert (f[:3] == 0).all()
    exact = plate.factor * plate.plain.dense(op.stabilisation) @ u[3:]
    assert abs(f[3:] - exact).max() < 1e-13 * abs(f).max()


@pytest.mark.parametrize(
    "tau, count, low, high",
    [
        (0.1, 40, -0.05, 0.06),
        (0.1, 90, -0.04, 0.04),
        (0.1, 250, -0.01, 0.01),
        (0.5, 40, -0.55, -0.3),
        (0.5, 90, -0.25, -0.1),
        (0.5, 250, -0.1, -0.05),
    ],
)
def test_bending_of_a_cantilever_depends_on_tau(tau, count, low, high, flexible):
    """Error of the tip deflection, 10 times as long as high, against Timoshenko's beam."""
    length, height = 1.0, 0.1
    shape = pi.mesh.rectangle(length, height, count)
    plate = flexible(shape, tau=tau)
    section = shape.section("right")
    load = np.zeros((plate.op.n_nodes, 2))
    load[section.nodes, 1] = section.lengths / section.lengths.sum()
    free = np.repeat(shape.points[:, 0] > 1e-9, 2)
    k = plate.tangent(plate.displacement(lambda x: 0 * x))[np.ix_(free, free)]
    tip = load.ravel()[free] @ np.linalg.solve(k, load.ravel()[free])
    modulus, nu, thickness = plate.plain.E, plate.plain.NU, plate.plain.THICKNESS
    slenderness = length / height
    beam = (4 * slenderness**3 + 12 / 5 * (1 + nu) * slenderness) / (modulus * thickness)
    assert low < tip / beam - 1 < high


def test_bad_input_is_named(meshes):
    square = meshes.quads(1, 1)
    for tau in (0.0, -0.1, np.nan, np.inf):
        with pytest.raises(InputError, match="tau"):
            virtual.reference_operator(square, tau)
    with pytest.raises(InputError, match="cell 1: .*counter-clockwise"):
        virtual.reference_operator(meshes.mesh([[0, 0], [1, 0], [0, 1], [1, 1]], [[0, 1, 2], [1, 2, 3]]))
    with pytest.raises(InputError, match="cell 0: the side after node 1 has no length"):
        virtual.reference_operator(meshes.mesh([[0, 0], [1, 0], [1, 0], [0, 1]], [[0, 1, 2, 3]]))
    with pytest.raises(InputError, match="node 3 belongs to no cell"):
        virtual.reference_operator(meshes.mesh([[0, 0], [1, 0], [0, 1], [5, 5]], [[0, 1, 2]]))
