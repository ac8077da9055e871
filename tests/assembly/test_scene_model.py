"""The model of a scene: fused kernels against the parts of the default model, needs, names."""

import numpy as np
import pytest

import polyida as pi
from polyida.model import Model


@pytest.fixture
def state(scenes, kind):
    """(model, t, q, v, a, lam) at random."""
    model, random = scenes.jointed(kind, pi.profile.sine(0.5, 1.0, 0.1)).build(), np.random.default_rng(5)
    return model, 0.2, *(0.1 * random.standard_normal(model.n) for _ in range(3)), random.standard_normal(model.m)


def test_residual_is_the_sum_of_its_parts(state):
    model, t, q, v, a, lam = state
    parts = Model.residual(model, t, q, v, a, lam)
    assert np.allclose(model.residual(t, q, v, a, lam), parts, atol=1e-12 * np.abs(parts).max())


def test_tangent_is_the_sum_of_its_parts(state):
    model, t, q, v, a, lam = state
    parts = Model.tangent(model, t, q, v, a, lam, 7e5, 3.0, 2.0)
    assert abs(model.tangent(t, q, v, a, lam, 7e5, 3.0, 2.0) - parts).max() < 1e-12 * abs(parts).max()


def test_a_tangent_of_complex_coefficients_is_the_sum_of_its_parts():
    scene = pi.Scene(gravity=(0.0, -9.81))
    damped = pi.Material(E=5e6, nu=0.3, rho=1100.0, viscosity=1e4)
    scene.add(pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=20, seed=1), damped, thickness=0.01))
    model = scene.build()
    t, q, v, a, lam = 0.2, *(0.01 * np.random.default_rng(5).standard_normal((3, model.n))), np.zeros(model.m)
    parts = (7e5 + 4e5j) * model.mass(q) + (3.0 + 2.0j) * model.force_v(t, q, v) + model.force_q(t, q, v)
    assert abs(model.tangent(t, q, v, a, lam, 7e5 + 4e5j, 3.0 + 2.0j, 1.0) - parts).max() < 1e-12 * abs(parts).max()


def test_one_pass_gives_residual_and_constraints(state):
    model, t, q, v, a, lam = state
    rotation = np.empty((model.n_nodes, 2))
    r, phi, _, det, cosine = model.evaluate(t, q, a, lam, rotation)
    assert np.array_equal(r, model.residual(t, q, v, a, lam)) and np.array_equal(phi, model.phi(t, q))
    assert np.isfinite([det, cosine]).all() and cosine <= 1.0


def test_rotations_follow_a_rigid_turn(scenes):
    model = scenes.pair()[0].build()
    rotation = np.empty((model.n_nodes, 2))
    model.evaluate(0.0, scenes.turned(model, np.zeros(model.n), 2.5), np.zeros(model.n), np.zeros(0), rotation)
    assert np.allclose(np.arctan2(rotation[:, 1], rotation[:, 0]), 2.5)


@pytest.mark.parametrize(
    "kind, driven, varies",
    [("revolute", False, False), ("clamp between", False, False), ("motor to ground", True, False), ("motor between", True, True)],
    indirect=["kind"],
)
def test_needs(scenes, kind, driven, varies):
    needs = scenes.jointed(kind).build().needs
    assert needs == pi.Needs(mass_varies=False, velocity_forces=False, driven=driven, phi_q_varies=varies)


class Counted(tuple):
    """Kinks that count how often somebody goes through all of them."""

    passes = 0

    def __iter__(self):
        Counted.passes += 1
        return super().__iter__()


def test_thousands_of_kinks_are_sorted_once(scenes):
    """A run asks for them at every kink: going through all of them there would take quadratic time."""
    times = Counted(np.arange(1, 41) * 1e-3)
    scene, upper = scenes.hinged(cells=4)
    straight = pi.profile.Profile(lambda t: 0.1 * t, lambda t: 0.1, lambda t: 0.0, times)
    scene.add(pi.PointLoad(upper.section("right"), (0.0, 1.0), straight))
    model, Counted.passes = scene.build(), 0
    for integrator in (pi.GeneralizedAlpha(h=1e-3), pi.EnergyMomentum(h=1e-3)):
        assert pi.solve(model, 0.04, integrator).success
    assert Counted.passes <= 2


def test_kinks_are_those_of_all_profiles(scenes):
    scene = scenes.jointed("motor between", pi.profile.quintic(0.0, 1.0, duration=0.5, begin=0.1))
    scene.add(pi.PointLoad(scene.parts["lower"].section("right"), (1.0, 0.0), pi.profile.ramp(0, 1, duration=0.3)))
    model = scene.build()
    assert model.kinks(-1.0, 1.0) == pytest.approx((0.0, 0.1, 0.3, 0.6))
    assert model.kinks(0.1, 0.6) == pytest.approx((0.3,))


def test_rows_and_names(scenes):
    scene = scenes.jointed("motor between")
    model = scene.build()
    assert model.m == len(model.labels) == 5
    assert [model.constraint_name(k) for k in range(model.rows["joint"].start, model.m)] == ["joint angle"]
    assert set(model.rows) == {"revolute 1", "revolute 2", "joint"}


def test_the_order_of_parts_does_not_matter(scenes):
    """A joint may be added before its plates."""
    scene = scenes.jointed("motor between")
    other = pi.Scene(scene.gravity)
    for name in ("tip", "joint", "upper", "lower"):
        other.add(scene.parts[name])
    for name in ("revolute 1", "revolute 2"):
        other.add(scene.parts[name])
    runs = [pi.solve(s.build(), 0.02, pi.GeneralizedAlpha(h=1e-3)) for s in (scene, other)]
    assert np.allclose(runs[0].q, runs[1].q, atol=1e-12)


def test_building_again_gives_the_same(scenes):
    scene = scenes.jointed("motor between")
    one, two = scene.build(), scene.build()
    q = 0.01 * np.random.default_rng(0).standard_normal(one.n)
    assert np.array_equal(one.force(0.1, q, q), two.force(0.1, q, q)) and np.array_equal(one.phi(0.1, q), two.phi(0.1, q))


@pytest.mark.parametrize("size", [2, 1000])
@pytest.mark.parametrize("call", ["force", "phi", "phi_q", "potential", "stress"])
def test_coordinates_of_the_wrong_size_are_refused(scenes, call, size):
    model, q = scenes.jointed("motor between").build(), np.zeros(size)
    arguments = {"force": (0.0, q, q), "phi": (0.0, q), "phi_q": (0.0, q), "potential": (q,), "stress": (q,)}
    with pytest.raises(ValueError):
        getattr(model, call)(*arguments[call])


def test_the_mass_system_is_that_of_the_whole_matrix(state):
    model, t, q, v, a, lam = state
    dq, dlam = model.mass_system(t, q).solve(a, lam)
    whole = Model.mass_system(model, t, q).solve(a, lam)
    assert np.abs(dq - whole[0]).max() < 1e-9 * np.abs(dq).max() and np.abs(dlam - whole[1]).max() < 1e-9 * np.abs(dlam).max()
