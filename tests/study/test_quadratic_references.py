"""Published values with quadratic cells: at most a fifth of the coordinates that linear cells take."""

import numpy as np
import pytest

import polyida as pi
from mesh_convergence import cases
from polyida.problems import literature

CSM1 = (-7.18767e-3, -66.1023e-3)  # m, Turek and Hron 2006
COOK = 23.964  # vertical displacement of the middle of the free side, plane stress, E = 1, nu = 1/3: the usual value of converged meshes


def test_csm1_on_the_arc():
    """Linear quads have an error of 4e-3 with 9588 coordinates."""
    found = cases.csm1("quads", "quadratic", 3, "arc")
    assert found["dof"] < 9588 / 5
    assert found["moved"] == pytest.approx(CSM1, rel=1e-3)


def test_elastica():
    """The plane body is 5e-4 off the slender reference; linear polygons have 1.5e-3 with 2800 coordinates."""
    found = cases.elastica("polygons", "quadratic", 1, 1)
    assert found["dof"] < 2800 / 5
    assert found["deviation"] < 1.5e-3


def test_spin_up_beam():
    """260 x 2 linear quadrilaterals have 1566 coordinates; with 130 the extension has the same error, that of the step."""
    problem = literature.spin_up_beam_problem(nx=15, order=2)
    run = pi.solve(problem.model, problem.t_end, pi.GeneralizedAlpha(h=1e-2, rho_inf=0.9))
    assert problem.model.n < 1566 / 5
    assert literature.steady_extension(run) == pytest.approx(literature.EXTENSION, rel=1e-3)


def cook(count, order):
    """(deflection, n) of Cook's membrane with count x count quads: 48 long, sides of 44 and 16, the right one pulled up by a shear of 1 in sum."""
    flat = pi.mesh.quads(1.0, 1.0, count, count, order=order)
    x, share = flat.points[:, 0], flat.points[:, 1] + 0.5
    mesh = pi.mesh.moved(flat, np.column_stack([48.0 * x, 44.0 * x + share * (44.0 - 28.0 * x)]))
    scene = pi.Scene()
    plate = scene.add(pi.Plate(mesh, pi.Material(1.0, 1 / 3, 1.0), thickness=1.0, name="membrane"))
    scene.add(pi.Clamp(plate.section("left"), name="clamp"))
    scene.add(pi.EdgeTraction(plate.section("right"), (0.0, 1.0 / 16.0), name="shear"))
    model = scene.build()
    moved = cases.linear_response(model).reshape(-1, 2)
    return moved[plate.node((48.0, 52.0)).nodes[0], 1], model.n


def test_cooks_membrane():
    quadratic, n = cook(8, order=2)
    linear, many = cook(34, order=1)
    assert n < many / 5
    assert abs(quadratic - COOK) < 0.02
    assert abs(quadratic - COOK) < abs(linear - COOK)
