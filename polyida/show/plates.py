"""Geometry and stress of a run's bodies in each frame, from which pictures and exports are drawn. Positions are in m."""

import numpy as np

from polyida.errors import InputError
from polyida.reprs import cut
from polyida.validation import is_flag, is_whole

EVENT_FRAMES, EVENT_TEXT = 5, 30  # frames that show the name of an event; characters of names


def require_run(part, run, overwrite):
    """Raise InputError in the name of `part` unless `run` is a run with frames and `overwrite` is True or False."""
    if not hasattr(run, "model") or not hasattr(run, "node_positions"):
        raise InputError(f"{part}: {type(run).__name__} is no run; give what solve or load returns")
    if run.model is None:
        raise InputError(f"{part}: {run.missing}; the run that was loaded has no plates")
    if len(run.t) == 0:
        raise InputError(f"{part}: the run has no frames")
    if not is_flag(overwrite):
        raise InputError(f"{part}: overwrite = {overwrite!r} must be True or False")


def bodies(model):
    """The plates of a scene's model, also reduced and rigid ones. Raises InputError for a model without anything to draw."""
    if not drawable(model):
        raise InputError(f"{type(model).__name__} has no plates to draw: only the model of a scene has")
    return model.drawn


def drawable(model):
    """True if a model has anything to draw."""
    return model is not None and bool(model.drawn or len(model.sticks(np.zeros(model.n))))


def sticks(run, k):
    """Segments (segments, 2, 2) of the bodies without a mesh in frame k."""
    return run.model.sticks(np.asarray(run.q[k], float))


def places(run, k):
    """All points that are drawn in frame k, (points, 2)."""
    return np.concatenate([run.node_positions(k), sticks(run, k).reshape(-1, 2)])


def connectivity(model):
    """Corner nodes of the cells of all plates, with common node numbers, and offsets (cells + 1,) of the cells."""
    nodes, offsets, last = [np.zeros(0, int)], [np.zeros(1, int)], 0
    for body in bodies(model):
        nodes.append(body.mesh.nodes.astype(int) + body.nodes.start)
        offsets.append(body.mesh.offsets[1:].astype(int) + last)
        last += len(body.mesh.nodes)
    return np.concatenate(nodes), np.concatenate(offsets)


def polygons(model, positions):
    """Corners (corners, 2) of every cell as a list, at node positions (nodes, 2)."""
    nodes, offsets = connectivity(model)
    return np.split(positions[nodes], offsets[1:-1]) if len(nodes) else []


def outlines(model, positions):
    """Boundary edges of all plates as segments (edges, 2, 2)."""
    return positions[edges(model)]


def edges(model):
    """Nodes of the boundary edges of all plates, (edges, 2)."""
    return np.concatenate([np.zeros((0, 2), int), *(body.mesh.boundary_edges + body.nodes.start for body in bodies(model))])


def closed(model):
    """As `connectivity`, with the first corner of every cell repeated after its last."""
    nodes, offsets = connectivity(model)
    return np.insert(nodes, offsets[1:], nodes[offsets[:-1]]), offsets + np.arange(len(offsets))


def frames_at(run, times):
    """Index of the frame nearest to each time, (times,); of equally near frames the first."""
    times, t = np.asarray(times, float), run.t
    after = np.clip(np.searchsorted(t, times), 1, max(1, len(t) - 1)).clip(max=len(t) - 1)
    before = np.maximum(after - 1, 0)
    return np.searchsorted(t, np.where(times - t[before] <= t[after] - times, t[before], t[after]))


def spread(run, count):
    """At most `count` different frames evenly spread in time, the first and the last among them."""
    if not is_whole(count):
        raise InputError(f"frames = {count!r} must be a whole number, at least 1")
    return np.unique(frames_at(run, np.linspace(run.t[0], run.t[-1], count)))


def clock(run, frames):
    """The text of each frame: its time, and the names of the events of the last EVENT_FRAMES frames, each once, newest first."""
    names = [{} for _ in frames]
    for event in reversed(run.events):
        first = np.searchsorted(frames, min(event.frame, frames[-1]))
        for shown in names[first : first + EVENT_FRAMES]:
            shown[event.name] = None
    texts = [f", {cut(', '.join(shown), EVENT_TEXT)}" if shown else "" for shown in names]
    return [f"t = {run.t[k]:.3f} s{text}" for k, text in zip(frames, texts)]
