"""What a model from sympy can do: derivatives, values, gradients, files, states, functions of time, all integrators."""

import pickle

import numpy as np
import pytest
import sympy as sp
from sympy.physics.mechanics import KanesMethod, Particle, Point, ReferenceFrame, dynamicsymbols

import polyida as pi

t = dynamicsymbols._t
x, y = dynamicsymbols("x y")
m, g, l = sp.symbols("m g l")
L = m * (x.diff(t) ** 2 + y.diff(t) ** 2) / 2 - m * g * y
VALUES = {m: 2.0, g: 9.81, l: 1.0}


def pendulum(**more):
    return pi.symbolic.lagrangian(L, [x, y], phi=[x**2 + y**2 - l**2], **({"values": VALUES, "compiled": False} | more))


def last_x():
    """The square of q[0] in the last frame, as an objective."""

    def slopes(run):
        rows = np.zeros_like(run.q)
        rows[-1, 0] = 2.0 * run.q[-1, 0]
        return {"q": rows}

    return pi.objective.UserObjective(lambda run: float(run.q[-1, 0] ** 2), slopes)


def random_system(seed):
    """A model with random terms: of angles, places, rolling, times."""
    random = np.random.default_rng(seed)
    n = int(random.integers(2, 5))
    q, p = dynamicsymbols(f"q:{n}"), sp.symbols("p:4")
    drive = sp.Function("s")

    def number():
        return sp.Rational(int(random.integers(1, 9)), 4)

    arms = [sum(number() * random.choice([sp.sin, sp.cos])(one) for one in q) + number() * q[0] * p[0] for _ in range(n + 1)]
    moved = arms[0] + (drive(t) if seed % 2 else 0)
    kinetic = sum(number() * one.diff(t) ** 2 for one in (*arms[1:], moved, *q)) * p[1]
    lagrangian = kinetic - p[2] * sum(sp.cos(one - q[0]) + number() * sp.sqrt(1 + one**2) for one in q)
    phi = [q[0] ** 2 + sp.sin(q[1]) - p[3] + (sp.sin(3 * t) if seed % 3 == 0 else 0)]
    psi = [q[1].diff(t) * sp.cos(q[0]) - q[0].diff(t) * sp.sin(q[-1]) * p[0] + t * p[3]] if seed % 2 == 0 else []
    forces = [-p[0] * one.diff(t) * sp.Abs(one.diff(t)) + sp.exp(-q[0]) * sp.sin(2 * t) for one in q]
    values = dict(zip(p, random.uniform(0.5, 2.0, 4))) | ({drive: pi.profile.sine(0.2, 0.4)} if seed % 2 else {})
    return pi.symbolic.lagrangian(lagrangian, q, phi, psi, forces, values=values, compiled=False)


@pytest.mark.parametrize("seed", range(10))
def test_derivatives_of_random_systems(seed):
    errors = pi.check_derivatives(random_system(seed), t=0.3, seed=seed)
    assert max(errors.values()) < 1e-8, errors


@pytest.mark.parametrize("integrator", [pi.GeneralizedAlpha(h=5e-3, tolerance=1e-9), pi.RadauIIA(h=2e-2)], ids=["alpha", "Radau"])
def test_gradients_in_values(integrator):
    """Against runs with other values; the start is on the constraint for all of them, since l is moved with q0 fixed by x0 = l."""
    a = dynamicsymbols("a")
    k = sp.Symbol("lam")  # called like the multipliers
    swing = m * l**2 * a.diff(t) ** 2 / 2 - m * g * l * sp.sin(a) - k * a**2 / 2
    model = pi.symbolic.lagrangian(swing, [a], values=VALUES | {k: 3.0}, compiled=False)
    run = pi.solve(model, 0.4, integrator, q0=[0.3])
    slopes = pi.gradient(run, last_x(), ["m", "l", "g", "lam"])
    for key in (m, l, g, k):
        h, value = 1e-4, model.parameter(key.name)
        ends = [last_x()(pi.solve(model.with_values({key: value + s * h}), 0.4, integrator, q0=[0.3])) for s in (1, -1, 2, -2)]
        difference = (8 * (ends[0] - ends[1]) - (ends[2] - ends[3])) / (12 * h)
        assert abs(slopes[key.name] - difference) < 1e-7 * max(1.0, abs(difference)), key


def test_gradient_in_values_of_a_constraint():
    model = pendulum()
    assert max(pi.check_derivatives(model).values()) < 1e-9
    run = pi.solve(model, 0.3, pi.GeneralizedAlpha(h=5e-3, tolerance=1e-9), q0=[1.0, 0.0])
    checked = pi.check_gradient(run, last_x(), ["m", "g"])
    assert max(checked.values()) < 1e-5, checked
    assert abs(pi.gradient(run, last_x(), ["m"])["m"]) < 1e-9  # the mass does not change the motion


def test_values_change_without_a_new_class():
    model = pendulum()
    other = model.with_values({"l": 2.0, g: 1.62})
    assert type(other) is type(model) is type(pendulum()) and other.source is model.source
    assert (model.parameter("l"), other.parameter("l"), other.parameter("g")) == (1.0, 2.0, 1.62)
    assert model.replaced("m", 7.0).parameter("m") == 7.0
    with pytest.raises(pi.InputError, match="'k'; it has m, g, l"):
        model.with_values({"k": 1.0})


def test_evaluate_knows_all_that_a_run_has():
    model = pendulum()
    run = pi.solve(model, 0.2, pi.RadauIIA(rtol=1e-8), q0=[1.0, 0.0])
    energy = m * (x.diff(t) ** 2 + y.diff(t) ** 2) / 2 + m * g * y
    assert np.abs(model.evaluate(run, energy) - run.energy.total).max() < 1e-12
    balance = model.evaluate(run, [m * x.diff(t, 2) + 2 * x * model.lam[0], m * y.diff(t, 2) + m * g + 2 * y * model.lam[0]])
    assert balance.shape == (len(run), 2) and np.abs(balance).max() < 1e-9
    assert np.array_equal(model.evaluate(run, t), run.t) and np.array_equal(model.evaluate(run, 3), np.full(len(run), 3.0))
    longer = model.with_values({l: 1.5})
    run = pi.solve(longer, 0.1, pi.RadauIIA(rtol=1e-8), q0=[1.5, 0.0])
    assert np.abs(model.evaluate(run, x**2 + y**2 - l**2)).max() < 1e-10  # with the values of the run
    with pytest.raises(pi.InputError, match="k has no value"):
        model.evaluate(run, sp.Symbol("k") * x)
    with pytest.raises(pi.InputError, match="not of this model"):
        pi.symbolic.lagrangian(L, [x, y], values={m: 1.0, g: 1.0}, compiled=False).evaluate(run, x)


def test_pickled_and_loaded(tmp_path):
    model = pendulum()
    again = pickle.loads(pickle.dumps(model.with_values({l: 2.0})))
    assert type(again) is type(model) and again.parameter("l") == 2.0
    pi.solve(model, 0.1, pi.RadauIIA(rtol=1e-6), q0=[1.0, 0.0], out=tmp_path / "run.h5")
    run = pi.load(tmp_path / "run.h5", model=model)
    assert np.abs(model.evaluate(run, sp.sqrt(x**2 + y**2)) - 1.0).max() < 1e-10


def test_states_are_first_order():
    """A motor's current, L i' = u - R i - k w, drives a wheel, J w' = k i: against the exponential."""
    a, i = dynamicsymbols("a i")
    J, k, R, H, u = sp.symbols("J k R H u")
    model = pi.symbolic.lagrangian(
        J * a.diff(t) ** 2 / 2, [a], forces=[k * i], states={i: (u - R * i - k * a.diff(t)) / H},
        values={J: 0.1, k: 0.5, R: 2.0, H: 0.3, u: 1.0}, compiled=False,
    )  # fmt: skip
    run = pi.solve(model, 0.5, pi.RadauIIA(rtol=1e-10), q0=[0.0], x0=[0.2])
    from scipy.linalg import expm

    A = np.array([[0.0, 5.0, 0.0], [-0.5 / 0.3, -2.0 / 0.3, 1.0 / 0.3], [0.0, 0.0, 0.0]])
    exact = expm(0.5 * A) @ [0.0, 0.2, 1.0]
    assert abs(run.v[-1, 0] - exact[0]) < 1e-8 and abs(model.evaluate(run, i)[-1] - exact[1]) < 1e-8


def test_functions_of_time_have_kinks_and_derivatives():
    """A pivot that moves by a profile with kinks: the motion is that of the relative angle, x = f + l sin a."""
    a, f = dynamicsymbols("a f")
    px, py = f + l * sp.sin(a), -l * sp.cos(a)
    moved = m * (px.diff(t) ** 2 + py.diff(t) ** 2) / 2 - m * g * py
    profile = pi.profile.quintic(0.0, 0.3, 0.2, begin=0.05)
    in_angle = pi.symbolic.lagrangian(moved, [a], values=VALUES | {f: profile}, compiled=False)
    assert in_angle.kinks(0.0, 1.0) == (0.05, 0.25)
    held = [(x - f) ** 2 + y**2 - l**2]
    in_places = pi.symbolic.lagrangian(L, [x, y], phi=held, values=VALUES | {f: profile}, compiled=False)
    assert max(pi.check_derivatives(in_places.with_values({f: pi.profile.sine(0.1, 0.5)})).values()) < 1e-8
    runs = [pi.solve(one, 0.4, pi.RadauIIA(rtol=1e-9), q0=q0) for one, q0 in ((in_angle, [0.0]), (in_places, [0.0, -1.0]))]
    assert abs(in_angle.evaluate(runs[0], px)[-1] - runs[1].q[-1, 0]) < 1e-7
    still = in_angle.with_values({f: 0.0})
    assert pi.solve(still, 0.1, pi.GeneralizedAlpha(h=1e-2), q0=[0.0]).q[-1, 0] == 0.0


def test_names_of_all_kinds():
    """Values called like attributes of a model, Greek letters, subscripts, dummies, and one name with two assumptions."""
    keys = [*sp.symbols("n mass phi q0 lam values lambda_1"), sp.Symbol("\\mu_{s}"), sp.Dummy("n"), sp.Symbol("n", positive=True)]
    a = dynamicsymbols("mass")
    model = pi.symbolic.lagrangian(a.diff(t) ** 2 / 2 - sum(keys) * a**2 / 2, [a], values=dict.fromkeys(keys, 1.0), compiled=False)
    assert model.n == 1 and max(pi.check_derivatives(model).values()) < 1e-9
    run = pi.solve(model, 0.3, pi.RadauIIA(h=1e-2), q0=[1.0])
    slopes = pi.gradient(run, last_x(), list(model.parameters))
    assert len(slopes) == len(keys) and np.ptp([slopes[name] for name in model.parameters]) < 1e-12


def test_all_integrators_and_compiled_functions():
    model = pendulum(compiled=True)
    ends = {}
    for one in (pi.GeneralizedAlpha(h=1e-3), pi.RadauIIA(rtol=1e-8), pi.IDA(rtol=1e-8), pi.EnergyMomentum(h=1e-3)):
        run = pi.solve(model, 0.2, one, q0=[1.0, 0.0], every=50)
        ends[type(one).__name__] = run.q[-1, 1]
        assert run.success and np.ptp(run.energy.total) < 1e-4
    assert np.ptp(list(ends.values())) < 1e-5, ends


def test_velocity_rows_are_compiled():
    """A sled's blade, in compiled code and in Python."""
    a = dynamicsymbols("a")
    blade = [y.diff(t) * sp.cos(a) - x.diff(t) * sp.sin(a)]
    made = [
        pi.symbolic.lagrangian(L + a.diff(t) ** 2 / 2, [x, y, a], psi=blade, values={m: 2.0, g: 9.81}, compiled=fast)
        for fast in (True, False)
    ]
    runs = [pi.solve(one, 0.2, pi.GeneralizedAlpha(h=2e-3), q0=[0.0, 0.0, 0.5], v0=[0.0, 0.0, 1.0]) for one in made]
    assert np.abs(runs[0].q - runs[1].q).max() < 1e-10
    assert np.abs(made[0].evaluate(runs[0], blade[0])).max() < 1e-10


def test_dependent_speeds_of_kanes_method_become_rows():
    """A pendulum in places whose second speed sympy has eliminated: its rows are phi alone, since the velocity constraint follows from it."""
    u, w = dynamicsymbols("u w")
    N, P = ReferenceFrame("N"), Point("P")
    P.set_vel(N, u * N.x + w * N.y)
    kane = KanesMethod(
        N, q_ind=[x], u_ind=[u], kd_eqs=[x.diff(t) - u, y.diff(t) - w], q_dependent=[y], configuration_constraints=[x**2 + y**2 - l**2],
        u_dependent=[w], velocity_constraints=[x * u + y * w],
    )  # fmt: skip
    kane.kanes_equations([Particle("bob", P, m)], [(P, -m * g * N.y)])
    model = pi.symbolic.mechanics(kane, values=VALUES, compiled=False)
    assert model.m == 1
    ends = [pi.solve(one, 0.3, pi.RadauIIA(rtol=1e-9), q0=[0.6, 0.8]).q[-1] for one in (model, pendulum())]
    assert np.abs(ends[0] - ends[1]).max() < 1e-8


def test_piecewise_and_signs():
    """Forces with branches: what a branch alone has is computed in the branch."""
    a = dynamicsymbols("a")
    wall = sp.Piecewise((-100 * (a - 1) ** sp.Rational(3, 2), a > 1), (0, True))
    brake = -m * sp.sign(a.diff(t)) * sp.sqrt(sp.Abs(a.diff(t))) + sp.Max(a, 0) * g
    model = pi.symbolic.lagrangian(a.diff(t) ** 2 / 2, [a], forces=[wall + brake], values={m: 0.1, g: -1.0}, compiled=False)
    errors = pi.check_derivatives(model, q=[0.4], v=[0.7]) | pi.check_derivatives(model, q=[1.4], v=[-0.7])
    assert max(errors.values()) < 1e-8, errors


def test_plots_of_expressions():
    import matplotlib.pyplot as plt

    model = pendulum()
    run = pi.solve(model, 0.1, pi.RadauIIA(rtol=1e-6), q0=[1.0, 0.0])
    axes = run.plot.expressions(sp.atan2(y, x), x * y)
    assert len(axes.lines) == 2 and np.array_equal(axes.lines[1].get_ydata(), model.evaluate(run, x * y))
    plt.close(axes.figure)
    with pytest.raises(pi.InputError, match="is no model of polyida.symbolic"):
        pi.solve(pi.problems.get("pendulum").model, 0.01, pi.GeneralizedAlpha(h=1e-2), q0=[1.0, 0.0]).plot.expressions(x)


def test_a_file_builds_a_model_for_the_command_line(tmp_path):
    from polyida.study.ivp import load

    file = tmp_path / "my_equations.py"
    file.write_text(
        """import polyida as pi
from sympy.physics.mechanics import dynamicsymbols

def build():
    a = dynamicsymbols("a")
    t = dynamicsymbols._t
    model = pi.symbolic.lagrangian(a.diff(t) ** 2 / 2 - a**2 / 2, [a], compiled=False)
    return model, {"q0": [1.0], "v0": [0.0], "time": 0.5}
"""
    )
    problem = load(f"{file}:build")
    assert abs(problem.run(pi.RadauIIA(rtol=1e-10)).q[-1, 0] - np.cos(0.5)) < 1e-8
