"""What is raised for a user's mistake and where an integrator cannot go on, and warnings of what is right but far from converged."""


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
