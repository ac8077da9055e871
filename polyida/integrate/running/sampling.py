"""Which instants of a run become frames, and where it stops: accepted steps, given times, the zero of a function."""

import numpy as np

from polyida.errors import InputError
from polyida.given import is_number, read_only
from polyida.integrate.running.hermite import cubic
from polyida.integrate.state import State, Stretch


def between(before, after, t):
    """The State at t between two accepted ones.

    q is the cubic Hermite polynomial through q and v at both ends, v its derivative, a and lam are linear in t; at an
    end it is the accepted state itself. q is of fourth, v of third, a and lam of second order in the step. An integrator's own
    polynomial, `after.within`, goes before.
    """
    if t in (before.t, after.t):
        return before if t == before.t else after
    if after.within is not None:
        return after.within(t)
    h = after.t - before.t
    s = (t - before.t) / h
    q, v = cubic(before.q, before.v, after.q, after.v, h, s)
    a, lam = before.a + s * (after.a - before.a), before.lam + s * (after.lam - before.lam)
    return State(float(t), q, v, a, lam, restart=False)


class Sampler:
    """Puts into a store every `every`-th accepted step, the first and the last; or the times `output`, where given.

    rows: the store's places of the next states, where each becomes a frame, or None.
    """

    def __init__(self, store, counts, every=1, output=None, done=0):
        self.store, self.counts, self.every = store, counts, every
        self.output, self.next, self.kept = output, done, None
        self.rows = store.rows if every == 1 and output is None else None

    def start(self, state):
        """Keep the first state."""
        if self.output is None:
            self.keep(state)
        elif self.next < len(self.output) and self.output[self.next] == state.t:
            self.next += 1
            self.keep(state)

    def step(self, before, stretch):
        """Keep what is wanted of the steps from one accepted state to those of a stretch, the last of which is number `counts.steps`."""
        if self.output is None:
            self._keep_every(stretch, self.counts.steps - len(stretch))
            return
        while self.next < len(self.output) and self.output[self.next] <= stretch.t[-1]:
            t = self.output[self.next]
            k = int(np.searchsorted(stretch.t, t))
            self.keep(between(stretch.state(k - 1) if k else before, stretch.state(k), t))
            self.next += 1

    def _keep_every(self, stretch, done):
        first = -(done + 1) % self.every
        if first < len(stretch):
            self.store.extend(stretch.part(first, len(stretch), self.every))
            self.kept = None if (done + len(stretch)) % self.every else stretch.last

    def end(self, state):
        """Keep the last state, where no times were given."""
        if self.output is None and state is not None:
            self.keep(state)

    def keep(self, state):
        """Make a state the next frame, unless it is the last one already."""
        if state is not self.kept:
            self.store.extend(Stretch.of(state))
            self.kept = state


class Until:
    """Watches f(t, q, v) for a change of sign from step to step. Raises InputError where it gives no finite number."""

    def __init__(self, function, state):
        self.function = function
        self.sign = np.sign(self._value(state))

    def crossing(self, before, after):
        """The state where f is zero between two accepted ones, or None. A zero at the start does not count."""
        value = self._value(after)
        if self.sign == 0 or (value != 0 and np.sign(value) == self.sign):
            self.sign = self.sign or np.sign(value)
            return None
        if value == 0:
            return after
        from scipy.optimize import brentq

        at = brentq(lambda t: self._value(between(before, after, t)), before.t, after.t, xtol=1e-300, rtol=4 * np.finfo(float).eps)
        return between(before, after, at)

    def _value(self, state):
        value = self.function(state.t, read_only(state.q), read_only(state.v))
        value = value.item() if isinstance(value, np.ndarray) and value.size == 1 else value
        if is_number(value):
            return float(value)
        given = f"an array of shape {np.shape(value)}" if np.ndim(value) else repr(value)
        wanted = "a finite number that changes sign where the run is to stop, like t - 0.02"
        raise InputError(f"until: the function gave {given} at t = {state.t:.9g} s; it must give {wanted}")
