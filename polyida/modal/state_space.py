"""State-space matrices of a model's small motions about a state."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.brief import brief
from polyida.integrate.state import State
from polyida.keywords import named_keywords
from polyida.modal.coordinates import Coordinates, inputs_of
from polyida.modal.modes import Modes
from polyida.modal.outputs import along, labels_of, outputs_of
from polyida.modal.system import linear_system
from polyida.model import Model


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
