"""Processes that are killed at random times: a run that writes to a file and is resumed, a sweep that is repeated, and what replaces files."""

import mmap
import os
import random
import signal
import struct
import tempfile
import time
import warnings
from pathlib import Path
from types import SimpleNamespace

import meshio
import numpy as np

from polyida import mesh
from polyida.io.layout import FRAMES
from polyida.io.load import load
from polyida.problems import plates
from polyida.run.resume import resume
from polyida.run.solve import solve
from polyida.show import animations, html, styles, vtu
from polyida.study.tasks import Study, run_tasks
from polyida.system import INSTANTS
from stress.outcome import Check, integrator

FLUSH = 50  # steps between flushes
ALLOWED = {"alpha": 0.0, "radau": 0.0, "energy": 1e-9, "ggl2": 5e-3, "ggl1": 5e-3}  # m: the resumed run against the whole one
SETTINGS = {"alpha": {"h": 1e-4}, "energy": {"h": 1e-4}, "radau": {"rtol": 1e-11}}  # of those that go on step for step


def killed_after(work, seconds):
    """Run work() in a forked process that is killed after so many CPU seconds. Returns True if the process ended before.

    CPU time does not depend on other processes of the machine. The signal of the timer ends a process at once, like SIGKILL. Raises
    ChildProcessError if work() failed.
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
    """`kills` kills of runs that write to a file: the resumed runs have the frames of a run without interruption, and no file loses more
    frames than one flush interval and one stretch of INSTANTS compiled steps. Frames are compared up to the first kill and, if resuming
    is exact, to the end.
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
            deviation = max(deviation, _largest_difference(part, whole, name))
            if part.status == "done":
                path.unlink()
        last = resume(path) if path.exists() and part.status != "done" else whole
    deviation = max(deviation, _largest_difference(last, whole, name))
    same_end = float(np.abs(last.q[-1] - whole.q[-1]).max())
    allowed = ALLOWED[name]
    return last, [
        Check("frames lost beyond the last flush", float(max(lost, 0)), 0.5),
        Check("stored frames, m", deviation, max(allowed, 1e-300)),
        Check("end of the resumed run, m", same_end, max(allowed, 1e-300)),
        Check("kills", float(kills), float(count)),
    ]


def _going_on(path, model, method, t_end, accepted):
    """The work of a killed process: continue from the file, or begin, and report accepted steps."""
    done = len(load(path)) - 1 if path.exists() else 0

    def report(t, steps=[done]):  # noqa: B006, the list is the counter
        steps[0] += 1
        accepted[:8] = struct.pack("q", steps[0])

    accepted[:8] = struct.pack("q", done)
    if path.exists():
        return lambda: resume(path, progress=report)
    return lambda: solve(model, t_end, method, out=path, flush_every=FLUSH, progress=report)


def _largest_difference(run, whole, name):
    """Largest difference of frames; for IDA, whose resumed runs take other steps, of the motion at equal times."""
    if name in SETTINGS:
        differences = [np.abs(np.asarray(getattr(run, key)) - getattr(whole, key)[: len(run)]).max(initial=0.0) for key in FRAMES]
        return float(differences[1] if name == "energy" else max(differences))
    at = np.stack([np.interp(run.t, whole.t, column) for column in whole.q.T], axis=1)
    return float(np.abs(np.asarray(run.q) - at).max())


def short_run(number, folder):
    """A task of the sweep: a short run that adds a line to a log."""
    with open(Path(folder) / "log", "a") as log:
        log.write(f"{number}\n")
    run = solve(plates.double_plate(cells=2).build(), 0.02 + 0.01 * (number % 7), integrator("alpha"))
    return {"end": [value.hex() for value in run.position("tip")[-1].tolist()]}


def killed_sweeps(kills, name="any", seed=0, tasks=12):
    """`kills` kills of sweeps of short runs, which are repeated until they are complete: no stored task runs again, and the rows are
    those of a sweep without interruption.
    """
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


def killed_writers(kills, seed=0):
    """`kills` kills of each way to replace a result: the folder then has the old result or the new one, whole, and the next call replaces it.

    Returns {name of the writer: {"old", "new" or what was wrong: count}}. Of a run that streams, frames from the first one on are new, too.
    """
    chance, counts = random.Random(seed), {}
    for name, (write, read) in writers().items():
        found = counts.setdefault(name, {})
        with tempfile.TemporaryDirectory() as folder:
            place = Path(folder)
            write(place, 0)
            old = read(place)
            begin = time.perf_counter()
            write(place, 1)
            span = time.perf_counter() - begin
            new = read(place)
            while sum(found.values()) < kills:
                write(place, 0)
                if read(place) != old:
                    found["not replaced"] = found.get("not replaced", 0) + 1
                if _killed_from_outside(lambda write=write, place=place: write(place, 1), chance.uniform(0.0, 2.0 * span)):
                    seen = outcome(read, place, old, new)
                    found[seen] = found.get(seen, 0) + 1
    return counts


def _killed_from_outside(work, seconds):
    """Run work() in a forked process that gets SIGKILL after so many seconds. Returns True if it came before the end."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        number = os.fork()
    if number == 0:
        code = 1
        try:
            work()
            code = 0
        finally:
            os._exit(code)
    time.sleep(seconds)
    os.kill(number, signal.SIGKILL)
    status = os.waitpid(number, 0)[1]
    if status and not os.WIFSIGNALED(status):
        raise ChildProcessError(f"the process failed by itself with code {os.waitstatus_to_exitcode(status)}")
    return os.WIFSIGNALED(status)


def outcome(read, place, old, new):
    """ "old", "new", or what is wrong with a place after a kill. A result of several files is a list, and each may be old or new."""
    try:
        found = read(place)
    except Exception as error:  # noqa: BLE001, a reader of a damaged file may raise anything
        return f"{type(error).__name__}: {error}"[:200]
    if found == old:
        return "old"
    if isinstance(found, list):
        return "new" if all(one in (before, after) for one, before, after in zip(found, old, new, strict=True)) else "damaged"
    return "new" if found == new or isinstance(found, bytes) and found and new.startswith(found) else "damaged"


def writers():
    """{name: (write(place, which), read(place))}; which: 0 of the old result, 1 of the new one."""
    model, method = plates.double_plate(cells=4).build(), integrator("alpha", h=1e-3)
    runs = [solve(model, t_end, method) for t_end in (0.02, 0.05)]
    kinds = {kind: [f"{kind} {which} ".encode() * 20_000 for which in range(2)] for kind in ("svg", "png", "pdf", "csv")}
    kinds["svg"] = [b'<svg width="1pt" viewBox="0 0 1 1">' + content + b"</svg>" for content in kinds["svg"]]
    kinds["csv"] = [b"x,y\n" + f"{which},1\n".encode() * 1000 for which in range(2)]
    meshes = [mesh.rectangle(1.0, 1.0, cells=cells, seed=0) for cells in (200, 400)]
    figures = [styles.figure()[0] for _ in range(2)]
    figures[1].axes[0].plot([0.0, 1.0])

    def page(place, which):
        files = {"p": {kind: contents[which] for kind, contents in kinds.items()}}
        writer = SimpleNamespace(figures={"p": None}, files=lambda: files)
        html.write(place / "page", f"title {which}", [html.Picture("p", "", None)], "made", {"python": "3"}, writer=writer)

    def rows(place, which):
        (place / "figures.json").unlink(missing_ok=True)
        study = Study(
            "rows", "", lambda quick: [{"number": k} for k in range(20)], lambda number: {"which": which, "text": "x" * 2000}, dict
        )
        run_tasks(study, True, place, fresh=True)

    def frames(place):
        names = vtu._frames_of(place / "frames" / "run.pvd")
        return b"".join(meshio.read(place / "frames" / name).points.tobytes() for name in sorted(names))

    frame_bytes = lambda place: np.asarray(load(place / "run.h5").q).tobytes()  # noqa: E731
    return {
        "save": (lambda place, which: runs[which].save(place / "run.h5", overwrite=True), frame_bytes),
        "stream": (
            lambda place, which: solve(model, (0.02, 0.05)[which], method, out=place / "run.h5", overwrite=True, flush_every=5),
            frame_bytes,
        ),
        "export": (lambda place, which: vtu.vtu(runs[which], place / "frames", overwrite=True, frames=4 + which), frames),
        "page": (page, lambda place: [(place / "page" / name).read_bytes() for name in ("report.html", "p.png", "p.pdf", "p.csv")]),
        "mesh": (
            lambda place, which: mesh.write(meshes[which], place / "mesh.vtu", overwrite=True),
            lambda place: (place / "mesh.vtu").read_bytes(),
        ),
        "figure": (
            lambda place, which: styles.save(figures[which], place / "figure.svg"),
            lambda place: (place / "figure.svg").read_bytes(),
        ),
        "movie": (
            lambda place, which: animations.animation(runs[which], place / "run.gif", frames=2 + which, width=2.0, overwrite=True),
            lambda place: (place / "run.gif").read_bytes(),
        ),
        "study": (rows, lambda place: [path.read_bytes() for path in sorted(place.glob("[!.]*.json"))]),
    }
