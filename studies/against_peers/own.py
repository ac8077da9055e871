"""The integrators of this package on the scenes: position of the tip at fixed times, and CPU seconds."""

import numpy as np

from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.ida.integrator import IDA
from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.run.solve import solve

TIMES = np.linspace(0.0, 1.0, 101)  # where the tip is compared, s
LEAN = 3e-3  # m/s^2 times h^2: what Newton may leave of q, a share of what weight moves in a step
OWN = {  # solver: (what it is called, integrator of a step, s, or a tolerance)
    "alpha": ("generalized-alpha", lambda h: GeneralizedAlpha(h=h)),
    "alpha lean": ("generalized-alpha, Newton to 3e-2", lambda h: GeneralizedAlpha(h=h, tolerance=0.03)),
    "ida": ("IDA", lambda rtol: IDA(rtol=rtol)),
    "radau": ("Radau IIA, by its error", lambda rtol: RadauIIA(rtol=rtol)),
    "radau fixed": ("Radau IIA, equal steps", lambda h: RadauIIA(h=h)),
    "radau lean": ("Radau IIA, equal steps, Newton to 3e-3 h²", lambda h: RadauIIA(h=h, tolerance=LEAN * h * h)),
    "radau lean, index 3": ("the same on index 3", lambda h: RadauIIA(h=h, tolerance=LEAN * h * h, form="index3")),
}
LABELS = {solver: label for solver, (label, _) in OWN.items()}


def tip_of(model):
    """Function q (n,) -> position of the tip, (2,), m."""
    rest = model.attachment("tip").point
    return lambda q: rest + model.displacement("tip", q)


def seen(model, integrator):
    """(counts, tip at TIMES (101, 2)) of a run. Raises RuntimeError if it fails."""
    run = solve(model, TIMES[-1], integrator, output=TIMES)
    if not run.success:
        raise RuntimeError(run.message)
    counts = {key: getattr(run.counts, key) for key in ("steps", "newton_iterations", "residuals", "tangents", "factorizations")}
    return counts, run.position("tip")


def seconds(model, integrator):
    """CPU seconds of a run without frames."""
    return solve(model, TIMES[-1], integrator, every=10**9).cpu_seconds


def ours(model, integrator, repeats):
    """(row, tip at TIMES) of an integrator of this package; CPU seconds are the median of `repeats` runs."""
    counts, tip = seen(model, integrator)
    again = [seconds(model, integrator) for _ in range(repeats)]
    return counts | {"cpu_s": float(np.median(again)) if again else np.nan}, tip


def largest(tip, exact):
    """Largest distance over TIMES, m."""
    return float(np.linalg.norm(tip - exact, axis=1).max())


def extrapolated(model, method, h):
    """Tip at TIMES by a method of second order with steps h and h / 2 and extrapolation."""
    coarse, half = (seen(model, method(h=step))[1] for step in (h, h / 2))
    return half + (half - coarse) / 3
