"""What speaks against a reference: two methods that agree may both have stepped over what is short and announced by no kink."""

import numpy as np

FINER = 1.5  # times the steps: of two runs that tell how far one moves
STANDS = 10.0  # times nearer to each other than to the reference, and beyond what is known of it: two runs that do not come to it


def short(reference):
    """The line on what is too short for a reference, of a model with forces that no kink announces; else none."""
    if "looked_at" not in reference:
        return []
    return [
        f"what acts for less than {reference['looked_at']:.1e} s between the steps of the reference is not seen, as far as no kink of the model "
        "announces it: known_to does not hold it"
    ]


def doubts(rows, runs, reference):
    """Lines on integrators whose ends stand still with finer steps, away from the reference. rows, runs: of all settings; with errors."""
    found = []
    for label in dict.fromkeys(row["integrator"] for row in rows):
        pairs = [(row, run) for row, run in zip(rows, runs) if row["integrator"] == label and run.success]
        found += _standing(label, sorted(pairs, key=lambda pair: pair[0]["steps"]), reference)
    return found


def _standing(label, pairs, reference):
    """The line of one integrator, or none."""
    finest, finest_run = pairs[-1] if pairs else ({}, None)
    before = [(row, run) for row, run in pairs if 0 < FINER * row["steps"] <= finest["steps"]]
    for part in ("q", "v") if before and "q" in reference else ():
        row, run = before[-1]
        error, moved = finest[f"error_{part}"], float(np.abs(getattr(finest_run, part)[-1] - getattr(run, part)[-1]).max())
        if error > STANDS * max(moved, reference["known_to"].get(part, 0.0)):
            return [
                f"{label}: from {row['steps']} to {finest['steps']} steps its {part} at the end moves by {moved:.1e}, and stands {error:.1e} from "
                "the reference: it follows another motion, or the reference has stepped over something short that no kink of the model announces"
            ]
    return []
