"""The seam: default derivatives of a model, and the check of exact ones."""

import numpy as np
import pytest

import polyida as pi


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


@pytest.mark.parametrize("missing", ["velocity_forces", "driven", "phi_q_varies"])
def test_check_finds_a_need_that_is_denied(missing):
    assert max(pi.check_derivatives(denied(missing), 0.3).values()) > 0.05


def test_check_names_a_mass_that_varies_against_its_needs():
    with pytest.raises(pi.InputError, match="Denied.mass changes with q.*mass_varies=True"):
        pi.check_derivatives(denied("mass_varies"), 0.3)


def test_names_are_imported_when_they_are_used():
    assert dir(pi) == sorted(pi.__all__)
    for name in pi.__all__:
        assert getattr(pi, name) is not None
    with pytest.raises(AttributeError, match="nonsense"):
        pi.nonsense


@pytest.mark.parametrize(
    "attribute, value",
    [
        ("force", lambda self, t, q, v: np.zeros(3)),
        ("mass", lambda self, q: np.eye(3)),
        ("phi", lambda self, t, q: np.zeros(2)),
        ("phi_q", lambda self, t, q: np.ones(2)),
    ],
)
def test_a_function_of_the_wrong_shape_is_named(attribute, value):
    model = type("Misshaped", (Slider,), {attribute: value})()
    with pytest.raises(pi.InputError, match=attribute):
        pi.solve(model, 0.1, pi.GeneralizedAlpha(h=1e-2), q0=[1.0, 0.0])
