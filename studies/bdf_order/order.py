"""What the order of BDF costs on flexible plates, undamped and damped: steps, work and the error of the tip."""

from functools import lru_cache

import numpy as np

from polyida.body.material import Material
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.ida.integrator import IDA
from polyida.integrate.solve import solve
from polyida.problems import plates
from polyida.study.compare import watch
from polyida.study.job import Job


@lru_cache(maxsize=8)
def damped(cells, time, viscosity):
    """(Job, tip at the end) of the double plate with a Kelvin-Voigt time in s; the tip from generalized-alpha at 1e-4 s
    and half, extrapolated.
    """
    rubber = plates.RUBBER
    material = Material(E=rubber.E, nu=rubber.nu, rho=rubber.rho, viscosity=viscosity)
    job = Job("double plate", plates.double_plate(cells, material=material).build(), time=time, point="tip")
    coarse, fine = (watch(job)(solve(job.model, time, GeneralizedAlpha(h=h), every=10**9).q[-1]) for h in (1e-4, 5e-5))
    return job, (4 * fine - coarse) / 3


def run_order(cells, time, viscosity, max_order, rtol=1e-5, cap=60_000):
    """One run of IDA with a highest order: counts, CPU seconds, error of the tip, and its steps over time."""
    job, tip = damped(cells, time, viscosity)
    run = solve(job.model, time, IDA(rtol=rtol, max_order=max_order, max_num_steps=cap), every=10)
    steps = np.diff(run.t) / 10
    error = float(np.linalg.norm(watch(job)(run.q[-1]) - tip)) if run.success else float("nan")
    return {
        "dof": job.model.n,
        "outcome": "done" if run.success else run.message,
        "t_reached": float(run.t[-1]),
        "steps": run.counts.steps,
        "rejected": run.counts.rejected,
        "residuals": run.counts.residuals,
        "factorizations": run.counts.factorizations,
        "cpu_s": run.cpu_seconds,
        "tip_error": error,
        "steps_per_s": run.counts.steps / float(run.t[-1]),
        "t": run.t[1:][:: max(1, len(steps) // 200)],
        "h": steps[:: max(1, len(steps) // 200)],
    }
