"""IDA with its solve as preconditioner, which receives cj, relative to IDA with a residual that contains the solve at a predicted cj:
alternating runs.
"""

from functools import partial

import numpy as np

import polyida as pi
from polyida.integrate.ida import integrator
from polyida.problems import get, plates
from polyida.run.solve import solve
from step_cost.side import NO_FRAMES, cells_for, cpu

LENGTH = 1.0  # m, of a bar


def chain(bars):
    """A chain of rigid bars that falls."""
    scene, before = pi.Scene(gravity=(0.0, -9.81)), pi.ground
    for k in range(bars):
        ends = {"A": (-LENGTH / 2, 0.0), "B": (LENGTH / 2, 0.0)}
        bar = scene.add(pi.RigidBody(mass=1.0, inertia=0.1, points=ends, origin=((k + 0.5) * LENGTH, 0.0)))
        scene.add(pi.Revolute(before, bar.at("A")))
        before = bar.at("B")
    return scene.build()


def own(name, by_numba=False):
    """A problem with user-defined equations: (model, t_end, start)."""
    problem = get(name)
    if by_numba:
        kind = type(problem.model)
        problem.model.__class__ = pi.compiled(type(kind.__name__, (kind,), {}))
    return problem.model, problem.t_end, {"q0": problem.q0, "v0": problem.v0}


CASES = {  # name: (what makes model, t_end in s and start, rtol)
    "plates_1e3": (lambda: (plates.double_plate(cells_for(1_000)).build(), 0.5, {}), 1e-5),
    "plates_1e4": (lambda: (plates.double_plate(cells_for(10_000)).build(), 0.15, {}), 1e-5),
    "chain_2": (lambda: (chain(2), 1.0, {}), 1e-6),
    "chain_5": (lambda: (chain(5), 1.0, {}), 1e-6),
    "andrews": (partial(own, "andrews"), 1e-6),
    "car_axis": (partial(own, "car-axis"), 1e-6),
    "pendulum": (partial(own, "pendulum"), 1e-6),
    "pendulum_compiled": (partial(own, "pendulum", True), 1e-6),
}


def tasks(quick):
    """Every case, the small ones quickly."""
    return [{"part": "told cj", "case": case, "pairs": 3 if quick else 7} for case in CASES if not (quick and case == "plates_1e4")]


class Handed:
    """Replacement of `Predicted`: the last cj that IDA gave."""

    def begin(self, t, q):
        """Nothing."""

    accept = begin

    def cj(self, t, q):
        """The same, whatever the state."""
        return self.value


class Told(integrator.Run):
    """A run whose preconditioner solves at its first call behind a residual, and hands the vector through at the next, as the product does."""

    def __init__(self, settings, model, sizes, counts, looked_into):
        from sksundae.ida import IDA, IDAJacTimes, IDAPrecond

        super().__init__(settings, model, sizes, counts, looked_into)
        rtol, *atol = settings.tolerances(model, sizes)
        self.linear.predicted, self.fresh = Handed(), False
        self.solver = IDA(
            self._told_residual,
            rtol=rtol,
            atol=self.system.tolerances(*atol),
            max_order=settings.largest_order(model),
            linsolver="gmres",
            krylov_dim=5,
            precond=IDAPrecond(None, self._solve),
            jactimes=IDAJacTimes(None, self._product),
        )

    def _told_residual(self, t, y, yp, res):
        self.counts.residuals += 1
        if t != self.tried:
            self.attempts, self.tried = self.attempts + 1, t
        self.fresh = True
        if not self.linear.F(t, y, yp, res):
            self.refused = t, np.array(y[: self.model.n])

    def _product(self, t, y, yp, res, vector, result, cj):
        result[:] = vector

    def _solve(self, t, y, yp, res, r, z, cj, delta):
        if not self.fresh:
            z[:] = r
            return
        self.fresh, linear, linear.predicted.value = False, self.linear, cj
        linear.correct(t, y, yp, linear.count_iteration(t, y), z)
        np.negative(z, out=z)


def told_row(case, pairs):
    """Medians over pairs of runs: CPU seconds with the predicted cj, and the ratio with the received one; counts of both, and the distance
    of their ends.
    """
    make, rtol = CASES[case]
    model, t_end, start = make()
    kinds, row, times = {"": integrator.Run, "told_": Told}, {"n": model.n}, {"": [], "told_": []}
    ends = {}
    for k in range(-1, pairs):
        for name in sorted(kinds, reverse=bool(k % 2)):
            integrator.Run = kinds[name]
            try:
                seconds, run = cpu(lambda: solve(model, t_end, pi.IDA(rtol=rtol), every=NO_FRAMES, **start))
            finally:
                integrator.Run = kinds[""]
            times[name] += [seconds] * (k >= 0)
            ends[name] = run.q[-1]
            row |= {f"{name}{key}": getattr(run.counts, key) for key in ("steps", "residuals", "factorizations", "rejected")}
    row |= {f"{name}cpu_s": float(np.median(found)) for name, found in times.items()}
    ratio = np.array(times["told_"]) / times[""]
    return row | {"ratio": float(np.median(ratio)), "apart": float(np.abs(ends[""] - ends["told_"]).max())}


def notes(rows):
    """One line a case."""
    return [
        f"IDA told cj over IDA that guesses it, {row['case']}: CPU time {row['ratio']:.2f} of {row['cpu_s']:.3g} s; steps {row['told_steps']} over "
        f"{row['steps']}, residuals {row['told_residuals']} over {row['residuals']}, factorizations {row['told_factorizations']} over "
        f"{row['factorizations']}; ends {row['apart']:.1e} apart"
        for row in rows
    ]
