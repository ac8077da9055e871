"""What an event does to q and v: projections onto the rows that act behind it, and impulses.

A run (`events.py`) and its adjoint (`adjoint/resets.py`) call the same Reset. An impulse has a given size. An impact reverses the rate of a
function g(t, q): the size of its impulse along dg/dq is the one that makes `g'+ = -e g'-`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import singledispatch
from typing import Any, NamedTuple

import numpy as np

from polyida.errors import InputError
from polyida.integrate.start import on_position
from polyida.model.differences import along, jacobian, reach_along

FREE = 1e-7  # of dg/dq, which is found by differences: the share that joints leave; a smaller one is round-off


class Push(NamedTuple):
    """Velocities that an event changes by an impulse.

    kind: "impulse" or "impact". impulse: what is given, N s; at: the attachment; along (n,): its generalised force. function: of (t, q), whose rate an impact changes by `-factor` of it.
    """

    kind: str
    impulse: tuple = ()
    at: Any = None
    along: Any = None
    function: Any = None
    factor: float = 1.0


@dataclass(frozen=True, eq=False)
class Reset:
    """What an event does to q and v when its parts have changed. The run and its adjoint call it.

    equations: the model behind the event, with its equations alone. given: function (t, q, v, a, lam) -> (q, v) of the functions in `then`, or
    None; it acts first. held: names of the joints that hold on to the position behind it. pushes: they act last, in this order. mode: the model
    before the event.
    """

    mode: Any
    given: Callable | None
    held: tuple
    equations: Any
    pushes: list

    def __call__(self, model, t, q, v):
        """(q, v, impulses of the rows, sizes of the pushes) behind an event at (t, q, v); model: `equations`, or the same on a tape.

        q is projected onto the position constraints, v onto the velocity constraints. Then each push changes v by `size y`, where
        `M y + phi_q^T lam = w` and `phi_q y = 0`; w is the generalised force of the push.
        """
        none, sizes = np.zeros(model.m), []
        q = on_position(model, t, q)
        rate = model.phi_rate(t, q, v) if model.m else none
        impulses = none
        if rate.any():
            change, impulses = model.mass_system(t, q).solve(np.zeros(model.n), rate)
            v = v + change
        for push in self.pushes:
            w = slope_of(model, push.function, t, q) if push.function else push.along
            y, lam = model.mass_system(t, q).solve(-w, none)
            size = 1.0
            if push.function:
                size = rate_of(model, push.function, t, q, v) / (w @ y) * -push.factor
            sizes.append(size)
            v, impulses = v + y * size, impulses + lam * size
        return q, v, impulses, sizes


def pull_of(model, at, impulse):
    """The generalised impulse (n,) of an impulse (2,), N s, on an attachment."""
    return model.pulled((at, "point"), np.array([complex(*impulse)]))[0]


def require_free(model, pushes, t, q):
    """Raise InputError if the joints and drives of a model hold all of the function that an impact reverses, but for round-off."""
    for push in pushes:
        if push.function:
            q = on_position(model, t, q)
            w = slope_of(model, push.function, t, q)
            moved = model.mass(q) @ model.mass_system(t, q).solve(-w, np.zeros(model.m))[0]  # w without what the joints take
            if not np.linalg.norm(moved) > FREE * np.linalg.norm(w):
                raise InputError("Impact: the joints do not let `when` change")


@singledispatch
def slope_of(model, function, t, q):
    """The slope (n,) of a function of (t, q) in q, by differences. model: one whose q it is."""
    return jacobian(lambda x: np.array([function(t, x)]), q, 1)[0]


@singledispatch
def rate_of(model, function, t, q, v):
    """Total derivative in time of a function of (t, q) with q' = v, a float, by differences."""
    return float(along(lambda s: np.array([function(t + s, q + s * v)]), reach_along(q, v))[0])
