"""Parameters of models of one's own: attributes that they name, slopes by hand or by differences."""

from dataclasses import dataclass

import numpy as np
import pytest

import polyida as pi
from polyida.adjoint.parameter import AdjointMultipliers, total
from polyida.adjoint.parameters import in_time, parameters_of
from polyida.model.differences import along
from polyida.model.guarded import guard
from polyida.problems.andrews import Q0, Andrews
from polyida.problems.equations import CarAxis, Pendulum

BY_DIFFERENCES = {name: getattr(pi.Model, name) for name in ("residual_p", "phi_p")}
MODELS = [Pendulum(), CarAxis(), Andrews(), pi.compiled(type("CompiledPendulum", (Pendulum,), BY_DIFFERENCES))()]


def work_of(model, t=(0.1, 0.3)):
    random, frames = np.random.default_rng(1), len(t)
    q = (Q0 if model.n == 7 else 1.0) + 0.1 * random.standard_normal((frames, model.n))
    v, a, w = random.standard_normal((3, frames, model.n))
    return AdjointMultipliers(
        np.array(t), q, v, a, *(random.standard_normal((frames, m)) for m in (model.m, model.n, model.m, model.m, model.m))
    )


@pytest.mark.parametrize("model", MODELS, ids=lambda model: type(model).__name__)
@pytest.mark.parametrize("guarded", [False, True])
def test_slopes_are_those_of_the_models(model, guarded):
    model = guard(model) if guarded else model
    work, known = work_of(model), parameters_of(model)
    assert tuple(known) == model.parameters and known
    for parameter in known.values():
        value, slope = np.asarray(parameter.value), parameter.slope(work)
        assert np.shape(slope) == value.shape
        for unit in np.eye(value.size).reshape(value.size, *value.shape):
            changed = lambda s, unit=unit, value=value, p=parameter: total(p.replaced(value * (1 + s * unit)), work)  # noqa: E731
            assert np.isclose(along(changed), (slope * unit * value).sum(), rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("problem, t_end, h", [("andrews", 1e-3, 1e-4), ("car-axis", 0.1, 1e-2)])
@pytest.mark.parametrize("form", ["index3", "stabilised"])
def test_gradients_of_runs_of_the_test_set(problem, t_end, h, form):
    given = pi.problems.get(problem)
    run = pi.solve(given.model, t_end, pi.GeneralizedAlpha(h=h, tolerance=1e-12, form=form), q0=given.q0, v0=given.v0)
    later = (np.arange(len(run)) > 0)[:, None]
    squares = pi.objective.UserObjective(
        lambda run: float((run.q[1:] ** 2).sum() + 1e-3 * (run.lam[1:] ** 2).sum()),
        lambda run: {"q": 2.0 * later * run.q, "lam": 2e-3 * later * run.lam},
    )
    errors = pi.check_gradient(run, squares)
    assert {*given.model.parameters} <= {*errors} and max(errors.values()) < 1e-6


def test_slopes_by_hand_are_checked():
    assert {"residual_p length", "phi_p length"} <= {*pi.check_derivatives(Pendulum())}
    assert max(pi.check_derivatives(Pendulum()).values()) < 1e-8

    class Wrong(Pendulum):
        def residual_p(self, name, *state):
            return 2.0 * super().residual_p(name, *state)

    assert pi.check_derivatives(Wrong())["residual_p weight"] > 0.4


@dataclass(frozen=True)
class Pulled(pi.Model):
    """A point that is pulled by what its class makes of its fields, from a time on."""

    pull: tuple = (1.0, 2.0)
    begin: float = 0.4
    n, m = 2, 0
    parameters = "pull", "begin"

    def __post_init__(self):
        object.__setattr__(self, "given", 3.0 * np.asarray(self.pull))

    def mass(self, q):
        return np.eye(2)

    def force(self, t, q, v):
        return -self.given * max(0.0, t - self.begin)

    def kinks(self, t0, t1):
        return tuple(t for t in (self.begin,) if t0 < t < t1)

    def initial_velocity(self, t, q):
        return 0.5 * self.given


def test_a_dataclass_is_made_anew():
    model, zero = Pulled(), np.zeros((1, 2))
    work = AdjointMultipliers(np.array([1.0]), zero, zero, zero, np.zeros((1, 0)), np.array([[1.0, 10.0]]))
    known = parameters_of(model)
    assert np.allclose(known["pull"].slope(work), [-1.8, -18.0], rtol=1e-10)
    assert known["begin"].slope(work) == pytest.approx(63.0, rel=1e-10)
    assert in_time(model, work) == pytest.approx([-63.0], rel=1e-9)
    assert np.allclose(known["pull"].start(0.0, zero[0], np.array([1.0, 4.0])), [1.5, 6.0], rtol=1e-10)
    assert known["begin"].start(0.0, zero[0], np.ones(2)) is None
    assert known["begin"].kinks(0.0, 1.0) == pytest.approx({0.4: 1.0}) and not known["pull"].kinks(0.0, 1.0)


@pytest.mark.parametrize("given", ["nothing", np.ones(3), np.nan])
def test_a_wrong_slope_is_named(given):
    wrong = type("Wrong", (Pendulum,), {"residual_p": lambda self, *_: given})
    with pytest.raises(pi.InputError, match=r"Wrong.residual_p\('length'\) must return finite numbers of shape \(2,\)"):
        guard(wrong()).residual_p("length", 0.0, *np.zeros((3, 2)), np.zeros(1))


class Pushed(pi.Model):
    """A free mass that a force pushes from the time `when` on: `a = 3 (t - when)`, and so `q(1) = (1 - when)^3 / 2`."""

    n, m = 1, 0
    needs = pi.Needs(mass_varies=False, velocity_forces=False, driven=False, phi_q_varies=False)
    parameters = ("when",)
    when = 0.37

    def mass(self, q):
        return np.eye(1)

    def force(self, t, q, v):
        return np.array([-3.0 * max(0.0, t - self.when)])

    def kinks(self, t0, t1):
        return (self.when,) if t0 < self.when < t1 else ()


@pytest.mark.parametrize("integrator", [pi.GeneralizedAlpha(5e-3, tolerance=1e-10), pi.RadauIIA(h=0.05)])
def test_differences_stay_on_one_side_of_a_kink_that_moves(integrator):
    run = pi.solve(Pushed(), 1.0, integrator)
    end = pi.objective.UserObjective(lambda run: float(run.q[-1, 0]), lambda run: {"q": np.eye(len(run))[-1][:, None]})
    found = pi.gradient(run, end)
    assert found["when"] == pytest.approx(-1.5 * (1.0 - 0.37) ** 2, rel=1e-4)
    assert pi.check_gradient(run, end)["when"] < 1e-6


class Jump(Pendulum):
    """A pendulum that a wind blows at from a time on: its force jumps at a kink that moves with a parameter."""

    parameters = "weight", "begin"
    begin = 0.1012

    def force(self, t, q, v):
        return super().force(t, q, v) - (np.array([5.0, 0.0]) if t > self.begin else 0.0)

    def kinks(self, t0, t1):
        return tuple(t for t in (self.begin, 0.102) if t0 < t < t1)

    residual_p = pi.Model.residual_p


@pytest.mark.parametrize("integrator", [pi.GeneralizedAlpha(h=5e-3, tolerance=1e-11), pi.RadauIIA(h=2e-2)])
def test_a_force_may_jump_where_a_parameter_says(integrator):
    run = pi.solve(Jump(), 0.2, integrator, q0=[0.0, -1.0])
    path = pi.objective.UserObjective(lambda run: float((run.q**3).sum()), lambda run: {"q": 3 * run.q**2})
    assert max(pi.check_gradient(run, path).values()) < 1e-7
