"""Cost of small systems: a step of mechanisms compared with exudyn, of users' models compared with their functions, the fixed cost of a
run, and solve_dae.
"""

from functools import partial

import numpy as np

import polyida as pi
from levels.scenes import at_level
from polyida.cli.study import main
from polyida.problems import plates
from polyida.problems.literature import n_four_bar
from polyida.show.styles import legend_above, marker_style
from polyida.study.plotting import line_picture, panels, study_figure
from polyida.study.rows import pick
from polyida.study.tasks import Study
from small_systems.in_exudyn import SETTINGS, SPARSE, Bodies
from small_systems.in_solve_dae import peer_row
from small_systems.own_models import SPANS, cpu, functions_row, pendulum_row

H = 1e-3  # s
STEPS = {"chain": 1000, "four-bar": 300}  # of a run of generalized-alpha; the four-bars are level after 0.7 s
LEAST = 30  # steps of any run
MODES = 5
INTEGRATORS = {
    "alpha": (lambda: pi.GeneralizedAlpha(h=H), 1),
    "radau": (lambda: pi.RadauIIA(h=H), 4),
    "energy": (lambda: pi.EnergyMomentum(h=H), 4),
}  # and of how many of alpha's steps one is timed
PAIRS = {"alpha_over_exudyn": ("alpha", "exudyn"), "radau_over_alpha": ("radau", "alpha"), "energy_over_alpha": ("energy", "alpha")}
AIMS = {
    **{f"alpha_over_exudyn_chain_{n}": 0.5 for n in (2, 5, 10)},
    **{f"alpha_over_exudyn_four_bar_{n}": 0.5 for n in (10, 20, 40, 200)},
    **{f"radau_over_alpha_chain_{n}": 6.0 for n in (2, 5, 10)},
    **{f"radau_over_alpha_four_bar_{n}": 6.0 for n in (10, 20, 40, 200)},
    **{f"energy_over_alpha_chain_{n}": 2.0 for n in (2, 5, 10)},
    "growth_from_40_to_200": 1.15,
    **dict(zip(("alpha_us_pendulum", "radau_us_pendulum", "energy_us_pendulum", "alpha_over_loop_pendulum"), (1.0, 6.0, 3.0, 5.0))),
    **{f"{key}_over_own_{name}": target for name in SPANS for key, target in (("alpha", 1.5), ("radau", 1.5), ("ida", 3.0))},
    "alpha_us_reduced_plates": 8.0,
    "radau_us_reduced_plates": 40.0,
    **{f"run_of_10_ms_{name}": 3.0 for name in ("chain", "reduced_plates")},
    "radau_over_solve_dae_double_pendulum": 0.02,
}
LEAST_AIMS = {f"{key}_python_over_compiled_andrews": 20.0 for key in ("alpha", "radau")}


def chain(count):
    """Bars of 1 m in a horizontal row at rest, the left end on a pin."""
    scene, before = pi.Scene(gravity=(0.0, -9.81)), None
    for k in range(count):
        bar = scene.add(pi.RigidBody.bar(1.0, 1.0, (k, 0.0), name=f"bar {k}"))
        scene.add(pi.Revolute(pi.ground.at((0.0, 0.0)) if before is None else before.at("right"), bar.at("left"), name=f"pin {k}"))
        before = bar
    return scene


def reduced_plates(modes):
    """The double plate with this number of modes in each plate."""
    return at_level(plates.double_plate().build(), modes)


SCENES = {"chain": chain, "four-bar": n_four_bar, "reduced plates": reduced_plates}


def tasks(quick):
    """Chains of bars and ladders of four-bars; users' models, reduced plates, whole runs."""
    sizes = {"chain": (2, 5, 10), "four-bar": (10, 40) if quick else (10, 20, 40, 200)}
    own = ("pendulum",) if quick else tuple(SPANS)
    selection = [("step", scene, size) for scene, all_of in sizes.items() for size in all_of]
    selection += [("own", name, 0) for name in own]
    selection += [("pendulum", "pendulum", 0), ("reduced", "reduced plates", MODES), ("run", "chain", 2), ("run", "reduced plates", MODES)]
    selection += [("solve_dae", "double pendulum", 2)]
    return [{"part": part, "scene": scene, "size": size, "rounds": 3 if quick else 7} for part, scene, size in selection]


def run(part, scene, size, rounds):
    """The row of one part."""
    try:
        return PARTS[part](scene, size, rounds)
    except ImportError as missing:
        return {"skipped": str(missing)}


def step_row(scene, size, rounds):
    """Microseconds of a step as medians over rounds in which the solvers alternate, and medians of the ratios of each round."""
    drawing = SCENES[scene](size)
    model, steps = drawing.build(), STEPS[scene]
    peer = Peer(drawing, steps, SPARSE if scene == "four-bar" else SETTINGS)
    for name in INTEGRATORS:
        stepped(model, name, LEAST)
    result = [{name: stepped(model, name, steps // share) for name, (_, share) in INTEGRATORS.items()} | peer.once() for _ in range(rounds)]
    row = {"n": model.n, "m": model.m, "exudyn": peer.description}
    row |= {f"{name}_us": float(np.median([each[name] for each in result])) for name in result[0]}
    for name, (one, other) in PAIRS.items():
        if other in result[0]:
            row[name] = float(np.median([each[one] / each[other] for each in result]))
    return row | peer.apart(model, steps)


def reduced_row(scene, size, rounds):
    """Microseconds of a step of plates with a few modes."""
    model = SCENES[scene](size).build()
    result = [{name: stepped(model, name, STEPS["chain"]) for name in ("alpha", "radau")} for _ in range(rounds + 1)][1:]
    return {"n": model.n, "m": model.m} | {f"{name}_us": float(np.median([each[name] for each in result])) for name in result[0]}


def run_row(scene, size, rounds):
    """CPU milliseconds of a whole run of 10 ms with ten steps of each integrator."""
    model, row = SCENES[scene](size).build(), {}
    for name, (make, _) in INTEGRATORS.items():
        result = [cpu(lambda make=make: pi.solve(model, 10 * H, make()))[0] for _ in range(5 * rounds + 1)]
        row["run_ms" if name == "alpha" else f"{name}_run_ms"] = 1e3 * float(np.median(result[1:]))
    return {"n": model.n, "m": model.m} | row


PARTS = {
    "step": step_row,
    "own": lambda scene, size, rounds: functions_row(scene, rounds),
    "pendulum": lambda scene, size, rounds: pendulum_row(rounds, stepped),
    "reduced": reduced_row,
    "run": run_row,
    "solve_dae": lambda scene, size, rounds: peer_row(chain(size).build(), rounds),
}


def stepped(model, name, steps, **start):
    """CPU microseconds of a step: the difference between a run of `steps` and one of a fifth of them."""
    long = max(LEAST, steps)
    ends, used = (long // 5, long), []
    for end in ends:
        seconds, done = cpu(partial(pi.solve, model, end * H, INTEGRATORS[name][0](), every=10**9, **start))
        used.append(seconds)
        if not done.success:
            raise RuntimeError(f"{name}: {done.message}")
    return 1e6 * (used[1] - used[0]) / (ends[1] - ends[0])


class Peer:
    """exudyn with the fastest of its settings, or nothing where it is not installed; said: which."""

    def __init__(self, scene, steps, settings):
        self.steps, self.setting, self.description = steps, None, "not installed"
        try:
            self.make = lambda: Bodies(scene)
            times = {setting: self._stepped(setting) for setting in settings}
        except ImportError:
            return
        self.setting = min(times, key=times.get)
        self.description = ", ".join(self.setting) + " Newton"

    def _stepped(self, setting):
        ends = self.steps // 5, self.steps
        used = [self.make().run(H, end, setting)[0] for end in ends]
        return 1e6 * (used[1] - used[0]) / (ends[1] - ends[0])

    def once(self):
        """{"exudyn": microseconds of a step}."""
        return {} if self.setting is None else {"exudyn": self._stepped(self.setting)}

    def apart(self, model, steps):
        """{"apart_m": largest distance of the last body's centres at the end}: a check that both solvers compute the same motion."""
        if self.setting is None:
            return {}
        q = pi.solve(model, steps * H, INTEGRATORS["alpha"][0](), every=10**9).q[-1].reshape(-1, 2)
        centre = (model.reference + q)[model.reduced_bodies[-1].pairs.start]
        return {"apart_m": float(np.abs(centre - self.make().run(H, steps, self.setting)[1]).max())}


def figures(rows):
    """Ratios by scene and size, and the exponent with which the cost of a step of generalized-alpha grows; microseconds and milliseconds of
    the other parts.
    """
    result, alpha = {}, {}
    for row in pick(rows, part="step"):
        label = f"{row['scene'].replace('-', '_')}_{row['size']}"
        result |= {f"{name}_{label}": row[name] for name in PAIRS if name in row}
        alpha[row["scene"], row["size"]] = row["alpha_us"]
    small, large = (alpha.get(("four-bar", size)) for size in (40, 200))
    if small and large:
        result["growth_from_40_to_200"] = float(np.log(large / small) / np.log(5))
    for row in (row for row in pick(rows) if row["part"] != "step"):
        label = row["scene"].replace(" ", "_")
        result |= {f"{name}_{label}": row[name] for name in row if name.endswith(("_us", "_over_own", "_compiled", "_loop", "_dae"))}
        result |= {f"{name.replace('run_ms', 'run_of_10_ms')}_{label}": row[name] for name in row if name.endswith("run_ms")}
    return result


def notes(rows):
    """Missed targets."""
    result = figures(rows)
    missed = [
        f"{name}: {result[name]:.3g}, aim at most {target:.3g}"
        for name, target in AIMS.items()
        if name in result and not result[name] <= target
    ]
    less = [
        f"{name}: {result[name]:.3g}, aim at least {target:.3g}"
        for name, target in LEAST_AIMS.items()
        if name in result and result[name] < target
    ]
    return missed + less + sorted({f"left out: {row['skipped']}" for row in rows if row.get("skipped")})


@study_figure
def draw(rows):
    """CPU time of a step against the number of coordinates."""
    scenes = [scene for scene in SCENES if pick(rows, scene=scene, part="step")]
    fig, axes = panels(len(scenes), width=9.0, height=3.4)
    for axis, scene in zip(axes, scenes):
        own = sorted(pick(rows, scene=scene, part="step"), key=lambda row: row["n"])
        for i, name in enumerate((*INTEGRATORS, "exudyn")):
            known = [row for row in own if f"{name}_us" in row]
            if known:
                axis.plot([row["n"] for row in known], [row[f"{name}_us"] for row in known], label=name, **marker_style(i))
        axis.set(xscale="log", yscale="log", xlabel=f"coordinates, {scene}", ylabel="CPU time of a step, us")
    legend_above(fig, axes)
    return line_picture(fig, "small-systems")


study = Study(
    "small_systems",
    "Cost of small systems",
    tasks,
    run,
    figures,
    draw,
    notes=notes,
    headline=(*AIMS, *LEAST_AIMS),
    columns=(
        "part",
        "scene",
        "size",
        "n",
        "m",
        "alpha_us",
        "exudyn_us",
        "radau_us",
        "energy_us",
        *PAIRS,
        "run_ms",
        "radau_run_ms",
        "energy_run_ms",
        "exudyn",
        "apart_m",
    ),
)

if __name__ == "__main__":
    main(study)
