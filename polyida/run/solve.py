"""`solve`: check the arguments of a run, find its first state, make its file and its store of frames, and run it.

In: model, integrator, times and start as a user gives them. Out: the Trajectory of `Run.go` (run.py). Wrong arguments are an InputError before
the first step; what follows it is the matter of run.py.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from polyida.assembly.motion import hint_of_left_out
from polyida.clock import clock
from polyida.environment import machine_info, one_blas_thread
from polyida.errors import InputError, ReductionWarning
from polyida.event import Event
from polyida.integrate.discontinuities import round_off
from polyida.integrate.start import consistent_state, require_state, restarted, vector_of, velocities_of
from polyida.integrate.state import Counts, HasSteps, State, declared
from polyida.io.layout import MEMORY_LIMIT
from polyida.io.save import create, free
from polyida.io.store import FrameStore
from polyida.model import Model
from polyida.model.check import require_declared, require_profiles
from polyida.model.compiled import Compiled
from polyida.model.guarded import guard
from polyida.model.row_laws import require_no_laws
from polyida.progress import require_progress
from polyida.run.contact_events import ContactHandler
from polyida.run.event_parts import prepared
from polyida.run.events import EventHandler
from polyida.run.recording import Recorder, require_of_state, require_sensors
from polyida.run.run import Run
from polyida.sensor import Sensor
from polyida.system.own import small_own
from polyida.validation import flag, floats, is_number, named_keywords, one_of, require_bytes, whole

if TYPE_CHECKING:
    from polyida.trajectory import Trajectory

MOST_STEPS = 1e12
SHORTEST = 1e-15  # s: numbers divided by the square of such a step are still finite in single precision
PRECISIONS = ("double", "single")
APART = 16  # floating-point numbers between t and t + h, at least


@named_keywords
def solve(
    model: Model,
    t_end: float,
    integrator: HasSteps,
    *,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    x0: ArrayLike | None = None,
    t0: float = 0.0,
    state: State | None = None,
    every: int = 1,
    output: ArrayLike | None = None,
    until: Callable[..., float] | None = None,
    events: Sequence[Event] | Event = (),
    progress: Callable[[float], object] | bool | None = None,
    sensors: dict[str, Callable[..., ArrayLike] | Sensor] | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    flush_every: int = 100,
    fsync: bool = False,
    memory_limit: float = MEMORY_LIMIT,
    precision: str = "double",
) -> Trajectory:
    """Run an integrator on a model from t0, or from the state of an earlier run, to t_end.

    Parameters
    ----------
    model : Model
        The model of a scene, or a user's own.
    t_end : float, s
        The end of the run.
    integrator : Integrator
        One of polyida's, or any object with `steps`; see Integrator.
    q0, v0 : (n,) float, optional
        Initial coordinates and velocities. By default q0 is zero and v0 that of the bodies' velocity and spin. They are projected onto the
        constraints; see `consistent_state`.
    x0 : (k,) float, optional
        First-order states at the start. By default those of the force elements or of the model.
    t0 : float, s
        The start of the run.
    state : State, optional
        Start from this state, for example `run.state`, instead of q0, v0, x0 and t0.
    every : int
        Every how many accepted steps a frame is stored; the first and the last state always are. Not together with output.
    output : (k,) float, s, optional
        Increasing times. The frames are then exactly those, interpolated within the accepted steps: q cubic from q and v, v its derivative,
        a and lam linear. Between steps of rigid bodies with driven constraints q and v are then put on these, with consistent a and lam.
    until : function f(t, q, v) or f(t, q, v, x) -> float, optional
        The run stops, with status "stopped", where f changes sign from one step to the next; x (k,) are the first-order states. That time
        is located on the same interpolation, driven constraints included, and is the last frame.
    events : list of Event, optional
        They change the model or the velocities where a function of the state changes its sign; `run.events` has those that happened. Both
        sides of an event are frames of the same time, unless `output` is given. lam has a column for each row of phi that ever acts, 0
        where it does not; `run.mode` is the model at the end.
    progress : function f(t), or True, optional
        Called at every accepted step; True shows a bar of tqdm (extra `notebook`).
    sensors : dict, {name: f(t, q, v), f(t, q, v, x) or one of `pi.sensor`}, optional
        Each returns a number or an array of one shape. They are called at the start and at every accepted step; `run.sensors[name]` has the
        values at the times `run.sensors.t`. They are in files too.
    out : path, optional
        An HDF5 file to which the frames are written during the run. `polyida.load` reads it at any time up to the last flush, also after
        the process was killed or the disk was full; `polyida.resume` continues it.
    overwrite : bool
        Replace an existing file, unless a process is writing it.
    flush_every : int
        Flush after so many steps or 2 s, or up to half as much later if a block of frames is complete by then. Generalized-alpha on a scene
        computes stretches of up to 1024 steps, and `resume` continues from the end of one.
    fsync : bool
        Wait at every flush until the data are on the disk, so that they survive a power failure; slow.
    memory_limit : float, bytes
        Without `out`, more frames than this go to a temporary file (TMPDIR). More frames than this stay in the file; see Trajectory.
    precision : "double" or "single"
        Of the stored q, v, a and lam. The run itself and its final state have double precision, unless the run ended between two steps.

    Returns
    -------
    Trajectory
        The frames, and how the run ended. After a numerical failure, Ctrl-C ("interrupted") or a full disk it has the frames so far. If the
        file was moved, removed or replaced during the run, the frames are complete and the message says so.

    Raises
    ------
    InputError
        For a wrong input, before the run starts.
    KeyboardInterrupt
        For Ctrl-C after the last step; its attribute `trajectory` is the complete run.
    Exception
        What a user's function raises; its attribute `trajectory` is the run so far.
    """
    if hasattr(t_end, "steps") and is_number(integrator):
        raise InputError(f"solve: t_end and the integrator are exchanged: t_end = {integrator!r} stands before the integrator")
    model, handler = _with_events(model, events, integrator)
    active = handler.mode if handler else guard(model)
    if state is None and not is_number(t0):
        raise InputError(f"solve: t0 = {t0!r} must be a finite time in s")
    if state is not None:
        if any(value is not None for value in (q0, v0, x0)):
            raise InputError("solve: give either a state or q0, v0 and x0; the state holds all of them")
        state = require_state("solve", active, state)
    if progress is not None:
        require_progress("solve", progress)
    require_sensors("solve", sensors, active)
    begin = t0 if state is None else state.t
    method = require_run(active, t_end, begin, integrator)
    whole("solve", "every", every)
    whole("solve", "flush_every", flush_every)
    flag("solve", "fsync", fsync)
    if until is not None:
        require_of_state("solve: until", until, active)
    one_of("solve", "precision", precision, PRECISIONS)
    times = _output_times(output, every, begin, t_end)
    require_bytes("solve", memory_limit)
    path = None if out is None else free(out, overwrite)
    plan = {  # plain data, for files
        "t_end": float(t_end),
        "every": int(every),
        "output": None if times is None else times.tolist(),
        "until": until is not None,
        "flush_every": int(flush_every),
        "fsync": fsync,
        "precision": precision,
        "began": _kind_of_start(state),
    }
    begun = clock()
    with one_blas_thread():
        _require_functions(active, state, begin, t_end, q0, v0, x0)
        if state is None:
            state = consistent_state(active, t0, q0, v0, x0)
        elif not state.restart:
            state = restarted(active, state)
        method.require_reach(active, state, t_end)
        recorder, file, m = Recorder(active, sensors or {}), None, active.m
        if handler:
            state, m = handler.start(state), handler.width
        recorder.step(state)
        single = precision == "single"
        if path is not None:
            file = create(path, model, integrator, active.n, m, plan, machine_info(), single, recorder.shapes)
        frames = _expected_frames(method.fixed_step(), times, every, t_end - begin)
        store = FrameStore(active.n, m, memory_limit, file, single, frames)
        run = Run(model, integrator, plan, store, recorder, Counts(), begun, until, progress, handler)
        run.begin(state, overwrite)
        result = run.go(state)
    if model.reduced_bodies and (hint := hint_of_left_out(model, result.t, result.q, result.a)):
        warnings.warn(f"solve: {hint}", ReductionWarning, stacklevel=3)
    return result


def _with_events(model, events, integrator):
    """(model with the parts that events add, EventHandler of a run with events or event-driven contact, else None)."""
    if not (events is None or events is False or (isinstance(events, (list, tuple)) and not events)):
        model, events = prepared("solve", model, events)
        if not declared(integrator).takes_laws:
            require_no_laws(
                "solve", guard(model), "events= beside contact or friction need polyida.NonsmoothAlpha(h=...) or MoreauJean(h=...)"
            )
        return model, EventHandler(model, events, declared(integrator))
    if isinstance(model, Model) and guard(model).row_laws and not declared(integrator).takes_laws:
        return model, ContactHandler(model, declared(integrator))
    return model, None


def _output_times(output, every, begin, t_end):
    """The given times of frames as an array, or None. Raises InputError unless they increase within the run."""
    if output is None:
        return None
    times = floats(output)
    if times is None or times.ndim != 1 or not times.size or not (np.diff(times) > 0).all():
        raise InputError("solve: output must be increasing finite times in s, at least one")
    if times[0] < begin or times[-1] > t_end:
        raise InputError(f"solve: output from {times[0]} to {times[-1]} s is not within the run, {begin} to {t_end} s")
    if every != 1:
        raise InputError(f"solve: every = {every} and output are given; output has the times of all frames, so leave every out")
    return times


def _kind_of_start(state):
    """What a run begins from: "start" (q0 and v0), "run" (a state of a run) or "state" (any other one).

    A state of a run has the memory of its integrator, or is between two steps; one of `static` has only its residual, `rest`.
    """
    if state is None:
        return "start"
    return "run" if state.memory.keys() - {"rest"} or not state.restart else "state"


def _require_functions(model, state, begin, t_end, q0, v0, x0):
    """Raise InputError if functions of the user's model or its profiles cannot be compiled or contradict what it declares."""
    q, v = (vector_of("q0", q0, model), velocities_of(v0, x0, model)) if state is None else (state.q, state.v)
    if not model.is_scene and small_own(model) and model.by_numba:
        Compiled(model)  # raises InputError for a function that numba cannot compile
    if not model.compiled or model.own_forces:  # a scene of polyida's own parts needs no check
        require_declared(model, float(begin), q, v, float(t_end))
    require_profiles(model, float(begin), float(t_end))


def _expected_frames(h, times, every, duration):
    """Number of frames of a run of that duration with constant steps h or frames at given times; 0 if it is unknown."""
    if times is not None:
        return len(times)
    return int(duration / (h * every)) + 1 if h else 0


def require_run(model, t_end, begin, integrator):
    """The Integrator of a run from `begin` to t_end. Raises InputError unless model, integrator and times make one."""
    method = declared(integrator)
    method.require(model)
    _require_takes(method, model)
    if not (is_number(t_end) and t_end > begin):
        raise InputError(f"solve: t_end = {t_end!r} must be a finite time after the start, t0 = {begin} s")
    _require_resolved(model.controllers if model.is_scene else (), t_end, begin, method.fixed_step())
    return method


def _require_takes(method, model):
    """Raise InputError if the model has laws of contact, velocity rows or controllers that the integrator does not know."""
    if guard(model).row_laws and not (method.takes_laws or method.trusted):
        names = ", ".join(dict.fromkeys(law.name for law in guard(model).row_laws))
        raise InputError(
            f"solve: {method.class_name()} knows no laws of contact and friction, those of {names}; use polyida.NonsmoothAlpha(h=...), or "
            "an integrator of polyida"
        )
    if guard(model).velocity_rows.size and not (method.trusted or method.velocity_rows):
        raise InputError(f"solve: {method.class_name()} knows no velocity rows; one that does has the attribute velocity_rows = True")
    controllers = model.controllers if model.is_scene else ()
    if controllers and not (method.trusted or method.takes_samples):
        names = ", ".join(repr(own.name) for own in controllers)
        needed = "one whose steps end at model.samples(t0, t1) and go on from model.sampled(t, q, v) has the attribute takes_samples = True"
        raise InputError(f"solve: {method.class_name()} takes no samples of the controllers {names}; {needed}")


def _require_resolved(controllers, t_end, begin, h):
    """Raise InputError unless floats resolve the run, its steps h (None: adaptive) and its sampling periods, and the steps are not too many."""
    apart = math.ulp(max(abs(begin), abs(t_end)))  # between two floats there
    shortest, near = max(SHORTEST, APART * apart), 2.0 * round_off(begin, t_end)
    for own in controllers:
        if own.period <= near:
            raise InputError(f"{own.name}: period = {own.period!r} s must be above {near:.2g} s in a run to t_end = {t_end:g} s")
    if t_end - begin < shortest:
        raise InputError(f"solve: t_end = {t_end!r} s is {t_end - begin:.3g} s after the start; the shortest run there is {shortest:.3g} s")
    if h and t_end - begin > MOST_STEPS * h:
        raise InputError(f"solve: t_end = {t_end:g} s is more than {MOST_STEPS:g} steps of {h:g} s away, which no computer takes")
    if h and h < APART * apart and t_end - begin > h:
        raise InputError(f"solve: steps of {h:g} s are lost at t = {t_end:g} s, where times are {apart:.2g} s apart")
