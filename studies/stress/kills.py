"""Kill -9 at random moments: of a run that writes to a file and is resumed, and of a sweep that is started again."""

import mmap
import os
import random
import signal
import struct
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np

from polyida.io.layout import FRAMES
from polyida.io.load import load
from polyida.problems import plates
from polyida.run.resume import resume
from polyida.run.solve import solve
from polyida.study.tasks import Study, run_tasks
from polyida.system import INSTANTS
from stress.outcome import Check, integrator

FLUSH = 50  # steps between flushes
ALLOWED = {"alpha": 0.0, "radau": 0.0, "energy": 1e-9, "ggl2": 5e-3, "ggl1": 5e-3}  # m: the resumed run against the whole one
SETTINGS = {"alpha": {"h": 1e-4}, "energy": {"h": 1e-4}, "radau": {"rtol": 1e-11}}  # of those that go on step for step


def killed_after(work, seconds):
    """Do work() in a new process that shares this one's memory and is killed after so much CPU time; whether it ended before.

    CPU time: so the moment does not depend on what else the machine does. The timer's signal ends a process at once, as SIGKILL does.
    Raises ChildProcessError if the work failed by itself.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of a fork beside threads: those of BLAS are idle
        number = os.fork()
    if number == 0:
        code = 1
        try:
            signal.signal(signal.SIGPROF, signal.SIG_DFL)
            signal.setitimer(signal.ITIMER_PROF, max(seconds, 1e-6))
            work()
            code = 0
        finally:
            os._exit(code)
    status = os.waitpid(number, 0)[1]
    killed = os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGPROF
    if not killed and status:
        raise ChildProcessError(f"the process failed by itself with code {os.waitstatus_to_exitcode(status)}")
    return not killed


def killed_runs(kills, name, seed=0, t_end=0.4):
    """`kills` kills of runs to a file, each resumed until it is killed again or ends: (last whole Trajectory, checks).

    Lost frames: those accepted before a kill that the file does not hold. At most one flush interval may be missing, and the
    INSTANTS steps that compiled code takes at most before a state from which a resumed run can go on. Wrong frames: up to the
    first kill and, where resuming is exact, all.
    """
    model, method = plates.double_plate_motors(cells=4).build(), integrator(name, **SETTINGS.get(name, {"rtol": 1e-6}))
    solve(model, t_end / 100, method)  # loads the kernels
    whole = solve(model, t_end, method)
    span = 2.0 * whole.cpu_seconds
    chance, deviation, lost, count = random.Random(seed), 0.0, 0, 0
    accepted = mmap.mmap(-1, 8)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.h5"
        while count < kills:
            work = _going_on(path, model, method, t_end, accepted)
            ended = killed_after(work, chance.uniform(0.0, span))
            count += not ended
            if not path.exists():
                continue
            part = load(path)
            written = struct.unpack("q", accepted[:8])[0]
            lost = max(lost, written - FLUSH - INSTANTS - (len(part) - 1))
            deviation = max(deviation, _apart(part, whole, name))
            if part.status == "done":
                path.unlink()
        last = resume(path) if path.exists() and part.status != "done" else whole
    deviation = max(deviation, _apart(last, whole, name))
    same_end = float(np.abs(last.q[-1] - whole.q[-1]).max())
    allowed = ALLOWED[name]
    return last, [
        Check("frames lost beyond the last flush", float(max(lost, 0)), 0.5),
        Check("kept frames, m", deviation, max(allowed, 1e-300)),
        Check("end of the resumed run, m", same_end, max(allowed, 1e-300)),
        Check("kills", float(kills), float(count)),
    ]


def _going_on(path, model, method, t_end, accepted):
    """What a victim does: go on from the file if there is one, tell every accepted step."""
    done = len(load(path)) - 1 if path.exists() else 0

    def tell(t, steps=[done]):  # noqa: B006, the list is the counter
        steps[0] += 1
        accepted[:8] = struct.pack("q", steps[0])

    accepted[:8] = struct.pack("q", done)
    if path.exists():
        return lambda: resume(path, progress=tell)
    return lambda: solve(model, t_end, method, out=path, flush_every=FLUSH, progress=tell)


def _apart(run, whole, name):
    """Largest difference of the frames, entry by entry, where a resumed run takes the same steps; for IDA that of the motion at equal times."""
    if name in SETTINGS:
        differences = [np.abs(np.asarray(getattr(run, key)) - getattr(whole, key)[: len(run)]).max(initial=0.0) for key in FRAMES]
        return float(differences[1] if name == "energy" else max(differences))
    at = np.stack([np.interp(run.t, whole.t, column) for column in whole.q.T], axis=1)
    return float(np.abs(np.asarray(run.q) - at).max())


def short_run(number, folder):
    """A task of the sweep: a short run, and a line in a log that tells that it was done."""
    with open(Path(folder) / "log", "a") as log:
        log.write(f"{number}\n")
    run = solve(plates.double_plate(cells=2).build(), 0.02 + 0.01 * (number % 7), integrator("alpha"))
    return {"end": [value.hex() for value in run.position("tip")[-1].tolist()]}


def killed_sweeps(kills, name="any", seed=0, tasks=12):
    """`kills` kills of sweeps of short runs, started again until they are whole: nothing is done twice that was written,
    and the rows are those of a sweep that was never killed."""
    chance, count, repeated, wrong = random.Random(seed), 0, 0, 0
    with tempfile.TemporaryDirectory() as folder:

        def sweep(number):
            place = Path(folder) / str(number)
            place.mkdir(exist_ok=True)
            study = Study("sweep", "", lambda quick: [{"number": k, "folder": str(place)} for k in range(tasks)], short_run, dict)
            return place, lambda: [row["end"] for row in run_tasks(study, True, place / "tasks")]

        sweep("warm")[1]()
        begin = time.process_time()
        expected, number = sweep("whole")[1](), 0
        span = time.process_time() - begin
        while count < kills:
            number += 1
            place, work = sweep(number)
            ended, here = False, 0
            while not ended and count < kills:
                ended = killed_after(work, chance.uniform(0.0, span))
                count, here = count + (not ended), here + (not ended)
            wrong += work() != expected
            repeated = max(repeated, len((place / "log").read_text().split()) - tasks - here)
            wrong += any(path.suffix != ".json" for path in (place / "tasks").iterdir())
    return None, [
        Check("sweeps with other rows or litter", float(wrong), 0.5),
        Check("tasks done again though written", float(max(repeated, 0)), 0.5),
    ]
