"""Exceptions and warnings, and the codes with which a compiled step ends."""

import re

# constants of compiled code: how a step, or a C function that it calls, ends
DONE, REFACTOR, INVERTED, NOT_FINITE, HALF_TURN, SINGULAR, ERROR_LARGE, ERROR_SMALL, RAISED, WRONG_SHAPE, NO_MATRIX = range(11)
REASONS = {  # (status, message) of a failed step
    REFACTOR: ("newton", "Newton does not converge with fresh matrices"),
    INVERTED: ("inverted", "an element is turned inside out; St. Venant-Kirchhoff has collapsed in compression"),
    NOT_FINITE: ("not finite", "the motion is not finite"),
    HALF_TURN: ("half-turn", "a motor stands on the wrong half-turn"),
    RAISED: ("exception", "a compiled function of the model raised an exception"),
    WRONG_SHAPE: ("shape", "a compiled function of the model returned an array of a wrong shape"),
    NO_MATRIX: ("singular", "the iteration matrix is not finite"),
    SINGULAR: ("singular", "the constraints' system is singular"),
}


STEERING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")


def printable(text):
    """A text for a terminal: characters that would steer it, or turn the direction of writing, are shown as `\\x1b`.

    Names, files and messages of other libraries may contain them. Ends of lines and tabs stay.
    """
    return STEERING.sub(lambda found: found[0].encode("unicode_escape").decode(), str(text))


def text_of(error):
    """The text of an exception; of one whose own text fails, that it has none."""
    try:
        return str(error)
    except Exception:  # noqa: BLE001, a user's class may raise anything
        return "an exception that cannot be shown"


class InputError(ValueError):
    """A wrong input, detected before the run: the message names the part, the value and what would be right.

    Parameters
    ----------
    message : object
        Reduced to one line of at most 600 characters.
    """

    def __init__(self, message: object) -> None:
        """Take the message and store it in one line, with control characters escaped, cut to at most about 600 characters."""
        line = printable(" ".join(str(message).split()))
        super().__init__(line if len(line) <= 600 else f"{line[:300]} ... {line[-295:]}")


class NamingWarning(UserWarning):
    """A warning whose text may have names and words of files in it."""

    def __str__(self) -> str:
        """The message with control characters escaped, fit to print."""
        return printable(super().__str__())


class ReductionWarning(NamingWarning):
    """The modes of a reduced plate do not represent much of its motion."""


class LockingWarning(NamingWarning):
    """The cells of a plate are far too stiff or too soft: the result converges, but slowly."""


class StepFailure(Exception):
    """An integrator cannot continue: a step failed. `pi.solve` then returns the run so far with this status and message.

    Parameters
    ----------
    status : str
        The kind of failure in one or two words, `run.status`.
    reason : str
        What failed, the beginning of `run.message`.
    t : float, s
        Time of the failed step.
    **seen : float or str
        Values of the failed step, such as `residual=1e-3`; they follow in the message.
    """

    def __init__(self, status: str, reason: str, t: float = float("nan"), **seen: object) -> None:
        """Compose the message from reason, time and the values of the failed step."""
        self.status = status
        self.reason = reason
        self.t = t
        self.seen = seen
        detail = ", ".join(f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}" for name, value in seen.items())
        super().__init__(f"{printable(reason)} at t = {t:.9g} s" + (f" ({detail})" if detail else ""))
