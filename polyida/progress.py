"""Progress of long computations: a user's function, or a bar of tqdm at a terminal or in a notebook."""

from contextlib import contextmanager
from importlib.util import find_spec

from polyida.clock import watched
from polyida.errors import InputError
from polyida.validation import library


def bar_for(part):
    """tqdm's class of bars. Raises InputError if it is not installed."""
    return library("tqdm.auto", f"{part}: progress = True needs tqdm; pip install 'polyida[notebook]'").tqdm


def require_progress(part, progress):
    """Raise InputError unless progress is None, False, a function of t, or True and tqdm is installed."""
    if progress is True:
        bar_for(part)
    elif progress is not None and progress is not False and not callable(progress):
        raise InputError(f"{part}: progress = {progress!r} must be a function of t, True or None")


@contextmanager
def over_time(progress, begin, t_end):
    """The function to call with t at every step, or None: the user's, or that of a bar over the run's time."""
    if progress is not True:
        yield progress or None
        return
    form = "{desc} {percentage:3.0f}%|{bar}| {elapsed}<{remaining}"
    with bar_for("solve")(total=t_end - begin, bar_format=form, leave=False) as bar:

        def tell(t):
            """Show the time t of the run, s, in the bar."""
            bar.set_description_str(f"t = {t:.4g} of {t_end:.4g} s", refresh=False)
            bar.update(t - begin - bar.n)

        yield tell


@contextmanager
def backward(progress, run):
    """The function to call with t at every step of a backward sweep over a run; a bar begins at the end of the run."""
    begin, end = float(run.t[0]), float(run.t[-1])
    with over_time(progress, begin, end) as tell:
        yield (lambda t: tell(begin + end - t)) if progress is True else tell or (lambda t: None)


@contextmanager
def teller(study, progress):
    """A function of (done, total, what): the user's, that of tqdm's bar (True), or one without output (False).

    None: a bar where someone looks on, if tqdm is installed. Raises InputError for anything else, and for True if tqdm is not installed.
    """
    if progress is None:
        progress = watched() and find_spec("tqdm") is not None
    if progress is False:
        yield lambda done, total, what: None
    elif callable(progress):
        yield progress
    elif progress is True:
        with bar_for(study)(desc=study, leave=False) as bar:

            def tell(done, total, what):
                """Show in the bar that `done` of `total` steps are done, and what comes next."""
                bar.total, bar.n = total, done
                bar.set_postfix_str(what)

            yield tell
    else:
        raise InputError(f"{study}: progress = {progress!r} must be a function of (done, total, what), True or None")
