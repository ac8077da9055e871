"""`resume`: continue a run that is in a file.

The file gives plan, model, integrator and the last state to go on from; functions of the user's are given again. Its frames up to that state are
copied to a new file, which replaces the old one, and the run goes on there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from polyida.clock import clock
from polyida.environment import one_blas_thread
from polyida.errors import InputError
from polyida.event import Event, Events
from polyida.integrate.state import Counts, declared
from polyida.io.layout import FRAMES, MEMORY_LIMIT
from polyida.io.load import integrator_of, model_of, sensors_of
from polyida.io.reader import naming, read
from polyida.io.save import behind_blocks, commit, create, free
from polyida.io.scene_data import UnknownPart
from polyida.io.store import FrameStore
from polyida.model import Model
from polyida.model.guarded import guard
from polyida.progress import require_progress
from polyida.run.contact_events import ContactHandler
from polyida.run.event_parts import prepared
from polyida.run.events import EventHandler
from polyida.run.recording import Recorder, require_of_state, require_sensors
from polyida.run.run import Run
from polyida.run.solve import require_run
from polyida.sensor import Sensor, Sensors
from polyida.validation import floats, is_flag, is_number, is_whole, named_keywords, require_bytes

if TYPE_CHECKING:
    from polyida.trajectory import Trajectory

PLAN = {  # what a file says on its run, and what that is
    "t_end": is_number,
    "every": is_whole,
    "output": lambda times: times is None or np.ndim(floats(times)) == 1,
    "until": is_flag,
    "flush_every": is_whole,
    "fsync": is_flag,
}


@named_keywords
def resume(
    path: str | Path,
    t_end: float | None = None,
    *,
    model: Model | None = None,
    integrator: object = None,
    events: Sequence[Event] | Event | bool | None = None,
    until: Callable[..., float] | bool | None = None,
    progress: Callable[[float], object] | bool | None = None,
    sensors: dict[str, Callable[..., ArrayLike] | Sensor] | bool | None = None,
    memory_limit: float = MEMORY_LIMIT,
) -> Trajectory:
    """Continue the run in a file of `solve(..., out=path)` or `save`.

    It starts at the last state in the file from which the integrator can continue: for small models this may be 1024 steps before the last
    frame. Frames after it are computed again. Radau IIA and fixed-step generalized-alpha to the same t_end give the frames of a run that
    was never interrupted, bit by bit on the same machine. Adaptive generalized-alpha, EnergyMomentum and IDA, which starts again at
    order 1, agree to their tolerance. A copy that is continued replaces the file, whole or not at all.

    Parameters
    ----------
    path : path of the file
    t_end : float, s, optional
        Another end than that of the run.
    model : Model, optional
        Needed for a user's own model, and if a motor or load has a user's own function; by default the scene in the file.
    integrator : Integrator, optional
        By default that of the run.
    events : list of Event, or False, optional
        As in `solve`; needed if the run had events, in the same order. False: continue without more of them. Give model= too if they have
        parts, which refer to its bodies.
    until : function f(t, q, v) -> float, or False, optional
        As in `solve`; needed if the run had one. False: continue without it.
    progress : function f(t), or True, optional
        As in `solve`.
    sensors : dict, or False, optional
        As in `solve`; needed if the run had sensors, with the same names. False: continue without them; their values so far stay.
    memory_limit : float, bytes
        As in `solve`.

    Returns
    -------
    Trajectory
        The whole run.

    Raises
    ------
    InputError
        If the file cannot be read or is being written, has no state to continue from, or has reached t_end; and for wrong arguments.
    """
    if not (t_end is None or is_number(t_end)):
        raise InputError(f"resume: t_end = {t_end!r} must be a finite time in s")
    require_progress("resume", progress)
    require_bytes("resume", memory_limit)
    stored = read(path)
    with naming(path, everything=False):
        try:
            if stored.live:
                raise InputError("another process is still writing it")
            with naming(path):
                if damage := stored.check():
                    raise InputError(f"{damage}; to go on from the last of them, load it and give its `state` to solve")
                plan, restart = _plan(stored, t_end, until), stored.restart
                machine = dict(stored.about["machine"])
                model, integrator = _model_and_integrator(stored, model, integrator)
                model, handler, past = _with_events(stored, model, integrator, events)
            active = handler.mode if handler else guard(model)
            if until is not None and until is not False:
                require_of_state("resume: until", until, active)
            if sensors is not False:
                require_sensors("resume", sensors, active)
            require_run(active, plan["t_end"], restart.state.t, integrator).require_reach(active, restart.state, plan["t_end"])
            recorder = _recorder(stored, active, sensors)
            store = _copied(stored, model, integrator, plan, machine, recorder, past, memory_limit)
        finally:
            stored.file.close()
    begun = tuple(now - spent for now, spent in zip(clock(), stored.seconds))
    run = Run(model, integrator, plan, store, recorder, Counts(**restart.counts), begun, until or None, progress, handler, past)
    run.restart = run.flushed = restart
    run.recorded = recorder.count
    with one_blas_thread():
        return run.go(restart.state)


def _model_and_integrator(stored, model, integrator):
    """(model, integrator) of the run, from the file if they are None. Raises InputError if the file cannot hold the model."""
    about = stored.about
    if model is None and ("scene" not in about or about["drives"]):
        own = ", ".join(map(repr, about["drives"].values())) or about["model"]
        raise InputError(f"{own} has functions of the user's own, which no file holds; give model=, or SCENE to `polyida run`")
    try:
        model = model_of(stored, {}) if model is None else model
    except UnknownPart as unknown:
        raise InputError(f"the file's scene cannot be built: {unknown}") from None
    return model, integrator_of(stored) if integrator is None else integrator


def _with_events(stored, model, integrator, events):
    """(model with the parts that events add, EventHandler or None, Events up to the state from which the run is continued)."""
    past = Events.from_data(stored.record.get("events") or [])
    past.happened = [one for one in past if one.t <= stored.restart.state.t]
    known, handler = guard(model, "resume"), None
    by_laws = bool(known.row_laws)
    if past.given and events is None and not by_laws:
        raise InputError("the run had events, whose functions no file holds; give events=, or events=False to go on without more of them")
    if by_laws and not declared(integrator).takes_laws:
        handler = ContactHandler(model, declared(integrator), past)
    elif events or past.given:
        model, events = prepared("resume", model, events or ())
        past.given = True
        handler = EventHandler(model, events, declared(integrator), past)
        known = handler.whole
    if (known.n, handler.width if handler else known.m) != (stored.n, stored.m):
        raise InputError(f"the run has {stored.n} coordinates and {stored.m} constraints; the model is another")
    return model, handler, past


def _copied(stored, model, integrator, plan, machine, recorder, past, memory_limit):
    """A FrameStore with the frames up to the state from which the run is continued, in a new file that replaces the old one."""
    n, m, restart = stored.n, stored.m, stored.restart
    file = create(free(stored.path, True), model, integrator, n, m, plan, machine, stored.single, recorder.shapes)
    with file.publishing(True):
        store = FrameStore(n, m, memory_limit, file, stored.single)
        store.copy([stored.columns[name] for name in FRAMES], restart.frames)
        rows = behind_blocks(file, recorder.rows)
        commit(store, "running", "", Counts(**restart.counts), stored.seconds, restart, rows, events=past)
    return store


def _plan(stored, t_end, until):
    """The stored plan of a run with a new end. Raises InputError if the run cannot be continued."""
    plan, restart = stored.about["plan"], stored.restart
    if restart is None or not plan:
        raise InputError("it holds no state to go on from")
    for name, is_good in PLAN.items():
        if name not in plan or not is_good(plan[name]):
            raise InputError(f"its plan is damaged: {name} = {plan.get(name)!r:.100}")
    if until is None and plan["until"]:
        raise InputError("the run had a function `until`, which no file holds; give until=, or until=False to go on without")
    plan = plan | {"t_end": plan["t_end"] if t_end is None else float(t_end), "until": bool(until)}
    if not restart.state.t < plan["t_end"]:
        raise InputError(f"the run has reached t = {restart.state.t:.9g} s; give a later t_end to go on")
    return plan


def _recorder(stored, model, sensors):
    """A Recorder with the values of the sensors up to the state from which the run is continued."""
    names, functions = ", ".join(map(repr, stored.sensors)), sensors or {}
    if sensors is None and names:
        raise InputError(
            f"the run had the sensors {names}, functions which no file holds; give sensors=, or sensors=False to go on without"
        )
    if sensors is not False and list(functions) != list(stored.sensors):
        raise InputError(
            f"the run had {f'the sensors {names}' if names else 'no sensors'}; it cannot go on with {', '.join(map(repr, functions))}"
        )
    recorded = sensors_of(stored)
    return Recorder(guard(model), functions, Sensors(recorded.shapes, recorded.rows[recorded.t <= stored.restart.state.t]))
