"""One function of a user's model, checked: read-only arguments, a copied result of the right shape and type."""

import numpy as np

from polyida.errors import InputError

FLOAT = np.dtype(float)


def read_only_view(argument):
    """A read-only view of an array; anything else as it is."""
    if isinstance(argument, np.ndarray):
        argument = argument.view()
        argument.setflags(False)
    return argument


class CheckedFunction:
    """A function of a user with read-only arguments, and a result that is checked and copied: it may return one array again and again.

    label: its name in messages. function: the user's. shape: of its results. seen: [arguments, result] of the last call, for messages.
    """

    def __init__(self, label, function, shape):
        """Take the user's function, its name for messages and the shape of its results."""
        self.label, self.function, self.shape = label, function, shape
        self.seen = [(), np.zeros(0)]

    def __call__(self, *values):
        """A copy of the function's result. Raises InputError for a wrong one, and if the function writes into its arguments."""
        self.seen[0] = arguments = tuple(map(read_only_view, values))
        try:
            result = self.function(*arguments)
        except ValueError as error:
            raise self.explained(error)  # noqa: B904 with its cause
        if not (type(result) is np.ndarray and result.dtype is FLOAT and result.shape == self.shape):
            result = self.array(result)
        self.seen[1] = result
        return result.copy()

    def array(self, result):
        """A result as an array of floats, dense or sparse in rows or columns. Raises InputError for other types and shapes."""
        require_array(self.label, result, self.shape)
        sparse = getattr(result, "format", "csr") not in ("csr", "csc")  # other formats lack operations
        return (result.tocsr() if sparse else result).astype(float)

    def explained(self, error):
        """The InputError of a function that wrote into its arguments; any other error as it is."""
        if not (isinstance(error, ValueError) and "read-only" in str(error)):
            return error
        refused = InputError(f"{self.label} writes into its arguments, which belong to the integrator: take a copy first")
        refused.__cause__ = error
        return refused

    @property
    def is_finite(self):
        """False if the last call gave numbers that are not finite for finite arguments."""
        arguments, result = self.seen
        entries = result if isinstance(result, np.ndarray) else result.tocsr().data
        return np.isfinite(entries).all() or not all(np.isfinite(x).all() for x in arguments)


def require_array(label, result, shape):
    """Raise InputError unless result is an array of exactly this shape with real or whole numbers; label: the function, in the message."""
    part = f"{label} must return an array of shape {shape}"
    if getattr(result, "shape", None) != shape:
        raise InputError(f"{part}, not {getattr(result, 'shape', None) or f'another type, {type(result).__name__}'}")
    if getattr(result.dtype, "kind", "O") not in "fiu":
        raise InputError(f"{part} of real numbers, not of {result.dtype}")
