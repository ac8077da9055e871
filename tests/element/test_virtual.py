from functools import partial

import numpy as np
import pytest

import polyida as pi
from polyida.element.elements import virtual, wachspress
from polyida.errors import InputError

SHIFT = np.array([[0.03, 0.05], [-0.02, 0.04]])


def test_patch(meshes, flexible, body):
    """In a linear field all elements have the forces of the same edge tractions."""
    shape = meshes.mixed()
    plate, other = flexible(shape, padding=3), body(shape, padding=3)
    u = plate.displacement(lambda x: x @ SHIFT.T + [3.0, -2.0])
    assert abs(plate.force(u)[0] - other.force(u)[0]).max() < 1e-13 * other.E * other.THICKNESS
    assert plate.energy(u) == pytest.approx(other.energy(u), rel=1e-12)


def test_linear_fields_on_cells_that_are_not_convex(meshes, flexible):
    shape = meshes.hanging()
    plate = flexible(shape, tau=5.0)
    f = plate.force(plate.displacement(lambda x: x @ SHIFT.T + [3.0, -2.0]))[0]
    stress = plate.stress(plate.displacement(lambda x: x @ SHIFT.T))
    assert abs(stress - stress[0]).max() < 1e-13 * plate.E
    deformation = np.eye(2) + SHIFT
    cauchy = np.array([[stress[0, 0], stress[0, 2]], [stress[0, 2], stress[0, 1]]])
    kirchhoff = np.linalg.det(deformation) * plate.op.areas.sum() * plate.THICKNESS * cauchy
    assert abs((shape.points @ deformation.T).T @ f - kirchhoff).max() < 1e-13 * plate.E


def test_stabilisation_is_symmetric_scales_with_tau_and_spares_triangles(meshes, body):
    shape = meshes.mixed()
    soft, stiff = (body(shape, operator=partial(virtual, tau=tau)) for tau in (0.1, 0.5))
    matrix = soft.dense(soft.op.stabilisation)
    assert (matrix == matrix.T).all()
    assert abs(soft.dense(stiff.op.stabilisation) - 5 * matrix).max() < 1e-15
    triangle, usual = virtual(meshes.polygon(3)), wachspress(meshes.polygon(3))
    assert not triangle.stabilisation.any()
    assert usual.stabilisation is None
    assert (triangle.gradients == usual.gradients).all() and (triangle.weights == usual.weights).all()
    assert abs(triangle.mass - usual.mass).max() < 1e-15


def test_mass_is_exact_for_rigid_bodies_and_positive(meshes, body):
    convex = meshes.mixed(1.0, 0.7, seed=9)
    for shape, area, polar in ((convex, 0.7, 0.7 * (1 + 0.49) / 12), (meshes.hanging(), 6.0, 6 * 13 / 12)):
        plate = body(shape, operator=virtual)
        mass = plate.dense(plate.op.mass)
        x, y = (shape.points - (shape.points.max(axis=0) + shape.points.min(axis=0)) / 2).T
        assert mass.sum() == pytest.approx(area, rel=1e-13)
        assert max(abs(x @ mass.sum(axis=0)), abs(y @ mass.sum(axis=0))) < 1e-14 * area
        assert x @ mass @ x + y @ mass @ y == pytest.approx(polar, rel=1e-12)
        assert (mass == mass.T).all()
        assert np.linalg.eigvalsh(mass)[0] > 1e-3 * area / len(x)
        assert mass.sum(axis=0).min() > 0
    many = body(meshes.polygon(30), operator=virtual)
    assert np.linalg.eigvalsh(many.dense(many.op.mass))[0] > 1e-4 * many.op.areas[0]


def test_mass_of_a_square_is_the_bilinear_one(meshes, body):
    square = body(meshes.mesh([[0, 0], [2, 0], [2, 2], [0, 2]], [[0, 1, 2, 3]]), operator=virtual)
    bilinear = np.array([[4, 2, 1, 2], [2, 4, 2, 1], [1, 2, 4, 2], [2, 1, 2, 4]]) / 9
    assert abs(square.dense(square.op.mass) - bilinear).max() < 1e-15


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
    modulus, nu, thickness = plate.E, plate.NU, plate.THICKNESS
    slenderness = length / height
    beam = (4 * slenderness**3 + 12 / 5 * (1 + nu) * slenderness) / (modulus * thickness)
    assert low < tip / beam - 1 < high


def test_bad_input_is_named(meshes):
    square = meshes.quads(1, 1)
    for tau in (0.0, -0.1, np.nan, np.inf):
        with pytest.raises(InputError, match="tau"):
            virtual(square, tau)
    with pytest.raises(InputError, match="cell 1: .*counter-clockwise"):
        virtual(meshes.mesh([[0, 0], [1, 0], [0, 1], [1, 1]], [[0, 1, 2], [1, 2, 3]]))
    with pytest.raises(InputError, match="cell 0: the side after node 1 has no length"):
        virtual(meshes.mesh([[0, 0], [1, 0], [1, 0], [0, 1]], [[0, 1, 2, 3]]))
    with pytest.raises(InputError, match="node 3 belongs to no cell"):
        virtual(meshes.mesh([[0, 0], [1, 0], [0, 1], [5, 5]], [[0, 1, 2]]))
