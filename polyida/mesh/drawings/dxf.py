"""Closed curves of DXF drawings, through ezdxf: circles, ellipses, splines, and polylines, lines and arcs that join to rings."""

import logging
from collections import Counter
from contextlib import contextmanager

import numpy as np

from polyida.errors import InputError
from polyida.mesh.drawings.drawing import CHORDS, Drawing, library
from polyida.mesh.files.guarded import guarded
from polyida.mesh.files.repair import several

GAP = 1e-6  # of the drawing's size, that ends of one ring may be apart


def read(path, part):
    """Drawing of the model space, or of what is there on the layer `part`."""
    library("ezdxf")
    from ezdxf import readfile, units
    from ezdxf.disassemble import recursive_decompose

    with guarded(path.stat().st_size), _unheard("ezdxf"):
        document = readfile(path)
        entities = list(recursive_decompose(document.modelspace()))
    layers = sorted({entity.dxf.layer for entity in entities})
    if part is not None and part not in layers:
        raise InputError(f"has nothing on the layer {part!r}; there are {', '.join(map(repr, layers)) or 'none'}")
    curves, skipped = [], Counter()
    for entity in (entity for entity in entities if part in (None, entity.dxf.layer)):
        found = _curves(entity)
        curves += found
        skipped[entity.dxftype()] += not found
    notes = [f"left out {count} {kind}" for kind, count in skipped.items() if count]
    rings, left = _joined(curves)
    notes += [f"left out {several(left, 'open curve')}"] if left else []
    metres = units.conversion_factor(document.units, units.M) if document.units else None
    return Drawing(rings, metres, tuple(notes))


@contextmanager
def _unheard(name):
    """Without what a library logs: it quotes bytes of the file that are no letters, and what matters comes back as an exception."""
    log = logging.getLogger(name)
    before, log.disabled = log.disabled, True
    try:
        yield
    finally:
        log.disabled = before


def _curves(entity):
    """[(n, 2)] of the pieces of an entity, none where it is no curve."""
    kind = entity.dxftype()
    if kind in ("LWPOLYLINE", "POLYLINE"):
        return [curve for piece in entity.virtual_entities() for curve in _curves(piece)]
    if kind == "LINE":
        return [_plane([entity.dxf.start, entity.dxf.end])]
    if kind == "CIRCLE":
        return [_plane(entity.vertices(np.linspace(0.0, 360.0, 4 * CHORDS + 1)))]
    if kind == "ARC":
        return [_plane(entity.vertices(entity.angles(2 * CHORDS)))]
    if kind == "ELLIPSE":
        return [_plane(entity.vertices(entity.params(4 * CHORDS + 1)))]
    return [_plane(entity.construction_tool().approximate(4 * CHORDS))] if kind == "SPLINE" else []


def _plane(points):
    return np.array([[point[0], point[1]] for point in map(tuple, points)], dtype=float)


def _joined(curves):
    """(rings (n, 2), number of curves that are part of none)."""
    from ezdxf import edgeminer

    if not curves:
        return [], 0
    gap = GAP * float(np.ptp(np.concatenate(curves), axis=0).max())
    rings = [curve for curve in curves if np.hypot(*(curve[0] - curve[-1])) <= gap]
    open_ones = [curve for curve in curves if np.hypot(*(curve[0] - curve[-1])) > gap]
    edges = [edgeminer.make_edge(curve[0], curve[-1], payload=curve) for curve in open_ones]
    left = len(open_ones)
    if not edges:
        return rings, 0
    for chain in edgeminer.find_all_simple_chains(edgeminer.Deposit(edges, gap_tol=gap)):
        if edgeminer.is_loop(chain, gap_tol=gap):
            rings.append(np.concatenate([(edge.payload[::-1] if edge.is_reverse else edge.payload)[:-1] for edge in chain]))
            left -= len(chain)
    return rings, left
