"""What is raised for a user's mistake and where an integrator cannot go on, warnings of what is right but far from converged, and how a step ends."""

# constants of compiled code: how a step, or a C function that it calls, ends
DONE, REFACTOR, INVERTED, NOT_FINITE, HALF_TURN, SINGULAR, TOO_FAR, TOO_NEAR, RAISED, WRONG_SHAPE, NO_MATRIX = range(11)
REASONS = {  # how a step can end, and what a failure says of it
    REFACTOR: ("newton", "Newton does not converge with fresh matrices"),
    INVERTED: ("inverted", "an element is turned inside out; St. Venant-Kirchhoff has collapsed in compression"),
    NOT_FINITE: ("not finite", "the motion is not finite"),
    HALF_TURN: ("half-turn", "a motor stands on the wrong half-turn"),
    RAISED: ("exception", "a compiled function of the model raised an exception"),
    WRONG_SHAPE: ("shape", "a compiled function of the model returned an array of a wrong shape"),
    NO_MATRIX: ("singular", "the iteration matrix is not finite"),
    SINGULAR: ("singular", "the constraints' system is singular"),
}


class InputError(ValueError):
    """A wrong input, found before the run: the message names the part, the value and what would be right.

    It is one line: line breaks go, and the middle of what is longer than 600 characters.
    """

    def __init__(self, message: object) -> None:
        line = " ".join(str(message).split())
        super().__init__(line if len(line) <= 600 else f"{line[:300]} ... {line[-295:]}")


class ReductionWarning(UserWarning):
    """The modes of a reduced plate leave much of its motion out."""


class LockingWarning(UserWarning):
    """Elements that are far too stiff for their material: the answer converges, but slowly."""


class StepFailure(Exception):
    """An integrator cannot go on: where, why, and what it last saw. `solve` turns it into a status and keeps the run so far."""

    def __init__(self, status, reason, t=float("nan"), **seen):
        self.status, self.reason, self.t, self.seen = status, reason, t, seen
        detail = ", ".join(f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}" for name, value in seen.items())
        super().__init__(f"{reason} at t = {t:.9g} s" + (f" ({detail})" if detail else ""))
