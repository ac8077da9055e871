"""The HTML page of a comparison: one file that stands alone, its pictures inside."""

import base64
import math
from html import escape

from polyida.machine import footer

COLUMNS = {  # key of a row -> heading, format
    "run": ("", "{}"),
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


def table(comparison):
    """Headings and rows of text of the comparison's table; what a run does not have is a dash."""
    columns = {key: column for key, column in COLUMNS.items() if any(key in row for row in comparison.rows)}
    quantity, unit = comparison.quantity, f", {comparison.unit}" if comparison.unit else ""
    headings = [f"{quantity} {heading}{unit}" if "error" in key else heading for key, (heading, _) in columns.items()]
    return headings, [[_text(row.get(key), form) for key, (_, form) in columns.items()] for row in comparison.rows]


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


def page(comparison, folder, captions, machine, command):
    """The page as text. captions: {name of a picture, which is name.png in `folder`: caption}."""
    headings, rows = table(comparison)
    settings = [f"{_cell('th', row['run'])}<td><code>{escape(row['settings'])}</code></td>" for row in comparison.rows]
    return PAGE.format(
        title=escape(f"{comparison.job.name}: {' and '.join(comparison.runs)}"),
        system=escape(system(comparison.job)),
        command=escape(command),
        notes="".join(f'<p class="note">{escape(note)}</p>' for note in comparison.notes),
        head="".join(_cell("th", heading) for heading in headings),
        rows="".join(f"<tr>{''.join(_cell('td', text) for text in row)}</tr>" for row in rows),
        settings="".join(f"<tr>{row}</tr>" for row in settings),
        figures="".join(_figure(folder, name, caption) for name, caption in captions.items()),
        gap=gap(comparison),
        machine=escape(footer(machine)),
    )


def finite(value):
    """Plain data in which numbers that JSON cannot hold are None."""
    if isinstance(value, dict):
        return {name: finite(entry) for name, entry in value.items()}
    if isinstance(value, list):
        return [finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _figure(folder, name, caption):
    data = base64.b64encode((folder / f"{name}.png").read_bytes()).decode()
    return (
        f'<figure><img alt="{escape(caption)}" src="data:image/png;base64,{data}">'
        f"<figcaption>{escape(caption)} <code>{name}.pdf</code></figcaption></figure>"
    )


def _cell(kind, text):
    return f"<{kind}>{escape(text)}</{kind}>"


def _text(value, form):
    missing = value is None or (isinstance(value, float) and not math.isfinite(value))
    return "-" if missing else form.format(value)


PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>{title}</title>
<style>
body {{ font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }}
h1 {{ font-size: 1.5rem; }} h2 {{ font-size: 1.1rem; margin-top: 2rem; }}
table {{ border-collapse: collapse; font-variant-numeric: tabular-nums; }} .wide {{ overflow-x: auto; }}
th, td {{ text-align: right; padding: .3rem .7rem; border-bottom: 1px solid #ddd; }} th {{ font-weight: 600; }}
td:first-child, .settings th, .settings td {{ text-align: left; }}
figure {{ margin: 1.5rem 0; }} figure img {{ width: 100%; max-width: 40rem; }}
figcaption {{ color: #555; font-size: .9rem; }} .note {{ color: #a33000; }}
code {{ font-size: .85em; background: #f4f4f4; padding: .1rem .3rem; }}
footer {{ margin-top: 3rem; color: #555; font-size: .8rem; }}
</style></head><body>
<h1>{title}</h1>
<p>{system}. Made by <code>{command}</code></p>
{notes}
<h2>Result</h2>
<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>
<p>Errors are distances from the refined run, which is Radau IIA with a tolerance of 1e-9, or a thousandth of theirs, on the same
mesh: they are errors in time, not of the mesh. CPU seconds do not contain the compilation of kernels. The energy change
is that of kinetic, strain and gravity energy together, less the work of the motors. {gap}</p>
<h2>Settings</h2>
<div class="wide"><table class="settings">{settings}</table></div>
<h2>Figures</h2>
{figures}
<footer>{machine}</footer>
</body></html>
"""
