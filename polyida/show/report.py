"""The folder of a comparison: report.html, its pictures as PNG and PDF, figures.json, the runs, VTU frames."""

import json
from pathlib import Path

from polyida.machine import machine_info
from polyida.show import plots
from polyida.show.page import finite, page
from polyida.show.style import save

FRAMES = 50  # VTU frames written at most


def write(comparison, folder, command, tell=lambda what: None):
    """Write the report of a Comparison into an existing folder; returns the path of report.html.

    command: what was typed, shown in the report and in figures.json. tell: called with the name of what is being
    written.
    """
    folder, machine = Path(folder), machine_info()
    for label, run in comparison.runs.items():  # first what cannot be made again in a moment
        tell(f"{label}.h5")
        run.save(folder / f"{label}.h5", overwrite=True)
    data = {"figures": comparison.figures, "rows": finite(comparison.rows), "machine": machine, "command": command}
    (folder / "figures.json").write_text(json.dumps(data, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    captions = _draw(comparison, folder, tell)
    if shown := _drawable(comparison):
        from polyida.show.vtu import vtu

        tell("frames")
        vtu(shown, folder / "frames", overwrite=True, frames=FRAMES)
    text = page(comparison, folder, captions, machine, command)
    (folder / "report.html").write_text(text, encoding="utf-8")
    return folder / "report.html"


def pictures(comparison):
    """{file name: (function that draws it, caption)} of what this comparison can show."""
    runs = {label: run for label, run in comparison.runs.items() if len(run.t) > 1}
    model, shown, found = comparison.job.model, _drawable(comparison), {}
    if shown:
        found["mesh"] = lambda: plots.mesh(model), "The polygon meshes at rest, shaded by number of corners."
        caption = "The plates at several times, coloured by the von Mises stress of every element."
        found["deformed"] = lambda: plots.deformed(shown), caption
    return found | (_curves(comparison, runs) if runs else {})


def _curves(comparison, runs):
    """The pictures that any model has, in the form of `pictures`."""
    model, point, found = comparison.job.model, comparison.job.point, {}
    if point:
        found["tip"] = lambda: plots.tip(runs, point), f"Path of {point}, and its coordinates against time."
    else:
        found["coordinates"] = lambda: plots.coordinates(runs), "The first coordinates."
    distances = {label: comparison.distances[label] for label in runs}
    caption = f"Distance of {comparison.quantity} from the refined run."
    found["error"] = lambda: plots.errors(distances, comparison.unit), caption
    if model.rows:
        caption = "What each joint does to the body on its far side."
        found["reactions"] = lambda: plots.reactions(runs, list(model.rows)), caption
    found["energy"] = lambda: plots.energy(runs), "Energy, and what is gained or lost beside the work of motors."
    if model.m:
        found["drift"] = lambda: plots.drift(runs), "How well the constraints hold."
    return found


def _draw(comparison, folder, tell):
    """Write all pictures; {file name: caption}."""
    captions = {}
    for name, (draw, caption) in pictures(comparison).items():
        tell(f"{name}.png")
        drawn = draw()
        for suffix in ("png", "pdf"):
            save(drawn, folder / f"{name}.{suffix}")
        captions[name] = caption
    return captions


def _drawable(comparison):
    """The first run whose plates can be drawn, or None."""
    runs = [run for run in comparison.runs.values() if len(run.t) > 1 and run.model.bodies]
    return runs[0] if runs else None
