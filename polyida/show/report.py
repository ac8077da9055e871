"""The report of a comparison: what is said of it in a terminal, and its folder with report.html, figures.json, the runs and VTU frames."""

import json
import math
from contextlib import suppress
from pathlib import Path

from polyida.environment import machine_info
from polyida.show import html, plates, plots
from polyida.show.html import shown

FRAMES = 50  # VTU frames written at most
ERRORS = (
    "Errors are distances from the refined run, which is Radau IIA with a tolerance of 1e-9, or a thousandth of theirs, on the same mesh: "
    "they are errors in time, not of the mesh. CPU seconds do not contain the compilation of kernels. The energy change is that of "
    "kinetic, strain and gravity energy together, less the work of the motors."
)
STICKS = "The bodies at several times, each drawn between its points."
SETTINGS = {"run": ("run", "{}"), "settings": ("settings", "code")}


def begin(job, runs, press):
    """Give to a Press what can be drawn of {label: Trajectory} before the refined run; a picture that fails waits for `write`."""
    for name, (draw, _) in pictures(job, runs).items():
        with suppress(Exception):
            press.give(name, draw())


def write(comparison, folder, command, press, tell=lambda what: None):
    """Write the report of a Comparison into an existing folder; returns the path of report.html.

    command: what was typed, shown in the report and in figures.json. press: a Press, which draws. tell: called with the
    name of what is being written.
    """
    folder, machine = Path(folder), machine_info()
    for label, run in comparison.runs.items():  # first what cannot be made again in a moment
        tell(f"{label}.h5")
        run.save(folder / f"{label}.h5", overwrite=True)
    data = {"figures": comparison.figures, "rows": finite(comparison.rows), "machine": machine, "command": command}
    (folder / "figures.json").write_text(json.dumps(data, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    found = pictures(comparison.job, comparison.runs, comparison)
    for name, (draw, _) in found.items():
        if name not in press:
            press.give(name, draw())
    found = [html.Picture(name, caption, press[name]) for name, (_, caption) in found.items()]
    if (shown := _drawable(comparison.runs)) and shown.model.drawn:
        from polyida.show.vtu import vtu

        tell("frames")
        vtu(shown, folder / "frames", overwrite=True, frames=FRAMES)
    tell("pictures")
    *others, last = comparison.runs
    title = f"{comparison.job.name}: {' and '.join(filter(None, [', '.join(others), last]))}"
    moving = [html.Heading("Motion"), html.Movie(shown, f"The motion by {_label(comparison, shown)}.")] if shown else []
    table, text = html.Table(columns(comparison), comparison.rows), html.Text(f"{ERRORS} {gap(comparison)}")
    settings = [html.Heading("Settings"), html.Table(SETTINGS, comparison.rows)]
    page = [html.Notes(comparison.notes), html.Heading("Result"), table, text, *settings, *moving, html.Heading("Figures"), *found]
    return html.write(folder, title, page, command, machine, f"{system(comparison.job)}.", press)


def _label(comparison, run):
    return next(label for label, other in comparison.runs.items() if other is run)


def pictures(job, runs, comparison=None):
    """{file name: (function that draws it, caption)} of what these runs can show, with a Comparison also how far they are from the refined run."""
    moving, shown, found = {label: run for label, run in runs.items() if len(run.t) > 1}, _drawable(runs), {}
    if shown and shown.model.drawn:
        found["mesh"] = lambda: plots.mesh(job.model), "The polygon meshes at rest; a shade is a number of corners."
    if shown:
        caption = "The plates at several times, coloured by the von Mises stress of every element." if shown.model.drawn else STICKS
        found["deformed"] = lambda: plots.deformed(shown), caption
    return found | (_curves(job, moving, comparison) if moving else {})


def _curves(job, runs, comparison):
    """The pictures that any model has, in the form of `pictures`."""
    model, point, found = job.model, job.point, {}
    if point:
        found["tip"] = lambda: plots.tip(runs, point), f"Path of {point}, and how far it is from there in the other runs."
    else:
        found["coordinates"] = lambda: plots.coordinates(runs), "The first coordinates."
    if comparison:
        distances = {label: comparison.distances[label] for label in runs}
        caption = f"Distance of {comparison.quantity} from the refined run."
        found["error"] = lambda: plots.errors(distances, comparison.unit), caption
    if model.rows:
        caption = "What each joint does to the body on its far side."
        found["reactions"] = lambda: plots.reactions(runs, list(model.rows)), caption
    caption = "Energies of the first run, and what each run gains or loses beside the work of parts and what they dissipate."
    found["energy"] = lambda: plots.energy(runs), caption
    if model.m:
        found["drift"] = (
            lambda: plots.drift(runs),
            f"How well the constraints hold: the largest violation in each of {plots.INTERVALS} intervals of time.",
        )
    return found


def _drawable(runs):
    """The first run whose plates can be drawn, or None."""
    shown = [run for run in runs.values() if len(run.t) > 1 and plates.drawable(run.model)]
    return shown[0] if shown else None


COLUMNS = {  # key of a row -> heading, format
    "run": ("run", "{}"),
    "error_max": ("error, largest", "{:.2e}"),
    "error_end": ("error, at the end", "{:.2e}"),
    "published_error": ("from published", "{:.2e}"),
    "cpu_s": ("CPU s", "{:.2f}"),
    "steps": ("steps", "{}"),
    "newton_iterations": ("iterations", "{}"),
    "factorizations": ("factorizations", "{}"),
    "drift_max": ("drift of phi", "{:.1e}"),
    "energy_change": ("energy change, J", "{:.2e}"),
}


def columns(comparison):
    """{key of a row: (heading, format)} of what the rows of the comparison have."""
    quantity, unit = comparison.quantity, f", {comparison.unit}" if comparison.unit else ""
    return {
        key: (f"{quantity} {heading}{unit}" if "error" in key else heading, form)
        for key, (heading, form) in COLUMNS.items()
        if any(key in row for row in comparison.rows)
    }


def table(comparison):
    """Headings and rows of text of the comparison's table; what a run does not have is a dash."""
    found = columns(comparison)
    rows = [[shown(row.get(key), form, dash="-") for key, (_, form) in found.items()] for row in comparison.rows]
    return [heading for heading, _ in found.values()], rows


def system(job):
    """Size of the system and time simulated, in words."""
    plural = "s" * (job.model.m != 1)
    return f"{job.model.n} coordinates, {job.model.m} constraint{plural}, {job.time:g} s simulated"


def gap(comparison):
    """A sentence on how far apart the integrators end, empty where one of them did not get there."""
    if not math.isfinite(comparison.gap):
        return ""
    who = "the two integrators are" if len(comparison.runs) == 2 else "two of the integrators are at most"
    return " ".join(f"At the end {who} {comparison.gap:.2e} {comparison.unit} apart.".split())


def finite(value):
    """Plain data in which numbers that JSON cannot hold are None."""
    if isinstance(value, dict):
        return {name: finite(entry) for name, entry in value.items()}
    if isinstance(value, list):
        return [finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
