"""An objective of a user's own."""

from collections.abc import Callable, Mapping
from dataclasses import is_dataclass, replace
from typing import Any

import numpy as np

from polyida.errors import InputError
from polyida.given import floats, is_number
from polyida.keywords import named_keywords
from polyida.objective.objective import Objective, asked, run_of
from polyida.objective.slopes import FRAMES, Slopes


@named_keywords
class Own(Objective):
    """A function of a run with its slopes, both written by the user.

    value(run) -> J. slopes(run) -> {"q": dJ/dq (frames, n), "v", "a": alike, "lam": (frames, m), "t": (frames,)} in all frames; what is not
    there is zero. Where J depends on a parameter by itself, its slope at the same frames stands there too, by the parameter's name:
    "arm.mass"; without any such name, slopes of that kind in parameters that `pi.gradient` is asked for by name (`body.inertia`) are
    differences of value(run). Frame 0's v is that before the integrator's start and has no slope. Raises InputError where they are no
    functions, and of a run for other names and shapes, and numbers that are not finite.
    """

    def __init__(self, value: Callable[[Any], float], slopes: Callable[[Any], Mapping[str, Any]]) -> None:
        for name, given in (("value", value), ("slopes", slopes)):
            if not callable(given):
                raise InputError(f"Own: {name} = {given!r:.100} must be a function of a run")
        self._value, self._slopes = value, slopes

    def __call__(self, run: Any) -> float:
        found = _asked("value", self._value, run_of("Own", run))
        if not is_number(found):
            raise InputError(f"Own: value(run) must return a finite number, not {found!r:.100}")
        return float(found)

    def slopes(self, run: Any) -> Callable[[slice], Slopes]:
        """What the user's function gives, looked at."""
        run = run_of("Own", run)
        given = _asked("slopes", self._slopes, run)
        if not isinstance(given, Mapping):
            raise InputError(f"Own: slopes(run) must return a dictionary, not {given!r:.100}")
        frames = {name: _checked(name, value, np.shape(getattr(run, name))) for name, value in given.items() if name in FRAMES}
        direct = {name: _checked(name, value) for name, value in given.items() if name not in FRAMES}

        def of(part):
            whole = part.indices(len(run.t))[1] == len(run.t)
            of_model = elsewhere if whole and not direct else None
            return Slopes(**{name: value[part] for name, value in frames.items()}, direct=direct if whole else {}, of_model=of_model)

        def elsewhere(model):
            try:
                return self(replace(run, model=model) if is_dataclass(run) else run._replace(model=model))
            except InputError as error:
                raise InputError(
                    f"Own: value(run) fails for the same frames of a model with another number: {error}; use names of parts"
                ) from None

        return of


def _asked(name, function, run):
    return asked(f"Own: {name}(run), the function {getattr(function, '__name__', type(function).__name__)},", function, run)


def _checked(name, value, shape=None):
    """The slope in what is called so, as floats, of a shape, or of any where the name is a parameter's."""
    if not isinstance(name, str) or (shape is None and "." not in name):
        raise InputError(f"Own: slopes(run) has {name!r:.100}; known: {', '.join(map(repr, FRAMES))}, and parameters, as 'arm.mass'")
    found = floats(value)
    if found is None or (shape is not None and found.shape != shape):
        wanted = "finite numbers" if shape is None else f"finite numbers of shape {shape}"
        raise InputError(f"Own: slopes(run)[{name!r}], {value!r:.100}, must be {wanted}")
    return found
