"""The one exception that a user's mistake raises, and the warning of what is right but far from converged."""


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
