"""Rows of a study's table, picked and read where some are missing: what a missing row would have given is NaN."""

import numpy as np

NAN = float("nan")


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
