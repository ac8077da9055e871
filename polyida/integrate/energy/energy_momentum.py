"""The energy-momentum method of Simo and Tarnow (1992), with the discrete derivative of Gonzalez (1996) beyond plates."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from polyida.errors import InputError
from polyida.integrate.energy.dense import OF_ENERGY
from polyida.integrate.energy.steps import HALVINGS, Steps
from polyida.integrate.kinks import Grid, at_kink, enough_steps, stretches
from polyida.integrate.rest import held
from polyida.integrate.start import on_velocity
from polyida.integrate.state import Counts, Integrator, State, States, Stretch
from polyida.model import Model
from polyida.model.check import require_energies
from polyida.model.differences import beside
from polyida.model.guarded import Compiled, guard, require_constraints, unguarded
from polyida.validation import is_number, is_whole, named_keywords

SAME = 1e-9  # of its size, by which what ought to be equal may differ


@named_keywords
@dataclass(frozen=True)
class EnergyMomentum(Integrator):
    """Constant steps that keep energy and momenta in the discrete sense.

    `M (v_1 - v_0)/h + f_int + B^T lam = f_ext(t_m)`, `q_1 - q_0 = h (v_0 + v_1)/2`, `phi(q_1, t_1) = 0`. The stress is that of the mean
    of the strains at both ends on the mean F, B the constraint Jacobian of the mean q and mean time: without moving motors and damping
    the energy changes by what Newton leaves, for `f_int . (q_1 - q_0) = W_1 - W_0` and `B (q_1 - q_0) = 0`. Velocities of the frames are
    on their constraint. Second order in q, v, a and lam; a and lam follow from q and v, for the frames that are kept: on plates that costs
    half to two thirds of a step. Damping enters at the middle of the step and only takes energy.

    It takes every scene, force elements and bodies of one's own by the discrete derivative of their energy, and every model of one's own that gives
    `potential`, with a constant mass and phi at most quadratic in q (integrate/energy/dense.py). Other forces act at the middle. That
    the energy is kept where phi_q varies needs `Needs(driven=False)`: else phi may do work, and v is put on its constraint at the cost of it.

    All models go through one compiled loop, which keeps its factor while Newton contracts; it calls force elements, bodies and models in Python back.

    h: step, s; a run takes the largest not above h that divides its time evenly, and at least four steps behind a kink where
    the loads are no straight lines. tolerance: Newton's, of h^2 times the size of the
    acceleration. max_iterations: of one Newton solve. Raises InputError for a setting out of range and for a model that it does not take.
    Source: Simo, Tarnow, ZAMP 43 (1992) 757-792; Gonzalez, CMAME 190 (2000) 1763-1783 for the stress;
    J. Nonlinear Sci. 6 (1996) 449-467 for the discrete derivative.
    """

    h: float
    tolerance: float = 1e-10
    max_iterations: int = 40
    trusted = True

    def __post_init__(self):
        for name, good, want in (
            ("h", is_number(self.h) and self.h > 0, "a positive step in s"),
            ("tolerance", is_number(self.tolerance) and 0 < self.tolerance < 1, "between 0 and 1"),
            ("max_iterations", is_whole(self.max_iterations), "a positive whole number"),
        ):
            if not good or isinstance(getattr(self, name), bool):
                raise InputError(f"EnergyMomentum: {name} = {getattr(self, name)!r} must be {want}")

    def fixed_step(self) -> float:
        """h."""
        return float(self.h)

    def require(self, model: Model) -> None:
        """Raise InputError unless it takes the model: any scene; one's own with a potential, constant mass, phi at most quadratic.

        Forces must be those of the energies that are given, where elements and models say that they are conservative.
        """
        if not model.is_scene:
            require_own(model)
        require_energies(guard(model), 0.0, np.zeros(model.n))

    def steps(self, model: Model, state: State, t_end: float, counts: Counts) -> Iterator[State]:
        """Accepted states after `state` up to t_end, one a step. Raises StepFailure."""
        return States(self._stretches(model, state, t_end, counts), counts)

    def _stretches(self, model, state, t_end, counts):
        for begin, end, most in stretches(model, state.t, t_end, self.h):
            v = on_velocity(
                model, beside(begin, 1) if at_kink(model, begin) else begin, state.q, state.v
            )  # a motor's speed may have jumped
            state = State(state.t, state.q, v, state.a, state.lam, state.memory)
            grid = Grid(begin, end, enough_steps(model, state, begin, end, min(self.h, most)))
            for state in held(model, state, grid, counts):
                grid = grid._replace(done=grid.done + 1)
                counts.steps += 1
                yield Stretch.of(state)
            if grid.done == grid.count:
                continue
            for ends in Steps(self, model, grid.h, counts, 0 if model.switching else HALVINGS).run(state, grid):
                counts.steps += len(ends)
                yield ends
            state = ends.last


def require_own(model):
    """Raise InputError, naming what is in the way, unless the discrete derivative takes a model of one's own.

    What its functions are like is seen at places drawn at random.
    """
    model, random = guard(model, "EnergyMomentum"), np.random.default_rng(0)
    require_constraints(model)
    q, d = random.standard_normal((2, model.n))
    part, else_ = f"EnergyMomentum: {model.name}", "; use GeneralizedAlpha or IDA"
    if model.potential(q) is None:
        raise InputError(f"{part} gives no potential(q), so there is no energy to keep{else_}")
    if model.needs.mass_varies and not _equal(model.mass(q), model.mass(q + d)):
        raise InputError(f"{part}: its mass varies with q; it must be constant{else_}")
    if model.m and not _equal(model.phi(0.0, q + d) - model.phi(0.0, q - d), 2.0 * model.phi_q(0.0, q) @ d):
        raise InputError(f"{part}: its phi(t, q) is not quadratic in q, at most, which its constraints must be to do no work{else_}")
    if unguarded(model).by_numba:
        Compiled(model, OF_ENERGY)


def _equal(one, other):
    return abs(one - other).max() <= SAME * (abs(one).max() + abs(other).max())
