"""Linear modes: closed forms of beams, pendulums, chains and dampers, and what is refused."""

import warnings
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import roots_laguerre

import polyida as pi
from polyida.integrate.state import State

G = 9.81
FREE_FREE = np.array([4.730040744862704, 7.853204624095838, 10.99560783800167])  # roots of cos x cosh x = 1
CLAMPED = 1.8751040687119611  # least root of cos x cosh x = -1


class Springs(pi.Model):
    """Masses 2 kg and 1 kg on springs in a row, with a damper at each: `M x'' + C x' + K x = 0`."""

    n, m = 2, 0
    M, K = np.diag([2.0, 1.0]), np.array([[300.0, -100.0], [-100.0, 100.0]])

    def __init__(self, C=((0.0, 0.0), (0.0, 0.0)), K=None):
        self.C, self.K = np.array(C), self.K if K is None else np.array(K)

    def mass(self, q):
        return self.M

    def force(self, t, q, v):
        return self.K @ q + self.C @ v


class Chain(pi.Model):
    """N masses of 1 kg a link of 1 m apart, hanging from the origin: q their places, one constraint a link."""

    def __init__(self, count):
        self.n, self.m = 2 * count, count

    def mass(self, q):
        return np.eye(self.n)

    def force(self, t, q, v):
        return np.tile([0.0, G], self.m)

    def links(self, q):
        return np.diff(np.vstack([[0.0, 0.0], q.reshape(-1, 2)]), axis=0)

    def phi(self, t, q):
        return (np.sum(self.links(q) ** 2, axis=1) - 1.0) / 2

    def phi_q(self, t, q):
        rows, links = np.zeros((self.m, self.m, 2)), self.links(q)
        at = np.arange(self.m)
        rows[at, at] = links
        rows[at[1:], at[:-1]] = -links[1:]
        return rows.reshape(self.m, -1)

    @property
    def hanging(self):
        return np.stack([np.zeros(self.m), -1.0 - np.arange(self.m)], axis=1).ravel()


@dataclass(frozen=True, eq=False)
class Bar(pi.Body):
    """A rigid bar of 1 m and 2 kg in natural coordinates, its left end at the origin."""

    angle: float = 0.0
    name: str | None = None

    def coordinates(self):
        z = np.exp(1j * self.angle)
        return [0.5 * z, z]

    def mass_matrix(self):
        return np.diag([2.0, 2.0 / 12])

    def attachments(self):
        return {"left": [1.0, -0.5], "right": [1.0, 0.5]}

    def rows(self):
        z = self.point_of("axis", [0.0, 1.0]).x
        return [(pi.dot(z, z) - 1.0) * 0.5]


def beam(held=True, cells=(80, 4), height=0.02, gravity=(0.0, 0.0), angle=0.0, element="virtual", **material):
    """(model, sqrt(E I / rho A) / L^2) of a slender bar of 1 m, clamped at its left end or free."""
    rubber = {"E": 50e6, "nu": 0.0, "rho": 1100.0} | material
    scene = pi.Scene(gravity)
    bar = scene.add(pi.Plate(pi.mesh.quads(1.0, height, *cells), pi.Material(**rubber), 0.01, angle=angle, element=element))
    if held:
        scene.add(pi.Clamp(bar.section("left")))
    return scene.build(), np.sqrt(rubber["E"] * height**2 / 12 / rubber["rho"])


def test_a_clamped_bar_has_its_published_frequencies(scenes):
    """1 x 0.1 m, 50 MPa, nu 0.3: fine quadratic elements of another code."""
    found = pi.modes(scenes.cantilever(cells=400)[0].build(), count=3)
    assert np.allclose(found.frequencies, [3.421, 20.52, 53.36], rtol=2.5e-3)
    assert not found.unstable.any() and not found.damping.any()


def test_a_free_bar_has_three_rigid_motions_and_those_of_euler_and_bernoulli():
    """Two meshes are extrapolated at order 2; shear, which their beam has not, takes 0.1 to 0.7 %."""
    (coarse, unit), (fine, _) = beam(held=False, cells=(80, 4)), beam(held=False, cells=(160, 8))
    first, found = pi.modes(coarse, count=6), pi.modes(fine, count=6)
    assert np.array_equal(found.frequencies[:3], np.zeros(3))
    f = (4 * found.frequencies - first.frequencies)[3:] / 3
    assert np.allclose(f, FREE_FREE**2 * unit / (2 * np.pi), rtol=8e-3)
    assert found.participation.sum(axis=0) == pytest.approx([found.mass] * 2, rel=1e-9)
    assert found.mass == pytest.approx(1100.0 * 0.02 * 0.01, rel=1e-12)


def test_the_first_mode_of_a_cantilever_moves_its_published_share_of_the_mass():
    """0.6131 of a slender beam, 0.1883 its second, across; nothing along."""
    found = pi.modes(beam()[0], count=2)
    assert found.participation[:, 1] / found.mass == pytest.approx([0.6131, 0.1883], rel=5e-3)
    assert np.abs(found.participation[:, 0]).max() < 1e-9
    assert "61.3% along y" in found.summary()


@pytest.mark.parametrize("count", [1, 2, 12])
def test_a_hanging_chain_swings_at_the_roots_of_laguerre_s_polynomial(count):
    """omega^2 = g / l times the roots of L_N: of one mass, a pendulum, sqrt(g / l). All stiffness is that of the multipliers."""
    model = Chain(count)
    found = pi.modes(model, pi.static(model, q0=model.hanging), count=count)
    assert (2 * np.pi * found.frequencies) ** 2 / G == pytest.approx(roots_laguerre(count)[0], rel=1e-9)
    assert found.participation is None and np.isnan(found.mass)


def rigid_pendulum():
    scene = pi.Scene(gravity=(0.0, -G))
    bar = scene.add(Bar(angle=-np.pi / 2, name="bar"))
    scene.add(pi.Revolute(pi.ground, bar.at("left")))
    return scene.build()


def test_a_rigid_bar_swings_as_a_physical_pendulum():
    """omega^2 = 3 g / 2 L."""
    model = rigid_pendulum()
    found = pi.modes(model, pi.static(model), count=1)
    assert (2 * np.pi * found.frequencies[0]) ** 2 == pytest.approx(1.5 * G, rel=1e-9)
    assert found.mass == pytest.approx(2.0) and found.participation[0] == pytest.approx([1.5, 0.0], abs=1e-9)


def hanging(body):
    """(model, state) of two plates that hang from each other, each as `body` makes it."""
    scene, mesh, rubber = pi.Scene(gravity=(0.0, -G)), pi.mesh.quads(1.0, 0.1, 20, 2), pi.Material(500e6, 0.3, 1100.0)
    a, b = (scene.add(body(pi.Plate(mesh, rubber, 0.01, origin=(0.0, y), angle=-np.pi / 2))) for y in (0.0, -1.0))
    scene.add(pi.Revolute(pi.ground, a.section("left")))
    scene.add(pi.Revolute(a.section("right"), b.section("left")))
    model = scene.build()
    return model, pi.static(model)


def test_all_levels_of_a_body_have_its_slow_modes():
    """Two rigid bars hanging from each other: omega^2 = 3 (1 -+ 2 / sqrt 7) g / L of bars without width."""
    full, reduced, rigid = (
        pi.modes(*hanging(body), count=count).frequencies
        for body, count in ((lambda plate: plate, 5), (lambda plate: pi.Reduced(plate, modes=5), 5), (pi.Rigid, 2))
    )
    slender = np.sqrt(3 * (1 - np.array([2, -2]) / np.sqrt(7)) * G) / (2 * np.pi)
    assert rigid == pytest.approx(slender, rel=1e-2)
    assert full[:2] == pytest.approx(rigid, rel=2e-3) and reduced == pytest.approx(full, rel=5e-3)


def test_gravity_stiffens_a_hanging_bar():
    """omega^2 grows by `g int (L - x) w'^2 dx / int w^2 dx`, w the shape of the bar without weight, in first order."""
    model, _ = beam(gravity=(0.0, -0.5), angle=-np.pi / 2)
    loaded, free = (pi.modes(model, state, count=1).frequencies[0] for state in (pi.static(model), None))
    c, s, ch, sh = (f(CLAMPED) for f in (np.cos, np.sin, np.cosh, np.sinh))
    k = (ch + c) / (sh + s)
    shape = lambda x: np.cosh(CLAMPED * x) - np.cos(CLAMPED * x) - k * (np.sinh(CLAMPED * x) - np.sin(CLAMPED * x))  # noqa: E731
    slope = lambda x: CLAMPED * (np.sinh(CLAMPED * x) + np.sin(CLAMPED * x) - k * (np.cosh(CLAMPED * x) - np.cos(CLAMPED * x)))  # noqa: E731
    gain = 0.5 * quad(lambda x: (1 - x) * slope(x) ** 2, 0, 1)[0] / quad(lambda x: shape(x) ** 2, 0, 1)[0]
    assert (2 * np.pi) ** 2 * (loaded**2 - free**2) == pytest.approx(gain, rel=1e-2)


@pytest.mark.parametrize("damper", [0.5, 4.0, 39.0, 41.0])
def test_a_mass_on_a_spring_and_a_damper(damper):
    """2 s^2 + c s + 200 = 0, of one mass; the other is held stiffly. Beyond c = 40 it fades without swinging."""
    model = Springs(C=[[damper, 0.0], [0.0, 0.0]], K=[[200.0, 0.0], [0.0, 1e6]])
    found = pi.modes(model, count=1, damped=True)
    exact = np.roots([2.0, damper, 200.0])
    slow = exact[np.argmin(np.abs(exact) - 1e-9 * exact.imag)]
    assert found.roots[0] == pytest.approx(slow, rel=1e-9)
    assert found.damping[0] == pytest.approx(min(1.0, damper / 40.0), rel=1e-9)


def test_dampers_that_are_not_proportional_give_complex_shapes():
    C = np.array([[3.0, -3.0], [-3.0, 3.0]])
    found = pi.modes(Springs(C), count=2, damped=True)
    for s, x in zip(found.roots, found.shapes):
        assert np.abs((s**2 * Springs.M + s * C + Springs.K) @ x).max() < 1e-9 * np.abs(x).max() * 300
    assert np.abs(found.shapes.imag).max() > 1e-2 and np.iscomplexobj(found.shapes)


@pytest.mark.parametrize("cells", [(20, 2), (100, 4)])
@pytest.mark.parametrize("held", [True, False])
def test_a_viscous_bar_is_damped_by_half_its_viscosity_times_omega(cells, held):
    """C = viscosity K: Kelvin and Voigt's solid; frequencies are those without damping."""
    model, _ = beam(held, cells=cells, element="wachspress", viscosity=2e-4)
    found, still = pi.modes(model, count=6, damped=True), pi.modes(model, count=6)
    # round-off of K, eps of its largest eigenvalue, is 2.5e-8 of the least one on one kind of processor
    assert found.frequencies == pytest.approx(still.frequencies, rel=2.5e-7, abs=1e-12)
    assert found.damping == pytest.approx(2e-4 * np.pi * still.frequencies, rel=2.5e-7, abs=1e-12)
    assert np.abs(np.abs(found.shapes[-1]) - np.abs(still.shapes[-1])).max() < 1e-6 * np.abs(still.shapes).max()


def test_rigid_motions_beside_damped_vibrations_come_once_at_any_angle():
    """A stiff viscous plate and a bar with a soft, damped spring between them; round-off of the vibrations is in the rigid motions."""
    viscous, found = pi.Material(E=2e7, nu=0.3, rho=1100.0, viscosity=1e-3), []
    for angle in np.linspace(0.0, 3.3, 12):
        scene, end = pi.Scene(), (np.cos(angle), np.sin(angle))
        plate = scene.add(pi.Reduced(pi.Plate(pi.mesh.quads(1.0, 0.1, 5, 2), viscous, 0.01, angle=angle, name="plate"), modes=3))
        bar = scene.add(pi.RigidBody.bar(1.0, 0.7, end, angle, name="bar"))
        scene.add(pi.Revolute(plate.section("right"), bar.at("left")))
        scene.add(pi.TorsionSpring(plate.section("right"), bar.at("left"), 3.0, 0.1))
        found.append(pi.modes(scene.build(), count=30, damped=True).roots)
    for roots in found:
        assert len(roots) == len(found[0]) and np.array_equal(roots[:3], np.zeros(3)) and roots[3].imag > 8.0
        assert roots == pytest.approx(found[0], rel=1e-6)


@pytest.mark.filterwarnings("ignore:modes")
def test_a_force_without_potential_is_taken_with_damped_alone():
    """Ziegler's kind of flutter: two roots to the right of the axis that swing."""
    model = Springs(K=[[300.0, -100.0], [400.0, 100.0]])
    with pytest.raises(pi.InputError, match="not symmetric.*damped=True"):
        pi.modes(model, count=1)
    found = pi.modes(model, count=2, damped=True)
    exact = np.sqrt(-np.linalg.eigvals(np.linalg.solve(Springs.M, model.K)).astype(complex))
    assert np.sort_complex(found.roots) == pytest.approx(np.sort_complex(np.where(exact.imag < 0, -exact, exact)), rel=1e-9)
    assert found.unstable.any() and (found.frequencies > 0).all()


def states_of(roots):
    """Eigenvalues of the first-order system: both of a pair, a real root by itself."""
    return np.sort_complex(np.concatenate([roots, roots[roots.imag != 0].conj()]))


def test_both_roots_of_a_mass_that_is_damped_beyond_critical_are_given():
    """s^2 + 10 s + 1: -0.10 and -9.90."""

    class One(Springs):
        n, M = 1, np.eye(1)

    found = pi.modes(One(C=[[10.0]], K=[[1.0]]), damped=True)
    assert found.roots == pytest.approx(np.sort(np.roots([1.0, 10.0, 1.0]))[::-1], rel=1e-12)
    assert found.rates == pytest.approx(found.roots.real) and (found.frequencies == 0.0).all() and (found.damping == 1.0).all()
    assert "mode 1: fades at 0.101 1/s" in found.summary() and "mode 2: fades at 9.9 1/s" in found.summary()
    assert len(pi.modes(One(C=[[10.0]], K=[[1.0]]), count=1, damped=True).roots) == 1


def test_the_bicycle_at_rest_falls_in_two_ways():
    """Roots of the benchmark bicycle at v = 0: Meijaard, Papadopoulos, Ruina, Schwab, Proc. R. Soc. A 463 (2007), table 2."""

    class Bicycle(Springs):
        M = np.array([[80.81722, 2.31941332208709], [2.31941332208709, 0.29784188199686]])

    K = 9.81 * np.array([[-80.95, -2.59951685249872], [-2.59951685249872, -0.80329488458618]])
    model, exact = Bicycle(K=K), (3.13164324790656, 5.53094371765393)
    with pytest.warns(UserWarning, match="2 of the modes grow"):
        found = pi.modes(model, damped=True)
    assert np.sort(found.roots.real) == pytest.approx(np.sort([*exact, *np.negative(exact)]), rel=1e-12) and not found.roots.imag.any()
    assert np.sort(np.linalg.eigvals(pi.linearise(model).A)) == pytest.approx(np.sort(found.roots.real), rel=1e-9)
    assert found.unstable.sum() == 2 and found.summary().count("unstable") == 2 and "grows at 5.53 1/s, unstable" in found.summary()
    assert np.sort(found.damping).tolist() == [-1.0, -1.0, 1.0, 1.0]
    with pytest.warns(UserWarning, match="2 of the modes grow"):
        still = pi.modes(model)
    assert still.roots == pytest.approx(exact[::-1], rel=1e-12) or still.roots == pytest.approx(exact, rel=1e-12)
    assert len(found.plot().axes) == 4


@pytest.mark.filterwarnings("ignore:modes")
@pytest.mark.parametrize("seed", range(4))
def test_the_roots_are_the_eigenvalues_of_the_linearised_system(seed):
    """Of a random model on constraints, some of its roots real, some to the right."""
    random = np.random.default_rng(seed)

    class Random(Springs):
        m, M = 2, np.diag([2.0, 1.0, 3.0, 0.5, 1.0])
        n, B = 5, random.standard_normal((2, 5))

        def phi(self, t, q):
            return self.B @ q

        def phi_q(self, t, q):
            return self.B

    C, K = random.standard_normal((2, 5, 5))
    model = Random(C=4.0 * C @ C.T, K=K + K.T + 2.0 * np.eye(5))
    found, A = pi.modes(model, count=99, damped=True), pi.linearise(model).A
    assert states_of(found.roots) == pytest.approx(np.sort_complex(np.linalg.eigvals(A).astype(complex)), rel=1e-7, abs=1e-9)
    assert np.all(np.diff(np.abs(found.roots)) > -1e-9) and (found.roots.imag == 0).any()
    slowest = pi.modes(model, count=2, damped=True)
    assert slowest.roots == pytest.approx(found.roots[:2], rel=1e-9)


def test_where_it_is_drawn_and_where_it_moves(scenes):
    model = scenes.cantilever()[0].build()
    v = np.zeros(model.n)
    v[0] = 1e-3
    with pytest.warns(UserWarning, match="modes: the state moves"):
        found = pi.modes(model, State(0.0, np.zeros(model.n), v, v, np.zeros(model.m)), count=2)
    assert np.array_equal(found.frequencies, pi.modes(model, count=2).frequencies)


@pytest.mark.parametrize("damped", [False, True])
@pytest.mark.parametrize("size", [1e-6, 1.0, 1e3])
def test_a_free_body_on_an_unstretched_spring_along_an_axis_is_not_unstable(size, damped):
    """Across its axis the spring's stiffness is the round-off of that along it; a body that may drift and turn has two rigid motions."""
    scene = pi.Scene()
    bar = scene.add(pi.RigidBody.bar(0.5 * size, 2.0, origin=(size, 0.0), name="bar"))
    scene.add(pi.SpringDamper(pi.ground.at((0.0, 0.0)), bar.at("left"), stiffness=50.0, name="spring"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        roots = pi.modes(scene.build(), damped=damped).roots
    assert np.array_equal(roots[:2], [0.0, 0.0]) and roots[2] == pytest.approx(5j, rel=1e-9)
