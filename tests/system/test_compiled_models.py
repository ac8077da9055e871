"""Own models whose functions numba compiles: the same motion as in Python, and the same errors."""

import numpy as np
import pytest

import polyida as pi
from polyida import compiled
from polyida.model.guarded import guard
from polyida.system.own import small_table


def slope_of(angle):
    """A plain function of the module, which a compiled function may call."""
    return np.sin(angle) * twice(0.5)


def twice(x):
    return 2.0 * x


class Slider(pi.Model):
    """A mass in polar coordinates q = (r, angle) with damping, on a curve that moves: all terms of r and phi."""

    n, m = 2, 1
    drag, heavy, table = 0.5, True, np.array([3.0, 4.0])

    def mass(self, q):
        return np.diag(np.array([2.0, 2.0 * q[0] ** 2])) if self.heavy else np.eye(2)

    def force(self, t, q, v):
        along = -2.0 * q[0] * v[1] ** 2 + self.table[0] * q[0] + self.drag * v[0]
        return np.array([along, self.table[1] * q[0] * v[0] * v[1] + slope_of(q[1]) + np.cos(t)])

    def phi(self, t, q):
        return np.array([q[0] - np.exp(0.3 * t) * np.cos(q[1])])

    def phi_q(self, t, q):
        return np.array([[1.0, np.exp(0.3 * t) * np.sin(q[1])]])


class Exact(Slider):
    """The same with its derivatives by hand."""

    def force_q(self, t, q, v):
        return np.array([[-2.0 * v[1] ** 2 + 3.0, 0.0], [4.0 * v[0] * v[1], np.cos(q[1])]])

    def force_v(self, t, q, v):
        return np.array([[0.5, -4.0 * q[0] * v[1]], [4.0 * q[0] * v[1], 4.0 * q[0] * v[0]]])

    def mass_a_q(self, q, a):
        return np.array([[0.0, 0.0], [4.0 * q[0] * a[1], 0.0]])

    def reaction_q(self, t, q, lam):
        return np.array([[0.0, 0.0], [0.0, np.exp(0.3 * t) * np.cos(q[1]) * lam[0]]])

    def phi_t(self, t, q):
        return np.array([-0.3 * np.exp(0.3 * t) * np.cos(q[1])])


class Whole(Slider):
    """The same with r in one function."""

    def residual(self, t, q, v, a, lam):
        pull = np.array([lam[0], lam[0] * np.exp(0.3 * t) * np.sin(q[1])])
        inertia = np.array([2.0 * a[0], 2.0 * q[0] ** 2 * a[1]])
        along = -2.0 * q[0] * v[1] ** 2 + 3.0 * q[0] + 0.5 * v[0]
        return inertia + pull + np.array([along, 4.0 * q[0] * v[0] * v[1] + np.sin(q[1]) + np.cos(t)])


class Free(pi.Model):
    """Two springs without a constraint, in constant M."""

    n, m, needs = 2, 0, pi.Needs(mass_varies=False, velocity_forces=False, driven=False, phi_q_varies=False)

    def mass(self, q):
        return np.array([[2.0, 0.5], [0.5, 1.0]])

    def force(self, t, q, v):
        return np.array([9.0 * q[0] ** 3, 4.0 * q[1] - 1.0])


START = dict(q0=[np.cos(0.4), 0.4])
METHODS = {
    "fixed steps": pi.GeneralizedAlpha(h=2e-3),
    "adaptive steps": pi.GeneralizedAlpha(rtol=1e-6),
    "stabilised": pi.GeneralizedAlpha(h=2e-3, form="stabilised"),
    "extrapolated": pi.GeneralizedAlpha(h=2e-3, extrapolate=True),
    "whole matrix": pi.GeneralizedAlpha(h=2e-3, linear="kkt"),
    "IDA": pi.IDA(rtol=1e-6),
    "IDA, index 1": pi.IDA(rtol=1e-6, form="index1"),
}


def by_numba(kind):
    """The class, its functions compiled."""
    return compiled(type(kind.__name__, (kind,), {}))


@pytest.mark.parametrize(
    "kind, method",
    [(Slider, method) for method in METHODS]
    + [(kind, method) for kind in (Exact, Whole, Free) for method in ("fixed steps", "whole matrix", "IDA, index 1")],
)
def test_the_motion_is_that_of_the_functions_in_python(kind, method):
    start = {"q0": [1.0, 0.5]} if kind is Free else START
    runs = [pi.solve(model(), 0.3, METHODS[method], **start) for model in (kind, by_numba(kind))]
    assert all(run.success for run in runs)
    for name in ("q", "v", "a", "lam"):
        one, other = (getattr(run, name)[-1] for run in runs)
        assert np.abs(one - other).max(initial=0.0) < 1e-6 * max(1.0, np.abs(one).max(initial=0.0)), name
    assert runs[0].counts.steps == runs[1].counts.steps


@pytest.mark.parametrize("kind", [Slider, Exact])
def test_the_step_matrix_is_that_of_the_functions_in_python(kind):
    model, state = guard(by_numba(kind)()), [np.array(x) for x in ([0.8, 0.4], [-0.6, 1.3], [0.9, -0.2], [1.7])]
    table = small_table(model)
    table.make(0.7, *state, 1e4, 1e2)
    exact = Exact().tangent(0.7, *state, 1e4, 1e2, 1.0)
    assert np.abs(table.w.S - exact).max() < 1e-9 * np.abs(exact).max()
    assert np.abs(table.w.S - 1e4 * Exact().mass(state[0])).max() > 1.0, "what the differences add can be seen"


def test_a_run_is_gone_on_with():
    model, method = by_numba(Slider)(), pi.GeneralizedAlpha(h=2e-3)
    whole = pi.solve(model, 0.4, method, **START)
    part = pi.solve(model, 0.4, method, until=lambda t, q, v: t - 0.2, **START)
    rest = pi.solve(model, 0.4, method, state=part.state)
    assert np.abs(rest.q[-1] - whole.q[-1]).max() < 1e-8


class Raises(Free):
    def force(self, t, q, v):
        if t > 0.1:
            raise ValueError("beyond")
        return np.array([9.0 * q[0] ** 3, 4.0 * q[1] - 1.0])


class Grows(Free):
    def force(self, t, q, v):
        return np.array([9.0 * q[0] ** 3, 4.0 * q[1] - 1.0]) if t < 0.1 else np.zeros(3)


class Divides(Free):
    def force(self, t, q, v):
        late = 0.0 if t > 0.1 else 1.0
        return np.array([9.0 * q[0] ** 3, 4.0 * q[1] - 1.0 / late])


@pytest.mark.parametrize("method", [pi.GeneralizedAlpha(h=1e-2), pi.IDA(max_step=1e-2)], ids=["alpha", "IDA"])
@pytest.mark.parametrize("kind, words", [(Raises, "exception"), (Grows, "shape"), (Divides, "not finite")])
def test_a_function_that_fails_ends_the_run_at_its_time(kind, words, method):
    run = pi.solve(by_numba(kind)(), 0.3, method, q0=[1.0, 0.5])
    assert not run.success and words in run.message
    assert 0.08 < run.t[-1] < 0.11 and np.isfinite(run.q).all()


class Complex(Free):
    def mass(self, q):
        return np.eye(2) * 1j


class Number(Free):
    def force(self, t, q, v):
        return 1.0


class Writes(Free):
    def force(self, t, q, v):
        q[0] = 0.0
        return np.zeros(2)


class Unknown(Free):
    def force(self, t, q, v):
        return np.array(eval("[0.0, 1.0]"))


class Asks(Free):
    def pull(self, q):
        return 4.0 * q

    def force(self, t, q, v):
        return self.pull(q)


@pytest.mark.parametrize("kind", [Complex, Number, Writes, Unknown, Asks])
def test_what_cannot_be_compiled_is_refused_before_the_run(kind):
    with pytest.raises(pi.InputError, match=f"{kind.__name__}.(mass|force)"):
        pi.solve(by_numba(kind)(), 0.1, pi.GeneralizedAlpha(h=1e-2), q0=[1.0, 0.5])


class Outside(Free):
    def force(self, t, q, v):
        return np.array([9.0 * q[0] ** 3, 4.0 * q[2 if t > 0.1 else 1] - 1.0])


def test_an_index_out_of_bounds_ends_the_run_and_is_named():
    run = pi.solve(by_numba(Outside)(), 0.3, pi.GeneralizedAlpha(h=1e-2), q0=[1.0, 0.5])
    assert not run.success and "Outside.force raised IndexError" in run.message and 0.08 < run.t[-1] < 0.11


class Interrupts(Free):
    late = False

    def force(self, t, q, v):
        if self.late:
            raise KeyboardInterrupt
        return np.array([9.0 * q[0] ** 3, 4.0 * q[1] - 1.0])


@pytest.mark.parametrize("method", [pi.GeneralizedAlpha(h=1e-2), pi.RadauIIA(h=1e-2)], ids=["alpha", "Radau"])
def test_ctrl_c_in_a_function_in_python_stops_the_run_at_its_step(method):
    model = Interrupts()

    def watch(t, q, v):
        model.late = t > 0.1
        return 1.0

    run = pi.solve(model, 0.3, method, q0=[1.0, 0.5], until=watch)
    assert run.status == "interrupted" and 0.1 < run.t[-1] < 0.3


class Chain(pi.Model):
    """Springs in a row with damping, as many as no dense table takes, the ends on a curve."""

    n, m, needs = 60, 1, pi.Needs(mass_varies=False, driven=False)
    late = 1.0

    def mass(self, q):
        return np.eye(60)

    def force(self, t, q, v):
        g = 3.0 * q**3 + 0.1 * v
        g[1:] += 100.0 * (q[1:] - q[:-1])
        g[:-1] -= 100.0 * (q[1:] - q[:-1])
        if t > self.late:
            raise ValueError("late")
        return g

    def phi(self, t, q):
        return np.array([q[59] - q[0] ** 2])

    def phi_q(self, t, q):
        B = np.zeros((1, 60))
        B[0, 59], B[0, 0] = 1.0, -2.0 * q[0]
        return B


@pytest.mark.parametrize("method", [pi.GeneralizedAlpha(h=1e-3), pi.RadauIIA(h=1e-3), pi.IDA(max_step=1e-3)], ids=["alpha", "Radau", "IDA"])
def test_functions_of_large_models_are_compiled(method):
    """The same motion; a failure names the function and its time."""
    fast, q0 = by_numba(Chain), np.linspace(1.0, 1.0, 60)
    runs = [pi.solve(kind(), 0.01, method, q0=q0) for kind in (Chain, fast)]
    assert all(run.success for run in runs) and np.abs(runs[0].q[-1] - runs[1].q[-1]).max() < 1e-9
    model = fast()
    model.late = 5e-3
    run = pi.solve(model, 0.01, method, q0=q0)
    assert run.status == "exception" and "Chain.force: a compiled function" in run.message and 3e-3 < run.t[-1] < 6e-3


def at_half(t, q, v):
    return q[0] - 0.5


def two_rows(t, q, v):
    return np.array([[q[0], t], [v[0], 1.0]])


def length(t, q, v):
    return np.sqrt(q[0] ** 2 + q[1] ** 2)


def failing(t, q, v):
    if t > 0.1:
        raise ValueError("late")
    return 1.0


def ceasing(t, q, v):
    return 1.0 / (1.0 if t < 0.1 else 0.0) if t < 0.1 else np.nan


RUN = dict(integrator=pi.GeneralizedAlpha(h=1e-3), q0=[1.0, 0.5])


def test_until_and_sensors_are_the_same_compiled():
    runs = []
    for made in (lambda f: f, compiled):
        sensors = {"rows": made(two_rows), "length": made(length)}
        runs.append(pi.solve(Free(), 2.0, until=made(at_half), sensors=sensors, **RUN))
    assert runs[0].status == runs[1].status == "stopped" and runs[0].t[-1] == runs[1].t[-1] > 0.1
    for name in ("rows", "length"):
        assert np.array_equal(runs[0].sensors[name], runs[1].sensors[name])
    assert np.array_equal(runs[0].sensors.t, runs[1].sensors.t) and np.array_equal(runs[0].q, runs[1].q)


@pytest.mark.parametrize("function, error", [(failing, ValueError), (ceasing, pi.InputError)])
@pytest.mark.parametrize("asked", ["until", "sensor"])
def test_a_compiled_until_or_sensor_that_fails_stops_the_run_there(function, error, asked):
    options = {"until": compiled(function)} if asked == "until" else {"sensors": {"odd": compiled(function)}}
    with pytest.raises(error, match=r"late|t = 0\.1") as caught:
        pi.solve(Free(), 0.3, **options, **RUN)
    assert 0.098 < caught.value.trajectory.t[-1] < 0.1011


class Swing(pi.Model):
    """A point on a rod of 1 m that a quartic spring pulls: a constant M, not declared, and phi quadratic in q."""

    n, m, needs = 2, 1, pi.Needs(driven=False)
    stiffness, drag = 30.0, 0.0

    def mass(self, q):
        return np.array([[2.0, 0.0], [0.0, 2.0]])

    def force(self, t, q, v):
        return np.array([self.stiffness * (q[0] + q[0] ** 3), 19.62]) + self.drag * v

    def potential(self, q):
        return self.stiffness * (q[0] ** 2 / 2 + q[0] ** 4 / 4) + 19.62 * q[1]

    def phi(self, t, q):
        return np.array([q @ q - 1.0])

    def phi_q(self, t, q):
        return np.array([[2.0 * q[0], 2.0 * q[1]]])


class Springs(Free):
    """Two quartic springs without a constraint."""

    def force(self, t, q, v):
        return np.array([q[0] + 40.0 * q[0] ** 3, 3.0 * q[1]])

    def potential(self, q):
        return q[0] ** 2 / 2 + 10.0 * q[0] ** 4 + 1.5 * q[1] ** 2


class Carried(Swing):
    """The same, at the end of a rod whose foot moves."""

    needs = pi.Needs(mass_varies=False)

    def phi(self, t, q):
        return np.array([(q[0] - 0.1 * np.sin(t)) ** 2 + q[1] ** 2 - 1.0])

    def phi_q(self, t, q):
        return np.array([[2.0 * (q[0] - 0.1 * np.sin(t)), 2.0 * q[1]]])

    def phi_t(self, t, q):
        return np.array([-0.2 * np.cos(t) * (q[0] - 0.1 * np.sin(t))])


@pytest.mark.parametrize("kind, start", [(Swing, {"q0": [1.0, 0.0]}), (Springs, {"v0": [1.0, -1.0]}), (Carried, {"q0": [1.0, 0.0]})])
def test_energy_momentum_is_the_same_compiled(kind, start):
    """Both by the discrete derivative; they keep their matrices, and energy where nothing drives."""
    fast = compiled(type("Fast", (kind,), {}))()
    runs = [pi.solve(model, 1.0, pi.EnergyMomentum(h=4e-3, tolerance=1e-13), **start) for model in (kind(), fast)]
    assert all(run.success for run in runs), runs[1].message
    for name in ("q", "v", "a", "lam"):
        one, other = (getattr(run, name) for run in runs)
        assert np.abs(one - other).max(initial=0.0) < 1e-8 * max(1.0, np.abs(one).max(initial=0.0)), name
    assert max(run.counts.factorizations for run in runs) < 125
    if not kind.needs.driven:
        assert np.ptp(runs[1].energy.total) < 1e-10 * np.ptp(runs[1].energy.kinetic)


def test_only_the_energy_momentum_method_compiles_the_potential():
    class Odd(Springs):
        def potential(self, q):
            return float(repr(float(Springs.potential(self, q))))  # which numba does not take

    odd = compiled(Odd)()
    assert pi.solve(odd, 0.02, pi.GeneralizedAlpha(h=1e-2)).success
    with pytest.raises(pi.InputError, match=r"Odd\.potential cannot be compiled") as caught:
        pi.solve(odd, 0.02, pi.EnergyMomentum(h=1e-2))
    assert not hasattr(caught.value, "trajectory")  # no run began
