"""Cost of a step against the number of coordinates for each integrator, compared with the lower bound of the machine."""

import numpy as np

from against_peers import peers
from polyida.cli.study import main
from polyida.study.plotting import picture, study_figure
from polyida.study.tasks import Study
from step_cost import beside_alpha, frames, own_functions, threads, told_cj, waits
from step_cost import measure as cost
from step_cost.against import against
from step_cost.pair import BACKENDS, pair_row

DECADES = {"1e3": 1_000, "1e4": 10_000, "1e5": 100_000}
SPARSE = {"2e3": 2_000, "9e3": 9_000, "2e4": 20_000}
STEPS = {1_000: 1000, 3_000: 600, 10_000: 300, 30_000: 100, 100_000: 50}
RADAU_SPANS = {1_000: (0.1, 1.1), 3_000: (0.1, 0.6), 10_000: (0.05, 0.35), 30_000: (0.05, 0.2), 100_000: (0.02, 0.07)}  # s
SPANS = {1_000: (0.1, 1.0), 3_000: (0.1, 0.5), 10_000: (0.05, 0.25), 30_000: (0.02, 0.08), 100_000: (0.005, 0.02)}  # of IDA, s
AIMS = {  # figure: aim, at most (True) or at least
    "alpha_step_over_floor_1e3": (0.25, True),
    "alpha_step_over_floor_1e4": (0.1, True),
    "alpha_step_over_floor_1e5": (0.12, True),
    "ida_speedup_over_sparse_2e3": (4, False),
    "ida_speedup_over_sparse_9e3": (6, False),
    "ida_speedup_over_sparse_2e4": (8, False),
    **{f"ida_over_alpha_step_{name}": (1.5, True) for name in DECADES},
    "growth_exponent": (1.15, True),
    "residual_ns_per_dof": (15, True),
    "residual_tangent_ns_per_dof": (100, True),
    "bytes_per_dof_1e5": (2 * 2**30 / 1e5, True),
    "frames_over_none_1e3": (1.05, True),
    "frames_over_none_1e4": (1.1, True),
    "frames_over_none_1e5": (1.15, True),
    "hdf5_over_none_1e4": (1.25, True),
    "cold_start_s": (3, True),
    "warm_start_s": (0.7, True),
} | waits.AIMS
HEADLINE = tuple(name for name in AIMS if not name.endswith("start_s"))  # the short selection leaves out the start with an empty cache
PARTS = ("residual", "tangent", "factor", "solve", "rest")
RUNS = {
    "step": cost.step_row,
    "floor": cost.floor_row,
    "pair": pair_row,
    "beside alpha": beside_alpha.ratio_row,
    "told cj": told_cj.told_row,
    "own functions": own_functions.own_row,
    "sparse": cost.sparse_row,
    "memory": cost.memory_row,
    "frames": frames.frames_row,
    "threads": threads.threads_row,
    "start": cost.start_rows,
    "wait": waits.wait_row,
}


def tasks(quick):
    """Steps and lower bounds of each size, then IDA with its sparse solver, memory, start-up."""
    selection, few = [], 3 if quick else 1
    for dof in DECADES.values() if quick else STEPS:
        large = dof > 50_000
        repeats = 1 if quick and large else 3
        count = max(12, STEPS[dof] // few)
        for scene in ("scene 1",) if quick else ("scene 1", "scene 2"):
            selection.append(_step(scene, dof, "alpha", 0.01, 0.01 + 1e-3 * count, repeats))
        backends = [name for name in cost.BACKENDS if name != "band" or dof <= peers.WIDEST_BAND]
        if quick and large:  # alpha's step and its floor, which superlu is not
            selection.append({"part": "floor", "dof": dof, "backend": "fronts", "repeats": 2})
            continue
        short, long = SPANS[dof]
        once = 1 if large or quick else repeats
        selection.append(_step("scene 1", dof, "ida", short, short + (long - short) / (1 if large else few), once))
        selection.append(_step("scene 1", dof, "radau", *RADAU_SPANS[dof], 1 if quick else repeats))
        for part, names in (("pair", BACKENDS), ("floor", backends)):
            selection += [{"part": part, "dof": dof, "backend": name, "repeats": 2 if large else 7} for name in names]
    selection += [{"part": "beside alpha", "dof": dof, "repeats": (3 if dof > 50_000 else 7) // few} for dof in DECADES.values()]
    selection += told_cj.tasks(quick) + own_functions.tasks(quick)
    selection += frames.tasks(quick)
    spans = dict(zip(SPARSE.values(), (0.2, 0.04, 0.01) if quick else (1.0, 0.2, 0.05)))
    selection += [{"part": "sparse", "dof": dof, "t_end": span, "repeats": 1 if quick else 3} for dof, span in spans.items()]
    selection += [
        {"part": "memory", "dof": 100_000, "integrator": name, "steps": steps}
        for name, steps in ((("alpha", 30),) if quick else (("alpha", 1000), ("radau", 100)))
    ]
    selection += waits.tasks(quick)
    if quick:
        return selection
    return [*selection, {"part": "threads", "dof": 100_000, "steps": 30, "repeats": 9}, {"part": "start", "dof": 1_000, "warm": 3}]


def _step(scene, dof, integrator, short, long, repeats):
    step = {"scene": scene, "dof": dof, "integrator": integrator, "short": short, "long": long, "repeats": repeats}
    return {"part": "step"} | step


def run(part, **task):
    """One row; "skipped" gives the reason if an optional package is missing."""
    try:
        return RUNS[part](**task)
    except peers.Missing as missing:
        return {"skipped": str(missing)}


def only(rows, part, **values):
    """Successful rows of a part with these values."""
    good = [row for row in rows if row["part"] == part and not row.get("error") and not row.get("skipped")]
    return [row for row in good if all(row.get(key) == value for key, value in values.items())]


def floors(rows, part="floor"):
    """{dof: row of the back-end with the smallest lower bound}; part "pair": of Radau IIA."""
    result = {}
    for row in only(rows, part):
        result[row["dof"]] = min(row, result.get(row["dof"], row), key=lambda x: x["floor_ms"])
    return result


def figures(rows):
    """Figures of all parts that ran."""
    result, single, pair = {}, floors(rows), floors(rows, "pair")
    alpha = only(rows, "step", scene="scene 1", integrator="alpha")
    for name, dof in DECADES.items():
        for row in only(rows, "step", scene="scene 1", dof=dof):
            kind, best = row["integrator"], pair if row["integrator"] == "radau" else single
            result[f"{kind}_ms_per_step_{name}"] = row["ms_per_step"]
            if dof in best:
                result[f"{kind}_step_over_floor_{name}"] = row["ms_per_step"] / best[dof]["floor_ms"]
                result[f"{'pair_' * (best is pair)}floor_ms_{name}"] = best[dof]["floor_ms"]
            if kind == "radau":
                result[f"radau_ms_per_iteration_{name}"] = row["ms_per_iteration"]
            for floor in only(rows, "floor", dof=dof, backend="pardiso"):
                result[f"{kind}_step_over_pardiso_{name}"] = row["ms_per_step"] / floor["floor_ms"]
    if len(alpha) > 1:
        result["growth_exponent"] = np.polyfit(np.log([row["n"] for row in alpha]), np.log([row["ms_per_step"] for row in alpha]), 1)[0]
    result |= {f"ida_speedup_over_sparse_{name}": row["speedup"] for name, dof in SPARSE.items() for row in only(rows, "sparse", dof=dof)}
    result |= {f"ida_over_alpha_step_{name}": row["ratio"] for name, dof in DECADES.items() for row in only(rows, "beside alpha", dof=dof)}
    result |= {f"ida_told_cj_over_guessed_{row['case']}": row["ratio"] for row in only(rows, "told cj")}
    result |= frames.figures(rows)
    for row in only(rows, "memory"):
        result[f"{'' if row['integrator'] == 'alpha' else row['integrator'] + '_'}bytes_per_dof_1e5"] = row["bytes_per_dof"]
    result |= threads.figures(only(rows, "threads"))
    result |= {
        key: row[key]
        for row in only(rows, "step", integrator="alpha", scene="scene 1", dof=10_000)
        for key in ("residual_ns_per_dof", "residual_tangent_ns_per_dof")
    }
    result |= waits.figures(rows)
    return result | {key: row[key] for row in only(rows, "start") for key in ("cold_start_s", "warm_start_s")}


def aim_notes(rows):
    """Missed targets."""
    result = figures(rows)
    return [
        f"{name}: {result[name]:.3g}, aim {'at most' if most else 'at least'} {target:.3g}"
        for name, (target, most) in AIMS.items()
        if name in result and (result[name] > target) == most
    ]


def step_notes(rows):
    """Profile of the step at each size, compared with the lower bound."""
    lines, best = [], floors(rows)
    for row in only(rows, "step", integrator="alpha", scene="scene 1"):
        floor = best.get(row["dof"], {"backend": "-", "factor_ms": np.nan, "solve_ms": np.nan})
        shares = ", ".join(f"{part} {100 * row[f'{part}_ms'] / row['ms_per_step']:.0f} %" for part in PARTS)
        lines.append(
            f"{row['n']} coordinates: a step of {row['ms_per_step']:.3g} ms is {shares} "
            f"({row['newton_iterations_per_step']:.2f} iterations); floor {floor['backend']}: "
            f"{floor['factor_ms']:.3g} + 3 x {floor['solve_ms']:.3g} ms"
        )
    return lines


def ida_notes(rows):
    return beside_alpha.notes(only(rows, "beside alpha"))


def told_notes(rows):
    return told_cj.notes(only(rows, "told cj")) + own_functions.notes(only(rows, "own functions"))


def radau_notes(rows):
    """A step of Radau IIA compared with its lower bound."""
    best = floors(rows, "pair")
    return [
        f"{row['n']} coordinates: a step of Radau IIA of {row['ms_per_step']:.3g} ms takes {row['newton_iterations_per_step']:.2f} iterations "
        f"of {row['ms_per_iteration']:.3g} ms, {row['factorizations_in_all']} factorizations in all; floor {best[row['dof']]['backend']}: "
        f"{best[row['dof']]['factor_ms']:.3g} + 3 x {best[row['dof']]['solve_ms']:.3g} ms, each of a real and a complex matrix"
        for row in only(rows, "step", integrator="radau")
        if row["dof"] in best
    ]


def memory_notes(rows):
    """Composition of the memory of a coordinate."""
    return [
        f"memory, {row['integrator']}, {row['n']} coordinates: peak resident memory of a process of {row['steps']} steps, Python and libraries "
        f"({row['imported_bytes'] / 2**20:.0f} MiB) and model ({row['built_bytes'] / 2**20:.0f} MiB so far) "
        f"included, over coordinates: {row['peak_bytes'] / 2**20:.0f} MiB; {row['frame_bytes'] / 2**20:.0f} MiB of "
        "frames, in a file beyond 512 MiB"
        for row in only(rows, "memory")
    ]


def thread_notes(rows):
    """Effect of a second thread."""
    return threads.notes(only(rows, "threads"))


def start_notes(rows):
    """Times of a new process before its first step, and omitted parts."""
    lines = []
    for row in only(rows, "start"):
        split = ", ".join(f"{what} {row[f'cold_{what}_s']:.2f} / {row[f'warm_{what}_s']:.2f}" for what in ("import", "mesh", "first_step"))
        lines.append(f"CPU s of a fresh process, kernel cache empty / filled: {split}")
    return lines + sorted({f"left out: {row['skipped']}" for row in rows if row.get("skipped")})


@study_figure
def cost_figure(rows):
    """CPU time of a step against the number of coordinates, and lower bounds: its factorizations and solves alone."""
    from polyida.show.styles import figure, line_style

    fig, axes = figure(6.4, 4.6)
    alpha = ("generalized-alpha", "alpha")
    kinds = ((*alpha, "scene 1"), (*alpha, "scene 2"), ("IDA", "ida", "scene 1"), ("Radau IIA", "radau", "scene 1"))
    lines = [
        (f"a step of {name}, {scene}", only(rows, "step", scene=scene, integrator=key), "ms_per_step", "o") for name, key, scene in kinds
    ]
    lines += [(f"1 factorization + 3 solves, {name}", only(rows, "floor", backend=name), "floor_ms", "x") for name in cost.BACKENDS]
    lines += [
        (f"real and complex factorization + 6 solves, {name}", only(rows, "pair", backend=name), "floor_ms", "+") for name in BACKENDS
    ]
    for k, (label, result, key, marker) in enumerate(lines):
        if result:
            axes.loglog(
                [row["n"] for row in result],
                [row[key] for row in result],
                marker=marker,
                label=label,
                **line_style(k) | {"markersize": 4} | {"linewidth": 1.4 if marker == "o" else 0.8},
            )
    if not axes.lines:
        raise LookupError("no rows to draw")
    axes.set(xlabel="coordinates", ylabel="CPU time, ms")
    fig.legend(loc="outside lower center", ncols=2, fontsize=7)
    return picture(fig, "step_cost")


@study_figure
def parts_figure(rows):
    """Shares of the parts of a step in its CPU time against the number of coordinates."""
    from polyida.show.styles import PALETTE, figure

    fig, axes = figure(6.4, 2.8)
    result, bottom = only(rows, "step", scene="scene 1", integrator="alpha"), 0.0
    if not result:
        raise LookupError("no rows to draw")
    for colour, part in zip(PALETTE, PARTS):
        share = np.array([100 * max(r[f"{part}_ms"], 0.0) / r["ms_per_step"] for r in result])
        axes.bar(range(len(result)), share, 0.6, bottom=bottom, label=part, color=colour)
        bottom = bottom + share
    axes.set_xticks(range(len(result)), [f"{r['n']}" for r in result])
    axes.set(xlabel="coordinates", ylabel="share of a step, %")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return picture(fig, "step_parts")


study = Study(
    "step_cost",
    "Cost of a step",
    tasks,
    run,
    figures,
    (cost_figure, parts_figure),
    notes=(aim_notes, step_notes, ida_notes, told_notes, radau_notes, memory_notes, frames.notes, thread_notes, start_notes, waits.notes),
    headline=HEADLINE,
    options={"against": ("a commit of this clone: only the steps of this package over that one's", against)},
    columns=(
        "part",
        "scene",
        "integrator",
        "backend",
        "figure",
        "what",
        "n",
        "steps",
        "ms_per_step",
        "newton_iterations_per_step",
        "factor_ms",
        "solve_ms",
        "floor_ms",
        "ida_ms",
        "alpha_ms",
        "ratio",
        "speedup",
        "bytes_per_dof",
        "wall_s",
        "cpu_s",
    ),
)

if __name__ == "__main__":
    main(study)
