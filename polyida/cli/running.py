"""The runs of a command: where they are written, how they begin, go on, are loaded, and what is told of them."""

from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path

from polyida.cli import screen
from polyida.cli.screen import bars, lines
from polyida.errors import InputError


def free(given, default, overwrite, tell):
    """Where to write: a given path must be free unless `overwrite`; the default gets a number where it is taken.

    tell: called with a line that says so. A symlink is followed. Raises InputError where the path is taken.
    """
    path, number = given or default, 2
    path = _resolved(path) if path.is_symlink() else path
    if overwrite or not _taken(path):
        return path
    if given:
        raise InputError(f"{given} exists: choose another name, or say --overwrite to replace it")
    while _taken(path):
        path = default.with_name(f"{default.stem}-{number}{default.suffix}")
        number += 1
    tell(f"{default} exists and is kept; writing {path}")
    return path


def _resolved(link):
    try:
        return link.resolve()
    except (OSError, RuntimeError):
        raise InputError(f"{link} is a symlink that leads nowhere but to itself") from None


def _taken(path):
    return path.exists() and not (path.is_dir() and not any(path.iterdir()))


def make(folder):
    """Make a folder with those above it. Raises InputError where that cannot be done."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: the folder cannot be made ({error.strerror})") from error


@contextmanager
def made(folder):
    """A folder made before the run, so that it is known at once if it cannot be; removed if nothing came into it."""
    make(folder)
    try:
        yield
    finally:
        if not any(folder.iterdir()):
            folder.rmdir()


def begun(scene, integrator, options, settings, out, overwrite):
    """(run, its file) of a scene with its options, by an integrator with its settings."""
    from polyida.run.solve import solve
    from polyida.study import chosen
    from polyida.study.chosen import load
    from polyida.study.compare import warm_up

    job, choice = load(scene, step=None if settings["step"] == "auto" else settings["step"], **options), chosen.choice(integrator)
    member = choice.made(job, **{name: value for name, value in settings.items() if value is not None})
    path = free(out, Path(f"{job.name}-{integrator.rpartition(':')[2]}.h5"), overwrite, lines)
    make(path.parent)
    with bars() as tell, job.code(), choice.code():
        tell("preparing kernels", None)
        warm_up(job, member)
        told = {"progress": lambda t: tell(choice.label, t / job.time), "out": path, "overwrite": overwrite}
        return solve(job.model, job.time, member, q0=job.q0, v0=job.v0, **told), path


def require_none(options, why):
    """Raise InputError for an option that was given."""
    if strange := [name for name, value in options.items() if value is not None]:
        raise InputError(f"run: --{strange[0].replace('_', '-')} has no place here: {why}")


def resumed(path, scene, cells, time):
    """Go on with the run in a file; the model comes from `scene` where that is given."""
    from polyida.run.resume import resume
    from polyida.study.chosen import load

    job = load(scene, time=time, cells=cells) if scene else None
    end = time or loaded(path).plan.get("t_end") or 1.0
    with bars() as tell, job.code() if job else nullcontext():
        return resume(path, time, model=job and job.model, progress=lambda t: tell("going on", t / end))


def loaded(file):
    """A saved run; InputError where there is none."""
    from polyida.io.load import load

    if not file.is_file():
        raise InputError(f"{file}: there is no such file")
    return load(file)


def run_told(run, file, command):
    """{"figures", "rows", "notes", "machine", "command"} of one run in a file. machine: that it was made with."""
    row = {
        "run": str(file),
        "settings": repr(run.integrator),
        "success": bool(run.success),
        "status": run.status,
        "t_end": float(run.t[-1]) if len(run.t) else None,
        "frames": len(run.t),
        "coordinates": int(run.q.shape[1]),
        "constraints": int(run.lam.shape[1]),
        "cpu_s": float(run.cpu_seconds),
        "wall_s": float(run.wall_seconds),
        **run.counts.as_dict(),
    }
    with suppress(InputError):  # a model that no file holds
        row["drift_max"] = float(max(run.drift, default=0.0))
    figures = {key: value for key, value in row.items() if isinstance(value, int | float) and not isinstance(value, bool)}
    notes = [run.message] if run.message else []
    return {"figures": figures, "rows": [row], "notes": notes, "machine": dict(run.machine), "command": command}


def show_run(run, file):
    """Print what a run holds: how it ended, its work, and what it was made with."""
    counts, machine = (", ".join(f"{key} {value}" for key, value in data.items()) for data in (run.counts.as_dict(), run.machine))
    kind, n, m = type(run.model).__name__, run.q.shape[1], run.lam.shape[1]
    screen.texts(
        ["", ""],
        [
            ["run", run.summary()],
            ["frames", f"{len(run.t)}" + (f", t = {run.t[0]:g} .. {run.t[-1]:g} s" if len(run.t) else "")],
            ["model", f"{kind}, {n} coordinates, {m} constraints"],
            ["integrator", repr(run.integrator)],
            ["counts", counts],
            ["time", f"{run.cpu_seconds:.2f} CPU s, {run.wall_seconds:.2f} s"],
            ["made with", machine],
        ],
        str(file),
    )
