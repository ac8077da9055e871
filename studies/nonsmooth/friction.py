"""What friction costs: CPU time of a step with friction over that of one without, and starts of a flexible mechanism from rest."""

from time import process_time

import numpy as np

import polyida as pi
from nonsmooth.scenes import FLOOR, G, plate_crank

MODES, BARS, MU = 5, 10, 0.05
METHODS = {
    "alpha": pi.GeneralizedAlpha(h=2e-4),
    "IDA": pi.IDA(rtol=1e-5),
    "Radau IIA": pi.RadauIIA(h=1e-3),
    "energy-momentum": pi.EnergyMomentum(h=2e-4),
    "nonsmooth alpha": pi.NonsmoothAlpha(h=2e-4),
    "Moreau-Jean": pi.MoreauJean(h=2e-4),
}
STARTS = [(modes, mu, rtol) for modes in (0, MODES) for mu in (0.05, 0.1, 0.2, 0.4) for rtol in (1e-4, 1e-5, 1e-7)]


def bars(mu):
    """Ten rigid bars that hang in a row from rest, with friction in every pin."""
    scene, end, friction = pi.Scene(gravity=(0.0, -G)), FLOOR, {"friction": mu, "pin_radius": 0.01} if mu else {}
    for k in range(BARS):
        bar = scene.add(pi.RigidBody.bar(0.1, 0.1, origin=(0.1 * k, 0.0), name=f"bar {k}"))
        scene.add(pi.Revolute(end, bar.at("left"), name=f"pin {k}", **friction))
        end = bar.at("right")
    return scene


SCENES = {"guide, 40 cells": lambda mu: plate_crank(mu, 40), "guide, 400 cells": lambda mu: plate_crank(mu, 400), "ten bars": bars}


def tasks(quick):
    scenes = ("guide, 40 cells", "ten bars") if quick else SCENES
    methods = ("alpha", "Radau IIA") if quick else METHODS
    costs = [{"part": "friction", "scene": scene, "integrator": way} for scene in scenes for way in methods]
    return costs + [{"part": "starts", "modes": modes, "mu": mu, "x": rtol} for modes, mu, rtol in (STARTS[12:15] if quick else STARTS)]


def measure(scene, integrator, end=0.05, pairs=3):
    """Medians of CPU seconds a step with and without friction, in pairs, and their ratio."""
    models = [SCENES[scene](mu).build() for mu in (MU, 0.0)]
    method, seconds, runs = METHODS[integrator], np.zeros((2, pairs)), [None, None]
    for model in models:
        pi.solve(model, 0.1 * end, method)  # compiles the kernels
    for pair in range(pairs):
        for k, model in enumerate(models):
            begin = process_time()
            runs[k] = pi.solve(model, end, method)
            seconds[k, pair] = (process_time() - begin) / runs[k].counts.steps
    done = "; ".join(run.message for run in runs if not run.success) or "done"
    with_friction, without = np.median(seconds, axis=1)
    return {
        "with_ms": float(1e3 * with_friction),
        "without_ms": float(1e3 * without),
        "friction_over_none": float(np.median(seconds[0] / seconds[1])),
        "events": len(runs[0].events),
        "steps": runs[0].counts.steps,
        "outcome": done,
    }


def start(modes, mu, x, end=0.03):
    """A run of Radau IIA from rest with the tolerance x."""
    begin = process_time()
    run = pi.solve(plate_crank(mu, modes=modes).build(), end, pi.RadauIIA(rtol=x))
    return {
        "cpu_s": process_time() - begin,
        "steps": run.counts.steps,
        "events": len(run.events),
        "outcome": "done" if run.success else run.message,
    }
