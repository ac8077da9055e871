"""Closed curves of DXF drawings, by ezdxf: what the layers show, with blocks in their places."""

import logging
import threading
from collections import Counter

import numpy as np

from polyida.errors import InputError
from polyida.mesh.raw import counted
from polyida.mesh.svg import CHORDS, GAP
from polyida.validation import library

MOST = 200_000  # entities, with those of all blocks in all their places


def dxf_library():
    """Return ezdxf. Raise InputError if it is not installed."""
    return library("ezdxf", "it needs ezdxf: pip install 'polyida[mesh]'")


def read_dxf(path, part):
    """(rings, metres in one unit or None, notes) of the model space, or of its layer `part`."""
    dxf_library()
    from ezdxf import readfile, units

    log, others = logging.getLogger("ezdxf"), _OtherThreads()  # it quotes bytes that are no letters; errors come as exceptions
    log.addFilter(others)
    try:
        document = readfile(path)
        _require_few(document)
        drawing = _Shown(document, part)
    finally:
        log.removeFilter(others)
    entities, hidden, skipped = drawing.entities, drawing.hidden, drawing.skipped
    layers = sorted({layer for _, layer in entities})
    if part is not None and part not in layers:
        raise InputError(f"has nothing on the layer {part!r}; there are {', '.join(map(repr, layers)) or 'none'}")
    curves = []
    for entity, layer in entities:
        if part in (None, layer):
            pieces = _curves_of(entity)
            curves += pieces
            skipped[entity.dxftype()] += not pieces
    rings, unused = _rings(curves)
    notes = [f"left out {count} {kind}" for kind, count in skipped.items() if count]
    notes += [f"left out {counted(unused, 'open curve')}"] if unused else []
    if hidden:
        where = ", ".join(f"{count} on {layer!r}" for layer, count in sorted(hidden.items()))
        notes.append(f"left out what is frozen, switched off or invisible: {where}")
    return rings, units.conversion_factor(document.units, units.M) if document.units else None, tuple(notes)


class _OtherThreads(logging.Filter):
    """Drops the messages of this thread."""

    def __init__(self):
        """Make a filter that drops the log messages of the thread that calls this."""
        super().__init__()
        self.thread = threading.get_ident()

    def filter(self, record):
        """True for a log record of another thread, which is kept."""
        return record.thread != self.thread


def _require_few(document):
    """Raise InputError if a block holds itself, or if all blocks in all their places have more than MOST entities."""
    totals, open_blocks = {}, set()

    def total_of(name):
        """The number of entities of a block with those of the blocks within it, counted once."""
        key = str(name).lower()
        if key in open_blocks:
            raise InputError(f"the block {name!r:.80} holds itself")
        if key not in totals:
            open_blocks.add(key)
            block = document.blocks.get(name)
            totals[key] = 0 if block is None else total(block)
            open_blocks.discard(key)
        return totals[key]

    def total(entities):
        """The number of entities with those of the blocks that they place."""
        count = 0
        for entity in entities:
            count += 1
            if entity.dxftype() == "INSERT":
                count += entity.mcount * (1 + total_of(entity.dxf.name))
            elif entity.dxftype() == "DIMENSION":
                count += total_of(entity.dxf.get("geometry", ""))
        return count

    count = total(document.modelspace())
    if count > MOST:
        raise InputError(f"has {count:.4g} entities with those of its blocks in all their places; at most {MOST} can be read")


class _Shown:
    """What the layers of a drawing show, each entity with its layer; the layer `part` is shown because it was asked for.

    hidden: {layer: number of entities left out}; skipped: {kind: number of entities that cannot be read}.
    """

    def __init__(self, document, part):
        """Collect what the model space of a document shows."""
        self.document = document
        self.part = part
        self.entities, self.hidden, self.skipped = [], Counter(), Counter()
        self._take(document.modelspace(), None)

    def _take(self, entities, layer_of_block):
        """Add the entities that their layers show, and those of the blocks among them; layer_of_block: of what stands on layer 0."""
        from ezdxf.protocols import SupportsVirtualEntities, virtual_entities

        for entity in entities:
            layer = entity.dxf.layer
            if layer == "0" and layer_of_block is not None:  # within a block, the layer of its place
                layer = layer_of_block
            frozen, off = self._state(layer)
            is_block = entity.dxftype() == "INSERT"
            if entity.dxf.get("invisible", 0) or frozen or (off and not is_block):  # switched off, a block shows its other layers
                self.hidden[layer] += 1
            elif is_block:
                self._take_block(entity, layer)
            elif isinstance(entity, SupportsVirtualEntities):
                self._take(virtual_entities(entity), layer)
            else:
                self.entities.append((entity, layer))

    def _take_block(self, entity, layer):
        """Add what a block shows in each of its places; one of another file is skipped."""
        block = entity.block()
        if block is None or block.block_record.is_xref:
            self.skipped["INSERT of another file" if block is not None else "INSERT without its block"] += 1
            return
        for insert in entity.multi_insert() if entity.mcount > 1 else [entity]:
            self._take(insert.virtual_entities(skipped_entity_callback=self._cannot_be_placed), layer)

    def _cannot_be_placed(self, entity, reason):
        """Count an entity of a block that ezdxf cannot place as skipped, by its DXF type; a callback of ezdxf."""
        self.skipped[entity.dxftype()] += 1

    def _state(self, layer):
        """(True if a layer is frozen, True if it is switched off); both False for the chosen layer and for an unknown one."""
        if layer == self.part or not self.document.layers.has_entry(layer):
            return False, False
        entry = self.document.layers.get(layer)
        return entry.is_frozen(), entry.is_off()


def _curves_of(entity):
    """Points (n, 2) of each curve of an entity; none if it is of another kind."""
    kind = entity.dxftype()
    if kind in ("LWPOLYLINE", "POLYLINE"):
        if kind == "LWPOLYLINE" and not entity.has_arc:
            points = [*entity.vertices_in_wcs()]
            points += points[:1] if entity.closed else []
        else:
            return [curve for piece in entity.virtual_entities() for curve in _curves_of(piece)]
    elif kind == "LINE":
        points = [entity.dxf.start, entity.dxf.end]
    elif kind == "CIRCLE":
        points = entity.vertices(np.linspace(0.0, 360.0, 4 * CHORDS + 1))
    elif kind == "ARC":
        points = entity.vertices(entity.angles(2 * CHORDS))
    elif kind == "ELLIPSE":
        points = entity.vertices(entity.params(4 * CHORDS + 1))
    elif kind == "SPLINE":
        points = entity.construction_tool().approximate(4 * CHORDS)
    else:
        return []
    return [np.array([[point[0], point[1]] for point in map(tuple, points)], dtype=float).reshape(-1, 2)]


def _rings(curves):
    """(closed curves, number of open ones left out): curves that are closed, and those that join at their ends."""
    from ezdxf import edgeminer

    curves = [curve for curve in curves if len(curve) > 1]
    gap = GAP * float(np.ptp(np.concatenate(curves), axis=0).max()) if curves else 0.0
    closed = [np.hypot(*(curve[0] - curve[-1])) <= gap for curve in curves]
    rings = [curve for curve, ring in zip(curves, closed) if ring]
    edges = [edgeminer.make_edge(curve[0], curve[-1], payload=curve) for curve, ring in zip(curves, closed) if not ring]
    unused = len(edges)
    for chain in edgeminer.find_all_simple_chains(edgeminer.Deposit(edges, gap_tol=gap)) if edges else ():
        if edgeminer.is_loop(chain, gap_tol=gap):
            rings.append(np.concatenate([(edge.payload[::-1] if edge.is_reverse else edge.payload)[:-1] for edge in chain]))
            unused -= len(chain)
    return rings, unused
