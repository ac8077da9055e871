"""How a study tells how far it is."""

from contextlib import contextmanager

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
        with _bar(study) as bar:
            yield bar.tell
    else:
        raise InputError(f"{study}: progress = {progress!r} must be a function of (done, total, what), True or None")


class _bar:
    def __init__(self, study):
        try:
            from tqdm.auto import tqdm
        except ImportError:
            raise InputError(f"{study}: progress=True needs tqdm; pip install 'polyida[notebook]'") from None
        self.bar = tqdm(desc=study, leave=False)

    def tell(self, done, total, what):
        self.bar.total, self.bar.n = total, done
        self.bar.set_postfix_str(what)

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self.bar.close()
