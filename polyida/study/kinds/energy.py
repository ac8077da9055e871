"""Energy and momentum over a run: what each integrator gains or loses beside the work that is done on the model."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.keywords import named_keywords
from polyida.results.motion import unbalanced
from polyida.study.kinds.kept import Kept, kept
from polyida.study.progress import teller
from polyida.study.subject import members, subject


class EnergyKept(Kept):
    """What `energy` found: a row a run, histories of energies and momenta."""

    title = "energy over a run"
    columns = {
        "integrator": ("integrator", "{}"),
        "setting": ("setting", "{}"),
        "energy_change": ("change at the end, J", "{:.2e}"),
        "energy_drift": ("largest change, J", "{:.2e}"),
        "relative_drift": ("of its size", "{:.1e}"),
        "momentum_drift": ("of momentum, N s", "{:.1e}"),
        "angular_drift": ("of angular momentum, N m s", "{:.1e}"),
        "steps": ("steps", "{}"),
        "cpu_s": ("CPU s", "{:.3g}"),
        "status": ("status", "{}"),
    }
    quantities = {
        "unbalanced": ("energy gained or lost beside all work, J", False),
        "total": ("total energy, J", False),
        "kinetic": ("kinetic energy, J", False),
        "strain": ("strain energy, J", False),
        "angular_momentum": ("angular momentum, N m s", False),
    }

    @property
    def figures(self) -> dict[str, float]:
        """The largest change relative to the energy's own size, by names such as "relative_drift alpha"."""
        return {f"relative_drift {row['integrator']}": row["relative_drift"] for row in self.rows}


@named_keywords
def energy(
    model: object,
    t_end: float | None = None,
    *,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    integrators: dict[str, object] | None = None,
    frames: int = 400,
    every: int = 1,
    progress: Callable[[int, int, str], object] | bool | None = None,
) -> EnergyKept:
    """Run each of {label: integrator} to t_end and follow the energy: its change less the work of motors and loads, more what is dissipated.

    It is zero for the exact motion, where the model states its potential; NaN where it does not. Its size is the range of the kinetic
    energy. Momenta, where the model says them, should stay where nothing outside acts: their drifts are the largest changes. frames: points of
    each history, at most; rows have the largest of every `every`-th step. model, q0, v0, progress: as `work_precision`. Raises InputError before the first run.
    """
    given = subject("energy", model, t_end, q0, v0)
    known = members("energy", given, integrators, several=False)
    with teller("energy", progress) as tell:
        return EnergyKept(given.name, *kept("energy", given, known, frames, every, _measure, tell))


def _measure(run, at):
    found, change = run.energy, unbalanced(run)
    size = float(np.ptp(found.kinetic))
    drift = float(np.abs(change).max())
    row = {"energy_change": float(change[-1]), "energy_drift": drift, "relative_drift": drift / size if size else np.nan}
    momentum, angular = _momenta(run)
    row |= {"momentum_drift": float(np.abs(momentum - momentum[0]).max()), "angular_drift": float(np.abs(angular - angular[0]).max())}
    parts = {"unbalanced": change} | {name: getattr(found, name) for name in ("total", "kinetic", "strain")}
    return row, {"t": run.t[at]} | {name: values[at] for name, values in (parts | {"angular_momentum": angular}).items()}


def _momenta(run):
    """Momentum (frames, 2) and angular momentum (frames,); NaN where the model does not say them."""
    try:
        return run.momentum, run.angular_momentum
    except InputError:
        return np.full((len(run.t), 2), np.nan), np.full(len(run.t), np.nan)
