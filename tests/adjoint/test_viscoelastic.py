"""Gradients of runs of viscoelastic plates, full and reduced, against differences; and what has no adjoint."""

import numpy as np
import pytest

import polyida as pi
from polyida.adjoint.products import products_at

TERMS = [(0.4, 0.05), (0.2, 0.3)]
NAMES = ["arm.prony", "fore.prony", "arm.stiffness", "arm.E", "arm.thickness", "arm.rho", "fore.E", "tip.mass", "v0"]


@pytest.fixture(scope="module")
def model():
    """A full plate of virtual elements, and a reduced one with one term and viscosity, as a double pendulum."""
    scene, mesh = pi.Scene(gravity=(0.0, -9.81)), pi.mesh.quads(0.4, 0.1, 4, 2)
    soft = {"E": 2e6, "nu": 0.3, "rho": 1000.0}
    arm = scene.add(pi.Plate(mesh, pi.Material(**soft, prony=TERMS), 0.01, element="virtual", name="arm"))
    material = pi.Material(**soft, prony=[(0.5, 0.1)], viscosity=1e-4)
    fore = scene.add(pi.Reduced(pi.Plate(mesh, material, 0.01, origin=(0.4, 0.0), name="fore"), modes=2))
    scene.add(pi.Revolute(pi.ground.at((0.0, 0.0)), arm.section("left"), name="root"))
    scene.add(pi.Revolute(arm.section("right"), fore.section("left"), name="elbow"))
    scene.add(pi.PointMass(fore.section("right"), 0.2, name="tip"))
    return scene.build()


def test_products_are_those_of_the_matrices(model):
    rng, lam = np.random.default_rng(0), np.zeros(model.m)
    q, v, w = 1e-3 * rng.standard_normal(model.n), rng.standard_normal(model.n), rng.standard_normal(model.n)
    found = products_at(model, model.drives(0.0), q, v, lam, w, lam)
    for matrix, product in (
        (model.force_q(0.0, q, v), found.stiff),
        (model.force_v(0.0, q, v), found.slowing),
        (model.mass(), found.heavy),
    ):
        exact = matrix.T @ w
        assert product.ravel() == pytest.approx(exact, rel=1e-12, abs=1e-14 * np.abs(exact).max())


@pytest.mark.parametrize("integrator", [pi.GeneralizedAlpha(h=2e-3, tolerance=1e-12), pi.RadauIIA(h=5e-3, tolerance=1e-13)])
def test_slopes_are_those_of_differences(model, integrator):
    run = pi.solve(model, 0.02, integrator)
    errors = pi.check_gradient(run, pi.objective.Deviation("tip", lambda t: (0.8, 0.0)), parameters=NAMES)
    assert max(errors.values()) < 1e-6, errors


def test_what_has_no_adjoint_is_refused(model):
    run = pi.solve(model, 0.01, pi.GeneralizedAlpha(h=2e-3))
    with pytest.raises(pi.InputError, match="PeakStress.*'arm', 'fore' viscoelastic"):
        pi.gradient(run, pi.objective.PeakStress())
    energy, frequency = pi.objective.StrainEnergy(), pi.objective.Frequency(0)
    for objective in (frequency, 2.0 * energy, pi.objective.Mass() + frequency, [pi.objective.Mass(), energy - frequency]):
        with pytest.raises(pi.InputError, match="(Frequency|StrainEnergy) is of elastic bodies, and 'arm', 'fore' viscoelastic"):
            pi.gradient(run, objective)
    with pytest.raises(pi.InputError, match="equilibria and modes of viscoelastic"):
        pi.gradient(pi.modes(model), pi.objective.Frequency(0))


def test_newton_leaves_round_off_in_the_error_of_a_run(model):
    """Left over are the equations that the steps solve, without the strains among the unknowns."""
    run = pi.solve(model, 0.02, pi.GeneralizedAlpha(h=2e-3, tolerance=1e-12))
    bars = pi.error_of(run, pi.objective.Deviation("tip", lambda t: (0.8, 0.0)))
    assert abs(bars.newton) < 1e-10 * abs(bars.time)


def test_slopes_with_two_full_plates_of_different_meshes_elements_and_series():
    scene, before = pi.Scene(gravity=(0.0, -9.81)), pi.ground.at((0.0, 0.0))
    plates = (
        ("near", "virtual", pi.mesh.quads(0.4, 0.1, 3, 1), [(0.4, 0.05)]),
        ("far", "wachspress", pi.mesh.rectangle(0.4, 0.1, cells=6, seed=1), [(0.3, 0.1), (0.2, 0.02)]),
    )
    for k, (name, element, mesh, terms) in enumerate(plates):
        material = pi.Material(E=2e6, nu=0.3, rho=1000.0, prony=terms)
        plate = scene.add(pi.Plate(mesh, material, 0.01, origin=(0.4 * k, 0.0), element=element, name=name))
        scene.add(pi.Revolute(before, plate.section("left"), name=f"pin of {name}"))
        before = plate.section("right")
    scene.add(pi.PointMass(before, 0.2, name="tip"))
    run = pi.solve(scene.build(), 0.01, pi.GeneralizedAlpha(h=2e-3, tolerance=1e-12))
    names = [f"{name}.{key}" for name, *_ in plates for key in ("stiffness", "prony", "E")]
    errors = pi.check_gradient(run, pi.objective.Deviation("tip", lambda t: (0.8, 0.0)), parameters=names)
    assert max(errors.values()) < 1e-6, errors
