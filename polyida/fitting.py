"""Parameters of models from measured histories, by least squares (scipy.optimize.least_squares)."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from inspect import signature
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.errors import InputError, StepFailure
from polyida.reprs import brief
from polyida.validation import floats, is_number, named_keywords, one_of, positive, reals, whole

STEP = 1e-5  # of a parameter's size: step of forward differences; errors of runs of 1e-10 leave five digits of the slopes
LARGE = 10.0  # times the largest norm of residuals so far: that of a run that fails
APART = 1e-8  # of the largest singular value of the Jacobian: below it parameters cannot be told apart
PRECISE = 1e-12  # of sums of squares, parameters and gradients, where the search ends


@named_keywords
@dataclass(frozen=True, eq=False)
class Fit:
    """Parameters that fit measured values best; the result of `pi.fit`.

    Parameters
    ----------
    values : dict of str to float
        The parameters.
    covariance : (p, p) float
        Of the parameters in their order: `s^2 (J^T J)^-1`, J the slopes of the predicted values over sigma, `s^2 = sum(residuals^2) / (N - p)`; s = 1 if
        sigma was given.
    measured, predicted : array of float
        Measured values, and those of the best parameters, of one shape.
    runs, failed : int
        Calls of the function, and how many of them failed.
    message : str
        Why the search ended.
    """

    values: dict[str, float]
    covariance: NDArray
    measured: NDArray
    predicted: NDArray
    runs: int
    failed: int
    message: str

    __repr__ = brief

    @property
    def errors(self) -> dict[str, float]:
        """Standard deviation of each parameter, {name: float}, from the covariance."""
        return dict(zip(self.values, np.sqrt(np.diagonal(self.covariance)).tolist()))

    @property
    def correlation(self) -> NDArray:
        """Correlation of the parameters, (p, p): near 1 or -1 where the measured values determine a combination of two alone."""
        size = np.sqrt(np.diagonal(self.covariance))
        return self.covariance / np.outer(np.where(size > 0.0, size, 1.0), np.where(size > 0.0, size, 1.0))

    def summary(self) -> str:
        """Return a line for each parameter: value, standard deviation."""
        off = float(np.sqrt(np.mean((self.predicted - self.measured) ** 2)))
        head = f"{len(self.values)} parameters from {self.measured.size} values in {self.runs} runs, {self.failed} of which failed; rms residual {off:.3g}"
        return "\n".join([head] + [f"{name} = {value:.8g} +- {self.errors[name]:.2g}" for name, value in self.values.items()])

    @named_keywords
    def plot(self, axes: Any = None) -> Any:
        """Return a matplotlib Figure of the measured and the predicted values.

        Parameters
        ----------
        axes : matplotlib axes, optional
            To draw on.

        Returns
        -------
        Figure
            Values over their number.
        """
        from polyida.show.styles import on_axes

        with on_axes(axes) as axis:
            axis.plot(self.measured.ravel(), ".", color="0.6", label="measured")
            axis.plot(self.predicted.ravel(), "-", label="fitted")
            axis.set(xlabel="number of the value", ylabel="value")
            axis.legend()
        return axis.figure


@named_keywords
def fit(
    function: Callable[..., ArrayLike],
    measured: ArrayLike,
    start: Mapping[str, float],
    bounds: Mapping[str, tuple[float, float]] | None = None,
    sigma: float | None = None,
    loss: str = "linear",
    max_runs: int = 1000,
) -> Fit:
    """Find the parameters with which a function of them, such as a run, fits measured values best: `min sum(((f(p) - measured) / sigma)^2)`.

    The slopes are forward differences, one call for each parameter: a sweep of adjoints for each value would cost more where there are more values
    than parameters. Trial parameters with which the function fails (a `StepFailure`, an `InputError`, values that are missing or not
    finite, as of a run that ended early) have large residuals.

    Parameters
    ----------
    function : callable
        Takes the parameters as keywords, and returns predicted values in the shape of the measured ones, such as places at `output` times of a run.
    measured : array of float
        As many values as parameters, or more.
    start : dict of str to float
        First guess of each parameter.
    bounds : dict of str to (float, float), optional
        Least and largest value; parameters that are not named have none.
    sigma : float, > 0, optional
        Standard deviation of the measured values; by default it follows from the residuals.
    loss : "linear" or "soft_l1"
        "soft_l1" gives values that are far off less weight.
    max_runs : int
        Calls of the function after which the search ends, without those for slopes.

    Returns
    -------
    Fit
        Parameters, covariance, correlation, a plot.

    Raises
    ------
    InputError
        For wrong arguments, and for a function that fails at the start.

    Examples
    --------
    >>> pi.fit(lambda stiffness: tip(stiffness), measured, {"stiffness": 100.0}, bounds={"stiffness": (1.0, 1e4)}).values  # doctest: +SKIP
    """
    from scipy.optimize import least_squares

    if not callable(function):
        raise InputError(f"fit: function = {function!r:.100} must take the parameters and return predicted values")
    target = floats(measured)
    names, first, low, high = _parameters(start, bounds)
    if target is None or target.size < len(names):
        raise InputError(f"fit: measured = {measured!r:.100} must be finite numbers, at least as many as the {len(names)} parameters")
    sigma = None if sigma is None else positive("fit", "sigma", sigma, "the unit of the values")
    one_of("fit", "loss", loss, ("linear", "soft_l1"))
    whole("fit", "max_runs", max_runs)
    _require_taken(function, names)
    scale = np.where(first != 0.0, np.abs(first), np.where(np.isfinite(high - low), high - low, 1.0))
    calls = _Calls(function, names, target, sigma or 1.0, scale, high)
    calls.begin(first)
    options = dict.fromkeys(("ftol", "xtol", "gtol"), PRECISE) | {"loss": loss, "max_nfev": int(max_runs)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        found = least_squares(calls.residuals, first, calls.slopes, bounds=(low, high), x_scale=scale, **options)
    best = calls.residuals(found.x)
    values = dict(zip(names, found.x.tolist()))
    covariance = _covariance(found.jac, scale, best, sigma)
    predicted = target + (best * (sigma or 1.0)).reshape(target.shape)
    return Fit(values, covariance, target, predicted, calls.runs, calls.failed, str(found.message))


def _parameters(start, bounds):
    """(names, first guess, least and largest values) of the arguments of `fit`."""
    if not isinstance(start, Mapping) or not start or not all(isinstance(name, str) and is_number(value) for name, value in start.items()):
        raise InputError(f"fit: start = {start!r:.100} must be a dictionary of the parameters: a finite number for each name")
    limits: dict[str, tuple[float, float]] = dict.fromkeys(start, (-np.inf, np.inf))
    if bounds is not None:
        if not isinstance(bounds, Mapping) or not {*bounds} <= {*start}:
            raise InputError(f"fit: bounds = {bounds!r:.100} must be a dictionary of (least, largest) of parameters: {', '.join(start)}")
        for name, pair in bounds.items():
            two = reals(pair)
            if two is None or two.shape != (2,) or not two[0] < two[1]:
                raise InputError(f"fit: bounds of {name} = {pair!r:.100} must be two numbers, the least value first")
            if not two[0] <= start[name] <= two[1]:
                raise InputError(f"fit: {name} = {start[name]!r:.100} does not start within its bounds, {two[0]:g} to {two[1]:g}")
            limits[name] = two[0], two[1]
    low, high = np.array([*limits.values()], float).T
    return list(start), np.array([float(value) for value in start.values()]), low, high


def _require_taken(function, names):
    """Raise InputError unless the function takes the parameters as keywords."""
    try:
        signature(function).bind(**dict.fromkeys(names, 0.0))
    except TypeError as error:
        raise InputError(f"fit: function does not take the parameters {', '.join(names)} as keywords: {error}") from None
    except ValueError:  # it has no signature
        return


class _Calls:
    """The user's function as residuals over sigma, (N,), and their slopes.

    scale, high (p,): sizes and largest values of the parameters.
    """

    def __init__(self, function, names, target, sigma, scale, high):
        """Begin without calls of the function; see the fields below."""
        self.function = function
        self.names = names
        self.target = target
        self.sigma = sigma
        self.scale = scale
        self.high = high
        self.runs = 0  # calls of the function
        self.failed = 0  # calls that failed
        self.largest = 0.0  # norm of residuals so far
        self.known = b"", np.zeros(0)  # parameters of the last call that did not fail, as bytes, and its residuals

    def begin(self, x):
        """Call the user's function at the first guess x. Raises InputError if it fails or its result has a wrong shape."""
        try:
            values = self._values(x)
        except StepFailure as failure:
            raise InputError(f"fit: the function fails at the start: {failure}") from None
        if values is None:
            raise InputError(f"fit: the function must return finite numbers of the shape {self.target.shape} at the start")
        self.largest = float(np.linalg.norm(values)) or float(np.linalg.norm(self.target) / self.sigma) or 1.0

    def residuals(self, x):
        """The residuals over sigma at parameters x (p,); large ones where the function fails."""
        if self.known[0] == x.tobytes():
            return self.known[1]
        try:
            residuals = self._values(x)
        except (StepFailure, InputError):
            residuals = None
        if residuals is None:
            self.failed += 1
            return np.full(self.target.size, LARGE * self.largest / np.sqrt(self.target.size))
        self.largest = max(self.largest, float(np.linalg.norm(residuals)))
        self.known = x.tobytes(), residuals
        return residuals

    def slopes(self, x):
        """Slopes of the residuals, (N, p), by forward differences, away from an upper bound."""
        here, columns = self.residuals(x), []
        for k in range(len(x)):
            step = STEP * max(abs(x[k]), STEP * self.scale[k])
            moved = x.copy()
            moved[k] += step if x[k] + step <= self.high[k] else -step
            columns.append((self.residuals(moved) - here) / (moved[k] - x[k]))
        return np.stack(columns, axis=1)

    def _values(self, x):
        """The residuals over sigma of one call of the function, or None for values of another shape or not finite."""
        self.runs += 1
        values = floats(self.function(**dict(zip(self.names, x.tolist()))))
        return None if values is None or values.shape != self.target.shape else (values - self.target).ravel() / self.sigma


def _covariance(jacobian, scale, residuals, sigma):
    """Covariance matrix of the parameters, (p, p); warns if the measured values do not determine all of them."""
    _, sizes, rows = np.linalg.svd(jacobian * scale, full_matrices=False)
    if not sizes[-1] > APART * sizes[0]:
        warnings.warn("fit: the measured values do not determine all parameters: see .correlation", stacklevel=4)
    freedoms = max(1, len(residuals) - len(scale))
    square = 1.0 if sigma else float(residuals @ residuals) / freedoms
    weighted = rows.T * scale[:, None] / np.maximum(sizes, APART * (sizes[0] or 1.0))
    return square * (weighted @ weighted.T)
