"""One run of work against precision: an integrator at one step or tolerance on one case."""

from functools import lru_cache

import numpy as np

from polyida.integrate.solve import solve
from polyida.study.families import last_state
from polyida.study.members import by_tolerance, integrator
from polyida.study.references import case

COUNTS = ("steps", "rejected", "newton_iterations", "residuals", "tangents", "factorizations", "solves")


@lru_cache(maxsize=64)
def warm(name, member, quick):
    """Two steps, so that compiling or loading kernels counts as nobody's time."""
    given = case(name, quick)
    h = 1e-4 * given.t_end
    solve(given.model, 2 * h, integrator(member, 1e-4 if by_tolerance(member) else h, given.sizes, h), q0=given.q0, v0=given.v0)


def measure(name, member, x, quick):
    """Errors at the end, CPU seconds and counts of one run; one that fails has its message as outcome, no errors."""
    given = case(name, quick)
    warm(name, member, quick)
    chosen = integrator(member, x, given.sizes, given.t_end / 20, given.newton)
    run = solve(given.model, given.t_end, chosen, q0=given.q0, v0=given.v0, every=10**9)
    outcome = {"outcome": "done" if run.success else run.message, "t": float(run.t[-1]), "cpu_s": run.cpu_seconds}
    outcome |= {key: getattr(run.counts, key) for key in COUNTS} | {"reference": given.how, "known": given.known}
    return (given.errors(last_state(run)) if run.success else {}) | outcome


def cheapest(rows, error, level):
    """CPU seconds at which the lower envelope of runs reaches an error level, interpolated on logarithmic axes; NaN
    where none does.
    """
    pairs = sorted((row["cpu_s"], row[error]) for row in rows if np.isfinite(row.get(error) or np.nan) and row[error] > 0)
    before = None
    for cpu, found in pairs:
        if found <= level:
            if before is None:
                return cpu
            weight = np.log(before[1] / level) / np.log(before[1] / found)
            return float(np.exp((1 - weight) * np.log(before[0]) + weight * np.log(cpu)))
        if before is None or found < before[1]:
            before = (cpu, found)
    return float("nan")
