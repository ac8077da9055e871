"""Integrators, steps and tolerances for each problem of the work-precision study, and reasons for omitted runs."""

import numpy as np

from work_precision import radau_accuracy
from work_precision.integrators import FIXED, IDA_FORMS, RADAU

CLASSICAL = {"pendulum": 2e-2, "car-axis": 1e-2, "andrews": 6e-5}  # problem: coarsest step, s; halved again and again
SCENES = {
    "damped-ramp": 1e-3,
    "double-plate": 4e-3,
    "double-plate-motors": 4e-3,
    "plate-chain": 4e-3,
    "rigid-limit": 4e-3,
    "spin-up-beam": 4e-2,
}
STIFF = ("rigid-limit", "spin-up-beam")
EVENT, RAMP = "sudden-blow", "damped-ramp"
COARSER = 8  # times generalized-alpha's are the steps of Radau IIA
MEMBERS = (*FIXED, "alpha, adaptive", *(f"IDA {form}" for form in IDA_FORMS), "radau", *RADAU)
SHORT = {
    "problems": ("pendulum", "car-axis", "andrews", "damped-ramp", "double-plate"),
    "steps": (0, 2),
    "members": ("alpha", "alpha, Richardson", "energy-momentum", "alpha, adaptive")
    + tuple(f"IDA {form}" for form in IDA_FORMS)
    + ("radau", *RADAU),
}
FULL = {"problems": (*CLASSICAL, *SCENES), "steps": range(6), "members": MEMBERS}
ALWAYS = (  # members, problems, why these do not meet
    (set(MEMBERS) - {"alpha", "alpha, adaptive", "radau", "radau, fixed"}, (EVENT,), "what is compared is error control with fixed steps"),
    (set(MEMBERS) - {"alpha", "IDA ggl2", "radau", *RADAU}, (RAMP,), "what is fitted is the order of Radau IIA"),
    ({"energy-momentum"}, CLASSICAL, "it takes scenes of plates only"),
    ({"alpha, rho 0.5", "alpha, rho 0.99"}, CLASSICAL, "they differ in the damping of mesh modes, of which there are none"),
    (
        {"IDA index3", "IDA index2", "IDA index1", "IDA baumgarte"},
        STIFF,
        "IDA takes 1e4 to 1e6 steps on undamped stiff plates: its stabilised forms alone are run, to looser tolerances",
    ),
)
SPARED, ELSEWHERE = "left out of the short selection", "not in this table"
IN_SHORT = (
    ({"IDA index1", "IDA baumgarte"}, set(SHORT["problems"]) - {"andrews"}, SPARED),
    ({"alpha, Richardson", "IDA ggl1", "IDA index2"}, {"pendulum", "car-axis"}, SPARED),
    ({"IDA index2"}, {"double-plate"}, SPARED),
    (set(RADAU) - {"radau, fixed"}, set(CLASSICAL), SPARED),
    (set(MEMBERS) - set(SHORT["members"]), SHORT["problems"], SPARED),
)


def left_out(problem, member, quick):
    """Reason why a member does not run on a problem; empty if it runs."""
    rules = ALWAYS + IN_SHORT if quick else ALWAYS
    return next((why for members, problems, why in rules if member in members and problem in problems), "")


def tasks(quick):
    """One task for each run: problem, integrator and x, its step in s or its tolerance."""
    selected = SHORT if quick else FULL
    selection = [
        {"problem": problem, "integrator": member, "x": float(f"{x:.3g}"), "quick": quick}
        for problem in selected["problems"]
        for member in selected["members"]
        if not left_out(problem, member, quick)
        for x in ladder(problem, member, quick)
    ]
    tolerances, steps = [10.0**-k for k in range(3, 9)], [8e-3 / 2**k for k in range(7 if quick else 9)]
    blow = {"alpha": steps, "radau, fixed": steps[:6], "alpha, adaptive": tolerances, "radau": tolerances}
    selection += [
        {"problem": EVENT, "integrator": name, "x": float(f"{x:.3g}"), "quick": quick} for name, ladder in blow.items() for x in ladder
    ]
    return selection


def ladder(problem, member, quick):
    """Steps or tolerances of a member on a problem, coarse to fine."""
    if member == radau_accuracy.FIXED and problem in radau_accuracy.ASYMPTOTIC:
        return radau_accuracy.steps(problem, quick)
    if member in RADAU:
        return [COARSER * (CLASSICAL | SCENES)[problem] / 2**k for k in ((1, 3) if quick else range(6))]
    if member in FIXED:
        return [(CLASSICAL | SCENES)[problem] / 2**k for k in (SHORT if quick else FULL)["steps"]]
    if member == "alpha, adaptive":
        return _powers(1e-4, 1e-6 if quick else 1e-8, quick)
    if member == "radau":
        return _powers(1e-4, 1e-12 if problem in CLASSICAL and not quick else 1e-8, quick)
    return [1e-3, 1e-5] if member == "IDA index3" else _powers(1e-3, tightest(problem, member, quick), quick)


def tightest(problem, member, quick):
    """Smallest tolerance of IDA: below it stiff scenes without damping need a million steps."""
    if problem in CLASSICAL:
        return 1e-9 if quick and member != "IDA ggl2" else 1e-12
    return 1e-7 if quick else {"rigid-limit": 1e-5, "spin-up-beam": 1e-4}.get(problem, 1e-9)


def _powers(loose, tight, quick):
    return [float(f"1e{round(power)}") for power in np.arange(np.log10(loose), np.log10(tight) - 0.5, -2 if quick else -1)]


def not_run(rows):
    """Lines on members without a row on a problem of the table, with the reason."""
    met = {(row["problem"], row["integrator"]) for row in rows}
    absent = {}
    for problem, quick in {row["problem"]: row["quick"] for row in rows}.items():
        for member in MEMBERS if problem in (*CLASSICAL, *SCENES, EVENT) else ():
            if (problem, member) not in met:
                absent.setdefault((member, left_out(problem, member, quick) or ELSEWHERE), []).append(problem)
    together = {}
    for (member, why), problems in absent.items():
        together.setdefault((", ".join(problems), why), []).append(member)
    return [f"not run: {'; '.join(members)} on {problems}: {why}" for (problems, why), members in together.items()]
