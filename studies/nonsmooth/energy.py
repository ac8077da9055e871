"""Energy over many impacts without loss, e = 1 and no friction: a ball, and a rod whose ends hit the floor."""

from time import process_time

import polyida as pi
from nonsmooth.cases import MAKERS
from nonsmooth.scenes import on_floor

SETTINGS = {"alpha, events": 2e-3, "Radau IIA, events": 1e-7, "IDA, events": 1e-7, "nonsmooth alpha": 2e-3, "Moreau-Jean": 2e-3}
SCENES = {
    "ball, e = 1": lambda: on_floor({"p": (0.0, 0.0)}, (0.0, 0.2), e=1.0),
    "rod, e = 1": lambda: on_floor({"left": (-0.2, 0.0), "right": (0.2, 0.0)}, (0.0, 0.3), e=1.0, spin=2.0, inertia=0.04 / 3),
}


def tasks(quick):
    """All ways on both scenes."""
    return [
        {"part": "energy", "scene": scene, "integrator": way, "x": x, "time": 2.0 if quick else 20.0}
        for scene in SCENES
        for way, x in SETTINGS.items()
    ]


def measure(scene, integrator, x, time):
    """Largest change of energy, relative to that of the start, and its curve."""
    model, begin = SCENES[scene]().build(), process_time()
    run = pi.solve(model, time, MAKERS[integrator](x))
    row = {"cpu_s": process_time() - begin, "steps": run.counts.steps, "events": len(run.events)}
    height = {"ball, e = 1": 0.2, "rod, e = 1": 0.3}[scene]
    total = run.energy.kinetic + run.energy.potential - run.energy.potential[0] + 9.81 * height
    change = total / total[0] - 1.0
    every = slice(None, None, max(1, len(run.t) // 400))
    row |= {"energy_change": float(change[-1]), "energy_gain": float(max(change.max(), 0.0)), "outcome": "done"}
    return row | {"t": run.t[every], "energy": change[every]} | ({} if run.success else {"outcome": run.message})
