"""Objectives against what runs tell, and their slopes against differences of their own values."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

import polyida as pi
from polyida.adjoint.parameters import parameters_of

of = pi.objective
FRAMES = ("t", "q", "v", "a", "lam")
CIRCLE = lambda t: (2.0 * np.cos(3.0 * t), np.sin(3.0 * t))  # noqa: E731


def scene(element="wachspress", plane="stress"):
    """A plate that a motor turns, a reduced plate welded to it, a tip mass."""
    mesh, made = pi.mesh.rectangle(1.0, 0.1, cells=8, seed=1), pi.Scene(gravity=(0.0, -9.81))
    material = pi.Material(5e7, 0.3, 1100.0, plane=plane)
    upper = made.add(pi.Plate(mesh, material, 0.01, name="upper", element=element))
    lower = made.add(pi.Reduced(pi.Plate(mesh, material, 0.01, origin=(1.0, 0.0), name="lower"), modes=2))
    made.add(pi.Revolute(pi.ground, upper.section("left"), name="hub"))
    made.add(pi.AngleMotor(pi.ground, upper.section("left"), angle=pi.profile.quintic(0.0, 0.6, 0.1), name="motor"))
    made.add(pi.Weld(upper.section("right"), lower.section("left"), name="elbow"))
    made.add(pi.PointLoad(lower.section("right"), (1.0, -5.0), pi.profile.sine(1.0, 2.0, 0.4), name="load"))
    made.add(pi.PointMass(lower.section("right"), 0.5, name="tip"))
    return made.build().with_factors(upper=(np.linspace(0.6, 1.5, 8), np.linspace(1.3, 0.7, 8)))


def moving(model, seed=0):
    """Six frames of a turning, shaking motion: no solution of anything."""
    random, t = np.random.default_rng(seed), np.array([0.0, 0.01, 0.03, 0.04, 0.06, 0.09])
    places = model.reference @ np.array([1.0, 1j])
    q = [np.stack([z.real, z.imag], axis=1).ravel() for z in (places * (np.exp(1j * 5.0 * at) - 1.0) for at in t)]
    q = np.array(q) + 1e-3 * random.standard_normal((len(t), model.n))
    lam = 1.0 + random.standard_normal((len(t), model.m))
    return pi.Trajectory(model, "by hand", t, q, *random.standard_normal((2, *q.shape)), lam)


@pytest.fixture(scope="module", params=[("wachspress", "stress"), ("virtual", "strain")], ids=["wachspress", "virtual"])
def motion(request):
    return moving(scene(*request.param))


KINDS = {
    "path": lambda: of.Deviation("tip", CIRCLE),
    "place": lambda: of.Deviation("elbow", (0.9, 0.1)),
    "energy": of.StrainEnergy,
    "energy of a plate": lambda: of.StrainEnergy("upper"),
    "energy of a reduced plate": lambda: of.StrainEnergy("lower"),
    "torque": lambda: of.PeakReaction("motor"),
    "force": lambda: of.PeakReaction("hub", p=3),
    "moment": lambda: of.PeakReaction("elbow", p=2, unit="N m"),
    "stress": of.PeakStress,
    "stress of a plate": lambda: of.PeakStress("upper", p=1),
    "stress of what is solid": lambda: of.PeakStress("upper", p=3, power=0.2),
    "stress of a reduced plate": lambda: of.PeakStress("lower", p=4),
    "torque of a motor": lambda: of.PeakTorque("motor", p=3),
    "power of a motor": lambda: of.PeakPower("motor", p=2),
    "power of a joint between bodies": lambda: of.PeakPower("elbow", p=2),
    "work of loads": of.Compliance,
    "sum": lambda: 2.0 * of.StrainEnergy() - 0.3 * of.PeakReaction("motor") + of.Deviation("tip", (2.0, 0.0)),
}


def difference(function, size=1.0):
    """d function / ds at s = 0, of fourth order."""
    s = 1e-3 * size
    return (8 * (function(s) - function(-s)) - (function(2 * s) - function(-2 * s))) / (12 * s)


def slope_in(slopes, name):
    return slopes.by_time() if name == "t" else getattr(slopes, name)


@pytest.mark.parametrize("kind", KINDS)
def test_slopes_in_frames_are_those_of_the_value(kind, motion):
    objective, random = KINDS[kind](), np.random.default_rng(1)
    slopes = objective.slopes(motion)
    whole, parts = slopes(slice(0, 6)), [slopes(slice(0, 2)), slopes(slice(2, 6))]
    size = abs(objective(motion))
    for name in FRAMES:
        frames, slope = getattr(motion, name), slope_in(whole, name)
        way = random.standard_normal(frames.shape) * {"t": 1e-3, "q": 1e-3}.get(name, 1.0)
        expected = difference(lambda s: objective(replace(motion, **{name: frames + s * way})))  # noqa: B023
        assert (0.0 if slope is None else np.sum(slope * way)) == pytest.approx(expected, rel=1e-7, abs=1e-9 * size), name
        if slope is not None:
            assert np.allclose(np.concatenate([slope_in(part, name) for part in parts]), slope, rtol=1e-9, atol=1e-12 * np.abs(slope).max())


@pytest.mark.parametrize("kind", ["energy", "energy of a plate", "stress", "stress of a plate"])
def test_slopes_in_cells_at_fixed_frames(kind, motion):
    objective, model = KINDS[kind](), motion.model
    stiffness, mass = model.factors["upper"]
    way = np.random.default_rng(2).standard_normal(8)
    slopes = objective.slopes(motion)(slice(None))
    scaled = lambda s: replace(motion, model=model.with_factors(upper=(stiffness + s * way, mass)))  # noqa: E731
    assert slopes.direct["upper.stiffness"] @ way == pytest.approx(difference(lambda s: objective(scaled(s))), rel=1e-8)
    assert slopes.direct["upper.E"] * 5e7 == pytest.approx(slopes.direct["upper.stiffness"] @ stiffness, rel=1e-12)
    other = replace(motion, model=scaled(1e-4).model)
    assert slopes.of_model(other.model) - slopes.of_model(model) == pytest.approx(objective(other) - objective(motion), rel=1e-2)


def test_values_are_what_the_run_tells(motion):
    mean = lambda values: np.trapezoid(values, motion.t) / np.ptp(motion.t)  # noqa: E731
    assert of.StrainEnergy()(motion) == pytest.approx(mean(motion.energy.strain), rel=1e-12)
    assert of.StrainEnergy("upper")(motion) + of.StrainEnergy("lower")(motion) == pytest.approx(of.StrainEnergy()(motion), rel=1e-12)
    gap = motion.position("tip") - np.array([CIRCLE(t) for t in motion.t])
    assert of.Deviation("tip", CIRCLE)(motion) == pytest.approx(mean(np.sum(gap**2, axis=1)), rel=1e-13)
    torque = np.abs(motion.reaction("motor")[:, 0])
    assert of.PeakReaction("motor", p=2)(motion) == pytest.approx(np.sqrt(mean(torque**2)), rel=1e-13)
    assert 0.9 * torque.max() < of.PeakReaction("motor", p=400)(motion) <= torque.max()
    stress = np.array([motion.von_mises(k) for k in range(6)])
    areas = np.concatenate([body.operator.areas for body in motion.model.drawn])
    assert of.PeakStress(p=3)(motion) == pytest.approx(mean((stress**3) @ areas / areas.sum()) ** (1 / 3), rel=1e-12)
    assert 0.9 * stress.max() < of.PeakStress(p=1000)(motion) < stress.max()


@dataclass(frozen=True, eq=False)
class Sprung(pi.Body):
    """Two points on a spring of rest length 1 m, its energy a user's Python."""

    k: float = 30.0
    name: str | None = None

    def coordinates(self):
        return [0.0, 1.0]

    def mass_matrix(self):
        return np.eye(2)

    def attachments(self):
        return {"a": [1.0, 0.0], "b": [0.0, 1.0]}

    def translation(self):
        return [1.0, 1.0]

    def elastic(self, z):
        w = z[1] - z[0]
        pull = self.k * (abs(w) - 1.0) * w / abs(w)
        return np.array([-pull, pull])

    def energy(self, z):
        return 0.5 * self.k * (abs(z[1] - z[0]) - 1.0) ** 2


def test_energy_of_own_bodies():
    made, mesh = pi.Scene(), pi.mesh.quads(1.0, 0.2, 2, 1)
    made.add(pi.Plate(mesh, pi.Material(5e4, 0.3, 1100.0), 0.01, name="plate"))
    made.add(Sprung(name="spring"))
    run = moving(made.build())
    energies = [of.StrainEnergy(name) for name in ("plate", "spring", None)]
    lengths = np.hypot(*(np.array([[1.0], [0.0]]) + (run.q[:, -2:] - run.q[:, -4:-2]).T))
    assert energies[1](run) == pytest.approx(np.trapezoid(15.0 * (lengths - 1.0) ** 2, run.t) / np.ptp(run.t), rel=1e-10)
    assert energies[0](run) + energies[1](run) == pytest.approx(energies[2](run), rel=1e-12)
    way = 1e-3 * np.random.default_rng(4).standard_normal(run.q.shape)
    for energy in energies:
        expected = difference(lambda s: energy(replace(run, q=run.q + s * way)))  # noqa: B023
        assert np.sum(energy.slopes(run)(slice(None)).q * way) == pytest.approx(expected, rel=1e-7)
    stiffer = parameters_of(run.model)["spring.k"].of_model(energies[1].slopes(run)(slice(None)).of_model)
    assert 30.0 * stiffer == pytest.approx(energies[1](run), rel=1e-9)


class Rods(pi.problems.get("pendulum").model.__class__):
    """The pendulum with a named point, whose place is no linear function of q."""

    def position(self, name, q):
        if name != "bob":
            raise pi.InputError(f"no point is called {name!r}")
        return q * (1.0 + 0.1 * np.sum(q**2, axis=1))[:, None]


def test_named_points_of_own_models():
    random = np.random.default_rng(3)
    run = pi.Trajectory(Rods(), "by hand", np.linspace(0.0, 1.0, 5), *random.standard_normal((3, 5, 2)), np.zeros((5, 1)))
    objective, way = of.Deviation("bob", CIRCLE), random.standard_normal((5, 2))
    slopes = objective.slopes(run)(slice(0, 5))
    assert np.sum(slopes.q * way) == pytest.approx(difference(lambda s: objective(replace(run, q=run.q + s * way))), rel=1e-9)
    with pytest.raises(pi.InputError, match="StrainEnergy: Rods is no scene's model"):
        of.StrainEnergy()(run)


def test_own_objectives(motion):
    squares = of.UserObjective(
        lambda run: float(np.sum(run.v**2) + np.sum(run.t)), lambda run: {"v": 2.0 * run.v, "t": np.ones(6), "upper.mass": np.arange(8.0)}
    )
    slopes = squares.slopes(motion)
    assert squares(motion) == np.sum(motion.v**2) + motion.t.sum()
    assert np.array_equal(slopes(slice(2, 4)).v, 2.0 * motion.v[2:4]) and slopes(slice(2, 4)).q is None
    assert np.array_equal(slopes(slice(4, 6)).direct["upper.mass"], np.arange(8.0)) and not slopes(slice(2, 4)).direct


@pytest.mark.parametrize(
    "slopes, match",
    [
        ({"velocity": 0.0}, "'velocity'; known: 'q', 'v', 'a', 'lam', 't', and parameters"),
        ({"v": np.zeros(3)}, r"\['v'\].* must be finite numbers of shape \(6, "),
        ({"arm.mass": [np.nan]}, "must be finite numbers"),
        ([], "must return a dictionary"),
    ],
)
def test_own_slopes_are_looked_at(slopes, match, motion):
    with pytest.raises(pi.InputError, match=match):
        of.UserObjective(lambda run: 0.0, lambda run: slopes).slopes(motion)


@pytest.mark.parametrize("term", [1.0, 2.0])
def test_slopes_of_a_wrong_shape_are_refused_by_name(term):
    class Height(of.Objective):
        def __call__(self, run):
            return float(run.q[-1, 0])

        def slopes(self, run):
            return lambda part: of.Slopes(q=np.ones(run.model.n))

    with pytest.raises(pi.InputError, match=r"Height: slopes\(run\)\(part\).q has the shape .* it must be \("):
        pi.gradient(pi.solve(scene(), 2e-3, pi.GeneralizedAlpha(1e-3)), term * Height())


def test_masses_and_their_slopes():
    model = scene()
    run = pi.solve(model, 4e-3, pi.GeneralizedAlpha(1e-3, tolerance=1e-10))
    plate = model.factors["upper"][1] @ model.bodies[0].mesh.cell_areas * 0.01 * 1100.0
    assert of.Mass("upper")(run) == pytest.approx(plate, rel=1e-12)
    assert of.Mass()(run) == pytest.approx(plate + 1.1 + 0.5, rel=1e-12)
    names = ["upper.mass", "upper.stiffness", "upper.rho", "upper.thickness", "tip.mass", "lower.rho", "lower.thickness", "v0"]
    one, other = pi.gradient(run, [of.Mass(), of.Mass() + of.StrainEnergy("upper")], names)
    assert one.counts.solves == 0 and other.counts.solves > 0
    assert not one["v0"].any() and not np.any(one["upper.stiffness"])
    errors = pi.check_gradient(run, of.Mass(), names)
    assert max(errors.values()) < 1e-8, errors
    with pytest.raises(pi.InputError, match="Mass: no body or point mass is called 'hub'"):
        of.Mass("hub")(run)


def test_maxima_and_their_bounds(motion):
    steps = np.diff(motion.t)
    weights = np.convolve(steps, [0.5, 0.5]) / steps.sum()
    torque = np.abs(motion.reaction("motor")[:, 0])
    for p in (2.0, 8.0, 64.0):
        mean, largest = of.PeakTorque("motor", p=p)(motion), of.PeakTorque("motor", p=p).largest(motion)
        assert largest == pytest.approx(torque.max(), rel=1e-12)
        assert mean <= largest <= (1.0 + 1e-12) * mean * weights[torque.argmax()] ** (-1.0 / p)
    stress = np.array([motion.von_mises(k) for k in range(len(motion))])
    assert of.PeakStress().largest(motion) == pytest.approx(stress.max(), rel=1e-12)
    areas = np.concatenate([body.mesh.cell_areas for body in motion.model.drawn])
    frame, cell = np.unravel_index(stress.argmax(), stress.shape)
    share = weights[frame] * areas[cell] / areas.sum()
    assert of.PeakStress(p=8)(motion) <= stress.max() <= of.PeakStress(p=8)(motion) * share ** (-1.0 / 8.0)
    assert of.Deviation("tip", (0.0, 0.0)).largest(motion) is None and (2.0 * of.PeakStress()).largest(motion) is None


def test_power_is_that_of_the_motor():
    model = scene()
    run = pi.solve(model, 0.05, pi.GeneralizedAlpha(1e-3, tolerance=1e-10))
    speed = np.array([pi.profile.quintic(0.0, 0.6, 0.1).at(t)[1] for t in run.t])
    power = np.abs(run.reaction("motor")[:, 0] * speed)
    assert of.PeakPower("motor").largest(run) == pytest.approx(power.max(), rel=1e-3)
    errors = pi.check_gradient(run, of.PeakPower("motor", p=4), ["upper.stiffness", "upper.mass", "tip.mass", "motor.end"])
    assert max(errors.values()) < 1e-6, errors
    with pytest.raises(pi.InputError, match="PeakTorque: the reaction of 'hub' is in N; it has no N m"):
        of.PeakTorque("hub")(run)
    with pytest.raises(pi.InputError, match="Limit: upper = 0"):
        of.Limit(of.Mass(), 0.0)
