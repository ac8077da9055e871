"""Event-driven runs of models with contact and friction, by integrators that know equations alone.

A mode is a model in which closed contacts and rows that stick are equations, and rows that slip are forces (statuses.py). Each row with a law
has a function that is not negative while its status lasts. Where one becomes negative, velocities jump by the impact laws, and the
accelerations' cone problem (Contacts) gives the next statuses.

Where equations depend on time, they may begin to move rows at rest that they hold, at any time: the rates of these rows, of velocities that
satisfy the equations, are watched. Then friction slips, a contact opens, and others are hit. Where a motor dwells, friction that it moved is at
rest again. A motion also ends where friction that slips has no unique force (unique_friction.py).
"""

from dataclasses import dataclass, replace
from functools import wraps
from itertools import pairwise
from time import process_time
from typing import NamedTuple

import numpy as np

from polyida.errors import InputError, StepFailure
from polyida.event import Events, Happened
from polyida.integrate.discontinuities import at_kink
from polyida.integrate.nonsmooth.cone import CLOSED, SLIPS_DOWN, SLIPS_UP, STICKS
from polyida.integrate.nonsmooth.contacts import TOUCH, Contacts
from polyida.integrate.start import consistent_acceleration
from polyida.integrate.state import State, between
from polyida.linear.lu import SingularSystem
from polyida.model.differences import beside
from polyida.model.guarded import guard
from polyida.model.row_laws import Slipping
from polyida.run.event_search import OFFSET, Change, EventSearch
from polyida.run.quiet_steps import QuietSteps
from polyida.run.sign_changes import NODES
from polyida.run.statuses import NONE, SIGNS, Statuses
from polyida.run.unique_friction import singular_ahead, singular_in_step, uniqueness

LEAST_SPEED = 1e-3  # m/s: a slower impact is plastic
MOST = 1000  # changes of one row
AT_ONCE = 10  # changes of one row at one time
LONG_AGO = 1e-6  # s: kinks and samples at the start of a run count
SHORTER = 1 / 8  # of a step whose forces end a status that the consistent ones do not end: the next step
AT_BOUND = 1e-4  # of the largest force, now or in the mode: a row at its bound by consistent forces; farther away the integrator's own ones were inexact
MOVES = 2.0  # of `Contacts.still`: rates of rows that begin to move
RESTS = 1e-3  # of `Contacts.still`: rates of rows that are at rest again
WORDS = {CLOSED: "closes", STICKS: "sticks", SLIPS_UP: "slips", SLIPS_DOWN: "slips"}


@dataclass(frozen=True)
class RowEvent:
    """An event that occurs where the function of row number `law` changes its sign."""

    law: int
    name: str
    direction: str = "falling"


class Pieces(NamedTuple):
    """The piece of a motion that the integrator takes at a time: short after a doubtful change, and each twice as long as the one before."""

    length: float = 0.0  # s; 0: the motion is whole
    end: float = 0.0  # time at which the piece ends, s; 0: no piece has begun
    longest: float = 0.0  # length from which the motion is whole again, s


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


class ContactHandler(EventSearch):
    """The events of an event-driven run with contact and friction: each change of a row's status is one.

    It differs from other searches in `_quiet` (most steps need no look into them), `_motion` (in pieces; it ends at a loss of unique friction),
    `_first` (jumps of forces, rows that equations begin to move) and `_crossing` (functions that begin with round-off).
    """

    def __init__(self, model, method, happened=None, compiled=True):
        """Take the model, the integrator and the Events so far. compiled: False if friction that slips is to be in Python, for the adjoint."""
        whole = guard(model)
        _require_no_edges(whole, method)
        if happened is None:
            happened = Events(given=True)
            happened.watch_seconds = 0.0
        events = [RowEvent(number, law.name) for number, law in enumerate(whole.row_laws)]
        super().__init__(whole, events, method, happened, whole.m)
        self.contacts = Contacts(whole)
        self.statuses = Statuses(whole, self.contacts, compiled)
        self.quiet_steps = None  # QuietSteps of the motion
        self.jumps = False  # True if forces jump in time: the model has kinks or samples
        self.last_good = None  # last accepted State of the motion, or that at which friction is no longer unique
        self.step = 0.0  # length of the last step, s; 0 if the motion ended in it
        self.dwelling = NONE  # numbers of the rows whose motion ended the last step
        self.pieces = Pieces()
        self.counts = np.zeros((2, len(events)), np.int64)  # changes of each row: in all, and at the time of the last change
        self.last_change = -np.inf  # time of the last change, s
        self.seen = set()  # statuses at that time

    @property
    def status(self):
        """Status of each row with a law, (rows with laws,)."""
        return self.statuses.status

    def _set_status(self, status, t, q, v):
        """Set the statuses at a state, and the mode that follows from them."""
        self.statuses.set(status, t, q, v)
        self.mode = self.statuses.mode

    def start(self, state):
        """The first state of a run; sets the mode. state: from `consistent_state`, with all columns of lam."""
        try:
            state = self._settled_at_rest(state)
        except StepFailure:  # no forces satisfy the laws; the first motion raises it again, so that the run ends with it
            self._set_status(np.zeros(len(self.events), np.int64), state.t, state.q, state.v)
        return replace(state, memory={"status": self.status.astype(float)}, restart=True)

    def _settled_at_rest(self, state):
        """The consistent State with the contacts closed that touch and do not separate; sets statuses and mode."""
        return self._settled(state.t, state.q, state.v, self.contacts.at_rest(state.t, state.q, state.v))

    def _memory(self):
        """What a run goes on with: of events, of the statuses and of the pieces of a motion."""
        return super()._memory() | {"status": self.status.astype(float), "pieces": np.array(self.pieces)}

    def spread(self, state):
        """A State of the mode with the multipliers of all rows, (width,)."""
        return State(state.t, state.q, state.v, state.a, self.statuses.all_forces(state), restart=False)

    def stretches(self, state, t_end, counts):
        """Yield step batches of the run's states, and Changes, from the statuses in the memory of its first state."""
        memory = dict(state.memory)
        status = np.asarray(memory.pop("status"), np.int64)
        self.pieces = Pieces(*memory.pop("pieces", ()))
        self._set_status(status, state.t, state.q, state.v)
        span = state.t - LONG_AGO, t_end
        self.jumps = bool(tuple(self.whole.kinks(*span))) or any(True for _ in self.whole.samples(*span))
        return super().stretches(replace(state, memory=memory), t_end, counts)

    def value(self, event, state):
        """Value of the function of an event's row at a state of the mode; its status lasts while the sign stays."""
        return float(self.statuses.functions_at(state)[event.law])

    def _quiet(self, before, stretch):
        """True for the steps of a stretch in which certainly no status of a row ends, (steps,).

        A motion's first step, those near an end of unique friction, those of rows with shared forces or held by equations, and those of runs with
        kinks and samples are looked into.
        """
        statuses = self.statuses
        earlier = self.quiet_steps.next(stretch)
        held = statuses.shared.size or statuses.watched.size or statuses.fixed.any()
        if self.jumps or held or not self.quiet_steps.certain(stretch.last):
            self.mode.longest_stretch = 1
            return np.zeros(len(stretch), bool)
        lam = statuses.all_forces(stretch.last)[None] if len(stretch) == 1 else self.mode.spread(stretch.lam, self.width)
        return self.quiet_steps.quiet(earlier, self.values, statuses.functions(stretch, lam), self.sides, self.sizes)

    def _pass(self, part, done):
        """Go on after quiet steps, the first `done` ones of the batch; `part`: the last of them."""
        values = self.quiet_steps.values[:done]
        self.values = values[-1]
        self.sizes = np.maximum(self.sizes, np.abs(values).max(axis=0, initial=0.0))
        self.contacts.speed = max(self.contacts.speed, float(np.abs(part.v).max(initial=0.0)))
        self.last_good = part.last
        self.step = float(part.t[-1] - part.t[-2]) if len(part) > 1 else self.step

    def _motion(self, before, t_end, counts):
        """Yield the step batches of one mode, and the Change at its end. Raises StepFailure where friction has no unique force."""
        self.last_good, self.step = before, self.method.fixed_step()
        if self.started:
            self._settled_at_rest(before)
            if self._hit(before).any():  # contacts that are closed and approach at the start of the run
                self.started = False
                yield Change(None, *self._observed_change(before, []))
                return
        self.quiet_steps = QuietSteps(self.mode, before)
        try:
            if not uniqueness(self.mode, before, before) > 0.0:
                raise self.mode.singular()
            yield from self._in_pieces(before, t_end, counts)
        except (StepFailure, SingularSystem) as error:  # a step across the end of a unique force may have no solution
            if isinstance(self.mode, Slipping) and self.step:
                ahead = singular_ahead(self.mode, self.last_good, self.step, 4.0)
                if ahead:
                    self.last_good = ahead
                    raise StepFailure("singular", str(self.mode.singular()), ahead.t) from None
            if isinstance(error, SingularSystem):
                raise StepFailure("singular", str(error), self.last_good.t) from None
            raise

    def _in_pieces(self, before, t_end, counts):
        """The motion of a mode; after a step whose forces were not the consistent ones in pieces, which begin short and grow."""
        while True:
            self._next_piece(before.t)
            end, part = self.pieces.end or t_end, None
            for part in super()._motion(before, min(end, t_end), counts):
                yield part
            if isinstance(part, Change) or end >= t_end:
                return
            good = self.last_good
            before = State(good.t, good.q, good.v, good.a, good.lam, good.memory | {"polynomials": 1.0})

    def _next_piece(self, t):
        """Begin the next piece at time t if one has ended there, or the first if one was asked for."""
        length, end, longest = self.pieces
        if length and end <= t:
            length = 2.0 * length if end else length
            self.pieces = Pieces(length, t + length, longest) if length < longest else Pieces()

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
        ahead = singular_in_step(self.mode, before, after) if isinstance(self.mode, Slipping) else None
        if ahead and (ahead.t > after.t or (hit and hit[0] < ahead.t)):
            rows = hit[1] if hit else np.flatnonzero(self.status >= SLIPS_UP)
            ahead = ahead if all(self._lasts(k, before, ahead) for k in rows) else None
        if ahead:
            self.last_good, self.step = ahead, 0.0
            raise self.mode.singular()
        self.last_good, self.step = after, after.t - before.t
        return hit

    def _after_jump(self, t, q, v):
        """(t, v) with the forces after a jump at t: just after a kink, with the outputs of controllers that sample."""
        return beside(t, 1.0) if at_kink(self.whole, t) else t, self.whole.sampled(t, q, v)

    def _with_forces_after_jump(self, state):
        """A state of the mode, with the accelerations and multipliers after a jump of forces at its time."""
        t, v = self._after_jump(state.t, state.q, state.v)
        if t == state.t and v is state.v:
            return state
        a, lam = consistent_acceleration(self.mode, t, state.q, v)
        return State(state.t, state.q, state.v, a, lam, restart=False)

    def _jumped(self, before):
        """(time, numbers of the rows) whose status a jump of forces at the start of a step ends, or None."""
        state = self._with_forces_after_jump(before) if self.jumps else before
        if state is before:
            return None
        values = np.array([self.value(event, state) for event in self.events])
        rows = np.flatnonzero((values < -OFFSET * np.maximum(self.sizes, np.abs(values))) & (self.values > 0.0) & (self.status < SLIPS_UP))
        return (before.t, rows.tolist()) if len(rows) else None

    def _first_watched(self, before, after):
        """(time, numbers of the rows) at which equations begin to move rows at rest in a step, or no longer move rows of friction, or None."""
        if not self.contacts.turning:
            return None
        still = self.contacts.still(after.v)
        watched = self.statuses.watched
        times = before.t + NODES * (after.t - before.t)
        self.dwelling = self._dwelling(before, after, RESTS * still)
        if len(self.dwelling):
            return before.t, self.dwelling

        def moving(t):
            """Numbers of the watched rows that equations move at time t of the step, faster than `MOVES * still`."""
            return watched[np.abs(self.statuses.rates_by_equations(between(before, after, t))[watched]) > MOVES * still]

        for begin, end in pairwise([*times[:-1], after.t]) if len(watched) else ():
            if len(moving(end)):
                while begin < (middle := 0.5 * (begin + end)) < end:
                    begin, end = (begin, middle) if len(moving(middle)) else (middle, end)
                return end, moving(end)
        return None

    def _dwelling(self, before, after, least):
        """Numbers of the rows of friction that slip and that equations alone hold, whose rates are below `least` in all of a step."""
        rows = np.flatnonzero(self.statuses.fixed & (np.abs(self.values) < least)).tolist()
        for s in NODES if rows else ():
            state = between(before, after, before.t + s * (after.t - before.t))
            rates = self.statuses.rates_by_equations(state)
            rows = [k for k in rows if abs(rates[k]) < least]
        return np.array(rows, np.int64)

    def _lasts(self, number, before, ahead):
        """True if a row has the status that it had before at a state ahead, too; that of a closed contact follows from its force without friction."""
        if self.contacts.contact[number] and self.status[number] == CLOSED:
            return self.mode.would_press_without_friction(ahead, before.lam)
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

    def _hit(self, state):
        """True for the contacts that have closed and whose gap decreases, (rows with laws,)."""
        contacts, still, size = self.contacts, self.contacts.still(state.v), TOUCH * (self.whole.extent or 1.0)
        rates = self.whole.phi_rate(state.t, state.q, state.v)[contacts.rows]
        return contacts.contact & (contacts.gaps(state.t, state.q) <= size) & (rates < -still)

    @timed
    def _change(self, state, fired):
        """(State after, what happened, "") where the statuses of the rows `fired` end, or contacts are hit. Raises StepFailure."""
        if not uniqueness(self.mode, state, state) > 0.0:  # the event is of forces within round-off of that point
            self.last_good, self.step = state, 0.0
            raise self.mode.singular()
        state = self._with_forces_after_jump(state)
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
        after = self._settled(t, q, v, closed, begins, dwells)
        changed = np.flatnonzero(self.status != old)
        happened = happened or [Happened(t, self._told(k), 0.0, 0.0, 0) for k in changed]
        rows = np.union1d(changed, np.flatnonzero(hit))
        self._set_pieces(old, self._require_progress(t, rows if len(rows) else fired), hit.any())
        self.happened.happened += happened
        self._begin_functions(State(t, q, v, after.a, after.lam[self.mode.columns]), still)
        return replace(after, memory=self._memory(), restart=True), happened, ""

    def _impact(self, state, rates, still, hit, closed):
        """(velocities after an impact of the contacts `hit`, contacts that are closed then, what happened).

        rates: of the rows with laws before it; those below `still` are round-off. closed: the contacts that may take impulses. An impulse P takes
        the energy `-P (rate before + rate after) / 2`. Impacts slower than LEAST_SPEED are plastic.
        """
        contacts, t, q = self.contacts, state.t, state.q
        none, held = np.zeros(len(contacts.rows)), np.zeros(len(contacts.equations))
        v, P, _, status = contacts.impact(t, q, state.v, rates, closed, none, held, 0.0, None, np.abs(rates) < LEAST_SPEED)
        self.observer.hit(rates, P, status)
        after = self.whole.phi_rate(t, q, v)[contacts.rows]
        lost = -0.5 * P * (rates + after)
        # friction elsewhere may lose energy, too
        listed = (hit & (P > 0.0) & (self.status != CLOSED)) | ((P != 0.0) & (np.abs(rates + after) > still))
        happened = []
        for name in dict.fromkeys(contacts.names[k] for k in np.flatnonzero(listed)):
            of_part = np.array([other == name for other in contacts.names])
            happened.append(Happened(t, name, float(np.abs(P[of_part]).max()), float(lost[of_part].sum()), 0))
        return v, closed & (after <= still), happened

    def _begins(self, state, rates, closed, fired):
        """Directions in which rows that reached their bounds slip; opens the contacts without pressure. At a bound the laws allow both statuses."""
        begins, lam = np.zeros(len(self.events)), self.statuses.all_forces(state)
        for k in fired:
            if k in self.statuses.watched and abs(rates[k]) > self.contacts.still(state.v):  # equations move it
                continue
            if self.value(self.events[k], state) > AT_BOUND * max(np.abs(lam).max(initial=0.0), self.sizes[k]):
                continue
            if self.contacts.contact[k]:
                closed[k] &= self.status[k] != CLOSED
            elif self.status[k] == STICKS:
                begins[k] = np.sign(lam[self.whole.row_laws[k].row])
        return begins

    def _settled(self, t, q, v, closed, begins=0.0, dwells=NONE):
        """The State with consistent accelerations, and all columns of lam; sets statuses and mode. begins: directions of slip from rest.

        dwells: rows that equations hold at rest from now on.
        """
        contacts = self.contacts
        just_after, sampled = self._after_jump(t, q, v)
        a, lam, p, status = contacts.accelerations(just_after, q, sampled, closed, begins=begins, dwells=dwells)
        rates = self.whole.phi_rate(t, q, v)[contacts.rows]
        bounded = np.array([law.is_contact or law.mu > 0.0 or law.constant > 0.0 for law in self.whole.row_laws])
        slips = ~contacts.contact & (np.abs(rates) > contacts.still(v))
        slips[dwells] = False
        status = np.where(slips & (status > 0), np.where(rates > 0.0, SLIPS_UP, SLIPS_DOWN), status)
        self._set_status(np.where(bounded & contacts.active(closed), status, 0), t, q, v)
        return State(t, q, v, a, contacts.all_multipliers(lam, p), restart=False)

    def _require_progress(self, t, rows):
        """True if a change is later than the last one; raises StepFailure if rows change too often, in all or at one time."""
        advances = t > self.last_change + 1e-12 * max(1.0, abs(t))
        if advances:
            self.counts[1] = 0
            self.last_change = t
        self.counts[:, rows] += 1
        for limit, counts, why in ((MOST, self.counts[0], "changed"), (AT_ONCE, self.counts[1], "changed at one time")):
            if (counts > limit).any():
                name = self.contacts.names[int(np.argmax(counts))]
                advice = "use polyida.NonsmoothAlpha(h=...), which steps through"
                raise StepFailure("events", f"the contact or friction of {name!r} {why} more than {limit} times; {advice}", t)
        return advances

    def _set_pieces(self, old, advances, hit):
        """Begin the next motion with a short piece if its statuses were seen at this time before; `old`: statuses before the change.

        The forces of the step were not the consistent ones then, as of mesh modes that it does not resolve. advances: the change is after the
        last one. hit: contacts were hit.
        """
        now = self.status.tobytes()
        self.seen = {old.tobytes()} if advances else self.seen
        again = now in self.seen and not (advances or hit)  # the same statuses twice at one time, without an impact
        self.seen.add(now)
        self.pieces = Pieces(SHORTER * self.step, 0.0, max(self.step, self.pieces.longest)) if again else Pieces()

    def _begin_functions(self, state, still):
        """Set values, sides and sizes of the functions at the first state of a motion; still: speeds below it are round-off, m/s."""
        contact = self.contacts.contact
        self.values = np.array([self.value(event, state) for event in self.events])
        # slip from rest, and the gap of a contact that opens, are round-off of either sign at first
        begins = np.where(contact, self.status == 0, self.status >= SLIPS_UP)
        begins &= self.values <= np.where(contact, TOUCH * (self.whole.extent or 1.0), still)
        self.sides = np.where(begins, 0.0, 1.0)
        self.sizes = np.abs(self.values)

    def _told(self, k):
        """Name of the part of row k and what its new status is, for users: "floor closes"."""
        free = "opens" if self.contacts.contact[k] else "sticks" if self.statuses.without_function[k] else "is free"
        return f"{self.contacts.names[k]} {WORDS.get(int(self.status[k]), free)}"


def _require_no_edges(whole, method):
    """Raise InputError if contacts of the model are with edges, whose rows are not smooth."""
    if whole.is_scene and whole.edge_rows:
        names = ", ".join(law.name for law in whole.row_laws if law.row in [rows.first for rows in whole.edge_rows])
        why = "their rows are not smooth, which takes polyida.NonsmoothAlpha(h=...) or MoreauJean(h=...)"
        raise InputError(f"{method.class_name()}: the contacts of {names} are with edges; {why}")
