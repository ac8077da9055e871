"""An integrator of a user's own: states that are wrong stop the run, and the good ones before them are kept."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

import polyida as pi
from polyida.run.accepted import STANDSTILL

END, BAD = 1.0, 5


class Free(pi.Model):
    """One free mass."""

    n, m = 2, 0

    def mass(self, q):
        return np.eye(2)

    def force(self, t, q, v):
        return np.zeros(2)


class Mine:
    """Ten steps that leave the mass where it is, the sixth of them changed."""

    def __init__(self, change=None, end=END):
        self.change, self.end = change, end

    def steps(self, model, state, t_end, counts):
        for k in range(1, 11):
            counts.steps += 1
            after = pi.State(self.end * k / 10, state.q, state.v, state.a, state.lam)
            yield self.change(after) if self.change and k == BAD + 1 else after


def solved(integrator, **options):
    return pi.solve(Free(), END, integrator, q0=[1.0, 2.0], **options)


CHANGES = {
    "nan": (lambda s: replace(s, q=s.q * np.nan), "not finite", "q[0] = nan at t = 0.6 s"),
    "inf": (lambda s: replace(s, a=s.a + np.inf), "not finite", "a[0] = inf at t = 0.6 s"),
    "complex": (lambda s: replace(s, v=s.v * 1j), "integrator", "v at t = 0.6 s", "complex"),
    "objects": (lambda s: replace(s, v=s.v.astype(object)), "integrator", "v at t = 0.6 s", "object"),
    "shape": (lambda s: replace(s, a=s.a[:1]), "integrator", "a at t = 0.6 s", "(1,)", "(2,)"),
    "lam": (lambda s: replace(s, lam=np.zeros(1)), "integrator", "lam at t = 0.6 s"),
    "list": (lambda s: replace(s, q=s.q.tolist()), "integrator", "q at t = 0.6 s", "list"),
    "no State": (lambda s: {"t": s.t, "q": s.q}, "integrator", "dict", "State"),
    "nothing": (lambda s: None, "integrator", "NoneType"),
    "back": (lambda s: replace(s, t=0.1), "integrator", "t = 0.1 s after 0.5 s"),
    "repeated": (lambda s: replace(s, t=0.5), "integrator", "t = 0.5 s after 0.5 s"),
    "beyond the end": (lambda s: replace(s, t=1.5), "integrator", "t = 1.5 s overruns"),
    "t nan": (lambda s: replace(s, t=np.nan), "integrator", "t = nan"),
    "t complex": (lambda s: replace(s, t=0.6j), "integrator", "0.6j"),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_wrong_state_stops_the_run(name, tmp_path):
    change, status, *said = CHANGES[name]
    run = solved(Mine(change), out=tmp_path / "run.h5")
    assert run.status == status and not run.success
    assert all(text in run.message for text in ["Mine", "t = 0.5 s", *said]), run.message
    assert run.t == pytest.approx(np.arange(BAD + 1) / 10)
    again = pi.load(tmp_path / "run.h5")
    assert np.array_equal(again.q, run.q) and again.status == status


def test_one_that_overruns_or_stops_short_is_not_done():
    over, short = solved(Mine(end=1.05 * END)), solved(Mine(end=0.9 * END))
    assert over.status == short.status == "integrator"
    assert "overruns" in over.message and over.t[-1] < END and "short of t_end = 1 s" in short.message and len(short) == 11


@pytest.mark.parametrize("last", [0.5, END])
def test_one_that_does_not_advance_is_stopped(last):
    class Zeno:
        def steps(self, model, state, t_end, counts):
            t = last
            while True:
                yield replace(state, t=t)
                t = np.nextafter(t, 2.0) if last < END else t

    run = solved(Zeno())
    assert not run.success and "Zeno" in run.message and len(run) <= STANDSTILL + 2


def test_one_that_gives_no_states_at_all():
    class Nothing:
        def steps(self, model, state, t_end, counts):
            return None

    class Empty:
        def steps(self, model, state, t_end, counts):
            return iter(())

    assert "Nothing: its steps gave NoneType" in solved(Nothing()).message
    assert "Empty: it ended short" in solved(Empty()).message


@pytest.mark.parametrize("memory", [{"past": (np.zeros(1), 1e-2, np.zeros(2))}, {"name": "abc"}, {7: 1.0}])
def test_a_memory_that_no_file_stores_stops_the_run(memory):
    class Forgets:
        def steps(self, model, state, t_end, counts):
            counts.steps += 1
            yield pi.State(t_end, state.q, state.v, state.a, state.lam, memory=memory)

    run = pi.solve(Free(), END, Forgets(), q0=[1.0, 2.0])
    assert not run.success and f"memory[{next(iter(memory))!r}] at t = " in run.message and "must be a number or an array" in run.message


class Reuses:
    """Uniform motion in ten steps that changes, in place, what it was given and what it has yielded."""

    def steps(self, model, state, t_end, counts):
        h, memory = (t_end - state.t) / 10, {"seen": np.zeros(1)}
        q, first = state.q, state.t
        for k in range(1, 11):
            counts.steps += 1
            q += h * state.v
            memory["seen"] += 1
            after = pi.State(first + k * h, q.copy(), state.v, state.a, state.lam, memory=memory)
            yield after
            after.q[:], after.lam[:] = 77.0, 77.0


def test_what_an_integrator_changes_later_is_not_the_runs():
    given, seen = [np.array([1.0, 2.0]), np.array([1.0, 0.0])], []
    run = pi.solve(
        Free(), END, Reuses(), q0=given[0], v0=given[1], output=[0.0, 0.03, 0.5, 1.0], until=lambda t, q, v: seen.append((t, q)) or t - 0.95
    )
    assert np.allclose(run.q, [[1.0 + t, 2.0] for t in run.t], atol=1e-12) and np.array_equal(given, [[1.0, 2.0], [1.0, 0.0]])
    assert all(np.allclose(q, [1.0 + t, 2.0]) for t, q in seen)
    part = pi.solve(Free(), END, Reuses(), q0=given[0], v0=given[1], every=5)
    again = pi.solve(Free(), 2.0 * END, Reuses(), state=part.state)
    assert part.state.q[0] == pytest.approx(2.0) and again.q[0, 0] == pytest.approx(2.0) and again.q[-1, 0] == pytest.approx(3.0)
    assert part.state.memory["seen"] == 10.0 and np.allclose(part.q[:, 0], 1.0 + part.t)


COUNTS = {"steps": "many", "solves": np.nan, "tangents": None, "rejected": np.arange(3), "residuals": -1, "backend": 3, "mine": 1}


@pytest.mark.parametrize("name", COUNTS)
def test_counts_that_are_none_stop_the_run(name, tmp_path):
    class Counting(Mine):
        def steps(self, model, state, t_end, counts):
            for k, after in enumerate(super().steps(model, state, t_end, counts)):
                if k == BAD:
                    setattr(counts, name, COUNTS[name])
                yield after

    run = solved(Counting(), out=tmp_path / "run.h5")
    assert not run.success and f"counts.{name} = " in run.message and run.t[-1] == 0.5
    assert run.counts.steps == BAD and pi.load(tmp_path / "run.h5").counts.as_dict() == run.counts.as_dict() and run.summary()


@pytest.mark.parametrize("steps", [lambda model: iter(()), lambda model, state, t_end, counts, more: iter(())])
def test_steps_with_other_arguments_are_refused_before_the_run(steps):
    with pytest.raises(pi.InputError, match=r"solve: steps of .* must take \(model, state, t_end, counts\)"):
        solved(SimpleNamespace(steps=steps))


@dataclass
class WithStep:
    h: float
    order: int = 1

    def steps(self, model, state, t_end, counts):
        yield state


@pytest.mark.parametrize(
    "given, words",
    [
        (WithStep, r"solve: WithStep is a class: give an instance, WithStep\(h=\.\.\.\)$"),
        (pi.IDA, r"solve: IDA is a class: give an instance, IDA\(\)$"),
        (3.0, r"3\.0 is no integrator, it has no method steps\(model, state, t_end, counts\)"),
        (SimpleNamespace, "solve: SimpleNamespace is no integrator, it has no method steps"),
    ],
)
def test_a_class_and_an_object_without_steps_are_refused(given, words):
    with pytest.raises(pi.InputError, match=words):
        solved(given)


class Declared(Mine, pi.Integrator):
    """One that inherits the defaults: its states are copied and checked."""


class Trusted(Declared):
    """One whose states are used as they are."""

    trusted = True


def test_one_that_inherits_gets_the_defaults():
    integrator = Declared()
    integrator.h = 1e-2
    assert integrator.fixed_step() == 1e-2 and integrator.relative_tolerance() is None and integrator.without_halving() is integrator
    run = solved(integrator)
    assert run.success and np.array_equal(run.q, solved(Mine()).q) and run.summary().startswith("done: Declared")
    wrong = solved(Declared(lambda s: replace(s, q=s.q.tolist())))
    assert wrong.status == "integrator" and "list" in wrong.message


def test_states_of_a_trusted_one_are_taken_as_they_are():
    run, plain = solved(Trusted()), solved(Mine())
    assert run.success and run.counts == plain.counts and np.array_equal(run.q, plain.q) and np.array_equal(run.t, plain.t)
    bad = solved(Trusted(lambda s: replace(s, q=s.q * np.nan)))
    assert bad.status == "not finite" and "Trusted" in bad.message and len(bad) == BAD + 1


class Euler:
    """Symplectic Euler; in_place: in the arrays of the state from which it starts."""

    def __init__(self, in_place):
        self.in_place = in_place

    def steps(self, model, state, t_end, counts):
        t, q, v = state.t, state.q, state.v
        if not self.in_place:
            q, v = q.copy(), v.copy()
        count = max(1, round((t_end - t) / 0.01))
        h = (t_end - t) / count
        for k in range(count):
            a = -model.force(t, q, v)
            v += h * a
            q += h * v
            t = t_end if k == count - 1 else t + h
            counts.steps += 1
            yield pi.State(t, q.copy(), v.copy(), a, np.zeros(0))


class TrustedEuler(Euler, pi.Integrator):
    trusted = True


class HeirOfTrust(pi.GeneralizedAlpha):
    """It inherits what GeneralizedAlpha promises of its own steps."""

    in_place = True

    def steps(self, model, state, t_end, counts):
        return Euler(self.in_place).steps(model, state, t_end, counts)


class CarefulHeir(HeirOfTrust):
    in_place = False


class Wall(pi.Model):
    """A mass on a spring that meets a stiffer one."""

    n, m = 1, 0

    def mass(self, q):
        return np.eye(1)

    def force(self, t, q, v):
        return 40.0 * q + 2e3 * np.minimum(q + 0.5, 0.0)

    def gaps(self, t, q):
        return q + 0.5


START = {
    "own": (Euler(True), Euler(False)),
    "trusted": (TrustedEuler(True), TrustedEuler(False)),
    "heir": (HeirOfTrust(h=0.01), CarefulHeir(h=0.01)),
}


@pytest.mark.parametrize("name", START)
def test_the_start_is_an_integrators_own(name):
    """Steps up to a switch are tried again from one state, which no trial may have changed."""
    run, expected = (pi.solve(Wall(), 0.5, one, q0=[1.0], v0=[0.0]) for one in START[name])
    assert run.counts.rejected and run.success and np.abs(run.q[-1] - expected.q[-1]).max() < 1e-12
