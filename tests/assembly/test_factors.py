"""Plates whose cells are scaled: the same as plates of other materials, thicknesses and meshes, with nothing built anew."""

import pickle
from functools import cached_property
from types import SimpleNamespace

import numpy as np
import pytest

import polyida as pi
from polyida.assembly.factors import mass_work, stiffness_work
from polyida.assembly.places import PlacedPlate
from polyida.linear.lu import LU
from polyida.results.section_forces import section_forces

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
def test_full_cells_change_not_a_bit(element):
    solid = arms(element)
    full, at = solid.with_factors(upper=(1.0, None), lower=(np.ones(MESH.n_cells), 1)), state(solid)
    for name, wanted in everything(solid, at).items():
        assert np.array_equal(everything(full, at)[name], wanted), name


@pytest.mark.parametrize("element", ELEMENTS)
def test_factors_are_of_the_full_plate_and_others_stay(element):
    given, model = some(), arms(element)
    at, wanted = state(model), model.with_factors(**given)
    steps = model.with_factors(**some(7)).with_factors(upper=given["upper"]).with_factors(lower=given["lower"])
    compare(everything(steps, at), everything(wanted, at), rtol=0.0)
    for name, pair in given.items():
        assert np.array_equal(steps.factors[name], pair)
    assert np.array_equal(model.factors["upper"], np.ones((2, MESH.n_cells)))
    back = steps.with_factors(upper=(None, None), lower=(1.0, 1.0))
    assert np.array_equal(back.residual(*at), model.residual(*at))


@pytest.mark.parametrize("element", ELEMENTS)
def test_everything_is_a_sum_over_cells(element):
    """r, M and K are linear in the factors: halves of the cells that are scaled in turn add up."""
    model, chosen = arms(element), np.arange(MESH.n_cells) % 3 == 0
    at = state(model)
    r = [model.with_factors(upper=(np.where(on, 2.0, 1.0),) * 2).residual(*at) for on in (chosen, ~chosen, chosen | True, chosen & False)]
    assert np.allclose(r[0] + r[1], r[2] + r[3], rtol=1e-12, atol=1e-12 * np.abs(r[2]).max())


def test_what_was_worked_out_before_is_not_kept_where_it_follows_from_factors():
    model, given = arms(), some()
    at, kept = (
        state(model),
        [name for kind in type(model).__mro__ for name, value in vars(kind).items() if isinstance(value, cached_property)],
    )
    everything(model, at), [getattr(model, name) for name in kept]
    after, fresh = model.with_factors(**given), arms().with_factors(**given)
    compare(everything(after, at), everything(fresh, at), rtol=0.0)
    for name in kept:
        assert np.array_equal(numbers(getattr(after, name)), numbers(getattr(fresh, name))), name


def numbers(thing):
    """The numbers of what a model keeps."""
    if isinstance(thing, (list, tuple)):
        return np.concatenate([np.zeros(0), *map(numbers, thing)])
    if isinstance(thing, PlacedPlate):
        return np.concatenate([*thing.factors, thing.pull, thing.operator.weights])
    if isinstance(thing, LU):
        return thing.solve(np.arange(2.0 * MESH.n_nodes))
    return (thing.toarray() if hasattr(thing, "toarray") else thing).ravel()


def test_nothing_else_is_built_anew():
    from polyida.linear.dissection import symbolic_of

    model = arms()
    one, two = model.with_factors(upper=(0.5, 0.5)), model.with_factors(upper=(0.2, 0.5))
    assert one.once(symbolic_of, of_shape=True) is two.once(symbolic_of, of_shape=True) is model.once(symbolic_of, of_shape=True)
    assert one.arrays.links is two.arrays.links is model.arrays.links
    assert one.arrays.plates.gradients is two.arrays.plates.gradients and one.arrays.plates.pairs is two.arrays.plates.pairs


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


def test_section_forces_are_in_equilibrium_with_the_scaled_part():
    """A hanging plate at rest: the cut carries the weight below it, each cell times its factor."""
    mass = np.where(MESH.cell_centroids[:, 0] > 0.5, 3.0, 1.0)
    scene = pi.Scene((9.81, 0.0))
    bar = scene.add(pi.Plate(MESH, pi.Material(E=5e6, nu=0.3, rho=1100.0), 0.01, name="bar"))
    scene.add(pi.Clamp(bar.section("left"), name="root"))
    model = scene.build().with_factors(bar=(None, mass))
    tension = [section_forces(at_rest(hung), "bar", (0.3, 0.1), (1.0, 0.0)).normal[0] for hung in (model, scene.build())]
    heavier = 2.0 * 9.81 * 1100.0 * 0.01 * MESH.cell_areas[mass > 1.0].sum()
    assert tension[0] - tension[1] == pytest.approx(heavier, rel=1e-6)


def at_rest(model):
    """Its equilibrium as a motion of one frame."""
    return SimpleNamespace(model=model, t=np.zeros(1), q=pi.static(model).q[None], v=np.zeros((1, model.n)), a=np.zeros((1, model.n)))


def test_a_plate_starts_with_the_velocity_of_its_scaled_centre_of_mass():
    scene = pi.Scene()
    scene.add(pi.Plate(MESH, pi.Material(E=5e6, nu=0.3, rho=1100.0), 0.01, name="free", velocity=(2.0, 1.0), spin=3.0))
    mass = some()["upper"][1]
    model = scene.build().with_factors(free=(None, mass))
    whole = 1100.0 * 0.01 * (mass @ MESH.cell_areas)
    assert model.lightest == pytest.approx(whole)
    assert model.momenta(np.zeros(model.n), model.initial_velocity(0.0, np.zeros(model.n)))[:2] == pytest.approx(
        whole * np.array([2.0, 1.0])
    )


def test_pickle_and_files_keep_factors(tmp_path):
    model = arms().with_factors(**some())
    at = state(model)
    assert np.array_equal(pickle.loads(pickle.dumps(model)).residual(*at), model.residual(*at))
    run = pi.solve(model, 0.01, pi.GeneralizedAlpha(h=5e-3))
    run.save(tmp_path / "run.h5")
    loaded = pi.load(tmp_path / "run.h5")
    assert np.array_equal(loaded.model.residual(*at), model.residual(*at))
    for name, pair in some().items():
        assert np.array_equal(loaded.model.factors[name], pair)
    solid = pi.solve(arms(), 0.01, pi.GeneralizedAlpha(h=5e-3))
    solid.save(tmp_path / "solid.h5")
    assert np.array_equal(pi.load(tmp_path / "solid.h5").model.factors["upper"], np.ones((2, MESH.n_cells)))


def test_redundant_rows_stay_left_out():
    scene = pi.Scene()
    plate = scene.add(pi.Plate(MESH, pi.Material(E=5e6, nu=0.3, rho=1100.0), 0.01, name="bar"))
    scene.add(pi.Clamp(plate.section("left"), name="root"))
    scene.add(pi.Revolute(pi.ground, plate.section("left"), name="twice"))
    model = scene.build("least-norm")
    scaled = model.with_factors(bar=(0.5, 0.5))
    assert scaled.redundant is model.redundant and scaled.m == model.m
    run = pi.solve(scaled, 0.01, pi.GeneralizedAlpha(h=5e-3))
    assert run.reaction("twice").shape == (len(run), 2)


@pytest.mark.parametrize(
    "given, told",
    [
        ({"uper": (1.0, 1.0)}, "'uper' is no part of the scene; plates: 'upper'"),
        ({"hub": (1.0, 1.0)}, "'hub' is a Revolute; plates"),
        ({"rod": (1.0, 1.0)}, "'rod' is a Rigid: only the cells of full plates have factors"),
        ({"upper": 0.5}, "upper = 0.5 must be a pair"),
        (
            {"upper": (np.ones(3), 1.0)},
            r"stiffness of 'upper' .* of shape \(3,\), must be a positive number, or one for each of its 24 cells",
        ),
        ({"upper": (1.0, "half")}, "mass of 'upper' = 'half' must be"),
        ({"upper": (1.0, -0.5)}, "mass of 'upper' is -0.5: factors must be positive"),
        ({"upper": (np.r_[np.ones(5), 0.0, np.ones(18)], 1.0)}, "stiffness of 'upper' is 0 in cell 5: factors must be positive"),
        ({"upper": (1.0, np.full(24, np.nan))}, "mass of 'upper' is nan in cell 0"),
        ({"upper": (np.inf, None)}, "stiffness of 'upper' is inf"),
    ],
)
def test_wrong_factors_are_named(given, told):
    scene = pi.Scene()
    upper = scene.add(pi.Plate(MESH, pi.Material(E=5e6, nu=0.3, rho=1100.0), 0.01, name="upper"))
    scene.add(pi.Rigid(pi.Plate(MESH, pi.Material(E=5e6, nu=0.3, rho=1100.0), 0.01), name="rod"))
    scene.add(pi.Revolute(pi.ground, upper.section("left"), name="hub"))
    with pytest.raises(pi.InputError, match=told):
        scene.build().with_factors(**given)


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
