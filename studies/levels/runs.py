"""Runs of problems at every level: distance from full plates, and CPU time."""

from functools import lru_cache
from types import SimpleNamespace

import numpy as np

from levels.scenes import at_level, problem_of
from polyida.body.rigid_body import PointMass
from polyida.force.loads import PointLoad
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.joint.joint import Joint
from polyida.run.solve import solve

EXACT, REFINED = 1e-9, 1e-8  # rtol of Radau IIA: of the full plates' run that is looked from, and of runs without a step
TIMES = 201  # of a run, at which errors are looked at
TIP = "tip"
SHORT = 1.0  # CPU s: of runs that take less, the least time of three counts


@lru_cache(maxsize=1)
def case(name):
    """The problem, the times, and the positions of its joints, masses and loads by a refined run of full plates."""
    p = problem_of(name)
    times = np.linspace(0.0, p.t_end, TIMES)
    points = [name for name, part in p.model.parts.items() if isinstance(part, (Joint, PointMass, PointLoad))]
    run = solve(p.model, p.t_end, RadauIIA(rtol=EXACT), q0=p.q0, v0=p.v0, output=times)
    if not run.success:
        raise RuntimeError(f"{name}, full: {run.message}")
    return SimpleNamespace(p=p, times=times, points=points, places=_places(run, points))


def _places(run, points):
    """(frames, points, 2), m."""
    return np.stack([run.position(name) for name in points], axis=1)


@lru_cache(maxsize=1)
def model_at(name, level):
    """The model of a problem at a level."""
    return at_level(case(name).p.model, level).build()


def measure(problem, level, x=None):
    """Largest distance of the tip, if there is one, and of any joint, mass or load from its position with full plates, m; CPU seconds.

    x: step of generalized-alpha relative to the problem's time; None: Radau IIA with a small tolerance, whose distance is that of the level
    itself.
    """
    c, model = case(problem), model_at(problem, level)
    method = RadauIIA(rtol=REFINED) if x is None else GeneralizedAlpha(h=x * c.p.t_end)
    solve(model, 1e-3 * c.p.t_end, method)
    run = solve(model, c.p.t_end, method, output=c.times)
    seconds = [run.cpu_seconds]
    while x is not None and len(seconds) < 3 and seconds[0] < SHORT:
        seconds.append(solve(model, c.p.t_end, method, every=10**9).cpu_seconds)
    apart = np.linalg.norm(_places(run, c.points) - c.places[: len(run.t)], axis=2).max(axis=0) if run.success else np.full(1, np.nan)
    tip = c.points.index(TIP) if TIP in c.points and run.success else apart.argmax()
    return {
        "n": model.n,
        "distance": float(apart[tip]),
        "anywhere": float(apart.max()),
        "cpu_s": min(seconds),
        "steps": run.counts.steps,
        "outcome": "done" if run.success else run.message,
    }
