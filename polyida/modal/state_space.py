"""State-space matrices of small motions of a model about a state, and the steady response to a harmonic input.

Small motions are written as `x = T y + G u`. Columns of T are normal (`B T = 0`, `T^T M T = 1`). G is the immediate motion by inputs that
move constraints, `B G = -rows`, normal to T in M, so that their accelerations move no y: `y'' = T^T M x''`. Outputs are places,
velocities, accelerations and reactions by name, or combinations of coordinates.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.errors import InputError
from polyida.integrate.directions import direction, known_inputs
from polyida.integrate.state import State
from polyida.joint.attachment import Attachment
from polyida.linear.lu import SingularSystem
from polyida.linear.saddle import KKT
from polyida.modal import eigen
from polyida.modal.eigen import NO_MASS, linear_system
from polyida.modal.modes import Modes, normalised
from polyida.model import Model, differences
from polyida.reprs import brief
from polyida.results.motion import reaction_of
from polyida.validation import floats, is_one_of, is_whole, named_keywords

OFF = 1e-6  # of |B| |x|: modes that leave the constraints by more are none of this state
MOST = 2000  # coordinates that are taken without modes


def inputs_of(part, model, state, given):
    """A list of Direction with labels, of what a user gives: None (all profiles), one, a list or a dictionary {label: one}.

    Raises InputError in the name of `part`.
    """
    if given is None:
        given = [name for name in known_inputs(model) if name]
    if not isinstance(given, (list, dict)):
        given = [given]
    named = given.items() if isinstance(given, dict) else ((None, one) for one in given)
    found = [(label, direction(part, model, state, one)) for label, one in named]
    return [replace(one, label=str(label or one.label or f"input {k}")) for k, (label, one) in enumerate(found)]


class Coordinates:
    """T (n, d) and, of inputs, forces (n, k), rows (m, k) and G (n, k). modes: None for all coordinates, a number of modes, or Modes."""

    def __init__(self, part, system, inputs, modes=None):
        self.system, n, m = system, system.n, system.model.m
        try:
            self.mass = KKT(system.M, system.B, 1.0)
        except SingularSystem:
            raise InputError(NO_MASS) from None
        self.T = _basis(part, system, modes)
        self.forces = np.array([one.force for one in inputs]).reshape(len(inputs), n).T
        self.rows = np.array([one.row for one in inputs]).reshape(len(inputs), m).T
        self.G = self.mass.solve(np.zeros_like(self.forces), self.rows)[0]

    def accelerations(self, x, v, forces, rows):
        """(x'', mu) for columns x, v (n, k) under forces (n, k) and with the accelerations of the rows (m, k)."""
        r = self.system.K @ x - forces
        if self.system.C is not None:
            r = r + self.system.C @ v
        if not np.iscomplexobj(r):
            return self.mass.solve(r, rows)
        parts = [self.mass.solve(part(r), part(rows)) for part in (np.real, np.imag)]
        return tuple(real + 1j * imaginary for real, imaginary in zip(*parts))

    def reduced(self, a):
        """y'' of columns a (n, k)."""
        return self.T.T @ (self.system.M @ a)


def _basis(part, system, modes):
    if modes is None:
        if system.freedoms > MOST:
            raise InputError(f"{part}: modes = None takes all {system.freedoms} coordinates, {MOST} at most; give a number of modes")
        return system.basis
    if isinstance(modes, Modes):
        X = modes.shapes.T
        if len(X) != system.n:
            raise InputError(f"{part}: the modes are of another model, with {len(X)} coordinates; this one has {system.n}")
        if np.iscomplexobj(X):
            raise InputError(f"{part}: modes with damping are complex; give those without, pi.modes(model, state)")
        if np.abs(system.B @ X).max(initial=0.0) > OFF * abs(system.B).max(initial=0.0) * np.abs(X).max():
            raise InputError(f"{part}: the modes are about another state, they leave the constraints of this one")
        return X
    if not is_whole(modes, 1, system.freedoms):
        raise InputError(f"{part}: modes = {str(modes)[:80]} must be None, Modes or a whole number from 1 to {system.freedoms}")
    if not system.conservative:
        raise InputError(f"{part}: K is not symmetric, a force has no potential: it has no undamped modes; leave modes out")
    return normalised(system.M, eigen.undamped(system, modes)[1])


KINDS = ("position", "velocity", "acceleration", "reaction")
MOTION = {"position": 0, "velocity": 1, "acceleration": 2}


@dataclass(frozen=True, eq=False)
class Output:
    """labels: of its components. along(moved, mu): their changes, (components, k), where q, v and a change by the three of `moved`,
    (n, k) each, and lam by mu (m, k)."""

    labels: tuple[str, ...]
    along: Callable[[tuple[NDArray, NDArray, NDArray], NDArray], NDArray]


def outputs_of(part, model, state, given):
    """A list of Output of what a user gives: None, one, a list or a dictionary {label: one}. Raises InputError, in the name of `part`."""
    if given is None:
        given = default(model)
    if isinstance(given, (dict, list)) and not given:
        raise InputError(f"{part}: output {given!r} names nothing to look at; leave it out for masses, loads or all coordinates")
    if isinstance(given, dict):
        return [_output(part, model, state, one, str(label)) for label, one in given.items()]
    given = given if isinstance(given, list) else [given]
    return [_output(part, model, state, one, None) for one in given]


def default(model):
    """The places of all masses and loads; without any, all of q."""
    names = [name for name, thing in model.parts.items() if isinstance(getattr(thing, "at", None), Attachment)]
    return names or {f"q[{k}]": row for k, row in enumerate(np.eye(model.n))}


def labels_of(outputs):
    """Labels of all components."""
    return tuple(label for output in outputs for label in output.labels)


def along(outputs, moved, mu):
    """Changes of all components, (components, k), real or complex."""
    if any(map(np.iscomplexobj, (*moved, mu))):
        real, imaginary = (along(outputs, tuple(map(take, moved)), take(mu)) for take in (np.real, np.imag))
        return real + 1j * imaginary
    return np.concatenate([np.zeros((0, mu.shape[1])), *(output.along(moved, mu) for output in outputs)])


def _output(part, model, state, given, label):
    vector = None if isinstance(given, (str, Attachment)) else floats(given)
    if vector is not None and vector.shape == (model.n,):
        return Output((label or "output",), lambda moved, mu: vector[None] @ moved[0])
    what, kind = given if isinstance(given, tuple) and len(given) == 2 else (given, "position")
    if not is_one_of(kind, KINDS) or not isinstance(what, (str, Attachment)):
        wanted = f"a name, (name, one of {', '.join(KINDS)}), or {model.n} finite numbers"
        raise InputError(f"{part}: output {str(given)[:80]} must be {wanted}")
    return _reaction(part, model, state, what, label) if kind == "reaction" else _place(model, state, what, kind, label)


def _place(model, state, what, kind, label):
    model.position(what, state.q[None])
    name = label or (f"{what} {kind}" if kind != "position" else f"{what}")

    def change(moved, mu):
        X = moved[MOTION[kind]]
        return _slope(lambda s: model.position(what, state.q + s * X.T).T, X)

    return Output((f"{name} x", f"{name} y"), change)


def _reaction(part, model, state, name, label):
    if not is_one_of(name, model.joints):
        raise InputError(f"{part}: no joint is called {name!r}; known: {', '.join(map(repr, model.joints)) or 'none'}")

    def reactions(q, lam):
        return reaction_of(model, name, np.full(len(q), state.t), q, lam).T

    def change(moved, mu):
        return _slope(lambda s: reactions(state.q + s * moved[0].T, state.lam + s * mu.T), moved[0])

    count = len(reactions(state.q[None], state.lam[None]))
    return Output(tuple(f"{label or name + ' reaction'} {k}" for k in range(count)), change)


def _slope(function, X):
    """Derivative along columns X (n, k), in which q moves by about 1e-3 of a metre at most."""
    return differences.along(function, 1.0 / (float(np.abs(X).max(initial=0.0)) or 1.0))


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
