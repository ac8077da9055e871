"""All studies with rows that failed: table, notes, figures.json and what can be drawn come out all the same."""

import importlib.util
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from against_peers import gain
from designed_in_motion.machines import MACHINES
from least_weight import bracket
from mbb_beam.beam import mesh_of
from polyhedra.cases import SPIN
from polyida.cli import study as cli_study
from polyida.show import styles
from polyida.study import plotting
from polyida.study.result import StudyResult, _quick_note
from polyida.study.rows import fit_slope, number
from work_precision import tip_accuracy

FOLDER = Path(__file__).parents[2] / "studies"
BROKEN = {"error": "RuntimeError: it broke", "traceback": "where it broke"}
T = [0.0, 10.0, 13.0, 20.0]
MOST = 20  # rows of a study, about, each of which fails alone
REQUIRED = {
    "work_precision": {
        "andrews_alpha_best_error",
        "andrews_ida_best_error",
        "car_axis_ida_error_q",
        "car_axis_ida_error_lam",
        "newton_share",
        "ida_error_slope",
        "radau_order_q",
        "radau_order_v",
        "radau_order_lam",
        "radau_error_over_rtol",
    },
    "step_size_sensitivity": {"order_q", "order_v", "order_lam", "lam_error_h1e-9", "acceleration_error_h1e-9"},
    "conditioning": {"slope_unscaled", "scaled_condition_max"},
    "bdf_order": {"steps_order5_over_order2"},
    "energy": {"energy_momentum_relative_drift"},
    "nonsmooth": {"random_bouncing_energy_growth", "random_plastic_energy_growth"},
    "defaults": {"default_error_max", "default_error_min", "alpha_cpu_over_best_max"},
    "levels": {
        "reduced_gap_5",
        "reduced_gap_10",
        "reduced_spin_gap",
        "reduced_step_us_160",
        "reduced_step_us_4000",
        "reduced_speedup_4000",
        "reduction_s_4000",
    },
    "start": {"cold_alpha_cpu_s", "cold_main_job_cpu_s"},
    "gradient_over_run": {"gradient_over_run_1e3", "gradient_over_run_1e4", "several_over_one_1e3", "several_over_one_1e4"},
    "least_weight": {"arm_over_static", "rod_over_thickness"},
    "error_bars": {"missed", "false_alarms"},
    "polyhedra": {"patch", "energy", "gradient", "hinge_momentum"},
    "gradient_errors": {"gradient_error_default", "gradient_error_1e-10"},
    "designed_in_motion": {"design_gain_over_static", "design_wall_s"},
    "mbb_beam": {"mbb_compliance", "mbb_difference"},
    "mesh_convergence": {"elastica_1_error", "elastica_10_error", "csm1_error", "spin_up_extension_error"},
}


COSTS = {  # parts of the study of a step's cost, and what their rows hold
    "wait": "wall_s cpu_s first_s",
    "beside alpha": "ida_ms alpha_ms ratio residuals_per_step solves_per_step factorizations_per_step",
    "frames": "ratio first_ratio none_ms extra_us new_memory_us",
    "threads": "one_thread_ms two_threads_ms speedup lowest highest triad_one_gb_s triad_two_gb_s triad_speedup factor_mb limit halves_by_turns_ms halves_at_once_ms",
    "own functions": "python_us compiled_us ready_us",
    "told cj": "cpu_s ratio apart steps residuals factorizations rejected told_steps told_residuals told_factorizations",
}


def made_up(name, task):
    """A row's results of the right form, without a run."""
    h = task.get("x", task.get("h", 1e-3 / 2 ** task.get("halvings", 0))) or 1e-3
    size = 1e-6 if isinstance(h, list) else float(h)
    errors = {f"error_{part}": size**2 for part in ("q", "v", "a", "lam")}
    work = {
        "outcome": "done",
        "steps": 10,
        "cpu_s": 1e-3 / size,
        "residuals": 20,
        "factorizations": 2,
        "dof": int(task.get("through", 4)) ** 2,
    }
    if name == "work_precision" and task["problem"] in tip_accuracy.SCENES:
        tip = {"error_tip": size, "known_tip": 1e-12, "newton_tip": 1e-3 * size}
        return work | tip | {"known": {"tip": 1e-12}, "reference": "made up"}
    if name == "work_precision":
        return errors | work | {"steps": 1 / size, "known": {"q": 1e-12, "v": 1e-12, "lam": 1e-12}, "reference": "made up"}
    if name == "step_size_sensitivity":
        floors = {f"floor_{part}": 1e-20 for part in ("q", "v", "a", "lam")}
        return errors | floors | {"h": size, "outcome": "done", "iterations": 2.0, "stall_q": 1e-18 / size**2}
    if name == "conditioning":
        values = [1e-3] * len(task["h"])
        return {"values": values, "theory": 0, "slope": -4.0, "slope_limit": -4.0, "worst": 1e5, "at_1e-2": 1e-2, "at_1e-9": 1e-2}
    if name == "bdf_order":
        return work | {"steps_per_s": 40.0, "t_reached": 0.25, "tip_error": 1e-5, "t": T, "h": [1e-4] * 4, "rejected": 0}
    if name == "defaults":
        error = 1e-4 if task["x"] is None else 0.1 * task["x"]
        return work | {"cpu_s": 1e-5 / error, "error_max": error, "error_end": error, "size": 1.0, "known": {"q": 1e-9}, "summary": "done"}
    if name == "levels":
        costs = {
            "run": {"distance": 1e-5, "anywhere": 2e-5, "cpu_s": 1e-3 / size},
            "step": {"step_s": 1e-5},
            "reduction": {"reduction_s": 0.1},
        }
        return {"n": 28, "steps": 10, "iterations": 2.0, "outcome": "done"} | costs[task["part"]]
    if name == "energy":
        momentum = {"linear_drift": 1e-9, "angular_drift": 1e-9, "angular": [0.0, 1e-9, 1e-9, 1e-9]}
        return work | momentum | {"energy_drift": 1e-9, "energy_change": 1e-9, "t": T, "energy": [0.0, 1e-9, -1e-9, 2.0]}
    if name == "nonsmooth":
        off = dict.fromkeys(("touches_off", "leaves_off", "force_rms", "bottom_off", "place", "height", "penetration"), 1e-3)
        random = ("beyond_cone", "energy_growth", "energy_growth_in_all", "momentum_in_a_step", "momentum_in_all", "lowest_gap")
        curves = {"t": T, "energy": [0.0, 1e-9, 1e-9, 1e-9], "force": [0.0, 1.0, 0.0, 0.0], "bottom": [1.0, 0.0, 0.0, 1.0]}
        plate = dict.fromkeys(("cost_of_contact", "iterations_in_contact", "iterations_without", "solves_in_contact", "factors", "n"), 2)
        plate |= dict.fromkeys(("friction_over_none", "with_ms", "without_ms"), 2.0) | {
            "runs": 40,
            "stated": 1,
            "stops": 0,
            "far": 0,
            "apart": 1e-6,
        }
        return work | off | plate | dict.fromkeys(random, 1e-9) | curves | {"error_q": size, "events": 2, "energy_change": 1e-9}
    if name == "closed_chain":
        if task["side"] == "derive":
            return {"derive_s": 1.0, "first_s": 2.0}
        return {"runs": [{"setting": "made up", "outcome": "done", "cpu_s": 1e-4 / x, "error_rad": x} for x in (1e-5, 1e-7)]}
    if name == "mesh_convergence" and task["case"] in ("swing", "motor"):
        error = (1.0 if task["element"] == "quadratic" else 10.0) / task["cells"] ** 2
        return {"dof": task["cells"], "tip": [1.0, error], "cpu_s": 1e-3 * task["cells"], "step_cpu_s": 1e-6 * task["cells"]}
    if name == "mesh_convergence":
        moved = {"moved": [-7e-3, -66e-3], "bending_errors": [1e-3] * 3, "axial_errors": [1e-3] * 2, "compliance": 1.0 + size}
        return work | moved | {"deviation": 0.1 / task["through"] ** 2, "t": T, "u": [0.0, 1e-4, 5e-4, 5e-4], "w": [0.0] * 4}
    if name == "polyhedra":
        names = "deviation energy drift bending_error torsion_error momentum order step_over_iterations step_over_one iterations"
        conditions = {f"{method}_{scaling}": 1e5 for method in ("alpha", "radau", "ida") for scaling in ("scaled", "none")}
        times = dict.fromkeys(("residual_ms", "solve_ms", "factor_ms"), 1.0)
        curves = {"errors": [1e-3, 1e-4], "sizes": [1e-2, 1e-3], "tip": [0.0, size, 0.0], "n": 3 * task["cells"]}
        return work | dict.fromkeys(names.split(), 1e-9) | conditions | times | curves | task
    return performance(name, task)


def designed(task):
    """A design of the arm: bands of material along its edges."""
    mesh = MACHINES[task["machine"]].mesh(task["cells"])
    rho = (np.abs(mesh.cell_centroids[:, 1]) > 0.06) + 1.0 * (mesh.cell_centroids[:, 0] > 0.8)
    moved = {
        "J": 1e-5,
        "largest": 7e-3,
        "after": 1e-4,
        "torque": 50.0,
        "thickness": 0.01,
        "t": T,
        "off": [0.0, 1e-3, 7e-3, 1e-4],
        "torques": [[0.0, 1.0, 2.0, 0.0]],
    }
    if task["design"] in ("uniform", "bar"):
        return moved
    found = {"evaluations": 3, "first": 1e-3, "grey_J": 1e-5, "grey": 0.1, "at": 0.5, "wall_s": 1.0, "cpu_s": 1.0}
    return moved | found | {"history": [1e-3, 1e-4, 1e-5], "stages": [[0.45] * mesh.n_cells], "rho": rho.tolist()}


def weighed(task):
    """A design of the arm as above, or the rod."""
    costs = {"wall_s": 1.0, "cpu_s": 1.0, "message": "limits kept"}
    if task["part"] == "rod":
        ways = {f"{what}_{way}": value for way in ("thickness", "heights") for what, value in (("mass", 0.1), ("excess", 0.0))}
        ways |= {f"history_{way}": [0.2, 0.1] for way in ("thickness", "heights")}
        ways |= {f"message_{way}": "limits kept" for way in ("thickness", "heights")}
        ways |= {f"sizes_{way}": {"rod.thickness": 0.01} for way in ("thickness", "heights")}
        return costs | ways | {f"limits_{way}": {"PeakReaction pin": 300.0} for way in ("thickness", "heights")}
    mesh = bracket.mesh_of(task["cells"]) if task["part"] == "bracket" else MACHINES["arm"].mesh(task["cells"])
    rho = (np.abs(mesh.cell_centroids[:, 1]) > 0.06) + 1.0 * (mesh.cell_centroids[:, 0] > 0.8)
    columns = ("upper", "optimiser", "solid", "smaller steps")
    measures = {"mass": 1.0, "deviation": 1e-6, "torque": 1.0, "stress": 1.0}
    values = {f"{measure}_{column}": value for measure, value in measures.items() for column in columns}
    found = {
        "excess": 0.01,
        "at": 0.5,
        "grey": 0.1,
        "evaluations": 2,
        "history": [1.0, 0.9],
        "stages": [],
        "rho": np.minimum(rho, 1.0).tolist(),
        "solid": list(range(len(rho))),
    }
    found |= {"share": 0.5, "start_stress": 1.0}
    return costs | values | found


def performance(name, task):
    if name == "least_weight":
        return weighed(task)
    if name == "designed_in_motion":
        return designed(task)
    if name == "mbb_beam":
        elements = dict.fromkeys(("wachspress", "virtual") + ("bilinear",) * (task["mesh"] == "squares"), 234.0)
        made = {"compliance": 234.0, "used": 20, "settled": True, "grey": 0.3, "by_element": elements}
        return made | {"history": [1000.0 / (k + 1) for k in range(20)], "rho": [0.5] * mesh_of(task["mesh"]).n_cells}
    if name == "peers_table":
        return {"found": "seen", "version": "1.0", "says": "it was there"}
    if name == "skip":
        return {"off": "", "counted": "", "count_on": 1, "count_off": 2, "cpu_on_s": 1.0, "cpu_off_s": 2.0, "times": 2.0}
    if name == "stress":
        return {"outcome": "right", "checked": "drift", "deviation": 1e-12, "bound": 1e-9, "steps": 10, "status": "done", "reason": ""}
    if name == "start":
        times = ("cpu_s", "wall_s", "import_s", "build_s", "run_s")
        return {f"{cache}_{time}": 2.0 for cache in ("cold", "warm") for time in times}
    if name == "against_peers":
        setting = task["setting"]
        if task["solver"] == "rounds":
            points = [{"solver": s, "setting": x, "error_max": x**1.5, "cpu_s": [1e-4 / x]} for s, x in gain.settings(task["scene"])]
            return {"n": task["dof"], "reference_doubt": 1e-9, "points": points}
        if task["solver"] == "stiff":
            return {"n": task["dof"], "reference_doubt": 1e-9, "stiff_error": 1e-7}
        known = {"reference_doubt": 1e-8} if task["solver"] == "reference" else {"cpu_s": 1e-4 / setting, "steps": 1 / setting}
        return {"n": task["dof"], "error_max": 0.5 * setting**1.5, "error_end": setting**2} | known
    if name == "gradient_over_run":
        times = {f"{what}_us": 50.0 for what in ("run", "gradient", "sweep", "solve", "product")}
        counts = dict.fromkeys(("run_solves", "solves", "run_factorizations", "factorizations", "ratio"), 1.0)
        several = dict.fromkeys(("four_us", "apart_us", "several_over_one", "several_over_apart"), 2.0)
        return times | counts | several | {"n": task["dof"], "steps": 10, "stiffness_error": 1e-6, "mass_error": 1e-6}
    if name == "small_systems":
        if task["part"] != "step":
            return {"n": 2, "m": 1} | dict.fromkeys(
                ("alpha_us", "run_ms", "alpha_over_own", "alpha_over_loop", "radau_over_solve_dae"), 100.0
            )
        times = dict.fromkeys(("alpha_us", "exudyn_us", "radau_us", "energy_us"), 10.0 * task["size"])
        ratios = dict.fromkeys(("alpha_over_exudyn", "radau_over_alpha", "energy_over_alpha"), 1.0)
        return {"n": 4 * task["size"], "m": 3 * task["size"], "exudyn": "sparse, full Newton", "apart_m": 1e-8} | times | ratios
    if name == "error_bars":
        more = {"time": {"cost": 1.0, "steps": 10}, "modes": {"twice": 0.5}}.get(task["part"], {})
        made = {"exact_error": 1e-3, "estimate": 1e-3, "ratio": 1.0, "trusted": True, "outside": False, "fast_share": 0.1}
        return made | more
    if name == "gradient_errors":
        return {"n": 40, "steps": 10, "iterations": 2.0, "slope_error": task["tolerance"] or 1e-5, "stiffness": 1e-6}
    if task["part"] in COSTS:
        return {"n": 1000} | dict.fromkeys(COSTS[task["part"]].split(), 1.0)
    parts = {f"{part}_ms": 1.0 for part in ("residual", "tangent", "factor", "solve", "rest")}
    sizes = {f"{key}_bytes": 2**20 for key in ("imported", "built", "peak", "frame")}
    starts = {f"{how}_{what}_s": 1.0 for how in ("cold", "warm") for what in ("import", "mesh", "first_step", "start")}
    costs = {"n": task["dof"], "ms_per_step": 1e-3 * task["dof"], "newton_iterations_per_step": 1.0, "floor_ms": 1.0, "speedup": 5.0}
    costs |= {"factor_ms": 0.5, "solve_ms": 0.1, "ms_per_iteration": 1.0, "factorizations_in_all": 2}
    return (
        parts
        | sizes
        | starts
        | costs
        | {"steps": 10, "bytes_per_dof": 10.0, "residual_ns_per_dof": 1.0, "residual_tangent_ns_per_dof": 2.0}
    )


def study_of(name):
    spec = importlib.util.spec_from_file_location(f"study_{name}", FOLDER / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return getattr(module, "STUDY", None) or module.study


STUDIES = {path.stem: study_of(path.stem) for path in sorted(FOLDER.glob("*.py")) if path.stem != "digits"}


def rows_of(study):
    return [task | {"error": ""} | made_up(study.name, task) for task in study.tasks(True)]


def command(study, rows, folder, monkeypatch):
    """figures.json of the command line with these rows."""
    monkeypatch.setattr(cli_study, "run_tasks", lambda *given: rows)
    folder.mkdir(parents=True, exist_ok=True)
    return cli_study.main(study, ["--quick", "--out", str(folder)])


@pytest.mark.parametrize("name", STUDIES)
def test_all_rows_failed(name, tmp_path, monkeypatch, capsys, pages_alone):
    study = STUDIES[name]
    rows = [task | BROKEN for task in study.tasks(True)]
    with pytest.raises(SystemExit, match="failed"):
        command(study, rows, tmp_path, monkeypatch)
    data = json.loads((tmp_path / "figures.json").read_text())
    assert REQUIRED.get(name, set()) <= set(study.headline) <= set(data["figures"])
    assert all(data["figures"][key] is None for key in study.headline)
    assert sum(line.startswith("failed: ") for line in data["notes"]) == len(rows) == len(data["rows"])
    assert {"study", "figures", "notes", "rows", "machine", "command"} <= set(data) and data["study"] == study.name
    printed = " ".join(capsys.readouterr().out.split())  # a terminal of 80 columns parts long lines anywhere
    assert "it broke" in printed and "figures.json" in printed and "where it broke" not in printed


def test_each_part_of_polyhedra_runs_and_meets_its_aim():
    study, first = STUDIES["polyhedra"], {}
    less = {"free": {"cells": 8}, "step": {"cells": 8}, "run": {"t_end": 0.2}}
    for task in study.tasks(True):
        first.setdefault((task["part"], task.get("integrator")), task | less.get(task["part"], {}))
    found = StudyResult(study, [task | {"error": ""} | study.run(**task) for task in first.values()])
    figures, missing = found.figures, "integrators_apart_m"  # of the full selection
    assert [name for name, value in figures.items() if not np.isfinite(value)] == [missing]
    assert figures["patch"] < 1e-12 and figures["energy"] < 1e-9 and figures["drift"] < 1e-14
    assert figures["gradient"] < 1e-6 and figures["hinge_momentum"] < 1e-9
    assert abs(figures["order_alpha_soft"] - 2.0) < 0.2 and abs(figures["order_radau_soft"] - 5.0) < 0.2
    assert abs(number(found.rows, "angle", part="hinge") - 0.2 * SPIN) < 1e-2 and number(found.rows, "fall", part="hinge") < 0.1
    assert 1.0 <= figures["iterations_1e-03"] <= 2.0 and figures["cantilever_60"] < 0.03
    assert [picture.name for picture in found.report_pictures()] == ["polyhedra"]


@pytest.mark.parametrize("name", STUDIES)
def test_each_single_row_failed(name, monkeypatch):
    study, rows = STUDIES[name], rows_of(STUDIES[name])
    silent = study.__class__(**{**study.__dict__, "draw": lambda rows: []})
    whole = StudyResult(silent, rows)
    assert all(np.isfinite(whole.figures[key]) for key in REQUIRED.get(name, ()))
    assert not [line for line in whole.notes if "not computed" in line]
    for k in range(0, len(rows), max(1, len(rows) // MOST)):
        task = study.tasks(True)[k]
        broken = rows[:k] + [task | BROKEN] + rows[k + 1 :]
        assert not [line for line in StudyResult(silent, broken).notes if "not computed" in line], task


@pytest.mark.parametrize("name", STUDIES)
def test_what_can_be_drawn_is_drawn(name):
    study, rows = STUDIES[name], rows_of(STUDIES[name])
    whole = StudyResult(study, rows)
    assert whole.report_pictures() and not [line for line in whole.notes if "not computed" in line]
    assert all(len(picture.caption) > 20 for picture in whole.report_pictures()), [picture.name for picture in whole.report_pictures()]
    few = rows[:: max(1, len(rows) // 5)]
    for row in few[::2]:
        broken = [{key: row[key] for key in study.tasks(True)[0] if key in row} | BROKEN if other is row else other for other in few]
        found = StudyResult(study, broken)
        assert found.report_pictures() and all(line.endswith("no rows to draw") for line in found.notes if line.startswith("not computed"))


def test_a_part_that_cannot_be_formed_keeps_no_other_from_it(tmp_path, monkeypatch, capsys):
    def bad(rows):
        return {"lost": [row["value"] for row in rows][0]}

    study = findings_study(bad)
    data = command(study, [{"number": 1, "error": ""}], tmp_path, monkeypatch)
    assert data["figures"] == {"lost": None, "kept": 1.0} and "a line" in data["notes"]
    assert sum(line == "not computed: bad: KeyError: 'value'" for line in data["notes"]) == 3


def findings_study(bad):
    from polyida.study.tasks import Study

    return Study(
        "two",
        "",
        lambda quick: [{"number": 1}],
        None,
        (bad, lambda rows: {"kept": 1}),
        (bad, lambda rows: []),
        notes=(bad, lambda rows: ["a line"]),
        headline=("lost",),
    )


def test_what_the_short_selection_leaves_out_is_told():
    def of(quick):
        return [{"name": name, "h": h, "quick": quick} for name in ("a" if quick else "abc") for h in ((1,) if quick else (1, 2, 0.5))]

    (line,) = _quick_note(replace(findings_study(dict), tasks=of))
    assert line == "the quick selection has 1 runs, the full one 9; missing values: name b, c; h 2, 0.5"
    assert _quick_note(findings_study(dict)) == []


def test_logarithmic_axes_never_cut_the_data():
    for low, high in ((3e-2, 5e-2), (0.9, 1.1), (2e-4, 9e-4), (1e-3, 1e-2), (1e-6, 1.0)):
        with styles.settings():
            made, axes = plotting.panels(1)
            plotting.loglog(axes[0], [low, high], [low, high], 0, "line")
            plotting.line_picture(made, "x")
        for limits in (axes[0].get_xlim(), axes[0].get_ylim()):
            assert limits[0] < low and limits[1] > high
            decades = np.floor(np.log10(limits[1]) + 1e-9) - np.ceil(np.log10(limits[0]) - 1e-9)
            assert decades >= 1 and limits[0] > low / 101 and limits[1] < high * 101


def test_slopes_of_too_few_points_are_nan():
    assert np.isnan(fit_slope([1e-3], [1.0])) and np.isnan(fit_slope([1e-3, 1e-3], [1.0, 2.0]))
    assert fit_slope([1e-3, 1e-2, np.nan], [1e-6, 1e-4, 1.0]) == pytest.approx(2.0)
