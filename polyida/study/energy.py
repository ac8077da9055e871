"""Energy balance of a run: what the motors put in, and what is gained or lost beside that."""

import numpy as np

from polyida.io.frames import each


def motor_work(run):
    """Work of all that drives phi, motors and paths, up to every frame, `int lam . phi_t dt`, (frames,), J.

    By the trapezoidal rule.
    """
    work = np.zeros(len(run.t))
    if run.model.needs.driven:
        power = np.array([lam @ run.model.phi_t(t, q) for t, q, lam in zip(run.t, each(run.q), each(run.lam))])
        work[1:] = np.cumsum(np.diff(run.t) * (power[1:] + power[:-1]) / 2)
    return work


def unbalanced(run):
    """Change of the total energy since the start less the work of the motors, (frames,), J.

    NaN where a model states no potential. Zero for the exact motion of a scene without damping whose only load is
    gravity.
    """
    total = run.energy.total
    return total - total[0] - motor_work(run)
