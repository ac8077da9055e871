"""pi.study as a library: rows, orders, references, reports, of models, scenes, problems and integrators of a user's own."""

import json
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.linalg import expm

import polyida as pi
from polyida.errors import InputError, StepFailure
from polyida.problems.equations import Pendulum
from polyida.study.comparison import compare
from polyida.study.ivp import InitialValueProblem

STEPS = (1e-2, 5e-3, 2.5e-3)


@dataclass(frozen=True)
class Projected:
    """An integrator of a user's own, of order 1: v by a, then q by v, both put on the constraints."""

    h: float

    def steps(self, model, state, t_end, counts):
        count = round((t_end - state.t) / self.h)
        for k in range(1, count + 1):
            q = state.q + self.h * (state.v + self.h * state.a)
            q /= np.linalg.norm(q)
            v = (q - state.q) / self.h
            state = pi.consistent_state(model, t_end * k / count, q, v - q * (q @ v))
            counts.steps += 1
            yield state


@dataclass(frozen=True)
class Stops:
    """An integrator that stops half way."""

    h: float = 0.1

    def steps(self, model, state, t_end, counts):
        raise StepFailure("newton", "it does not converge", 0.5 * t_end)
        yield


def start():
    return {"q0": [1.0, 0.0]}


@pytest.fixture(scope="module")
def study():
    members = {
        "own": [Projected(h) for h in STEPS],
        "alpha": [pi.GeneralizedAlpha(h=h) for h in STEPS],
        "radau": [pi.RadauIIA(rtol=r) for r in (1e-4, 1e-6)],
    }
    return pi.study.work_precision(Pendulum(), 0.5, **start(), integrators=members)


def test_rows_say_what_ran_and_what_it_came_to(study):
    assert [row["integrator"] for row in study.rows] == ["own"] * 3 + ["alpha"] * 3 + ["radau"] * 2
    assert [row["setting"] for row in study.rows[:4]] == ["h=0.01", "h=0.005", "h=0.0025", "h=0.01"] and study.rows[-1][
        "setting"
    ] == "rtol=1e-06"
    assert [row["steps"] for row in study.rows[:6]] == [50, 100, 200] * 2 and all(row["status"] == "done" for row in study.rows)


def test_orders_are_those_of_the_methods(study):
    assert study.orders["own"]["q"] == pytest.approx(1.0, abs=0.15) and study.orders["alpha"]["q"] == pytest.approx(2.0, abs=0.05)
    assert study.orders["alpha"]["lam"] == pytest.approx(2.0, abs=0.05) and np.isnan(study.orders["radau"]["q"])


def test_the_reference_is_made_by_two_families_and_known_to_a_tenth_of_every_error(study):
    assert [how.split(",")[0] for how in study.reference["made_by"]] == ["Radau IIA", "DOP853 on the index-1 equations"]
    for part in ("q", "v", "lam"):
        assert study.known_to[part] <= 0.1 * min(row[f"error_{part}"] for row in study.rows)


def test_the_reference_is_right_as_far_as_it_is_known(study):
    """The pendulum's speed follows from its height: v^2 = -2 g y; its multiplier from both."""
    q, v, lam = (study.reference[part] for part in ("q", "v", "lam"))
    assert v @ v == pytest.approx(-2 * 9.81 * q[1], abs=50 * study.known_to["v"])
    assert lam[0] == pytest.approx(v @ v - 9.81 * q[1], abs=100 * study.known_to["v"])


def test_a_run_is_a_reference_of_unknown_precision():
    run = pi.solve(Pendulum(), 0.5, pi.RadauIIA(rtol=1e-10), **start())
    study = pi.study.work_precision(Pendulum(), 0.5, **start(), integrators={"alpha": pi.GeneralizedAlpha(h=1e-2)}, reference=run)
    assert study.rows[0]["error_q"] > 1e-6 and np.isnan(study.known_to["q"]) and "its accuracy is unknown" in str(study)


def test_problems_by_name_have_their_own_start_end_and_digits():
    study = pi.study.work_precision("pendulum", integrators={"radau": pi.RadauIIA(rtol=1e-8)})
    p = pi.problems.get("pendulum")
    assert study.reference["made_by"] == [p.source] and study.known_to["q"] == p.known_to["q"] and study.rows[0]["error_q"] < 1e-5
    shorter = pi.study.work_precision(p, 0.1, integrators={"radau": pi.RadauIIA(rtol=1e-8)})
    assert len(shorter.reference["made_by"]) == 2 and shorter.rows[0]["t"] == pytest.approx(0.1)


def test_a_run_that_stops_is_a_row_without_errors():
    study = pi.study.work_precision(Pendulum(), 0.5, **start(), integrators={"stops": Stops(), "alpha": pi.GeneralizedAlpha(h=1e-2)})
    assert study.rows[0]["status"] == "newton" and np.isnan(study.rows[0]["error_q"]) and study.rows[1]["error_q"] > 0
    assert any("stops" in note and "does not converge" in note for note in study.notes) and len(study.plot().lines) >= 1


def test_points_below_what_is_known_are_hollow_and_stand_at_it(study):
    blunt = type(study)("blunt", study.rows, [], study.reference | {"known_to": {"q": 1e-3, "v": 1e-3, "lam": 1e-3}})
    lines = {line.get_label(): line for line in blunt.plot("q").lines}
    below = [line for line in blunt.plot("q").lines if line.get_label() == "_below"]
    assert min(lines["radau"].get_ydata()) == 1e-3 and "accuracy of the reference" in lines
    assert sum(len(line.get_xdata()) for line in below) == sum(row["error_q"] <= 1e-3 for row in study.rows)
    assert all(line.get_markerfacecolor() == "white" for line in below)


def test_rows_as_a_data_frame_and_a_data_set(study):
    frame = study.to_dataframe()
    assert list(frame.columns)[:3] == ["integrator", "setting", "error_q"] and len(frame) == 8
    assert frame.groupby("integrator").error_q.min()["radau"] == study.rows[-1]["error_q"]
    assert study.to_xarray()["steps"].values.tolist() == [row["steps"] for row in study.rows]


def test_a_report_has_page_numbers_and_pictures_and_is_not_overwritten(study, tmp_path):
    folder = study.report(tmp_path / "report", command="python mine.py")
    data = json.loads((folder / "figures.json").read_text())
    assert [row["error_q"] for row in data["rows"]] == [row["error_q"] for row in study.rows] and data["command"] == "python mine.py"
    assert data["figures"]["order_q alpha"] == study.orders["alpha"]["q"] and "polyida" in data["machine"]
    page = (folder / "report.html").read_text()
    assert "DOP853 on the index-1 equations" in page and "python mine.py" in page
    assert {path.name for path in folder.iterdir()} >= {
        f"error-{part}.{kind}" for part in ("q", "v", "lam") for kind in ("png", "pdf", "csv")
    }
    with pytest.raises(InputError, match="has something in it"):
        study.report(folder)
    other = pi.study.Result([{"number": 7}])
    assert other.report(folder, overwrite=True) == folder and json.loads((folder / "figures.json").read_text())["rows"] == [{"number": 7}]


@dataclass(frozen=True)
class Euler:
    """An integrator with an iteration matrix of its own."""

    def steps(self, model, state, t_end, counts):
        yield from ()

    def iteration_matrix(self, model, state, h):
        return np.block([[model.mass(state.q) / h, model.phi_q(state.t, state.q).T], [model.phi_q(state.t, state.q), np.zeros((1, 1))]])


def test_condition_numbers_fall_as_theory_says():
    model = Pendulum()
    state = pi.consistent_state(model, 0.0, [1.0, 0.0])
    members = {
        "raw": lambda h: pi.GeneralizedAlpha(h=h, scaling="none"),
        "scaled": pi.GeneralizedAlpha(),
        "IDA": pi.IDA(form="index3", linear="whole", scaling="none"),
        "own": Euler(),
    }
    study = pi.study.conditioning(model, state, members, h=[10.0**-k for k in range(3, 9)])
    assert (
        len(study.rows) == 24 and study.slopes["raw"] == pytest.approx(-4, abs=0.05) and study.slopes["IDA"] == pytest.approx(-3, abs=0.1)
    )
    assert abs(study.slopes["scaled"]) < 0.05 and study.slopes["own"] == pytest.approx(-2, abs=0.05)
    assert len(study.plot().lines) == 4


def test_energy_and_drift_follow_whole_runs():
    members = {"alpha": pi.GeneralizedAlpha(h=1e-2), "energy-momentum": pi.EnergyMomentum(h=1e-2)}
    kept = pi.study.energy(Pendulum(), 2.0, **start(), integrators=members, frames=50)
    by_label = {row["integrator"]: row for row in kept.rows}
    assert by_label["energy-momentum"]["energy_drift"] < 1e-7 < by_label["alpha"]["energy_drift"]
    data = kept.to_xarray()
    assert data["unbalanced"].dims == ("run", "frame") and data.sizes == {"run": 2, "frame": 50} and float(data["t"].max()) == 2.0
    off = pi.study.drift(Pendulum(), 2.0, **start(), integrators=members | {"IDA": pi.IDA(rtol=1e-4)})
    assert all(row["drift"] < 1e-6 for row in off.rows) and off.plot("velocity_drift").get_yscale() == "log"
    assert np.isnan(off.to_xarray()["drift"].sel(run="IDA").values).sum() == 201 - off.rows[2]["steps"] - 1
    assert "unbalanced" in kept.pictures() and "drift" in off.pictures()


class Lagging(pi.Model):
    """A mass on a spring beside a spring and a damper in series: `x' = (q - x)/0.1`."""

    n, m, k = 1, 0, 1
    needs = pi.Needs(mass_varies=False)

    def mass(self, q):
        return np.eye(1)

    def force(self, t, q, v, x):
        return 13.0 * q - 9.0 * x

    def rates(self, t, q, v, x):
        return (q - x) / 0.1


def test_states_have_errors_and_orders():
    exact = expm(np.array([[0.0, 1.0, 0.0], [-13.0, 0.0, 9.0], [10.0, 0.0, -10.0]])) @ [0.0, 1.0, 0.0]
    study = pi.study.step_sizes(Lagging(), 1.0, v0=[1.0], integrators={"alpha": pi.GeneralizedAlpha}, h=(0.02, 0.01))
    run = pi.solve(Lagging(), 1.0, pi.GeneralizedAlpha(h=0.01), v0=[1.0])
    errors = [study.rows[1][f"error_{part}"] for part in "qvx"]
    assert errors == pytest.approx(np.abs([run.q[-1, 0], run.v[-1, 0], run.x[-1, 0]] - exact), rel=1e-4)
    assert study.orders["alpha"]["x"] == pytest.approx(2.0, abs=0.15) and 0 < study.known_to["x"] < 1e-3 * errors[2]
    given = {"q": exact[:1], "v": exact[1:2], "lam": [], "x": exact[2:]}
    same = pi.study.work_precision(Lagging(), 1.0, v0=[1.0], integrators={"alpha": pi.GeneralizedAlpha(h=0.01)}, reference=given)
    assert same.rows[0]["error_x"] == pytest.approx(errors[2], rel=1e-4) and "error in x" in str(same)
    with pytest.raises(InputError, match=r"reference\['x'\] must be 1 finite"):
        pi.study.work_precision(
            Lagging(), 1.0, v0=[1.0], integrators={"alpha": pi.GeneralizedAlpha(h=0.01)}, reference=given | {"x": [1.0, 2.0]}
        )
    rows = compare(InitialValueProblem("lag", Lagging(), 1.0, v0=[1.0]), integrators={"alpha": pi.GeneralizedAlpha(h=0.01)}).rows
    assert [rows[0]["states_end"], rows[0]["error_end"]] == pytest.approx([errors[2], errors[0]], rel=1e-4)
    assert rows[0]["states_max"] >= rows[0]["states_end"]


@pytest.mark.parametrize(("make", "order"), [(pi.GeneralizedAlpha, 2.0), (lambda h: pi.RadauIIA(h=h), 5.0)])
def test_orders_are_those_of_the_steps_that_were_used(make, order):
    h = np.array([0.09, 0.06, 0.051])  # in one second 12, 17 and 20 steps
    study = pi.study.step_sizes("pendulum", 1.0, integrators={"own": make}, h=h)
    assert [row["h"] for row in study.rows] == list(h) and [row["steps"] for row in study.rows] == [12, 17, 20]
    assert study.orders["own"]["q"] == pytest.approx(order, abs=0.1)
    assert study.plot("q").lines[0].get_xdata() == pytest.approx([1 / 12, 1 / 17, 1 / 20])


def test_errors_of_a_quantity_without_a_reference():
    def slopes(run):
        result = np.zeros(run.q.shape)
        result[-1, 0] = 1.0
        return {"q": result}

    place, start = pi.objective.UserObjective(lambda run: float(run.q[-1, 0]), slopes), {"q0": [1.0, 0.0]}
    integrators = {"alpha": [pi.GeneralizedAlpha(h=h, tolerance=1e-10) for h in (1e-2, 2.5e-3)], "Radau IIA": [pi.RadauIIA(rtol=1e-5)]}
    result = pi.study.work_precision(Pendulum(), 0.5, **start, integrators=integrators, reference=False, objective=place)
    coarse, fine, radau = result.rows
    exact = place(pi.solve(Pendulum(), 0.5, pi.RadauIIA(rtol=1e-11), **start))
    measured = abs(place(pi.solve(Pendulum(), 0.5, integrators["alpha"][0], **start)) - exact)
    assert coarse["error_J"] == pytest.approx(measured, rel=0.01) and coarse["estimated_J"] == pytest.approx(measured, rel=0.05)
    assert abs(result.reference["J"] - exact) <= result.known_to["J"] and np.isnan(coarse["error_q"])
    assert fine["estimated_J"] > radau["estimated_J"] > 0.0
    assert "error-J" in result.pictures() and "error in J, estimated" in str(result.shown_columns())
    with pytest.raises(pi.InputError, match="give an objective"):
        pi.study.work_precision(Pendulum(), 0.5, **start, integrators=integrators, reference=False)
