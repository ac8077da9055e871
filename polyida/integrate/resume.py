"""`resume`: go on with a run that is in a file."""

import time
from pathlib import Path

from polyida import trajectory_file as files
from polyida.errors import InputError
from polyida.file_lock import being_written
from polyida.frames import MEMORY_LIMIT, FrameStore
from polyida.integrate.run import Run
from polyida.integrate.solve import require_run
from polyida.integrate.state import Counts
from polyida.threads import one_blas_thread


def resume(path, t_end=None, *, model=None, integrator=None, until=None, progress=None, memory_limit=MEMORY_LIMIT):
    """Go on with the run in a file of `solve(..., out=path)` or `save`, to its t_end or another; the whole Trajectory.

    It starts at the state of the last flush; frames beyond it are computed again. Fixed-step generalized-alpha to the
    same t_end gives the frames of a run that was never interrupted, bit by bit on the same machine; IDA starts anew
    at order 1 there and agrees to its tolerance. The file is replaced by a copy that goes on, whole or not at all.
    model: needed for a model of a user's own, and where a motor or load follows a user's own function; the scene in
    the file otherwise. until: as in `solve`, needed where the run had one (False: go on without). Raises InputError
    for a file that cannot be read or is being written, has nothing to go on from, or has reached t_end.
    """
    with files.naming(path):
        path = Path(path)
        stored = files.read(path)
        try:
            if being_written(path):
                raise InputError("another process is still writing it")
            model, integrator = _parts(stored, model, integrator)
            plan = _plan(stored, t_end, until)
            require_run(model, plan["t_end"], stored.restart.state.t, integrator)
            file = files.continuation(path, stored, model, integrator, plan)
        finally:
            stored.file.close()
    restart, record = stored.restart, stored.record
    clocks = time.perf_counter() - float(record["wall_seconds"]), time.process_time() - float(record["cpu_seconds"])
    store = FrameStore(model.n, model.m, memory_limit, file)
    run = Run(model, integrator, plan, store, Counts(**restart.counts), clocks, until or None, progress)
    run.restart = run.flushed = restart
    with one_blas_thread():
        return run.go(restart.state)


def _parts(stored, model, integrator):
    """(model, integrator), from the file where they are not given."""
    about = stored.about
    if model is None and ("scene" not in about or about["drives"]):
        named = ", ".join(map(repr, about["drives"])) or about["model"]
        raise InputError(f"{named} has functions of the user's own, which no file holds; give model=")
    model = files.model_of(stored, {}) if model is None else model
    if (getattr(model, "n", None), getattr(model, "m", None)) != (stored.n, stored.m):
        raise InputError(f"the run has {stored.n} coordinates and {stored.m} constraints; the model is another")
    return model, files.integrator_of(stored) if integrator is None else integrator


def _plan(stored, t_end, until):
    """What was asked for, with the new end."""
    plan, restart = dict(stored.about["plan"]), stored.restart
    if restart is None or "t_end" not in plan:
        raise InputError("it holds no state to go on from")
    if until is None and plan["until"]:
        raise InputError(
            "the run had a function `until`, which no file holds; give until=, or until=False to go on without"
        )
    plan |= {"t_end": plan["t_end"] if t_end is None else t_end, "until": bool(until)}
    if not restart.state.t < plan["t_end"]:
        raise InputError(f"the run has reached t = {restart.state.t:.9g} s; give a later t_end to go on")
    return plan
