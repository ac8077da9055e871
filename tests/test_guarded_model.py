"""A user's model: whatever its functions do wrong is named, and what they do oddly does no harm."""

import numpy as np
import pytest
import scipy.sparse

import polyida as pi
from polyida.model.check import require_declared
from polyida.model.differences import along, jacobian
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


def test_differences_keep_copies():
    room = np.zeros(2)

    def function(s):
        room[:] = np.sin(s), s * s
        return room

    assert along(function) == pytest.approx([1.0, 0.0], abs=1e-8)
    assert along(function, room=(0.0, np.inf)) == pytest.approx([1.0, 0.0], abs=1e-6)
    assert jacobian(lambda x: function(x[0]), np.array([0.5]), 2)[:, 0] == pytest.approx([np.cos(0.5), 1.0], abs=1e-8)


def test_one_array_does_for_everything_else_too():
    right, odd = Pendulum(), OneBuffer()
    state = pi.consistent_state(right, q0=[1.0, 0.0])
    assert np.array_equal(pi.consistent_state(odd, q0=[1.0, 0.0]).lam, state.lam)
    assert max(pi.check_derivatives(odd).values()) < 1e-7
    assert pi.condition_number(odd, INTEGRATORS[0], state) == pi.condition_number(right, INTEGRATORS[0], state)
    assert np.array_equal(pi.static(odd, q0=[0.0, -1.0]).lam, pi.static(right, q0=[0.0, -1.0]).lam)
    run = pi.solve(odd, 0.1, INTEGRATORS[0], **START)
    assert np.array_equal(run.velocity_drift, pi.solve(right, 0.1, INTEGRATORS[0], **START).velocity_drift)


WRONG = {
    "complex": (lambda x, t: x * (1 + 0j), "complex"),
    "objects": (lambda x, t: x.astype(object), "object"),
    "text": (lambda x, t: x.astype(str), "<U"),
    "a list": (lambda x, t: x.tolist(), "list"),
    "another shape": (lambda x, t: x[None], "shape"),
    "not finite": (lambda x, t: x * np.nan, "not finite"),
}


@pytest.mark.parametrize("name", ["mass", "force", "phi", "phi_q"])
@pytest.mark.parametrize("kind", WRONG)
def test_a_wrong_result_is_named_before_the_run(name, kind):
    change, said = WRONG[kind]
    with pytest.raises(pi.InputError, match=rf"Changed\.{name} .*{said}"):
        pi.solve(changed(**{name: change}), 0.1, INTEGRATORS[0], **START)


@every
@pytest.mark.parametrize("name", ["force", "phi", "phi_q"])
@pytest.mark.parametrize("kind", ["complex", "another shape"])
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


def test_integers_are_numbers():
    model = changed(mass=lambda x, t: x.astype(int), phi_q=lambda x, t: x)
    assert pi.solve(model, 0.1, INTEGRATORS[0], **START).success


@pytest.mark.parametrize("attribute, value", [("n", 2.0), ("m", -1), ("needs", {"driven": False}), ("n", None)])
def test_sizes_and_needs_are_looked_at(attribute, value):
    with pytest.raises(pi.InputError, match=f"Sized: .*{attribute} = "):
        pi.solve(type("Sized", (Pendulum,), {attribute: value})(), 0.1, INTEGRATORS[0], **START)


def test_a_function_that_is_missing_is_said():
    model = type("Half", (pi.Model,), {"n": 1, "m": 0, "mass": lambda self, q: np.eye(1)})()
    with pytest.raises(pi.InputError, match="Half has not all"):
        pi.solve(model, 0.1, INTEGRATORS[0])


def test_kinks_of_a_model_may_come_in_any_order():
    times = [0.07, 0.03, 0.03]
    model = type("Kinked", (Pendulum,), {"kinks": lambda self, t0, t1: [t for t in times if t0 < t < t1]})()
    run = pi.solve(model, 0.1, INTEGRATORS[0], **START)
    assert run.success and (np.diff(run.t) > 0).all() and {0.03, 0.07} <= set(run.t)
    model = type("Kinked", (Pendulum,), {"kinks": lambda self, t0, t1: ["soon"]})()
    with pytest.raises(pi.InputError, match="Kinked.kinks"):
        pi.solve(model, 0.1, INTEGRATORS[0], **START)


@every
def test_a_mass_that_varies_though_it_is_said_not_to_is_named(integrator):
    functions = {"mass": lambda self, q: (2.0 + q[1]) * np.eye(2), "needs": pi.Needs(mass_varies=False)}
    with pytest.raises(pi.InputError, match=r"Varying\.mass changes with q.* mass_varies=True"):
        pi.solve(type("Varying", (Pendulum,), functions)(), 0.1, integrator, **START)


def test_what_somebody_else_holds_is_copied():
    class Turns(Pendulum):
        rooms, calls = (np.zeros(1), np.zeros(1)), 0

        def phi(self, t, q):
            self.calls += 1
            self.rooms[self.calls % 2][:] = Pendulum.phi(self, t, q)
            return self.rooms[self.calls % 2][:]

    model, fresh = guard(Turns()), np.zeros(2)
    first, q = model.phi(0.0, np.array([2.0, 0.0])), np.array([1.0, 0.0])
    assert [model.phi(0.0, q) is room for room in Turns.rooms * 2] == [False] * 4 and first == 3.0
    new = type("New", (Pendulum,), {"force": lambda self, t, q, v: fresh})()
    assert guard(new).force(0.0, q, q) is not fresh


def test_a_rate_of_phi_of_the_users_own_is_called():
    rated = type("Rated", (Pendulum,), {"phi_rate": lambda self, t, q, v: np.array([2.0 * q @ v, 0.0])})()
    with pytest.raises(pi.InputError, match=r"Rated\.phi_rate must return an array of shape \(1,\)"):
        pi.solve(rated, 0.1, INTEGRATORS[0], **START)


def test_every_call_of_a_run_is_guarded():
    writable = []

    class Looks(Pendulum):
        def phi_q(self, t, q):
            writable.append(q.flags.writeable)
            return Pendulum.phi_q(self, t, q)

        def mass(self, q):
            writable.append(q.flags.writeable)
            return Pendulum.mass(self, q)

    state = pi.solve(Pendulum(), 0.1, INTEGRATORS[0], until=lambda t, q, v: t - 0.055, **START).state
    assert pi.solve(Looks(), 0.2, INTEGRATORS[0], state=state).success
    assert len(writable) > 100 and not any(writable)


@every
def test_names_that_scenes_have_are_the_users_own(integrator):
    model = Pendulum()
    model.parts, model.reference, model.motor_profiles, model.gravity = ["rod"], 7.0, "none", 9.81
    assert np.array_equal(pi.solve(model, 0.1, integrator, **START).q, pi.solve(Pendulum(), 0.1, integrator, **START).q)


class Overdressed(Pendulum):
    """With attributes of its own that are called as a scene's are."""

    def __init__(self):
        self.arrays, self.reference, self.gravity, self.labels, self.extent = "mine", "mine too", 9.81, None, "large"


@every
def test_attributes_that_happen_to_be_called_as_a_scenes_make_no_scene(integrator):
    run, plain = (pi.solve(model, 0.1, integrator, **START) for model in (Overdressed(), Pendulum()))
    assert run.success and np.array_equal(run.q, plain.q) and np.array_equal(run.lam, plain.lam)
    assert np.array_equal(run.energy.kinetic, plain.energy.kinetic)


def test_what_only_scenes_have_is_said_to_be_missing():
    run = pi.solve(Pendulum(), 0.02, INTEGRATORS[0], **START)
    for ask in (lambda: run.position("tip"), lambda: run.model.attachment("tip")):
        with pytest.raises(pi.InputError, match="Pendulum has no named points"):
            ask()
    with pytest.raises(pi.InputError, match="no joint is called 'tip'"):
        run.reaction("tip")
    with pytest.raises(pi.InputError, match=r"EnergyMomentum: Pendulum gives no potential\(q\)"):
        pi.solve(Overdressed.__base__(), 0.1, pi.EnergyMomentum(h=1e-2), **START)


def test_a_model_may_have_what_scenes_have():
    class Named(Pendulum):
        rows = {"rod": slice(0, 1)}

        def position(self, name, q):
            return q

        def reactions(self, name, q, lam):
            return lam * q

        def potentials(self, q):
            return 9.81 * q[1], 1.5 * q[0] ** 2

        def objection(self, t, q):
            return "too far" if q[0] < 0.99 else None

    run = pi.solve(Named(), 1.0, pi.GeneralizedAlpha(h=1e-2, max_halvings=0), **START)
    assert run.status == "objection" and "too far" in run.message and run.q[:, 0].min() >= 0.99
    assert np.array_equal(run.position("any"), run.q) and np.array_equal(run.reaction("rod"), run.lam * run.q)
    assert np.array_equal(run.energy.strain, 1.5 * run.q[:, 0] ** 2) and np.ptp(run.energy.total) < 1e-3


def test_a_step_matrix_of_one_s_own_is_taken():
    """By generalized-alpha for every factor; it solves as the default one."""
    from polyida.linear.step_matrix import StepMatrix

    made = []

    class Counted(StepMatrix):
        def factor(self, *at):
            made.append(at[0])
            super().factor(*at)

    class Own(Pendulum):
        alike = True

        def step_matrix(self):
            return Counted(self)

    runs = [pi.solve(kind(), 0.1, pi.GeneralizedAlpha(h=1e-2), q0=[1.0, 0.0]) for kind in (Pendulum, Own)]
    assert np.abs(runs[0].q - runs[1].q).max() < 1e-14 and len(made) >= runs[1].counts.factorizations > 0


@pytest.mark.parametrize("kind", ["coo", "csr", "dia", "lil"])
@pytest.mark.parametrize("integrator", [*INTEGRATORS, pi.EnergyMomentum(h=1e-2)], ids=lambda one: type(one).__name__)
def test_matrices_come_in_every_sparse_format_beside_dense_ones(integrator, kind):
    """`scipy.sparse.eye` and `diags` give "dia" where no format is asked for; a sparse phi_q may stand beside a dense M, and the other way."""

    class Sparse(Pendulum):
        needs = pi.Needs(mass_varies=False, velocity_forces=False, driven=False)

        def potential(self, q):
            return 1.5 * q[0] ** 2 + 9.81 * q[1]

        def phi_q(self, t, q):
            return scipy.sparse.coo_matrix(2.0 * q[None]).asformat(kind)

    class SparseMass(Sparse):
        def mass(self, q):
            return scipy.sparse.eye(2).asformat(kind)

        phi_q = Pendulum.phi_q

    wanted = pi.solve(Pendulum(), 0.05, pi.RadauIIA(rtol=1e-8), **START).q[-1]
    for model in (Sparse(), SparseMass()):
        run = pi.solve(model, 0.05, integrator, **START)
        assert run.status == "done" and np.abs(run.q[-1] - wanted).max() < 1e-4


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
