"""The performance studies: their counts, what they compare, and how figures follow from rows. No times are judged."""

import importlib.util
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import polyida
from against_peers import against as against_gains
from against_peers import gain, peers
from polyida.errors import InputError
from polyida.integrate.ida.forms import System
from polyida.integrate.ida.integrator import IDA
from polyida.integrate.ida.linear import Correction
from polyida.integrate.state import Counts
from polyida.problems import plates
from polyida.run.solve import solve
from skip import savings
from step_cost import against, frames, measure, pair, told_cj, waits

SMALL = 120


def script(name):
    """A script of studies/ as a module."""
    spec = importlib.util.spec_from_file_location(f"study_{name}", Path(__file__).parents[2] / "studies" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


against_peers, of_cost, of_skip, of_start = map(script, ("against_peers", "step_cost", "skip", "start"))


@pytest.fixture(scope="module")
def model():
    return measure.model_of("scene 1", SMALL)


@pytest.mark.parametrize("dof", [1_000, 9_000])
def test_meshes_have_the_size_asked_for(dof):
    assert measure.model_of("scene 1", dof).n == pytest.approx(dof, rel=0.05)


@pytest.mark.parametrize("case", ["chain_2", "pendulum", "andrews"])
def test_ida_takes_the_same_steps_whether_cj_is_told_or_guessed(case):
    row = told_cj.told_row(case, 1)
    assert all(row[key] == row[f"told_{key}"] for key in ("steps", "residuals", "factorizations", "rejected"))
    assert row["apart"] < 1e-8


@pytest.mark.parametrize("integrator", ["alpha", "ida", "radau"])
def test_a_steps_row_counts_what_lies_between_the_two_runs(integrator):
    row = measure.step_row("scene 1", SMALL, integrator, 0.01, 0.03, 1)
    assert row["steps"] > 0 and row["newton_iterations_per_step"] >= 1
    assert row["ms_per_iteration"] == pytest.approx(row["ms_per_step"] / row["newton_iterations_per_step"])
    if integrator == "alpha":
        assert row["steps"] == 20 and row["factorizations_in_all"] == 1 and row["tangents_per_step"] == 0
        assert row["ms_per_step"] == pytest.approx(sum(row[f"{part}_ms"] for part in of_cost.PARTS))


@pytest.mark.parametrize("backend", measure.BACKENDS)
def test_every_back_end_solves_the_same_system(backend):
    try:
        row = measure.floor_row(SMALL, backend, 1)
    except peers.Missing as missing:
        pytest.skip(str(missing))
    assert row["relative_residual"] < (1e-3 if backend in ("fronts", "pardiso single") else 1e-10)


@pytest.mark.parametrize("backend", pair.BACKENDS)
def test_both_factors_of_a_pair_solve_their_systems(backend):
    row = pair.pair_row(SMALL, backend, 1)
    assert row["relative_residual"] < (1e-3 if backend == "fronts" else 1e-10)
    assert row["floor_ms"] == pytest.approx(row["factor_ms"] + 3 * row["solve_ms"])


@pytest.mark.parametrize("streams", [False, True])
def test_runs_with_and_without_frames_are_the_same_work(streams, monkeypatch):
    row = frames.frames_row("frames_over_none_1e3", SMALL, 30, 2, streams)
    assert row["n"] == measure.model_of("scene 1", SMALL).n and row["ratio"] > 0
    real = frames.solve
    monkeypatch.setattr(
        frames, "solve", lambda model, t_end, integrator, **rest: real(model, t_end * (1.1 if rest else 1.0), integrator, **rest)
    )
    with pytest.raises(RuntimeError, match="2 and 31 frames"):
        frames.frames_row("frames_over_none_1e3", SMALL, 30, 1, False)


def test_figures_of_frames_are_those_of_their_rows():
    rows = [{"part": "frames"} | task for task in frames.tasks(True)]
    rows = [
        row | {"ratio": 1.0 + 0.1 * k, "first_ratio": 1.5, "extra_us": 2.0, "none_ms": 0.1, "new_memory_us": 1.0}
        for k, row in enumerate(rows)
    ]
    found = of_cost.figures(rows)
    assert found["frames_over_none_1e3"] == 1.0 and found["hdf5_over_none_1e4"] == 1.3 and set(found) <= set(of_cost.HEADLINE)
    assert any("hdf5_over_none_1e4: 1.3, aim at most 1.25" in note for note in of_cost.aim_notes(rows))
    assert "frames_over_none_1e4: 1.100; 2 us a frame" in " ".join(frames.notes(rows))


def slope(residual, y, yp, along_y, along_yp):
    s = 1e-6
    return (residual(y + s * along_y, yp + s * along_yp) - residual(y - s * along_y, yp - s * along_yp)) / (2 * s)


def test_the_whole_jacobian_is_the_slope_of_the_residual(model):
    system, jacobian, cj = System(model, "ggl2", 0.0), peers.WholeJacobian(model), 30.0
    equations = Correction(system, Counts(), 5)
    random = np.random.default_rng(1)

    def residual(y, yp):
        res = np.empty(system.size)
        equations.F(0.0, y, yp, res)
        return res

    y, yp = 1e-3 * random.standard_normal((2, system.size))
    direction, values = random.standard_normal(system.size), np.empty(jacobian.pattern.nnz)
    jacobian(0.0, y, yp, None, cj, values)
    matrix = jacobian.pattern.copy()
    matrix.data[:] = values
    expected = slope(residual, y, yp, direction, cj * direction)
    assert np.abs(matrix @ direction - expected).max() < 1e-6 * np.abs(expected).max()
    assert matrix.indices.dtype == np.int32


def test_the_whole_jacobian_refuses_motors():
    with pytest.raises(InputError, match="motors"):
        peers.WholeJacobian(plates.double_plate_motors(4).build())


@pytest.mark.parametrize("scene", measure.SCENES)
def test_both_jacobians_of_the_first_order_form_are_slopes(scene):
    first, random = peers.FirstOrder(measure.model_of(scene, SMALL)), np.random.default_rng(2)
    y, yp, direction = np.array([[1e-3], [1e-3], [1.0]]) * random.standard_normal((3, first.system.size))
    zero = np.zeros_like(y)
    for matrix, along in zip(first.jacobians(0.3, y, yp), ((direction, zero), (zero, direction))):
        expected = slope(lambda a, b: first.residual(0.3, a, b), y, yp, *along)
        assert np.abs(matrix @ direction - expected).max() < 1e-5 * np.abs(expected).max()


def test_the_sparse_solver_takes_the_same_steps(model):
    run = solve(model, 5e-3, IDA(rtol=1e-5))
    other = measure.run_isolated(measure.sparse_alone, {"dof": SMALL, "t_end": 5e-3}, 60.0)
    assert not other["error"] and abs(other["steps"] - run.counts.steps) <= 3


@pytest.mark.parametrize("solver", ["solve_dae", "exudyn", "exudyn modified"])
def test_peers_find_the_same_motion(model, solver):
    look, times = against_peers.tip_of(model), np.linspace(0.0, 0.02, 3)
    own = solve(model, times[-1], against_peers.GeneralizedAlpha(h=2e-4), output=times).position("tip")
    try:
        if solver == "solve_dae":
            _, seen = peers.radau(model, times, 1e-5, look)
        else:
            _, seen = peers.ExudynScene(model, look).run(times, 1e-3, solver != "exudyn")
    except peers.Missing as missing:
        pytest.skip(str(missing))
    assert np.abs(seen - own).max() < 2e-5


SAVED = {
    "constant mass",
    "linear joints",
    "no motors: phi_t, bias",
    "no motors: reaction_q",
    "no damping: dg/dv",
    "no border",
    "stale matrix",
    "factor kept",
    "single precision",
    "shared operator",
    "no energies, no stresses",
    "no frames",
    "rest",
    "rest, residuals",
    "no frames: v",
    "no frames: a, lam",
}


@pytest.mark.parametrize("saving", savings.SAVINGS)
def test_a_saving_that_is_switched_off_is_counted(saving):
    row = savings.measure(saving, 6, 0.01, 1)
    assert row["count_off"] > row["count_on"] if saving in SAVED else row["count_off"] >= row["count_on"] > 0


@pytest.mark.parametrize("saving", ["co-rotated factor", "stale matrix", "factor kept", "compiled stretches"])
def test_a_row_of_an_engine_differs_in_one_switch(saving):
    """Both sides are the same settings, and their motions agree to Newton's tolerance: what is switched off is work alone."""
    on, off = savings.ENGINES[saving]
    one, other = (replace(side, engine=savings.Steps) if isinstance(side, savings.Driven) else side for side in (on, off))
    assert all(getattr(one, field.name) == getattr(other, field.name) for field in fields(savings.GeneralizedAlpha))
    model = plates.double_plate(6).build()
    ends = [solve(model, 0.1, side, every=10**9).position("tip")[-1] for side in (on, off)]
    assert np.abs(ends[0] - ends[1]).max() < 1e-6


def test_a_factor_that_does_not_turn_is_made_anew():
    model = plates.double_plate(6).build()
    turned, fixed = (solve(model, 0.4, side, every=10**9).counts for side in savings.ENGINES["co-rotated factor"])
    assert turned.factorizations == 1 < fixed.factorizations


def work_precision(solver, scale):
    case = {"scene": "scene 1", "dof": 800, "solver": solver}
    return [case | {"setting": h, "error_max": h**2, "cpu_s": scale / h, "steps": 1 / h} for h in (1e-2, 1e-3)]


def test_figures_compare_at_equal_error():
    rows = [{"scene": "scene 1", "dof": 800, "solver": "reference", "n": 800, "reference_doubt": 1e-9}]
    rows += work_precision("alpha", 1e-4) + work_precision("ida", 3e-4) + work_precision("radau", 5e-5) + work_precision("solve_dae", 2e-3)
    rows += [{"scene": "scene 1", "dof": 800, "solver": "exudyn", "setting": 1, "skipped": "exudyn is not installed"}]
    found = against_peers.figures(rows)
    assert found["ida_over_alpha_at_1e-5"] == pytest.approx(3.0)
    assert [found["scene1_800_peer_ratio"], found["scene1_800_radau_peer_ratio"]] == pytest.approx([40.0, 40.0])
    assert found["scene1_800_cpu_s"] == pytest.approx(0.05) and "scene1_800_exudyn_cpu_s" not in found
    assert any("not installed" in line for line in against_peers.notes(rows))


def of_solver(solver, scale, loads):
    """Points whose errors are the squares of their steps, with a round for each load of the machine."""
    return [{"solver": solver, "setting": h, "error_max": h**2, "cpu_s": [scale * load / h for load in loads]} for h in (1e-2, 1e-3, 1e-4)]


def test_a_gain_is_the_median_of_the_rounds_at_equal_errors():
    """What slows both down in a round leaves its ratio as it is; equal steps and error control are one front."""
    loads = (1.0, 1.4, 2.0)
    points = of_solver("alpha", 6e-4, loads) + of_solver("radau", 2e-4, loads) + of_solver("radau fixed", 1e-3, loads)
    rows = [{"scene": "scene 1", "points": points + of_solver(gain.BEFORE, 4e-4, loads), "n": 12, "reference_doubt": 1e-9}]
    found = against_gains.figures(rows)
    assert found["radau_gain_2e-6"] == pytest.approx(3.0) and found["radau_gain_2e-6_before"] == pytest.approx(2.0)
    assert found["radau_gain_2e-6_s"] == pytest.approx(2e-4 * 1.4 / 2e-6**0.5) and "radau_gain2_1e-5" not in found
    assert np.isfinite(found["radau_gain_3e-8"]) and any("DOP853" in line for line in gain.notes(rows))


def test_the_points_of_a_round_are_measured_against_a_family_of_its_own(monkeypatch):
    few = [("alpha", 2e-3), ("radau", 1e-4), ("radau fixed", 2.5e-2)]
    monkeypatch.setattr(gain, "settings", lambda scene: few)
    monkeypatch.setattr(gain, "TIMES", np.linspace(0.0, 0.05, 11))
    monkeypatch.setattr("against_peers.own.TIMES", np.linspace(0.0, 0.05, 11))
    gain.reference.cache_clear()
    row = gain.in_rounds("scene 1", 60, 2)
    gain.reference.cache_clear()
    assert [(point["solver"], point["setting"]) for point in row["points"]] == few
    assert all(10 * row["reference_doubt"] < point["error_max"] < 1e-4 and len(point["cpu_s"]) == 2 for point in row["points"])


def test_growth_and_floor_come_from_their_rows():
    step = {"part": "step", "scene": "scene 1", "integrator": "alpha"}
    step |= {"residual_ns_per_dof": 1.0, "residual_tangent_ns_per_dof": 2.0}
    rows = [step | {"dof": n, "n": n, "ms_per_step": 1e-4 * n**1.2} for n in (1_000, 10_000, 100_000)]
    rows += [
        {"part": "floor", "dof": 1_000, "backend": name, "factor_ms": ms, "solve_ms": 0.0, "floor_ms": ms}
        for name, ms in (("fronts", 2.0), ("band", 1.0))
    ]
    found = of_cost.figures(rows)
    assert found["growth_exponent"] == pytest.approx(1.2)
    assert found["alpha_step_over_floor_1e3"] == pytest.approx(1e-4 * 1_000**1.2)


def test_a_wait_is_the_median_of_those_after_the_first(monkeypatch):
    seconds = [(9.0, 9.0), (1.0, 2.0), (5.0, 6.0), (2.0, 3.0)]
    monkeypatch.setitem(waits.WAITS, "comparison", lambda folder: lambda k: seconds[k])
    row = waits.wait_row("comparison", 3)
    assert row == {"wall_s": 2.0, "cpu_s": 3.0, "first_s": 9.0}
    found = of_cost.figures([{"part": "wait", "what": "comparison"} | row])
    assert found == {"compare_wall_s": 2.0, "compare_cpu_s": 3.0}


def test_a_command_that_is_waited_for_must_end_well(tmp_path):
    wall, cpu = waits.command("run", "pendulum", "--time", 0.01, "--out", tmp_path / "run.h5")
    assert wall > 0 and cpu > 0 and (tmp_path / "run.h5").is_file()
    with pytest.raises(RuntimeError, match="no such file"):
        waits.command("animate", tmp_path / "none.h5")


def test_the_largest_figure_has_its_panels_in_both_files(tmp_path):
    paths = waits.panels_written(tmp_path)
    assert [path.suffix for path in paths] == [".png", ".pdf"] and all(path.stat().st_size for path in paths)
    assert paths[1].read_bytes().count(b"/FontFile2") == 1


@pytest.mark.parametrize("study", [against_peers.study, of_cost.study, of_skip.study, of_start.study])
def test_a_study_has_distinct_tasks_and_a_smaller_selection(study):
    for quick in (True, False):
        tasks = [tuple(task.items()) for task in study.tasks(quick)]
        assert len(set(tasks)) == len(tasks)
    assert len(study.tasks(True)) <= len(study.tasks(False))


@pytest.fixture(scope="module")
def now():
    """A side of a comparison with this package in it."""
    with against.Side(Path(polyida.__file__).parents[1], 4, "alpha", 0.01, 0.05) as side:
        yield side


def test_a_side_of_a_pair_times_as_many_steps_as_it_was_asked_for(now):
    row = now()
    assert row["steps"] == 40 and row["newton_iterations"] >= 1 and np.isfinite(row["ms_per_step"])


def test_a_ratio_is_that_of_now_over_before(monkeypatch, tmp_path):
    """Each pair has its own: what the machine does to both sides of one does not move the median."""

    class Side:
        about = {"n": 12}

        def __init__(self, tree, *arguments):
            self.cost, self.load, self.tree = 2.0 if tree == tmp_path else 3.0, 1.0, tree

        def __call__(self):
            self.load *= 1.5
            return {"ms_per_step": self.cost * self.load, "steps": 10, "newton_iterations": 1.0, "factorizations": 0.0}

        def __enter__(self):
            return self

        def __exit__(self, *exception):
            pass

    monkeypatch.setattr(against, "Side", Side)
    monkeypatch.setattr(against, "exported", lambda commit: SimpleNamespace(name=tmp_path))
    row = against.measured("step_over_before_1e3", "any")
    assert [row[name] for name in ("ratio", "lowest", "highest")] == pytest.approx([1.5] * 3) and row["pairs"] == 21
    assert against.figures([{"figure": "step_over_before_1e3"} | row]) == {"step_over_before_1e3": pytest.approx(1.5)}
    assert any("aim at most" in line for line in against.notes([{"figure": "step_over_before_1e3"} | row]))


def test_no_other_package_is_measured_than_the_folders_own(tmp_path):
    """The one that is installed, where there is one, is not taken for it."""
    with pytest.raises((ImportError, ChildProcessError)):
        against.Side(tmp_path, 4, "alpha", 0.01, 0.05)


@pytest.mark.skipif(not (Path(__file__).parents[2] / ".git").exists(), reason="no clone")
def test_the_package_of_a_commit_is_taken_as_it_was():
    commit = against.whole_name("HEAD")
    assert len(commit) == 40 and (Path(against.exported(commit).name) / "polyida" / "__init__.py").exists()
    study = of_cost.study.options["against"][1]("HEAD")
    assert [task["figure"] for task in study.tasks(True)] == [name for name in against.PAIRS if "1e5" not in name]
    with pytest.raises(InputError, match="no clone that has such a commit"):
        against.whole_name("no-such-commit")


def test_a_start_fills_its_own_cache_and_the_next_one_finds_it(tmp_path):
    """The second process adds no kernel; parts are no more than what the process used."""
    (tmp_path / "own.py").write_text("from polyida.jit import entry\n\n\n@entry\ndef plus_one(x):\n    return x + 1.0\n")
    parts = {"import": "import polyida", "build": "import own", "run": "assert own.plus_one(1.0) == 2.0"}
    kept = []
    for _ in range(2):
        row = of_start.started(parts, tmp_path)
        kept.append({path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.nb?")})
        assert 0 < sum(row[f"{part}_s"] for part in parts) < row["cpu_s"] + 0.1
    assert kept[0] == kept[1] and any(path.suffix == ".nbc" for path in kept[0])
    with pytest.raises(ChildProcessError, match="ZeroDivisionError"):
        of_start.started({"run": "1 / 0"}, tmp_path)
