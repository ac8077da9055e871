"""Compute and print the digits of the problems again: `python studies/digits.py [problem ...]`.

DOP853 gives the digits of each problem, its distance from Radau IIA is `known_to`. The tables DIGITS of problems/plates.py and
problems/mechanisms.py hold them. The pendulum, the car axis and Andrews' mechanism have references of other origin; the distance from them
is printed. Seconds each, the plates and mechanisms some minutes; `--cells 8 --time 0.1` takes seconds.
"""

import argparse
from types import SimpleNamespace
from typing import NamedTuple

from polyida import problems
from polyida.integrate.start import consistent_acceleration
from polyida.problems.mechanisms import LEVELS
from polyida.problems.plates import DIGITS
from polyida.study.references import by_explicit, by_radau, distance


class Tolerances(NamedTuple):
    """rtol of both methods: as tight as round-off, which adds up over the steps and disturbs error estimates, lets them serve."""

    explicit: float
    radau: float


CLASSICAL = {"pendulum": Tolerances(2.3e-14, 1e-12), "car-axis": Tolerances(2.3e-14, 1e-12), "andrews": Tolerances(1e-13, 1e-13)}
PLATES = Tolerances(1e-11, 1e-13)
RIGID = Tolerances(1e-12, 1e-13)
MECHANISMS = {
    name: Tolerances(rtol, 1e-12)
    for name, rtol in (("slider-crank", 1e-8), ("four-bar", 1e-8), ("two-link-arm", 1e-9), ("peaucellier", 1e-9))
}


def parts_of(problem, t_end, end):
    """The quantities that the problem compares, of a state {"q", "v", "lam"}."""
    if problem.name in CLASSICAL:
        return end | {"a": consistent_acceleration(problem.model, t_end, end["q"], end["v"])[0]}
    frames = {part: value[None] for part, value in end.items()}
    run = SimpleNamespace(model=problem.model, position=lambda name: problem.model.position(name, frames["q"]), **frames)
    result = {part: measure(run) for part, measure in problem.measures.items()}
    return result if problem.name in MECHANISMS else result | {"lam": end["lam"]}


def digits(problem, t_end, tolerances):
    """(digits, known_to) at t_end: DOP853, and its distance from Radau IIA."""
    ends = [
        parts_of(problem, t_end, family(problem.model, t_end, rtol, problem.q0, problem.v0))
        for family, rtol in zip((by_explicit, by_radau), tolerances)
    ]
    return ends[0], distance(*ends)


def main(arguments=None):
    """Print the digits of the named problems, or of all, with their accuracy."""
    names = [*CLASSICAL, *DIGITS, *MECHANISMS]
    parser = argparse.ArgumentParser(prog="python studies/digits.py", description=__doc__.split("\n")[0])
    parser.add_argument("problem", nargs="*", default=names, help=", ".join(names))
    parser.add_argument("--cells", type=int, help="of a plate, where it is not the default mesh")
    parser.add_argument("--time", type=float, help="s, where it is not the problem's")
    args = parser.parse_args(arguments)
    options = {"cells": args.cells} if args.cells else {}
    for name in args.problem:
        for level in LEVELS if name in MECHANISMS else ("",):
            print_digits(
                level, problems.get(name, **({} if name in CLASSICAL else options), **({"level": level} if level else {})), args.time
            )


def print_digits(level, problem, time):
    """Print the digits of a problem at its end or at an earlier time, s."""
    tolerances = RIGID if level == "rigid" else (CLASSICAL | MECHANISMS).get(problem.name, PLATES)
    result, known_to = digits(problem, time or problem.t_end, tolerances)
    stored = {} if time else problem.reference
    for part, value in result.items():
        away = f", {problem.errors(**{part: value})[part]:.1e} from those that are stored" if part in stored else ""
        called = f"{problem.name} {level} {part}" if level else f"{problem.name} {part}"
        print(f"{called} {[float(f'{x:.16g}') for x in value]} known to {known_to[part]:.1e}{away}", flush=True)


if __name__ == "__main__":
    main()
