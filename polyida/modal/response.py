"""Steady response of small motions to an input that swings."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.brief import brief
from polyida.errors import InputError
from polyida.given import floats
from polyida.integrate.state import State
from polyida.keywords import named_keywords
from polyida.linear.lu import SingularSystem
from polyida.modal.coordinates import Coordinates, inputs_of
from polyida.modal.modes import Modes
from polyida.modal.outputs import along, labels_of, outputs_of
from polyida.modal.system import linear_system
from polyida.model import Model


@named_keywords
@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """What `pi.frequency_response` gives: outputs y of an input `u = e^(i omega t)`.

    frequencies: (k,), Hz. values: complex, (k, outputs), y over u. input, outputs: their names.
    """

    frequencies: NDArray
    values: NDArray
    input: str
    outputs: tuple[str, ...]

    __repr__ = brief

    @property
    def amplitude(self) -> NDArray:
        """|y / u|, (k, outputs)."""
        return np.abs(self.values)

    @property
    def phase(self) -> NDArray:
        """By how much y is ahead of u, (k, outputs), rad, from -pi to pi."""
        return np.angle(self.values)

    def plot(self) -> Any:
        """A matplotlib Figure: amplitude and phase of each output against frequency."""
        from polyida.show.small_motions import response

        return response(self.frequencies, self.values, self.input, self.outputs)


@named_keywords
def frequency_response(
    model: Model, state: State | None, input: Any, output: Any, frequencies: ArrayLike, modes: Modes | int | None = None
) -> FrequencyResponse:
    """The FrequencyResponse of a model about a state at rest (None: q = 0 as it is drawn) to one input, at frequencies (k,), Hz:

        [ K + i omega C - omega^2 M   B^T ] [ x  ]   [  force ]
        [ B                            0  ] [ mu ] = [ -row   ]        omega = 2 pi f

    input: the name of a load or motor with a profile, by the value of which the response is counted (1, or 1 rad); a vector (n,) of
    generalised force, or a function of q that gives one. output: as one or several of `pi.linearise`. modes: None for the whole system,
    factored at each frequency; or how many modes, or which, x is made of, beside what a motor moves at once: what the others
    would do, also at rest, is left out.
    Values are infinite where an undamped mode is met exactly. Raises InputError as `pi.linearise`.
    """
    system = linear_system("frequency_response", model, state)
    given = floats(frequencies)
    if given is None or given.ndim > 1 or not given.size:
        raise InputError(f"frequency_response: frequencies = {str(frequencies)[:80]} must be finite numbers in Hz, at least one")
    inputs = inputs_of("frequency_response", system.model, system.state, input if isinstance(input, dict) else [input])
    if len(inputs) != 1:
        raise InputError(f"frequency_response: {len(inputs)} inputs were given; it takes one")
    (pushed,) = inputs
    outputs = outputs_of("frequency_response", system.model, system.state, output)
    solve = _whole(system, pushed) if modes is None else _modal(system, pushed, modes)
    frequencies = np.atleast_1d(given)
    values = [_look(outputs, solve, 2 * np.pi * f) for f in frequencies]
    return FrequencyResponse(frequencies, np.array(values), pushed.label, labels_of(outputs))


def _look(outputs, solve, omega):
    """The outputs at one frequency, (outputs,)."""
    try:
        x, mu = (column[:, None] for column in solve(omega))
    except (SingularSystem, np.linalg.LinAlgError):
        return np.full(len(labels_of(outputs)), np.inf, complex)
    return along(outputs, (x, 1j * omega * x, -(omega**2) * x), mu)[:, 0]


def _whole(system, pushed):
    return lambda omega: system.factor(-(omega**2), 1j * omega).solve(-pushed.force, pushed.row)


def _modal(system, pushed, modes):
    """x = T y + G, y from the equations that T sees; mu from the accelerations."""
    of = Coordinates("frequency_response", system, [pushed], modes)
    T, G = of.T, of.G[:, 0]
    C = 0.0 * system.M if system.C is None else system.C
    K_y, C_y = T.T @ (system.K @ T), T.T @ (C @ T)

    def solve(omega):
        matrix = K_y + 1j * omega * C_y - omega**2 * np.eye(len(K_y))
        x = G + T @ np.linalg.solve(matrix, T.T @ (pushed.force - system.K @ G - 1j * omega * (C @ G)))
        return x, of.accelerations(x, 1j * omega * x, pushed.force, -(omega**2) * pushed.row)[1]

    return solve
