"""Event-driven runs of models with contact and friction, by integrators that know equations alone.

A mode is a model in which closed contacts and rows that stick are equations, and rows that slip are forces. Each row with a law has a function
that is not negative while its status lasts: the gap of an open contact, the pressure of a closed one, `c(lam) - |lam|` of a row that sticks,
`sign rate` of one that slips. Where one becomes negative, velocities jump by the impact laws, and the accelerations' cone problem gives the next
statuses.

Closed and sticking rows may depend on each other, as those of a rigid block on two feet. Independent ones are the equations then. Their forces
are shared by all of them: of the forces with the same accelerations those of least norm, rows measured in `sqrt(G_ii)`. A row that reaches its
bound leaves the others to themselves, and has no function while they hold it.

Rows at rest may depend on equations alone, as the friction of a guide along which a motor moves a body. They carry no force, and have no function.
Where equations depend on time, they may begin to move such rows at any time: their rates, of velocities that satisfy the equations, are
watched. Then friction slips, a contact opens, and others are hit. Where a motor dwells, friction that it moved is at rest again.
"""

from dataclasses import dataclass, replace
from functools import wraps
from itertools import pairwise
from time import process_time

import numpy as np

from polyida.errors import InputError, StepFailure
from polyida.event import Events, Happened
from polyida.integrate.discontinuities import at_kink
from polyida.integrate.nonsmooth.cone import CLOSED, SLIPS_DOWN, SLIPS_UP, STICKS
from polyida.integrate.nonsmooth.contacts import FIXED, TOUCH, Contacts
from polyida.integrate.start import consistent_acceleration, on_velocity
from polyida.integrate.state import State, Stretch, between
from polyida.linear.lu import SingularSystem
from polyida.model.differences import beside
from polyida.model.guarded import guard
from polyida.model.row_laws import Slipping, Slips, pressing
from polyida.run.events import NODES, OFFSET, Change, EventHandler

LEAST_SPEED = 1e-3  # m/s: a slower impact is plastic
MOST = 1000  # changes of one row
UNIQUE = 1e-7  # of `Slips.uniqueness`: below it forces are errors of the state, 1e7 times as large
AT_ONCE = 10  # changes of one row at one time
LONG_AGO = 1e-6  # s: kinks and samples at the start of a run count
SHORTER = 1 / 8  # of a step whose forces end a status that the consistent ones do not end: the next step
DEPENDENT = 1e-10  # of G_ii: rows that depend on others
AT_BOUND = 1e-4  # of the largest force, now or in the mode: a row at its bound by consistent forces; farther away the integrator's own ones were inexact
MOVES, RESTS = 2.0, 1e-3  # of `Contacts.still`: rates of rows that begin to move, and that are at rest again
CLOSE = 1e-4  # of the same: a step from there that ends at another solution ends there
CERTAIN = 0.5  # of `Slipping.contraction`: below it no look at friction's uniqueness is needed
LONGEST = 64.0  # steps that are taken before they are looked at
NONE = np.zeros(0, np.int64)
SIGNS = {SLIPS_UP: 1.0, SLIPS_DOWN: -1.0}
WORDS = {CLOSED: "closes", STICKS: "sticks", SLIPS_UP: "slips", SLIPS_DOWN: "slips"}


@dataclass(frozen=True)
class RowEvent:
    """An event that occurs where the function of row number `law` changes its sign."""

    law: int
    name: str
    direction: str = "falling"


def timed(method):
    """Decorator of a method of ContactHandler: its CPU time is added to the time spent on contact and friction."""

    @wraps(method)
    def measured(self, *arguments):
        """The method, with its CPU seconds added to `watch_seconds` of the Events."""
        begin = process_time()
        try:
            return method(self, *arguments)
        finally:
            self.happened.watch_seconds += process_time() - begin

    return measured


class StepBatch:
    """The functions of the rows with laws over the steps that an integrator takes in one call, for all batches of one motion.

    A step is quiet if certainly no status ends in it: each function stays away from zero by more than half of what it changes within two steps.
    """

    def __init__(self, mode, before):
        """Begin at the first state of a motion of a mode."""
        self.mode = mode
        self.vectors = None  # keeps the vectors that a Stretch computes when they are first read
        self.values = None  # (steps, rows) of the functions at the ends of the batch's steps
        self.earlier = None  # (rows,) one step before the end of the last batch; None: not known
        contraction = mode.contraction(before.t, before.q) if isinstance(mode, Slipping) else 0.0
        self.unique = before.t, contraction, before.t  # t, contraction there, time up to which it certainly stays below CERTAIN
        mode.longest_stretch = 1

    def next(self, stretch):
        """Go on to the next batch; returns the values one step before its begin, or None."""
        earlier = self.earlier
        self.earlier = None
        self.vectors = stretch.computed()
        return earlier

    def certain(self, after):
        """True if friction that slips has certainly a unique force up to a state: it did where that was found last, and it changes slowly."""
        t, value, until = self.unique
        if isinstance(self.mode, Slipping) and after.t > until:
            now = self.mode.contraction(after.t, after.q)
            change = abs(now - value) / (after.t - t)
            until = after.t + min(2.0 * (after.t - t), (CERTAIN - now) / change if change else np.inf)
            self.unique, value = (after.t, now, until), max(value, now)
        return value < CERTAIN

    def quiet(self, earlier, begin, values, sides, sizes):
        """True for the quiet steps, (steps,); sets how many steps the next batch may have.

        earlier, begin: values one step before the batch and at its begin. values: at the ends of its steps. sides, sizes: of the functions.
        """
        self.values = values
        ends = np.vstack([begin if earlier is None else earlier, begin, values])
        around = np.array([ends[:-2], ends[1:-1], ends[2:]])
        least, change = (sides * around).min(axis=0), np.ptp(around, axis=0)
        quiet = ((least > OFFSET * np.maximum(sizes, least)) & (2.0 * least > change)).all(axis=1)
        quiet[0] &= earlier is not None
        self.earlier = ends[-2]
        moves = np.abs(values[-1] - ends[-2])
        left = np.min(np.abs(values[-1]) / np.where(moves > 0.0, moves, 1e-300), initial=LONGEST)  # steps until one is zero
        self.mode.longest_stretch = int(max(1, min(2 * self.mode.longest_stretch, left))) if quiet.all() else 1
        return quiet


class ContactHandler(EventHandler):
    """The events of an event-driven run with contact and friction: each change of a row's status is one."""

    def __init__(self, model, method, happened=None, compiled=True):
        """Take the model, the integrator and the Events so far. compiled: False if friction that slips is to be in Python, for the adjoint."""
        self.compiled = compiled
        self.whole, self.method, self.contacts = guard(model), method, Contacts(guard(model))
        if self.whole.is_scene and self.whole.edge_rows:
            names = ", ".join(law.name for law in self.whole.row_laws if law.row in [rows.first for rows in self.whole.edge_rows])
            why = "their rows are not smooth, which takes polyida.NonsmoothAlpha(h=...) or MoreauJean(h=...)"
            raise InputError(f"{method.class_name()}: the contacts of {names} are with edges; {why}")
        self.happened, self.width = happened, self.whole.m
        if happened is None:
            self.happened = Events(given=True)
            self.happened.watch_seconds = 0.0
        self.events = [RowEvent(number, law.name) for number, law in enumerate(self.whole.row_laws)]
        self.sides = np.zeros(len(self.events))
        self.sizes = np.zeros(len(self.events))
        self.counts = np.zeros((2, len(self.events)), np.int64)  # changes of each row: in all, and at the time of the last change
        self.last = -np.inf  # s: time of the last change
        self.modes = {}  # {(rows, slips): model}
        self.mode = self.whole  # the model of the statuses
        self.pressing = pressing(self.whole, self.whole.row_laws)
        # (numbers of rows with laws)
        self.shared = NONE  # those that share their forces
        self.watched = NONE  # at rest, held by equations that may begin to move them
        self.dwelling = NONE  # whose motion ended the last step
        self.seen = set()  # statuses at the time of the last change
        self.pieces = np.zeros(3)  # length and end of a piece of the motion, and the length from which it is whole again; 0: it is whole
        self.batch = None  # StepBatch of the motion

    def start(self, state):
        """The first state of a run; sets the mode. state: from `consistent_state`, with all columns of lam."""
        try:
            state = self._settled_at_rest(state)
        except StepFailure:  # no forces satisfy the laws; the first motion raises it again, so that the run ends with it
            self.status = np.zeros(len(self.events), np.int64)
            self._set_mode(state.t, state.q, state.v)
        return replace(state, memory={"status": self.status.astype(float)}, restart=True)

    def _settled_at_rest(self, state):
        """The consistent State with the contacts closed that touch and do not separate; sets statuses and mode."""
        return self._settled(state.t, state.q, state.v, self.contacts.at_rest(state.t, state.q, state.v))

    def whole_state(self, state):
        """A state of the mode with the columns of lam of all rows, and with what a run goes on with in its memory."""
        state = super().whole_state(state)
        if not state.restart:
            return state
        return replace(state, memory=state.memory | self._memory())

    def _memory(self):
        """What a run goes on with: of events, of the statuses and of the pieces of a motion."""
        return {"events": np.array([self.sides, self.sizes]), "status": self.status.astype(float), "pieces": self.pieces}

    def spread(self, state):
        """A State of the mode with the multipliers of all rows, (width,)."""
        return State(state.t, state.q, state.v, state.a, self._all_forces(state), restart=False)

    def stretches(self, state, t_end, counts):
        """Yield step batches of the run's states, and Changes, from the statuses in the memory of its first state."""
        memory = dict(state.memory)
        self.status, self.pieces = np.asarray(memory.pop("status"), np.int64), np.array(memory.pop("pieces", np.zeros(3)))
        self._set_mode(state.t, state.q, state.v)
        span = state.t - LONG_AGO, t_end
        self.jumps = bool(tuple(self.whole.kinks(*span))) or any(True for _ in self.whole.samples(*span))
        return super().stretches(replace(state, memory=memory), t_end, counts)

    def value(self, event, state):
        """Value of the function of an event's row at a state of the mode; its status lasts while the sign stays."""
        if self._known[0] is not state:
            values = self._values(Stretch.of(state), self._all_forces(state)[None])[0]
            for k in np.flatnonzero(self.fixed & ~self.held):
                values[k] = SIGNS[self.status[k]] * self._held_rates(state)[k]
            self._known = state, values
        return float(self._known[1][event.law])

    def _quiet(self, before, stretch):
        """(steps,) mask of a stretch: steps in which certainly no status of a row ends.

        A motion's first step, those near an end of unique friction, those of rows with shared forces or held by equations, and those of runs with
        kinks and samples are looked into.
        """
        earlier = self.batch.next(stretch)
        if self.jumps or self.shared.size or self.watched.size or self.fixed.any() or not self.batch.certain(stretch.last):
            self.mode.longest_stretch = 1
            return np.zeros(len(stretch), bool)
        lam = self._all_forces(stretch.last)[None] if len(stretch) == 1 else self.mode.spread(stretch.lam, self.width)
        return self.batch.quiet(earlier, self.values, self._values(stretch, lam), self.sides, self.sizes)

    def _pass(self, part, done):
        """Go on behind quiet steps, the first `done` ones of the batch; `part`: the last of them."""
        values = self.batch.values[:done]
        self.values = values[-1]
        self.sizes = np.maximum(self.sizes, np.abs(values).max(axis=0, initial=0.0))
        self.contacts.speed = max(self.contacts.speed, float(np.abs(part.v).max(initial=0.0)))
        self.at = part.last
        self.step = float(part.t[-1] - part.t[-2]) if len(part) > 1 else self.step

    def _values(self, stretch, lam):
        """The functions of the rows at the ends of a stretch, (k, rows with laws); lam: of all rows."""
        contacts, status, result = self.contacts, self.status, np.ones((len(lam), len(self.events)))
        phi, rates = self.whole.phi_of_frames(stretch.t, stretch.q, stretch.v)
        own, closed = lam[:, contacts.rows], contacts.contact & (status == CLOSED)
        for rows, values in (
            (status >= SLIPS_UP, np.where(status == SLIPS_UP, 1.0, -1.0) * rates[:, contacts.rows]),
            (status == STICKS, contacts.constant + contacts.mu * np.sqrt(lam**2 @ self.pressing) - np.abs(own)),
            (closed, -own),
            (contacts.contact & ~closed, phi[:, contacts.rows]),
        ):
            result[:, rows] = values[:, rows]
        return np.where(self.held, 1.0, result)

    def _motion(self, before, t_end, counts):
        """Yield the step batches of one mode, and the Change at its end. Raises StepFailure where friction has no unique force."""
        self.at, self.step = before, self.method.fixed_step()
        if self.started:
            self._settled_at_rest(before)
            if self._hit(before).any():  # contacts that are closed and approach at the start of the run
                self.started = False
                yield Change(None, *self._change(before, []))
                return
        self.batch = StepBatch(self.mode, before)
        try:
            if not self._uniqueness(before, before) > 0.0:
                raise self.mode.singular()
            yield from self._in_pieces(before, t_end, counts)
        except (StepFailure, SingularSystem) as error:  # a step across the end of a unique force may have no solution
            ahead = self._singular_ahead(self.at, self.step, 4.0) if isinstance(self.mode, Slipping) and self.step else None
            self.at, error = (ahead, self.mode.singular()) if ahead else (self.at, error)
            if not isinstance(error, SingularSystem):
                raise
            raise StepFailure("singular", str(error), self.at.t) from None

    def _in_pieces(self, before, t_end, counts):
        """The motion of a mode; behind a step whose forces were not the consistent ones in pieces, which begin short and grow."""
        while True:
            length, end, longest = self.pieces
            if length and end <= before.t:
                length = 2.0 * length if end else length
                self.pieces = np.array([length, before.t + length, longest]) if length < longest else np.zeros(3)
            end, part = self.pieces[1] or t_end, None
            for part in super()._motion(before, min(end, t_end), counts):
                yield part
            if isinstance(part, Change) or end >= t_end:
                return
            before = State(self.at.t, self.at.q, self.at.v, self.at.a, self.at.lam, self.at.memory | {"polynomials": 1.0})

    def _uniqueness(self, before, state):
        """What is positive while friction that slips has a unique force; rows press in the directions that they had before."""
        return self.mode.uniqueness(state, before.lam) if isinstance(self.mode, Slipping) else 1.0

    @timed
    def _first(self, before, after):
        """(time, numbers of the rows) of the first end of a status in a step, or None.

        Raises SingularSystem if the friction has no unique force somewhere in the step before.
        """
        # speeds that are round-off of the motion so far: at rest, and without gravity, a state gives no size for them
        self.contacts.speed = max(self.contacts.speed, float(np.abs(before.v).max(initial=0.0)))
        hit = self._jumped(before) or super()._first(before, after)
        watched = self._first_watched(before, after)
        if watched and (hit is None or watched[0] <= hit[0]):
            hit = watched
        ahead = self._singular(before, after) if isinstance(self.mode, Slipping) else None
        if ahead and (ahead.t > after.t or (hit and hit[0] < ahead.t)):
            rows = hit[1] if hit else np.flatnonzero(self.status >= SLIPS_UP)
            ahead = ahead if all(self._lasts(k, before, ahead) for k in rows) else None
        if ahead:
            self.at, self.step = ahead, 0.0
            raise self.mode.singular()
        self.at, self.step = after, after.t - before.t
        return hit

    def _behind(self, t, q, v):
        """(t, v) with the forces behind a jump at t: beside a kink, with the outputs of controllers that sample."""
        return beside(t, 1.0) if at_kink(self.whole, t) else t, self.whole.sampled(t, q, v)

    def _with_forces_behind(self, state):
        """A state of the mode, with the accelerations and multipliers behind a jump of forces at its time."""
        t, v = self._behind(state.t, state.q, state.v)
        if t == state.t and v is state.v:
            return state
        a, lam = consistent_acceleration(self.mode, t, state.q, v)
        return State(state.t, state.q, state.v, a, lam, restart=False)

    def _jumped(self, before):
        """(time, numbers of the rows) whose status a jump of forces at the start of a step ends, or None."""
        state = self._with_forces_behind(before) if self.jumps else before
        if state is before:
            return None
        values = np.array([self.value(event, state) for event in self.events])
        rows = np.flatnonzero((values < -OFFSET * np.maximum(self.sizes, np.abs(values))) & (self.values > 0.0) & (self.status < SLIPS_UP))
        return (before.t, rows.tolist()) if len(rows) else None

    def _first_watched(self, before, after):
        """(time, numbers of the rows) at which equations begin to move rows at rest in a step, or no longer move rows of friction, or None."""
        if not self.contacts.turning:
            return None
        still, times = self.contacts.still(after.v), before.t + NODES * (after.t - before.t)
        self.dwelling = self._dwelling(before, after, RESTS * still)
        if len(self.dwelling):
            return before.t, self.dwelling

        def moving(t):
            """Numbers of the watched rows that equations move at time t of the step, faster than `MOVES * still`."""
            return self.watched[np.abs(self._held_rates(between(before, after, t))[self.watched]) > MOVES * still]

        for begin, end in pairwise([*times[:-1], after.t]) if len(self.watched) else ():
            if len(moving(end)):
                while begin < (middle := 0.5 * (begin + end)) < end:
                    begin, end = (begin, middle) if len(moving(middle)) else (middle, end)
                return end, moving(end)
        return None

    def _dwelling(self, before, after, least):
        """Numbers of the rows of friction that slip and that equations alone hold, whose rates are below `least` in all of a step."""
        rows = np.flatnonzero(self.fixed & (np.abs(self.values) < least)).tolist()
        for s in NODES if rows else ():
            state = between(before, after, before.t + s * (after.t - before.t))
            rates = self._held_rates(state)
            rows = [k for k in rows if abs(rates[k]) < least]
        return np.array(rows, np.int64)

    def _held_rates(self, state):
        """Rates of the rows with laws at a state of a step, of velocities that satisfy the equations."""
        if self._held[0] is not state:
            v = on_velocity(self.equations, state.t, state.q, state.v)
            self._held = state, self.whole.phi_rate(state.t, state.q, v)[self.contacts.rows]
        return self._held[1]

    def _singular(self, before, after):
        """The State of a step, or shortly behind it, at which the friction has no unique force, or None.

        A step that comes near it may end at another solution, whose forces are not the consistent ones: the motion is then that before it.
        """
        from scipy.optimize import brentq

        unique = self._uniqueness(before, after)
        reached = not unique > UNIQUE
        agrees = self.mode.agrees(after)
        ahead = self._singular_ahead(before, after.t - before.t) if reached or not agrees else None
        if ahead is None and (reached or (not agrees and unique < CLOSE)):
            unique_at = lambda t: self._uniqueness(before, between(before, after, t))  # noqa: E731
            ahead = after if unique > 0.0 else between(before, after, brentq(unique_at, before.t, after.t))
        return ahead

    def _singular_ahead(self, state, h, most=2.0):
        """The State at which the friction has no unique force up to `most` steps of h ahead, by the accelerations of a state, or None.

        They grow as `|t - t_s|^(-1/3)`, so that the error is of order 5/3 in h.
        """
        from scipy.optimize import brentq

        def at(t):
            """The measure of a unique friction force at time t, extrapolated from the state; it is positive while there is one."""
            return self._uniqueness(state, _ahead(state, t))

        ends = state.t + h * np.array([0.0, 1.0, 2.0, most])
        return next((_ahead(state, brentq(at, *pair)) for pair in zip(ends, ends[1:]) if at(pair[1]) <= 0.0), None)

    def _lasts(self, number, before, ahead):
        """True if a row has the status that it had before at a state ahead, too; that of a closed contact follows from its force without friction."""
        if self.contacts.contact[number] and self.status[number] == CLOSED:
            return self.mode.pressed(ahead, before.lam)
        return self.value(self.events[number], ahead) > 0.0

    def _crossing(self, event, side, values, offset, before, after):
        """(time at which a row's status ends in a step, or None; the side of its function at the end).

        A slip or an opening that began in the wrong direction and goes on so, by more than round-off, ends with the step.
        """
        if side > 0.0:
            return super()._crossing(event, side, values, offset, before, after)
        is_gap = self.contacts.contact[event.law]
        round_off = TOUCH * (self.whole.extent or 1.0) if is_gap else self.contacts.still(after.v)
        t, side = super()._crossing(event, 0.0, values, max(offset, round_off), before, after)
        if t is None and side < 0.0:
            return (after.t, side) if self._change_of(event, after) < 0.0 else (None, 0.0)  # else it is an error of the integrator
        return t, side

    def _change_of(self, event, state):
        """Rate of a gap, or of the speed at which a row slips, at a state."""
        whole, row, at = self.whole, self.whole.row_laws[event.law].row, (state.t, state.q, state.v)
        if self.contacts.contact[event.law]:
            return float(whole.phi_rate(*at)[row])
        change = self.contacts.slopes(state.t, state.q, [event.law])[0] @ state.a + whole.phi_bias(*at)[row]
        return SIGNS[self.status[event.law]] * float(change)

    def _all_forces(self, state):
        """Multipliers lam of all rows, closed or not, at a state of the mode."""
        if self._forces[0] is not state:
            lam = self.mode.spread(state.lam, self.width)
            if len(self.shared):
                contacts, rows = self.contacts, self.contacts.rows[self.shared]
                G, _, Y = contacts.mobilities(state.t, state.q, self.shared)
                size, p = 1.0 / np.sqrt(G.diagonal()), -lam[rows]
                scaled = size[:, None] * G * size
                least = size * np.linalg.lstsq(scaled, size * (G @ p), rcond=DEPENDENT)[0]
                lam[rows] = -least
                lam[contacts.equations] += Y @ (least - p)
            self._forces = state, lam
        return self._forces[1]

    def _set_mode(self, t, q, v):
        """Set the model of the statuses, the rows that share forces, and those that the equations hold."""
        contacts, laws, status = self.contacts, self.whole.row_laws, self.status
        rates, gaps = self.whole.phi_rate(t, q, v)[contacts.rows], contacts.gaps(t, q)
        still = contacts.still(v)
        equal = np.where(contacts.contact, status == CLOSED, status == STICKS)
        slips = [(law, SIGNS[s]) for law, s in zip(laws, status) if s in SIGNS and (law.mu or law.constant)]
        pressed = contacts.contact | contacts.active(status == CLOSED)
        resting = np.flatnonzero((np.abs(rates) <= still) & (gaps <= TOUCH * (self.whole.extent or 1.0)) & pressed)
        self.shared = self.watched = NONE
        self.held = np.zeros(len(laws), bool)  # True for rows at rest that other rows hold: they have no function
        self.fixed = np.zeros(len(laws), bool)  # True for rows that slip and that equations alone move
        kept = np.flatnonzero(equal)
        sliding = np.flatnonzero(status >= SLIPS_UP)
        if len(sliding) and contacts.turning:
            G, mobility, _ = contacts.mobilities(t, q, sliding)
            self.fixed[sliding] = G.diagonal() <= FIXED * mobility
        if len(resting) and (len(resting) > 1 or not equal[resting[0]]):
            G, mobility, _ = contacts.mobilities(t, q, resting)
            size = np.where(G.diagonal() <= FIXED * mobility, np.inf, np.maximum(G.diagonal(), DEPENDENT * mobility))
            kept, held = _independent(G, np.isin(resting, kept), size)
            kept, held = resting[kept], resting[held]
            self.watched = held[~self.fixed[held]]
            self.held[self.watched] = True
            pressing = {row for law, _ in slips for row in law.on}
            if (self.held & equal).any():
                self.shared = np.array([k for k in resting if equal[k] and laws[k].row not in pressing], np.int64)
                self.held[self.shared] = False
        rows = np.sort(np.concatenate([contacts.equations, contacts.rows[kept]]))
        key = rows.tobytes(), tuple((law.row, sign) for law, sign in slips)
        if key not in self.modes:
            self.modes[key] = self._slipping(t, q, rows, slips) if slips else self.whole.with_rows(rows)
        self.mode = self.modes[key]
        # (state, its multipliers, rates or values): of the last state that they were computed at
        self._forces = self._held = self._known = None, None
        self.equations = self.whole.with_rows(rows) if len(self.watched) or slips else self.mode

    def _slipping(self, t, q, rows, slips):
        """The model in which these rows are equations and others slip, `slips`; in compiled code unless friction nearly holds by itself at (t, q)."""
        plain = Slips(self.whole, rows, slips)
        if not (self.whole.is_scene and self.compiled) or plain.contraction(t, q) >= CERTAIN:
            return plain
        from polyida.assembly.slipping import SlippingScene

        return SlippingScene.of(self.whole, rows, slips)

    def _settled(self, t, q, v, closed, begins=0.0, dwells=NONE):
        """The State with consistent accelerations, and all columns of lam; sets statuses and mode. begins: directions of slip from rest.

        dwells: rows that equations hold at rest from now on.
        """
        contacts = self.contacts
        behind, sampled = self._behind(t, q, v)
        a, lam, p, status = contacts.accelerations(behind, q, sampled, closed, begins=begins, dwells=dwells)
        rates = self.whole.phi_rate(t, q, v)[contacts.rows]
        bounded = np.array([law.is_contact or law.mu > 0.0 or law.constant > 0.0 for law in self.whole.row_laws])
        slips = ~contacts.contact & (np.abs(rates) > contacts.still(v))
        slips[dwells] = False
        status = np.where(slips & (status > 0), np.where(rates > 0.0, SLIPS_UP, SLIPS_DOWN), status)
        self.status = np.where(bounded & contacts.active(closed), status, 0)
        self._set_mode(t, q, v)
        return State(t, q, v, a, contacts.all_multipliers(lam, p), restart=False)

    @timed
    def _change(self, state, fired):
        """(state behind, what happened, "") where the statuses of the rows `fired` end, or contacts are hit. Raises StepFailure."""
        if not self._uniqueness(state, state) > 0.0:  # the event is of forces within round-off of that point
            self.at, self.step = state, 0.0
            raise self.mode.singular()
        state = self._with_forces_behind(state)
        contacts, t, q = self.contacts, state.t, state.q
        rates = self.whole.phi_rate(t, q, state.v)[contacts.rows]
        old, hit, still = self.status.copy(), self._hit(state), contacts.still(state.v)
        closed = ((old == CLOSED) & (rates <= still)) | hit | contacts.at_rest(t, q, state.v)
        if hit.any():
            v, closed, happened = self._impact(state, rates, still, hit, closed)
            begins = 0.0
        else:
            v, happened = state.v, []
            begins = self._begins(state, rates, closed, fired)
        dwells = np.intersect1d(self.dwelling, fired).astype(np.int64)
        behind = self._settled(t, q, v, closed, begins, dwells)
        changed = np.flatnonzero(self.status != old)
        happened = happened or [Happened(t, self._told(k), 0.0, 0.0, 0) for k in changed]
        rows = np.union1d(changed, np.flatnonzero(hit))
        self._set_pieces(old, self._require_progress(t, rows if len(rows) else fired), hit.any())
        self.happened.happened += happened
        self._set_sides(State(t, q, v, behind.a, behind.lam[self.mode.columns]), still)
        return replace(behind, memory=self._memory(), restart=True), happened, ""

    def _impact(self, state, rates, still, hit, closed):
        """(velocities behind an impact of the contacts `hit`, contacts that are closed then, what happened).

        rates: of the rows with laws before it; those below `still` are round-off. closed: the contacts that may take impulses. An impulse P takes the energy `-P (rate before + rate behind) / 2`. Impacts slower than
        LEAST_SPEED are plastic.
        """
        contacts, t, q = self.contacts, state.t, state.q
        none, held = np.zeros(len(contacts.rows)), np.zeros(len(contacts.equations))
        v, P, _, _ = contacts.impact(t, q, state.v, rates, closed, none, held, 0.0, None, np.abs(rates) < LEAST_SPEED)
        after = self.whole.phi_rate(t, q, v)[contacts.rows]
        lost = -0.5 * P * (rates + after)
        # friction elsewhere may lose energy, too
        listed = (hit & (P > 0.0) & (self.status != CLOSED)) | ((P != 0.0) & (np.abs(rates + after) > still))
        happened = []
        for name in dict.fromkeys(contacts.names[k] for k in np.flatnonzero(listed)):
            of_part = np.array([other == name for other in contacts.names])
            happened.append(Happened(t, name, float(np.abs(P[of_part]).max()), float(lost[of_part].sum()), 0))
        return v, closed & (after <= still), happened

    def _told(self, k):
        """Name of the part of row k and what its new status is, for users: "floor closes"."""
        free = "opens" if self.contacts.contact[k] else "sticks" if self.held[k] else "is free"
        return f"{self.contacts.names[k]} {WORDS.get(int(self.status[k]), free)}"

    def _set_pieces(self, old, advances, hit):
        """Begin the next motion with a short piece if its statuses were seen at this time before; `old`: statuses before the change.

        The forces of the step were not the consistent ones then, as of mesh modes that it does not resolve. advances: the change is behind the
        last one. hit: contacts were hit.
        """
        now = self.status.tobytes()
        self.seen = {old.tobytes()} if advances else self.seen
        again = now in self.seen and not (advances or hit)
        self.seen.add(now)
        self.pieces = np.array([SHORTER * self.step, 0.0, max(self.step, self.pieces[2])]) if again else np.zeros(3)

    def _set_sides(self, state, still):
        """Set values, sides and sizes of the functions at the first state of a motion; still: speeds below it are round-off, m/s."""
        contact = self.contacts.contact
        self.values = np.array([self.value(event, state) for event in self.events])
        # slip from rest, and the gap of a contact that opens, are round-off of either sign at first
        begins = np.where(contact, self.status == 0, self.status >= SLIPS_UP)
        begins &= self.values <= np.where(contact, TOUCH * (self.whole.extent or 1.0), still)
        self.sides = np.where(begins, 0.0, 1.0)
        self.sizes = np.abs(self.values)

    def _hit(self, state):
        """(contacts,) mask: contacts that have closed and whose gap decreases."""
        contacts, still, size = self.contacts, self.contacts.still(state.v), TOUCH * (self.whole.extent or 1.0)
        rates = self.whole.phi_rate(state.t, state.q, state.v)[contacts.rows]
        return contacts.contact & (contacts.gaps(state.t, state.q) <= size) & (rates < -still)

    def _begins(self, state, rates, closed, fired):
        """Directions in which rows that reached their bounds slip; opens the contacts without pressure. At a bound the laws allow both statuses."""
        begins, lam = np.zeros(len(self.events)), self._all_forces(state)
        for k in fired:
            if k in self.watched and abs(rates[k]) > self.contacts.still(state.v):  # equations move it
                continue
            if self.value(self.events[k], state) > AT_BOUND * max(np.abs(lam).max(initial=0.0), self.sizes[k]):
                continue
            if self.contacts.contact[k]:
                closed[k] &= self.status[k] != CLOSED
            elif self.status[k] == STICKS:
                begins[k] = np.sign(lam[self.whole.row_laws[k].row])
        return begins

    def _require_progress(self, t, rows):
        """True if a change is behind the last one; raises StepFailure if rows change too often, in all or at one time."""
        advances = t > self.last + 1e-12 * max(1.0, abs(t))
        if advances:
            self.counts[1], self.last = 0, t
        self.counts[:, rows] += 1
        for limit, counts, why in ((MOST, self.counts[0], "changed"), (AT_ONCE, self.counts[1], "changed at one time")):
            if (counts > limit).any():
                name = self.contacts.names[int(np.argmax(counts))]
                advice = "use polyida.NonsmoothAlpha(h=...), which steps through"
                raise StepFailure("events", f"the contact or friction of {name!r} {why} more than {limit} times; {advice}", t)
        return advances


def _ahead(state, t):
    """The State at t, near a state, extrapolated with its constant acceleration."""
    s = t - state.t
    return State(t, state.q + s * state.v + 0.5 * s * s * state.a, state.v + s * state.a, state.a, state.lam, restart=False)


def _independent(G, equal, size):
    """(numbers of independent rows among those with `equal`, numbers of the other rows that depend on them), by their Gram matrix G.

    size: of the diagonal. Rows that depend on the first ones are found by Cholesky's elimination with pivots.
    """
    rest, kept = G.copy(), []
    while True:
        left = np.where(equal, rest.diagonal() / size, 0.0)
        left[kept] = 0.0
        k = int(np.argmax(left))
        if left[k] <= DEPENDENT:
            dependent = np.flatnonzero(rest.diagonal() / size <= DEPENDENT)
            return np.array(kept, np.int64), np.setdiff1d(dependent, kept)
        kept.append(k)
        rest = rest - np.outer(rest[:, k], rest[k]) / rest[k, k]
