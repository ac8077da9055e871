"""What is said of a comparison, in a terminal and in its report: its columns, and sentences on it."""

import math

from polyida.show.html.blocks import shown

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
