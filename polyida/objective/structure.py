"""Objectives of a structure, not of its motion: mass and natural frequency."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from polyida.body.rigid_body import PointMass
from polyida.errors import InputError
from polyida.model.differences import along
from polyida.model.guarded import guard
from polyida.objective.objective import Objective, Slopes, along_way, reach, run_of
from polyida.objective.time_mean import named
from polyida.validation import is_one_of, is_whole, named_keywords


@named_keywords
@dataclass(frozen=True, eq=False)
class Mass(Objective):
    """Mass of all bodies and point masses of a scene, or of one of them, kg; of plates with the factors of their cells.

    Parameters
    ----------
    part : str, body or PointMass, optional
        By default all.

    Raises
    ------
    InputError
        Of a run if its model is no scene, or if the part has no mass or is not in the scene.
    """

    part: Any = None
    of_frames = False

    def __call__(self, run: Any) -> float:
        """Return the mass, kg, a float, of the chosen part of a run's model, or of all bodies and point masses if none is chosen."""
        return sum(self._masses(run_of("Mass", run).model).values())

    def named(self, model: Any) -> Mass:
        """Return the objective with the name of its part instead of the part."""
        return replace(self, part=named(model, self.part))

    def slopes(self, run: Any) -> Callable[[slice], Slopes]:
        """Return a function of a slice of frames: all slopes are those of the last frame."""
        run = run_of("Mass", run)
        model = guard(run.model, "Mass")
        masses, direct = self._masses(model), {}
        for body in model.bodies:
            if body.name in masses:
                material, thickness, whole = body.plate.material, body.plate.thickness, masses[body.name]
                direct[f"{body.name}.mass"] = material.rho * thickness * body.mesh.cell_areas
                direct |= {f"{body.name}.rho": whole / material.rho, f"{body.name}.thickness": whole / thickness}
        direct |= {f"{name}.mass": 1.0 for name in masses if isinstance(model.parts[name], PointMass)}
        result = Slopes(direct=direct, of_model=lambda other: sum(self.named(model)._masses(guard(other)).values()))
        return lambda part: result if part.indices(len(run.t))[1] == len(run.t) else Slopes()

    def _masses(self, model):
        """{name: kg} of the chosen bodies and point masses."""
        if not model.is_scene:
            raise InputError(f"Mass: {model.name} is no scene's model; write it as a pi.objective.UserObjective")
        known = {body.name: body.whole_mass for body in model.all_bodies}
        known |= {name: part.mass for name, part in model.parts.items() if isinstance(part, PointMass)}
        name = named(model, self.part)
        if name is not None and not is_one_of(name, known):
            raise InputError(f"Mass: no body or point mass is called {self.part!r:.100}; known: {', '.join(map(repr, known)) or 'none'}")
        return {key: float(mass) for key, mass in known.items() if name in (None, key)}


APART = 1e-6  # of omega^2: nearer frequencies are equal, and their shapes are not unique


@named_keywords
@dataclass(frozen=True, eq=False)
class Frequency(Objective):
    """Frequency of an undamped mode, Hz: one of `pi.modes`; of a run or an equilibrium that of its reference configuration.

        d omega^2/dp = x^T (dK/dp - omega^2 dM/dp) x + 2 mu^T dB/dp x,   omega^2 M x = K x + B^T mu,   B x = 0,   x^T M x = 1

    That is q = 0 at t = 0 without loads, as in `pi.modes(model)`. The gradient of modes about an equilibrium of `pi.static` includes the
    motion of the equilibrium with each parameter; any other state is fixed.

    Parameters
    ----------
    number : int
        Of the mode; 0 is the slowest.

    Raises
    ------
    InputError
        For a wrong number, for modes with damping, and, of slopes, for a mode at 0 Hz and for one of several with the same frequency.
    """

    number: int = 0
    of_frames = False

    def __post_init__(self):
        """Check the number of the mode. Raises InputError unless it is whole and at least 0."""
        if not is_whole(self.number, 0):
            raise InputError(f"Frequency: number = {self.number!r:.100} must be a whole number, 0 for the slowest mode")

    def __call__(self, run: Any) -> float:
        """Return the frequency of the mode, Hz."""
        return float(self._modes(run_of("Frequency", run), self.number + 1).frequencies[self.number])

    def slopes(self, run: Any) -> Callable[[slice], Slopes]:
        """Return a function of a slice of frames: all slopes are those of the last frame; q and lam are of the modes' state."""
        run = run_of("Frequency", run)
        modes = self._modes(run, self.number + 2)
        squares = np.real(-(modes.roots**2))  # omega^2, 1/s^2
        square, others = squares[self.number], np.delete(squares, self.number)
        if not square:
            raise InputError(f"Frequency: mode {self.number} is a rigid motion, at 0 Hz it has no slopes; hold the structure")
        if len(others) and np.abs(others - square).min() <= APART * abs(square):
            raise InputError(
                f"Frequency: mode {self.number} shares its {modes.frequencies[self.number]:.6g} Hz with another one: it has no slopes"
            )
        mode = _Mode(modes, self.number, square)
        result = Slopes(work=mode.work())
        if getattr(run, "modes", None) is not None:
            q, lam = mode.by_state()
            result = replace(result, q=q[None], lam=lam[None])
        return lambda part: result if part.indices(len(run.t))[1] == len(run.t) else Slopes()

    def _modes(self, run, count):
        """At least `count` modes, or all; those of the run if it has them. Raises InputError if the model has fewer than `number` needs."""
        from polyida.modal.modes import modes

        modes_of_run = getattr(run, "modes", None)
        if modes_of_run is not None and np.iscomplexobj(modes_of_run.shapes):
            raise InputError("Frequency: these modes are damped; take pi.modes(model, state) without damped=True")
        if modes_of_run is None or len(modes_of_run.roots) < min(count, run.model.n - run.model.m):
            modes_of_run = modes(run.model, modes_of_run and modes_of_run.state, count=count)
        if self.number >= len(modes_of_run.roots):
            raise InputError(f"Frequency: number = {self.number} is too large, the model has {len(modes_of_run.roots)} modes")
        return modes_of_run


class _Mode:
    """A mode x of a state (t, q, lam), with the multipliers mu of `omega^2 M x = K x + B^T mu`; by_square: df/d(omega^2), s."""

    def __init__(self, modes, number, square):
        """Take shape, state and frequency of the mode with this number from Modes, and compute its multipliers mu; square: its omega^2."""
        self.model, state = guard(modes.model), modes.state
        self.square = square
        self.t, self.q, self.lam = state.t, state.q, state.lam
        self.x = modes.shapes[number]
        self.by_square = 1.0 / (8 * np.pi**2 * abs(modes.frequencies[number]))
        self.still = np.zeros(self.model.n)
        self.mu = self.model.mass_system(self.t, self.q).solve(self._stiffness(self.q) @ self.x, np.zeros(self.model.m))[1]

    def _stiffness(self, q):
        """K = dr/dq, (n, n), at q with v = 0, a = 0 and the state's lam."""
        return self.model.tangent(self.t, q, self.still, self.still, self.lam, 0.0, 0.0, 1.0)

    def work(self):
        """Entries (t, q, v, a, lam, w, mu) of `x^T K x - omega^2 x^T M x + 2 mu^T B x`, times df/d(omega^2), as `Slopes.work` takes
        them.
        """
        x, still, q, lam = self.x, self.still, self.q, self.lam
        stiff = along_way(self.model, self.t, q, lam, x, self.by_square * x, 2.0 * self.by_square * self.mu)
        w, none = self.by_square * self.square * x, np.zeros_like(lam)
        heavy = [(self.t, q, still, x, lam, -w, none), (self.t, q, still, still, lam, w, none)]
        return tuple(np.concatenate([part, np.array(pair)]) for part, pair in zip(stiff, zip(*heavy)))

    def by_state(self):
        """(df/dq (n,), df/dlam (m,)) of the state."""
        model, t, q, x = self.model, self.t, self.q, self.x
        far = reach(model, q, x)
        q_adjoint = along(lambda s: self._stiffness(q + s * x).T @ x, far)
        if model.needs.mass_varies:
            q_adjoint = q_adjoint - self.square * (model.mass_a_q(q, x).T @ x)
        if model.needs.phi_q_varies and model.m:
            q_adjoint = q_adjoint + 2.0 * (model.reaction_q(t, q, self.mu).T @ x)
        return self.by_square * q_adjoint, self.by_square * along(lambda s: model.phi_q(t, q + s * x) @ x, far)
