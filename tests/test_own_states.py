"""First-order states of users' models, in Python and compiled, against fine references and closed forms in every integrator."""

import pickle

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import polyida as pi


class Pendulum(pi.Model):
    """A bar on a pivot, (x, y, angle), turned by a motor with the current x[0] under a controller with the integral x[1] of the error."""

    n, m, k = 3, 2, 2
    sizes_x = (1.0, 0.1)
    needs = pi.Needs(mass_varies=False, driven=False)
    parameters = ("R", "I")
    R, L, torque, P, I, D, aim = 1.0, 0.2, 0.5, 8.0, 6.0, 1.0, 0.7  # noqa: E741 the usual letter

    def mass(self, q):
        return np.diag(np.array([1.0, 1.0, 0.1]))

    def force(self, t, q, v, x):
        return np.array([0.0, 9.81, -self.torque * x[0]])

    def rates(self, t, q, v, x):
        error = self.aim - q[2]
        voltage = self.P * error + self.I * x[1] - self.D * v[2]
        return np.array([(voltage - self.R * x[0] - self.torque * v[2]) / self.L, error])

    def phi(self, t, q):
        return np.array([q[0] - 0.5 * np.sin(q[2]), q[1] + 0.5 * np.cos(q[2])])

    def phi_q(self, t, q):
        return np.array([[1.0, 0.0, -0.5 * np.cos(q[2])], [0.0, 1.0, -0.5 * np.sin(q[2])]])


class Maxwell(pi.Model):
    """A mass on a spring beside a spring and a damper in series: `x' = (q - x)/tau`."""

    n, m, k = 1, 0, 1
    x0, sizes_x = (0.05,), (0.2,)
    needs = pi.Needs(mass_varies=False)
    tau = 0.1

    def mass(self, q):
        return np.eye(1)

    def force(self, t, q, v, x):
        return 13.0 * q - 9.0 * x

    def rates(self, t, q, v, x):
        return (q - x) / self.tau

    def potential(self, q):
        return 6.5 * q[0] ** 2


def compiled(model, **changes):
    return pi.compiled(type(f"Compiled{model.__name__}", (model,), changes))


CompiledPendulum, CompiledMaxwell = compiled(Pendulum), compiled(Maxwell)
END, ANGLE = 1.0, 0.3
START = {"q0": [0.5 * np.sin(ANGLE), -0.5 * np.cos(ANGLE), ANGLE], "x0": [0.4, 0.02]}


@pytest.fixture(scope="module")
def reference():
    """Angle, its rate and the states at END."""
    p = Pendulum

    def slope(t, y):
        angle, speed, *x = y
        rates = p.rates(p, t, np.array([0.0, 0.0, angle]), np.array([0.0, 0.0, speed]), x)
        return [speed, (p.torque * x[0] - 9.81 * 0.5 * np.sin(angle)) / 0.35, *rates]

    return solve_ivp(slope, (0.0, END), [ANGLE, 0.0, *START["x0"]], method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]


def errors(run, exact):
    return np.abs(np.array([run.q[-1, run.model.n - 1], run.v[-1, run.model.n - 1], *run.x[-1]]) - exact)


def exact_maxwell(tau=0.1, begin=0.05):
    return expm(np.array([[0.0, 1.0, 0.0], [-13.0, 0.0, 9.0], [1.0 / tau, 0.0, -1.0 / tau]]) * END) @ [0.0, 1.0, begin]


@pytest.mark.parametrize(
    "integrator, steps, order, margin", [(pi.GeneralizedAlpha, (100, 200), 2.0, 0.15), (pi.RadauIIA, (20, 40), 5.0, 0.3)]
)
def test_orders_of_a_pendulum_with_motor_and_controller(integrator, steps, order, margin, reference):
    coarse, fine = (errors(pi.solve(CompiledPendulum(), END, integrator(h=END / n), **START), reference) for n in steps)
    assert np.log2(coarse / fine).min() >= order - margin


@pytest.mark.parametrize(
    "model, integrator, steps, order",
    [
        (CompiledMaxwell, pi.GeneralizedAlpha, (100, 200), 2.0),
        (Maxwell, pi.RadauIIA, (10, 20), 5.0),
        (Maxwell, pi.EnergyMomentum, (100, 200), 2.0),
        (CompiledMaxwell, pi.EnergyMomentum, (100, 200), 2.0),
    ],
)
def test_orders_against_a_closed_form(model, integrator, steps, order):
    coarse, fine = (errors(pi.solve(model(), END, integrator(h=END / n), v0=[1.0]), exact_maxwell()) for n in steps)
    assert np.log2(coarse / fine) == pytest.approx([order] * 3, abs=0.15)


def test_tolerances_of_ida_and_radau(reference):
    loose, tight = (errors(pi.solve(CompiledPendulum(), END, pi.IDA(rtol=rtol), **START), reference) for rtol in (1e-6, 1e-10))
    assert tight.max() < 1e-8 and np.log10(loose.max() / tight.max()) / 4 > 0.8
    assert errors(pi.solve(CompiledPendulum(), END, pi.RadauIIA(rtol=1e-10), **START), reference).max() < 1e-9
    assert errors(pi.solve(Maxwell(), END, pi.IDA(rtol=1e-9), v0=[1.0]), exact_maxwell()).max() < 1e-7


@pytest.mark.parametrize("integrator", [pi.GeneralizedAlpha(h=0.01), pi.RadauIIA(h=0.02), pi.IDA(rtol=1e-6)])
def test_compiled_equals_python(integrator):
    python, machine = (pi.solve(model(), END, integrator, **START) for model in (Pendulum, CompiledPendulum))
    for name in ("q", "v", "lam", "x"):
        assert getattr(machine, name)[-1] == pytest.approx(getattr(python, name)[-1], rel=1e-9, abs=1e-9)


def test_a_large_compiled_model_equals_python():
    class Chain(pi.Model):
        n, m, k = 60, 0, 2
        needs = pi.Needs(mass_varies=False)
        sizes_x = (2.0, 0.5)

        def mass(self, q):
            return np.eye(60)

        def force(self, t, q, v, x):
            f = 100.0 * q
            f[0] -= x[0]
            return f

        def rates(self, t, q, v, x):
            return np.array([1.0 - x[0] - q[0], x[0] - x[1]])

    python, machine = (pi.solve(model(), 0.2, pi.GeneralizedAlpha(h=0.01)) for model in (Chain, compiled(Chain)))
    assert machine.x == pytest.approx(python.x, abs=1e-13) and machine.q == pytest.approx(python.q, abs=1e-13)


@pytest.mark.parametrize("model", [Maxwell, CompiledMaxwell])
def test_stiff_states_keep_the_order(model):
    stiff = model()
    stiff.tau = 1e-6
    runs = (pi.solve(stiff, END, pi.GeneralizedAlpha(h=END / n), v0=[1.0], x0=[0.0]) for n in (100, 200))
    coarse, fine = (errors(run, exact_maxwell(1e-6, 0.0)) for run in runs)
    assert np.log2(coarse / fine) == pytest.approx([2.0] * 3, abs=0.15)


def test_start_values():
    step = pi.GeneralizedAlpha(h=0.01)

    def first(v0=None, **start):
        return pi.solve(Maxwell(), 0.02, step, v0=v0, **start).x[0]

    assert first() == first([0.0]) == [0.05]
    assert first(x0=[0.3]) == first([0.0], x0=[0.3]) == pytest.approx([0.3])
    run = pi.solve(Maxwell(), 0.02, step)
    assert first(run.v[-1]) == run.x[-1]  # a vector with the columns of states
    assert run.q.shape == (3, 2) and run.x.shape == (3, 1)
    again = pi.solve(Maxwell(), 0.04, step, state=run.state)
    assert np.array_equal(again.x[-1], pi.solve(Maxwell(), 0.04, step).x[-1])
    with pytest.raises(pi.InputError, match="x0"):
        first(x0=[0.3, 0.1])
    with pytest.raises(pi.InputError, match="1 finite numbers"):
        first([1.0, 2.0, 3.0])
    with pytest.raises(pi.InputError, match="x0"):
        pi.solve(Maxwell(), 0.04, step, state=run.state, x0=[0.1])


@pytest.mark.parametrize("wrap", [lambda f: f, pi.compiled])
def test_until_and_sensors_get_the_states(wrap):
    def half(t, q, v, x):
        return x[0] - 0.1

    function = wrap(half)
    run = pi.solve(CompiledMaxwell(), END, pi.GeneralizedAlpha(h=0.01), v0=[1.0], until=function, sensors={"x": function})
    assert run.status == "stopped" and run.x[-1] == pytest.approx([0.1], abs=1e-12)
    assert run.sensors["x"][-1] == pytest.approx(0.0, abs=1e-12)
    assert pi.solve(Maxwell(), END, pi.GeneralizedAlpha(h=0.01), until=lambda t, q, v: t - 0.5).t[-1] == pytest.approx(0.5)


def test_energy_leaves_the_states_out():
    run = pi.solve(Maxwell(), END, pi.GeneralizedAlpha(h=0.01), v0=[1.0])
    assert run.energy.kinetic[0] == pytest.approx(0.5)


def test_a_run_in_a_file_is_resumed(tmp_path):
    path, step = tmp_path / "run.h5", pi.GeneralizedAlpha(h=0.01)
    pi.solve(CompiledPendulum(), 0.5, step, out=path, **START)
    whole = pi.solve(CompiledPendulum(), END, step, **START)
    assert np.array_equal(pi.resume(path, END, model=CompiledPendulum()).x, whole.x)


@pytest.mark.parametrize(
    "reset",
    [
        lambda s: pi.consistent_state(CompiledPendulum(), s.t, s.q, s.v, x0=[0.1, s.x[1]]),
        lambda s: pi.State(s.t, s.q, np.append(s.v, [0.1 / 1.0, s.x[1] / 0.1]), s.a, s.lam),
    ],
)
def test_an_event_resets_states(reset):
    event = pi.Event(when=lambda s: s.t - 0.05, then=reset)
    run = pi.solve(CompiledPendulum(), 0.1, pi.RadauIIA(rtol=1e-9), events=event, **START)
    k = run.events[0].frame
    assert run.x[k] == pytest.approx([0.1, run.x[k - 1, 1]]) and abs(run.x[k - 1, 0] - 0.1) > 0.1
    assert run.q[k, :3] == pytest.approx(run.q[k - 1, :3], abs=1e-9) and run.v[k, :3] == pytest.approx(run.v[k - 1, :3], abs=1e-7)


def test_a_run_in_a_file_is_loaded_with_its_model(tmp_path):
    run, path = pi.solve(Pendulum(), 0.1, pi.GeneralizedAlpha(h=0.01), **START), tmp_path / "run.h5"
    run.save(path)
    with pytest.raises(pi.InputError, match=r"x: .* Give its model: polyida.load\(path, model=...\)"):
        pi.load(path).x  # noqa: B018 it raises
    loaded = pi.load(path, model=Pendulum())
    for name in ("x", "drift", "velocity_drift"):
        assert np.array_equal(getattr(loaded, name), getattr(run, name))
    assert np.array_equal(loaded.states(), run.states()) and np.array_equal(loaded.energy.kinetic, run.energy.kinetic)
    assert loaded.to_dataframe().equals(run.to_dataframe())
    assert np.array_equal(pi.solve(loaded.model, 0.2, pi.GeneralizedAlpha(h=0.01), state=loaded.state).q[0], run.q[-1])
    with pytest.raises(pi.InputError, match=r"5 coordinates and 2 multipliers; the model has n \+ k = 1 \+ 1 and m = 0"):
        pi.load(path, model=Maxwell())
    with pytest.raises(pi.InputError, match="load: the model is int"):
        pi.load(path, model=3)


@pytest.mark.parametrize("integrator", [pi.GeneralizedAlpha(h=0.02), pi.RadauIIA(h=0.05)])
def test_gradient_in_parameters_of_rates(integrator):
    def last(model):
        return pi.solve(model, END, integrator, **START)

    def slopes(run):
        slope = np.zeros(run.q.shape)
        slope[-1, 2] = 1.0
        return {"q": slope}

    found = pi.gradient(last(Pendulum()), pi.objective.UserObjective(lambda run: run.q[-1, 2], slopes))
    for name, value in (("R", 1.0), ("I", 6.0)):
        up, down = (last(Pendulum().replaced(name, value + s)).q[-1, 2] for s in (1e-4, -1e-4))
        assert found[name] == pytest.approx((up - down) / 2e-4, rel=1e-5)


def test_derivatives():
    assert max(pi.check_derivatives(Pendulum(), q=START["q0"]).values()) < 1e-9


@pytest.mark.parametrize("make", [lambda **c: type("Loaded", (Maxwell,), c), lambda **c: compiled(Maxwell, **c)])
def test_statics(make):
    rest = pi.static(make(force=lambda self, t, q, v, x: 13.0 * q - 9.0 * x - 3.0)())
    assert rest.q[0] == pytest.approx(0.75) and rest.x == pytest.approx([0.75])  # x = q, so that 4 q = 3


def test_tables_have_the_states():
    run = pi.solve(Valve(), 0.1, pi.GeneralizedAlpha(h=0.01))
    frame, data = run.to_dataframe(), run.to_xarray()
    assert list(frame.columns) == ["t", "q[0]", "v[0]", "x[0]", "x[1]", "x[2]"]
    assert np.array_equal(frame[["x[0]", "x[1]", "x[2]"]], run.states()) and np.array_equal(data.x, run.states())


def written(**changes):
    return [model(**changes) for model in (lambda **c: type("Tank", (Maxwell,), c), lambda **c: compiled(Maxwell, **c))]


def stiffness(self, t, q, v):
    return np.eye(1)


def long(self, t, q, v, x):
    return np.array([1.0, 2.0])


def plain(self, t, q, v):
    return 1.0 * q


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"rates": long}, "rates must return an array of shape (1,)"),
        ({"force": plain}, "force must take the states as its last argument"),
        ({"force_q": stiffness}, "cannot have force_q"),
        ({"k": 0}, "k = 0"),
        ({"x0": [1.0, 2.0]}, "x0 = [1.0, 2.0] must be 1 finite numbers"),
        ({"x0": [np.nan]}, "finite"),
        ({"sizes_x": [0.0]}, "positive"),
    ],
)
def test_wrong_models_are_refused_by_name(changes, words):
    for model in written(**changes):
        with pytest.raises(pi.InputError, match=model.__name__) as refused, np.errstate(all="ignore"):
            pi.solve(model(), END, pi.GeneralizedAlpha(h=0.01))
        assert words in str(refused.value)


def test_rates_that_numba_does_not_compile_are_named():
    def rates(self, t, q, v, x):
        return np.array([str(x[0])[0]] and [0.0 if {} else 1.0], object)

    with pytest.raises(pi.InputError, match="rates"):
        pi.solve(compiled(Maxwell, rates=rates)(), END, pi.GeneralizedAlpha(h=0.01))


def test_a_run_stops_where_rates_fail():
    def rates(self, t, q, v, x):
        return np.array([np.sqrt(0.5 - t)])

    for model in written(rates=rates):
        with np.errstate(all="ignore"):
            run = pi.solve(model(), END, pi.GeneralizedAlpha(h=0.01))
            with pytest.raises(pi.InputError, match=f"{model.__name__}.*rates gave numbers that are not finite"):
                pi.solve(model(), END, pi.GeneralizedAlpha(h=0.01), t0=0.6)
        assert run.status == "not finite" and f"{model.__name__}.rates" in run.message


def test_a_state_has_the_states():
    class Euler(pi.Integrator):
        """Explicit, with steps of 0.01 s; keeps the states that it reads."""

        def steps(self, model, state, t_end, counts):
            self.seen = [state.x]
            while state.t < t_end - 1e-9:
                a, lam = model.mass_system(state.t, state.q).solve(model.force(state.t, state.q, state.v), np.zeros(0))
                state = pi.State(state.t + 0.01, state.q + 0.01 * state.v, state.v + 0.01 * a, a, lam)
                counts.steps += 1
                yield state

    euler = Euler()
    run = pi.solve(Maxwell(), 0.1, euler, v0=[1.0], sensors={"x": pi.sensor.state(lambda state: state.x)})
    assert euler.seen == pytest.approx([0.05]) and run.x[1] == pytest.approx([0.045])
    assert pi.consistent_state(Maxwell(), x0=[0.3]).x == pytest.approx([0.3])
    assert np.array_equal(run.sensors["x"], run.x) and np.array_equal(run.state.x, run.x[-1])
    assert pickle.loads(pickle.dumps(run.state)).x == run.state.x


class Valve(pi.Model):
    """A piston pushed by a lag x[0] and a pressure x[1], `c p + p |p| = 1 - v + x[0]`; the lag follows w = x[2], `w = p - q`."""

    n, m, k, algebraic = 1, 0, 1, 2
    x0 = (0.1, 0.0, 0.0)
    needs = pi.Needs(mass_varies=False)
    c = 0.3

    def mass(self, q):
        return np.eye(1)

    def rates(self, t, q, v, x):
        return np.array([(x[2] - x[0]) / 0.05, self.c * x[1] + x[1] * abs(x[1]) - 1.0 + v[0] - x[0], x[1] - x[2] - q[0]])

    def force(self, t, q, v, x):
        return 4.0 * q - x[1]


class ByHand(Valve):
    """The same with the root of the quadratic equation."""

    algebraic, x0 = 0, (0.1,)

    def pressure(self, v, x):
        b = 1.0 - v[0] + x[0]
        return np.sign(b) * (np.sqrt(0.25 * self.c**2 + abs(b)) - 0.5 * self.c)

    def rates(self, t, q, v, x):
        return np.array([(self.pressure(v, x) - q[0] - x[0]) / 0.05])

    def force(self, t, q, v, x):
        return 4.0 * q - self.pressure(v, x)


@pytest.mark.parametrize("kind", [Valve, compiled(Valve)])
@pytest.mark.parametrize("integrator", [pi.GeneralizedAlpha(h=0.01, tolerance=1e-11), pi.RadauIIA(h=0.02, tolerance=1e-12)])
def test_algebraic_states_are_those_eliminated_by_hand(kind, integrator):
    run, exact = pi.solve(kind(), 0.5, integrator), pi.solve(ByHand(), 0.5, integrator)
    assert run.success and run.v[-1] == pytest.approx(exact.v[-1], abs=1e-9)
    x, p, w = run.states().T
    assert np.array_equal(run.x[:, 0], x) and run.x.shape[1] == 1
    assert np.abs(0.3 * p + p * np.abs(p) - 1.0 + run.v[:, 0] - x).max() < 1e-12 and np.abs(p - w - run.q[:, 0]).max() < 1e-12


def test_algebraic_states_of_a_rising_function_are_found_at_any_state():
    """`x^3 + x = 4 q` from x0 = 1, some of whose corrections are longer than x0."""

    class Cubic(pi.Model):
        n, m, algebraic, x0 = 1, 0, 1, (1.0,)

        def mass(self, q):
            return np.eye(1)

        def rates(self, t, q, v, x):
            return x**3 + x - 4.0 * q

        def force(self, t, q, v, x):
            return x

    x = np.linspace(-3.0, 3.0, 121)
    assert np.allclose([pi.consistent_state(Cubic(), q0=[0.25 * (one**3 + one)]).a[0] for one in x], -x, rtol=0.0, atol=1e-12)
    near = np.linspace(-1.00001, -0.9995, 11)
    assert np.allclose([-(a**3) - a - 4.0 * q for q in near for a in pi.consistent_state(Cubic(), q0=[q]).a], 0.0, atol=1e-11)


def test_algebraic_states_with_a_singular_slope_are_refused():
    class Flat(Valve):
        def rates(self, t, q, v, x):
            return np.array([x[2] - x[0], x[1] - x[2], 2.0 * (x[1] - x[2]) - q[0]])

    with pytest.raises(pi.InputError, match="algebraic states of Flat have no solution: their slope d rates/ds is singular"):
        pi.solve(Flat(), 0.1, pi.GeneralizedAlpha(h=0.01))


def test_algebraic_states_alone():
    class Resistor(Valve):
        k, algebraic, x0 = 0, 1, (0.0,)

        def rates(self, t, q, v, x):
            return x - 1.0 + 2.0 * v

        def force(self, t, q, v, x):
            return -x

    run = pi.solve(Resistor(), 0.5, pi.RadauIIA(rtol=1e-9))
    assert run.v[-1, 0] == pytest.approx(0.5 * (1.0 - np.exp(-1.0)), abs=1e-8) and run.x.shape == (len(run), 0)
    assert run.states()[-1, 0] == pytest.approx(np.exp(-1.0), abs=1e-8)
