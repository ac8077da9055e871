"""Start-up time: CPU time of new processes with an empty and with a filled kernel cache."""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import polyida
from polyida.cli.study import main
from polyida.study.plotting import panels, picture, study_figure
from polyida.study.rows import distinct, pick
from polyida.study.tasks import Study

IMPORT, BUILD = "import polyida as pi\nfrom polyida.problems.plates import double_plate", "model = double_plate().build()"
STEP = "pi.solve(model, 1e-3, pi.GeneralizedAlpha(h=1e-3))"
JOBS = {  # job: its parts in order, executed one after the other
    "alpha": {"import": IMPORT, "build": BUILD, "run": f"assert {STEP}.success"},
    "alpha by plain numba": {
        "import": f"import os\nos.environ['POLYIDA_PLAIN_NUMBA'] = '1'\n{IMPORT}",
        "build": BUILD,
        "run": f"assert {STEP}.success",
    },
    "main job": {
        "import": "from polyida.study.comparison import compare\nfrom polyida.study.ivp import load",
        "build": 'job = load("double-plate")',
        "run": "assert compare(job).success",
    },
}
AIMS = {"cold_alpha_cpu_s": 10.0, "cold_main_job_cpu_s": 15.0}
PARTS = """
import json, sys, time
marks, names = [0.0], {}
for part in json.loads(sys.argv[1]):
    exec(part, names)
    marks.append(time.process_time())
print(json.dumps(marks))
"""
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def tasks(quick):
    """Each job, once or three times."""
    return [{"job": job, "repeat": k} for job in JOBS for k in range(1 if quick else 3)]


def run(job, repeat):
    """CPU and wall seconds of a process with an empty cache, then of one with the cache that the first process has filled."""
    row = {}
    with tempfile.TemporaryDirectory(prefix="polyida-kernels-") as folder:
        for cache in ("cold", "warm"):
            row |= {f"{cache}_{name}": value for name, value in started(JOBS[job], folder).items()}
    return row


def started(parts, folder):
    """{"cpu_s", "wall_s" of a new process and its children, "<part>_s": CPU} with kernels in the folder and one BLAS thread.

    Raises ChildProcessError if the process fails.
    """
    path = os.pathsep.join([str(Path(polyida.__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    settings = os.environ | ONE_THREAD | {"NUMBA_CACHE_DIR": folder, "MPLBACKEND": "Agg", "PYTHONPATH": path}
    command = [sys.executable, "-c", PARTS, json.dumps(list(parts.values()))]
    begin, used = time.monotonic(), of_children()
    done = subprocess.run(command, env=settings, cwd=folder, capture_output=True, text=True)
    if done.returncode:
        raise ChildProcessError(f"{list(parts)}: {done.stderr.strip()[-300:]}")
    row = {"cpu_s": of_children() - used, "wall_s": time.monotonic() - begin}
    marks = np.diff(json.loads(done.stdout.splitlines()[-1]))
    return row | {f"{name}_s": float(seconds) for name, seconds in zip(parts, marks)}


def of_children():
    """CPU seconds of all finished processes that this process started."""
    used = os.times()
    return used.children_user + used.children_system


def figures(rows):
    """Medians: `cold_alpha_cpu_s`, `warm_alpha_cpu_s` and those of the other jobs."""
    result = {}
    for job in distinct(rows, "job"):
        for cache in ("cold", "warm"):
            seconds = [row[f"{cache}_cpu_s"] for row in pick(rows, job=job)]
            if seconds:
                result[f"{cache}_{job.replace(' ', '_')}_cpu_s"] = float(np.median(seconds))
    return result


def notes(rows):
    """Contents of the times, and missed targets."""
    result = figures(rows)
    missed = [f"{name}: {result[name]:.3g}, aim at most {target:g}" for name, target in AIMS.items() if result.get(name, 0) > target]
    return [
        "alpha: import, mesh and model of the double plate, one step of generalized-alpha; by plain numba: with POLYIDA_PLAIN_NUMBA=1",
        "main job: the double plate for its whole time, generalized-alpha, IDA, Radau IIA and the refined run, nothing drawn or written",
        "CPU seconds of new processes on one thread; others that work on the machine meanwhile make them longer",
        *missed,
    ]


@study_figure
def draw(rows):
    """CPU time of the parts of a new process with an empty (cold) and with a filled (warm) kernel cache."""
    from polyida.show.styles import PALETTE

    fig, (axes,) = panels(1, columns=1, height=2.6)
    jobs = [job for job in distinct(rows, "job") if pick(rows, job=job)]
    if not jobs:
        raise LookupError("no rows to draw")
    bars = [(job, cache) for job in jobs for cache in ("cold", "warm")]
    left = np.zeros(len(bars))
    for colour, part in zip(PALETTE, JOBS["alpha"]):
        width = np.array([np.median([row[f"{cache}_{part}_s"] for row in pick(rows, job=job)]) for job, cache in bars])
        axes.barh(range(len(bars)), width, 0.6, left=left, label=part, color=colour)
        left += width
    axes.set_yticks(range(len(bars)), [f"{job}, {cache}" for job, cache in bars])
    axes.set(xlabel="CPU time, s")
    axes.invert_yaxis()
    axes.legend(loc="lower right")
    return picture(fig, "start")


study = Study(
    "start",
    "CPU time of the start-up",
    tasks,
    run,
    figures,
    draw,
    notes=notes,
    headline=("cold_alpha_cpu_s", "cold_main_job_cpu_s", "warm_alpha_cpu_s", "warm_main_job_cpu_s"),
    columns=("job", "repeat", "cold_cpu_s", "cold_wall_s", "warm_cpu_s", "cold_import_s", "cold_build_s", "cold_run_s"),
)

if __name__ == "__main__":
    main(study)
