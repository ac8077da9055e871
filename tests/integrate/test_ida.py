"""IDA: settings, the linear solve against the dense matrix, published digits in every form, failures, kinks."""

from dataclasses import replace

import numpy as np
import pytest
import sksundae._cy_ida

import polyida as pi
from polyida import problems
from polyida.errors import InputError, StepFailure
from polyida.integrate.ida import run as run_of_ida
from polyida.integrate.ida.forms import FORMS, System
from polyida.integrate.ida.integrator import IDA
from polyida.integrate.ida.newton import Correction
from polyida.integrate.start import consistent_state
from polyida.integrate.state import Counts, State, between
from polyida.model import Model, Needs
from polyida.model.guarded import guard
from polyida.problems import plates


def run(model, settings, t_end, q0=None, v0=None):
    """(accepted states, counts) from a consistent start."""
    counts = Counts()
    return list(settings.steps(model, consistent_state(model, 0.0, q0, v0), t_end, counts)), counts


def run_problem(name, settings):
    p = problems.get(name)
    states, counts = run(p.model, settings, p.t_end, p.q0, p.v0)
    last = states[-1]
    return p, states, counts, p.errors(q=last.q, v=last.v, lam=last.lam)


class Oscillator(Model):
    """Two masses on springs, without constraints: q = cos(w t) q0 for w = 1 and 3."""

    n, m = 2, 0
    needs = Needs(False, False, False, False)

    def mass(self, q):
        return np.eye(2)

    def force(self, t, q, v):
        return np.array([1.0, 9.0]) * q


class Driven(Model):
    """A mass of 2 kg whose x is driven by `path(t)`, and whose y is pushed by `push(t)`; both may have kinks."""

    n, m = 2, 1
    needs = Needs(False, False, True, False)

    def __init__(self, path, rate, push, at):
        self.path, self.rate, self.push, self.at = path, rate, push, at

    def mass(self, q):
        return 2.0 * np.eye(2)

    def force(self, t, q, v):
        return np.array([0.0, -self.push(t)])

    def phi(self, t, q):
        return q[:1] - self.path(t)

    def phi_q(self, t, q):
        return np.array([[1.0, 0.0]])

    def phi_t(self, t, q):
        return np.array([-self.rate(t)])

    def phi_bias(self, t, q, v):
        return np.zeros(1)

    def kinks(self, t0, t1):
        return tuple(t for t in self.at if t0 < t < t1)


def test_absolute_tolerances():
    model, sizes = Oscillator(), np.array([2.0, 30.0, 1.0, 1.0])
    assert IDA(rtol=1e-4).tolerances(model, sizes) == pytest.approx((1e-4, 2e-4, 3e-3))
    assert IDA(rtol=1e-4, atol=1e-8).tolerances(model, sizes) == pytest.approx((1e-4, 1e-8, 1e-5))
    assert IDA(rtol=1e-4, atol=[1e-8, 1e-6]).tolerances(model, sizes) == (1e-4, 1e-8, 1e-6)
    _, of_q, of_v = IDA(atol=np.arange(1.0, 2 * model.n + 1)).tolerances(model, sizes)
    assert of_q.tolist() == [*range(1, model.n + 1)] and of_v.tolist() == [*range(model.n + 1, 2 * model.n + 1)]
    with pytest.raises(InputError, match=f"atol of 5 entries must be a number, a pair .* or {2 * model.n} entries"):
        IDA(atol=np.ones(5)).tolerances(model, sizes)
    model.flexible = True  # its q has a smaller tolerance, which IDA must not refuse
    assert pi.solve(model, 1e-6, IDA(rtol=1e-12), q0=[1.0, 0.0]).success


@pytest.mark.parametrize("E", [1e11, 1e12])
def test_stiff_plates_take_no_more_steps_than_soft_ones(E):
    stiff = plates.double_plate(12, material=replace(plates.RUBBER, E=E)).build()
    run, right = (pi.solve(stiff, 1.0, member) for member in (IDA(rtol=1e-5, max_num_steps=3000), pi.RadauIIA(rtol=1e-7)))
    assert run.success and run.counts.steps < 1000 and run.counts.rejected < 20
    assert np.abs(run.q[-1] - right.q[-1]).max() < 1e-3


class Swung(Model):
    """A mass on a rod whose end is driven along x, with friction; its inertia changes on the way."""

    n, m, shift = 2, 1, 0.3
    needs = Needs(driven=True)

    def mass(self, q):
        return np.array([[2.0 + 0.3 * q[0] ** 2, 0.1], [0.1, 1.0]])

    def force(self, t, q, v):
        return np.array([0.5 * v[0] * q[1], 9.81 + 0.2 * v[1] ** 2])

    def phi(self, t, q):
        return np.array([((q[0] - self.shift * np.sin(3.0 * t)) ** 2 + q[1] ** 2 - 1.0) / 2.0])

    def phi_q(self, t, q):
        return np.array([[q[0] - self.shift * np.sin(3.0 * t), q[1]]])


class Tied(Model):
    """Two masses on springs that move together: nothing of M and B changes, and no force depends on v."""

    n, m = 2, 1
    needs = Needs(False, False, False, False)

    def mass(self, q):
        return np.diag([1.0, 2.0])

    def force(self, t, q, v):
        return np.array([1.0, 9.0]) * q

    def phi(self, t, q):
        return q[:1] - q[1:]

    def phi_q(self, t, q):
        return np.array([[1.0, -1.0]])


OWN = {"swung": Swung, "tied": Tied, "free": Oscillator, "swung compiled": type("SwungCompiled", (Swung,), {"by_numba": True})}


def correction(model, form, linear, t, cj, y=None):
    """A Correction that expects cj at t."""
    found = Correction(System(model, form, baumgarte_rate=5.0), Counts(), 5, linear)
    found.begin(t - 1 / cj, np.zeros(found.system.size) if y is None else y)
    return found


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", ["pendulum", "car-axis", "andrews", *OWN])
def test_the_compiled_table_gives_the_residual_and_correction_of_callbacks(name, form):
    """In every form, with a factor of this state, and at the next iterate with the same one."""
    model, random, cj = guard(OWN[name]() if name in OWN else problems.get(name).model), np.random.default_rng(3), 40.0
    n, m = model.n, model.m
    y, yp = System(model, form, 5.0).pack(State(0.3, random.standard_normal(n), *(random.standard_normal(k) for k in (n, n, m))))
    general, small = (correction(model, form, linear, 0.3, cj, y) for linear in ("kkt", "auto"))
    right, found, F, F_small = (np.empty(len(y)) for _ in range(4))
    for k in range(2):
        at, rate = y + 1e-3 * k, yp + 1e-3 * random.standard_normal(len(y))
        assert general.residual(0.3, at, rate, right) and small.residual(0.3, at, rate, found)
        assert general.F(0.3, at, rate, F) and small.F(0.3, at, rate, F_small)
        assert np.abs(F_small - F).max() <= 1e-13 * np.abs(F).max()
        for part in np.split(np.arange(len(y)), [n, 2 * n]):
            assert np.abs(found - right)[part].max(initial=0.0) <= 1e-9 * np.abs(right[part]).max(initial=0.0)
    assert replace(general.counts, backend="") == replace(small.counts, backend="")


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", ["car-axis", "andrews"])
def test_the_correction_is_that_of_the_slope_of_the_residual(name, form):
    p, random, cj, small = problems.get(name), np.random.default_rng(3), 40.0, 1e-7
    linear = correction(p.model, form, "kkt", 0.0, cj)
    n, size = p.model.n, linear.system.size
    y, yp = linear.system.pack(consistent_state(p.model, 0.0, p.q0, p.v0))
    y, yp = y + small * random.standard_normal(size), yp + small * random.standard_normal(size)  # so near that phi does not bend
    d, F = np.empty((2, size))
    assert linear.residual(0.0, y, yp, d) and linear.F(0.0, y, yp, F)
    d, r = d / small, F / small
    step = 1e-4 / max(1.0, np.abs(d).max())
    residuals = np.empty((4, size))
    for k, factor_ in enumerate((1, -1, 2, -2)):
        linear.F(0.0, y + factor_ * step * d, yp + factor_ * step * cj * d, residuals[k])
    slope = (8 * (residuals[0] - residuals[1]) - (residuals[2] - residuals[3])) / (12 * step)
    for part in np.split(np.arange(size), [n, 2 * n]):
        assert np.abs(slope - r)[part].max() <= 2e-5 * np.abs(r[part]).max()


# bounds: some three times the error measured; its last digits follow the platform's round-off through step control
@pytest.mark.parametrize(
    "name, form, tolerance, of_q, of_lam",
    [
        ("pendulum", "ggl2", 1e-8, 3e-5, 3e-4),
        ("pendulum", "ggl1", 1e-8, 2e-5, 3e-4),
        ("car-axis", "ggl2", 1e-8, 1e-6, 1e-7),
        ("car-axis", "ggl1", 1e-8, 2e-6, 1e-7),
        ("andrews", "ggl2", 1e-8, 2e-5, 2e-3),
        ("andrews", "ggl1", 1e-8, 2e-5, 2e-3),
    ],
)
def test_published_digits(name, form, tolerance, of_q, of_lam):
    p, states, counts, error = run_problem(name, IDA(rtol=tolerance, atol=(tolerance, tolerance), form=form))
    assert states[-1].t == p.t_end
    assert error["q"] < of_q and error["lam"] < of_lam
    drift = max(np.abs(p.model.phi(s.t, s.q)).max() for s in states)
    assert drift < 10 * tolerance * max(1.0, np.abs(p.reference["q"]).max())
    assert counts.steps == len(states) <= counts.residuals and counts.factorizations < counts.solves


@pytest.mark.parametrize(
    "name, form", [*(("pendulum", form) for form in ("index2", "index1", "baumgarte")), ("car-axis", "index1"), ("andrews", "index2")]
)
def test_forms_of_lower_index(name, form):
    error = run_problem(name, IDA(rtol=1e-7, atol=(1e-8, 1e-8), form=form))[3]
    assert error["q"] < 1e-3


def turned_bar(motor):
    """A bar of 1 m and 1 kg whose hinge a motor turns by motor(t), with its weight: at a constant speed w the torque is m g l/2 cos(w t)."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = scene.add(pi.RigidBody.bar(1.0, 1.0, name="bar"))
    scene.add(pi.Revolute(pi.ground, bar.at("left"), name="hinge"))
    scene.add(pi.AngleMotor(pi.ground, bar.at("left"), motor, name="motor"))
    return scene.build()


@pytest.mark.parametrize("speed", [20.0, 32.0])
def test_no_very_short_step_is_left_before_the_times_at_which_steps_end(speed):
    """A motor given in Python: steps end every 1/64 s. A step of 1e-10 of the one before had multipliers of 1e4 times their size."""
    run = pi.solve(turned_bar(lambda t: speed * t), 1.0, pi.IDA(rtol=1e-8))
    steps = np.diff(run.t)
    assert (steps[1:] / steps[:-1]).min() > 0.4
    assert np.abs(run.reaction("motor")[:, 0] - 4.905 * np.cos(speed * run.t)).max() < 1e-2


def test_steps_do_not_depend_on_the_unit_of_mass():
    """Multipliers are not in the error estimate, however large they are: with 2^60 kg the forces in the hinge are 1e19 N."""
    runs = []
    for mass in (1.0, 2.0**60):
        scene = pi.Scene(gravity=(0.0, -9.81))
        bar = scene.add(pi.RigidBody.bar(1.0, mass))
        scene.add(pi.Revolute(pi.ground, bar.at("left")))
        runs.append(pi.solve(scene.build(), 1.0, pi.IDA(rtol=1e-6)))
    assert runs[0].steps == runs[1].steps and np.abs(runs[0].q[-1] - runs[1].q[-1]).max() < 1e-8


@pytest.mark.parametrize(
    "form, linear", [("index1", "auto"), ("baumgarte", "auto"), ("index1", "kkt"), ("index2", "whole"), ("ggl2", "whole")]
)
def test_multipliers_are_right_where_phi_q_turns(form, linear):
    """Forms that keep phi_q of the factor: the error of multipliers grew to 1e9 N."""
    run = pi.solve(turned_bar(pi.profile.polynomial([0.0, 4.0])), 1.0, pi.IDA(rtol=1e-7, form=form, linear=linear))
    assert np.abs(run.reaction("motor")[:, 0] - 4.905 * np.cos(4.0 * run.t)).max() < 1e-4


@pytest.mark.parametrize("form", ["ggl2", "ggl1"])
def test_second_multiplier_vanishes_beside_the_velocity(form):
    p, states, _, _ = run_problem("car-axis", IDA(rtol=1e-8, atol=(1e-8, 1e-8), form=form))
    correction = max(np.abs(p.model.phi_q(s.t, s.q).T @ s.memory["mu"]).max() for s in states)
    assert correction < 1e-4 * max(np.abs(s.v).max() for s in states)


def test_what_sundials_says_goes_into_the_message_and_what_a_model_prints_is_kept(capsys):
    class Blind(Oscillator):
        def force(self, t, q, v):
            print("asked")
            return np.full(2, np.nan)

    state = State(0.0, np.ones(2), np.zeros(2), np.zeros(2), np.zeros(0))
    with pytest.raises(StepFailure, match="corrector convergence failed repeatedly") as failure:
        list(IDA().steps(Blind(), state, 1.0, Counts()))
    assert failure.value.t == 0.0 and failure.value.status == "newton"
    assert set(capsys.readouterr().out.split("\n")) == {"asked", ""}


def test_a_flag_without_text_ends_the_run_with_its_frames(monkeypatch):
    """The binding raises KeyError for a flag of SUNDIALS that it does not know; a user's own KeyError stays one."""

    class Breaks(Oscillator):
        def force(self, t, q, v):
            return super().force(t, q, v) if t < 0.5 else np.full(2, np.nan)

    class Raises(Oscillator):
        def force(self, t, q, v):
            return super().force(t, q, v) if t < 0.5 else {}[-4]

    monkeypatch.delitem(sksundae._cy_ida.IDAMESSAGES, -4)
    run = pi.solve(Breaks(), 1.0, IDA(), q0=np.ones(2))
    assert run.status == "ida" and "force" in run.message and 0.4 < run.t[-1] < 0.5
    with pytest.raises(KeyError):
        pi.solve(Raises(), 1.0, IDA(), q0=np.ones(2))


def test_index3_stops_at_the_cap():
    p = problems.get("andrews")
    with pytest.raises(StepFailure) as failure:
        run(p.model, IDA(form="index3", max_num_steps=300), p.t_end, p.q0, p.v0)
    assert failure.value.status == "too many steps" and failure.value.seen["steps"] == 300
    assert failure.value.seen["worst constraint"].startswith("phi[")


@pytest.mark.parametrize("form", ["ggl2", "ggl1", "index2"])
def test_a_jump_of_driven_velocity_at_start_middle_and_end(form):
    at = (0.0, 0.25, 0.75)

    def path(t):
        return np.interp(t, at, (0.0, 0.5, -0.5))

    def rate(t):
        return 0.0 if t <= 0 or t >= 0.75 else 2.0 if t < 0.25 else -2.0

    states, counts = run(Driven(path, rate, lambda t: 2.0, at), IDA(form=form, rtol=1e-8, atol=1e-10), 0.75)
    where = {s.t: s for s in states}
    assert where[0.25].v[0] == pytest.approx(2.0, abs=1e-6) and where[0.75].v[0] == pytest.approx(-2.0, abs=1e-6)
    assert where[0.75].q == pytest.approx([-0.5, 0.75**2 / 2], abs=1e-6) and counts.rejected == 0


@pytest.mark.parametrize("form", ["ggl2", "index3"])
def test_a_run_into_a_collapse_keeps_instants_of_their_own_and_finite_works(form):
    """IDA tries steps below the round-off of t there: they are no frames, and nothing overflows (the suite takes warnings for errors)."""
    model = plates.double_plate_motors(4, material=pi.Material(1e5, 0.3, 1100.0)).build()
    run = pi.solve(model, 0.5, pi.IDA(form=form))
    assert run.status in ("objection", "newton") and 0.4 < run.t[-1] < 0.5
    assert np.diff(run.t).min() > 0 and all(np.isfinite(work).all() for work in run.energy.work.values())


def test_counts_at_a_stop_do_not_depend_on_how_long_a_stretch_takes(monkeypatch):
    counts = []
    for seconds in (0.0, 60.0):
        monkeypatch.setattr(run_of_ida, "LONGEST", seconds)
        p = problems.get("pendulum")
        run = pi.solve(p.model, 1.0, pi.IDA(), q0=p.q0, v0=p.v0, until=lambda t, q, v: q[0] - 0.5)
        assert run.status == "stopped" and run.counts.residuals > run.counts.steps
        counts.append(run.counts)
    assert counts[0] == counts[1]


def test_a_state_whose_step_is_past_is_interpolated_by_the_cubic():
    """The polynomial of IDA is that of its last step."""
    problem = problems.get("pendulum")
    state = consistent_state(problem.model, 0.0, problem.q0, problem.v0)
    memories = {}, {"polynomials": 1.0}
    plain, steps = (list(IDA(rtol=1e-6).steps(problem.model, replace(state, memory=memory), 0.3, Counts())) for memory in memories)
    for k, least, most in ((2, 0.0, 0.0), (-2, 1e-15, 1e-5)):
        t = 0.5 * (steps[k].t + steps[k + 1].t)
        apart = np.abs(between(steps[k], steps[k + 1], t).q - between(plain[k], plain[k + 1], t).q).max()
        assert least <= apart <= most
