"""State-space matrices of small motions of a model about a state, and the steady response to a harmonic input.

Small motions are written as `x = T y + G u`. Columns of T are normal (`B T = 0`, `T^T M T = 1`). G is the immediate motion by inputs that
move constraints, `B G = -rows`, normal to T in M, so that their accelerations move no y: `y'' = T^T M x''`. Outputs are places,
velocities, accelerations and reactions by name, or combinations of coordinates.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.assembly.own_forces import slopes_of
from polyida.errors import InputError
from polyida.integrate.input_direction import input_direction, input_names
from polyida.integrate.state import State
from polyida.joint.attachment import Attachment
from polyida.linear.lu import SingularSystem, dense
from polyida.linear.saddle import KKT
from polyida.modal import eigen
from polyida.modal.eigen import MOST, NO_MASS, linear_system
from polyida.modal.modes import Modes, normalised
from polyida.model import Model, differences
from polyida.reprs import brief
from polyida.results.motion import reaction_of
from polyida.validation import LARGEST, complexes, floats, is_number, is_one_of, is_whole, named_keywords, vector

STEADY = 1e-100  # rad/s, in place of 0 where there are first-order states: their integrals, which are coordinates, grow without bound at 0
MAX_VIOLATION = 1e-6  # of |B| |x|: modes that violate the constraints by more belong to another state


def inputs_of(part, model, state, inputs):
    """A list of InputDirection with labels of a user's None (all profiles), one input, a list or a dictionary {label: input}."""
    if inputs is None:
        inputs = [name for name in input_names(model) if name]
    if not isinstance(inputs, (list, dict)):
        inputs = [inputs]
    named = inputs.items() if isinstance(inputs, dict) else ((None, one) for one in inputs)
    directions = [(label, input_direction(part, model, state, one)) for label, one in named]
    return [replace(one, label=str(label or one.label or f"input {k}")) for k, (label, one) in enumerate(directions)]


class Coordinates:
    """T (n, d) and, of inputs, forces (n, k), rows (m, k) and G (n, k). modes: None for all coordinates, a number of modes, or Modes."""

    def __init__(self, part, system, inputs, modes=None):
        """Factor M on the constraints, choose the basis T, and solve for the immediate motions G."""
        self.system, n, m = system, system.n, system.model.m
        try:
            self.mass = KKT(system.M, system.B, 1.0)
        except SingularSystem:
            raise InputError(NO_MASS) from None
        self.T, self.units, self.states = _basis(part, system, modes)
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
        """Accelerations `y'' = T^T M a` in the basis T, (d, k), of columns a (n, k)."""
        return self.T.T @ (self.system.M @ a)


def _basis(part, system, modes):
    """(T, units and names of first-order states); with these the velocities of states are the last columns of T."""
    if not system.model.k:
        return _basis_of_places(part, system, modes), np.zeros(0), []
    held = system.with_states_held()
    if isinstance(modes, Modes):
        modes = replace(modes, shapes=modes.shapes[:, system.places])
    elif modes is not None and system.model.is_scene:  # a filter that is held would be a stiff spring
        model, state = system.model, system.state
        K = slopes_of([own for own in model.own_forces if own.names], state.t, state.q, state.v, 0.0, 1.0)[system.places][:, system.places]
        held = replace(held, K=held.K - (dense(K) if isinstance(held.K, np.ndarray) else K))
    T = system.whole(_basis_of_places(part, held, modes))
    S, units, names = eigen.state_basis(system, T)
    return np.hstack([T, S]), units, names


def _basis_of_places(part, system, modes):
    """The columns T of a system without first-order states: all coordinates, the user's modes, or a number of modes."""
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
        if np.abs(system.B @ X).max(initial=0.0) > MAX_VIOLATION * abs(system.B).max(initial=0.0) * np.abs(X).max():
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
    """Components with labels; along(moved, mu): their changes, (components, k), for changes `moved` of q, v and a, (n, k), and mu of lam."""

    labels: tuple[str, ...]
    along: Callable[[tuple[NDArray, NDArray, NDArray], NDArray], NDArray]


def outputs_of(part, model, state, outputs):
    """A list of Output of a user's None, one output, a list or a dictionary {label: output}."""
    if outputs is None:  # the places of all masses and loads; without any, all of q
        outputs = [name for name, thing in model.parts.items() if isinstance(getattr(thing, "at", None), Attachment)]
        outputs = outputs or {f"q[{k}]": row for k, row in enumerate(np.eye(model.n))}
    if isinstance(outputs, (dict, list)) and not outputs:
        raise InputError(f"{part}: output {outputs!r} names nothing to look at; leave it out for masses, loads or all coordinates")
    if isinstance(outputs, dict):
        return [_output(part, model, state, one, str(label)) for label, one in outputs.items()]
    outputs = outputs if isinstance(outputs, list) else [outputs]
    return [_output(part, model, state, one, None) for one in outputs]


def labels_of(outputs):
    """Labels of all components of a list of Outputs, a tuple of str."""
    return tuple(label for output in outputs for label in output.labels)


def along(outputs, moved, mu):
    """Changes of all components of Outputs, (components, k), real or complex, for changes `moved` of q, v and a, and mu of lam."""
    if any(map(np.iscomplexobj, (*moved, mu))):
        real, imaginary = (along(outputs, tuple(map(part, moved)), part(mu)) for part in (np.real, np.imag))
        return real + 1j * imaginary
    return np.concatenate([np.zeros((0, mu.shape[1])), *(output.along(moved, mu) for output in outputs)])


def _output(part, model, state, output, label):
    """The Output of one entry of a user's outputs, labelled by `label` or by its own name."""
    vector = None if isinstance(output, (str, Attachment)) else floats(output)
    if vector is not None and vector.shape == (model.n,):
        return Output((label or "output",), lambda moved, mu: vector[None] @ moved[0])
    what, kind = output if isinstance(output, tuple) and len(output) == 2 else (output, "position")
    if not is_one_of(kind, KINDS) or not isinstance(what, (str, Attachment)):
        forms = f"a name, (name, one of {', '.join(KINDS)}), or {model.n} finite numbers"
        raise InputError(f"{part}: output {str(output)[:80]} must be {forms}")
    return _reaction(part, model, state, what, label) if kind == "reaction" else _place(model, state, what, kind, label)


def _place(model, state, what, kind, label):
    """The Output with two components, x and y, of the place, velocity or acceleration of a named point `what`, about a state.

    kind: "position", "velocity" or "acceleration". label: begins the names of both components, by default what and kind.
    """
    model.position(what, state.q[None])
    name = label or (f"{what} {kind}" if kind != "position" else f"{what}")
    far = 1e3 * (model.extent or 1e-3)  # places of a scene are linear in q: far steps have the least round-off

    def change(moved, mu):
        """Change (2, k) of the place, velocity or acceleration for changes `moved` of q, v and a; mu has no effect."""
        X = moved[MOTION[kind]]
        return _slope(lambda s: model.position(what, state.q + s * X.T).T, X, far)

    return Output((f"{name} x", f"{name} y"), change)


def _reaction(part, model, state, name, label):
    """The Output of the components of a joint's reaction, which changes with q and with lam."""
    if not is_one_of(name, model.joints):
        raise InputError(f"{part}: no joint is called {name!r}; known: {', '.join(map(repr, model.joints)) or 'none'}")

    def reactions(q, lam):
        """The joint's reaction, (components, k), for rows of q (k, n) and of lam (k, m)."""
        return reaction_of(model, name, np.full(len(q), state.t), q, lam).T

    def change(moved, mu):
        """Change (components, k) of the reaction for changes `moved[0]` of q and mu of lam."""
        return _slope(lambda s: reactions(state.q + s * moved[0].T, state.lam + s * mu.T), moved[0], model.extent or 1.0)

    count = len(reactions(state.q[None], state.lam[None]))
    return Output(tuple(f"{label or name + ' reaction'} {k}" for k in range(count)), change)


def _slope(function, X, size):
    """Derivative along columns X (n, k); each moves q by about 1e-3 of `size`: accelerations by forces and by displacements differ by 1e9."""
    sizes = np.abs(X).max(axis=0, initial=0.0) / size
    sizes[sizes == 0.0] = 1.0
    return differences.along(lambda s: function((s / sizes)[:, None])) * sizes


@named_keywords
@dataclass(frozen=True, eq=False)
class StateSpace:
    """State space `x' = A x + B u`, `y = C x + D u` of changes from a state; the result of `pi.linearise`.

    x = (z, z', first-order states, value and rate of each motor), with d independent coordinates z of unit mass.

    Parameters
    ----------
    A, B, C, D : matrices
    inputs, outputs : tuple of str
        Names of u and y.
    motors : tuple of str
        The inputs that are motors; their u is the second derivative of the profile's value (rad/s^2 of an angle).
    shapes : (d + motors, n) float
        Changes of q with z and with the motors' values.
    states : tuple of str
        Names of the first-order states, "element state", and "strain 0 of tau = 0.1 s" of viscoelastic plates: these are combinations of their
        relaxed strains, at most d for each tau, without unit.
    """

    A: NDArray
    B: NDArray
    C: NDArray
    D: NDArray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    motors: tuple[str, ...]
    shapes: NDArray
    states: tuple[str, ...] = ()

    __repr__ = brief

    def to_scipy(self) -> Any:
        """Return these matrices as a `scipy.signal.StateSpace`."""
        from scipy.signal import StateSpace as Scipy

        return Scipy(self.A, self.B, self.C, self.D)

    def response(self, frequencies: ArrayLike) -> NDArray:
        """Return `C (i omega - A)^-1 B + D` at frequencies (k,), Hz: complex, (k, outputs, inputs)."""
        one, known = np.eye(len(self.A)), [frequencies] if is_number(frequencies) else frequencies
        known = vector("StateSpace.response", "frequencies", known)
        return np.array([self.C @ np.linalg.solve(2j * np.pi * f * one - self.A, self.B) + self.D for f in known])

    def displacements(self, x: ArrayLike) -> NDArray:
        """Return changes of q (..., n), m, for states x (..., states)."""
        x, d, k = complexes(x), len(self.shapes) - len(self.motors), len(self.states)
        if x is None or x.shape[-1:] != (len(self.A),) or not np.isfinite(x).all():
            raise InputError(f"StateSpace.displacements: x must be finite numbers, (..., {len(self.A)})")
        x = x if x.imag.any() else x.real
        return np.concatenate([x[..., :d], x[..., 2 * d + k : 2 * d + k + len(self.motors)]], axis=-1) @ self.shapes


@named_keywords
def linearise(
    model: Model, state: State | None = None, inputs: Any = None, outputs: Any = None, modes: Modes | int | None = None
) -> StateSpace:
    """Linearise a model about a state at rest.

    Parameters
    ----------
    model : Model
    state : State, optional
        One of `pi.static`; by default q = 0.
    inputs : optional
        One input, a list, or {name: input}: the name of a load or motor with a profile, a vector (n,) of generalised force, or a function of
        q that returns one. By default all loads and motors with a profile. u of a load is its profile's value, u of a motor the second
        derivative of that; the motor's value and rate are states.
    outputs : optional
        One output, a list, or {name: output}: a name or attachment for its place, (name, kind) with kind "position", "velocity",
        "acceleration" or "reaction" (of a joint), or a vector w (n,) for `w^T q`. By default the places of all masses and loads, or all of q.
    modes : int or Modes, optional
        Number of modes, or the modes, that are the coordinates. By default all n - m, an orthonormal basis on the constraints: then the
        eigenvalues of A are the roots of `pi.modes(..., damped=True)`, and two zeros for each motor. A number of modes is taken without force
        elements that have first-order states.

    Returns
    -------
    StateSpace
        Its matrices and names.

    Raises
    ------
    InputError
        For an unknown input or output, and as `pi.modes`.

    Examples
    --------
    >>> system = pi.linearise(model, pi.static(model), inputs="wind", outputs=["tip", ("tip", "velocity")])  # doctest: +SKIP
    >>> t, y, _ = scipy.signal.lsim(system.to_scipy(), u, t)  # doctest: +SKIP
    """
    system = linear_system("linearise", model, state)
    directions = inputs_of("linearise", system.model, system.state, inputs)
    looked_at = outputs_of("linearise", system.model, system.state, outputs)
    coordinates = Coordinates("linearise", system, directions, modes)
    motors = [k for k, one in enumerate(directions) if one.row.any()]
    A, B, C, D = _matrices(coordinates, motors, looked_at)
    T, model = coordinates.T, system.model
    if model.k:
        A, B, C = _without_integrals(A, B, C, T.shape[1], coordinates.units)
        T = T[:, : T.shape[1] - len(coordinates.units)]
    shapes = np.concatenate([T, coordinates.G[:, motors]], axis=1).T
    names = tuple(one.label for one in directions)
    return StateSpace(A, B, C, D, names, labels_of(looked_at), tuple(names[k] for k in motors), shapes, tuple(coordinates.states))


def _without_integrals(A, B, C, d, of_states):
    """A, B and C without those of d coordinates whose velocities are first-order states, the last ones, and with these in their own units."""
    k = len(of_states)
    used, units = np.delete(np.arange(len(A)), np.arange(d - k, d)), np.ones(len(A))
    units[2 * d - k : 2 * d] = of_states
    units = units[used]
    return A[np.ix_(used, used)] * units[:, None] / units, B[used] * units[:, None], C[:, used] / units


def _matrices(of, motors, outputs):
    """A, B, C and D from x, x', x'' and the multipliers for each state and input equal to one.

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
    """Outputs y of an input `u = e^(i omega t)`; the result of `pi.frequency_response`.

    Parameters
    ----------
    frequencies : (k,) float, Hz
    values : (k, outputs) complex
        y / u.
    input : str
    outputs : tuple of str
    """

    frequencies: NDArray
    values: NDArray
    input: str
    outputs: tuple[str, ...]

    __repr__ = brief

    @property
    def amplitude(self) -> NDArray:
        """Amplitudes of the outputs over that of the input, |y / u|, (k, outputs)."""
        return np.abs(self.values)

    @property
    def phase(self) -> NDArray:
        """The phase by which y leads u, (k, outputs), rad, from -pi to pi."""
        return np.angle(self.values)

    def plot(self) -> Any:
        """Return a matplotlib Figure of amplitude and phase of each output against frequency."""
        from polyida.show.plates import response

        return response(self.frequencies, self.values, self.input, self.outputs)


@named_keywords
def frequency_response(
    model: Model, state: State | None, input: Any, output: Any, frequencies: ArrayLike, modes: Modes | int | None = None
) -> FrequencyResponse:
    """Compute the steady response to one harmonic input.

        [ K + i omega C - omega^2 M   B^T ] [ x  ]   [  force ]
        [ B                            0  ] [ mu ] = [ -row   ]        omega = 2 pi f

    Parameters
    ----------
    model : Model
    state : State or None
        At rest; None for q = 0.
    input : str, (n,) float or function
        A load or motor with a profile, whose value is u; a vector of generalised force, or a function of q that returns one.
    output : as `outputs` of `pi.linearise`
    frequencies : (k,) float, Hz
    modes : int or Modes, optional
        x is made of these modes and of the immediate motion by a motor; the static response of the other modes is missing. By default the
        whole system is factored at each frequency.

    Returns
    -------
    FrequencyResponse
        Infinite at the frequency of an undamped mode.

    Raises
    ------
    InputError
        As `pi.linearise`.
    """
    system = linear_system("frequency_response", model, state)
    at = floats(frequencies)
    if at is None or at.ndim > 1 or not at.size or np.abs(at).max() > LARGEST:
        raise InputError(f"frequency_response: frequencies = {str(frequencies)[:80]} must be finite numbers in Hz, at least one")
    inputs = inputs_of("frequency_response", system.model, system.state, input if isinstance(input, dict) else [input])
    if len(inputs) != 1:
        raise InputError(f"frequency_response: {len(inputs)} inputs were given; it takes one")
    (pushed,) = inputs
    outputs = outputs_of("frequency_response", system.model, system.state, output)
    whole = lambda omega: system.factor(-(omega**2), 1j * omega).solve(-pushed.force, pushed.row)  # noqa: E731
    solve = whole if modes is None else _modal(system, pushed, modes)
    frequencies = np.atleast_1d(at)
    steady = STEADY if system.model.k else 0.0
    values = [_look(outputs, solve, 2 * np.pi * f or steady) for f in frequencies]
    return FrequencyResponse(frequencies, np.array(values), pushed.label, labels_of(outputs))


def _look(outputs, solve, omega):
    """Complex amplitudes (outputs,) of the Outputs at the angular frequency omega, rad/s; inf at an undamped resonance.

    solve(omega): (x (n,), mu (m,)), the complex amplitudes of q and lam.
    """
    try:
        x, mu = (column[:, None] for column in solve(omega))
    except (SingularSystem, np.linalg.LinAlgError):
        return np.full(len(labels_of(outputs)), np.inf, complex)
    return along(outputs, (x, 1j * omega * x, -(omega**2) * x), mu)[:, 0]


def _modal(system, pushed, modes):
    """Function omega -> (x, mu) of the harmonic response with x = T y + G in the span of modes T; mu follows from the accelerations."""
    of = Coordinates("frequency_response", system, [pushed], modes)
    T, G = of.T, of.G[:, 0]
    C = 0.0 * system.M if system.C is None else system.C
    K_y, C_y = T.T @ (system.K @ T), T.T @ (C @ T)

    def solve(omega):
        """(x (n,), mu (m,)): complex amplitudes of changes of q and lam due to the input at the angular frequency omega, rad/s."""
        matrix = K_y + 1j * omega * C_y - omega**2 * np.eye(len(K_y))
        x = G + T @ np.linalg.solve(matrix, T.T @ (pushed.force - system.K @ G - 1j * omega * (C @ G)))
        return x, of.accelerations(x, 1j * omega * x, pushed.force, -(omega**2) * pushed.row)[1]

    return solve
