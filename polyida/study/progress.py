"""How a study tells how far it is."""

from contextlib import contextmanager

from polyida.bar import bar_for
from polyida.errors import InputError


@contextmanager
def teller(study, progress):
    """A function of (done, total, what), of what a user gave: such a function, None or False: silence, or True: tqdm's bar.

    Raises InputError for anything else, and for True where tqdm is not installed.
    """
    if progress is None or progress is False:
        yield lambda done, total, what: None
    elif callable(progress):
        yield progress
    elif progress is True:
        with bar_for(study)(desc=study, leave=False) as bar:

            def tell(done, total, what):
                bar.total, bar.n = total, done
                bar.set_postfix_str(what)

            yield tell
    else:
        raise InputError(f"{study}: progress = {progress!r} must be a function of (done, total, what), True or None")
