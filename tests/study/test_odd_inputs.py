"""pi.study on what users bring: no constraints, pulses that nobody announces, functions that raise, labels with dollars."""

from dataclasses import dataclass

import numpy as np
import pytest

import polyida as pi
from polyida.errors import InputError
from polyida.reprs import shown
from polyida.show.figure_files import csv
from polyida.study.ivp import initial_value_problem
from polyida.study.refinement import make_reference

STEPS = (1e-2, 5e-3)


class Spring(pi.Model):
    """1 kg on 100 N/m, without a constraint; raises: from when on its force does. pulse: when 1e5 N act for 1e-4 s."""

    n, m = 1, 0

    def __init__(self, raises=np.inf, pulse=np.inf, error=ArithmeticError):
        self.raises, self.pulse, self.error = raises, pulse, error

    def mass(self, q):
        return np.eye(1)

    def force(self, t, q, v):
        if t > self.raises:
            raise self.error("no force")
        return 100.0 * q - 1e5 * (self.pulse < t < self.pulse + 1e-4)


@dataclass(frozen=True)
class Leapfrog:
    h: float

    def steps(self, model, state, t_end, counts):
        t, q, v = state.t, state.q, state.v
        for t in np.linspace(t, t_end, round((t_end - t) / self.h) + 1)[1:]:
            half = v - self.h / 2 * model.force(t, q, v)
            q = q + self.h * half
            v = half - self.h / 2 * model.force(t, q, half)
            counts.steps += 1
            yield pi.State(t, q, v, -model.force(t, q, v), np.zeros(0))


def settings(make=pi.GeneralizedAlpha, steps=STEPS):
    return [make(h=h) for h in steps]


def test_a_model_without_constraints_has_orders_and_no_errors_of_multipliers():
    study = pi.study.work_precision(Spring(), 0.5, q0=[1.0], integrators={"own": settings(Leapfrog), "alpha": settings()})
    exact = np.cos(5.0)
    assert abs(study.reference["q"][0] - exact) < 2 * study.known_to["q"] < 1e-9 and np.isnan(study.known_to["lam"])
    assert study.orders["own"]["q"] == pytest.approx(2, abs=0.1) and study.orders["alpha"]["v"] == pytest.approx(2, abs=0.1)
    assert np.isnan([row["error_lam"] for row in study.rows]).all() and not study.plot("lam").lines


def test_objects_without_a_repr_are_shown_by_their_numbers_and_texts():
    class Plain:
        def __init__(self, h, kind="own"):
            self.h, self.kind, self.work, self._calls = h, kind, np.zeros(3), 0

        def steps(self, model, state, t_end, counts):
            return Leapfrog(self.h).steps(model, state, t_end, counts)

    several = pi.study.step_sizes(Spring(), 0.5, q0=[1.0], integrators={"own": Plain}, h=(0.02, 0.01))
    assert [row["setting"] for row in several.rows] == ["h=0.02", "h=0.01"]
    alone = pi.study.drift(Spring(), 0.5, q0=[1.0], integrators={"own": Plain(0.01)})
    assert alone.rows[0]["setting"] == "Plain(h=0.01, kind='own')" == shown(Plain(0.01))


def test_what_has_no_energy_and_what_is_drawn_at_a_bound_are_told():
    kept = pi.study.energy(Spring(), 0.1, q0=[1.0], integrators={"own": Leapfrog(1e-2)})
    assert np.isnan(kept.rows[0]["energy_change"]) and "no `potential`" in kept.notes[0]
    off = pi.study.drift(Spring(), 0.1, q0=[1.0], integrators={"own": Leapfrog(1e-2)})
    assert off.pictures()["drift"][0] == "max |φ| against time, 1e-17 if it is less."


def test_integrators_that_stand_still_away_from_the_reference_are_told():
    study = pi.study.work_precision(Spring(pulse=0.277), 0.3, q0=[0.0], integrators={"own": settings(Leapfrog, (2e-5, 1e-5))})
    exact = 1e3 * (np.cos(10 * (0.3 - 0.2771)) - np.cos(10 * (0.3 - 0.277)))
    assert study.rows[-1]["error_q"] == pytest.approx(exact, rel=0.1) and study.known_to["q"] < 1e-3 * exact
    assert any(note.startswith("own: from 15000 to 30000 steps") and "missed a short pulse" in note for note in study.notes)
    calm = pi.study.work_precision(Spring(), 0.3, q0=[1.0], integrators={"own": settings(Leapfrog)})
    assert len(calm.notes) == 1 and "can miss a force" in calm.notes[0]  # of a force of one's own, that no kink announces


@pytest.mark.parametrize("error", [ArithmeticError, SystemExit, GeneratorExit])
def test_a_function_that_raises_is_a_row_and_the_others_are_kept(error):
    spring = Spring(raises=0.2, error=error)
    study = pi.study.work_precision(spring, 0.5, q0=[1.0], integrators={"alpha": settings()})
    assert [row["status"] for row in study.rows] == ["error"] * 2 and all(0 < row["t"] < 0.21 for row in study.rows)
    assert f"alpha, h=0.01: {error.__name__}: no force" in study.notes and any("no two methods" in note for note in study.notes)
    assert len(study.notes) == len(set(study.notes))
    assert pi.study.energy(spring, 0.5, q0=[1.0], integrators={"alpha": settings()[0]}).rows[0]["status"] == "error"


def test_errors_below_what_is_known_are_counted_in_a_note():
    reference = {"q": [np.cos(5.0)], "v": [-10 * np.sin(5.0)], "lam": [], "known_to": {"q": 1.0, "v": 1e-9}}
    study = pi.study.work_precision(Spring(), 0.5, q0=[1.0], integrators={"alpha": settings()}, reference=reference)
    assert study.notes == ["2 of 2 errors in q are below the reference's accuracy, 1.0e+00"]
    assert np.isnan(study.orders["alpha"]["q"]) and study.orders["alpha"]["v"] == pytest.approx(2, abs=0.1)


def test_labels_are_written_as_they_are(tmp_path, pages_alone):
    label = r"$\alp$ / é"
    for study in (
        pi.study.step_sizes(Spring(), 0.1, q0=[1.0], integrators={label: Leapfrog}, h=STEPS),
        pi.study.drift(Spring(), 0.1, q0=[1.0], integrators={label: Leapfrog(1e-2)}),
        pi.study.conditioning(Spring(), pi.consistent_state(Spring(), 0.0, [1.0]), {label: pi.GeneralizedAlpha}, h=STEPS),
    ):
        assert label in (study.report(tmp_path / type(study).__name__) / "report.html").read_text()
    same = pi.study.drift(Spring(), 0.1, q0=[1.0], integrators={name: Leapfrog(1e-2) for name in ("$x", "x")})
    assert csv(same.plot().figure).splitlines()[0] == '"t, s","max |φ| ($x)","max |φ| (x)"'
    with pytest.raises(InputError, match="does not begin with _"):
        pi.study.drift(Spring(), 0.1, q0=[1.0], integrators={"_hidden": Leapfrog(1e-2)})


def test_conditioning_draws_every_state_and_takes_problems_by_name():
    problem = pi.problems.get("pendulum")
    states = [pi.consistent_state(problem.model, 0.0, problem.q0), pi.solve(problem.model, 0.1, pi.IDA(), q0=problem.q0).state]
    study = pi.study.conditioning("pendulum", states, {"alpha": pi.GeneralizedAlpha}, h=STEPS)
    head = csv(study.plot().figure).splitlines()[0]
    assert "alpha, state 0" in head and "alpha, state 1" in head
    with pytest.raises(InputError, match="states has no state"):
        pi.study.conditioning("pendulum", [], {"alpha": pi.GeneralizedAlpha})
    with pytest.raises(InputError, match=r"integrators\['alpha'\] = 5 must be an integrator, or a class"):
        pi.study.conditioning("pendulum", states, {"alpha": 5})


def test_a_reference_is_not_said_to_be_known_better_than_it_is():
    """Over ten swings both methods fall behind: of one tolerance they were thirty times nearer to each other than to the truth."""
    p = pi.problems.get("pendulum")
    found = make_reference(initial_value_problem("study", p.model, p.t_end, p.q0), lambda values: {"q": 1.0, "v": 1.0, "lam": 1.0})
    for part, known in found["known_to"].items():
        assert known >= 0.9 * np.abs(found[part] - p.reference[part]).max() - p.known_to[part]


def test_values_of_any_size_are_shown_and_those_that_no_file_holds_are_refused(tmp_path):
    circular = []
    circular.append(circular)
    assert "about 10^5000" in str(pi.study.Result([{"a": 10**5000}]))
    pi.study.Result([{"a": 10**400}]).report(tmp_path / "large")
    assert "[[...]]" in str(pi.study.Result([{"a": circular}]))
    with pytest.raises(InputError, match="a value of the rows cannot be written"):
        pi.study.Result([{"a": circular}]).report(tmp_path / "page")
    with pytest.raises(InputError, match="command = 3 must be a text"):
        pi.study.Result([{"a": 1}]).report(tmp_path / "page", command=3)
