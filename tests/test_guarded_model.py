"""A user's model: whatever its functions do wrong is named, and what they do oddly does no harm."""

import numpy as np
import pytest
import scipy.sparse

import polyida as pi
from polyida.model.check import require_declared
from polyida.model.guarded import guard

INTEGRATORS = [
    pi.GeneralizedAlpha(h=1e-2),
    pi.GeneralizedAlpha(h=1e-2, form="stabilised"),
    pi.IDA(),
    pi.IDA(linear="whole"),
    pi.RadauIIA(),
    pi.RadauIIA(h=1e-2),
]
every = pytest.mark.parametrize("integrator", INTEGRATORS, ids=["alpha", "stabilised", "IDA", "IDA whole", "radau", "radau, fixed steps"])
START = dict(q0=[1.0, 0.0])


class Pendulum(pi.Model):
    """A point on a rod, pulled by its weight and a spring in x."""

    n, m = 2, 1

    def mass(self, q):
        return np.eye(2)

    def force(self, t, q, v):
        return np.array([3.0 * q[0], 9.81])

    def phi(self, t, q):
        return np.array([q @ q - 1.0])

    def phi_q(self, t, q):
        return 2.0 * q[None]


class OneBuffer(Pendulum):
    """The same, each function filling the same array again and again."""

    def __init__(self):
        self.room = {name: np.zeros(shape) for name, shape in (("force", 2), ("phi", 1), ("phi_q", (1, 2)), ("mass", (2, 2)))}

    def _kept(self, name, values):
        self.room[name][...] = values
        return self.room[name]

    def mass(self, q):
        return self._kept("mass", np.eye(2))

    def force(self, t, q, v):
        return self._kept("force", Pendulum.force(self, t, q, v))

    def phi(self, t, q):
        return self._kept("phi", Pendulum.phi(self, t, q))

    def phi_q(self, t, q):
        return self._kept("phi_q", Pendulum.phi_q(self, t, q))


def changed(**functions):
    """The pendulum with some functions replaced by ones of the pendulum's result and the time."""

    def replaced(name, change):
        right = getattr(Pendulum, name)

        def function(self, *given):
            t = given[0] if name != "mass" else 0.0
            return change(right(self, *given), t)

        return function

    return type("Changed", (Pendulum,), {name: replaced(name, change) for name, change in functions.items()})()


@every
def test_functions_that_fill_one_array_give_the_same_run(integrator):
    one, other = (pi.solve(model, 0.3, integrator, **START) for model in (Pendulum(), OneBuffer()))
    assert one.success and np.array_equal(one.q, other.q) and np.array_equal(one.lam, other.lam)


WRONG = {
    "complex": (lambda x, t: x * (1 + 0j), "complex"),
    "objects": (lambda x, t: x.astype(object), "object"),
    "text": (lambda x, t: x.astype(str), "<U"),
    "a list": (lambda x, t: x.tolist(), "list"),
    "another shape": (lambda x, t: x[None], "shape"),
    "not finite": (lambda x, t: x * np.nan, "not finite"),
}


@pytest.mark.parametrize("name, kind", [("force", kind) for kind in WRONG] + [(name, "another shape") for name in ("mass", "phi", "phi_q")])
def test_a_wrong_result_is_named_before_the_run(name, kind):
    change, said = WRONG[kind]
    with pytest.raises(pi.InputError, match=rf"Changed\.{name} .*{said}"):
        pi.solve(changed(**{name: change}), 0.1, INTEGRATORS[0], **START)


@every
@pytest.mark.parametrize("name, kind", [("force", "complex"), ("phi", "another shape"), ("phi_q", "another shape")])
def test_a_result_that_goes_wrong_later_is_named(integrator, name, kind):
    change, said = WRONG[kind]
    model = changed(**{name: lambda x, t: change(x, t) if t > 0.05 else x})
    with pytest.raises(pi.InputError, match=rf"Changed\.{name} .*{said}") as caught:
        pi.solve(model, 0.1, integrator, **START)
    assert 0.0 < caught.value.trajectory.t[-1] <= 0.05


@every
@pytest.mark.parametrize("name", ["force", "phi", "phi_q"])
def test_numbers_that_are_not_finite_later_are_named(integrator, name):
    run = pi.solve(changed(**{name: lambda x, t: x * (np.nan if t > 0.05 else 1.0)}), 0.1, integrator, **START)
    assert not run.success and f"Changed.{name} gave" in run.message
    assert len(run) > 1 and 0.0 < run.t[-1] <= 0.051 and np.isfinite(run.q).all()


@pytest.mark.parametrize("places", [[(0, 1)], [(1, 1)]], ids=["at the start", "on the way"])
def test_a_mass_that_is_not_symmetric_is_named(places):
    def mass(self, q):
        return np.eye(2) + np.array([[0.0, 0.3 if places == [(0, 1)] else 0.3 * q[1]], [0.0, 0.0]])

    with pytest.raises(pi.InputError, match=r"Skew\.mass must be symmetric"):
        pi.solve(type("Skew", (Pendulum,), {"mass": mass})(), 0.1, INTEGRATORS[0], **START)


@pytest.mark.parametrize("by_numba", [False, True])
def test_a_negative_mass_is_named(by_numba):
    kind = type("Light", (Pendulum,), {"mass": lambda self, q: np.array([[1.0, 2.0], [2.0, 1.0]])})
    with pytest.raises(pi.InputError, match=r"Light\.mass must give no negative kinetic energy; M has the eigenvalue -1"):
        pi.solve((pi.compiled(kind) if by_numba else kind)(), 0.1, INTEGRATORS[0], **START)


@every
@pytest.mark.parametrize("name", ["mass", "force", "phi", "phi_q"])
def test_a_function_that_writes_into_its_arguments_is_named(integrator, name):
    right = getattr(Pendulum, name)

    def writes(self, *given):
        given[-1][0] += 0.1
        return right(self, *given)

    with pytest.raises(pi.InputError, match=rf"Writes\.{name} writes into its arguments"):
        pi.solve(type("Writes", (Pendulum,), {name: writes})(), 0.1, integrator, **START)


def test_until_cannot_write_into_the_state():
    def until(t, q, v):
        q[0] = 7.0
        return 1.0

    with pytest.raises(ValueError, match="read-only"):
        pi.solve(Pendulum(), 0.1, INTEGRATORS[0], until=until, **START)


@pytest.mark.parametrize("attribute, value", [("n", 2.0), ("m", -1), ("needs", {"driven": False}), ("n", None)])
def test_sizes_and_needs_are_looked_at(attribute, value):
    with pytest.raises(pi.InputError, match=f"Sized: .*{attribute} = "):
        pi.solve(type("Sized", (Pendulum,), {attribute: value})(), 0.1, INTEGRATORS[0], **START)


def velocity_row(self, t, q, v):
    return v[:1]


@pytest.mark.parametrize(
    "attributes, told",
    [
        ({"m": 0, "phi": Pendulum.phi}, r"phi\(t, q\), but m = 0"),
        ({"psi": velocity_row}, r"psi\(t, q, v\), but p = 0"),
        ({"algebraic": 1}, r"algebraic = 1 states, but its class gives no rates"),
    ],
)
def test_functions_that_the_sizes_leave_out_are_named(attributes, told):
    with pytest.raises(pi.InputError, match=f"^Short: .*{told}"):
        pi.solve(type("Short", (Pendulum,), attributes)(), 0.01, pi.RadauIIA(), **START)


def test_a_class_may_drop_the_rows_that_it_inherits_and_an_object_its_own():
    class Free(Pendulum):
        m = 0

    class Chain(Pendulum):
        def __init__(self, links):
            self.m = links

        def phi(self, t, q):
            return super().phi(t, q)[: self.m]

        def phi_q(self, t, q):
            return super().phi_q(t, q)[: self.m]

    for model in (Free(), Chain(0)):
        assert pi.solve(model, 0.1, pi.RadauIIA(rtol=1e-9), **START).q[-1, 1] == pytest.approx(-0.5 * 9.81 * 0.01)


def test_a_rate_of_phi_of_the_users_own_is_called():
    rated = type("Rated", (Pendulum,), {"phi_rate": lambda self, t, q, v: np.array([2.0 * q @ v, 0.0])})()
    with pytest.raises(pi.InputError, match=r"Rated\.phi_rate must return an array of shape \(1,\)"):
        pi.solve(rated, 0.1, INTEGRATORS[0], **START)


class Overdressed(Pendulum):
    """With attributes of its own that are called as a scene's are."""

    def __init__(self):
        self.arrays, self.reference, self.gravity, self.labels, self.extent = "mine", "mine too", 9.81, None, "large"


@every
def test_attributes_that_happen_to_be_called_as_a_scenes_make_no_scene(integrator):
    run, plain = (pi.solve(model, 0.1, integrator, **START) for model in (Overdressed(), Pendulum()))
    assert run.success and np.array_equal(run.q, plain.q) and np.array_equal(run.lam, plain.lam)
    assert np.array_equal(run.energy.kinetic, plain.energy.kinetic)


def test_checks_before_a_run_keep_sparse_matrices_sparse():
    """Dense, M alone would have 8e10 entries."""
    n = 100_000
    one = scipy.sparse.eye(n, format="csr")

    class Chain(pi.Model):
        m = 1
        needs = pi.Needs(mass_varies=False, velocity_forces=False, driven=False, phi_q_varies=False)

        def mass(self, q):
            return one

        def force(self, t, q, v):
            return q - 1.0

        def phi(self, t, q):
            return q[:1]

        def phi_q(self, t, q):
            return one[:1]

    Chain.n = n
    require_declared(guard(Chain()), 0.0, np.zeros(n), np.zeros(n), 1.0)


@pytest.mark.parametrize(
    ("name", "wrong", "given"),
    [
        ("mass", np.eye(2), "it is ndarray"),
        ("mass", lambda self, t, q: np.eye(2), r"it takes \(t, q\)"),
        ("force", lambda self, q, v: np.zeros(2), r"it takes \(q, v\)"),
        ("initial_velocity", lambda self: np.zeros(2), r"it takes \(\)"),
        ("rejection_reason", lambda self, q: None, r"it takes \(q\)"),
        ("gaps", lambda self, q: q, r"it takes \(q\)"),
        ("kinks", (0.1,), "it is tuple"),
        ("powers", lambda self, t, q, v: {}, r"it takes \(t, q, v\)"),
    ],
)
def test_a_function_with_other_arguments_is_named(name, wrong, given):
    with pytest.raises(pi.InputError, match=rf"^Odd\.{name} must be a function {name}\(self, .*\); {given}"):
        pi.solve(type("Odd", (Pendulum,), {name: wrong})(), 0.1, INTEGRATORS[0], **START)


def test_k_may_be_a_number_of_the_users_own():
    run = pi.solve(type("Spring", (Pendulum,), {"k": 100})(), 0.1, INTEGRATORS[0], **START)
    assert run.success and run.x.shape == (len(run), 0)


def test_functions_without_rows_may_be_written():
    empty = {"m": 0, "phi": lambda self, t, q: np.zeros(0), "phi_q": lambda self, t, q: np.zeros((0, 2))}
    assert pi.solve(type("Free", (Pendulum,), empty)(), 0.1, INTEGRATORS[0], **START).success
