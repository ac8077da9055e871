"""The one exception that a user's mistake raises."""


class InputError(ValueError):
    """A wrong input, found before the run: the message names the part, the value and what would be right."""
