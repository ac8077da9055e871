"""Problem: an objective and limits of one or several load cases as functions of the variables, with slopes."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polyida.adjoint.gradient import gradient
from polyida.assembly.scene_model import SceneModel
from polyida.design.variables import BuiltSize, BuiltSizeMap, Densities, Sharpness, Size, SizeMap
from polyida.errors import InputError, StepFailure
from polyida.model import Model
from polyida.objective.objective import Limit, Objective, require_objective
from polyida.validation import instance, listed, named_keywords, vector


class FailedRun(Exception):
    """The run of a design failed; the text says why."""


@named_keywords
@dataclass(frozen=True, eq=False)
class Case:
    """A load case: a model and its run.

    Parameters
    ----------
    model : Model, or function f(**sizes) -> Model
        Of a scene or of the user. A function gets every Size that its signature names.
    run : function f(model) -> Trajectory, Equilibrium or Modes
        Such as `lambda model: pi.solve(model, 0.5, pi.GeneralizedAlpha(h=2.5e-3))`. To evaluate cases in other processes, both functions
        must be those of a module.
    name : str

    Raises
    ------
    InputError
        For anything else.
    """

    model: Any
    run: Callable[[Any], Any]
    name: str = "run"

    def __post_init__(self):
        """Check that the run is a function and the model a model or a function."""
        if not callable(self.run):
            raise InputError(f"Case {self.name!r}: run = {self.run!r:.80} must be a function of a model that gives its run")
        if not (isinstance(self.model, (Model, SceneModel)) or callable(self.model)):
            raise InputError(f"Case {self.name!r}: model = {self.model!r:.80} must be a model, or a function of sizes that builds one")

    @property
    def arguments(self) -> tuple[str, ...]:
        """Names of the arguments of the function that builds the model."""
        return tuple(inspect.signature(self.model).parameters) if callable(self.model) else ()

    def built(self, sizes: dict[str, float]) -> Any:
        """Return the model with these sizes, those of other cases left out."""
        if not callable(self.model):
            return self.model
        return self.model(**{name: value for name, value in sizes.items() if name in self.arguments})

    def ran(self, model: Any) -> Any:
        """Return the run of a model. Raises FailedRun."""
        try:
            run = self.run(model)
        except StepFailure as error:
            raise FailedRun(f"{self.name}: {error}") from error
        if not getattr(run, "success", True):
            raise FailedRun(f"{self.name}: {run.message}")
        return run


@named_keywords
@dataclass(frozen=True, eq=False)
class Evaluation:
    """Values and slopes of a design.

    Parameters
    ----------
    values : (1 + limits,) float
        Of the objective and of the limits' objectives; NaN if a run failed.
    slopes : (1 + limits, variables) float
    largest : (1 + limits,) float
        The maxima that they stand for, the values where they stand for none.
    error : str
        Why a run failed, or empty.
    """

    values: NDArray
    slopes: NDArray
    largest: NDArray
    error: str = ""


@dataclass(frozen=True, eq=False)
class Setting:
    """What a case's evaluation needs: maps of the variables, their x (parts), and the Sharpness."""

    maps: tuple
    parts: tuple
    sharp: Sharpness

    def sizes(self):
        """{name of an argument of the function that builds the model: value}, of the variables that are sizes."""
        return {one.name: one.value(x, self.sharp) for one, x in zip(self.maps, self.parts) if isinstance(one, BuiltSizeMap)}

    def model(self, case, **changed):
        """A new model of a load case with the densities and sizes of this setting; changed: values of arguments in place of these sizes."""
        model = case.built(self.sizes() | changed)
        for one, x in zip(self.maps, self.parts):
            model = one.applied(model, x, self.sharp)
        return model


def evaluated(case: Case, setting: Setting, objectives: list[Objective]) -> tuple[list[float], list[NDArray], list[float]]:
    """(values, slopes (variables,), maxima) of objectives in a case. Raises FailedRun."""
    model = setting.model(case)
    run = case.ran(model)
    wanted, sizes = [], setting.sizes()
    for one in setting.maps:
        wanted += one.parameters(model)
        if one.name in case.arguments:
            scale = one.variable.upper - one.variable.lower
            wanted.append(BuiltSize(one.name, sizes[one.name], model, partial(_built, setting, case, one.name), scale))
    gradients = gradient(run, objectives, parameters=wanted)
    slopes = [np.concatenate([_slopes(one, found, x, setting) for one, x in zip(setting.maps, setting.parts)]) for found in gradients]
    largest = [one.largest(run) for one in objectives]
    values = [found.value for found in gradients]
    return values, slopes, [value if most is None else most for value, most in zip(values, largest)]


def _built(setting, case, name, value):
    """The model of a case with another value of an argument."""
    return setting.model(case, **{name: value})


def _slopes(one, found, x, setting):
    """dJ/dx of a map of variables; 0 if the case does not have its parameter."""
    known = one.name in found or any(name in found for name in one.parameters(None))
    return one.slopes(found, x, setting.sharp) if known else np.zeros(one.size)


@named_keywords
class Problem:
    """An objective and limits as functions of the variables, with slopes, for any optimiser.

    The objective of several cases is the mean over them; a limit holds in each case, or in the one that it names.

    Parameters
    ----------
    objective : Objective
    limits : sequence of Limit
    variables : sequence of Densities or Size
    cases : Case or sequence of Case
    executor : concurrent.futures.Executor, optional
        Where the cases are evaluated: a ProcessPoolExecutor, or `client.get_executor()` of Dask. None: here, one after the other.

    Raises
    ------
    InputError
        For anything else, and for names that occur twice.

    Examples
    --------
    >>> problem = pi.design.Problem(pi.objective.Mass(), [limit], [pi.design.Size("arm.thickness", 2e-3, 2e-2)], case)
    >>> found = problem.evaluate(problem.start)
    >>> found.values, found.slopes
    """

    def __init__(
        self,
        objective: Objective,
        limits: Sequence[Limit],
        variables: Sequence[Densities | Size],
        cases: Case | Sequence[Case],
        executor: Executor | None = None,
    ) -> None:
        """Check the arguments and map the variables to parameters of the models."""
        if executor is not None and not hasattr(executor, "submit"):
            raise InputError(f"design: executor = {executor!r:.100} must be a concurrent.futures.Executor, or None")
        self.executor = executor
        self.objective = require_objective("design", objective)
        self.limits = _listed("limits", limits, Limit, "pi.objective.Limit(objective, upper)")
        self.variables = _listed("variables", variables, (Densities, Size), "pi.design.Densities or pi.design.Size")
        self.cases = _listed("cases", [cases] if isinstance(cases, Case) else cases, Case, "pi.design.Case(model, run)")
        if not self.variables or not self.cases:
            raise InputError("design: variables and cases must have at least one entry")
        for what, names in (("variables", [one.name for one in self.variables]), ("cases", [one.name for one in self.cases])):
            if twice := {name for name in names if names.count(name) > 1}:
                raise InputError(f"design: {what} has {min(twice)!r} twice; give each a name of its own")
        known = {name for case in self.cases for name in case.arguments}
        sizes = {one.name: one.value(one.first) for one in self.variables if isinstance(one, Size) and one.name in known}
        model = self.cases[0].built(sizes)
        self.maps = tuple(
            one.bound(model) if isinstance(one, Densities) else BuiltSizeMap(one) if one.name in known else SizeMap(one, model)
            for one in self.variables
        )
        self.splits = np.cumsum([one.size for one in self.maps])[:-1]
        self.start = np.concatenate([one.start for one in self.maps])
        self.held = [(limit, case) for limit in self.limits for case in self.cases if limit.case in (None, case.name)]
        for limit in self.limits:
            if limit.case is not None and limit.case not in (case.name for case in self.cases):
                raise InputError(f"Limit: no case is called {limit.case!r}; known: {', '.join(repr(case.name) for case in self.cases)}")
        self.labels = self._labels()

    def _labels(self):
        """A name for each limit in each case that it holds in; equal ones get a number."""
        several, result = len(self.cases) > 1, []
        for limit, case in self.held:
            label = label_of(limit.objective) + (f", {case.name}" if several else "")
            result.append(label if label not in result else f"{label} {len(result) + 1}")
        return result

    def setting(self, x: NDArray, sharp: Sharpness = Sharpness()) -> Setting:  # noqa: B008, an immutable default
        """Return the Setting of an evaluation at x: the maps, their parts of x, and the Sharpness."""
        x = vector("Problem", "x", x, sum(one.size for one in self.maps))
        return Setting(self.maps, tuple(np.split(x, self.splits)), instance("Problem", "sharp", sharp, Sharpness))

    def values(self, x: NDArray, sharp: Sharpness = Sharpness()) -> dict[str, Any]:  # noqa: B008
        """Return {variable: its densities or number}.

        Parameters
        ----------
        x : (variables,) float, 0 to 1
        sharp : Sharpness
            (q of RAMP, beta of the projection or None).

        Returns
        -------
        dict of str to float or (cells,) float
        """
        setting = self.setting(x, sharp)
        return {one.name: one.value(part, setting.sharp) for one, part in zip(self.maps, setting.parts)}

    def evaluate(self, x: NDArray, sharp: Sharpness = Sharpness()) -> Evaluation:  # noqa: B008
        """Return values and slopes of the objective and of the objectives of all limits.

        Parameters
        ----------
        x : (variables,) float, 0 to 1
        sharp : Sharpness
            (q of RAMP, beta of the projection or None).

        Returns
        -------
        Evaluation
            values (1 + limits,), slopes (1 + limits, variables), largest (1 + limits,), error.
        """
        setting, found = self.setting(x, sharp), []
        asked = [[self.objective, *(limit.objective for limit, of in self.held if of is case)] for case in self.cases]
        try:
            if self.executor is None:
                found = [evaluated(case, setting, each) for case, each in zip(self.cases, asked)]
            else:
                futures = [self.executor.submit(evaluated, case, setting, each) for case, each in zip(self.cases, asked)]
                found = [future.result() for future in futures]
        except FailedRun as error:
            lost = np.full(1 + len(self.held), np.nan)
            return Evaluation(lost, np.zeros((len(lost), len(x))), lost, str(error))
        first: list[Any] = [sum(result[k][0] for result in found) / len(found) for k in range(3)]  # type: ignore[misc]
        rest = [iter(zip(*(result[k][1:] for k in range(3)))) for result in found]
        held = [next(rest[self.cases.index(case)]) for _, case in self.held]
        values, slopes, largest = (np.array([one, *(entry[k] for entry in held)]) for k, one in enumerate(first))
        return Evaluation(values, slopes, largest)


def label_of(objective):
    """A short text for an objective: its class, and the part that it names."""
    part = next((getattr(objective, key) for key in ("joint", "plate", "point", "part") if getattr(objective, key, None) is not None), None)
    name = part if isinstance(part, str) else getattr(part, "name", None)
    return type(objective).__name__ + (f" {name}" if name else "")


def _listed(what, values, kind, advice):
    """The values as a list of this kind. Raises InputError for anything else."""
    entries = listed("design", what, values)
    if not all(isinstance(one, kind) for one in entries):
        raise InputError(f"design: {what} = {values!r:.100} must be a list of {advice}")
    return entries
