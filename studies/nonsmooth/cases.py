"""The cases of work against precision: a scene, its end, and the error of a run."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from time import process_time

import numpy as np

import polyida as pi
from nonsmooth import references
from nonsmooth.scenes import Balls, Belt, Woodpecker, incline, on_floor, pendulum, rocking_block, slider_crank

EVENTS, STEPPING = ("alpha, events", "Radau IIA, events", "IDA, events"), ("nonsmooth alpha", "Moreau-Jean")
FIXED = ("alpha, events", *STEPPING)
MAKERS = {
    "alpha, events": lambda x: pi.GeneralizedAlpha(h=x),
    "Radau IIA, events": lambda x: pi.RadauIIA(rtol=x),
    "IDA, events": lambda x: pi.IDA(rtol=x),
    "nonsmooth alpha": lambda x: pi.NonsmoothAlpha(h=x),
    "Moreau-Jean": lambda x: pi.MoreauJean(h=x),
}


@dataclass(frozen=True)
class Case:
    """make() gives (model, start values); error(run) is the error in `unit`; h: the largest step; mean: error is the mean over time."""

    make: Callable
    t_end: float
    error: Callable
    h: float
    unit: str = "m"
    mean: bool = False


def scene_of(make):
    """(model, {}) of a scene."""
    return make().build(), {}


def mean_over_time(run, error):
    """Integral of |error| over the run's time, by the trapezium rule."""
    return float(np.trapezoid(np.abs(error), run.t) / run.t[-1])


def of_balls(run):
    return mean_over_time(run, (run.q.T - references.balls(run.t))[1])


def of_ball(run):
    return mean_over_time(run, run.q[:, 1] + 1.0 - [references.bounces(t, 0.8)[0] for t in run.t])


def of_belt(run):
    return float(abs(run.q[-1, 0] - references.belt(run.t[-1])))


def of_rocking(run):
    left, right = (run.position(run.model.parts["body"].at(name))[-1] for name in ("left", "right"))
    return float(abs(np.arctan2(*(right - left)[::-1]) - rocking(run.t[-1])))


def of_pendulum(run):
    x, y = run.position("tip")[-1]
    return float(abs(np.arctan2(x, -y) - references.PENDULUM))


def of_slider(run):
    return float(abs(run.position(run.model.parts["slider"].at("c"))[-1, 0] - slider()))


def of_woodpecker(run):
    return float(np.abs(run.q[-1] - Woodpecker.begin[0] + [Woodpecker.fall, 0.0, 0.0]).max())


rocking = cache(references.rocking)


@cache
def slider():
    """Place of the slider at 0.6 s, m."""
    return references.place_of_slider(references.crank_angle(0.2, 0.6)[0])


START = dict(zip(("q0", "v0"), Balls.begin))
CASES = {
    "two balls": Case(lambda: (Balls(), START), 1.0, of_balls, 7e-3, mean=True),
    "bouncing ball": Case(lambda: scene_of(lambda: on_floor({"p": (0.0, 0.0)}, (0.0, 1.0), e=0.8)), 1.5, of_ball, 1e-2, mean=True),
    "belt": Case(lambda: (Belt(), {}), 5.0, of_belt, 4e-2),
    "incline": Case(lambda: scene_of(incline), 1.0, lambda run: float(np.abs(run.q).max()), 2e-2),
    "rocking block": Case(lambda: scene_of(rocking_block), 0.5, of_rocking, 4e-3, "rad"),
    "pendulum, pin friction": Case(lambda: scene_of(lambda: pendulum(1.0)), 3.0, of_pendulum, 4e-2, "rad"),
    "slider-crank": Case(lambda: scene_of(slider_crank), 0.6, of_slider, 2e-3),
    "woodpecker": Case(lambda: (Woodpecker(), dict(zip(("q0", "v0"), Woodpecker.begin))), Woodpecker.period, of_woodpecker, 4e-4, "m, rad"),
}


def tasks(quick):
    """Steps that are halved, and tolerances, of all ways on all cases."""
    halvings, tolerances = (3, (1e-5, 1e-7)) if quick else (6, (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9))
    cases = ("two balls", "bouncing ball", "belt", "incline", "rocking block") if quick else CASES
    return [
        {"part": "precision", "scene": name, "integrator": way, "x": x}
        for name in cases
        for way in MAKERS
        for x in ([CASES[name].h / 2.0**k for k in range(halvings)] if way in FIXED else tolerances)
    ]


def measure(scene, integrator, x):
    """Error, CPU seconds and counts of one run. The kernels are compiled in a short run before."""
    case, method = CASES[scene], MAKERS[integrator](x)
    model, start = case.make()
    pi.solve(model, 1e-2 * case.t_end, method, **start)
    begin = process_time()
    run = pi.solve(model, case.t_end, method, **start)
    row = {"cpu_s": process_time() - begin, "steps": run.counts.steps, "events": len(run.events), "outcome": "done"}
    return row | ({"error_q": case.error(run)} if run.success else {"outcome": run.message})
