"""Closing of loops: bodies are moved as rigid, by as little as closes them, from a nearby drawing onto their joints."""

from dataclasses import dataclass

import numpy as np

from polyida.assembly.build import of_kind
from polyida.assembly.closing.loops import Loops
from polyida.assembly.closing.placed import Placed, places_of
from polyida.body.body import Body
from polyida.body.plate import Plate
from polyida.errors import InputError
from polyida.given import pairs_of
from polyida.joint.joint import Joint

STILL = 1e-13  # of the scene's size: moves that are round-off
NAMED = 3  # bodies that a message names


@dataclass(frozen=True, eq=False)
class Assembly:
    """By how much `scene.assemble()` moved the bodies, each as rigid: shift, {name: m} of its centre, turn, {name: rad}.

    largest: the longest way that a point of a body went, m. gap: the widest that was open before, m, and `open` the joint it was in,
    empty where all were closed.
    """

    shift: dict[str, float]
    turn: dict[str, float]
    largest: float
    gap: float
    open: str

    def summary(self) -> str:
        """One line: what was open, and who moved by how much."""
        moved = [name for name in self.shift if self.shift[name] or self.turn[name]]
        if not moved:
            return "all joints are closed as drawn; nothing moved"
        each = ", ".join(f"{name!r} by {self.shift[name]:.3g} m and {self.turn[name]:.3g} rad" for name in moved)
        return f"joints are closed; {self.open!r} was open by {self.gap:.3g} m; moved {each}"


def close(parts, held=()):
    """Move the bodies of {name: part} onto the rows of its joints, those that are driven at t = 0; an Assembly.

    Raises InputError, with every body where it was drawn, naming the joints that stay open, or bodies that would have to move and are
    held, by name.
    """
    known = of_kind(parts, Plate, Body)
    size = float(np.ptp(pairs_of(np.concatenate([places_of(body) for body in known.values()])), axis=0).max()) or 1.0
    bodies = [Placed(name, body, size) for name, body in known.items()]
    loops = Loops(parts, [body for body in bodies if body.part], size)
    x, drawn, left = loops.solve()
    loops.require_closed(x, drawn, left)
    moves = dict.fromkeys(known, (0.0, 0.0, 0.0)) | _moved(parts, loops, x, held)
    shift, turn, ways = ({name: move[k] for name, move in moves.items()} for k in range(3))
    gap = float(drawn.max(initial=0.0))
    return Assembly(shift, turn, max(ways.values(), default=0.0), gap, loops.names[drawn.argmax()] if gap else "")


def _moved(parts, loops, x, held):
    """{name: (shift, m, turn, rad, longest way of a point, m)} of the bodies that are moved, those by more than round-off."""
    chosen = [(body, move) for body, move in zip(loops.bodies, x) if np.abs(move).max() > STILL]
    if stuck := [body.name for body, _ in chosen if body.name in held]:
        raise InputError(
            f"Scene.assemble: {', '.join(map(repr, stuck[:NAMED]))} would have to move, but there is a model of the scene, whose runs "
            "would move along; assemble before build, or draw the scene anew"
        )
    for body, _ in chosen:
        if others := [other.name for other in loops.bodies if other is not body and other.part is body.part]:
            raise InputError(
                f"Scene.assemble: {body.name!r} would have to move, but it is made of one plate with {', '.join(map(repr, others[:NAMED]))}; "
                "give each a plate of its own"
            )
    before = [(body, body.placement) for body, _ in chosen]
    for joint in of_kind(parts, Joint).values() if chosen else ():
        joint.keep_drawing()
    try:
        moves = {body.name: loops.place(body, *move) for body, move in chosen}
        Loops(parts, loops.bodies, loops.size).require_closed_as_drawn()
    except InputError:
        for body, placement in before:
            body.settle(*placement)
        raise
    return moves
