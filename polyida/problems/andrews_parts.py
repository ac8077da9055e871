"""Andrews' squeezing mechanism made of parts: seven rigid bodies, ten pins, a spring and a torque.

Bodies K1 to K7 have the lengths and masses of `polyida.problems.andrews`, pins at (0, 0), A and B on the ground; all but K1 and K3 hang
together in three loops. Each body's own axes are turned by the angle of its first direction in the equations: beta (K1), beta + Theta
(K2), gamma (K3), Phi + delta (K4), delta (K5), Omega + epsilon (K6), epsilon (K7); the drawing has their published values at the start.

The mechanism and its figures: Schiehlen (ed.), Multibody Systems Handbook (1990); Hairer and Wanner, Solving Ordinary Differential
Equations II, VII.7; IVP test set.
"""

import numpy as np

from polyida.body.rigid_body import RigidBody
from polyida.force.elements import SpringDamper, Torque
from polyida.joint.attachment import ground
from polyida.joint.joints import Revolute
from polyida.problems import Problem
from polyida.problems import andrews as given
from polyida.problems.about import ABOUT
from polyida.problems.andrews import DIGITS, KNOWN_TO
from polyida.scene import Scene

BODIES = {  # mass, inertia, centre of mass, pins and other points, in own axes from the first of them, m; E joins K2, K3, K4 and K6
    "K1": (given.m1, given.I1, (given.ra, 0.0), {"O": (0.0, 0.0), "P": (given.rr, 0.0)}),
    "K2": (given.m2, given.I2, (-given.da, 0.0), {"P": (0.0, 0.0), "E": (-given.d, 0.0)}),
    "K3": (given.m3, given.I3, (given.sb, -given.sa), {"B": (0.0, 0.0), "E": (0.0, -given.ss), "D": (given.sd, -given.sc)}),
    "K4": (given.m4, given.I4, (0.0, -given.h), {"G": (0.0, 0.0), "E": (0.0, -given.e)}),
    "K5": (given.m5, given.I5, (given.ta, -given.tb), {"A": (0.0, 0.0), "G": (given.zt, 0.0)}),
    "K6": (given.m6, given.I6, (given.k, 0.0), {"H": (0.0, 0.0), "E": (given.zf, 0.0)}),
    "K7": (given.m7, given.I7, (given.ub, -given.ua), {"A": (0.0, 0.0), "H": (0.0, -given.u)}),
}
GROUND = {"K1": "O", "K3": "B", "K5": "A", "K7": "A"}
PINS = (("K1", "K2", "P"), ("K2", "K3", "E"), ("K2", "K4", "E"), ("K2", "K6", "E"), ("K4", "K5", "G"), ("K6", "K7", "H"))
GYRATION = np.array([np.sqrt(inertia / mass) for mass, inertia, *_ in BODIES.values()])  # m, the unit of their turn in q
ANGLES = given.TURNS @ given.Q0  # of the bodies at the start, rad


def places():
    """The pin that each body's axes begin at, at the start, complex, m."""
    z, A = np.exp(1j * ANGLES), complex(given.xa, given.ya)
    return {"O": 0j, "A": A, "B": complex(given.xb, given.yb), "P": given.rr * z[0], "G": A + given.zt * z[4], "H": A - 1j * given.u * z[6]}


def andrews():
    """Bodies "K1" to "K7", torque "drive" on K1, "spring" from the ground to the point D of K3, at the published start."""
    scene, at, bodies = Scene(), {pin: (place.real, place.imag) for pin, place in places().items()}, {}
    for (name, (mass, inertia, center, points)), angle in zip(BODIES.items(), ANGLES):
        body = RigidBody(mass, inertia, points, origin=at[next(iter(points))], angle=angle, center=center, name=name)
        bodies[name] = scene.add(body)
    for name, pin in GROUND.items():
        scene.add(Revolute(ground.at(at[pin]), bodies[name].at(pin), name=f"{pin} of {name}"))
    for one, other, pin in PINS:
        scene.add(Revolute(bodies[one].at(pin), bodies[other].at(pin), name=f"{pin} of {one} and {other}"))
    scene.add(SpringDamper(ground.at((given.xc, given.yc)), bodies["K3"].at("D"), stiffness=given.c0, length=given.l0, name="spring"))
    scene.add(Torque(bodies["K1"].at("O"), given.mom, name="drive"))
    return scene


def directions(q):
    """What q (..., 28), or v, adds to the directions, of length one, of the seven bodies, complex, (..., 7)."""
    return q.reshape(*q.shape[:-1], 7, 2, 2)[..., 1, :] @ (1, 1j) / GYRATION


def angles(run):
    """(beta, Theta, gamma, Phi, delta, Omega, epsilon) in every frame, (frames, 7), rad; frames must be less than half a turn apart."""
    z = np.exp(1j * ANGLES) + directions(run.q[:])
    return np.linalg.solve(given.TURNS, np.unwrap(np.angle(z), axis=0).T).T


def rates(run):
    """Their rates in every frame, (frames, 7), rad/s."""
    z = np.exp(1j * ANGLES) + directions(run.q[:])
    return np.linalg.solve(given.TURNS, (z.conj() * directions(run.v[:])).imag.T).T


def at_end(run):
    """The angles at the end of a run, whose frames may be few: whole turns are those of the reference."""
    found, known = angles(run)[-1], np.array(DIGITS["q"])
    return found + 2 * np.pi * np.round((known - found) / (2 * np.pi))


def problem():
    """Andrews' mechanism made of seven rigid bodies, 0.03 s from rest."""
    return Problem(
        name="andrews-parts",
        model=andrews().build(),
        q0=None,
        v0=None,
        t_end=0.03,
        reference={"angles": np.array(DIGITS["q"]), "rates": np.array(DIGITS["v"])},
        known_to={"angles": KNOWN_TO["q"], "rates": KNOWN_TO["v"]},
        measures={"angles": at_end, "rates": lambda run: rates(run)[-1]},
        **ABOUT["andrews-parts"],
    )
