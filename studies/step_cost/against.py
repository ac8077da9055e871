"""Steps of this version relative to those of an earlier commit, measured alternately, so that disturbances of the machine affect both."""

import json
import os
import subprocess
import sys
import tarfile
import tempfile
from functools import lru_cache
from io import BytesIO
from pathlib import Path

import numpy as np

import polyida
from polyida.errors import InputError
from polyida.study.rows import pick
from polyida.study.tasks import Study
from step_cost.side import cells_for

CLONE, SIDE = Path(__file__).parents[2], Path(__file__).with_name("side.py")
PAIRS = {  # figure: coordinates, integrator, times between which a step is measured, s, pairs of measurements
    "step_over_before_1e3": (1_000, "alpha", 0.01, 2.01, 21),
    "step_over_before_1e4": (10_000, "alpha", 0.01, 0.41, 15),
    "step_over_before_1e5": (100_000, "alpha", 0.01, 0.05, 7),
    "ida_step_over_before_1e3": (1_000, "ida", 0.1, 2.0, 21),
    "ida_step_over_before_1e4": (10_000, "ida", 0.05, 0.25, 15),
    "ida_step_over_before_1e5": (100_000, "ida", 0.005, 0.015, 5),
    "radau_step_over_before_1e3": (1_000, "radau", 0.05, 1.05, 15),
    "radau_step_over_before_1e4": (10_000, "radau", 0.05, 0.25, 9),
    "radau_step_over_before_1e5": (100_000, "radau", 0.01, 0.04, 5),
    "energy_step_over_before_1e3": (1_000, "energy", 0.01, 1.01, 15),
    "energy_step_over_before_1e4": (10_000, "energy", 0.01, 0.21, 9),
    "energy_step_over_before_1e5": (100_000, "energy", 0.01, 0.03, 5),
}
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
LIMIT = 1.02  # at which a step counts as slower than before


def against(commit):
    """The study of a commit's steps. InputError if this is no clone that has it."""
    whole = whole_name(commit)
    return Study(
        "step_cost",
        f"Cost of a step over that at {whole[:10]}",
        lambda quick: [{"figure": name, "commit": whole} for name in PAIRS if not (quick and name.endswith("1e5"))],
        measured,
        figures,
        notes=notes,
        columns=(
            "figure",
            "n",
            "pairs",
            "ratio",
            "lowest",
            "highest",
            "before_ms",
            "now_ms",
            "before_iterations",
            "now_iterations",
            "before_factors",
            "now_factors",
        ),
    )


def whole_name(commit):
    """The commit's hash."""
    command = ["git", "-C", str(CLONE), "rev-parse", "--verify", "--quiet", "--end-of-options", f"{commit}^{{commit}}"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        raise InputError(f"--against {commit}: {CLONE} is no clone that has such a commit; give one of `git log`") from None


@lru_cache(maxsize=1)
def exported(commit):
    """A temporary folder with the package of a commit and its kernels; it is removed when this process ends."""
    folder = tempfile.TemporaryDirectory(prefix="polyida-before-")
    packed = subprocess.run(["git", "-C", str(CLONE), "archive", commit, "polyida"], capture_output=True, check=True).stdout
    with tarfile.open(fileobj=BytesIO(packed)) as files:
        files.extractall(folder.name, filter="data")
    return folder


class Side:
    """A process of a script with the package of a folder; calling it gives one measurement. Close it, or use it in a `with`."""

    def __init__(self, tree, *arguments, script=SIDE):
        settings = os.environ | ONE_THREAD | {"PYTHONPATH": str(tree)}
        if tree != Path(polyida.__file__).parents[1]:
            settings["NUMBA_CACHE_DIR"] = str(tree / "kernels")
        command = [sys.executable, str(script), *map(str, arguments)]
        self.process = subprocess.Popen(command, env=settings, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.about = self._answer()
        if not Path(self.about["package"]).is_relative_to(tree):
            self.process.kill()
            raise ImportError(f"the package of {tree} is to be measured, not {self.about['package']}")

    def __call__(self, asked=""):
        print(asked, file=self.process.stdin, flush=True)
        return self._answer()

    def _answer(self):
        line = self.process.stdout.readline()
        if not line:
            raise ChildProcessError(f"{self.process.args} ended with code {self.process.wait()}")
        return json.loads(line)

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self.process.communicate()


def measured(figure, commit):
    """The row of a figure: median, lowest and highest ratio of pairs, medians of both sides; which is first changes by turns."""
    dof, integrator, short, long, pairs = PAIRS[figure]
    trees = (Path(exported(commit).name).resolve(), Path(polyida.__file__).resolve().parents[1])
    for tree in trees:
        Side(tree, 4, integrator, short, long).__exit__()  # compiles: what measures below has loaded its kernels
    arguments = (cells_for(dof), integrator, short, long)
    with Side(trees[0], *arguments) as before, Side(trees[1], *arguments) as now:
        if before.about["n"] != now.about["n"]:
            raise ArithmeticError(f"{before.about['n']} coordinates before, {now.about['n']} now: not the same model")
        rows = [in_turn(before, now, k % 2) for k in range(pairs + 1)][1:]  # the first has waited for both to be ready
    return {"n": now.about["n"], "pairs": pairs} | summary(rows)


def in_turn(before, now, turned):
    """(measurement before, measurement now)."""
    if turned:
        later = now()
        return before(), later
    return before(), now()


def summary(rows):
    """{"ratio": median of now over before, ...} of pairs of measurements."""
    ratios = [now["ms_per_step"] / before["ms_per_step"] for before, now in rows]
    result = {"ratio": float(np.median(ratios)), "lowest": min(ratios), "highest": max(ratios)}
    for side, measurements in zip(("before", "now"), zip(*rows)):
        for short, name in (("ms", "ms_per_step"), ("iterations", "newton_iterations"), ("steps", "steps"), ("factors", "factorizations")):
            result[f"{side}_{short}"] = float(np.median([row[name] for row in measurements]))
    return result


def figures(rows):
    """CPU time of a step now over before, by the names of PAIRS."""
    return {row["figure"]: row["ratio"] for row in pick(rows)}


def notes(rows):
    """How it was measured; which steps are slower than before."""
    slower = [f"{row['figure']}: {row['ratio']:.3f}, aim at most {LIMIT}" for row in pick(rows) if row["ratio"] > LIMIT]
    return [
        "CPU time of a step over that at the commit: medians of pairs, two processes in turn on one thread; "
        "generalized-alpha with tolerance 1e-4, IDA with rtol 1e-5, Radau IIA with h = 5 ms, on the double plate",
        *slower,
    ]
