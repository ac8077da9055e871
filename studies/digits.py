"""The digits of problems/plate_digits.py, made anew and printed: `python studies/digits.py [problem ...]`.

Two families a problem, DOP853 and generalized-alpha extrapolated; the digits are the former's, `known_to` their
distance. Some minutes each; `--cells 8 --time 0.1 --rtol 1e-8 --step 5e-6` takes seconds.
"""

import argparse

from polyida import problems
from polyida.problems.plate_digits import DIGITS
from polyida.study.families import by_alpha, by_explicit, distance

RTOL, STEP = 1e-9, 2.5e-6


def of_tip(model, end):
    """{"tip", "tip_velocity", "lam"} of a state {"q", "v", "lam"}."""
    return {
        "tip": model.attachment("tip").point + model.displacement("tip", end["q"]),
        "tip_velocity": model.displacement("tip", end["v"]),
        "lam": end["lam"],
    }


def digits(name, t_end=None, rtol=RTOL, step=STEP, **options):
    """(digits, known_to) of a problem at its t_end or another: by DOP853, and how far generalized-alpha is from it."""
    problem = problems.get(name, **options)
    model, t_end = problem.model, t_end or problem.t_end
    exact, other = (of_tip(model, end) for end in (by_explicit(model, t_end, rtol), by_alpha(model, t_end, step)))
    return exact, distance(exact, other)


def main(arguments=None):
    """Print the digits of the problems that are named, or of all, with how well each is known."""
    made = argparse.ArgumentParser(prog="python studies/digits.py", description=__doc__.split("\n")[0])
    made.add_argument("problem", nargs="*", default=list(DIGITS), help=", ".join(DIGITS))
    made.add_argument("--cells", type=int, help="of a plate, where it is not the default mesh")
    made.add_argument("--time", type=float, help="s, where it is not the problem's")
    made.add_argument("--rtol", type=float, default=RTOL, help="of DOP853")
    made.add_argument("--step", type=float, default=STEP, help="of generalized-alpha, s; and half of it")
    given = made.parse_args(arguments)
    options = {"cells": given.cells} if given.cells else {}
    for name in given.problem:
        exact, known_to = digits(name, given.time, given.rtol, given.step, **options)
        for part, value in exact.items():
            print(f"{name} {part} {[float(f'{x:.14g}') for x in value]} known to {known_to[part]:.1e}", flush=True)


if __name__ == "__main__":
    main()
