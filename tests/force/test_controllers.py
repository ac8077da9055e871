"""Sampled controllers: zero-order hold in every integrator, orders behind jumps of the outputs, resumed runs."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.linalg import expm

import polyida as pi

PERIOD, KP, KD, LAG = 0.05, 20.0, 3.0, 0.02


@dataclass(frozen=True, eq=False)
class SampledPD(pi.Controller):
    """Force along x at a point, N: `-kp (x - goal) - kd x'`, held between samples."""

    at: object
    goal: float = 1.3
    period: float = PERIOD
    name: str | None = None

    def sides(self):
        return (self.at,)

    def sample(self, t, x, v, s, u):
        return np.array([-KP * (x[0, 0] - self.goal) - KD * v[0, 0]])

    def forces(self, t, x, v, s, u):
        f = np.zeros((1, 2))
        f[0, 0] = u[0]
        return f


@dataclass(frozen=True, eq=False)
class LaggedPD(SampledPD):
    """The same through a lag: the output acts on the rate of a state only."""

    states = ("force",)

    def rates(self, t, x, v, s, u):
        return np.array([(u[0] - s[0]) / LAG])

    def forces(self, t, x, v, s, u):
        f = np.zeros((1, 2))
        f[0, 0] = s[0]
        return f


CompiledPD, CompiledLaggedPD = (pi.compiled(type(f"Compiled{kind.__name__}", (kind,), {})) for kind in (SampledPD, LaggedPD))


def cart(kind, speed=1.0):
    """A body of 1 kg on a rail that moves at a speed, m/s, and is to stop at 1.3 m."""
    scene = pi.Scene()
    body = scene.add(pi.RigidBody(mass=1.0, inertia=0.1, points={"c": (0.0, 0.0)}, origin=(1.0, 0.0), velocity=(speed, 0.0), name="body"))
    scene.add(pi.Prismatic(pi.ground.at((0.0, 0.0), direction=(1.0, 0.0)), body.at("c"), name="rail"))
    scene.add(pi.PointMass(body.at("c"), 1e-12, name="c"))
    scene.add(kind(body.at("c"), name="control"))
    return scene.build()


def exact(end, lagged, v=1.0):
    """Place of the cart at the end, m."""
    x, force = 0.0, 0.0
    for _ in range(round(end / PERIOD)):
        u = -KP * (x - 0.3) - KD * v
        if lagged:
            A = np.array([[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, -1.0 / LAG, 1.0 / LAG], np.zeros(4)])
            x, v, force, _ = expm(A * PERIOD) @ [x, v, force, u]
        else:
            x, v = x + PERIOD * v + PERIOD**2 / 2 * u, v + PERIOD * u
    return 1.0 + x


METHODS = [pi.GeneralizedAlpha(h=0.01), pi.RadauIIA(rtol=1e-8), pi.IDA(rtol=1e-7), pi.EnergyMomentum(h=0.01)]


@pytest.mark.parametrize("integrator, kind", [*((one, CompiledPD) for one in METHODS), (METHODS[0], SampledPD), (METHODS[1], SampledPD)])
def test_forces_that_jump(kind, integrator):
    run = pi.solve(cart(kind), 1.0, integrator)
    assert run.position("c")[-1, 0] == pytest.approx(exact(1.0, False), abs=1e-9)  # the motion is quadratic between samples
    assert set(np.round(np.arange(1, 20) * PERIOD, 12)) <= set(np.round(run.t, 12))


@pytest.mark.parametrize("integrator", [*METHODS, pi.GeneralizedAlpha(rtol=1e-5)])
def test_a_controller_sets_in_motion_what_is_at_rest(integrator):
    assert pi.solve(cart(CompiledPD, 0.0), 1.0, integrator).position("c")[-1, 0] == pytest.approx(exact(1.0, False, 0.0), abs=1e-9)


@pytest.mark.parametrize("kind", [LaggedPD, CompiledLaggedPD])
def test_outputs_that_act_on_rates(kind):
    model, right = cart(kind), exact(1.0, True)
    for method in (pi.GeneralizedAlpha, pi.EnergyMomentum)[: 1 if kind is LaggedPD else 2]:
        coarse, fine = (abs(pi.solve(model, 1.0, method(h=h)).position("c")[-1, 0] - right) for h in (0.01, 0.005))
        assert np.log2(coarse / fine) == pytest.approx(2.0, abs=0.15)
    for integrator in METHODS[1 : 2 if kind is LaggedPD else 3]:
        assert pi.solve(model, 1.0, integrator).position("c")[-1, 0] == pytest.approx(right, abs=1e-7)
    states = pi.solve(model, 0.1, METHODS[1]).states("control")
    assert states.shape[1] == 2 and states[0, 1] == 0.0 and states[1, 1] == pytest.approx(KP * 0.3 - KD)


@pi.compiled
@dataclass(frozen=True, eq=False)
class SampledTorque(pi.Controller):
    """A torque on a direction, N m, that brakes its rotation."""

    at: object
    period: float = 0.1
    name: str | None = None

    def sides(self):
        return (self.at.d,)

    def sample(self, t, x, v, s, u):
        return np.array([-2.0 * (x[0, 0] * v[0, 1] - x[0, 1] * v[0, 0])])

    def forces(self, t, x, v, s, u):
        f = np.zeros((1, 2))
        size = x[0, 0] ** 2 + x[0, 1] ** 2
        f[0, 0], f[0, 1] = -u[0] * x[0, 1] / size, u[0] * x[0, 0] / size
        return f


def pendulum():
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = scene.add(pi.RigidBody.bar(1.0, 2.0, name="bar"))
    scene.add(pi.Revolute(pi.ground.at((0.0, 0.0)), bar.at("left"), name="pin"))
    scene.add(pi.PointMass(bar.at("right"), 0.1, name="tip"))
    scene.add(SampledTorque(bar.at("right"), name="brake"))
    return scene.build()


def test_generalized_alpha_is_of_order_two_in_places_and_multipliers_through_jumps():
    model, end = pendulum(), 0.95
    reference = pi.solve(model, end, pi.RadauIIA(rtol=1e-11))
    errors = []
    for n in (190, 380, 760):
        run = pi.solve(model, end, pi.GeneralizedAlpha(h=end / n))
        errors.append([abs(run.position("tip")[-1] - reference.position("tip")[-1]).max(), abs(run.lam[-1] - reference.lam[-1]).max()])
    orders = np.log2(np.array(errors)[:-1] / np.array(errors)[1:])
    assert orders == pytest.approx(np.full((2, 2), 2.0), abs=0.2)


@pytest.mark.parametrize("integrator", [pi.GeneralizedAlpha(h=0.01), pi.RadauIIA(h=0.02), pi.EnergyMomentum(h=0.01)])
def test_a_run_that_goes_on_is_the_same_to_the_last_bit(integrator):
    model = pendulum()
    whole = pi.solve(model, 0.8, integrator)
    first = pi.solve(model, 0.4, integrator)
    for _ in range(2):  # the state is not changed
        rest = pi.solve(model, 0.8, integrator, state=first.state)
        assert np.array_equal(rest.q[-1], whole.q[-1])


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"period": 0.0}, "period = 0.0"),
        ({"sample": pi.Controller.sample}, "gives no sample"),
        ({"sample": lambda self, t, x, v: [0.0]}, "sample: its arguments must be (self, t, x, v, s, u)"),
        ({"outputs": ()}, "outputs = ()"),
        ({"outputs": ("",)}, "outputs = ('',)"),
        ({"outputs": (1,)}, "outputs = (1,)"),
    ],
)
def test_wrong_controllers_are_refused_by_name(changes, words):
    wrong = dataclass(frozen=True, eq=False)(
        type("Wrong", (SampledPD,), changes | {"__annotations__": {"period": float}} if "period" in changes else changes)
    )
    with pytest.raises(pi.InputError, match="control") as refused:
        cart(wrong)
    assert words in str(refused.value)


def test_wrong_outputs_are_refused_by_name():
    model = cart(type("Wrong", (SampledPD,), {"sample": lambda *_: np.array([1.0, 2.0])}))
    with pytest.raises(pi.InputError, match=r"control: sample must return real numbers of shape \(1,\)"):
        pi.solve(model, 1.0, pi.GeneralizedAlpha(h=0.01))


@pytest.mark.parametrize("integrator", METHODS, ids=lambda one: type(one).__name__)
def test_a_run_stops_at_a_sample_that_is_not_finite(integrator):
    model = cart(type("Wrong", (SampledPD,), {"sample": lambda self, t, *_: np.array([np.nan if t > 0.12 else 0.0])}))
    run = pi.solve(model, 1.0, integrator)
    assert run.status == "not finite" and run.message.startswith("sample of 'control' gave numbers that are not finite")
    assert run.message.count("at t = 0.15 s") == 1 and run.t[-1] == pytest.approx(0.15)


@pytest.mark.parametrize(
    "integrator",
    [*METHODS, pi.GeneralizedAlpha(h=0.01, form="stabilised"), pi.NonsmoothAlpha(h=0.01), pi.MoreauJean(h=0.01)],
    ids=lambda one: type(one).__name__,
)
def test_each_sample_is_taken_once(integrator):
    times = []

    def count(self, t, x, v, s, u):
        times.append(t)
        return u + 1.0

    run = pi.solve(cart(type("Counter", (SampledPD,), {"sample": count, "forces": lambda self, *_: np.zeros((1, 2))})), 0.22, integrator)
    assert times == pytest.approx(PERIOD * np.arange(5))
    before = np.ceil(np.round(run.t / PERIOD, 9))  # at the time of a sample the outputs before it
    assert run.states("control")[:, 0] == pytest.approx(before, abs=1e-12)


def test_an_own_integrator_must_say_that_it_takes_samples():
    class Own(pi.Integrator):
        def steps(self, model, state, t_end, counts):
            yield from pi.GeneralizedAlpha(h=0.01).steps(model, state, t_end, counts)

    own = Own()
    with pytest.raises(pi.InputError, match="Own takes no samples of the controllers 'control'; .* takes_samples = True"):
        pi.solve(cart(SampledPD), 0.1, own)
    own.takes_samples = True
    assert pi.solve(cart(SampledPD), 0.1, own).success


def test_a_period_that_times_do_not_resolve_is_refused():
    model = cart(lambda at, name: SampledPD(at, period=1e-13, name=name))
    with pytest.raises(pi.InputError, match="control: period = 1e-13 s must be above 2e-12 s in a run to t_end = 1 s"):
        pi.solve(model, 1.0, pi.RadauIIA(h=0.1))
    short = cart(lambda at, name: SampledPD(at, period=1e-9, name=name))
    assert next(iter(short.samples(0.0, 1e6))) == 1e-9  # one by one: all of them would fill the memory


def test_gradients_refuse_outputs_that_are_held_all_the_time():
    run = pi.solve(cart(lambda at, name: SampledPD(at, period=10.0, name=name)), 0.1, pi.GeneralizedAlpha(h=0.01))
    with pytest.raises(pi.InputError, match="sampled Controller"):
        pi.gradient(run, pi.objective.Deviation("c", lambda t: (1.0, 0.0)))


def test_a_yielded_state_keeps_its_memory():
    model, before, compared = pendulum(), None, 0
    for state in pi.EnergyMomentum(h=0.01).steps(model, pi.consistent_state(model), 0.35, pi.Counts()):
        if before is not None and before[1] is not None:
            assert np.array_equal(before[0].memory["v_free"], before[1])
            compared += 1
        free = state.memory.get("v_free")
        before = state, None if free is None else free.copy()
    assert compared
