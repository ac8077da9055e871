"""The stages of a run's steps, which its frames do not hold: solved again from each step's beginning by the method's own code, to round-off."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from polyida.integrate.kinks import inner_side
from polyida.integrate.radau.plain import PlainSystem, lift
from polyida.integrate.radau.radau_iia import EXACT
from polyida.integrate.radau.steps import Steps
from polyida.integrate.sizes import typical_sizes
from polyida.integrate.state import State
from polyida.linear.matrix import dense


class Stages(NamedTuple):
    """A step of h, s, and its stages: t (s,), e = q_i - q_0 - c_i h v_0, q, v, v' (s, n), lam (s, m), mu (s, m) or (s, 0) without."""

    h: float
    t: np.ndarray
    e: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray
    mu: np.ndarray


class StagesAgain:
    """Of a model and the settings of its run, which began with a state.

    lift (n,): the diagonal of D^-1, lifts: whether that is made of M; tied: whether there is mu; moves_v: whether the end's v is
    moved onto its constraint.
    """

    def __init__(self, model, settings, first, t_end, counts):
        sizes = typical_sizes(model, first, t_end - first.t)
        self.model = model
        self.engine = Steps(replace(settings, tolerance=EXACT * float(sizes[0])), model, counts, sizes)
        self.engine.begin(first)
        self.engine.looks = False
        system, self.tableau = self.engine.system, self.engine.tableau
        self.tied, self.moves_v = system.tied, system.moves_v and not system.tied
        self.lifts = isinstance(system, PlainSystem) and system.tied and not model.alike
        self.lift = lift(model, self.engine.shares) if self.lifts else np.ones(model.n)
        self.before = None

    def of(self, state, t):
        """The Stages of the step from a state to t. Raises StepFailure."""
        h, begin = t - state.t, inner_side(self.model, state.t, state.t - t)
        self.engine.limits = begin if begin != state.t else -np.inf, inner_side(self.model, t, t - state.t)
        goes_on = self.before is not None and self.before.t == state.t and begin == state.t
        memory = self.before.memory if goes_on else {}
        self.before, _ = self.engine.step(State(state.t, state.q, state.v, state.a, state.lam, memory), h, t)
        return self._stages(state, h)

    def _stages(self, state, h):
        x, W, model = self.engine.system.trial, self.tableau.W, self.model
        e, lam, mu = x.e.copy(), x.lam.copy(), x.mu.copy()
        t = np.array([self.engine.clamp(state.t + c * h) for c in self.tableau.c])
        q = state.q + self.tableau.c[:, None] * h * state.v + e
        dv = W @ e / h
        if self.tied:
            dv += [self.lift * (dense(model.phi_q(*at)).T @ more) for *at, more in zip(t, q, mu)]
        return Stages(h, t, e, q, state.v + dv, W @ dv / h, lam, mu)
