"""Plates whose cells are scaled: the same as plates of other materials, thicknesses and meshes, with nothing built anew."""

import numpy as np
import pytest

import polyida as pi
from polyida.assembly.factors import mass_work, stiffness_work

ELEMENTS = ("wachspress", "virtual")


def arms(element="wachspress", stiffness=1.0, mass=1.0, material=None, thickness=0.01, gravity=(1.0, -9.81), redundant="refuse", **more):
    """Two arms on one mesh, a tip mass, damping, a motor: their materials scaled."""
    mesh = more.pop("mesh", None) or MESH
    given = {"E": 5e6 * stiffness, "nu": 0.3, "rho": 1100.0 * mass, "viscosity": 1e-3, "mass_damping": 0.5} | (material or {})
    scene = pi.Scene(gravity)
    upper = scene.add(pi.Plate(mesh, pi.Material(**given), thickness, name="upper", element=element))
    lower = scene.add(pi.Plate(mesh, pi.Material(**given), thickness, origin=(1.0, 0.0), name="lower", element=element))
    scene.add(pi.Revolute(pi.ground, upper.section("left"), name="hub"))
    scene.add(pi.AngleMotor(pi.ground, upper.section("left"), pi.profile.quintic(0.0, 0.6, duration=0.5), name="motor"))
    scene.add(pi.Revolute(upper.section("right"), lower.section("left"), name="elbow"))
    scene.add(pi.PointMass(lower.section("right"), 0.05, name="tip"))
    scene.add(pi.PointLoad(lower.section("right"), (0.5, 0.1), pi.profile.sine(1.0, 3.0), name="push"))
    return scene.build(redundant)


MESH = pi.mesh.rectangle(1.0, 0.2, cells=24, seed=1)


def state(model, seed=3):
    """t, q, v, a, lam at random."""
    random = np.random.default_rng(seed)
    return 0.2, *(size * random.standard_normal(model.n) for size in (0.005, 0.1, 1.0)), random.standard_normal(model.m)


def some(seed=0):
    """Factors of stiffness and mass for both arms."""
    random = np.random.default_rng(seed)
    return {name: tuple(random.uniform(0.2, 2.0, (2, MESH.n_cells))) for name in ("upper", "lower")}


def everything(model, at):
    """What a model says of itself in a state."""
    t, q, v, a, lam = at
    matrix = model.tangent(t, q, v, a, lam, 7e3, 30.0, 1.0).toarray()
    told = {
        "r": model.residual(*at),
        "force": model.force(t, q, v),
        "mass": model.mass(q).toarray(),
        "mass inverse": model.mass_inverse(a),
        "tangent": matrix,
        "energy": model.potentials(q),
        "momenta": model.momenta(q, v),
        "powers": list(model.powers(t, q, v, lam).values()),
        "stress": model.stress(q),
        "lightest": model.lightest,
    }
    system = model.mass_system(t, q).solve(model.residual(*at), model.phi(t, q))
    return told | {"accelerations": system[0], "multipliers": system[1]}


def compare(one, other, rtol=1e-11):
    for name, wanted in other.items():
        assert np.allclose(one[name], wanted, rtol=rtol, atol=rtol * np.abs(wanted).max()), name


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize("gravity", [(1.0, -9.81), (pi.profile.sine(3.0, 1.0), -9.81)])
def test_one_factor_for_all_cells_is_another_material(element, gravity):
    model, other = arms(element, gravity=gravity).with_factors(upper=(0.3, 1.7), lower=(0.3, 1.7)), arms(element, 0.3, 1.7, gravity=gravity)
    at = state(model)
    compare(everything(model, at), everything(other, at))


@pytest.mark.parametrize("element", ELEMENTS)
def test_everything_is_a_sum_over_cells(element):
    """r, M and K are linear in the factors: halves of the cells that are scaled in turn add up."""
    model, chosen = arms(element), np.arange(MESH.n_cells) % 3 == 0
    at = state(model)
    r = [model.with_factors(upper=(np.where(on, 2.0, 1.0),) * 2).residual(*at) for on in (chosen, ~chosen, chosen | True, chosen & False)]
    assert np.allclose(r[0] + r[1], r[2] + r[3], rtol=1e-12, atol=1e-12 * np.abs(r[2]).max())


@pytest.mark.parametrize("element", ELEMENTS)
def test_stress_is_that_of_the_scaled_material_and_strain_that_of_the_motion(element):
    from polyida.results.motion import strains

    model, given = arms(element), some()
    scaled, q = model.with_factors(**given), state(model)[1]
    stiffness = np.concatenate([given["upper"][0], given["lower"][0]])
    assert np.allclose(scaled.stress(q), stiffness[:, None] * model.stress(q), rtol=1e-12)
    assert np.allclose(strains(scaled, q), strains(model, q), rtol=1e-12)


def test_a_run_is_that_of_another_material():
    one = pi.solve(arms().with_factors(upper=(0.5, 2.0), lower=(0.5, 2.0)), 0.05, pi.GeneralizedAlpha(h=5e-3))
    other = pi.solve(arms("wachspress", 0.5, 2.0), 0.05, pi.GeneralizedAlpha(h=5e-3))
    assert one.status == other.status == "done" and one.counts == other.counts
    for name in ("q", "v", "a", "lam"):
        assert np.allclose(getattr(one, name), getattr(other, name), atol=1e-8 * np.abs(getattr(other, name)).max())
    assert np.allclose(one.energy.total, other.energy.total, rtol=1e-8)
    assert np.allclose(one.momentum, other.momentum, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("damping", [{}, {"viscosity": 0.0}])
@pytest.mark.parametrize("element", ELEMENTS)
def test_works_of_cells_are_the_slopes_of_the_residual(element, damping):
    """r is linear in the factors, so that differences are exact; summed over frames, at any factors of the model."""
    model = arms(element, material=damping, gravity=(1.0, pi.profile.sine(3.0, 1.0)))
    frames, (w, a) = [state(model, seed) for seed in range(3)], np.random.default_rng(9).standard_normal((2, 3, model.n))
    t, q, v = (np.array([frame[k] for frame in frames]) for k in range(3))
    b = a + 0.5 * v - np.array([np.tile((1.0, pi.profile.sine(3.0, 1.0)(at)), model.n_nodes) for at in t])
    of_stiffness, of_mass = stiffness_work(model.with_factors(**some()), q, v, w), mass_work(model.with_factors(**some()), b, w)
    lam, names = np.zeros(model.m), ("upper", "lower")

    def total(name, what, cell):
        pair = [1.0, 1.0]
        pair[what] = 1.0 + (np.arange(MESH.n_cells) == cell)
        changed = model.with_factors(**{name: pair})
        return sum(w[k] @ changed.residual(t[k], q[k], v[k], a[k], lam) for k in range(3))

    solid = total("upper", 0, -1)
    for what, found in enumerate((of_stiffness, of_mass)):
        assert tuple(found) == names
        wanted = np.array([[total(name, what, cell) - solid for cell in range(MESH.n_cells)] for name in names])
        assert np.allclose([found[name] for name in names], wanted, atol=1e-11 * np.abs(wanted).max() + 1e-13 * abs(solid))


@pytest.mark.parametrize("element", ELEMENTS)
def test_linear_fields_pass_the_patch_test_in_every_cell(element):
    """u = H x and w = G x: each cell works `A t P(H) : G`, its stabilisation nothing; constant b and w give its mass."""
    H, G, material = np.array([[0.03, 0.05], [-0.02, 0.01]]), np.array([[0.4, -1.0], [0.7, 0.2]]), pi.Material(E=5e6, nu=0.3, rho=1100.0)
    scene = pi.Scene()
    scene.add(pi.Plate(MESH, material, 0.01, name="free", element=element))
    model = scene.build()
    q, w = ((model.reference @ slope.T).reshape(1, -1) for slope in (H, G))
    F, E = np.eye(2) + H, (H + H.T + H.T @ H) / 2
    P = 5e6 / (1 - 0.09) * F @ (0.7 * E + 0.3 * np.trace(E) * np.eye(2))
    assert np.allclose(stiffness_work(model, q, 0 * q, w)["free"], 0.01 * MESH.cell_areas * np.sum(P * G), rtol=1e-10)
    b, along = (np.tile(pair, model.n_nodes)[None] for pair in ((2.0, 3.0), (-1.0, 4.0)))
    assert np.allclose(mass_work(model, b, along)["free"], 1100.0 * 0.01 * MESH.cell_areas * 10.0, rtol=1e-12)
