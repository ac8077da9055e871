"""`solve`: run an integrator over a model and collect a trajectory, whatever happens."""

import math
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.assembly.motion import hint_of_left_out
from polyida.environment import machine_info, one_blas_thread
from polyida.errors import InputError, ReductionWarning
from polyida.integrate.start import consistent_state, given, require_state, restarted
from polyida.integrate.state import Counts, Integrator, State, asked, constant_step
from polyida.io.layout import MEMORY_LIMIT, require_bytes
from polyida.io.save import create, free
from polyida.io.store import FrameStore
from polyida.model import Model
from polyida.model.check import require_declared
from polyida.model.guarded import Compiled, guard, unguarded
from polyida.progress import require_progress
from polyida.run.run import Run
from polyida.run.sampling import Recorder, require_sensors
from polyida.sensor import Sensor
from polyida.system.python import small_own
from polyida.validation import floats, is_number, is_one_of, is_whole, named_keywords, takes

if TYPE_CHECKING:
    from polyida.trajectory import Trajectory

MOST_STEPS = 1e12
SHORTEST = 1e-15  # s: what is divided by the squares of its steps is still a number in single precision
PRECISIONS = ("double", "single")
APART = 16  # times between t and t + h, at least


@named_keywords
def solve(
    model: Model,
    t_end: float,
    integrator: Integrator,
    *,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    t0: float = 0.0,
    state: State | None = None,
    every: int = 1,
    output: ArrayLike | None = None,
    until: Callable[[float, NDArray, NDArray], float] | None = None,
    progress: Callable[[float], object] | bool | None = None,
    sensors: dict[str, Callable[[float, NDArray, NDArray], ArrayLike] | Sensor] | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    flush_every: int = 100,
    fsync: bool = False,
    memory_limit: float = MEMORY_LIMIT,
    precision: str = "double",
) -> "Trajectory":
    """Run `integrator` on `model` from t0 (or from `state`, that of an earlier run) to t_end.

    q0, v0: initial coordinates and velocities; those left out are zero, v0 those of the bodies' velocity and spin, moved onto the
    constraints where they must be (see consistent_state). every: keep each `every`-th accepted step (the first and last always). output:
    increasing times; the frames are then exactly those, interpolated within the accepted steps (q cubic from q and v, v its derivative, a
    and lam linear). until: f(t, q, v) -> float; the run stops ("stopped") where it changes sign, located on the same interpolation; the
    last frame is there. progress: called with t at every accepted step; True shows a bar of tqdm (extra `notebook`). sensors: {name: f(t,
    q, v), or one of `pi.sensor`}, each giving a number or an array of one shape; called at the start and at every accepted step, whatever
    becomes a frame: `run.sensors[name]` (steps, ...) at `run.sensors.t`, kept in memory and in files.

    out: an HDF5 file to which the frames are written as they come. `polyida.load` reads it at any time, also after the
    process was killed or the disk was full, up to the last flush: that is after every `flush_every` steps or 2 s, or up
    to half as much later where a block of frames is whole by then; resume goes on from the last step by then whose memory
    is known (generalized-alpha on a scene works in stretches of up to 1024 steps). overwrite: replace an existing file, unless a process is
    writing it. fsync: have every flush on the disk before the run goes on, so that it survives a power cut too; slow. What comes back is
    what was written, also where the file was moved, removed or replaced meanwhile; the message says so then. Without `out`, frames beyond
    `memory_limit` bytes go to a file in the folder for temporary files (TMPDIR); a trajectory with more of them than
    that leaves them in the file, see Trajectory. precision: "single" keeps q, v, a and lam of the frames with 7 digits, in half the
    room, in memory and in files; the run itself, and the state to go on from, are as ever, but one that no step ended in, found by
    `until` or extrapolated, is the last frame.

    Returns a Trajectory; a numerical failure, Ctrl-C ("interrupted") and a full disk are its status and message, with the frames up to it.
    An exception in a user's function goes on to the caller; its attribute `trajectory` is the run so far. Ctrl-C after the last step raises
    KeyboardInterrupt, which has the whole run as `trajectory`. Raises InputError for a wrong input, before the run starts.
    """
    known = guard(model)
    _require_start(known, t0, state, q0, v0)
    require_progress("solve", progress)
    require_sensors("solve", sensors)
    begin = t0 if state is None else state.t
    require_run(model, t_end, begin, integrator)
    plan = _plan(begin, t_end, every, output, until, flush_every, fsync, precision) | {"began": _began(state)}
    require_bytes("solve", memory_limit)
    path = None if out is None else free(out, overwrite)
    clocks = time.perf_counter(), time.process_time()
    with one_blas_thread():
        state = _first(known, t0, state, q0, v0, t_end, asked(integrator, "nonholonomic"))
        asked(integrator, "require_reach")(known, state, t_end)
        recorder, file = Recorder(known, sensors or {}), None
        recorder.step(state)
        if path is not None:
            file = create(path, model, integrator, model.n, model.m, plan, machine_info(), precision == "single", recorder.shapes)
        store = FrameStore(model.n, model.m, memory_limit, file, precision == "single", _expected(plan, begin, integrator))
        run = Run(model, integrator, plan, store, recorder, Counts(), clocks, until, progress)
        run.begin(state, overwrite)
        found = run.go(state)
    if model.few and (left := hint_of_left_out(model, found.t, found.q, found.a)):
        warnings.warn(f"solve: {left}", ReductionWarning, stacklevel=3)
    return found


def _first(known, t0, state, q0, v0, t_end, nonholonomic):
    """The state to begin with; one that is not known to be accepted is put on the constraints. What the model says of itself is looked at."""
    if state is not None:
        state = require_state("solve", known, state)
        t0, q, v = state.t, state.q, state.v
    else:
        q, v = given(known, "q0", q0), given(known, "v0", v0)
    if small_own(known) and unguarded(known).by_numba:
        Compiled(known)
    require_declared(known, float(t0), q, v, float(t_end), nonholonomic)
    if state is None:
        return consistent_state(known, t0, q0, v0)
    return state if state.restart else restarted(known, state)


def require_run(model, t_end, begin, integrator):
    """Raise InputError unless these can make a run from `begin`."""
    if not hasattr(integrator, "steps") or isinstance(integrator, type):
        raise InputError(f"solve: {integrator!r} is no integrator; use polyida.GeneralizedAlpha(...) or polyida.IDA(...)")
    if not callable(integrator.steps):
        told = f"steps = {integrator.steps!r:.100} of {type(integrator).__name__}"
        raise InputError(f"solve: {told} must be a function, steps(model, state, t_end, counts), that yields a State a step")
    if not takes(integrator.steps, 4):
        raise InputError(f"solve: steps of {type(integrator).__name__} must take (model, state, t_end, counts)")
    asked(integrator, "require")(model)
    if not (is_number(t_end) and t_end > begin):
        raise InputError(f"solve: t_end = {t_end!r} must be a finite time after the start, t0 = {begin} s")
    _require_steps(begin, t_end, asked(integrator, "h"))


def _require_steps(begin, t_end, h):
    """Raise InputError for a run whose steps would be without number, or times and step sizes that floats do not resolve."""
    apart = math.ulp(max(abs(begin), abs(t_end)))
    shortest = max(SHORTEST, APART * apart)
    if t_end - begin < shortest:
        raise InputError(f"solve: t_end = {t_end!r} s is {t_end - begin:.3g} s after the start; the shortest run there is {shortest:.3g} s")
    if not is_number(h):
        return
    if t_end - begin > MOST_STEPS * h:
        raise InputError(f"solve: t_end = {t_end:g} s is more than {MOST_STEPS:g} steps of {h:g} s away, which no computer takes")
    if h < APART * apart and t_end - begin > h:
        raise InputError(f"solve: steps of {h:g} s are lost at t = {t_end:g} s, where times are {apart:.2g} s apart")


def _require_start(known, t0, state, q0, v0):
    if state is None:
        if not is_number(t0):
            raise InputError(f"solve: t0 = {t0!r} must be a finite time in s")
        return
    if q0 is not None or v0 is not None:
        raise InputError("solve: give either a state or q0 and v0; the state holds both")
    require_state("solve", known, state)


def _plan(begin, t_end, every, output, until, flush_every, fsync, precision):
    """What was asked for, as plain data that a file can hold."""
    for name, value in (("every", every), ("flush_every", flush_every)):
        if not is_whole(value):
            raise InputError(f"solve: {name} = {value!r} must be a whole number of at least 1")
    if not isinstance(fsync, bool):
        raise InputError(f"solve: fsync = {fsync!r} must be True or False")
    if until is not None and not callable(until):
        raise InputError(f"solve: until = {until!r} must be a function of t, q and v")
    if not is_one_of(precision, PRECISIONS):
        raise InputError(f"solve: precision = {precision!r} must be one of {', '.join(PRECISIONS)}")
    times = None if output is None else _times(output, begin, t_end)
    return {
        "t_end": float(t_end),
        "every": int(every),
        "output": times,
        "until": until is not None,
        "flush_every": int(flush_every),
        "fsync": fsync,
        "precision": precision,
    }


def _began(state):
    """How a run begins: at a "start" from q0 and v0, in a "state" that is taken as it is, or in one of another "run".

    A state of a run has the memory of its integrator, or is between two steps; one of `static` has no memory but its residual, `rest`.
    """
    if state is None:
        return "start"
    return "run" if state.memory.keys() - {"rest"} or not state.restart else "state"


def _expected(plan, begin, integrator):
    """How many frames there will be, 0 where nobody knows."""
    if plan["output"]:
        return len(plan["output"])
    h = constant_step(integrator)
    return int((plan["t_end"] - begin) / (h * plan["every"])) + 1 if h else 0


def _times(output, begin, t_end):
    times = floats(output)
    if times is None or times.ndim != 1 or not times.size or not (np.diff(times) > 0).all():
        raise InputError("solve: output must be increasing finite times in s, at least one")
    if times[0] < begin or times[-1] > t_end:
        raise InputError(f"solve: output from {times[0]} to {times[-1]} s is not within the run, {begin} to {t_end} s")
    return times.tolist()
