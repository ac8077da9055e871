"""A process that runs generalized-alpha of an earlier commit on request: `python side.py CELLS SCENE` with that version first on
PYTHONPATH.

It prints its location and the size of the model, then for every line {"setting": step} the CPU seconds of a run and its tip at the times of
`own.py`. It uses only names that all versions of the package have.
"""

import json
import sys

import numpy as np

import polyida
from polyida.problems import plates


def main(cells, scene):
    """Answer requests until the input ends."""
    make = {"scene 1": plates.double_plate, "scene 2": plates.double_plate_motors}[scene]
    model, times = make(int(cells)).build(), np.linspace(0.0, 1.0, 101)
    print(json.dumps({"package": polyida.__file__, "n": model.n}), flush=True)
    for line in sys.stdin:
        method = polyida.GeneralizedAlpha(h=json.loads(line)["setting"])
        tip = polyida.solve(model, times[-1], method, output=times).position("tip").tolist()
        seconds = polyida.solve(model, times[-1], method, every=10**9).cpu_seconds
        print(json.dumps({"cpu_s": seconds, "tip": tip}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
