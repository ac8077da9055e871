"""Variables of a design: densities of the cells of a plate, and sizes. The optimiser sees numbers from 0 to 1."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polyida.adjoint.parameter import Parameter, total
from polyida.adjoint.parameters import parameters_of
from polyida.assembly.motion import moves_at
from polyida.design.densities import cells_along, mass, project, ramp
from polyida.errors import InputError
from polyida.mesh import density_filter
from polyida.model.differences import along
from polyida.validation import floats, is_flag, is_number, listed, named_keywords, number, settle


@named_keywords
@dataclass(frozen=True)
class Sharpness:
    """How sharply densities become stiffness.

    Parameters
    ----------
    q : float
        Of RAMP.
    beta : float or None
        Of the projection; None for none.
    """

    q: float = 20.0
    beta: float | None = None


@named_keywords
@dataclass(frozen=True, eq=False)
class Densities:
    """Densities of the cells of a full plate: `rho = project(filter @ x)`, and 1 along the sections of joints.

    The stiffness of a cell follows RAMP, its mass is in proportion, both with `void` left at rho = 0.

    Parameters
    ----------
    plate : str
        Name of a plate.
    radius : float, m
        Of the hat filter: about the least width of a member.
    keep : str or iterable of str
        Sections of the mesh whose cells stay solid.
    start : float or (cells,) float, 0 to 1
        Of the variables.
    void : float in (0, 1)

    Raises
    ------
    InputError
        For wrong numbers, and of a problem for an unknown plate or section.
    """

    plate: str
    radius: float
    keep: Iterable[str] = ()
    start: float | NDArray = 0.5
    void: float = 1e-3

    def __post_init__(self):
        """Check the name and the ranges of all numbers."""
        start = floats(self.start)
        if start is None or start.ndim > 1 or not ((start >= 0) & (start <= 1)).all():
            raise InputError(f"Densities of {self.plate!r}: start = {self.start!r:.80} must be a number from 0 to 1, or one for each cell")
        keep = [self.keep] if isinstance(self.keep, str) else listed(f"Densities of {self.plate!r}", "keep", self.keep)
        settle(self, start=start, keep=tuple(keep))
        ramp(0.5, void=self.void)

    @property
    def name(self) -> str:
        """The name of the variable, which is that of its plate."""
        return self.plate

    def bound(self, model: Any) -> DensityMap:
        """Return the map from the variables of this plate of a model to its factors."""
        bodies = model.bodies if getattr(model, "is_scene", False) else ()
        known = {body.name: body for body in bodies}
        if self.plate not in known:
            raise InputError(f"Densities: no full plate is called {self.plate!r:.80}; known: {', '.join(map(repr, known)) or 'none'}")
        mesh, shape = known[self.plate].mesh, np.shape(self.start)
        if shape not in ((), (mesh.n_cells,)):
            raise InputError(f"Densities of {self.plate!r}: start has shape {shape}, the plate has {mesh.n_cells} cells")
        return DensityMap(self, mesh)


class DensityMap:
    """Maps variables (cells,) of a plate on a mesh to factors of its cells, and slopes back."""

    unit = "of the cells"

    def __init__(self, variable, mesh):
        """Find the cells that are free and the filter between them."""
        self.variable, self.mesh = variable, mesh
        self.name = variable.plate
        self.size = mesh.n_cells
        self.blur = density_filter(mesh, variable.radius)
        self.free = np.ones(mesh.n_cells, bool)
        for cells in cells_along(f"Densities of {self.name!r}", mesh, variable.keep).values():
            self.free[cells] = False
        self.start = np.broadcast_to(variable.start, self.size)

    def value(self, x, sharp):
        """Densities rho of the cells, (cells,), of the variables x at a Sharpness."""
        return self._densities(x, sharp)[0]

    def _densities(self, x, sharp):
        """(rho, its derivative in the filtered densities) of the cells."""
        blurred = np.clip(self.blur @ x, 0.0, 1.0)
        rho, rate = (blurred, 1.0) if sharp.beta is None else project(blurred, sharp.beta)
        return np.where(self.free, rho, 1.0), np.where(self.free, rate, 0.0)

    def parameters(self, model):
        """Names of the parameters of a model that it sets."""
        return [f"{self.name}.stiffness", f"{self.name}.mass"]

    def applied(self, model, x, sharp):
        """The model with these densities."""
        rho, void = self.value(x, sharp), self.variable.void
        return model.with_factors(**{self.name: (ramp(rho, sharp.q, void)[0], mass(rho, void=void)[0])})

    def slopes(self, gradient, x, sharp):
        """dJ/dx (cells,), from a Gradient."""
        (rho, rate), void = self._densities(x, sharp), self.variable.void
        by_rho = gradient[f"{self.name}.stiffness"] * ramp(rho, sharp.q, void)[1] + gradient[f"{self.name}.mass"] * mass(rho, void=void)[1]
        return self.blur.T @ (rate * by_rho)


@named_keywords
@dataclass(frozen=True, eq=False)
class Size:
    """A number of the model between two bounds: a parameter, or an argument of the function that builds the model.

    Parameters such as "arm.thickness", "spring.stiffness" or "pid.kp" have the slopes of `pi.gradient`. What has no parameter, such as a
    length, the place of a joint or a height of an outline, is an argument of `Case(build)`, which moves the nodes of one mesh
    (`pi.mesh.moved`); its slopes come from the multipliers of the sweep and differences of the built models, exact to about 1e-9.

    Parameters
    ----------
    name : str
    lower, upper : float
    start : float, optional
        By default the middle, of the logarithm if `log`.
    log : bool
        True: the optimiser sees the logarithm, for numbers whose order of magnitude is searched.

    Raises
    ------
    InputError
        For wrong bounds, a start outside of them, and of a problem for an unknown name.
    """

    name: str
    lower: float
    upper: float
    start: float | None = None
    log: bool = False

    def __post_init__(self):
        """Check the name, the bounds and the start."""
        label = f"Size {self.name!r}"
        if not isinstance(self.name, str):
            raise InputError(f"Size: name = {self.name!r:.80} must be a text, such as 'arm.thickness'")
        if not (is_number(self.lower) and is_number(self.upper) and self.lower < self.upper):
            raise InputError(f"{label}: lower = {self.lower!r:.40} must be less than upper = {self.upper!r:.40}")
        if not is_flag(self.log) or (self.log and not self.lower > 0):
            raise InputError(f"{label}: log = {self.log!r:.40} must be True or False, and True only with lower > 0")
        if not (self.start is None or (is_number(self.start) and self.lower <= self.start <= self.upper)):
            raise InputError(f"{label}: start = {self.start!r:.40} must be a number from {self.lower:g} to {self.upper:g}, or None")

    def value(self, x: float) -> float:
        """Return the number at x, 0 to 1."""
        x = number(f"Size {self.name!r}", "x", x, "its range")
        return float(self.lower * (self.upper / self.lower) ** x if self.log else self.lower + x * (self.upper - self.lower))

    def rate(self, x: float) -> float:
        """Return the derivative of the number in x."""
        return self.value(x) * float(np.log(self.upper / self.lower)) if self.log else self.upper - self.lower

    @property
    def first(self) -> float:
        """The x, from 0 to 1, of the start; 0.5 without a start."""
        if self.start is None:
            return 0.5
        ends = np.array([self.lower, self.start, self.upper], float)
        low, at, high = np.log(ends) if self.log else ends
        return float((at - low) / (high - low))


class SizeMap:
    """Maps a variable (1,) to a parameter of a model, and slopes back."""

    unit = ""

    def __init__(self, variable, model):
        """Find the parameter of the model. Raises InputError for an unknown name."""
        known = parameters_of(model)
        if variable.name not in known or np.ndim(known[variable.name].value):
            numbers = ", ".join(repr(name) for name, one in known.items() if not np.ndim(one.value))
            raise InputError(
                f"Size {variable.name!r}: neither an argument of the case's function nor a number of the model; known: {numbers or 'none'}"
            )
        self.variable = variable
        self.name = variable.name
        self.size = 1
        self.start = np.array([variable.first])

    def value(self, x, sharp):
        """The number that the variable x (1,) stands for."""
        return self.variable.value(x[0])

    def parameters(self, model):
        """Names of the parameters of a model that it sets."""
        return [self.name]

    def applied(self, model, x, sharp):
        """The model with this number."""
        return parameters_of(model)[self.name].replaced(self.value(x, sharp))

    def slopes(self, gradient, x, sharp):
        """dJ/dx (1,), from a Gradient."""
        return np.array([gradient[self.name] * self.variable.rate(x[0])])


class BuiltSizeMap(SizeMap):
    """Maps a variable (1,) to an argument of the function that builds the model, and slopes back; `Problem` gives the parameter."""

    def __init__(self, variable):
        """Map the variable to the argument of its name."""
        self.variable = variable
        self.name = variable.name
        self.size = 1
        self.start = np.array([variable.first])

    def parameters(self, model):
        """An empty list, because `Problem` adds the parameter itself."""
        return []

    def applied(self, model, x, sharp):
        """The model, which was built with it."""
        return model


@dataclass(frozen=True, eq=False)
class BuiltSize(Parameter):
    """An argument of a function that builds the model. build: function of its value -> model; scale: over which the model varies."""

    build: Callable[[float], Any]
    scale: float
    changes_coordinates = True

    @cached_property
    def _models(self):
        """{change of the argument: model built with it}; each model is kept."""
        return {}

    def _model(self, s):
        """The model with the argument changed by s, built once. Raises InputError if it has other coordinates."""
        if s not in self._models:
            self._models[s] = other = self.replaced(self.value + s)
            if (other.n, other.m) != (self.model.n, self.model.m):
                raise InputError(
                    f"Size {self.name!r}: the model has {self.model.n} coordinates, with a slightly different value {other.n}; "
                    "move the nodes of one mesh, as with pi.mesh.moved"
                )
        return self._models[s]

    def slope(self, work):
        """The slope of the sum over AdjointMultipliers, by differences of fourth order between built models."""
        return float(along(lambda s: total(self._model(s), work), self.scale))

    def of_model(self, function):
        """The slope of a function of the model, by differences."""
        return float(along(lambda s: function(self._model(s)), self.scale))

    def start(self, t, q, adjoint):
        """Differences of the initial velocities, if the scene starts in motion."""
        if self.model.is_scene and not moves_at(self.model, t, q):
            return None
        return float(along(lambda s: adjoint @ self._model(s).initial_velocity(t, q), self.scale))

    def replaced(self, value):
        """The model of another value."""
        return self.build(value)
