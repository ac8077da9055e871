"""Joints that are added in motion: their rows take from the present places of the bodies what other joints take from the drawing."""

from copy import copy
from dataclasses import fields, replace

import numpy as np

from polyida.joint.attachment import Attachment
from polyida.joint.formula import all_rows
from polyida.validation import pairs_of, settle


def held_at(joint, place):
    """The joint as added where its sides are now, with the sides of the drawing; place((side, "point" or "direction")): complex, of now.

    Plain `ground` is the present place of the other side. Rows of directions alone hold at their present value, rows of places as they are
    written.
    """
    now, held = copy(joint), copy(joint)
    for field in fields(joint):
        if isinstance(side := getattr(now, field.name), Attachment):
            settle(now, **{field.name: _moved(side, place)})
    facing = now.facing()
    for name in ("a", "b"):
        settle(held, **{name: getattr(getattr(facing, name), "drawn", getattr(facing, name))})
    rows, number = [_held(row, place) for row in all_rows(facing)], sum(row.rate is not True for row in all_rows(facing))
    settle(held, rows=lambda: rows[:number], velocity_rows=lambda: rows[number:])
    return held


def _moved(side, place):
    """An attachment whose place at rest is the present one; drawn: the attachment itself."""
    here = {"point": pairs_of(place((side, "point")))}
    if side.has_direction:
        here["direction"] = pairs_of(place((side, "direction")))
    kind = type(type(side).__name__, (type(side),), here | {"drawn": side, "each": lambda own: [_moved(one, place) for one in side.each()]})
    other = object.__new__(kind)
    other.__dict__.update(vars(side))
    return other


def _held(row, place):
    """The row on the attachments of the drawing."""

    def drawn(summand):
        return replace(summand, terms=tuple((getattr(side, "drawn", side), part, w) for side, part, w in summand.terms))

    products = tuple(replace(one, rotated=drawn(one.rotated), unrotated=drawn(one.unrotated)) for one in row.products)
    held = replace(row, products=products)
    parts = {part for one in products for summand in (one.rotated, one.unrotated) for _, part, _ in summand.terms}
    if row.rate or row.driven or parts != {"direction"}:
        return held
    at = lambda side, part: place((side, part))  # noqa: E731
    value = row.constant + sum((np.conj(one.rotated.at(at)) * one.unrotated.at(at)).real for one in products)
    return replace(held, constant=row.constant - value)
