"""Gains of Radau IIA over generalized-alpha of an earlier commit, measured alternately with the present version: a slower generalized-alpha
is no gain of Radau IIA.
"""

from pathlib import Path

from against_peers import gain
from polyida.study.tasks import Study
from step_cost.against import Side, exported, whole_name
from step_cost.side import cells_for


def against(commit):
    """The study of the gains against a commit. Raises InputError if this is no clone that contains it."""
    whole = whole_name(commit)
    return Study(
        "against_peers",
        f"Radau IIA against generalized-alpha of {whole[:10]}",
        lambda quick: [
            {"scene": scene, "dof": 300 if quick else gain.DOF, "rounds": 1 if quick else 5, "commit": whole}
            for scene in ("scene 1", "scene 2")
        ],
        measured,
        figures,
        gain.figure,
        notes=gain.notes,
        columns=("scene", "n", "rounds", "reference_doubt"),
        headline=tuple(gain.TARGETS),
    )


def measured(scene, dof, rounds, commit):
    """The row of a scene."""
    tree = Path(exported(commit).name).resolve()
    with Side(tree, cells_for(dof), scene, script=Path(__file__).with_name("side.py")) as before:
        row = gain.in_rounds(scene, dof, rounds, before)
        if before.about["n"] != row["n"]:
            raise ArithmeticError(f"{before.about['n']} coordinates before, {row['n']} now: not the same model")
    return row


def figures(rows):
    """Gains over the present generalized-alpha, and over the earlier one: "..._before"."""
    before = gain.gains(rows, gain.BEFORE)
    return gain.gains(rows) | {f"{name}_before": before[name] for name in gain.TARGETS if name in before}
