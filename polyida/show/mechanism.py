"""Supports, joints, springs, dampers, motors, loads and contacts of a scene as engineers draw them: lines and pins for every frame.

Places and lines are complex numbers x + iy, m, over frames. Symbols are as large as `size`; only what a part is made of has its own size:
the length of a spring, the radius of a disc, the reach of a rail.
"""

from typing import NamedTuple

import numpy as np

from polyida.assembly.build import own_sides
from polyida.body.body import Body, points_of
from polyida.body.plate import Plate
from polyida.body.rigid_body import PointMass
from polyida.force.controllers import Maxwell
from polyida.force.force_element import ForceElement, sides_of
from polyida.force.loads import EdgeTraction, Force, PointLoad, RotationElement
from polyida.force.springs import PenaltyContact, SpringDamper, TorsionSpring
from polyida.joint.contact import Clearance, Contact
from polyida.joint.joint import Joint
from polyida.joint.joints import AngleMotor, Clamp, Distance, PrescribedPosition, Prismatic, Revolute, RollingDisc, Skate, Slot, Weld
from polyida.validation import pairs_of

SYMBOL = 0.04  # size of a symbol, of the longer side of what is drawn
TURNS, SPIRAL, CIRCLE = 6, 2.5, 24  # of a spring and a torsion spring; corners of a circle
HATCHES = 5
TIMES = (0.0, 0.01, 0.1, 1.0)  # s, at which the direction of a force is looked for
TIP = 0.4  # length of the head of an arrow, of the symbol's size


class Symbols(NamedTuple):
    """What is drawn over frames: segments (frames, k, 2, 2) of supports and joints, and of forces, and the places (frames, pins, 2) of pins."""

    joints: np.ndarray
    forces: np.ndarray
    pins: np.ndarray


def symbols(parts, place, size, frames=1):
    """The Symbols of {name: part} and of bodies that are one point and hang on no joint.

    place(side, "point" or "direction") -> (frames,) complex, of an attachment or a place of the ground. size: of a symbol, m.
    """
    draw = _Pen(place, size, frames)
    joined = {id(side.body) for part in parts.values() if isinstance(part, Joint) for side in own_sides(part)}
    for name, part in parts.items():
        if isinstance(part, Body) and part.plate is None and id(part) not in joined:
            draw.lone(part)
        elif isinstance(part, (PointMass, PointLoad, EdgeTraction)):
            draw.on_a_point(part)
        elif isinstance(part, ForceElement):
            draw.force(name, part)
        elif isinstance(part, Joint):
            draw.joint(part)
    return draw.finished()


class _Pen:
    """Collects the lines of parts. lines: {"joints" or "forces": [(frames, corners) complex]}; pins: [(frames,) complex]."""

    def __init__(self, place, size, frames):
        """Make a pen without lines, for symbols of one size, m, over so many frames."""
        self.place = place  # function (side, "point" or "direction") -> (frames,) complex
        self.size = size  # of a symbol, m
        self.frames = frames
        self.lines = {"joints": [], "forces": []}
        self.pins = []

    def finished(self):
        """The Symbols of all lines and pins that were collected, each line as segments of two points."""
        segments = {}
        for kind, lines in self.lines.items():
            pieces = [np.stack([line[:, :-1], line[:, 1:]], axis=-1) for line in lines]
            found = np.concatenate([np.zeros((self.frames, 0, 2), complex), *pieces], axis=1)
            segments[kind] = pairs_of(found)
        pins = np.array(self.pins).T.reshape(self.frames, -1)
        return Symbols(segments["joints"], segments["forces"], pairs_of(pins))

    def lone(self, body):
        """Add a circle and its two diameters at the point of a body that has exactly one named point; nothing for other bodies."""
        points = points_of(body)
        if len(points) == 1:
            at, radius = self.place(points[0], "point"), 0.35 * self.size
            self.add("joints", self.circle(at, radius), self.line(at, -radius, radius), self.line(at, -1j * radius, 1j * radius))

    def on_a_point(self, part):
        """Draw a point mass as a disc, or a load on a point as an arrow."""
        at = self.place(part.at, "point")
        if isinstance(part, PointMass):
            self.add("joints", self.circle(at, 0.35 * self.size), self.line(at, -0.35 * self.size, 0.35 * self.size))
        else:
            self.arrow(at, complex(*(part.force if isinstance(part, PointLoad) else part.traction)))

    def joint(self, part):
        """Draw a joint; one of a user as a line between its places."""
        sides = list({id(side): side for side in own_sides(part)}.values())
        held = next((side for side in sides if side.body), None)
        if held is None:
            return
        sides = [side if side.body else side.facing(held) for side in sides]
        fixed = next((side for side in sides if side.body is None), None)
        if len(sides) == 2:
            self.between(part, sides, *np.broadcast_arrays(*(self.place(side, "point") for side in sides)), fixed)
        else:
            self.add("joints", np.stack(np.broadcast_arrays(*(self.place(side, "point") for side in sides)), axis=1))

    def between(self, part, sides, a, b, fixed):
        """Draw a joint between the places a and b (frames,); fixed: its side on the ground, or None."""
        ground = a if fixed is sides[0] else b
        if isinstance(part, (Slot, Prismatic)):
            self.rail(a, self.unit(sides[0]), b, hatched=fixed is sides[0], block=isinstance(part, Prismatic))
        elif isinstance(part, (Weld, Clamp)):
            self.fixing(ground if fixed else b, held=sides[1] if fixed is sides[0] else sides[0], fixed=fixed)
        elif isinstance(part, AngleMotor):
            self.turning(b if sides[1].body else a)
        elif isinstance(part, RollingDisc):
            self.add("joints", self.circle(b, part.radius), self.line(b, 0, part.radius * self.unit(sides[1])))
            self.surface(a, self.unit(sides[0]), b, part.circle, inward=part.circle is None, below=part.radius)
        elif isinstance(part, Contact):
            self.surface(b, self.unit(sides[1]) if part.radius is None and not sides[1].has_edges else None, a, part.radius)
            if part.disc:
                self.add("joints", self.circle(a, part.disc))
        elif isinstance(part, Clearance):
            self.add("joints", self.circle(a, max(self.size, part.gap)))
            self.pin(b)
        elif isinstance(part, Skate):
            along = self.size * self.unit(sides[1])
            self.add("joints", self.line(b, -along, along))
        elif isinstance(part, PrescribedPosition):
            self.arrow(b, complex(part.x is not None, part.y is not None), "joints")
        else:
            apart = isinstance(part, Distance) or np.abs(a - b).max() > 0.1 * self.size
            if apart:
                self.add("joints", np.stack([a, b], axis=1))
                self.pin(a)
            self.pin(b)
            if fixed and isinstance(part, (Revolute, Distance)):
                self.support(ground)

    def force(self, name, part):
        """Draw a force element by its kind: spring, damper, torque, contact, force; one of a user as a line between its places."""
        if isinstance(part, (SpringDamper, Maxwell)):
            a, b = np.broadcast_arrays(self.place(part.a, "point"), self.place(part.b, "point"))
            for fixed, place in ((part.a, a), (part.b, b)):
                if fixed.body is None:
                    self.support(place)
            self.spring(a, b, part.stiffness > 0.0, part.damping > 0.0)
        elif isinstance(part, TorsionSpring):
            self.spiral(self.place(part.b if part.b.body else part.a, "point"))
        elif isinstance(part, RotationElement):
            self.turning(self.place(part.at, "point"), "forces")
        elif isinstance(part, PenaltyContact):
            a, b = self.place(part.a, "point"), self.place(part.b, "point")
            self.surface(b, None if part.radius else self.unit(part.b), a, part.radius, inward=True)
        elif isinstance(part, Force):
            if not callable(part.force):  # the direction of a function of state is not known before the run
                forces = [complex(*(component(t) for component in part.force)) for t in TIMES]
                along = next((force for force in forces if force), -1j)
                self.arrow(self.place(part.at, "point"), along * self.unit(part.at) if part.follower else along)
        else:
            places = [self.of_side(side) for side in sides_of(name, part) if side.part == "point"]
            if len(places) > 1:
                self.add("forces", np.stack(np.broadcast_arrays(*places), axis=1))

    def of_side(self, side):
        """Place of a Side of a force element, (frames,) complex, m; (1,) for a place of the ground."""
        return np.array([complex(*side.rest)]) if side.at is None else self.place(side.at, "point")

    def unit(self, side):
        """Unit vector of a side's direction, (frames,) complex."""
        along = self.place(side, "direction")
        return along / np.abs(along)

    def add(self, kind, *lines):
        """Add lines, (frames, corners) complex each, to those of kind "joints" or "forces"."""
        self.lines[kind] += lines

    def pin(self, at):
        """Add a pin at a place, (frames,) complex, m."""
        self.pins.append(at)

    def line(self, at, *corners):
        """A line through corners relative to a place; a corner is a number or (frames,)."""
        return np.stack([at + corner for corner in corners], axis=1)

    def circle(self, at, radius, begin=0.0, end=2 * np.pi):
        """Return an arc of this radius, m, about the places `at` (frames,) complex, from the angle begin to end, rad; default: a circle.

        It has (frames, CIRCLE) complex corners, m. Nothing is drawn.
        """
        return at[:, None] + radius * np.exp(1j * np.linspace(begin, end, CIRCLE))

    def hatch(self, begin, end, side):
        """Short lines from begin to end on a side, which is a unit vector over frames or a number."""
        along = end - begin
        step = 0.35 * self.size
        count = int(np.clip(np.ceil(np.abs(along).max() / step), HATCHES, 60))
        for k in range(count):
            foot = begin + along * (k + 0.75) / count
            back = -step * along / np.maximum(np.abs(along), 1e-300)
            self.add("joints", np.stack([foot, foot + back + step * side], axis=1))

    def support(self, at):
        """Draw a hatched bearing below a pin at a place, (frames,) complex."""
        foot = self.size * np.array([-0.6 - 1j, 0.6 - 1j])
        self.add("joints", self.line(at, foot[0], 0, foot[1]), self.line(at, *(1.5 * foot.real + 1j * foot.imag)))
        self.hatch(at + 1.5 * foot[0].real - 1j * self.size, at + 1.5 * foot[1].real - 1j * self.size, -1j)
        self.pin(at)

    def fixing(self, at, held, fixed):
        """Draw a hatched wall behind a clamped body, or a square between two bodies."""
        if fixed is None:
            s = 0.4 * self.size
            self.add("joints", self.line(at, s + 1j * s, -s + 1j * s, -s - 1j * s, s - 1j * s, s + 1j * s))
            return
        middle = complex(*_middle(held.body)) - complex(*held.point)
        away = -middle / abs(middle) if middle else -1j
        half = 1j * away * max(1.2 * self.size, 0.75 * held.length)
        self.add("joints", self.line(at, -half, half))
        self.hatch(at - half, at + half, away)

    def rail(self, a, along, b, hatched, block):
        """Draw a rail through a that reaches as far as b goes, and the slider on it."""
        s = ((b - a) * along.conj()).real
        low, high = s.min() - 2.5 * self.size, s.max() + 2.5 * self.size
        under = (-0.5j * along) * self.size
        self.add("joints", np.stack([a + under + low * along, a + under + high * along], axis=1))
        if hatched:
            self.hatch(a + under + low * along, a + under + high * along, -1j * along)
        else:
            self.add("joints", np.stack([a - under + low * along, a - under + high * along], axis=1))
        corners = (0.9 + 0.5j, -0.9 + 0.5j, -0.9 - 0.5j, 0.9 - 0.5j, 0.9 + 0.5j)
        if block:
            self.add("joints", np.stack([b + self.size * along * corner for corner in corners], axis=1))
        self.pin(b)

    def surface(self, at, along, other, radius=None, inward=False, below=0.0):
        """What a point or a disc touches: a circle, or a hatched line that reaches as far as the other side goes."""
        if radius is not None:
            self.add("joints", self.circle(at, radius))
        elif along is not None:
            s = ((other - at) * along.conj()).real
            low, high = min(s.min(), 0.0) - 3.0 * self.size, max(s.max(), 0.0) + 3.0 * self.size
            begin, end = np.broadcast_arrays(at + low * along, at + high * along)
            self.add("joints", np.stack([begin, end], axis=1))
            above = np.sign(((other - at) * along.conj()).imag.sum()) or 1.0
            self.hatch(begin, end, -1j * along * above)

    def spring(self, a, b, stiff, damped):
        """Add lines from a to b, (frames,) complex, m: a zigzag if stiff, else a dashpot, both beside each other if stiff and damped."""
        along = b - a
        length = np.abs(along)
        unit = np.where(length > 0.0, along / np.maximum(length, 1e-300), 1.0)
        beside = 0.7j * unit * self.size if stiff and damped else 0j * unit
        if stiff:
            places = np.concatenate([[0.0, 0.2], 0.2 + 0.6 * (np.arange(2 * TURNS) + 0.5) / (2 * TURNS), [0.8, 1.0]])
            swings = np.concatenate([[0.0, 0.0], 0.5 * (-1.0) ** np.arange(2 * TURNS), [0.0, 0.0]])
            self.add("forces", (a + beside)[:, None] + along[:, None] * places + self.size * 1j * unit[:, None] * swings)
        if damped or not stiff:
            start = a - beside
            half = 0.4j * unit * self.size
            self.add("forces", np.stack([start, start + 0.55 * along], axis=1))
            self.add("forces", np.stack([start + 0.55 * along - 0.8 * half, start + 0.55 * along + 0.8 * half], axis=1))
            cup = [start + 0.65 * along + half, start + 0.35 * along + half, start + 0.35 * along - half, start + 0.65 * along - half]
            self.add("forces", np.stack([cup[0], start + 0.65 * along + half, start + 0.65 * along - half, cup[3]], axis=1))
            self.add("forces", np.stack(cup[:2], axis=1), np.stack(cup[2:], axis=1))
            self.add("forces", np.stack([start + 0.65 * along, start + along], axis=1))
        if stiff and damped:
            self.add("forces", np.stack([a + beside, a - beside], axis=1), np.stack([b + beside, b - beside], axis=1))

    def spiral(self, at):
        """Draw a torsion spring as a spiral around a place, (frames,) complex."""
        angles = np.linspace(0.0, 2 * np.pi * SPIRAL, int(SPIRAL * CIRCLE))
        self.add("forces", at[:, None] + self.size * angles / angles[-1] * np.exp(1j * angles))

    def turning(self, at, kind="joints"):
        """Draw an arc with an arrowhead around a place, (frames,) complex, for a moment or a motor."""
        radius, end = 1.1 * self.size, 1.6 * np.pi
        self.add(kind, self.circle(at, radius, 0.2 * np.pi, end))
        self.head(kind, at + radius * np.exp(1j * end), 1j * np.exp(1j * end))

    def arrow(self, at, force, kind="forces"):
        """An arrow that ends at a place in the direction of a force, which is a number or (frames,); zero is drawn downwards."""
        along = np.where(force == 0, -1j, force / np.maximum(np.abs(force), 1e-300)) * np.ones(len(at))
        self.add(kind, self.line(at, -3.0 * self.size * along, 0))
        self.head(kind, at, along)

    def head(self, kind, at, along):
        """Draw the head of an arrow of a kind that ends at a place in the direction of the unit vector `along`, both complex."""
        back = -TIP * self.size * along
        self.add(kind, self.line(at, back * (1 + 0.6j), 0, back * (1 - 0.6j)))


def _middle(body):
    """Mean point (2,), m, of a body in the drawing: of its nodes, or of its named points."""
    plate = body if isinstance(body, Plate) else body.plate
    return np.mean(plate.points if plate is not None else [at.point for at in points_of(body)], axis=0)
