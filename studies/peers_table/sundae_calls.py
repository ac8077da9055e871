"""Checks of scikit-sundae."""

from peers_table.first_order import START, pendulum, slopes
from peers_table.rows import T_END, NotThere, only, require, swung


def by_sundae(**options):
    """The run of scikit-sundae's IDA, with all its steps."""
    from sksundae.ida import IDA

    def residual(t, y, yp, res):
        res[:] = pendulum(t, y, yp)

    run = IDA(residual, rtol=1e-6, atol=1e-6, **options).solve([0.0, T_END], START, slopes())
    require(run.success, run.message)
    return run


def sundae_order():
    low, high = (len(by_sundae(max_order=order).t) for order in (1, 5))
    require(high < low / 2, f"{high} steps with order up to 5, {low} with order 1")
    return f"{high} steps with orders up to 5, {low} with order 1; {swung(by_sundae().y[-1, :2], 1e-3)}"


def sundae_solvers():
    """The solver modules of scikit-sundae."""
    import pkgutil

    import sksundae

    return [module.name for module in pkgutil.iter_modules(sksundae.__path__) if not module.name.startswith("_")]


def sundae_counts():
    run = by_sundae()
    require(min(run.nfev, run.njev) > 0, "counts of nothing")
    return f"residuals {run.nfev}, Jacobians {run.njev}"


def sundae_own():
    from sksundae.ida import IDA

    try:
        IDA(pendulum, method="one's own")
    except Exception as error:  # noqa: BLE001, whatever it says, that is what is shown
        raise NotThere(f"its methods are those of SUNDIALS: {error}") from None
    return "took a method by name"


CHECKS = {
    "a model of one's own": lambda: swung(by_sundae().y[-1, :2], 1e-3),
    "generalized-alpha on index 3": lambda: only(sundae_solvers(), ["alpha"]),
    "stabilised index 2 (GGL)": lambda: swung(by_sundae().y[-1, :2], 1e-3),
    "BDF of variable order": sundae_order,
    "Radau IIA": lambda: only(sundae_solvers(), ["radau"]),
    "energy-momentum": lambda: only(sundae_solvers(), ["energy"]),
    "an integrator of one's own": sundae_own,
    "counts of the work": sundae_counts,
}
