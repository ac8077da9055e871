"""Parts with states: sampled controllers, PID control, linear control, a DC motor, a Maxwell element."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from polyida.body.body import require_arguments, require_whole
from polyida.errors import InputError
from polyida.fields import check, check_fields, time_profile
from polyida.force.force_element import ForceElement
from polyida.force.loads import RotationElement, as_forces, measured
from polyida.force.springs import elongation
from polyida.jit.user_functions import compiled
from polyida.joint.attachment import Attachment, require_places, require_sides
from polyida.validation import floats, is_number, named_keywords, number, positive, settle


class Controller(ForceElement, part=False):
    """A force element whose outputs u are held between samples (zero-order hold): base class of a user's frozen dataclass.

    The class has a field `name` and a field or attribute `period`, s, and writes `sides()`, `sample(t, x, v, s, u)` and
    `forces(t, x, v, s, u)`; with states also `rates(t, x, v, s, u)`. It samples at t = 0, period, 2 period, ... Steps of
    all integrators end at the samples. An output that acts on rates only, as a voltage, costs less than one that makes forces jump.
    `run.states(name)` has the states, then the outputs; at the time of a sample those before it.

    `@polyida.compiled` above the class lets numba compile `forces` and `rates`; `sample` stays Python.

    Attributes
    ----------
    period : float, s
    outputs : tuple of str
        Names of the outputs.
    """

    period = 0.0
    outputs: tuple[str, ...] = ("u",)

    def require(self) -> None:
        """Raise InputError unless the period and the outputs are right."""
        require_whole(self, Controller, ("sample",))
        require_arguments(self, Controller, {"sample": "txvsu"})
        if not (is_number(self.period) and self.period > 0):
            raise InputError(f"{self.label}: period = {self.period!r} must be a positive time in s")
        names = self.outputs
        if not (isinstance(names, tuple) and names and all(isinstance(name, str) and name for name in names)):
            raise InputError(f"{self.label}: outputs = {names!r:.80} must be a tuple of names, one at least")

    def sample(self, t: float, x: np.ndarray, v: np.ndarray, s: np.ndarray, u: np.ndarray) -> ArrayLike:
        """Return new outputs, (outputs,), from time, places and velocities of the sides, states and the outputs so far."""
        raise NotImplementedError


def pid_torque(self, t, x, v, s):
    """(torque without limit, torque, error, filtered rate) of a PID."""
    angle, rate = measured(self, x, v)
    error = self.target(t) - angle
    if self.filter > 0.0:
        rate = (angle - s[1]) / self.filter
    whole = self.kp * error + s[0] - self.kd * rate
    return whole, min(max(whole, -self.limit), self.limit), error, rate


@compiled
@named_keywords
@dataclass(frozen=True, eq=False)
class PID(RotationElement):
    """A continuous PID controller of an angle: the torque `u = kp e + I - kd angle'` on a direction, e = target - angle, `I' = ki e`.

    The derivative is that of the angle, so that a jump of the target gives no impulse; with `filter` it is `(angle - z)/filter`,
    `z' = (angle - z)/filter`. A torque above `limit` is cut off, and `I' = ki e + (ki/kp) (cut u - u)` then stops the integral from growing.
    States: "integral", I, N m, and "filtered", z, rad.

    Parameters
    ----------
    at : Attachment
        With a direction; the angle is its rotation since the reference configuration, between -pi and pi.
    kp : float, N m/rad
    ki : float, N m/(rad s)
    kd : float, N m s/rad
    target : float, Profile or function of time, rad
    against : Attachment, optional
        Of another body: the angle is relative to it, and -u acts on it. Default: the ground.
    filter : float, s, >= 0
        Time constant of the derivative.
    limit : float, N m, > 0
        Largest torque.
    name : str, optional

    Raises
    ------
    InputError
        For an attachment without a direction, two attachments of one body, or a wrong number.
    """

    at: Attachment
    kp: float = field(metadata=check(number, "N m/rad"))
    ki: float = field(default=0.0, metadata=check(number, "N m/(rad s)"))
    kd: float = field(default=0.0, metadata=check(number, "N m s/rad"))
    target: Any = field(default=0.0, metadata=check(time_profile))
    against: Attachment | None = None
    filter: float = field(default=0.0, metadata=check(number, "s", 0.0))
    limit: float = field(default=1e30, metadata=check(positive, "N m"))
    name: str | None = None
    states = ("integral", "filtered")

    def __post_init__(self):
        """Check the fields, and that it acts on a direction. Raises InputError."""
        self.require_rotation()
        check_fields(self, self.label)

    def sizes(self) -> list[float]:
        """Return the sizes of the states: the torque of an error of 1 rad, N m, and 1 rad."""
        return [abs(self.kp) or 1.0, 1.0]

    def rates(self, t: float, x: np.ndarray, v: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Return (I', z'), the rates of the integral and of the filtered angle."""
        whole, torque, error, rate = pid_torque(self, t, x, v, s)
        back = self.ki / self.kp * (torque - whole) if self.kp != 0.0 else 0.0
        return np.array([self.ki * error + back, rate if self.filter > 0.0 else 0.0])

    def forces(self, t: float, x: np.ndarray, v: np.ndarray, s: np.ndarray) -> np.ndarray:  # type: ignore[override]  # of one with states
        """Return `u i d / |d|^2`, and the opposite for a second direction, (sides, 2), J."""
        return as_forces(x, pid_torque(self, t, x, v, s)[1])


@compiled
@named_keywords
@dataclass(frozen=True, eq=False)
class LinearController(RotationElement):
    """A linear controller of an angle: `x' = A x + B e`, torque `u = C x + D e` on a direction, e = target - angle.

    A controller K designed with scipy.signal or python-control goes in as it is, `LinearController(at, K)`, or by its matrices.

    Parameters
    ----------
    at : Attachment
        With a direction; the angle is its rotation since the reference configuration, between -pi and pi.
    A : (k, k) float, 1/s, or a state space in continuous time
        A StateSpace of scipy.signal or python-control; without B, C and D.
    B : (k, 1) float
    C : (1, k) float
    D : (1, 1) float, N m/rad
    target : float, Profile or function of time, rad
    against : Attachment, optional
        Of another body: the angle is relative to it, and -u acts on it. Default: the ground.
    name : str, optional

    Raises
    ------
    InputError
        For an attachment without a direction, two attachments of one body, matrices of wrong shapes, or a system in discrete time.
    """

    at: Attachment
    A: Any
    B: Any = None
    C: Any = None
    D: Any = None
    target: Any = field(default=0.0, metadata=check(time_profile))
    against: Attachment | None = None
    name: str | None = None

    def __post_init__(self):
        """Take the matrices of a state space, and check them and the fields."""
        self.require_rotation()
        match self.A, self.B, self.C, self.D:
            case object(A=A, B=B, C=C, D=D, dt=step), None, None, None:
                if step:  # None or 0 in continuous time
                    what = f"{type(self.A).__name__} in discrete time, dt = {step!r}"
                    raise InputError(f"{self.label}: A is a {what}; give one in continuous time, or write a polyida.Controller")
                settle(self, A=A, B=B, C=C, D=D)
            case object(to_ss=_), *_:
                raise InputError(f"{self.label}: A is a {type(self.A).__name__}; give its to_ss(), without B, C and D")
        A = floats(self.A)
        k = 0 if A is None or A.ndim != 2 else len(A)
        matrices = {}
        for name, shape in {"A": (k, k), "B": (k, 1), "C": (1, k), "D": (1, 1)}.items():
            matrix = floats(getattr(self, name))
            if not k or matrix is None or matrix.size != np.prod(shape):
                raise InputError(
                    f"{self.label}: {name} = {getattr(self, name)!r:.80} must be finite numbers of shape {shape if k else '(k, k)'}"
                )
            matrices[name] = matrix.reshape(shape)
        settle(self, **matrices)
        check_fields(self, self.label)

    @property
    def states(self) -> tuple[str, ...]:  # type: ignore[override]  # their number depends on A
        """Names of the states, "x_0" to "x_k"."""
        return tuple(f"x_{k}" for k in range(len(self.A)))

    def rates(self, t: float, x: np.ndarray, v: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Return the rates of the states, A s + B e, with the error e = target - angle, rad."""
        error = self.target(t) - measured(self, x, v)[0]
        rates = np.empty(s.shape[0])
        for i in range(s.shape[0]):
            rates[i] = self.B[i, 0] * error
            for j in range(s.shape[0]):
                rates[i] += self.A[i, j] * s[j]
        return rates

    def forces(self, t: float, x: np.ndarray, v: np.ndarray, s: np.ndarray) -> np.ndarray:  # type: ignore[override]  # of one with states
        """Return `u i d / |d|^2`, and the opposite for a second direction, (sides, 2), J."""
        torque = self.D[0, 0] * (self.target(t) - measured(self, x, v)[0])
        for j in range(s.shape[0]):
            torque += self.C[0, j] * s[j]
        return as_forces(x, torque)


@compiled
@named_keywords
@dataclass(frozen=True, eq=False)
class DCMotor(RotationElement):
    """A DC motor with gear: `L i' = volts - R i - k n angle'`, torque `k n i` on a direction. State: "current", i, A; algebraic for L = 0.

    Parameters
    ----------
    at : Attachment
        With a direction.
    volts : float, Profile or function of time, V
    k : float, N m/A
        Torque constant; V s/rad as the constant of the counter voltage.
    L : float, H, >= 0
    R : float, Ohm, >= 0
        > 0 for L = 0.
    gear : float
        n, the motor's rotation over that of the direction.
    against : Attachment, optional
        Of another body, on which the opposite torque acts. Default: the ground.
    name : str, optional

    Raises
    ------
    InputError
        For an attachment without a direction, two attachments of one body, or a wrong number.
    """

    at: Attachment
    volts: Any = field(metadata=check(time_profile))
    k: float = field(metadata=check(number, "N m/A"))
    L: float = field(metadata=check(number, "H", 0.0))
    R: float
    gear: float = field(default=1.0, metadata=check(number, "rad/rad"))
    against: Attachment | None = None
    name: str | None = None

    def __post_init__(self):
        """Check the fields, and that R is positive where L = 0. Raises InputError."""
        self.require_rotation()
        check_fields(self, self.label)
        settle(self, R=(number(self.label, "R", self.R, "Ohm", 0.0) if self.L else positive(self.label, "R", self.R, "Ohm")))

    @property
    def states(self) -> tuple[str, ...]:  # type: ignore[override]
        """Names of the states: the current, unless L is zero."""
        return ("current",) if self.L else ()

    @property
    def algebraic(self) -> tuple[str, ...]:  # type: ignore[override]
        """Names of the algebraic states: the current for L = 0, otherwise none."""
        return () if self.L else ("current",)

    def rates(self, t: float, x: np.ndarray, v: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Return (1,): the rate of the current, A/s, or for L = 0 the voltage that must vanish, V."""
        volts = self.volts(t) - self.R * s[0] - self.k * self.gear * measured(self, x, v)[1]
        return np.array([volts / self.L if self.L > 0.0 else volts])

    def forces(self, t: float, x: np.ndarray, v: np.ndarray, s: np.ndarray) -> np.ndarray:  # type: ignore[override]  # of one with states
        """Return the torque as forces on the directions, (sides, 2), J."""
        return as_forces(x, self.k * self.gear * s[0])


@compiled
@named_keywords
@dataclass(frozen=True, eq=False)
class Maxwell(ForceElement):
    """A spring in series with a damper between two points: tension `N = k (e - s)`, `s' = N/c`, e = l - l0. State: "damper", s, m.

    Energy `k (e - s)^2 / 2`, dissipation `N^2 / c`. At l = 0 the line has no direction and the force is zero.

    Parameters
    ----------
    a, b : Attachment or Ground
    stiffness : float, N/m, k > 0
    damping : float, N s/m, c > 0
        The relaxation time is c/k.
    length : float, m, l0 >= 0
        Length without tension at the start. Default: the distance in the reference configuration.
    name : str, optional

    Raises
    ------
    InputError
        For a wrong number, or sides that are no points of two bodies or of a body and the ground.
    """

    a: Any
    b: Any
    stiffness: float = field(metadata=check(positive, "N/m"))
    damping: float = field(metadata=check(positive, "N s/m"))
    length: float | None = field(default=None, metadata=check(number, "m", 0.0))
    name: str | None = None
    states = ("damper",)
    dissipates = True

    def __post_init__(self):
        """Check the sides and the fields; the default length is the distance in the reference configuration."""
        require_sides(self.label, self.a, self.b)
        require_places(self.label, self.a, self.b)
        if self.length is None:
            settle(self, length=np.linalg.norm(self.b.point - self.a.point))
        check_fields(self, self.label)

    def sides(self) -> tuple:
        """Return the two points a and b on which the element acts."""
        return self.a, self.b

    def rates(self, t: float, x: np.ndarray, v: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Return the rate of the damper, s' = N/c, m/s."""
        return np.array([self.stiffness / self.damping * (elongation(self, x)[0] - s[0])])

    def forces(self, t: float, x: np.ndarray, v: np.ndarray, s: np.ndarray) -> np.ndarray:  # type: ignore[override]  # of one with states
        """Return `u N` on a and `-u N` on b, (2, 2), N."""
        e, ux, uy = elongation(self, x)
        tension = self.stiffness * (e - s[0])
        return np.array(((tension * ux, tension * uy), (-tension * ux, -tension * uy)))

    def energy(self, x: np.ndarray, s: np.ndarray) -> float:  # type: ignore[override]  # of an element with states
        """Return the energy of the spring, `k (e - s)^2 / 2`, J."""
        return 0.5 * self.stiffness * (elongation(self, x)[0] - s[0]) ** 2
