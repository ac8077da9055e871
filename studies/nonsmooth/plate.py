"""A plate of some 1400 coordinates thrown on its corner, mu = 0.3: what a step in contact costs against one without."""

from time import process_time

import numpy as np

import polyida as pi
from nonsmooth.scenes import FLOOR, G

END, STEP = 0.12, 2e-4  # s; the corner is in contact for some 85 of 600 steps


class Timed(pi.NonsmoothAlpha):
    """NonsmoothAlpha that stores (CPU seconds, Newton iterations, solves, closed contacts) of each step in `rows`."""

    rows: list = []  # noqa: RUF012

    def steps(self, model, state, t_end, counts):
        """States, as the base class yields them."""
        states, closed = super().steps(model, state, t_end, counts), 0
        while True:
            before = counts.newton_iterations, counts.solves
            begin = process_time()
            if (state := next(states, None)) is None:
                return
            spent = process_time() - begin
            still = int(np.sum(state.memory["closed"]))
            self.rows.append((spent, counts.newton_iterations - before[0], counts.solves - before[1], closed * still))
            closed = still
            yield state


def thrown_plate(cells=365):
    """The scene; all nodes of the plate's rim may touch the floor."""
    scene = pi.Scene(gravity=(0.0, -G))
    rubber, mesh = pi.Material(E=50e6, nu=0.3, rho=1100.0), pi.mesh.rectangle(1.0, 0.5, cells, seed=1)
    motion = {"origin": (0.0, 0.25), "angle": 0.3, "velocity": (1.0, -1.0), "spin": 1.0}
    plate = scene.add(pi.Plate(mesh, rubber, 0.01, name="plate", **motion))
    rim = sorted({int(node) for side in ("bottom", "right", "left", "top") for node in plate.section(side).nodes})
    scene.add(pi.Contact(plate.section(rim), FLOOR, friction=0.3, name="floor"))
    return scene


def measure(cells):
    """Medians over the steps in contact and without, and what the run keeps."""
    model, method = thrown_plate(cells).build(), Timed(h=STEP)
    pi.solve(model, END, method)  # compiles the kernels
    method.rows.clear()
    run = pi.solve(model, END, method)
    if not run.success:
        return {"outcome": run.message}
    rows = np.array(method.rows)
    touches = rows[:, 3] > 0
    of_kind = {kind: np.median(rows[of, 0]) for kind, of in (("contact", touches), ("free", ~touches))}
    gaps = np.array([model.phi(t, q)[::2].min() for t, q in zip(run.t, run.q)])
    return {
        "outcome": "done",
        "cpu_s": float(rows[:, 0].sum()),
        "steps": run.counts.steps,
        "n": model.n,
        "cost_of_contact": float(of_kind["contact"] / of_kind["free"]),
        "iterations_in_contact": float(rows[touches, 1].mean()),
        "iterations_without": float(rows[~touches, 1].mean()),
        "solves_in_contact": float(rows[touches, 2].mean()),
        "factors": run.counts.factorizations,
        "penetration": float(max(-gaps.min(), 0.0)),
        "energy_gain": float(np.diff(run.energy.total).max() / run.energy.kinetic[0]),
    }
