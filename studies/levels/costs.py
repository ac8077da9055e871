"""CPU time of a step at every level and number of cells, and of the reduction itself."""

from functools import lru_cache

import numpy as np

from levels.scenes import FULL, at_level, body_of
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.problems.plates import double_plate
from step_cost.side import between, cpu

H = 5e-4  # s
SHORT, LONG, REPEATS = 0.05, {FULL: 0.15}, 5  # s, of the runs whose difference is measured
OF_FEW = 1.05  # s, of those with few coordinates


@lru_cache(maxsize=1)
def plates(cells):
    """The model of the double plate."""
    return double_plate(cells).build()


def step(cells, level):
    """CPU seconds of a step of generalized-alpha within a run of the double plate without frames: the median of runs."""
    model, method = at_level(plates(cells), level).build(), GeneralizedAlpha(h=H)
    long = LONG.get(level, OF_FEW)
    between(model, method, SHORT, long)  # compiles or loads the kernels
    pairs = [between(model, method, SHORT, long) for _ in range(REPEATS)]
    steps = pairs[0][1][1].steps - pairs[0][0][1].steps
    iterations = pairs[0][1][1].newton_iterations - pairs[0][0][1].newton_iterations
    return {"n": model.n, "step_s": float(np.median([b[0] - a[0] for a, b in pairs])) / steps, "iterations": iterations / steps}


def reduction(cells, level):
    """CPU seconds from a plate held at both ends to its modes, mass and form: the median of some."""
    body = body_of(plates(cells).parts["upper"], level)
    ends = [body.section("left"), body.section("right")]
    seconds = [cpu(lambda: body.prepared(ends).form())[0] for _ in range(REPEATS + 1)]
    return {"reduction_s": float(np.median(seconds[1:]))}
