"""Effect of IDA's order and error test on flexible plates, damped or stiff: steps, work and error of the tip."""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from polyida.body.plate import Material
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.ida.integrator import IDA
from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.integrate.sizes import typical_sizes
from polyida.integrate.start import consistent_state
from polyida.problems import plates
from polyida.run.solve import solve
from polyida.study.comparison import watched_quantity
from polyida.study.ivp import InitialValueProblem


@lru_cache(maxsize=8)
def damped(cells, time, viscosity):
    """(problem, tip at the end) of the double plate with a Kelvin-Voigt time in s; the tip is from generalized-alpha at 1e-4 s and half of
    it, extrapolated.
    """
    rubber = plates.RUBBER
    material = Material(E=rubber.E, nu=rubber.nu, rho=rubber.rho, viscosity=viscosity)
    job = InitialValueProblem("double plate", plates.double_plate(cells, material=material).build(), t_end=time, point="tip")
    coarse, fine = (watched_quantity(job)(solve(job.model, time, GeneralizedAlpha(h=h), every=10**9).q[-1]) for h in (1e-4, 5e-5))
    return job, (4 * fine - coarse) / 3


def run_order(cells, time, viscosity, max_order, rtol=1e-5, cap=60_000):
    """One run of IDA with a largest order: counts, CPU seconds, error of the tip, and its steps over time."""
    job, tip = damped(cells, time, viscosity)
    run = solve(job.model, time, IDA(rtol=rtol, max_order=max_order, max_num_steps=cap), every=10)
    steps = np.diff(run.t) / 10
    shown = slice(None, None, max(1, len(steps) // 200))
    return _row(job, tip, run) | {"t": run.t[1:][shown], "h": steps[shown]}


@lru_cache(maxsize=8)
def stiff(cells, time, modulus):
    """(problem, tip at the end) of the double plate with Young's modulus in Pa; the tip is from Radau IIA."""
    material = replace(plates.RUBBER, E=modulus)
    job = InitialValueProblem("double plate", plates.double_plate(cells, material=material).build(), t_end=time, point="tip")
    return job, watched_quantity(job)(solve(job.model, time, RadauIIA(rtol=1e-8), every=10**9).q[-1])


def run_tested(cells, time, modulus, tested, rtol, cap):
    """One run of IDA of order 2 with the weights "q sharply" (default) or "q and v alike" (rtol of the sizes of both)."""
    job, tip = stiff(cells, time, modulus)
    length, speed = typical_sizes(job.model, consistent_state(job.model, 0.0, None, None), time)
    atol = None if tested == "q sharply" else (rtol * length, rtol * speed)
    return _row(job, tip, solve(job.model, time, IDA(rtol=rtol, atol=atol, max_num_steps=cap), every=10))


def _row(job, tip, run):
    """Work of a run, and the error of its tip at the end, m."""
    return {
        "dof": job.model.n,
        "outcome": "done" if run.success else run.message,
        "t_reached": float(run.t[-1]),
        "steps": run.counts.steps,
        "rejected": run.counts.rejected,
        "residuals": run.counts.residuals,
        "factorizations": run.counts.factorizations,
        "cpu_s": run.cpu_seconds,
        "tip_error": float(np.linalg.norm(watched_quantity(job)(run.q[-1]) - tip)) if run.success else float("nan"),
        "steps_per_s": run.counts.steps / float(run.t[-1]),
    }
