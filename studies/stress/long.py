"""Runs of very many steps: the errors of phi and energy, the time of a step and the memory must not grow."""

import resource
import sys
import time

import numpy as np

from polyida.problems import plates
from polyida.run.solve import solve
from stress.outcome import Check, balance, extent, integrator

H = 1e-3
PARTS = 20  # of a run, between which time and memory are compared


class Meter:
    """A progress function that records CPU seconds and peak memory of the process after each part of a run."""

    def __init__(self, steps):
        self.due, self.every, self.count, self.marks = steps // PARTS, steps // PARTS, 0, []

    def __call__(self, t):
        self.count += 1
        if self.count == self.due:
            self.due += self.every
            self.marks.append((self.count, time.process_time(), _memory()))

    @property
    def slower(self):
        """CPU time of a step in the last quarter over that in the second quarter."""
        counts, cpu, _ = np.array(self.marks).T
        each = np.diff(cpu) / np.diff(counts)
        quarter = len(each) // 4
        return float(np.median(each[-quarter:]) / np.median(each[quarter : 2 * quarter]))

    @property
    def grown(self):
        """Increase of the peak memory in the second half, bytes."""
        memory = np.array(self.marks)[:, 2]
        return float(memory[-1] - memory[len(memory) // 2])


def _memory():
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def many_steps(steps, name):
    """`steps` steps of 1 ms of two swinging plates with few cells: drift of phi below 1e-10 m, no growth of energy, steps at the end take
    at most twice the time of early ones, and memory grows by at most 4 MiB plus 8 bytes a step in the second half.
    """
    model, meter = plates.double_plate(cells=2).build(), Meter(steps)
    settings = {"max_step": H, "max_num_steps": 4 * steps} if name in ("ggl2", "ggl1", "radau") else {}
    run = solve(model, steps * H, integrator(name, H, **settings), every=max(1, steps // 2000), progress=meter)
    gained, lost = balance(run, 1e-3, 1.01)
    if name == "energy":
        gained, lost = balance(run, 1e-6, 1e-6)
    if not run.success:
        return run, []
    return run, [
        Check("drift, m", run.drift.max(), 1e-10 * extent(model)),
        gained,
        lost,
        Check("time a step, late over early", meter.slower, 2.0),
        Check("memory gained, bytes", max(meter.grown, 0.0), 4 * 2**20 + 8.0 * steps),
    ]
