"""What is told of a run: as data, in the form of figures.json, and as a table."""

from contextlib import suppress

from polyida.cli.screen import tables
from polyida.errors import InputError


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
    tables.texts(
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
