"""The functions g that locate events, with their derivatives: of rows with laws, and of users.

Each class has `rate(state)`, g' along the motion before the event, and `back(state, c)`, the slopes of c g at a state of that motion: (c g_q,
c g_v, model, entries). model: that of all rows, or the mode if g is of a force or of the user; entries: its AdjointMultipliers, which give c g_p.
"""

import numpy as np

from polyida.adjoint.resets import moved_along, span_of
from polyida.adjoint.taped import Tape, TapedModel, pulled_back
from polyida.integrate.nonsmooth.cone import CLOSED, SLIPS_UP
from polyida.integrate.start import consistent_acceleration
from polyida.integrate.state import State
from polyida.model.differences import along, jacobian


def row_function(whole, mode, number, status):
    """The function of the row with law `number` that has a status in a mode of the model of all rows, `whole`."""
    law = whole.row_laws[number]
    if law.is_contact and status != CLOSED:
        return GapFunction(whole, law)
    if not law.is_contact and status >= SLIPS_UP:
        return SlipRateFunction(whole, law)
    return ForceFunction(whole, mode, law)


def unit_row(whole, law, c):
    """Weights (m,) of all rows: c for that of a law, else 0."""
    unit = np.zeros(whole.m)
    unit[law.row] = c
    return unit


class GapFunction:
    """The gap phi of an open contact."""

    def __init__(self, whole, law):
        """Take the model of all rows, and the law of the contact."""
        self.whole, self.law = whole, law

    def rate(self, state):
        """The rate of the gap."""
        return float(self.whole.phi_rate(state.t, state.q, state.v)[self.law.row])

    def back(self, state, c):
        """(c g_q, c g_v, model, its entries for parameters) at a state."""
        unit = unit_row(self.whole, self.law, c)
        taped = TapedModel(self.whole, Tape())
        taped.add_entry(state.t, state.q, mu=unit)
        return unit @ self.whole.phi_q(state.t, state.q), np.zeros(len(state.q)), self.whole, taped.entries


class SlipRateFunction:
    """The rate of a row of friction that slips."""

    def __init__(self, whole, law):
        """Take the model of all rows, and the law of the friction."""
        self.whole, self.law = whole, law

    def rate(self, state):
        """The rate's own derivative in time, `phi_q a + bias` of the row."""
        whole, (t, q, v) = self.whole, (state.t, state.q, state.v)
        return float((whole.phi_q(t, q) @ state.a + whole.phi_bias(t, q, v))[self.law.row])

    def back(self, state, c):
        """(c g_q, c g_v, model, its entries for parameters) at a state."""
        unit = unit_row(self.whole, self.law, c)
        of_q, of_v, entries = pulled_back(self.whole, state, lambda model, q, v: (model.phi_rate(state.t, q, v),), (unit,))
        return of_q, of_v, self.whole, entries


class ForceFunction:
    """The pressure -lam of a closed contact, or what friction that sticks leaves of its bound, `c(lam) - |lam|`."""

    def __init__(self, whole, mode, law):
        """Take the model of all rows, the mode before the event, and the law of the row."""
        self.whole, self.mode, self.law = whole, mode, law

    def rate(self, state):
        """The derivative in time, by differences of the consistent multipliers along the motion."""
        weights = self._weights(state)

        def force(s):
            """The derivative of the function in lam times the consistent lam at the time s later along the motion, (1,)."""
            lam = self.mode.spread(consistent_acceleration(self.mode, *moved_along(state, s))[1], self.whole.m)
            return np.array([weights @ lam])

        return float(along(force)[0])

    def back(self, state, c):
        """(c g_q, c g_v, the mode, its entries for parameters) at a state, g of the multipliers lam that belong to consistent accelerations."""
        adjoints = None, c * self._weights(state)[self.mode.columns]
        of_q, of_v, entries = pulled_back(self.mode, state, lambda model, q, v: consistent_acceleration(model, state.t, q, v), adjoints)
        return of_q, of_v, self.mode, entries

    def _weights(self, state):
        """The derivative of the function in lam of all rows, (m,)."""
        lam, weights = self.mode.spread(state.lam, self.whole.m), np.zeros(self.whole.m)
        weights[self.law.row] = -1.0 if self.law.is_contact else -np.sign(lam[self.law.row])
        size = np.linalg.norm(lam[list(self.law.on)])
        if not self.law.is_contact and size:
            weights[list(self.law.on)] += self.law.mu * lam[list(self.law.on)] / size
        return weights


class UserFunction:
    """The function of a user's event, by differences; it does not depend on parameters but by accelerations and multipliers."""

    def __init__(self, handler, event, mode, state):
        """Take the slopes of the function in q and v, and in a and lam if it reads these, at the event."""
        self.handler, self.event, self.mode = handler, event, mode
        self.of_forces = event.name in handler.of_forces
        self.slopes = []  # (len,) in each of q, v, a and lam that it reads
        vectors = state.q, state.v, state.a, state.lam
        with handler.in_mode(mode):
            for k in range(4 if self.of_forces else 2):

                def value_with(x, k=k):
                    """The function with x in place of vector k of the state, (1,)."""
                    return self._at(state.t, *vectors[:k], x, *vectors[k + 1 :])

                self.slopes.append(jacobian(value_with, vectors[k], 1)[0])

    def _at(self, t, q, v, a, lam):
        """The function of the event at a state, (1,)."""
        return np.array([self.handler.value(self.event, State(t, q, v, a, lam))])

    def rate(self, state):
        """dg/dt along the motion, whose accelerations are consistent."""

        def moved(s):
            """The function of the event, (1,), at the time s later along the motion; with consistent a and lam if it reads these."""
            now = moved_along(state, s)
            return self._at(*now, *(consistent_acceleration(self.mode, *now) if self.of_forces else (state.a, state.lam)))

        with self.handler.in_mode(self.mode):
            return float(along(moved, span_of(state))[0])

    def back(self, state, c):
        """(c g_q, c g_v, model, its entries for parameters) at a state."""
        of_q, of_v, entries = c * self.slopes[0], c * self.slopes[1], []
        if self.of_forces:
            adjoints = [c * slope for slope in self.slopes[2:]]
            q, v, entries = pulled_back(self.mode, state, lambda model, q, v: consistent_acceleration(model, state.t, q, v), adjoints)
            of_q, of_v = of_q + q, of_v + v
        return of_q, of_v, self.mode, entries
