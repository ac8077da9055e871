"""Viscoelastic plates: a bar against its closed form in every integrator, energy, statics, modes, and refused input."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import expm

import polyida as pi
from polyida.element.operator import Material
from polyida.element.relaxation import relax, strain_square
from polyida.integrate.alpha.steps import Steps

TERMS = [(0.4, 0.05), (0.2, 0.3)]
LENGTH, HEIGHT, THICKNESS, E, RHO, MASS, LOAD, END = 0.2, 0.1, 0.01, 1e5, 1000.0, 2.0, 1e-6, 1.0
STIFFNESS = E * THICKNESS * HEIGHT / LENGTH


def bar(terms=TERMS, element="wachspress", load=LOAD, **changes):
    """A bar of one cell with a mass at its end, pulled by a sudden load; at small strains and without Poisson's effect it is an oscillator."""
    material = pi.Material(**{"E": E, "nu": 0.0, "rho": RHO, "prony": terms} | changes)
    scene = pi.Scene(gravity=(0.0, 0.0))
    plate = scene.add(pi.Plate(pi.mesh.quads(LENGTH, HEIGHT, 1, 1), material, THICKNESS, element=element, name="bar"))
    scene.add(pi.Clamp(plate.section("left"), pi.ground, name="foot"))
    scene.add(pi.PointMass(plate.section("right"), MASS, name="tip"))
    scene.add(pi.PointLoad(plate.section("right"), (load, 0.0), name="load"))
    return scene


def exact(t, terms=TERMS):
    """Displacement of the tip and relaxed displacement of the first term at time t."""
    A = np.zeros((2 + len(terms),) * 2)
    mass = MASS + RHO * THICKNESS * HEIGHT * LENGTH / 3.0
    A[0, 1], A[1, 0] = 1.0, -STIFFNESS / mass
    for k, (g, tau) in enumerate(terms, 2):
        A[1, k], A[k, 0], A[k, k] = g * STIFFNESS / mass, 1.0 / tau, -1.0 / tau
    b = np.zeros(len(A))
    b[1] = LOAD / mass
    return np.linalg.solve(A, (expm(A * t) - np.eye(len(A))) @ b)[[0, 2]]


def errors(run, terms=TERMS):
    """Relative errors of tip and first relaxed strain at the end."""
    strain = run.model.strains["bar"]
    found = run.position("tip")[-1, 0] - LENGTH, run.v[-1][strain.columns[0]] * strain.units[0] * LENGTH
    return np.abs(found - exact(END, terms)) / np.abs(exact(END, terms))


@pytest.mark.parametrize(
    "element, integrator, steps, order",
    [
        ("wachspress", pi.GeneralizedAlpha, (200, 400), 2.0),
        ("virtual", pi.GeneralizedAlpha, (200, 400), 2.0),
        ("wachspress", pi.RadauIIA, (20, 40), 5.0),
        ("virtual", pi.EnergyMomentum, (200, 400), 2.0),
    ],
)
def test_orders_of_place_and_relaxed_strain(element, integrator, steps, order):
    model = bar(element=element).build()
    coarse, fine = (errors(pi.solve(model, END, integrator(h=END / n))) for n in steps)
    assert np.log2(coarse / fine) == pytest.approx([order] * 2, abs=0.3)


def test_tight_tolerances_meet_the_closed_form():
    model = bar().build()
    assert errors(pi.solve(model, END, pi.RadauIIA(h=END / 200))).max() < 1e-7


def test_ida_by_its_tolerance():
    model = bar(load=20.0, nu=0.3).build()
    tight = pi.solve(model, END / 4, pi.RadauIIA(h=END / 400))
    coarse, fine = (
        np.abs(np.r_[run.q[-1] - tight.q[-1], run.x[-1] - tight.x[-1]]).max()
        for run in (pi.solve(model, END / 4, pi.IDA(rtol=rtol)) for rtol in (1e-5, 1e-8))
    )
    assert fine < 1e-6 and np.log10(coarse / fine) / 3.0 > 0.7


def spinning(prony=TERMS, **changes):
    """A free plate that spins and vibrates."""
    material = pi.Material(E=2e5, nu=0.3, rho=RHO, prony=prony, **changes)
    scene = pi.Scene(gravity=(0.0, 0.0))
    plate = scene.add(pi.Plate(pi.mesh.quads(0.4, 0.1, 4, 2), material, THICKNESS, spin=5.0, name="plate"))
    scene.add(pi.PointMass(plate.section("right"), 0.2, name="tip"))
    return scene


def test_energy_and_dissipated_work_in_the_energy_momentum_method():
    model = spinning().build()
    run, h = pi.solve(model, 4.0, pi.EnergyMomentum(h=0.01)), 0.01
    body, strains, dissipated = model.bodies[0], model.strains["plate"], 0.0
    operator, material = body.operator, Material(model.arrays.plates.membrane_stiffness[0], model.arrays.plates.body_nu[0])
    for (q0, v0), (q1, v1) in pairwise(zip(np.asarray(run.q), np.asarray(run.v))):
        middle, half = ((x.reshape(-1, 2)[body.nodes]).copy() for x in (0.5 * (q0 + q1), 0.5 * (q1 - q0)))
        mean, none = np.empty(3 * len(operator.weights)), np.zeros_like(middle)
        relax(operator.cells(), material, middle, half, np.zeros_like(mean), none, mean)
        x = (strains.units * 0.5 * (v0 + v1)[strains.columns]).reshape(len(TERMS), -1)
        dissipated += h * sum(g / tau * strain_square(operator.weights, material, mean - one) for (g, tau), one in zip(TERMS, x))
    energy = run.energy.total
    assert dissipated > 1e-2 * run.energy.strain.max()
    assert abs(energy[-1] + dissipated - energy[0]) < 1e-10 * np.abs(energy).max()
    assert run.energy.dissipated["plate"][-1] == pytest.approx(dissipated, rel=0.15)


def test_rigid_motion_relaxes_nothing():
    model = spinning().build()
    v = pi.consistent_state(model).v
    turn = np.array([[0.0, -1.0], [1.0, 0.0]]) - np.eye(2)
    q = np.r_[(model.reference[: model.n_factored] @ turn.T).ravel(), np.zeros(model.n - 2 * model.n_factored)]
    r = model.residual(0.0, q, v, np.zeros(model.n), np.zeros(0))
    assert np.abs(r[2 * model.n_factored :]).max() < 1e-12 and model.strain_energy(q, v) < 1e-12


def test_statics_take_the_long_time_modulus_and_runs_stay_there():
    loaded, elastic = bar(load=5.0, nu=0.3).build(), bar(terms=(), load=5.0, nu=0.3, E=0.4 * E).build()
    rest, known = pi.static(loaded), pi.static(elastic)
    assert np.abs(rest.q[: elastic.n] - known.q).max() < 1e-9
    assert loaded.strain_energy(rest.q, rest.v) > 0.0
    run = pi.solve(loaded, 0.2, pi.GeneralizedAlpha(h=1e-3), state=rest)
    assert np.abs(np.asarray(run.q) - rest.q)[:, : elastic.n].max() < 1e-10
    stress = pi.solve(elastic, 0.01, pi.GeneralizedAlpha(h=1e-3), state=known).stress(-1)
    assert run.stress(-1) == pytest.approx(
        stress, rel=1e-8, abs=1e-14 * np.abs(stress).max()
    )  # the shear stress is round-off of the normal ones


def test_paths_of_equilibria_take_the_long_time_modulus():
    loaded, elastic = bar(load=5.0, nu=0.3).build(), bar(terms=(), load=5.0, nu=0.3, E=0.4 * E).build()
    path, known = pi.equilibrium_path(loaded, first=0.5), pi.equilibrium_path(elastic, first=0.5)
    assert path.factors == pytest.approx(known.factors) and np.abs(path.q[:, : elastic.n] - known.q).max() < 1e-9
    rest = pi.static(loaded, q0=path.states[-1].q)
    assert path.model is loaded and path.states[-1].x.shape == rest.x.shape == (loaded.k,)


def test_modes_take_the_modulus_of_a_sudden_strain():
    soft, hard = bar().build(), bar(terms=()).build()
    assert pi.modes(soft).frequencies == pytest.approx(pi.modes(hard).frequencies)


def test_frequency_response_has_the_complex_modulus():
    model, mass = bar().build(), MASS + RHO * THICKNESS * HEIGHT * LENGTH / 3.0
    frequencies = np.array([0.1, 1.0, 2.0, 5.0])
    pushed = np.zeros(model.n)
    right = np.isclose(model.reference[:, 0], LENGTH)
    pushed[: 2 * len(right)][::2][right] = 0.5
    found = pi.frequency_response(model, None, pushed, "tip", frequencies).values
    omega = 2 * np.pi * frequencies
    modulus = 1.0 - sum(g / (1.0 + 1j * omega * tau) for g, tau in TERMS)
    assert np.ravel(found[:, 0]) == pytest.approx(1.0 / (STIFFNESS * modulus - omega**2 * mass), rel=1e-6)


def test_runs_are_saved_and_resumed(tmp_path):
    model = bar(load=20.0).build()
    whole = pi.solve(model, 0.2, pi.GeneralizedAlpha(h=1e-3))
    half = pi.solve(model, 0.1, pi.GeneralizedAlpha(h=1e-3))
    half.save(tmp_path / "half.h5")
    again = pi.load(tmp_path / "half.h5")
    assert again.model.parts["bar"].material.prony == tuple(TERMS)
    rest = pi.solve(model, 0.2, pi.GeneralizedAlpha(h=1e-3), state=half.state)
    assert np.array_equal(rest.q[-1], whole.q[-1])


def test_what_knows_no_relaxation_refuses_it():
    model = bar().build()
    run = pi.solve(model, 0.02, pi.GeneralizedAlpha(h=1e-3))
    with pytest.raises(pi.InputError, match="viscoelastic"):
        pi.gradient(run, pi.objective.PeakStress())


def test_section_forces_balance_load_and_inertia():
    """Of a plate almost without mass: the normal force at each cut is the load less the inertia of the mass at the end."""
    scene = pi.Scene()
    material = pi.Material(E=E, nu=0.3, rho=1e-7, prony=TERMS)
    before = scene.add(pi.Plate(pi.mesh.quads(0.1, HEIGHT, 2, 2), material, THICKNESS, name="other"))
    plate = scene.add(pi.Plate(pi.mesh.quads(LENGTH, HEIGHT, 4, 2), material, THICKNESS, origin=(0.1, 0.0), name="bar"))
    scene.add(pi.Clamp(before.section("left"), pi.ground, name="foot"))
    scene.add(pi.Weld(before.section("right"), plate.section("left"), name="seam"))
    scene.add(pi.PointMass(plate.section("right"), MASS, name="tip"))
    scene.add(pi.PointLoad(plate.section("right"), (0.5, 0.0), name="load"))
    run = pi.solve(scene.build(), 0.4, pi.RadauIIA(h=0.02))
    change = np.array([run.model.displacement("tip", a)[0] for a in run.a])
    for at in (0.05, 0.1, 0.15):
        assert run.section_forces("bar", (at, 0.05)).normal == pytest.approx(0.5 - MASS * change, abs=1e-6)


def test_rigid_bodies_ignore_it():
    assert pi.Rigid(bar().parts["bar"]).label


def chain():
    """A viscoelastic plate, an elastic one, one of another series that is viscous too and shares its mesh, and a rigid body, held by joints."""
    scene, mesh = pi.Scene(gravity=(0.0, -9.81)), pi.mesh.quads(0.4, 0.1, 4, 2)
    soft = dict(E=2e5, nu=0.3, rho=RHO)
    materials = pi.Material(**soft, prony=TERMS), pi.Material(**soft), pi.Material(**soft, prony=[(0.5, 0.1)], viscosity=1e-4)
    before = pi.ground.at((0.0, 0.0))
    for k, (material, element) in enumerate(zip(materials, ("wachspress", "virtual", "virtual"))):
        plate = scene.add(pi.Plate(mesh, material, THICKNESS, origin=(0.4 * k, 0.0), element=element, name=f"plate {k}"))
        scene.add(pi.Revolute(before, plate.section("left")))
        before = plate.section("right")
    body = scene.add(pi.RigidBody(mass=1.0, inertia=0.1, points={"c": (0.0, 0.0)}, origin=(1.2, 0.0)))
    scene.add(pi.Weld(before, body.at("c")))
    return scene


@pytest.mark.parametrize("c", [3e2, 2e2 + 3e2j])
def test_strains_are_eliminated_from_the_step_matrix(c):
    model, rng = chain().build().with_factors(**{"plate 2": (2.0, 1.0)}), np.random.default_rng(0)
    first = 2 * model.n_factored
    q, v, r, lam = 1e-3 * rng.standard_normal(model.n), rng.standard_normal(model.n), rng.standard_normal(model.n), np.zeros(model.m)
    v[:first] = 0.0
    step = model.step_matrix()
    step.factor(0.0, q, v, v, lam, c * c, c)
    S, B = model.tangent(0.0, q, v, v, lam, c * c, c, 1.0).toarray(), model.phi_q(0.0, q).toarray()
    exact = np.linalg.solve(np.block([[S, B.T], [B, np.zeros((model.m,) * 2)]]), -np.r_[r, lam])[: model.n]
    found = step.saddle(0.0, q, lam, r, lam)[0]
    for part in (slice(first), slice(first, None)):  # the factor has single precision
        assert np.abs(found - exact)[part].max() < 1e-4 * np.abs(exact[part]).max()


@pytest.mark.parametrize("tau, modulus", [(1e-9, 0.6), (1e9, 1.0)])
@pytest.mark.parametrize("integrator", [pi.GeneralizedAlpha(h=2e-3), pi.RadauIIA(h=1e-2), pi.EnergyMomentum(h=2e-3)])
def test_very_fast_and_very_slow_relaxation(tau, modulus, integrator):
    relaxing, elastic = bar([(0.4, tau)], load=5.0, nu=0.3).build(), bar((), load=5.0, nu=0.3, E=modulus * E).build()
    one, other = (pi.solve(model, 0.3, integrator).q[-1][: elastic.n] for model in (relaxing, elastic))
    assert np.abs(one - other).max() < 1e-6 * np.abs(other).max()


def test_slopes_are_those_of_the_forces():
    model, rng = chain().build(), np.random.default_rng(0)
    q, v, d = 1e-3 * rng.standard_normal(model.n), rng.standard_normal(model.n), rng.standard_normal(model.n)
    along_q = (model.force(0.0, q + 1e-7 * d, v) - model.force(0.0, q - 1e-7 * d, v)) / 2e-7
    along_v = (model.force(0.0, q, v + 1e-3 * d) - model.force(0.0, q, v - 1e-3 * d)) / 2e-3
    assert model.force_q(0.0, q, v) @ d == pytest.approx(along_q, rel=1e-6, abs=1e-6 * np.abs(along_q).max())
    assert model.force_v(0.0, q, v) @ d == pytest.approx(along_v, rel=1e-6, abs=1e-8 * np.abs(along_v).max())


def test_paths_with_python_take_the_same_steps():
    compiled, plain = chain().build(), chain().build()
    plain.compiled = False
    for integrator in (pi.GeneralizedAlpha(h=2e-3), pi.RadauIIA(h=4e-3), pi.IDA(rtol=1e-7), pi.EnergyMomentum(h=2e-3)):
        one, other = (pi.solve(model, 0.02, integrator).x[-1] for model in (compiled, plain))
        assert np.abs(one - other).max() < 1e-5 * np.abs(one).max()


@pytest.mark.parametrize(
    "settings", [{"h": 2e-3}, {"h": 2e-3, "form": "stabilised"}, {"h": 2e-3, "start": "plain"}, {"rtol": 1e-6}], ids=str
)
def test_strains_are_no_unknowns_of_compiled_steps(settings):
    """They are computed from E at the end of a step. Newton's method in Python solves for them with the other coordinates."""
    compiled, plain = chain().build(), chain().build()
    plain.compiled, integrator = False, pi.GeneralizedAlpha(**settings, tolerance=1e-10)
    assert Steps(integrator, compiled, pi.Counts()).unknowns == 2 * compiled.n_factored < compiled.n
    one, other = (pi.solve(model, 0.02, integrator) for model in (compiled, plain))
    assert np.array_equal(one.t, other.t)
    for name, tolerance in (("q", 1e-10), ("x", 1e-9), ("v", 1e-8)):
        a, b = (np.asarray(getattr(run, name)) for run in (one, other))
        assert np.abs(a - b).max() < tolerance * np.abs(b).max()


@pytest.mark.parametrize(
    "mesh", [pi.mesh.rectangle(LENGTH, HEIGHT, cells=6, seed=1), pi.mesh.quads(LENGTH, HEIGHT, 3, 2)], ids=["polygons", "quads"]
)
@pytest.mark.parametrize("element", ["wachspress", "virtual"])
def test_a_bar_almost_without_mass_is_strained_alike_in_every_cell(element, mesh):
    """Polygons of any number of corners hold the closed form of one cell: a strain that is the same everywhere."""
    load, material = 1e-3, pi.Material(E=E, nu=0.0, rho=1.0, prony=TERMS)
    scene = pi.Scene()
    plate = scene.add(pi.Plate(mesh, material, THICKNESS, element=element, name="bar"))
    scene.add(pi.Clamp(plate.section("left"), pi.ground, name="foot"))
    scene.add(pi.PointMass(plate.section("right"), MASS + RHO * THICKNESS * HEIGHT * LENGTH / 3.0, name="tip"))
    scene.add(pi.PointLoad(plate.section("right"), (load, 0.0), name="load"))
    run = pi.solve(scene.build(), END, pi.RadauIIA(h=END / 40))
    place, relaxed = exact(END) * load / LOAD
    strain = run.model.strains["bar"]
    first = (strain.units * run.v[-1][strain.columns])[: len(strain.columns) // len(TERMS)]
    assert run.success and run.position("tip")[-1, 0] - LENGTH == pytest.approx(place, rel=5e-4), run.message
    along = first[np.abs(first) > 1e-2 * np.abs(first).max()]  # the others are across and shear, and places of no point
    assert len(along) >= mesh.n_cells and along == pytest.approx(relaxed / LENGTH, rel=5e-4)
