"""A process that times steps of another version of the package on request: `python side.py CELLS INTEGRATOR SHORT LONG` with that version
first on PYTHONPATH.

It prints its location and the size of the model, then a row of times and counts for every line of input. It uses only names that all
versions of the package have; its parent sets the threads.
"""

import json
import sys
import time
from dataclasses import replace
from functools import partial

import polyida
from polyida import Counts, consistent_state, solve
from polyida.problems.plates import double_plate

LARGE = 50_000  # coordinates from which on a run's start is dear
NO_FRAMES = 10**9  # keep every so many steps: the first and the last frame alone
MEMBERS = {  # the tolerances are given: a default may be another one on the other side
    "alpha": lambda: polyida.GeneralizedAlpha(h=1e-3, tolerance=1e-4),
    "ida": lambda: polyida.IDA(rtol=1e-5, atol=(1e-7, 1e-4)),
    "radau": lambda: polyida.RadauIIA(h=5e-3, tolerance=1e-8),
    "energy": lambda: polyida.EnergyMomentum(h=1e-3),
}


def cells_for(dof):
    """Cells a plate that give two plates together about so many coordinates."""
    return max(4, round(dof / 7.7 + 15 * min(1.0, dof / 1000)))


def cpu(call):
    """(CPU seconds of a call in this process, its result)."""
    begin = time.process_time()
    result = call()
    return time.process_time() - begin, result


def between(model, member, short, long):
    """(CPU s, Counts) of a run at the times `short` and `long`, s, in two runs or in one."""
    fixed = not isinstance(member, polyida.IDA)
    return (two_runs if fixed and model.n < LARGE else one_run)(model, member, short, long)


def two_runs(model, member, short, long):
    """(CPU s, counts) of a run to `short` and of one to `long`."""
    runs = [cpu(partial(solve, model, t_end, member, every=NO_FRAMES)) for t_end in (short, long)]
    return [(seconds, run.counts) for seconds, run in runs]


def one_run(model, member, short, long):
    """(CPU s, counts) of one run up to `short` and up to `long`: the start's scatter is not in the difference."""
    begin, counts, seen = time.process_time(), Counts(), []
    for state in member.steps(model, consistent_state(model, 0.0, None, None), long, counts):
        if state.restart and state.t >= short * (1 - 1e-9):
            seen.append((time.process_time() - begin, replace(counts)))
    return seen[0], seen[-1]


def step(model, member, short, long):
    """{"ms_per_step", "steps", "newton_iterations" and "factorizations" a step} of one measurement."""
    (begin, first), (end, last) = between(model, member, short, long)
    steps = last.steps - first.steps
    counts = {kind: (getattr(last, kind) - getattr(first, kind)) / steps for kind in ("newton_iterations", "factorizations")}
    return {"ms_per_step": 1e3 * (end - begin) / steps, "steps": steps} | counts


def main(cells, integrator, short, long):
    """Answer requests until the input ends."""
    model, member = double_plate(int(cells)).build(), MEMBERS[integrator]()
    print(json.dumps({"package": polyida.__file__, "n": model.n}), flush=True)
    solve(model, float(short), member, every=NO_FRAMES)  # compiles or loads the kernels
    for _ in sys.stdin:
        print(json.dumps(step(model, member, float(short), float(long))), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
