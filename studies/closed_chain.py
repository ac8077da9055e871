"""Equations from SymPy: a chain of bars pinned at both ends, CPU time at equal error beside solve_ivp, solve_dae and scikit-sundae.

All solve the equations that sympy derives from one Lagrangian: the others by numpy functions of sympy's lambdify, as one writes them by hand. A
missing package is left out.
"""

from closed_chain.chain import BY_IVP, derive_row, row
from polyida.cli.study import main
from polyida.show.styles import legend_above, marker_style
from polyida.study.plotting import line_picture, panels, study_figure
from polyida.study.rows import column, distinct, pick
from polyida.study.tasks import Study

OURS = ("alpha", "radau", "ida")
SIDES = (*OURS, *BY_IVP, "solve_dae", "scikit-sundae")
PEERS = {"solve_ivp": BY_IVP, "solve_dae": ("solve_dae",), "scikit-sundae": ("scikit-sundae",)}
ERROR = 1e-6  # rad, of the largest error of q at the end
AIMS = {"derive_s": 5.0, "first_s": 15.0, "over_solve_ivp": 0.3, "over_solve_dae": 0.1, "over_scikit-sundae": 0.5}


def tasks(quick):
    links = (4,) if quick else (4, 8, 16)
    return [{"links": n, "side": side, "rounds": 1 if quick else 3} for n in links for side in ("derive", *SIDES)]


def run(links, side, rounds):
    """The cost of deriving, or one side at all its settings."""
    if side == "derive":
        return derive_row(links)
    try:
        return {"runs": row(links, side, rounds)}
    except ImportError as error:
        return {"skipped": str(error)}


def figures(rows):
    """Of each chain the seconds to derive and compile, and least CPU times within ERROR over those of the others."""
    result = {}
    for links in distinct(rows, "links"):
        for one in pick(rows, links=links, side="derive"):
            result |= {f"{name}_{links}": one[name] for name in ("derive_s", "first_s")}
        ours = _least(rows, links, OURS)
        for name, sides in PEERS.items():
            theirs = _least(rows, links, sides)
            if ours and theirs:
                result[f"over_{name}_{links}"] = ours / theirs
    return result


def _least(rows, links, sides):
    """The least CPU seconds of some sides at errors below ERROR; None without such a run."""
    runs = [one for side in sides for found in pick(rows, links=links, side=side) for one in found.get("runs", ())]
    return min((one["cpu_s"] for one in runs if one["outcome"] == "done" and one["error_rad"] < ERROR), default=None)


def notes(rows):
    """Missed targets of the longest chain, and what was left out."""
    links, found = max(distinct(rows, "links"), default=0), figures(rows)
    missed = [
        f"{name}: {found[key]:.3g} of {links} links, aim at most {aim:g}"
        for name, aim in AIMS.items()
        if (key := f"{name}_{links}") in found and found[key] > aim
    ]
    return missed + sorted({f"left out: {one['skipped']}" for one in rows if one.get("skipped")})


def _label(side):
    """The package and the method of a side."""
    package = "polyida" if side in OURS else "solve_ivp" if side in BY_IVP else ""
    return f"{package} {side}".strip()


@study_figure
def draw(rows):
    """Error against CPU time of all sides, a panel for each chain."""
    chains = distinct(rows, "links")
    fig, axes = panels(len(chains), width=10.0, height=3.6)
    for axis, links in zip(axes, chains):
        for i, side in enumerate(SIDES):
            runs = [one for found in pick(rows, links=links, side=side) for one in found.get("runs", ()) if one["outcome"] == "done"]
            if runs:
                axis.loglog(column(runs, "cpu_s"), column(runs, "error_rad"), label=_label(side), **marker_style(i))
        axis.set(xlabel=f"CPU time, s, {links} links", ylabel="error of q, rad")
    legend_above(fig, axes)
    return line_picture(fig, "closed-chain")


study = Study(
    "closed_chain",
    "Equations from SymPy: a closed chain",
    tasks,
    run,
    figures,
    draw,
    notes=notes,
    headline=tuple(AIMS),
    columns=("links", "side", "derive_s", "first_s", "skipped"),
)

if __name__ == "__main__":
    main(study)
