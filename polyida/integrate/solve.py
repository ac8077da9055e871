"""`solve`: run an integrator over a model and collect a trajectory, whatever happens."""

import time

import numpy as np

from polyida.errors import InputError
from polyida.integrate.start import consistent_state
from polyida.integrate.state import Counts, StepFailure
from polyida.machine import machine_info
from polyida.model import Model
from polyida.threads import one_blas_thread
from polyida.trajectory import Trajectory


def solve(model, t_end, integrator, *, q0=None, v0=None, t0=0.0, state=None, every=1, progress=None):
    """Run `integrator` on `model` from t0 (or from `state`, an earlier one) to t_end.

    q0, v0: initial coordinates and velocities; those left out are zero, moved onto the constraints where they must be.
    every: keep each `every`-th accepted step (the first and last always). progress: called with t at every accepted step.
    Returns a Trajectory; a numerical failure is its status and message, with all frames up to it.
    Raises InputError for a wrong input, before the run starts.
    """
    _require(model, t_end, t0 if state is None else state.t, integrator, every)
    counts, frames, ended = Counts(), _Frames(), ("done", "")
    wall, cpu = time.perf_counter(), time.process_time()
    with one_blas_thread():
        state = consistent_state(model, t0, q0, v0) if state is None else state
        frames.add(state)
        try:
            for state in integrator.steps(model, state, float(t_end), counts):
                if counts.steps % every == 0:
                    frames.add(state)
                if progress is not None:
                    progress(state.t)
        except StepFailure as failure:
            ended = failure.status, str(failure)
        frames.add(state)
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    return Trajectory(model, integrator, *frames.arrays(), *ended, counts, cpu, wall, machine_info(), state.memory)


class _Frames:
    """Accepted states, each once."""

    def __init__(self):
        self._states = []

    def add(self, state):
        if not self._states or state is not self._states[-1]:
            self._states.append(state)

    def arrays(self):
        return tuple(np.array([getattr(state, name) for state in self._states]) for name in ("t", "q", "v", "a", "lam"))


def _require(model, t_end, t0, integrator, every):
    if not isinstance(model, Model):
        hint = "; call its build()" if hasattr(model, "build") else ""
        raise InputError(f"solve: the model is {type(model).__name__}, a polyida.Model is needed{hint}")
    if not hasattr(integrator, "steps"):
        raise InputError(f"solve: {integrator!r} is no integrator; use polyida.GeneralizedAlpha(...) or polyida.IDA(...)")
    if not (isinstance(t_end, (int, float, np.floating, np.integer)) and np.isfinite(t_end) and t_end > t0):
        raise InputError(f"solve: t_end = {t_end!r} must be a finite time after the start, t0 = {t0} s")
    if not (isinstance(every, (int, np.integer)) and every >= 1):
        raise InputError(f"solve: every = {every!r} must be a whole number of at least 1")
