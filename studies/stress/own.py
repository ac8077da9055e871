"""Cases of the stress study with user-defined bodies, joints, forces and models: they agree with a formula, or are refused by name."""

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from polyida.body.body import Body
from polyida.body.rigid_body import RigidBody
from polyida.errors import InputError
from polyida.force.force_element import ForceElement
from polyida.force.loads import Torque
from polyida.force.springs import SpringDamper
from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.joint.attachment import ground
from polyida.joint.formula import cross
from polyida.joint.joint import Joint
from polyida.joint.joints import Revolute, Slot
from polyida.modal.modes import modes
from polyida.model import Model, Needs
from polyida.model.check import check_derivatives
from polyida.run.solve import solve
from polyida.scene import Scene
from stress.outcome import INTEGRATORS, Check, Stop, drift_check, integrator

G = 9.81
WITHOUT_POTENTIAL = tuple(name for name in INTEGRATORS if name != "energy")  # of models that give the method no potential
ALLOWED = 5e-3  # of the motion: what the integrators of the table with their usual steps and tolerances are allowed


@dataclass(frozen=True, eq=False)
class Anchored(Body):
    """A point mass m, kg, on a spring to the origin of stiffness k, N/m. Its elastic force is a Python function."""

    m: float
    k: float
    name: str | None = None

    def coordinates(self):
        return [0.0]

    def mass_matrix(self):
        return [[self.m]]

    def attachments(self):
        return {"point": [1.0]}

    def translation(self):
        return [1.0]

    def elastic(self, z):
        return self.k * z

    def energy(self, z):
        return 0.5 * self.k * float(np.vdot(z, z).real)


BESIDE = ("nothing", "spring", "torque")


def own_body_beside(what, name):
    """A user-defined body of 1 kg on a spring of 30 N/m starts with 1 m/s beside a built-in force: it moves as `sin(omega t) / omega`. A
    built-in spring adds 20 N/m; a torque turns another body by `M t^2 / (2 I)`.
    """
    scene, t_end, extra = Scene(), 0.3, 20.0 if what == "spring" else 0.0
    point = scene.add(Anchored(1.0, 30.0, name="own"))
    wheel = scene.add(RigidBody(mass=1.0, inertia=0.5, points={"hub": (0.0, 0.0), "rim": (1.0, 0.0)}, origin=(0.0, 5.0), name="wheel"))
    scene.add(Revolute(ground, wheel.at("hub"), name="bearing"))
    if what == "spring":
        scene.add(SpringDamper(ground.at((-1.0, 0.0)), point.at("point"), stiffness=extra, name="beside"))
    if what == "torque":
        scene.add(Torque(wheel.at("hub"), 2.0, name="beside"))
    model, start = scene.build(), np.zeros(scene.build().n)
    start[0] = 1.0
    run = solve(model, t_end, integrator(name), v0=start)
    omega = np.sqrt(30.0 + extra)
    moved = run.position(point.at("point"))[-1] - [np.sin(omega * run.t[-1]) / omega, 0.0]
    angle = (2.0 if what == "torque" else 0.0) * run.t[-1] ** 2
    rim = run.position(wheel.at("rim"))[-1] - [np.cos(angle), 5.0 + np.sin(angle)]
    return run, [
        Check("place of the own body, m", float(np.linalg.norm(moved)), ALLOWED / omega),
        Check("place of the wheel's rim, m", float(np.linalg.norm(rim)), ALLOWED),
        drift_check(run),
    ]


class Linear(Model):
    """`M q'' + C q' + K q = 0`."""

    m = 0
    needs = Needs(mass_varies=False, driven=False, phi_q_varies=False)

    def __init__(self, M, C, K):
        self.M, self.C, self.K = (np.atleast_2d(np.asarray(part, float)) for part in (M, C, K))
        self.n = len(self.M)

    def mass(self, q):
        return self.M

    def force(self, t, q, v):
        return self.C @ v + self.K @ q

    def phi(self, t, q):
        return np.zeros(0)

    def phi_q(self, t, q):
        return np.zeros((0, self.n))


def damped_oscillator(damping, name):
    """Modes of `s^2 + d s + 1`: both roots -d/2 +- sqrt(d^2/4 - 1) are computed, also if they are real."""
    return None, [_all_roots(Linear(1.0, damping, 1.0), np.roots([1.0, damping, 1.0]))]


BICYCLE = {  # Meijaard, Papadopoulos, Ruina, Schwab (2007), Proc. R. Soc. A 463: speed in m/s, the roots of table 2 in 1/s
    0.0: (-5.53094371765393, -3.13164324790656, 3.13164324790656, 5.53094371765393),
    5.0: (-14.07838969279822, -0.32286642900409, -0.77534188219585 + 4.46486771378823j, -0.77534188219585 - 4.46486771378823j),
}


def bicycle(speed, name):
    """Modes of the benchmark bicycle of Meijaard and others (2007): all published roots are computed, also growing and real ones."""
    M = [[80.81722, 2.31941332208709], [2.31941332208709, 0.29784188199686]]
    C = [[0.0, 33.86641391492494], [-0.85035641456978, 1.68540397397560]]
    K0 = np.array([[-80.95, -2.59951685249872], [-2.59951685249872, -0.80329488458618]])
    K2 = np.array([[0.0, 76.59734589573222], [0.0, 2.65431523794604]])
    return None, [_all_roots(Linear(M, speed * np.array(C), G * K0 + speed**2 * K2), np.array(BICYCLE[speed]))]


def _all_roots(model, known):
    """The Check that `modes` has every root, including complex conjugates."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that modes grow is what is looked for
        roots = modes(model, damped=True, count=2 * model.n).roots
    result = np.concatenate([roots, roots.conj()])
    apart = np.abs(result[None, :] - known[:, None]).min(axis=1).max()
    return Check("roots of the modes, of the largest", float(apart / np.abs(known).max()), 1e-9)


class Rail(Joint):
    """The point of b stays on the line through the point of a along the direction of a."""

    def rows(self):
        return [cross(self.a.d, self.b.x - self.a.x)]


class Mirrored(Joint):
    """The constraint of Rail with its formula times -2."""

    def rows(self):
        return [cross(self.b.x - self.a.x, self.a.d) * 2.0]


class Pin(Joint):
    """The points of a and b coincide."""

    def rows(self):
        return [self.b.x - self.a.x]


HOLDS = {"Slot": Slot, "Rail": Rail, "Mirrored": Mirrored, "Pin": Pin}


def reaction_of(kind, name):
    """A body of 2 kg slides or hangs at a joint: the reaction on side b is `m (a - g)`, for user-defined joints and for the built-in one."""
    scene = Scene(gravity=(0.0, -G))
    body = scene.add(RigidBody(mass=2.0, inertia=0.1, points={"pin": (0.0, 0.0)}, name="body"))
    scene.add(HOLDS[kind](ground.at((0.0, 0.0), direction=(0.8, 0.6)), body.at("pin"), name="joint"))
    run = solve(scene.build(), 0.1, integrator(name))
    normal = np.array([-0.6, 0.8])
    known = 2.0 * G * (np.array([0.0, 1.0]) if kind == "Pin" else 0.8 * normal)
    force = np.asarray(run.wrench("joint"))[-1, :2]
    off = float(np.linalg.norm(force - known)) if force.shape == (2,) else float("inf")
    return run, [Check("reaction on side b, of the weight", off / (2.0 * G), ALLOWED), drift_check(run)]


PROMISES = ("none", "driven", "mass_varies", "velocity_forces", "phi_q_varies")


class Promising(Model):
    """Two coordinates with one constraint. `broken` is a property that `needs` wrongly denies."""

    n, m = 2, 1

    def __init__(self, broken):
        self.broken = broken
        self.needs = Needs(**{name: False for name in PROMISES[1:]})

    def mass(self, q):
        return np.diag([1.0, 1.0 + 0.3 * np.sin(q[0]) * (self.broken == "mass_varies")])

    def force(self, t, q, v):
        return np.array([q[0], G]) + 0.5 * v * (self.broken == "velocity_forces")

    def phi(self, t, q):
        bent = 0.2 * q[0] ** 2 * (self.broken == "phi_q_varies")
        return np.array([q[1] - 0.5 * q[0] - bent - 0.1 * np.sin(5.0 * t) ** 2 * (self.broken == "driven")])

    def phi_q(self, t, q):
        return np.array([[-0.5 - 0.4 * q[0] * (self.broken == "phi_q_varies"), 1.0]])


def promised(broken, name):
    """A user-defined model with all `needs` False: if that is true, the run agrees with a run of the model with default `needs`."""
    model = Promising(broken)
    run = solve(model, 0.5, integrator(name))
    return run, _against_honest(run, Promising(broken), needs=Needs())


def broken_promise(broken, name):
    """A model that contradicts its `needs` is refused, and the message names the property."""
    return Stop(("refused",), (broken,)) if broken != "none" else None


DERIVATIVES = ("none", "phi_rate", "phi_bias")


class Circling(Model):
    """A point of 1 kg on the unit circle under gravity. `wrong` is the function that is no derivative of phi."""

    n, m = 2, 1

    def __init__(self, wrong):
        self.wrong = wrong

    def mass(self, q):
        return np.eye(2)

    def force(self, t, q, v):
        return np.array([0.0, G])

    def phi(self, t, q):
        return np.array([0.5 * (q @ q - 1.0)])

    def phi_q(self, t, q):
        return q[None, :]

    def phi_rate(self, t, q, v):
        return np.array([q @ v + 0.2 * v[0] * (self.wrong == "phi_rate")])

    def phi_bias(self, t, q, v):
        return np.array([v @ v * (1.1 if self.wrong == "phi_bias" else 1.0)])


def circled(wrong, name):
    """A user-defined pendulum with phi_rate and phi_bias: the run is correct if they are derivatives of phi."""
    run = solve(Circling(wrong), 0.5, integrator(name), q0=[1.0, 0.0])
    return run, _against_honest(run, Circling("none"))


def no_derivative(wrong, name):
    """A model whose phi_rate or phi_bias is no derivative of phi is refused, and the message names the function."""
    return Stop(("refused",), (wrong,)) if wrong != "none" else None


def _against_honest(run, model, **attributes):
    """Checks of a run against Radau IIA with a small tolerance on a correct model."""
    vars(model).update(attributes)
    exact = solve(model, float(run.t[-1]), RadauIIA(rtol=1e-10), q0=run.q[0], v0=run.v[0])
    off = np.abs(run.q[-1] - exact.q[-1]).max() if exact.success else np.nan
    return [Check("q at the end against Radau IIA", float(off), ALLOWED), drift_check(run)]


@dataclass(frozen=True, eq=False)
class Attraction(ForceElement):
    """A point is attracted by the origin with the force `k d`, N. Its energy is `share` times the potential."""

    at: Any
    k: float
    share: float = 1.0
    name: str | None = None

    def sides(self):
        return (self.at,)

    def forces(self, t, x, v):
        return -self.k * x

    def energy(self, x):
        return self.share * 0.5 * self.k * float(np.vdot(x, x))


def own_energy(share, name):
    """A user-defined force with `share` times its potential as energy: `check_derivatives` accepts it, and the run conserves energy."""
    scene = Scene()
    body = scene.add(RigidBody(mass=1.0, inertia=0.1, points={"c": (0.0, 0.0)}, origin=(1.0, 0.0), name="body"))
    scene.add(Attraction(body.at("c"), 20.0, share, name="own"))
    model = scene.build()
    off = {key: value for key, value in check_derivatives(model).items() if not value < 1e-6}
    if off:
        raise InputError(f"check_derivatives: {', '.join(f'{key} {value:.3g}' for key, value in off.items())}")
    run = solve(model, 0.5, integrator(name))
    energy = run.energy.total
    return run, [Check("energy, of that at the start", float(np.abs(energy - energy[0]).max() / energy[0]), ALLOWED), drift_check(run)]


def no_potential(share, name):
    """`check_derivatives` detects an energy that is not the potential of its force."""
    return Stop(("refused",), ("check_derivatives",)) if share != 1.0 else None
