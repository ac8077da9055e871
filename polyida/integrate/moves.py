"""Moves of motors and loads that an integrator would step over: looked for between its steps, before they are taken.

A cell is the longest step that may be taken, sampled at nine points or more. A profile moves too fast for one step where it
bends away from its chord by SHARP of its range in the next few cells, or where a motor turns by more than TURN: phi cannot
tell an angle from one a full turn away, nor Newton's method one beyond a half-turn. Such a cell is taken in eight parts,
and so on, down to 8^-DEPTH. Found is what lasts as long as the samples are apart; ready-made loads say how long they take
and need no look.
"""

from typing import NamedTuple

import numpy as np

from polyida.profile import Profile

PARTS, DEPTH = 8, 4
SHARP, NOISE = 0.3, 1e-6
TURN = 1.5  # rad in a step
CONTINUOUS = 1e-6  # of an angle and 1 rad: less than that from one side of a kink to the other is round-off
AHEAD, CHUNK = 5, 256  # cells that a bend is compared with; that are looked at together
SAMPLES = 4096  # of a run, at least, where an integrator chooses its own steps, of cells an eighth of it


class Part(NamedTuple):
    """From begin to end no step longer than `most`, where that is finite; jump: why there is no step short enough, else empty."""

    begin: float
    end: float
    most: float
    jump: str = ""


class Look(NamedTuple):
    """A profile that is looked at. unit: "rad" where it turns rows of phi, "m" where it shifts them, empty where it is a load's."""

    name: str
    profile: Profile
    unit: str

    @property
    def motor(self):
        """Whether it drives phi."""
        return bool(self.unit)

    def values(self, times):
        """Its values at an array of times."""
        return self.profile.over(times)


def parts(model, begin, end, h, fine=PARTS, now=-np.inf):
    """Yield the Parts of the time between two kinks, for steps of h and shorter; `fine` samples in each.

    now: what ends before this time need not be looked at.
    """
    looks = _looks(model, h)
    jump = _jump_at(model, looks, end)
    if jump:
        yield from _smooth_parts(looks, begin, max(begin, end - h), h, fine, now)
        yield Part(max(begin, end - h), end, np.inf, jump)
    else:
        yield from _smooth_parts(looks, begin, end, h, fine, now)


def _smooth_parts(looks, begin, end, h, fine, now):
    if end - begin <= h:  # what is left of a load's pulse between two kinks is `enough_steps`' to see
        looks = [look for look in looks if look.motor]
    done = begin
    for part in _merged(_fast(looks, begin, end, h, fine, now)) if looks else ():
        if part.begin > done:
            yield Part(done, part.begin, np.inf)
        yield part
        done = part.end
    if done < end:
        yield Part(done, end, np.inf)


def _jump_at(model, looks, t):
    """In words, what motor does not have the same angle on both sides of a kink at t; empty where none."""
    near = 4 * np.spacing(abs(t))
    if not (looks and model.kinks(t - near, t + near)):
        return ""
    for look in looks:
        before, after = look.values(np.array([t - near, t + near]))
        if look.motor and abs(after - before) > CONTINUOUS * (1 + abs(after)):
            return _jump(look, np.array([before, after]), t)
    return ""


def cells_of(h, span):
    """(longest step, samples in each) for an integrator whose steps are h, or which chooses them up to h."""
    h = min(h, span / PARTS)
    return h, max(PARTS, int(np.ceil(SAMPLES * (h / span))))


def unseen(model, h):
    """In words, the loads that move within less than two steps of h all the time; empty where there are none."""
    found = [
        f"{name!r} moves within {profile.shortest:.3g} s"
        for name, profile, _ in _profiles(model)
        if profile.kinks == () and (profile.shortest or np.inf) < 2 * h
    ]
    return f"steps of {h:.3g} s do not show how {' and '.join(found)}" if found else ""


def _profiles(model):
    """(name, profile, unit) of all joints and loads of a scene, as of a Look, each profile once."""
    units = {k: "m" for k in model.path_profiles} | {k: "rad" for k in model.motor_profiles}
    return [(name, profile, units.get(k, "")) for k, (name, profile) in enumerate(model.named_profiles)]


def _looks(model, h):
    """The profiles that steps of h might pass over."""
    looks = [Look(*named) for named in _profiles(model)]
    return [look for look in looks if look.motor or (not look.profile.formula and (look.profile.shortest or 0.0) < 4 * h)]


def _fast(looks, begin, end, h, fine, now):
    """Parts of the cells that are too fast for one step, in order; cells end at multiples of h. Chunks that end before `now` are left out."""
    first, last = int(np.floor(begin / h + 1e-6)), int(np.ceil(end / h - 1e-6))
    passed = int(max(0.0, np.floor(now / h) - first - 1)) // CHUNK
    for k in range(first + passed * CHUNK, last, CHUNK):
        stop = min(k + CHUNK, last)
        edges = h * np.arange(k, min(stop + AHEAD, last) + 1)
        edges[0], edges[-1] = max(edges[0], begin) if k > first else begin, min(edges[-1], end) if stop < last else end
        near = max(1e-9 * h, 4 * np.spacing(max(abs(begin), abs(end))))
        inside = begin + near, end - near
        cells = [(look, look.values(_times(edges, fine, inside))) for look in looks]
        scales = [_scale(values) for _, values in cells]
        wanted = np.any([_sharp(look, values, scale) for (look, values), scale in zip(cells, scales)], axis=0)
        for i in np.flatnonzero(wanted[: stop - k]):
            found = list(_split(looks, [scale[i] for scale in scales], edges[i], edges[i + 1], fine, inside, DEPTH))
            jumps = [part.jump for part in found if part.jump]
            yield from [Part(edges[i], edges[i + 1], np.inf, jumps[0])] if jumps else found


def _times(edges, fine, inside):
    """The times (cells, fine + 1) at which cells are sampled; those at a kink, next to it."""
    return np.clip(edges[:-1, None] + np.diff(edges)[:, None] * (np.arange(fine + 1) / fine), *inside)


def _scale(values):
    """Of each cell, the range of values in it and the next few, or the last few."""
    low, high = values.min(axis=1), values.max(axis=1)
    at = np.minimum(np.arange(len(values)), max(0, len(values) - AHEAD))
    window = np.minimum(at[:, None] + np.arange(AHEAD), len(values) - 1)
    return np.maximum(high[window].max(axis=1) - low[window].min(axis=1), NOISE * np.abs(values).max(initial=0.0))


def _sharp(look, values, scale):
    """Which cells (cells, samples) are too fast for one step."""
    at = np.linspace(0.0, 1.0, values.shape[1])
    chord = values[:, :1] + (values[:, -1:] - values[:, :1]) * at
    sharp = np.abs(values - chord).max(axis=1) > SHARP * scale
    return sharp | (np.abs(np.diff(values)).sum(axis=1) > TURN) if look.unit == "rad" else sharp


def _split(looks, scales, begin, end, fine, inside, depth):
    """Parts of a cell that is too fast for one step, each slow enough, or as short as it goes."""
    edges, fine = np.linspace(begin, end, PARTS + 1), max(PARTS, fine // PARTS)
    cells = [look.values(_times(edges, fine, inside)) for look in looks]
    sharp = [_sharp(look, values, scale) for look, values, scale in zip(looks, cells, scales)]
    for i in range(PARTS):
        too_fast = [k for k in range(len(looks)) if sharp[k][i]]
        if too_fast and depth > 1:
            yield from _split(looks, scales, edges[i], edges[i + 1], fine, inside, depth - 1)
        else:
            jumps = [_jump(looks[k], cells[k][i], edges[i + 1]) for k in too_fast if looks[k].motor]
            yield Part(edges[i], edges[i + 1], edges[i + 1] - edges[i], "; ".join(jumps))


def _jump(look, values, t):
    what, advice = "angle of motor" if look.unit == "rad" else "way of", "give it a move that takes time, like profile.quintic"
    return f"the {what} {look.name!r} jumps by {np.ptp(values):.3g} {look.unit} at t = {t:.6g} s: {advice}; the run stops"


def _merged(found):
    """Neighbours of the same step as one."""
    last = None
    for part in found:
        if last and last.end == part.begin and not (last.jump or part.jump) and np.isclose(last.most, part.most, rtol=1e-6):
            last = last._replace(end=part.end)
            continue
        if last:
            yield last
        last = part
    if last:
        yield last
