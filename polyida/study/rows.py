"""Rows of a table of runs: cost and errors of each, their union in columns, and slopes fitted to them."""

from statistics import median

import numpy as np

from polyida.study.subject import PARTS

NAN = float("nan")


def fitted(x, y):
    """Slope of log y over log x by least squares; NaN where there are fewer than two finite positive points."""
    x, y = positive(x, y)
    return float(np.polyfit(np.log(x), np.log(y), 1)[0]) if len(np.unique(x)) > 1 else NAN


def positive(x, y):
    """The points whose coordinates are finite and positive both."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    good = np.isfinite(x) & np.isfinite(y) & (x > 0) & (y > 0)
    return x[good], y[good]


def pick(rows, **wanted):
    """The rows of tasks that did not fail, with these values."""
    return [row for row in rows if not row.get("error") and wanted.items() <= row.items()]


def value(row, name):
    """A number of a row; NaN where the row (None) or the number is missing."""
    found = None if row is None else row.get(name)
    return NAN if found is None else float(found)


def column(rows, name):
    """A number of each row, (rows,)."""
    return np.array([value(row, name) for row in rows], float)


def last(rows, **wanted):
    """The last of the rows with these values, or None."""
    return next(reversed(pick(rows, **wanted)), None)


def number(rows, name, **wanted):
    """A number of the last of the rows with these values."""
    return value(last(rows, **wanted), name)


def least(numbers):
    """The smallest finite number of several; NaN where there is none."""
    return min((float(x) for x in numbers if np.isfinite(x)), default=NAN)


def every(rows, name, **wanted):
    """A number of all rows with these values, those that failed included: theirs are NaN."""
    return column([row for row in rows if wanted.items() <= row.items()], name)


def worst(rows, name, **wanted):
    """The largest number of all rows with these values; NaN where there is none, or one of them failed or lacks it."""
    numbers = every(rows, name, **wanted)
    return float(numbers.max()) if numbers.size else NAN


def farthest(numbers, aim):
    """The number farthest from an aim; NaN where there is none or one is missing."""
    numbers = np.asarray(numbers, float)
    return float(numbers[np.abs(numbers - aim).argmax()]) if numbers.size and np.isfinite(numbers).all() else NAN


def each(rows, name):
    """The different values of an entry, in their order."""
    return list(dict.fromkeys(row[name] for row in rows if name in row))


def named(row, *names):
    """A row in words by these entries: numbers with their names, absent ones left out."""
    return ", ".join(str(row[name]) if isinstance(row[name], str) else f"{name} {row[name]:g}" for name in names if name in row)


def stopped(rows, *names, length=150):
    """Lines of the runs that did not come to their end, named by these entries, with their reason."""
    return [f"{named(row, *names)}: {row['outcome'][:length]}" for row in pick(rows) if row.get("outcome", "done") != "done"]


COUNTS = ("steps", "rejected", "newton_iterations", "residuals", "tangents", "factorizations", "solves")


def measured(subject, integrator, repeats=1):
    """(row, Trajectory of the ends alone): status, message, CPU seconds (the median of the repeats) and exact counts."""
    runs = [subject.run(integrator, every=10**9) for _ in range(repeats)]
    run = runs[0]
    row = {"status": run.status, "message": run.message, "t": float(run.t[-1]), "cpu_s": float(median(run.cpu_seconds for run in runs))}
    return row | {key: int(getattr(run.counts, key)) for key in COUNTS}, run


def errors(run, reference):
    """{"error_q", "error_v", "error_lam"}: the largest absolute deviation of each part at the end; NaN where the run did not come there,
    there is no reference, or nothing in the part.
    """
    return {f"error_{part}": _error(run, part, reference) for part in PARTS}


def _error(run, part, reference):
    if not run.success or not np.size(reference.get(part, ())):
        return NAN
    return float(np.abs(getattr(run, part)[-1] - reference[part]).max())


def smallest_errors(runs):
    """Function of a reference -> {part: the smallest error above zero of all runs}."""

    def of(reference):
        found = {part: [_error(run, part, reference) for run in runs] for part in PARTS}
        return {part: min((e for e in values if e > 0), default=0.0) for part, values in found.items()}

    return of
