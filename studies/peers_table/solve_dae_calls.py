"""Checks of solve_dae."""

from peers_table.first_order import START, pendulum, slopes
from peers_table.rows import T_END, only, require, swung


def by_solve_dae(method):
    """The run of solve_dae."""
    from solve_dae.integrate import solve_dae

    run = solve_dae(pendulum, (0.0, T_END), START, slopes(), method=method, rtol=1e-6, atol=1e-6)
    require(run.success, run.message)
    return run


def solve_dae_methods():
    """The methods that solve_dae accepts by name."""
    from solve_dae.integrate._dae.dae import METHODS

    return list(METHODS)


def solve_dae_own():
    """A method is a class on DaeSolver: one that counts the steps of Radau IIA."""
    from solve_dae.integrate import RadauDAE, solve_dae

    class Counted(RadauDAE):
        steps = 0

        def step(self):
            Counted.steps += 1
            return super().step()

    run = solve_dae(pendulum, (0.0, T_END), START, slopes(), method=Counted, rtol=1e-6, atol=1e-6)
    require(run.success and Counted.steps > 0, "the class was not used")
    return f"a class of a user took {Counted.steps} steps; {swung(run.y[:2, -1], 1e-3)}"


def solve_dae_counts():
    run = by_solve_dae("Radau")
    require(min(run.nfev, run.njev, run.nlu) > 0, "counts of nothing")
    return f"residuals {run.nfev}, Jacobians {run.njev}, factorizations {run.nlu}"


CHECKS = {
    "a model of one's own": lambda: swung(by_solve_dae("Radau").y[:2, -1], 1e-3),
    "generalized-alpha on index 3": lambda: only(solve_dae_methods(), ["alpha"]),
    "stabilised index 2 (GGL)": lambda: swung(by_solve_dae("Radau").y[:2, -1], 1e-3),
    "BDF of variable order": lambda: swung(by_solve_dae("BDF").y[:2, -1], 1e-2),
    "Radau IIA": lambda: swung(by_solve_dae("Radau").y[:2, -1], 1e-3),
    "energy-momentum": lambda: only(solve_dae_methods(), ["energy"]),
    "an integrator of one's own": solve_dae_own,
    "counts of the work": solve_dae_counts,
}
