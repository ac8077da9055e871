"""What D does, the diagonal of M over its mean at the run's start, by which the multipliers mu move v."""

import numpy as np

from polyida.adjoint.parameters.work import Work
from polyida.integrate.radau.rows import NOTHING
from polyida.model.differences import jacobian


def lift_bars(model, state, lift, bar):
    """(the bar of q, (n,), entries for parameters' slopes) of a state where D^-1, `lift`, was made, from the bar of that, (n,).

    `D^-1_k = sum_j M_jj / (n M_kk)`, and 1 where M_kk is nothing.
    """
    masses = np.abs(model.mass(state.q).diagonal())
    heavy = masses > NOTHING * masses.max()
    over = np.where(heavy, bar / np.where(heavy, masses, 1.0), 0.0)
    slopes = over.sum() / model.n - over * lift
    at = lambda q: np.array([slopes @ model.mass(q).diagonal()])  # noqa: E731
    zero, rows, entries = np.zeros(model.n), np.zeros(model.m), []
    for unit, slope in zip(np.eye(model.n), slopes):
        for a, w in ((unit, slope * unit), (zero, -slope * unit)):
            entries.append(Work(state.t, state.q, zero, a, rows, w, rows, rows, rows))
    return jacobian(at, state.q, 1)[0] if model.needs.mass_varies else zero, entries
