"""Forces that jump with the velocity, as dry friction written with a sign: steps with control of errors are rejected there for ever.

Where steps are rejected often, forces at v + w and v - w are compared, w small and random. If they differ by much, the interval is halved on the
side with the larger difference: the difference of a smooth force vanishes, that of a jump stays.
"""

import numpy as np

from polyida.errors import StepFailure
from polyida.force.force_element import ForceElement
from polyida.model.guarded import unguarded
from polyida.registry import is_built_in

JUMP_IN_V = "jump in v"  # the status of a run that ends there
REJECTED = 30  # steps in a short time, after which the forces are examined
ACCEPTED = 300  # the same of accepted steps: IDA goes on in tiny ones and rejects few
SHORT = 1e-3  # of the run's time: a run that passes a jump goes on from there
NEAR = 1e-3  # of the largest speed so far: width of the interval
HALVINGS = 30
LARGE = 1e-3  # of the largest force: a smaller difference is not examined
STAYS = 0.5  # of the difference at first: what a jump keeps


class Jumps:
    """Looks at accepted states; `look` raises a StepFailure where the forces jump with v and the run makes no way."""

    def __init__(self, model, counts, t, t_end):
        """Take the model, the Counts of the run, and its first and last time."""
        self.model, self.counts = model, counts
        self.speed = 0.0  # the largest so far
        self.since, self.steps, self.rejected = t, counts.steps, counts.rejected  # time and counts at the last look
        self.short = SHORT * (t_end - t)  # s

    def look(self, stretch):
        """Look at accepted steps; raises StepFailure if many were rejected in a short time and the forces jump."""
        self.speed = max(self.speed, float(np.abs(stretch.v[-1]).max(initial=0.0)))
        if self.counts.rejected - self.rejected < REJECTED and self.counts.steps - self.steps < ACCEPTED:
            return
        last, since = stretch.last, self.since
        self.since, self.rejected, self.steps = last.t, self.counts.rejected, self.counts.steps
        if last.t - since <= self.short and (found := self.found(last)):
            raise StepFailure(JUMP_IN_V, found, last.t, rejected=self.counts.rejected)

    def found(self, state):
        """A message if the forces jump as a function of the velocity near a State; otherwise an empty text.

        Forces are compared along one random direction of velocities, by bisection of the interval with the largest change.
        """
        if not (self.speed and self.model.needs.velocity_forces):
            return ""
        width = NEAR * self.speed * np.random.default_rng(0).standard_normal(len(state.v))
        low, high = -1.0, 1.0
        forces = [self._forces(state, state.v + s * width) for s in (low, high)]
        if forces[0] is None or forces[1] is None:
            return ""
        at = int(np.argmax(np.abs(forces[1] - forces[0])))
        below, above = forces[0][at], forces[1][at]
        first = abs(above - below)
        if not first > LARGE * max(np.abs(one).max() for one in forces):
            return ""
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            force = self._forces(state, state.v + middle * width)
            if force is None:
                return ""
            if abs(force[at] - below) >= abs(above - force[at]):
                high, above = middle, force[at]
            else:
                low, below = middle, force[at]
        return self._message(first) if abs(above - below) >= STAYS * first else ""

    def _forces(self, state, v):
        """The force vector g, (n,), at a state with other velocities v; None if it is not finite."""
        force = np.asarray(self.model.force(state.t, state.q, v))
        return force if np.isfinite(force).all() else None

    def _message(self, size):
        """Message of a jump of that size, with the force elements that may cause it."""
        parts = getattr(unguarded(self.model), "parts", {})
        own = [
            name for name, part in parts.items() if isinstance(part, ForceElement) and (_is_function(part) or not is_built_in(type(part)))
        ]
        who = f"the force of {' or '.join(map(repr, own))}" if own else "a force"
        return (
            f"{who} jumps by {size:.3g} with the velocity, as dry friction with a sign does: no step is short enough; use friction= of a joint "
            "or contact with NonsmoothAlpha or an event-driven run, or a smooth function such as tanh(v / v_0)"
        )


def _is_function(part):
    """True if a field of a force element is a user's function of the state."""
    return any(callable(value) and not hasattr(value, "kinks") for value in vars(part).values())
