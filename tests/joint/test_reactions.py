"""What joints do to their sides b: Newton's and Euler's laws of the body that a joint holds, and slopes of it against differences."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import polyida as pi

G, MASS, INERTIA, CENTRE = 9.81, 2.0, 0.3, (0.3, -0.2)
WAVE = pi.profile.sine(0.4, 0.7)


class Rail(pi.Joint):
    """The joint of the README."""

    def rows(self):
        return [pi.cross(self.a.d, self.b.x - self.a.x)]


class Hinge(pi.Joint):
    """Other factors and signs than those of a Revolute."""

    def rows(self):
        return [pi.dot(pi.ground.at((0.0, 0.0)).d, 3.0 * (self.b.x - self.a.x)), pi.cross(pi.ground.at((0.0, 0.0)).d, self.a.x - self.b.x)]


@dataclass(frozen=True, eq=False)
class TurningRail(pi.Joint):
    """A line that turns in time, and an angle that is held against it."""

    angle: Any

    def rows(self):
        line = self.a.d.turned(self.angle)
        return [-2.0 * pi.cross(line, self.b.x - self.a.x), pi.cross(line, self.b.d.onto(self.a.d))]


@dataclass(frozen=True, eq=False)
class TwoPins(pi.Joint):
    """Two points of the body of b are held: a pin, and a pin in a slot."""

    c: Any

    def rows(self):
        return [pi.cross(self.c.x - pi.ground.at(self.c.point).x, self.a.d), self.a.x - self.b.x]


def cross(arms, forces):
    """Moments of forces (., 2)."""
    return arms[..., 0] * forces[..., 1] - arms[..., 1] * forces[..., 0]


def body(scene, name="body", origin=(1.0, 0.0), angle=0.4, **start):
    made = pi.RigidBody(
        MASS, INERTIA, {"end": (0.0, 0.0), "other": (0.5, 0.1)}, origin=origin, angle=angle, center=CENTRE, name=name, **start
    )
    return scene.add(made)


AT = pi.ground.at((1.0, 0.0), direction=(2.0, 1.0))
JOINTS = {  # (the joint of an end of a body and of another point of it, components of the reaction)
    "rail": (lambda end, other: Rail(AT, end), "along"),
    "slot": (lambda end, other: pi.Slot(AT, end), "f"),
    "hinge": (lambda end, other: Hinge(AT, end), "f"),
    "revolute": (lambda end, other: pi.Revolute(pi.ground, end), "f"),
    "turning rail": (lambda end, other: TurningRail(AT, end, WAVE), "fm"),
    "two pins": (lambda end, other: TwoPins(AT, end, other), "fm"),
    "prismatic": (lambda end, other: pi.Prismatic(AT, end), "fm"),
    "weld": (lambda end, other: pi.Weld(pi.ground, end), "fm"),
    "clamp": (lambda end, other: pi.Clamp(pi.ground, end), "fm"),
    "distance": (lambda end, other: pi.Distance(pi.ground.at((0.2, 0.5)), end), "f"),
    "path": (lambda end, other: pi.PrescribedPosition(end, x=lambda t: 1.0 + 0.1 * np.sin(3.0 * t), y=lambda t: 0.0 * t), "f"),
    "path in y": (lambda end, other: pi.PrescribedPosition(end, x=None, y=lambda t: 0.1 * np.sin(3.0 * t)), "y"),
    "motor": (lambda end, other: pi.AngleMotor(AT, end, angle=WAVE), "m"),
}


def torsor(run, model, name, components):
    """(fx, fy, m) of the reaction, what it has not as zero."""
    told, found = run.wrench(name) if components == "along" else run.reaction(name), np.zeros((len(run), 3))
    found[:, {"f": [0, 1], "fm": [0, 1, 2], "along": [0, 1, 2], "m": [2], "y": [1]}[components]] = told
    return found


def needed(run, model, bar, end):
    """(fx, fy, m) about the point `end` that Newton and Euler want of a joint, the body under gravity."""
    place = model.places[id(bar)]
    q, a = (x.reshape(len(run), -1, 2)[:, place.pairs] @ (1.0, 1j) for x in (run.q, run.a))
    z = place.rest + q
    force = MASS * (a[:, 0] + 1j * G)
    spin = MASS * (np.conj(z[:, 1]) * a[:, 1]).imag
    arm = z[:, 0] - run.position(end) @ (1.0, 1j)
    return np.stack([force.real, force.imag, spin + (np.conj(arm) * force).imag], axis=1)


@pytest.mark.parametrize("kind", JOINTS)
def test_a_reaction_is_what_moves_the_body(kind):
    """Mass times acceleration is gravity and reaction; so is the turn about the point of b."""
    make, components = JOINTS[kind]
    scene = pi.Scene(gravity=(0.0, -G))
    bar = body(scene)
    joint = make(bar.at("end"), bar.at("other"))
    scene.add(joint)
    model = scene.build()
    name = next(name for name, part in scene.parts.items() if part is joint)
    run = pi.solve(model, 0.1, pi.GeneralizedAlpha(h=5e-3, tolerance=1e-12))
    expected = needed(run, model, bar, bar.at("end"))
    assert run.success and torsor(run, model, name, components) == pytest.approx(expected, abs=1e-8)
    assert run.wrench(name) == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("kind", ["rail", "slot", "hinge", "turning rail", "prismatic", "weld", "motor"])
def test_on_the_ground_it_is_what_the_ground_bears(kind):
    """Sides exchanged, the ground feels the opposite of what the body needs, about its own point."""
    scene = pi.Scene(gravity=(0.0, -G))
    bar = body(scene, angle=0.0)
    end, ground = bar.at("end"), pi.ground.at((1.0, 0.0))
    kinds = {"rail": Rail, "slot": pi.Slot, "hinge": Hinge, "prismatic": pi.Prismatic, "weld": pi.Weld}
    exchanged = kinds.get(kind) or (lambda a, b: (pi.AngleMotor if kind == "motor" else TurningRail)(a, b, WAVE))
    joint = exchanged(end, ground)
    scene.add(joint)
    model = scene.build()
    name = next(name for name, part in scene.parts.items() if part is joint)
    run = pi.solve(model, 0.1, pi.GeneralizedAlpha(h=5e-3, tolerance=1e-12))
    told = torsor(run, model, name, "fm" if kind == "hinge" else JOINTS[kind][1])
    told[:, 2] += cross(np.array([1.0, 0.0]) - run.position(end), told[:, :2])
    assert run.success and -told == pytest.approx(needed(run, model, bar, end), abs=1e-8)


INTEGRATORS = {"alpha": pi.GeneralizedAlpha(h=1e-2, tolerance=1e-12), "radau": pi.RadauIIA(h=2e-2)}
SLOPES = ("rail", "slot", "turning rail", "prismatic", "path", "distance", "motor")


@pytest.mark.parametrize("kind, method", [*((kind, "alpha") for kind in SLOPES), ("rail", "radau")])
def test_slopes_of_reactions(kind, method):
    make, components = JOINTS[kind]
    scene = pi.Scene(gravity=(0.0, -G))
    bar = body(scene)
    moves = {"turning rail": pi.profile.quintic(0.0, 0.5, 0.3), "motor": pi.profile.quintic(0.0, 0.5, 0.3)}
    end = bar.at("end")
    if kind == "path":
        joint = pi.PrescribedPosition(end, x=pi.profile.quintic(1.0, 1.4, 0.3), y=0.0)
    elif kind in moves:
        joint = (TurningRail if kind == "turning rail" else pi.AngleMotor)(AT, end, moves[kind])
    else:
        joint = make(end, bar.at("other"))
    scene.add(joint)
    scene.add(pi.PointMass(bar.at("other"), 0.5, name="load"))
    scene.add(pi.PointLoad(bar.at("other"), (3.0, -2.0), pi.profile.sine(1.0, 2.0, 0.4), name="push"))
    run = pi.solve(scene.build(), 0.06, INTEGRATORS[method])
    for unit in {"fm": ("N", "N m"), "m": ("N m",)}.get(components, ("N",)):
        errors = pi.check_gradient(run, pi.objective.PeakReaction(joint, p=2, unit=unit))
        assert errors and max(errors.values()) < 1e-5, (unit, errors)
