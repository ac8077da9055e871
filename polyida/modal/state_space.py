"""Small motions of a model about a state: their state-space matrices, and their steady response to an input that swings."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.errors import InputError
from polyida.integrate.state import State
from polyida.linear.lu import SingularSystem
from polyida.modal.coordinates import Coordinates, along, inputs_of, labels_of, outputs_of
from polyida.modal.modes import Modes
from polyida.modal.system import linear_system
from polyida.model import Model
from polyida.reprs import brief
from polyida.validation import floats, named_keywords


@named_keywords
@dataclass(frozen=True, eq=False)
class StateSpace:
    """`x' = A x + B u`, `y = C x + D u`, all of them changes from a state; what `pi.linearise` gives.

    x = (z, z', value and rate of each motor): z (d,) independent coordinates with unit mass, d their number. inputs, outputs: names of u
    and y. motors: those of the inputs that are motors, whose u is the second derivative of the profile's value (rad/s^2 of an angle): so
    velocities and reactions depend on u alone. shapes: (d + motors, n), how q moves with z and with the motors' values.
    """

    A: NDArray
    B: NDArray
    C: NDArray
    D: NDArray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    motors: tuple[str, ...]
    shapes: NDArray

    __repr__ = brief

    def to_scipy(self) -> Any:
        """The same as a `scipy.signal.StateSpace`."""
        from scipy.signal import StateSpace as Scipy

        return Scipy(self.A, self.B, self.C, self.D)

    def response(self, frequencies: ArrayLike) -> NDArray:
        """`C (i omega - A)^-1 B + D` at frequencies (k,), Hz: complex, (k, outputs, inputs)."""
        one = np.eye(len(self.A))
        return np.array([self.C @ np.linalg.solve(2j * np.pi * f * one - self.A, self.B) + self.D for f in np.atleast_1d(frequencies)])

    def displacements(self, x: ArrayLike) -> NDArray:
        """Changes of q (..., n) in states x (..., states)."""
        x, d = np.asarray(x), (len(self.A) - 2 * len(self.motors)) // 2
        return np.concatenate([x[..., :d], x[..., 2 * d : 2 * d + len(self.motors)]], axis=-1) @ self.shapes


@named_keywords
def linearise(
    model: Model, state: State | None = None, inputs: Any = None, outputs: Any = None, modes: Modes | int | None = None
) -> StateSpace:
    """The StateSpace of a model's small motions about a state at rest: one of `pi.static`, or q = 0 as it is drawn where it is None.

    inputs: names of loads and motors with a profile (all of them where it is None), vectors (n,) of generalised force, functions of q that
    give these: one, a list, or {name: input}. A load's u is its profile's value; a motor's is the second derivative of that, its value and
    rate are states. outputs: names (or attachments) for their places, (name, kind) with kind "position", "velocity", "acceleration" or
    "reaction" (of a joint), vectors w (n,) for `w^T q`: one, a list, or {name: output}; by default the places of all masses and
    loads, or all of q.
    modes: how many modes, or which, are the coordinates; by default all n - m, an orthonormal basis of what the constraints allow: A's
    eigenvalues are the roots of `pi.modes(..., damped=True)`, and two zeros a motor.
    Raises InputError for an input or output that there is not, naming those that there are, and as `pi.modes`.

        system = pi.linearise(model, pi.static(model), inputs="wind", outputs=["tip", ("tip", "velocity")])
        t, y, _ = scipy.signal.lsim(system.to_scipy(), u, t)
    """
    system = linear_system("linearise", model, state)
    given = inputs_of("linearise", system.model, system.state, inputs)
    looked_at = outputs_of("linearise", system.model, system.state, outputs)
    coordinates = Coordinates("linearise", system, given, modes)
    motors = [k for k, one in enumerate(given) if one.drives]
    A, B, C, D = _matrices(coordinates, motors, looked_at)
    shapes = np.concatenate([coordinates.T, coordinates.G[:, motors]], axis=1).T
    names = tuple(one.label for one in given)
    return StateSpace(A, B, C, D, names, labels_of(looked_at), tuple(names[k] for k in motors), shapes)


def _matrices(of, motors, outputs):
    """A, B, C and D: what each column of states and inputs by one does to x, x', x'' and the multipliers.

        z  z'  value  rate  u                 z  z'  value  rate  u
    x   T  0   G      0     0        force    0  0   f      0     f of loads
    x'  0  T   0      G     0        rows     0  0   0      0     rows
    """
    T, G, f = of.T, of.G[:, motors], of.forces[:, motors]
    (n, d), p, k = T.shape, len(motors), of.forces.shape[1]
    loads, none = of.forces.copy(), lambda columns: np.zeros((n, columns))
    loads[:, motors] = 0.0
    x = np.hstack([T, none(d), G, none(p), none(k)])
    v = np.hstack([none(d), T, none(p), G, none(k)])
    force = np.hstack([none(2 * d), f, none(p), loads])
    rows = np.hstack([np.zeros((len(of.rows), 2 * (d + p))), of.rows])
    a, mu = of.accelerations(x, v, force, rows)
    rates = np.zeros((2 * (d + p), x.shape[1]))
    rates[:d, d : 2 * d] = np.eye(d)
    rates[d : 2 * d] = of.reduced(a)
    a = T @ rates[d : 2 * d] + np.hstack([none(2 * (d + p)), of.G])
    rates[2 * d : 2 * d + p, 2 * d + p : 2 * (d + p)] = np.eye(p)
    rates[2 * d + p + np.arange(p), 2 * (d + p) + np.array(motors, int)] = 1.0
    looks = along(outputs, (x, v, a), mu)
    split = 2 * (d + p)
    return rates[:, :split], rates[:, split:], looks[:, :split], looks[:, split:]


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
    whole = lambda omega: system.factor(-(omega**2), 1j * omega).solve(-pushed.force, pushed.row)  # noqa: E731
    solve = whole if modes is None else _modal(system, pushed, modes)
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
