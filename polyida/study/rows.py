"""Selections from the rows of a study, and slopes fitted to them."""

import numpy as np

NAN = float("nan")


def fit_slope(x, y):
    """Least-squares slope of log y over log x; NaN for fewer than two different finite positive x."""
    x, y = positive(x, y)
    return float(np.polyfit(np.log(x), np.log(y), 1)[0]) if len(np.unique(x)) > 1 else NAN


def positive(x, y):
    """(x, y) without the points of which a coordinate is not finite or not positive, for logarithmic axes."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    good = np.isfinite(x) & np.isfinite(y) & (x > 0) & (y > 0)
    return x[good], y[good]


def pick(rows, **values):
    """The rows with these values that did not fail."""
    return [row for row in rows if not row.get("error") and values.items() <= row.items()]


def value(row, name):
    """A number of a row; NaN if the row is None or lacks the number."""
    number = None if row is None else row.get(name)
    return NAN if number is None else float(number)


def column(rows, name):
    """The values of a column, (rows,) floats; NaN for what is missing."""
    return np.array([value(row, name) for row in rows], float)


def last(rows, **values):
    """The last row with these values that did not fail, or None."""
    return next(reversed(pick(rows, **values)), None)


def number(rows, name, **values):
    """The value of a column in the last successful row with these values in other columns."""
    return value(last(rows, **values), name)


def smallest(numbers):
    """The smallest finite number; NaN if there is none."""
    return min((float(x) for x in numbers if np.isfinite(x)), default=NAN)


def column_with_failures(rows, name, **values):
    """The values of a column in all rows with these values in other columns, (rows,); NaN for failed rows."""
    return column([row for row in rows if values.items() <= row.items()], name)


def largest(rows, name, **values):
    """The largest number of all rows with these values; NaN if there is none, or if one of them failed or lacks it."""
    numbers = column_with_failures(rows, name, **values)
    return float(numbers.max()) if numbers.size else NAN


def farthest(numbers, target):
    """The number with the largest distance from a target; NaN if there is none or one is not finite."""
    numbers = np.asarray(numbers, float)
    return float(numbers[np.abs(numbers - target).argmax()]) if numbers.size and np.isfinite(numbers).all() else NAN


def distinct(rows, name):
    """The different values of a column, in the order in which they occur."""
    return list(dict.fromkeys(row[name] for row in rows if name in row))


def description(row, *names):
    """A row in words by these columns; numbers with their names, missing ones left out."""
    return ", ".join(str(row[name]) if isinstance(row[name], str) else f"{name} {row[name]:g}" for name in names if name in row)


def unfinished_notes(rows, *names, length=150):
    """A line for each run that did not reach its end, described by these columns, with the reason."""
    return [f"{description(row, *names)}: {row['outcome'][:length]}" for row in pick(rows) if row.get("outcome", "done") != "done"]
