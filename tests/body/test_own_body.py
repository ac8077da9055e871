"""Bodies of one's own: against ordinary differential equations, joined to plates and each other, in files; and what is wrong with one."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import polyida as pi
from polyida.model.differences import jacobian

G, LENGTH, MASS = 9.81, 1.0, 2.0


@dataclass(frozen=True, eq=False)
class Bar(pi.Body):
    """A rigid bar in natural coordinates: its point `ahead` of the left end, m, and its direction z, |z| = 1."""

    mass: float = MASS
    length: float = LENGTH
    origin: tuple = (0.0, 0.0)
    angle: float = 0.0
    ahead: complex = 0.5
    name: str | None = None

    def coordinates(self):
        z = np.exp(1j * self.angle)
        return [complex(*self.origin) + z * self.ahead, z]

    def mass_matrix(self):
        off = self.length / 2 - self.ahead
        turning = self.mass * (self.length**2 / 12 + abs(off) ** 2)
        return np.array([[self.mass, self.mass * off], [self.mass * np.conj(off), turning]])

    def attachments(self):
        return {name: [1.0, at * self.length - self.ahead] for name, at in (("left", 0.0), ("middle", 0.5), ("right", 1.0))}

    def x_axis(self):
        return [0.0, 1.0]

    def rows(self):
        z = self.at("left").d
        return [(pi.dot(z, z) - 1.0) * (0.5 * self.length)]


@dataclass(frozen=True, eq=False)
class Spring(pi.Body):
    """Two points of mass m on a spring of rest length 1 m."""

    m: float = 0.5
    k: float = 30.0
    name: str | None = None

    def coordinates(self):
        return [0.0, 1.0]

    def mass_matrix(self):
        return self.m * np.eye(4)

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


@pi.compiled
@dataclass(frozen=True, eq=False)
class Fast(Spring):
    """The same, compiled."""


@dataclass(frozen=True, eq=False)
class Exact(Spring):
    """The same with its derivative."""

    def elastic_z(self, z):
        w = z[1] - z[0]
        u = np.array([w.real, w.imag]) / abs(w)
        along = np.outer(u, u)
        return np.kron([[1.0, -1.0], [-1.0, 1.0]], self.k * (along + (1.0 - 1.0 / abs(w)) * (np.eye(2) - along)))


def pendulum(**options):
    """(model, bar) of a bar hinged at its left end, released level."""
    scene = pi.Scene(gravity=(0.0, -G))
    bar = scene.add(Bar(name="bar", **options))
    scene.add(pi.Revolute(pi.ground, bar.at("left"), name="hinge"))
    return scene.build(), bar


def swing(t, pull=1.5 * G / LENGTH):
    """Angle of the physical pendulum `angle'' = -pull cos(angle)`, released level."""
    return solve_ivp(lambda _, y: [y[1], -pull * np.cos(y[0])], (0.0, t), [0.0, 0.0], method="DOP853", rtol=1e-13, atol=1e-13).y[0, -1]


def error(run, bar, angle):
    return np.abs(run.position(bar.at("right"))[-1] - [np.cos(angle), np.sin(angle)]).max()


def tilted():
    """(scene, plate, bar) of a flexible plate with a bar hinged to its right edge."""
    scene = pi.Scene(gravity=(0.0, -G))
    mesh, rubber = pi.mesh.rectangle(1.0, 0.1, cells=12, seed=1), pi.Material(E=50e6, nu=0.3, rho=1100.0)
    plate = scene.add(pi.Plate(mesh, rubber, 0.01, name="plate"))
    bar = scene.add(Bar(origin=(1.0, 0.0), angle=0.3, ahead=0.2 + 0.1j, name="bar"))
    scene.add(pi.Revolute(plate.section("right"), bar.at("left"), name="elbow"))
    return scene, plate, bar


def test_a_pendulum_follows_its_differential_equation():
    model, bar = pendulum()
    run = pi.solve(model, 1.0, pi.IDA(rtol=1e-11, atol=1e-13))
    assert run.success and "plain paths" not in run.summary()
    assert error(run, bar, swing(1.0)) < 1e-8


def test_energy_and_momentum_beside_a_flexible_plate():
    scene, _, bar = tilted()
    scene.add(pi.PointMass(bar.at("right"), 0.4))
    scene.gravity = (0.0, 0.0)
    model, random = scene.build(), np.random.default_rng(2)
    start = pi.consistent_state(model, v0=None)
    spin = np.stack([-model.reference[:, 1], model.reference[:, 0]], axis=1).ravel()
    hit = model.mass_system(0.0, start.q).solve(-model.mass() @ (3.0 * spin + 0.1 * random.standard_normal(model.n)), np.zeros(model.m))[0]
    run = pi.solve(model, 0.1, pi.EnergyMomentum(h=1e-3), v0=hit)
    assert run.success, run.message
    assert np.ptp(run.energy.total) < 1e-9 * run.energy.total[0] and np.ptp(run.energy.kinetic) > 1e-4 * run.energy.total[0]
    lift = np.concatenate([np.tile(np.eye(2), (model.bodies[0].nodes.stop, 1)), np.eye(2), np.zeros((2, 2))])
    momentum = run.v @ (model.mass() @ lift)
    turning = [
        np.stack([-z[:, 1], z[:, 0]], axis=1).ravel() @ (model.mass() @ v)
        for z, v in zip((model.reference.ravel() + run.q).reshape(len(run), -1, 2), run.v)
    ]
    assert np.ptp(momentum, axis=0).max() < 1e-10 * np.abs(momentum).max()
    assert np.ptp(turning) < 1e-9 * np.abs(turning).max()


@pytest.mark.parametrize("kind", [Spring, Exact])
def test_derivatives(kind):
    scene, plate, bar = tilted()
    spring = scene.add(kind())
    scene.add(pi.PointMass(bar.at("right"), 0.3))
    scene.add(pi.Revolute(pi.ground, spring.at("b")))
    scene.add(pi.AngleMotor(plate.section("right"), bar.at("left"), pi.profile.sine(0.5, 1.0, 0.1)))
    model, random = scene.build(), np.random.default_rng(4)
    q, v, a = (0.01 * random.standard_normal(model.n) for _ in range(3))
    found = pi.check_derivatives(model, 0.2, q=q, v=v, a=a)
    assert max(found.values()) < 1e-6, found


@pytest.mark.parametrize(
    "method", [pi.IDA(rtol=1e-9, atol=1e-11), pi.RadauIIA(rtol=1e-8), pi.GeneralizedAlpha(h=1e-3), pi.EnergyMomentum(h=1e-3)]
)
def test_an_elastic_body_vibrates_and_falls(method):
    scene = pi.Scene(gravity=(0.0, -G))
    scene.add(Spring(name="spring"))
    model, t = scene.build(), 0.3
    run = pi.solve(model, t, method, q0=[-0.05, 0.0, 0.05, 0.0])
    stretch = 0.05 * np.cos(np.sqrt(2 * 30.0 / 0.5) * t)
    assert np.allclose(run.q[-1], [-stretch, -0.5 * G * t * t, stretch, -0.5 * G * t * t], atol=2e-5)
    assert np.ptp(run.energy.total) < 1e-4
    assert run.energy.strain[0] == pytest.approx(0.5 * 30.0 * 0.1**2)
    assert run.position(scene.parts["spring"].at("b"))[-1] == pytest.approx([1.0 + stretch, -0.5 * G * t * t], abs=2e-5)


def test_files_hold_it(tmp_path):
    scene, _, bar = tilted()
    scene.add(pi.PointMass(bar.at("right", direction=(1.0, 1.0)), 0.4, name="tip"))
    run = pi.solve(scene.build(), 5e-3, pi.GeneralizedAlpha(h=1e-3), out=tmp_path / "run.h5")
    loaded = pi.load(tmp_path / "run.h5")
    part = loaded.model.parts["bar"]
    assert isinstance(part, Bar) and part.ahead == bar.ahead
    assert np.array_equal(loaded.energy.total, run.energy.total)
    assert np.array_equal(loaded.position("tip"), run.position("tip"))
    assert np.array_equal(loaded.reaction("elbow"), run.reaction("elbow"))
    assert np.array_equal(loaded.position(part.at("left")), run.position(bar.at("left")))


def changed(**functions):
    """A Bar with functions of its class replaced by what gives these values."""
    made = {name: lambda self, *given, value=value: value for name, value in functions.items()}
    return dataclass(frozen=True, eq=False)(type("Changed", (Bar,), made))(name="bar")


WRONG = {
    r"coordinates\(\) gave": dict(coordinates=[[0.0, 1.0]]),
    r"mass_matrix\(\) gave \(3, 3\)": dict(mass_matrix=np.eye(3)),
    r"mass_matrix\(\) gave nothing": dict(mass_matrix="2 kg"),
    "not Hermitian": dict(mass_matrix=[[1.0, 1j], [1j, 1.0]]),
    "semidefinite": dict(mass_matrix=[[1.0, 2.0], [2.0, 1.0]]),
    r"attachments\(\) gave": dict(attachments=[[1.0, 0.0]]),
    r"attachments\(\) gave \{'':": dict(attachments={"": [1.0, 0.0]}),
    r"attachments\(\) gave \{1:": dict(attachments={1: [1.0, 0.0]}),
    r"attachment 'left' is given by \[1.0\]": dict(attachments={"left": [1.0]}),
    "attachment 'left' is given by .*nan": dict(attachments={"left": [1.0, np.nan]}),
    r"x_axis\(\) gave": dict(x_axis=[1.0]),
    "has no length at rest": dict(x_axis=[0.0, 0.0]),
    r"translation\(\) must give": dict(translation=[1.0]),
    "moves by .* and must move by 1": dict(translation=[1.0, 0.1]),
    "must give both": dict(elastic=np.zeros(2)),
}


@pytest.mark.parametrize("words", WRONG)
def test_what_is_wrong_is_told(words):
    with pytest.raises(pi.InputError, match=f"'bar'.*{words}"):
        pi.Scene().add(changed(**WRONG[words]))


def test_rows_and_directions_are_looked_at():
    bar = Bar(name="bar")
    for row, words in (
        (pi.dot(bar.at("left").d, bar.at("left").d) - 2.0, r"bar: it does not hold at rest.*its coordinates\(\)"),
        (bar.at("left").x - bar.at("left").x, "Bar 'bar', which is not in the scene"),
    ):
        scene = pi.Scene()
        scene.add(changed(rows=[row]))
        with pytest.raises(pi.InputError, match=words):
            scene.build()
    with pytest.raises(pi.InputError, match="no direction to turn"):
        Spring().at("a", direction=(1.0, 0.0))


@dataclass(frozen=True, eq=False)
class Uneven(Spring):
    """Masses that differ along x and y, and a drag."""

    def mass_matrix(self):
        return np.diag([0.5, 0.9, 0.5, 0.8])

    def damping(self):
        return 0.7, 0.0


@dataclass(frozen=True, eq=False)
class Formed(Spring):
    """One vector whose energy is given in Python and as a form: kernels take the form."""

    def mass_matrix(self):
        return 0.5 * np.eye(2)

    def attachments(self):
        return {"a": [1.0, 0.0], "b": [1.0, 1.0]}

    def translation(self):
        return [1.0, 0.0]

    def elastic(self, z):
        return np.array([0.0, 2.0 * self.k * (abs(z[1]) ** 2 - 1.0) * z[1]])

    def energy(self, z):
        return 0.5 * self.k * (abs(z[1]) ** 2 - 1.0) ** 2

    def form(self):
        return [[self.k]], [0.0]


def drawn_together(x, v, data):
    pull = data[0] * (x[1] - x[0]) + data[1] * (v[1] - v[0])
    return np.stack((pull, -pull))


class Drawn(pi.ForceElement, part=False):
    """A spring and a damper of rest length zero between two points."""

    def sides(self):
        return (self.a, self.b)

    def energy(self, x):
        return 0.5 * self.k * float((x[1] - x[0]) @ (x[1] - x[0]))


@dataclass(frozen=True, eq=False)
class InPython(Drawn):
    a: object
    b: object
    k: float = 20.0
    c: float = 3.0
    name: str | None = None

    def forces(self, t, x, v):
        return drawn_together(x, v, (self.k, self.c))


@pi.compiled
@dataclass(frozen=True, eq=False)
class ByNumba(InPython):
    """The same, compiled."""


PARTS = {
    "spring": lambda b, wheel: pi.SpringDamper(b.at("b"), wheel.at("tip"), stiffness=50.0, damping=2.0, length=0.4),
    "torsion": lambda b, wheel: pi.TorsionSpring(pi.ground, wheel.at("tip"), stiffness=4.0, damping=0.3),
    "contact": lambda b, wheel: pi.PenaltyContact(b.at("a"), wheel.at("tip"), stiffness=1e3, radius=2.0),
    "python": lambda b, wheel: InPython(b.at("a"), wheel.at("tip")),
    "compiled": lambda b, wheel: ByNumba(b.at("a"), wheel.at("tip"), k=10.0),
    "torque": lambda b, wheel: pi.Torque(wheel.at("tip"), 3.0),
    "load": lambda b, wheel: pi.PointLoad(b.at("b"), (1.0, 2.0)),
    "joint": lambda b, wheel: pi.Revolute(b.at("a"), pi.ground),
}


def beside(kind, *parts, **options):
    """The model of a body of one's own and a wheel, with some of PARTS."""
    scene = pi.Scene(gravity=(0.3, -G))
    body = scene.add(kind(name="own", **options))
    wheel = scene.add(pi.RigidBody(mass=2.0, inertia=0.1, points={"tip": (0.3, 0.1)}, origin=(1.0, 0.5), name="wheel"))
    scene.add(pi.PointMass(body.at("b"), 0.3))
    for part in parts:
        scene.add(PARTS[part](body, wheel))
    return scene.build()


@pytest.mark.parametrize("kind", [Spring, Fast, Uneven, Formed])
def test_the_residual_holds_each_part_once(kind):
    """By all parts together, and by any two beside a body in Python, it changes as by each alone; without loads and speeds it is the slope of the potential."""
    random, plain = np.random.default_rng(1), beside(kind)
    q, v, a = 0.3 * random.standard_normal((3, plain.n))
    lam = random.standard_normal(plain.m + 2)

    def gained(*parts):
        model = beside(kind, *parts)
        at_joint = [*lam[1:], lam[0]] if "joint" in parts else lam[:1]
        if not {"torque", "load"} & {*parts}:
            slope = jacobian(lambda x: np.array([model.potential(x)]), q, 1)[0]
            assert np.abs(model.force(0.1, q, 0.0 * v) - slope).max() < 1e-7 * np.abs(slope).max()
        return model.residual(0.1, q, v, a, np.array(at_joint)) - plain.residual(0.1, q, v, a, lam[:1])

    alone = {part: gained(part) for part in PARTS}
    for parts in (*(combinations(PARTS, 2) if kind is Spring else ()), tuple(PARTS)):
        assert np.abs(gained(*parts) - sum(alone[part] for part in parts)).max() < 1e-9


@pytest.mark.parametrize("kind", [Spring, Uneven, Fast])
def test_every_integrator_feels_elastic_forces_beside_compiled_ones(kind):
    """All end in one place, and the energies are in balance."""
    runs, model = [], beside(kind, "spring", "compiled")
    for method in (pi.RadauIIA(h=5e-3), pi.IDA(rtol=1e-6), pi.GeneralizedAlpha(h=1e-3), pi.EnergyMomentum(h=1e-3)):
        run = pi.solve(model, 0.03, method, output=[0.0, 0.01, 0.02, 0.03])
        energy = run.energy
        balance = energy.total - energy.total[0] - sum(energy.work.values()) + sum(energy.dissipated.values(), np.zeros(len(run)))
        runs.append(run.q[-1])
        assert run.success and np.abs(balance).max() < 1e-3 and np.abs(runs[-1] - runs[0]).max() < 2e-5 and energy.strain[-1] > 1e-4


def test_an_energy_that_is_not_that_of_the_elastic_force_is_told():
    wrong = dataclass(frozen=True, eq=False)(type("Wrong", (Spring,), {"energy": lambda self, z: 1.01 * Spring.energy(self, z)}))
    scene = pi.Scene()
    scene.add(wrong(name="spring"))
    model = scene.build()
    assert pi.check_derivatives(model)["energy of spring"] == pytest.approx(0.01, rel=0.02)
    for method in (pi.GeneralizedAlpha(h=1e-2), pi.EnergyMomentum(h=1e-2)):
        with pytest.raises(pi.InputError, match=r"spring: its energy must have elastic\(z\) as its gradient"):
            pi.solve(model, 0.1, method)


@pytest.mark.parametrize("function, arguments", [("elastic", "self, z"), ("energy", "self, z"), ("attachments", "self")])
def test_a_function_with_other_arguments_is_named(function, arguments):
    wrong = dataclass(frozen=True, eq=False)(type("Wrong", (Spring,), {function: lambda self, t, z: 0.0}))
    with pytest.raises(pi.InputError, match=rf"'spring': {function}: its arguments must be \({arguments}\)"):
        pi.Scene().add(wrong(name="spring"))


def hung(kind, **options):
    """A spring of one's own that hangs on the ground, with a mass and a force element."""
    scene = pi.Scene(gravity=(0.0, -G))
    body = scene.add(kind(name="spring", **options))
    scene.add(pi.Revolute(pi.ground, body.at("a"), name="hinge"))
    scene.add(pi.SpringDamper(pi.ground.at((0.5, 1.0)), body.at("b"), 10.0, 0.5))
    return scene.build()


METHODS = (
    pi.GeneralizedAlpha(h=1e-3, tolerance=1e-11, start="plain"),
    pi.RadauIIA(h=2e-3),
    pi.EnergyMomentum(h=1e-3, tolerance=1e-12),
    pi.IDA(rtol=1e-8),
)


@pytest.mark.parametrize("method", METHODS, ids=repr)
def test_a_compiled_body_moves_as_in_python(method):
    models = [hung(kind) for kind in (Spring, Fast)]
    assert ["the Python of" in model.remark for model in models] == [True, False]
    runs = [pi.solve(model, 0.1, method) for model in models]
    assert all(run.success for run in runs) and "Python" not in runs[1].summary()
    size = np.abs(runs[0].q[-1]).max()
    assert np.abs(runs[0].q[-1] - runs[1].q[-1]).max() < (1e-5 if isinstance(method, pi.IDA) else 1e-8) * size
    assert np.allclose(runs[0].energy.strain[-1], runs[1].energy.strain[-1], rtol=1e-4)


def shorter(z):
    return z[:1]


def infinite(z):
    return z / (z - z)


def raising(z):
    if len(z) > 1:
        raise ValueError("late")
    return z


def outside(z):
    return z * z[len(z)]


@pytest.mark.parametrize("what", [shorter, infinite, raising, outside])
def test_a_compiled_elastic_force_that_fails_ends_the_run_at_its_time(what):
    def elastic(self, z):
        w = z[1] - z[0]
        pull = self.k * (abs(w) - 1.0) * w / abs(w)
        found = np.array([-pull, pull])
        return what(found) if abs(w) > 1.02 else found

    kind = dataclass(frozen=True, eq=False)(type("Failing", (Fast,), {"elastic": elastic}))
    run = pi.solve(hung(kind), 1.0, pi.GeneralizedAlpha(h=1e-3))
    assert not run.success and "spring" in run.message and 0.0 < run.t[-1] < 0.5
