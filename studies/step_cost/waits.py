"""Waiting times of a user: a whole comparison, an animation, the largest figure of a study."""

import os
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import polyida
from polyida.show.styles import legend_above, save
from polyida.study.plotting import line_picture, loglog, panels
from polyida.study.rows import number

COMMAND = "import sys; from polyida.cli.commands import main; sys.exit(main(sys.argv[1:]))"
AIMS = {"compare_wall_s": (5.0, True), "animation_100_s": (4.0, True), "figure_s_max": (2.0, True)}  # most, s
PANELS = 14  # of the largest figure of all studies, work-counts-alpha


def wait_row(what, repeats):
    """{"wall_s", "cpu_s"}: medians after a first run that fills caches; without repeats the first run itself, whose kernels the parts
    before have compiled.
    """
    with TemporaryDirectory(prefix="polyida-waits-") as folder:
        again = WAITS[what](Path(folder))
        first, *times = [again(k) for k in range(repeats + 1)]
    wall, cpu = np.median(times or [first], axis=0)
    return {"wall_s": float(wall), "cpu_s": float(cpu), "first_s": first[0]}


def comparison(folder):
    """The command `polyida compare double-plate` in a new process, every time into a new folder."""
    return lambda k: command("compare", "double-plate", "--out", folder / str(k))


def animation(folder):
    """The command `polyida animate` of a saved run of the double plate in 100 frames, in a new process."""
    command("run", "double-plate", "--out", folder / "run.h5")
    return lambda k: command("animate", folder / "run.h5", "--frames", 100, "--out", folder / f"{k}.gif")


def largest_figure(folder):
    """A figure of as many logarithmic panels as the largest of all studies has, drawn and saved as PNG and PDF."""
    return lambda k: clocked(partial(panels_written, folder))


WAITS = {"comparison": comparison, "animation": animation, "figure": largest_figure}


def panels_written(folder):
    """Write the figure of `largest_figure` as PNG and PDF; its paths."""
    x = 10.0 ** np.arange(-8, 0)
    fig, axes = panels(PANELS, width=9.0, height=2.1, columns=4)
    for k, axis in enumerate(axes):
        for i in range(5):
            loglog(axis, x, x ** (0.5 + 0.1 * i), i, f"line {i}")
        axis.set(title=f"panel {k}", xlabel="error, m", ylabel="work")
    legend_above(fig, axes)
    (sheet,) = line_picture(fig, "panels")
    return [save(sheet.figure, folder / f"panels.{kind}") for kind in ("png", "pdf")]


def command(*arguments):
    """(wall s, CPU s including child processes) of a command of polyida in a new process. Raises RuntimeError if it fails."""
    paths = os.pathsep.join([str(Path(polyida.__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    given, settings = [sys.executable, "-c", COMMAND, *map(str, arguments)], os.environ | {"PYTHONPATH": paths}
    return clocked(partial(_ended, given, settings))


def _ended(given, settings):
    done = subprocess.run(given, env=settings, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{' '.join(given[3:])}: {done.stderr.strip()[-300:]}")


def clocked(call):
    """(wall s, CPU s of this process and of those that ended meanwhile) of a call."""
    begin, before = time.monotonic(), os.times()
    call()
    return time.monotonic() - begin, sum(os.times()[:4]) - sum(before[:4])


def tasks(quick):
    """Each thing to wait for."""
    return [{"part": "wait", "what": what, "repeats": 0 if quick else 3} for what in WAITS]


def figures(rows):
    """Wall seconds of each; of the comparison CPU seconds too, for it works in two processes."""
    waits = {"compare_wall_s": "comparison", "animation_100_s": "animation", "figure_s_max": "figure"}
    result = {name: number(rows, "wall_s", part="wait", what=what) for name, what in waits.items()}
    result["compare_cpu_s"] = number(rows, "cpu_s", part="wait", what="comparison")
    return {name: value for name, value in result.items() if np.isfinite(value)}


def notes(rows):
    """Descriptions of the times."""
    if not figures(rows):
        return []
    return [
        "compare_wall_s, animation_100_s: whole commands in new processes that find the kernels compiled, "
        "`polyida compare double-plate` and `polyida animate run.h5 --frames 100`; others that work on the machine meanwhile make them longer",
        f"figure_s_max: {PANELS} logarithmic panels, as many as the largest figure of all studies has, as PNG and PDF",
    ]
