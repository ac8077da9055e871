"""Force elements with first-order states, against closed forms in every integrator."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.linalg import expm

import polyida as pi


@dataclass(frozen=True, eq=False)
class Maxwell(pi.ForceElement):
    """A spring k0 beside a spring k1 in series with a damper: `s' = (e - s)/tau`, e = x - 1 at the point `at`."""

    at: object
    k0: float
    k1: float
    tau: float
    begin: float = 0.05
    name: str | None = None
    states = ("s",)
    dissipates = True

    def sides(self):
        return (self.at,)

    def sizes(self):
        return [0.2]

    def start(self):
        return [self.begin]

    def rates(self, t, x, v, s):
        return np.array([(x[0, 0] - 1.0 - s[0]) / self.tau])

    def forces(self, t, x, v, s):
        e, f = x[0, 0] - 1.0, np.zeros((1, 2))
        f[0, 0] = -self.k0 * e - self.k1 * (e - s[0])
        return f

    def energy(self, x, s):
        e = x[0, 0] - 1.0
        return 0.5 * self.k0 * e**2 + 0.5 * self.k1 * (e - s[0]) ** 2


CompiledMaxwell = pi.compiled(type("CompiledMaxwell", (Maxwell,), {}))
END, START = 2.0, (0.0, 1.0, 0.05)


def on_rail(kind=Maxwell, **changes):
    """A body of 1 kg on a rail, with a Maxwell element."""
    scene = pi.Scene()
    body = scene.add(pi.RigidBody(mass=1.0, inertia=0.1, points={"c": (0.0, 0.0)}, origin=(1.0, 0.0), velocity=(1.0, 0.0), name="body"))
    scene.add(pi.Prismatic(pi.ground.at((0.0, 0.0), direction=(1.0, 0.0)), body.at("c"), name="rail"))
    scene.add(pi.PointMass(body.at("c"), 1e-12, name="c"))
    scene.add(kind(body.at("c"), **{"k0": 4.0, "k1": 9.0, "tau": 0.1, "name": "element"} | changes))
    return scene


def exact(t, tau=0.1, begin=0.05):
    """(e, s) at time t."""
    A = np.array([[0.0, 1.0, 0.0], [-13.0, 0.0, 9.0], [1.0 / tau, 0.0, -1.0 / tau]])
    return (expm(A * t) @ [0.0, 1.0, begin])[[0, 2]]


def errors(run, **changes):
    """Errors of place and state at the end."""
    return np.abs([run.position("c")[-1, 0] - 1.0, run.states("element")[-1, 0]] - exact(END, **changes))


@pytest.mark.parametrize("kind", [Maxwell, CompiledMaxwell])
@pytest.mark.parametrize(
    "integrator, steps, order", [(pi.GeneralizedAlpha, (100, 200), 2.0), (pi.RadauIIA, (10, 20), 5.0), (pi.EnergyMomentum, (100, 200), 2.0)]
)
def test_orders_of_place_and_state(kind, integrator, steps, order):
    model = on_rail(kind).build()
    coarse, fine = (errors(pi.solve(model, END, integrator(h=END / n))) for n in steps)
    assert np.log2(coarse / fine) == pytest.approx([order] * 2, abs=0.15)


@pytest.mark.parametrize("kind", [Maxwell, CompiledMaxwell])
def test_tight_tolerances_meet_the_closed_form(kind):
    model = on_rail(kind).build()
    assert errors(pi.solve(model, END, pi.RadauIIA(rtol=1e-10))).max() < 1e-9
    if kind is CompiledMaxwell:
        assert errors(pi.solve(model, END, pi.IDA(rtol=1e-9))).max() < 1e-7


@pytest.mark.parametrize("begin", [0.0, 0.1])
def test_stiff_states_on_and_off_their_manifold(begin):
    changes = {"tau": 1e-6, "begin": begin}
    model = on_rail(CompiledMaxwell, **changes).build()
    coarse, fine = (errors(pi.solve(model, END, pi.GeneralizedAlpha(h=END / n)), **changes) for n in (400, 800))
    assert coarse[0] < 5e-5 and np.log2(coarse[0] / fine[0]) == pytest.approx(2.0, abs=0.15)
    assert errors(pi.solve(model, END, pi.RadauIIA(rtol=1e-8)), **changes).max() < 1e-8


def test_energy_and_dissipated_work_in_the_energy_momentum_method():
    model = on_rail(CompiledMaxwell).build()
    run = pi.solve(model, 4.0, pi.EnergyMomentum(h=0.01))
    energy, dissipated = run.energy.total, 0.0
    element, x, s = model.parts["element"], run.position("c"), run.states("element")
    for k in range(len(run) - 1):  # in a step the state changes the energy at the mean place
        middle = 0.5 * (x[k] + x[k + 1])[None]
        dissipated += element.energy(middle, s[k]) - element.energy(middle, s[k + 1])
    assert dissipated > 0.1
    assert abs(energy[-1] + dissipated - energy[0]) < 1e-10 * energy[0]


def test_strongly_damped_elements_take_as_many_steps_of_ida_as_with_the_exact_matrix():
    model = on_rail(CompiledMaxwell, tau=1e-4).build()
    fast, exact_matrix = (pi.solve(model, END, pi.IDA(rtol=1e-6, linear=linear)) for linear in ("auto", "kkt"))
    assert fast.counts.steps == pytest.approx(exact_matrix.counts.steps, rel=0.1)


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"states": ("s", "s")}, "different names"),
        ({"states": ("",)}, "states = ('',) must be a tuple of different names"),
        ({"states": (1,)}, "states = (1,) must be a tuple of different names"),
        ({"states": ()}, "rates(), but no states"),
        ({"forces_x": lambda *_: None}, "forces_x() of an element with states is not used"),
        ({"rates": pi.ForceElement.rates}, "no rates"),
        ({"sizes": lambda self: [0.0]}, "1 positive numbers"),
        ({"start": lambda self: [0.0, 1.0]}, "1 finite numbers"),
        ({"rates": lambda self, t, x, v: [0.0]}, "rates: its arguments must be (self, t, x, v, s)"),
        ({"energy": lambda self, x: 0.0}, "energy: its arguments must be (self, x, s)"),
        ({"gap": lambda self, x, s: 1.0}, "gap: its arguments must be (self, x)"),
        ({"start": lambda self, t: [0.0]}, "start: its arguments must be (self)"),
    ],
)
def test_wrong_states_are_refused_by_name(changes, words):
    wrong = type("Wrong", (Maxwell,), changes)
    with pytest.raises(pi.InputError, match="element") as refused:
        on_rail(wrong)
    assert words in str(refused.value)


@pytest.mark.parametrize("rates, words", [(lambda *_: [1.0, 2.0], "shape (1,)"), (lambda *_: [np.nan], "not finite")])
def test_wrong_rates_are_refused_by_name(rates, words):
    model = on_rail(type("Wrong", (Maxwell,), {"rates": rates})).build()
    with pytest.raises(pi.InputError, match="element") as refused:
        pi.solve(model, END, pi.GeneralizedAlpha(h=0.01))
    assert words in str(refused.value)


@pytest.mark.parametrize("integrator", [pi.GeneralizedAlpha(rtol=1e-5), pi.RadauIIA(rtol=1e-6), pi.IDA(rtol=1e-6)])
def test_steps_do_not_depend_on_the_integrals_of_states(integrator):
    model = on_rail(CompiledMaxwell).build()
    start = pi.consistent_state(model)
    far = pi.State(start.t, start.q.copy(), start.v, start.a, start.lam)
    far.q[model.hidden] = 1e3
    one, other = (pi.solve(model, END, integrator, state=state) for state in (start, far))
    assert other.steps == one.steps
    assert other.x == pytest.approx(one.x, abs=1e-6)  # equal bit by bit but for IDA, whose norms round differently


@pytest.mark.parametrize("wrap", [lambda kind: kind, pi.compiled])
def test_a_state_at_rest_stays_where_its_rate_vanishes(wrap):
    def rates(self, t, x, v, s):
        return np.array([v[0, 0] - np.abs(v[0, 0]) / 0.01 * s[0]])

    def forces(self, t, x, v, s):
        return np.array([[-self.k1 * s[0] - self.k0 * (x[0, 0] - 1.0), 0.0]])

    bristle = wrap(type("Bristle", (Maxwell,), {"rates": rates, "forces": forces}))
    rest = pi.static(on_rail(bristle).build())
    assert rest.x == pytest.approx([0.05]) and rest.q[0] == pytest.approx(-9.0 * 0.05 / 4.0)


def test_a_path_of_equilibria_has_the_states():
    def scene(*parts):
        scene = pi.Scene(gravity=(0.0, -10.0))
        bar = scene.add(pi.RigidBody.bar(1.0, 2.0, name="bar"))
        scene.add(pi.Revolute(pi.ground.at((0.0, 0.0)), bar.at("left"), name="pin"))
        scene.add(pi.TorsionSpring(pi.ground.at((0.0, 0.0)), bar.at("left"), stiffness=30.0, name="spring"))
        for part in parts:
            scene.add(part(bar))
        return scene.build()

    relaxed = scene(lambda bar: pi.Maxwell(pi.ground.at((1.0, 1.0)), bar.at("right"), stiffness=50.0, damping=10.0, name="element"))
    path, without = pi.equilibrium_path(relaxed, until=1.0), pi.equilibrium_path(scene(), until=1.0)
    ends = [np.interp(0.5, one.factors, one.q[:, 3]) for one in (path, without)]
    assert ends[0] == pytest.approx(ends[1], abs=1e-3)
    for factor, state in zip(path.factors, path.states):  # relaxed: the damper has the elongation, and the spring alone bears the load
        bar = state.q[2:4] * np.sqrt(relaxed.mass().diagonal()[2])
        assert np.isfinite(bar).all() and state.x.shape == (1,) and abs(state.a).max() == 0.0
        assert relaxed.force(0.0, state.q, state.v)[relaxed.state_columns] == pytest.approx([0.0], abs=1e-9), factor
