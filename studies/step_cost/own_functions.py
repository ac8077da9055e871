"""A step with user-defined functions: in Python, compiled by `polyida.compiled`, and built in; and with states over one without.

`PYTHONPATH=studies python studies/step_cost/own_functions.py [FUNCTION ...]` prints it.
"""

import sys
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import polyida as pi
from polyida.problems.plates import RUBBER, double_plate
from polyida.run.solve import solve
from step_cost.side import NO_FRAMES, cells_for, cpu

H = 1e-3  # s
STEPS = {"alpha": (200, 1200), "radau": (20, 120), "energy": (20, 220)}  # of the two runs whose difference is told
METHODS = {"alpha": pi.GeneralizedAlpha(h=H), "radau": pi.RadauIIA(h=H), "energy": pi.EnergyMomentum(h=H)}


@dataclass(frozen=True, eq=False)
class Spring(pi.ForceElement):
    """A spring and a damper of rest length zero between two points."""

    a: Any
    b: Any
    stiffness: float
    damping: float
    name: str | None = None

    def sides(self):
        return (self.a, self.b)

    def forces(self, t, x, v):
        pull = self.stiffness * (x[1] - x[0]) + self.damping * (v[1] - v[0])
        return np.stack((pull, -pull))

    def energy(self, x):
        w = x[1] - x[0]
        return 0.5 * self.stiffness * (w[0] ** 2 + w[1] ** 2)


@dataclass(frozen=True, eq=False)
class Dumbbell(pi.Body):
    """Two masses m, kg, on a spring of stiffness k, N/m, and rest length 1 m."""

    m: float
    k: float
    name: str | None = None

    def coordinates(self):
        return [1.0, 2.0]

    def mass_matrix(self):
        return self.m * np.eye(2)

    def attachments(self):
        return {"left": [1.0, 0.0], "right": [0.0, 1.0]}

    def translation(self):
        return [1.0, 1.0]

    def elastic(self, z):
        w = z[1] - z[0]
        pull = self.k * (abs(w) - 1.0) * w / abs(w)
        return np.array([-pull, pull])

    def energy(self, z):
        return 0.5 * self.k * (abs(z[1] - z[0]) - 1.0) ** 2


@dataclass(frozen=True, eq=False)
class Sampled(pi.Controller):
    """A torque against the rotation of a direction, computed in Python every 10 steps."""

    at: Any
    name: str | None = None
    period = 10 * H

    def sides(self):
        return (self.at.d,)

    def sample(self, t, x, v, s, u):
        return np.array([-0.1 * (x[0, 0] * v[0, 1] - x[0, 1] * v[0, 0])])

    def forces(self, t, x, v, s, u):
        return u[0] / (x[0, 0] ** 2 + x[0, 1] ** 2) * np.array([[-x[0, 1], x[0, 0]]])


def compiled(kind):
    """A subclass that numba compiles."""
    return pi.compiled(dataclass(frozen=True, eq=False)(type(f"Compiled{kind.__name__}", (kind,), {})))


def turning(t):
    """A moment, N m."""
    return np.sin(3.0 * t) + 0.5 * t * t


def height(t, q, v):
    """A number of a state that stays positive."""
    return q[1] + 10.0


def pendulum(body=None, force=None, *at_elbow):
    """The model of two bars, or a bar and a body, that fall; at_elbow: functions of the second joint."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    first = scene.add(pi.RigidBody.bar(1.0, 1.0, name="first"))
    second = scene.add(body or pi.RigidBody.bar(1.0, 1.0, (1.0, 0.0), name="second"))
    scene.add(pi.Revolute(pi.ground, first.at("left")))
    elbow = scene.add(pi.Revolute(first.at("right"), second.at("left")))
    for part in at_elbow:
        scene.add(part(elbow))
    if force:
        scene.add(force(first, second))
    return scene.build()


def plates(*forces, prony=()):
    """The model of two plates of about 1000 coordinates, with forces, functions of their joint, and terms of relaxation."""
    scene = double_plate(cells_for(1000), material=replace(RUBBER, prony=prony))
    for force in forces:
        scene.add(force(scene.parts["elbow"]))
    return scene.build()


def driven(joint):
    """A DC motor against the ground."""
    return pi.DCMotor(joint.a, pi.profile.sine(6.0, 1.0), k=0.05, L=1e-3, R=1.0, gear=20.0)


def controlled(joint):
    """A PID controller of the angle between two bodies."""
    return pi.PID(joint.b, kp=5.0, ki=2.0, kd=0.2, target=0.3, against=joint.a, filter=0.01)


def spring(kind):
    """The model with a spring of a kind."""
    ends = (pi.ground.at((0.5, -2.0)),)
    return pendulum(force=lambda first, second: kind(*ends, second.at("right"), stiffness=20.0, damping=0.1))


def motor(moment):
    """The model with a moment."""
    return pendulum(force=lambda first, second: pi.Torque(first.at("right"), moment))


def sampled(joint):
    """A controller that samples in Python and whose force is compiled."""
    return compiled(Sampled)(joint.b)


CASES = {  # what: {variant: (what makes its model, options of solve)}
    "motor and PID, bars": {"without": (pendulum, {}), "with": (lambda: pendulum(None, None, driven, controlled), {})},
    "motor and PID, plates": {"without": (plates, {}), "with": (lambda: plates(driven, controlled), {})},
    "sample every 10 steps, plates": {"without": (plates, {}), "with": (lambda: plates(sampled), {})},
    "relaxation, two terms": {"without": (plates, {}), "with": (lambda: plates(prony=[(0.2, 0.01), (0.1, 0.1)]), {})},
    "force": {
        "python": (lambda: spring(Spring), {}),
        "compiled": (lambda: spring(compiled(Spring)), {}),
        "ready": (lambda: spring(pi.SpringDamper), {}),
    },
    "body": {"python": (lambda: pendulum(Dumbbell(0.5, 1e3)), {}), "compiled": (lambda: pendulum(compiled(Dumbbell)(0.5, 1e3)), {})},
    "profile": {
        "python": (lambda: motor(turning), {}),
        "compiled": (lambda: motor(pi.compiled(turning)), {}),
        "ready": (lambda: motor(pi.profile.sine(1.0, 0.5)), {}),
    },
    "until": {"python": (pendulum, {"until": height}), "compiled": (pendulum, {"until": pi.compiled(height)}), "ready": (pendulum, {})},
    "sensor": {
        "python": (pendulum, {"sensors": {"height": height}}),
        "compiled": (pendulum, {"sensors": {"height": pi.compiled(height)}}),
        "ready": (pendulum, {}),
    },
}


def tasks(quick):
    """One row for each kind of function and method."""
    methods = ("alpha",) if quick else METHODS
    return [
        {"part": "own functions", "function": name, "method": method, "rounds": 2 if quick else 5} for name in CASES for method in methods
    ]


def own_row(function, method, rounds):
    """{variant: CPU microseconds of a step, "ratio": with over without}, medians of rounds in which all variants alternate."""
    models = {name: (make(), options) for name, (make, options) in CASES[function].items()}
    result: dict = {name: [] for name in models}
    short, long = STEPS[method]
    for _ in range(rounds + 1):
        for name, (model, options) in models.items():
            ends = [cpu(lambda: solve(model, steps * H, METHODS[method], every=NO_FRAMES, **options))[0] for steps in (short, long)]  # noqa: B023
            result[name].append(1e6 * (ends[1] - ends[0]) / (long - short))
    row = {f"{name}_us": float(np.median(times[1:])) for name, times in result.items()}
    if "without" in result:
        row["ratio"] = float(np.median(np.divide(result["with"], result["without"])[1:]))
    return row


def notes(rows):
    """The times of a step."""
    return [
        f"{row['function']}, {row['method']}: "
        + ", ".join(f"{name[:-3]} {row[name]:.3g} us" for name in row if name.endswith("_us"))
        + (f", with over without {row['ratio']:.3f}" if "ratio" in row else "")
        for row in rows
    ]


if __name__ == "__main__":
    for task in tasks(False):
        task.pop("part")
        if task["function"] in sys.argv[1:] or not sys.argv[1:]:
            print(*notes([task | own_row(**task)]), flush=True)
