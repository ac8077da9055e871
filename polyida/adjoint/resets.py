"""What events do to a state, on a tape: the run's own functions (run/events.py), those of users by differences."""

from functools import singledispatch

import numpy as np

from polyida.adjoint.taped import Tape, TapedModel, add_to
from polyida.integrate.start import consistent_acceleration, on_position, on_velocity
from polyida.model.differences import along, jacobian, reach_along
from polyida.run.event_search import AHEAD
from polyida.run.reset import rate_of, slope_of


@slope_of.register
def _(model: TapedModel, function, t, q):
    """The slope of a function along q on a tape, with its own derivative by differences."""

    def back(adjoint):
        """Add `H adjoint` to the adjoint of q, by differences; H is the second derivative of the function in q."""
        add_to(q, along(lambda s: slope_of(model.model, function, t, q.value + s * adjoint), reach_along(q.value, adjoint)))

    return model.tape.record([slope_of(model.model, function, t, q.value)], back)[0]


@rate_of.register
def _(model: TapedModel, function, t, q, v):
    """The rate of a function along the motion on a tape, with its derivatives by differences."""

    def back(adjoint):
        """Add the derivatives of the rate times its adjoint: the rate of the slope for q, the slope itself for v."""
        here = lambda s: slope_of(model.model, function, t + s, q.value + s * v.value)  # noqa: E731
        add_to(q, adjoint * along(here, reach_along(q.value, v.value)))
        add_to(v, adjoint * here(0.0))

    return model.tape.record([rate_of(model.model, function, t, q.value, v.value)], back)[0]


@singledispatch
def changed_by(model, given, t, q, v, a, lam):
    """(q, v) that the functions of a Reset give at a state of the model before it."""
    return given(t, q, v, a, lam)


@changed_by.register
def _(model: TapedModel, given, t, q, v, a, lam):
    """On a tape, by differences. Places and velocities keep the constraints, since functions may refuse others."""
    mode, now = model.model, [x.value for x in (q, v, a, lam)]

    def back(*adjoints):
        """Add the slopes of `adjoints . change` in q, v, a and lam, by differences."""

        def change(*state):
            """The sum of the products of the adjoints with what the functions give at the nearest permitted state, (1,)."""
            return np.array([sum(float(adjoint @ x) for adjoint, x in zip(adjoints, on_constraints(mode, given, t, *state)))])

        for k, one in enumerate((q, v, a, lam)):
            add_to(one, jacobian(lambda x, k=k: change(*now[:k], x, *now[k + 1 :]), now[k], 1)[0])

    return tuple(model.tape.record(given(t, *now), back))


def on_constraints(mode, given, t, q, v, a, lam):
    """What functions of a Reset give at the nearest place and velocity that the mode allows."""
    q = on_position(mode, t, q) if mode.m else q
    return given(t, q, on_velocity(mode, t, q, v), a, lam)


def behind(resets, models, t, q, v):
    """[q, v, positions that joints hold on to] behind resets, from those before. models: (before, behind) of each, or those on a tape."""
    places = []
    for reset, (before, model) in zip(resets, models):
        if reset.given:
            q, v = changed_by(before, reset.given, t, q, v, *consistent_acceleration(before, t, q, v))
        places += [q] * bool(reset.held)
        q, v, *_ = reset(model, t, q, v)
    return [q, v, *places]


def rate_behind(resets, state):
    """The rate of what `behind` gives, one vector, along the motion before; differences of the whole map, also in its time."""
    models = [(reset.mode, reset.equations) for reset in resets]
    return along(lambda s: np.concatenate(behind(resets, models, *moved_along(state, s))), span_of(state))


def pulled_through(resets, state, adjoints):
    """(adjoint of q, adjoint of v, [(model, entries for parameters)]) at a state, from the adjoints of what `behind` gives."""
    tape = Tape()
    q, v = tape.var(state.q), tape.var(state.v)
    models = [(TapedModel(reset.mode, tape), TapedModel(reset.equations, tape)) for reset in resets]
    for result, adjoint in zip(behind(resets, models, state.t, q, v), adjoints):
        add_to(result, adjoint)
    tape.back()
    return q.adjoint, v.adjoint, [(taped.model, taped.entries) for pair in models for taped in pair]


def moved_along(state, s):
    """(t, q, v) of the motion from a state, s later, up to the third power of s."""
    return state.t + s, state.q + s * state.v + 0.5 * s * s * state.a, state.v + s * state.a


def span_of(state):
    """Time in which a state changes so little that differences along its motion are accurate, s."""
    return AHEAD * min(reach_along(state.q, state.v), reach_along(state.v, state.a))
