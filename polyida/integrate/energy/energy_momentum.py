"""The energy-momentum method of Simo and Tarnow (1992), with the discrete derivative of Gonzalez (1996) for users' models.

`phi = 0` at both ends leaves the deviation of `v_1 = 2 (q_1 - q_0)/h - v_0` from `phi_q v + phi_t = 0` as large as that of v_0, with the
opposite sign: the effect of a motor's jerk would alternate for ever, and appear in lam divided by h. So if phi is driven, v_1 is projected
along M^-1 phi_q^T; lam takes up what a step misses; a motor's energy was measured to be off by 4e-13 a step at 20 rad/s and 4 ms.
If nothing is driven, there is an energy to conserve, and v_1, off its constraint by O(h^2), has it. So the next step begins from that v_1
(memory "v_free"), which conserves energy and momenta; in the frame v_1 is projected and scaled to its kinetic energy, without the motion of
a free scene as a whole, whose momenta stay.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from polyida.errors import InputError
from polyida.fields import above_zero, check_fields, must_be
from polyida.integrate.discontinuities import Grid, at_kink, number_of_steps, pieces
from polyida.integrate.energy.steps import HALVINGS, Steps
from polyida.integrate.energy.tables import OF_ENERGY
from polyida.integrate.engine import steps_at_rest
from polyida.integrate.start import on_velocity
from polyida.integrate.state import Counts, Integrator, State, States, Stretch
from polyida.model import Model
from polyida.model.check import require_energies
from polyida.model.compiled import Compiled
from polyida.model.differences import beside
from polyida.model.guarded import guard, require_written
from polyida.validation import is_number, is_whole, named_keywords

SAME = 1e-9  # relative difference of what should be equal


@named_keywords
@dataclass(frozen=True)
class EnergyMomentum(Integrator):
    """Constant steps that conserve energy and momenta in the discrete sense.

    `M (v_1 - v_0)/h + f_int + B^T lam = f_ext(t_m)`, `q_1 - q_0 = h (v_0 + v_1)/2`, `phi(q_1, t_1) = 0`.

    Parameters
    ----------
    h : float, s
        Step. A run takes the largest step not above h that divides its time evenly, and at least four steps behind a kink of loads that are
        not straight lines.
    tolerance : float
        Newton's tolerance, of h^2 times the size of the acceleration.
    max_iterations : int
        Largest number of iterations of one Newton solve.

    Raises
    ------
    InputError
        For a setting out of range; a run raises it for a model that the method does not take.

    Notes
    -----
    The stress is that of the mean of the strains at both ends on the mean F; B is phi_q at the mean q and t. Without motors and damping the
    energy changes by what Newton's method leaves, since `f_int . (q_1 - q_0) = W_1 - W_0` and `B (q_1 - q_0) = 0`. Damping acts at the middle
    of the step and only takes energy. q, v, a and lam are of second order; velocities of frames satisfy their constraint. a and lam are
    computed for the frames that are kept; on plates that costs half to two thirds of a step.

    Models: every scene, with users' force elements and bodies by the discrete derivative of their energy, and every user's model with a
    `potential`, constant mass and phi at most quadratic in q. Other forces act at the middle. If phi_q varies, energy is conserved with
    `Needs(driven=False)` only. The discrete derivative of a potential is along `M (q_1 - q_0)`: momenta of a user's model change by the error of
    the method. Its slope along a step is a central difference of sixth order over a quarter of the step, whose error goes into the energy.

    Simo, Tarnow, ZAMP 43 (1992) 757-792; Gonzalez, CMAME 190 (2000) 1763-1783 for the stress; J. Nonlinear Sci. 6 (1996) 449-467 for the
    discrete derivative.
    """

    h: float = field(metadata=must_be("a positive step in s", above_zero))
    tolerance: float = field(default=1e-10, metadata=must_be("between 0 and 1", lambda x: is_number(x) and 0 < x < 1))
    max_iterations: int = field(default=40, metadata=must_be("a positive whole number", is_whole))
    trusted, order = True, 2

    def __post_init__(self):
        """Check the settings. Raises InputError for a setting out of range."""
        check_fields(self, self.class_name())

    def require(self, model: Model) -> None:
        """Raise InputError unless the method takes the model: any scene; a user's with a potential, constant mass, phi at most quadratic.

        Elements and models that declare conservative forces must give the energies of these. Functions are tested at random places.
        """
        if not model.is_scene:
            own, random = guard(model, "EnergyMomentum"), np.random.default_rng(0)
            require_written(own)
            q, d = random.standard_normal((2, own.n))
            part, other = f"EnergyMomentum: {own.name}", "; use GeneralizedAlpha or IDA"
            if own.potential(q) is None:
                raise InputError(f"{part} gives no potential(q), so there is no energy to keep{other}")
            if own.needs.mass_varies and not _equal(own.mass(q), own.mass(q + d)):
                raise InputError(f"{part}: its mass varies with q; it must be constant{other}")
            move = np.delete(2.0 * own.phi_q(0.0, q) @ d, own.velocity_rows)  # the force of a velocity row does no work in any case
            gain = np.delete(own.phi(0.0, q + d) - own.phi(0.0, q - d), own.velocity_rows)
            if move.size and not _equal(gain, move):
                wanted = "which its constraints must be to do no work"
                raise InputError(f"{part}: its phi(t, q) is not quadratic in q, at most, {wanted}{other}")
            if own.by_numba:
                Compiled(own, OF_ENERGY)
        own = guard(model)
        require_energies(own, 0.0, np.zeros(own.n))

    def steps(self, model: Model, state: State, t_end: float, counts: Counts) -> Iterator[State]:
        """Accepted states after `state` up to t_end, one for each step. Raises StepFailure."""
        return States(self._stretches(model, state, t_end, counts), counts)

    def _stretches(self, model, state, t_end, counts):
        """Stretches of accepted states, one piece between kinks after the other. Raises StepFailure."""
        for begin, end, most in pieces(model, state.t, t_end, self.h):
            t = beside(begin, 1) if at_kink(model, begin) else begin  # behind a jump of a motor's speed
            v, memory = model.sampled(begin, state.q, state.v), state.memory
            if "v_free" in memory and v is not state.v:
                memory = memory | {"v_free": memory["v_free"] + (v - state.v)}
            state = State(state.t, state.q, on_velocity(model, t, state.q, v), state.a, state.lam, memory)
            grid = Grid(begin, end, number_of_steps(model, state, begin, end, min(self.h, most)))
            for state, grid in steps_at_rest(model, state, grid, counts):  # noqa: B007 it is that behind the last one
                yield Stretch.of(state)
            if grid.done == grid.count:
                continue
            for ends in Steps(self, model, grid.h, counts, 0 if model.switching else HALVINGS).run(state, grid):
                counts.steps += len(ends)
                yield ends
            state = ends.last


def _equal(one, other):
    """True if two arrays or sparse matrices are equal up to round-off."""
    return abs(one - other).max() <= SAME * (abs(one).max() + abs(other).max())
