"""The energy-momentum method of Simo and Tarnow (1992), with the discrete derivative of Gonzalez (1996) beyond plates."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from polyida.assembly.own.laws import NO_ENERGY
from polyida.errors import InputError
from polyida.given import is_number, is_whole
from polyida.integrate.energy.general import General, WithForces, require_general
from polyida.integrate.energy.midpoint import Midpoint
from polyida.integrate.energy.steps import HALVINGS
from polyida.integrate.kinks import Grid, at_kink, beside, enough_steps, stretches
from polyida.integrate.rest import held
from polyida.integrate.start import on_velocity
from polyida.integrate.state import Counts, State
from polyida.keywords import named_keywords
from polyida.model import Model
from polyida.model.check import require_energies
from polyida.model.guarded import guard, unguarded
from polyida.system.python import small_own


@named_keywords
@dataclass(frozen=True)
class EnergyMomentum:
    """Constant steps that keep energy and momenta in the discrete sense.

    `M (v_1 - v_0)/h + f_int + B^T lam = f_ext(t_m)`, `q_1 - q_0 = h (v_0 + v_1)/2`, `phi(q_1, t_1) = 0`. The stress is that of the mean
    of the strains at both ends on the mean F, B the constraint Jacobian of the mean q and mean time: without moving motors and damping
    the energy changes by what Newton leaves, for `f_int . (q_1 - q_0) = W_1 - W_0` and `B (q_1 - q_0) = 0`. Velocities of the frames are
    on their constraint. Second order in q, v, a and lam; a and lam of a frame follow from its q and v: in the loop where no
    body is a plate, else for each frame that is kept, which costs half to two thirds of a step (integrate/energy/at_end.py). Damping enters at the middle of the step and only takes energy.

    It takes every scene, force elements and bodies of one's own by the discrete derivative of their energy, and every model of one's own that gives
    `potential`, with a constant mass and phi at most quadratic in q (integrate/energy/general.py). Other forces act at the middle. That
    the energy is kept where phi_q varies needs `Needs(driven=False)`: else phi may do work, and v is put on its constraint at the cost of it.

    Scenes of plates, bodies, joints, loads and compiled force elements, and small models of one's own that numba compiles, go through a compiled
    loop, which keeps its factor. With other force elements, bodies and models each step makes a new factorization, which the run's summary says.

    h: step, s; a run takes the largest not above h that divides its time evenly, and at least four steps behind a kink where
    the loads are no straight lines. tolerance: Newton's, of h^2 times the size of the
    acceleration. max_iterations: of one Newton solve. Raises InputError for a setting out of range and for a model that it does not take.
    Source: Simo, Tarnow, ZAMP 43 (1992) 757-792; Gonzalez, CMAME 190 (2000) 1763-1783 for the stress;
    J. Nonlinear Sci. 6 (1996) 449-467 for the discrete derivative.
    """

    h: float
    tolerance: float = 1e-10
    max_iterations: int = 40

    writes_rows = True  # into the places of a run's frames

    def __post_init__(self):
        for name, good, want in (
            ("h", is_number(self.h) and self.h > 0, "a positive step in s"),
            ("tolerance", is_number(self.tolerance) and 0 < self.tolerance < 1, "between 0 and 1"),
            ("max_iterations", is_whole(self.max_iterations), "a positive whole number"),
        ):
            if not good or isinstance(getattr(self, name), bool):
                raise InputError(f"EnergyMomentum: {name} = {getattr(self, name)!r} must be {want}")

    def require(self, model: Model) -> None:
        """Raise InputError unless it takes the model: any scene; one's own with a potential, constant mass, phi at most quadratic.

        Forces must be those of the energies that are given, where elements and models say that they are conservative.
        """
        if not model.is_scene:
            require_general(model)
        require_energies(guard(model), 0.0, np.zeros(model.n))

    def cost(self, model: Model) -> str:
        """What a summary says of steps that cost more than those of a scene without Python; empty for these."""
        kind = _kind(model)
        if kind is Midpoint:
            return ""
        parts = [own.name for own in model.own_forces.each if own.python] if kind is WithForces else []
        return f"a new factorization in each step, because of {', '.join(map(repr, parts)) or 'functions in Python'}"

    def steps(self, model: Model, state: State, t_end: float, counts: Counts, rows: Any = None) -> Iterator[State]:
        """Accepted states after `state` up to t_end, one a step; rows: of a run's frames, see Steps. Raises StepFailure."""
        kind = _kind(model)
        for begin, end, most in stretches(model, state.t, t_end, self.h):
            state = _ready(model, state, begin)
            count = enough_steps(model, state, begin, end, min(self.h, most))
            grid = Grid(begin, end, count)
            for state in held(model, state, grid, counts):
                grid = grid._replace(done=grid.done + 1)
                counts.steps += 1
                yield state
            stepper = kind(self, model, grid.h, counts, beside(end, -1) if at_kink(model, end) else end, 0 if model.switching else HALVINGS)
            stepper.rows = rows or stepper.rows
            for state in stepper.run(state, grid):
                counts.steps += 1
                yield state


def _kind(model):
    """The kind of steps that a model takes."""
    if not model.is_scene:
        return Midpoint if small_own(model) and unguarded(model).by_numba else General
    return Midpoint if model.compiled and (model.laws is None or NO_ENERGY not in model.laws.energies) else WithForces


def _ready(model, state, begin):
    """The state with v on the constraint that holds from `begin` on: a motor's speed may have jumped. The rest is Newton's first guess."""
    v = on_velocity(model, beside(begin, 1) if at_kink(model, begin) else begin, state.q, state.v)
    return State(state.t, state.q, v, state.a, state.lam, state.memory)
