"""Slopes in h of the rows of the step-size study, fitted in the range of a single cause of error, and theoretical slopes."""

import numpy as np

from polyida.linear.saddle import SCALINGS
from polyida.study.rows import column, fit_slope, pick, value

PARTS = ("q", "v", "a", "lam")
METHOD = {"q": 3, "v": 2, "a": 2, "lam": 2}  # theory, after a few steps
ROUND_OFF = {"q": 0, "v": -1, "a": -2, "lam": -2}  # theory, of phi from positions
WAYS = {"carried": True, "from positions": False}  # how phi is taken
STALL = {"carried": 0, "from positions": -2}  # theory of Newton's stall
SOLVES = (*SCALINGS, "compiled")  # the whole matrix in a scaling, or the compiled steps through the Schur complement
ABOVE = 5.0  # an error is fitted where it is so many times what else is seen there
LINEAR = 0.1  # a stall level above this share of the step's own motion is no longer a linear matter
WITHIN = 0.3  # slopes further from theory than this are told


def name_of(solve):
    """Ending of a figure's name; none for the scaling that is the default."""
    return "" if solve == "physical" else f"_{solve}"


def runs_of(rows, **wanted):
    """Rows with these values by rising h."""
    return sorted(pick(rows, **wanted), key=lambda row: row["h"])


def above_floor(runs, part):
    """Runs of the order study with an error ABOVE times the accuracy of the reference."""
    return [row for row in runs if value(row, f"error_{part}") > ABOVE * value(row, f"floor_{part}")]


def order(rows, scene, part, form="index3"):
    """Fitted order of a part in h, above the reference's floor."""
    runs = above_floor(runs_of(rows, part="order", scene=scene, form=form), part)
    return fit_slope(column(runs, "h"), column(runs, f"error_{part}"))


def method(rows, scene, part, solve):
    """Slope of an error after a few steps with carried phi, h from 1e-4 to 1e-2 s."""
    runs = [row for row in runs_of(rows, part="tiny", scene=scene, phi="carried", solve=solve) if 0.99e-4 < row["h"] < 1.01e-2]
    return fit_slope(column(runs, "h"), column(runs, f"error_{part}"))


def round_off(rows, scene, part, solve):
    """Slope of an error with phi from positions in the range where it is ABOVE times that with carried phi; of q, up to 1e-7 s."""
    of = {"part": "tiny", "scene": scene, "solve": solve}
    clean = {row["h"]: value(row, f"error_{part}") for row in runs_of(rows, phi="carried", **of)}
    runs = runs_of(rows, phi="from positions", **of)
    if part == "q":
        runs = [row for row in runs if row["h"] < 1.01e-7]
    else:
        runs = [row for row in runs if value(row, f"error_{part}") > ABOVE * clean.get(row["h"], np.nan)]
    return fit_slope(column(runs, "h"), column(runs, f"error_{part}"))


def stall(rows, scene, phi, solve):
    """Slope of Newton's stagnation level for h up to 1e-5 s, where it is linear."""
    runs = [row for row in runs_of(rows, part="tiny", scene=scene, phi=phi, solve=solve) if row["h"] < 1.01e-5]
    runs = [row for row in runs if value(row, "stall_q") < LINEAR]
    return fit_slope(column(runs, "h"), column(runs, "stall_q"))


def table(rows):
    """[(name of the figure, quantity, solver, slope, theory)] of errors after a few steps and of the stagnation level, with each solver."""
    figures = []
    for part in PARTS:
        for solve in SOLVES:
            slope = method(rows, "smooth motors", part, solve)
            figures.append((f"slope_method_{part}{name_of(solve)}", f"method, {part}", solve, slope, METHOD[part]))
        for solve in SOLVES:
            slope, what = round_off(rows, "smooth motors", part, solve), f"round-off of phi from positions, {part}"
            figures.append((f"slope_round_off_{part}{name_of(solve)}", what, solve, slope, ROUND_OFF[part]))
    for phi, theory in STALL.items():
        for solve in SCALINGS:
            name = f"stall_slope_phi_{phi.replace(' ', '_')}{name_of(solve)}"
            figures.append((name, f"Newton's stall, phi {phi}", solve, stall(rows, "scene 2", phi, solve), theory))
    return figures


def in_words(rows):
    """A line for each kind of slope: theory, and the slope with each solver."""
    lines = {}
    for _, what, solve, slope, theory in table(rows):
        if np.isfinite(slope):
            suffix = "" if abs(slope - theory) <= WITHIN else f" (not within {WITHIN:g})"
            lines.setdefault((what, theory), []).append(f"{solve} {slope:+.2f}{suffix}")
    return [f"slope in h, {what}: theory {theory:+d}; {', '.join(result)}" for (what, theory), result in lines.items()]
