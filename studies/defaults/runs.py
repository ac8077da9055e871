"""Runs of the named problems with default and explicit settings: largest errors of q over time relative to the problem's size."""

from functools import lru_cache
from types import SimpleNamespace

import numpy as np

from polyida import problems
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.ida.integrator import IDA
from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.problems import Problem
from polyida.run.solve import solve
from work_precision.cases import sudden_blow

REFINED = 1e-10  # rtol of Radau IIA, whose runs are the references
TIMES = 201  # of a run, at which errors are looked at
CAP = 15_000  # steps of IDA with given tolerances
SHORT = 1.0  # CPU s: of runs that take less, the least time of three counts
MAKERS = {
    "alpha": (GeneralizedAlpha, lambda x, time: GeneralizedAlpha(h=x * time)),
    "radau": (RadauIIA, lambda x, time: RadauIIA(rtol=x)),
    "ida": (IDA, lambda x, time: IDA(rtol=x, max_num_steps=CAP)),
}


def problem(name):
    """The Problem of a name; also "sudden-blow" of the references, a pulse of 5 ms in a run of 2 s."""
    if name == "sudden-blow":
        return Problem(name, sudden_blow(20, 2.0), None, None, 2.0)
    return problems.get(name)


@lru_cache(maxsize=2)
def case(name):
    """The problem, its size (extent of the scene, or largest |q|), q at TIMES times by a refined run, and the accuracy of that."""
    p, times = problem(name), np.linspace(0.0, problem(name).t_end, TIMES)
    run = solve(p.model, p.t_end, RadauIIA(rtol=REFINED), q0=p.q0, v0=p.v0, output=times)
    if not run.success:
        raise RuntimeError(f"reference of {name}: {run.message}")
    known = p.compare(run) if p.reference else {}
    return SimpleNamespace(p=p, times=times, q=run.q[:], size=p.model.extent or float(np.abs(run.q[:]).max()), known=known)


def measure(problem, integrator, x=None):
    """Errors, CPU seconds and counts of a run with setting x, or with the default settings if x is None.

    x: h relative to the problem's time for generalized-alpha, rtol for the others.
    """
    c, (default, explicit) = case(problem), MAKERS[integrator]
    chosen = default() if x is None else explicit(x, c.p.t_end)
    start = {"q0": c.p.q0, "v0": c.p.v0}
    solve(c.p.model, 1e-6 * c.p.t_end, chosen, **start)
    run = solve(c.p.model, c.p.t_end, chosen, output=c.times, **start)
    seconds = [run.cpu_seconds]
    while len(seconds) < 3 and seconds[0] < SHORT:
        seconds.append(solve(c.p.model, c.p.t_end, chosen, every=10**9, **start).cpu_seconds)
    error = np.abs(run.q[:] - c.q[: len(run.t)]).max(axis=1) / c.size if run.success else np.full(1, np.nan)
    return {
        "error_max": float(error.max()),
        "error_end": float(error[-1]),
        "cpu_s": min(seconds),
        "steps": run.counts.steps,
        "rejected": run.counts.rejected,
        "factorizations": run.counts.factorizations,
        "size": c.size,
        "known": c.known,
        "outcome": "done" if run.success else run.message,
        "summary": run.summary(),
    }
