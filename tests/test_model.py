"""The seam: default derivatives of a model, and the check of exact ones."""

import numpy as np
import pytest

import polyida as pi
from polyida.model.check import require_declared
from polyida.model.guarded import guard


class Slider(pi.Model):
    """A mass in polar coordinates q = (r, angle) with damping, on a curve that moves: all terms of r and phi."""

    n, m = 2, 1

    def mass(self, q):
        return np.diag([2.0, 2.0 * q[0] ** 2])

    def force(self, t, q, v):
        return np.array([-2.0 * q[0] * v[1] ** 2 + 3.0 * q[0] + 0.5 * v[0], 4.0 * q[0] * v[0] * v[1] + np.sin(q[1]) + np.cos(t)])

    def phi(self, t, q):
        return np.array([q[0] - np.exp(0.3 * t) * np.cos(q[1])])

    def phi_q(self, t, q):
        return np.array([[1.0, np.exp(0.3 * t) * np.sin(q[1])]])


class Exact(Slider):
    """The same with every derivative by hand."""

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

    def phi_bias(self, t, q, v):
        s = np.exp(0.3 * t)
        return np.array([s * np.cos(q[1]) * v[1] ** 2 + 0.6 * s * np.sin(q[1]) * v[1] - 0.09 * s * np.cos(q[1])])


STATE = dict(t=0.7, q=np.array([0.8, 0.4]), v=np.array([-0.6, 1.3]), a=np.array([0.9, -0.2]), lam=np.array([1.7]))
ARGUMENTS = {"force_q": "tqv", "force_v": "tqv", "mass_a_q": "qa", "reaction_q": ("t", "q", "lam"), "phi_t": "tq", "phi_bias": "tqv"}


@pytest.mark.parametrize("name", ARGUMENTS)
def test_defaults_are_right(name):
    given = [STATE[key] for key in ARGUMENTS[name]]
    exact = getattr(Exact(), name)(*given)
    assert np.abs(getattr(Slider(), name)(*given) - exact).max() < 1e-8 * max(1.0, np.abs(exact).max())


def test_default_tangent_is_the_derivative_of_the_residual():
    t, q, v, a, lam = STATE.values()
    exact = Exact()
    whole = (
        2.0 * exact.mass(q)
        + 3.0 * exact.force_v(t, q, v)
        + 5.0 * (exact.force_q(t, q, v) + exact.mass_a_q(q, a) + exact.reaction_q(t, q, lam))
    )
    assert np.allclose(Slider().tangent(t, q, v, a, lam, 2.0, 3.0, 5.0), whole, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("model", [Slider(), Exact()])
def test_check_finds_right_derivatives_right(model):
    assert max(pi.check_derivatives(model, 0.3).values()) < 1e-7


@pytest.mark.parametrize("name", [*ARGUMENTS, "phi_q"])
def test_check_finds_a_wrong_override(name):
    right = getattr(Exact, name)
    wrong = type("Wrong", (Exact,), {name: lambda self, *given: 1.1 * right(self, *given)})
    assert pi.check_derivatives(wrong(), 0.3)[name] > 0.05


def denied(missing):
    """Exact, which says that it does not need what it does."""
    given = {"needs": pi.Needs(**{missing: False}), "phi_t": pi.Model.phi_t, "phi_bias": pi.Model.phi_bias}
    return type("Denied", (Exact,), given)()


def test_check_names_a_mass_that_varies_against_its_needs():
    with pytest.raises(pi.InputError, match="Denied.mass changes with q.*mass_varies=True"):
        pi.check_derivatives(denied("mass_varies"), 0.3)


def test_names_are_imported_when_they_are_used():
    assert dir(pi) == sorted(pi.__all__)
    for name in pi.__all__:
        assert getattr(pi, name) is not None
    with pytest.raises(AttributeError, match="nonsense"):
        pi.nonsense
    with pytest.raises(AttributeError, match="nonsense"):
        pi.study.nonsense


STEP = pi.GeneralizedAlpha(h=1e-2)
RUN = dict(q0=[1.0, 0.0])
PROMISES = {"mass_varies": "mass", "velocity_forces": "force", "driven": "phi", "phi_q_varies": "phi_q"}


@pytest.mark.parametrize("integrator", [STEP, pi.IDA(), pi.RadauIIA()], ids=["alpha", "IDA", "radau"])
@pytest.mark.parametrize("promise", PROMISES)
def test_a_broken_promise_is_named_before_the_run(promise, integrator):
    function = PROMISES[promise]
    with pytest.raises(pi.InputError, match=rf"Denied\.{function} changes with .*{promise}=False: .*{promise}=True"):
        pi.solve(denied(promise), 0.1, integrator, **RUN)


@pytest.mark.parametrize("name", ["phi_q", "phi_t", "phi_rate", "phi_bias"])
def test_a_wrong_derivative_of_phi_is_named_before_the_run(name):
    right = getattr(Exact, name)
    wrong = type("Wrong", (Exact,), {name: lambda self, *given: 1.001 * right(self, *given)})()
    with pytest.raises(pi.InputError, match=rf"Wrong\.{name} is not .* by differences"):
        pi.solve(wrong, 0.1, STEP, **RUN)
    if name == "phi_q":
        with pytest.raises(pi.InputError, match=r"Wrong\.phi_q is not"):
            pi.static(wrong, q0=[1.0, 0.0])


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e6])
def test_right_derivatives_raise_no_alarm(size):
    """Whatever the unit of length, with a fast drive, a kink in q, and functions that are not finite, or raise, off the constraint."""

    class Odd(Exact):
        def phi(self, t, q):
            u = q / size
            if not 0.0 < u[0] < 1.5:
                raise ArithmeticError("out of its range")
            far = np.sqrt(1.2 - u[0]) + abs(u[1] - 0.05)
            return np.array([u @ u - 1.0 - 1e-3 * np.sin(3e4 * t) + 0.0 * far]) * size

        def phi_q(self, t, q):
            return 2.0 * q[None] / size

        def phi_t(self, t, q):
            return np.array([-30.0 * np.cos(3e4 * t)]) * size

        def phi_rate(self, t, q, v):
            return self.phi_q(t, q) @ v + self.phi_t(t, q)

        def phi_bias(self, t, q, v):
            return np.array([2.0 * v @ v / size + 9e5 * np.sin(3e4 * t) * size])

    start = size * np.array([1.0, 0.0])
    for t_end in (1e-5, 1.0, 100.0):
        require_declared(guard(Odd()), 0.0, start, 0.0 * start, t_end)


class Skate(pi.Model):
    """A skate (x, y, angle) on a slope along x: it moves along its blade alone, which no phi says."""

    n, m = 3, 1
    needs = pi.Needs(mass_varies=False, velocity_forces=False, driven=False)

    def mass(self, q):
        return np.eye(3)

    def force(self, t, q, v):
        return np.array([-2.0, 0.0, 0.0])

    def phi(self, t, q):
        return np.zeros(1)

    def phi_q(self, t, q):
        return np.array([[-np.sin(q[2]), np.cos(q[2]), 0.0]])

    def phi_rate(self, t, q, v):
        return self.phi_q(t, q) @ v


@pytest.mark.parametrize("integrator", [STEP, pi.RadauIIA(), pi.IDA(), pi.IDA(form="index2")], ids=["alpha", "radau", "ggl2", "index2"])
def test_a_rate_that_is_no_derivative_of_phi_is_named(integrator):
    with pytest.raises(pi.InputError, match=r"Skate\.phi_rate is not d phi/dt .*written as psi"):
        pi.solve(Skate(), 0.1, integrator, v0=[0.0, 0.0, 1.0])


@pytest.mark.parametrize("name", ["phi", "phi_q"])
def test_a_model_without_a_function_of_its_constraints_is_named(name):
    given = {name: getattr(pi.Model, name), "potential": lambda self, q: 0.0}
    model, keeping = type("Bare", (Slider,), given)(), pi.EnergyMomentum(h=1e-2)
    for ask in (
        lambda: pi.solve(model, 0.1, keeping),
        lambda: pi.check_derivatives(model),
        lambda: pi.solve(model, 0.1, STEP, **RUN),
        lambda: pi.static(model),
        lambda: pi.linearise(model),
        lambda: pi.modes(model),
    ):
        with pytest.raises(pi.InputError, match=rf"Bare: m = 1 constraints, but its class gives no {name}\(t, q\)"):
            ask()
