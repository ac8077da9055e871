"""Rows with laws of a model at a state: forces, accelerations, impacts and positions that satisfy the laws, each by a cone problem.

Rows without a law are equations of `base`, a model of its own. The rows with laws (contact, friction) have the slopes B. Pressures p = -lam
of theirs change the solution of the equations, with the matrix S = M or the step matrix, by

    dq = X p,  dlam = Y p,   [[S, B_e^T], [B_e, 0]] (X, Y) = (B^T, 0),   B_e: slopes of the equations

so that the rates of the rows with laws are `u = G p + b`, `G = B X`, b those at p = 0. Each question is answered in this order: the rows that
can carry a force (`active`, `group`), their slopes (`slopes`), X, Y and G (`mass_columns`), and the cone problem for p (`solve`). The questions:
`accelerations` (forces at a state), `impact` (velocities behind an impact), `place` (positions without penetration).
"""

from typing import NamedTuple

import numpy as np

from polyida.errors import InputError, StepFailure
from polyida.integrate.nonsmooth.cone import CLOSED, CONTACT, FRICTION, OPEN, STICKS, Cone, solve_cone
from polyida.integrate.state import State
from polyida.linear.lu import dense

TOUCH = 1e-9  # of the model's extent: a smaller gap is closed
OPENED = 1e-6  # of the model's extent: deeper penetration at the start is a mistake
ROUND_OFF = 1e-12  # of the model's extent: penetration that is left
ROUNDS = 20
KEPT = 8  # sets of rows whose slopes, columns by the masses and cone problems are kept
FIXED = 1e-13  # of the mobility: a row that the equations hold
DEPENDENT = 1e-10  # of G_ii: a row that others determine
MOVES = 1e-9  # of the accelerations: round-off of that of a row
WITHIN = 0.999  # of the bound of friction: an interpolated force below it is of a row that sticks
GAINED = 1e-9  # of the work of an impact: round-off of the energy it adds
HALVINGS = 40  # of the share of restitution that keeps the energy


class Group(NamedTuple):
    """Rows with laws that take part in a cone problem, and its arrays, which each problem fills."""

    rows: np.ndarray  # their numbers among the rows with laws
    of_model: np.ndarray  # their numbers among all rows of the model
    friction: np.ndarray  # True for rows of friction
    cone: Cone
    entries: np.ndarray  # of `cone.l` and `cone.L` that are multipliers of equations
    equations: np.ndarray  # numbers of these equations


class Problem(NamedTuple):
    """The cone problem of the k rows of a group: p with `u = G p + b` that satisfies the laws.

    start: where Newton's method begins. lam: multipliers of the equations at p = 0, Y (equations, k): their change with p. held_below: G_ii up
    to which the equations hold a row: it carries no force, but friction if it slips. slip: sign of the rate of each row, 0 if it sticks or is a
    contact.
    """

    G: np.ndarray
    b: np.ndarray
    start: np.ndarray
    lam: np.ndarray
    Y: np.ndarray
    held_below: np.ndarray
    slip: np.ndarray

    def part(self, which):
        """The problem of the rows of a mask, with p = 0 in the others."""
        G = self.G[np.ix_(which, which)]
        return Problem(G, self.b[which], self.start[which], self.lam, self.Y[:, which], self.held_below[which], self.slip[which])


class Accelerations(NamedTuple):
    """Consistent accelerations and forces at a state, of `Contacts.accelerations`."""

    a: np.ndarray  # (n,)
    lam: np.ndarray  # (equations,)
    p: np.ndarray  # (k,) pressures of the rows with laws
    status: np.ndarray  # (k,) int


class ImpactResult(NamedTuple):
    """What `Contacts.impact` returns."""

    v: np.ndarray  # (n,) velocities after it
    impulses: np.ndarray  # (k,) P of the rows with laws, N s
    change: np.ndarray  # (equations,) change of the impulses of the equations, N s
    status: np.ndarray  # (k,) int; OPEN for what rebounds


class Contacts:
    """The rows with laws of a model. rows: their numbers; equations: those of the other rows; base: the model with these alone.

    on_laws, on_equations (., 2): pairs of a row of friction and a row that presses it, among the rows with laws and among the equations.
    Vectors (k,) are of all rows with laws, in this order, unless a group is named.

    Results that are asked for again are kept: the last one of `active` (by the mask), `mobility` (by the array B itself), `rates` (by the arrays
    q and v and the time) and `still` (by the array v); up to KEPT of `slopes` (by the rows, at one q), `mass_columns` (by the array B) and `group`
    (by the rows). An array is compared by identity, not by its numbers: nobody writes into one that was passed.
    """

    def __init__(self, model):
        """Split the rows of a model by its laws."""
        laws = model.row_laws
        self.model = model
        self.rows = np.array([law.row for law in laws], np.int64)
        self.equations = np.setdiff1d(np.arange(model.m), self.rows)
        self.base = model.with_rows(self.equations)
        self.names = [law.name for law in laws]
        self.contact = np.array([law.is_contact for law in laws], bool)
        self.restitution = np.array([law.restitution or 0.0 for law in laws])
        self.mu = np.array([law.mu for law in laws], float)
        self.constant = np.array([law.constant for law in laws], float)
        self._slopes = {}  # {(type, bytes) of the rows: (q, t, model, slopes)}
        self._columns = {}  # {id(B): (B, X, Y, G)}
        self._groups = {}  # {bytes of the mask: Group}
        self._rates = (None, None, None, None)  # q, v, t and the rates there
        self._active = (None, None)  # bytes of `closed`, and the rows active then
        self._mobility = (None, None)  # B and its mobility
        self._still = (None, None)  # v and the rate below which friction sticks
        self.turning = model.needs.phi_q_varies or model.needs.driven
        self.speed = max(float(np.sqrt(model.free_fall * (model.extent or 1.0))), 1e-6)
        masses = np.abs(model.mass(np.zeros(model.n)).diagonal())
        self.inertia = float(masses.max()) or 1.0
        self.on_laws, self.on_equations = self._pressed_by(self.rows), self._pressed_by(self.equations)

    def _pressed_by(self, rows):
        """Pairs (., 2) of the number of a row of friction among those with laws, and of one that presses it among `rows`."""
        numbers = {int(row): k for k, row in enumerate(rows)}
        found = [(k, numbers[row]) for k, law in enumerate(self.model.row_laws) for row in law.on if row in numbers]
        return np.array(found, np.int64).reshape(-1, 2)

    def active(self, closed):
        """True for the rows that can carry a force: closed contacts, and friction whose pressing contacts are closed."""
        key, active = self._active
        if key != closed.tobytes():
            pressed = self.constant > 0.0
            pressed[self.on_equations[:, 0]] = True
            pressed[self.on_laws[closed[self.on_laws[:, 1]], 0]] = True
            active = np.where(self.contact, closed, pressed)
            self._active = closed.tobytes(), active
        return active

    def slopes(self, t, q, which, model=None):
        """phi_q of the rows with laws that `which` selects, a mask or their numbers, (k, n), dense; of the model `facing` a position if given.

        Those of the last sets are kept while phi_q is the same.
        """
        which, model = np.asarray(which), model or self.model
        key = which.dtype.char, which.tobytes()
        known_q, known_t, known_model, B = self._slopes.get(key, (None, t, model, None))
        if B is None or (self.turning and not (known_q is q and known_t == t and known_model is model)):
            if len(self._slopes) >= KEPT:
                self._slopes.clear()
            rows = self.rows[which]
            B = model.phi_q_rows(t, q, rows) if model.is_scene else dense(model.phi_q(t, q)[rows]) if len(rows) else np.zeros((0, model.n))
            self._slopes[key] = q, t, model, B
        return B

    def mobility(self, B):
        """Squares of the rows B over the largest mass, (k,); those of the last B are kept."""
        if self._mobility[0] is not B:
            self._mobility = B, np.einsum("ij,ij->i", B, B) / self.inertia
        return self._mobility[1]

    def gaps(self, t, q):
        """Gaps of all rows with laws, (k,): phi of each contact, and 0 for each row of friction, which has none."""
        return np.where(self.contact, self.model.phi(t, q)[self.rows], 0.0)

    def columns(self, solve, B):
        """(X (n, k), Y (equations, k)) of rows B (k, n): changes of q and lam for unit pressures, by solve(r (n, k), phi)."""
        return solve(-B.T, np.zeros((len(self.equations), len(B)))) if len(B) else (B.T, np.zeros((len(self.equations), 0)))

    def mass_columns(self, t, q, B):
        """`columns` by the masses, and G = B X. Those of the last rows B of `slopes` are kept, as on a line of the ground."""
        known_B, X, Y, G = self._columns.get(id(B), (None, None, None, None))
        if known_B is not B or self.base.needs.mass_varies:
            if len(self._columns) >= KEPT:
                self._columns.clear()
            X, Y = self.columns(self.base.mass_system(t, q).solve, B)
            G = B @ X
            self._columns[id(B)] = B, X, Y, G
        return X, Y, G

    def rates(self, t, q, v):
        """phi_rate of all rows of the model; that of the last state is kept."""
        known_q, known_v, known_t, rates = self._rates
        if not (known_q is q and known_v is v and known_t == t):
            rates = self.model.phi_rate(t, q, v)
            self._rates = q, v, t, rates
        return rates

    def mobilities(self, t, q, numbers):
        """(G (k, k), a typical G_ii without equations (k,), Y) of the rows with laws of these numbers, by the masses."""
        B = self.slopes(t, q, numbers)
        _, Y, G = self.mass_columns(t, q, B)
        return G, self.mobility(B), Y

    def solve(self, t, group, problem, scale=1.0, slips=False):
        """(p (k,), status (k,) int) of the k rows of a group, by its Problem. Raises StepFailure.

        It writes c, sign, l and L of `group.cone`: a Group has the arrays of the problem that was solved last, not those of a state. scale: of the friction's constant. slips: True if rows with a slip go on to slip.
        """
        slip = problem.slip
        fixed = problem.G.diagonal() <= problem.held_below
        if fixed.any():
            free = ~fixed | (slip != 0.0)
            if not free.all():
                chosen = np.zeros(len(self.rows), bool)
                chosen[group.rows[free]] = True
                p, status = np.zeros(len(free)), np.zeros(len(free), np.int64)
                p[free], status[free] = self.solve(t, self.group(chosen), problem.part(free), scale, slips)
                return p, status
            slip = slip if slips else np.where(fixed, slip, 0.0)
        elif not slips:
            slip = 0.0
        rows, cone = group.rows, group.cone
        cone.c[:], cone.sign[:] = scale * self.constant[rows], slip
        if len(group.entries):
            cone.l[group.entries], cone.L[group.entries] = problem.lam[group.equations], problem.Y[group.equations]
        p, status = np.array(problem.start, float), np.zeros(len(rows), np.int64)
        if len(rows) and solve_cone(np.array(problem.G), np.ascontiguousarray(problem.b), cone, p, status) < 0:
            names = ", ".join(dict.fromkeys(self.names[i] for i in rows))
            raise StepFailure("contact", f"no forces satisfy the laws of contact and friction of {names}", t)
        return p, status

    def group(self, chosen):
        """The Group of a mask of rows with laws; the last ones are kept."""
        key = chosen.tobytes()
        if key not in self._groups:
            if len(self._groups) >= KEPT:
                self._groups.clear()
            self._groups[key] = self._new_group(np.flatnonzero(chosen))
        return self._groups[key]

    def _new_group(self, rows):
        """The Group of rows with laws: its friction has an entry for each row or equation that presses it, ordered by rows of friction."""
        number = np.full(len(self.rows), -1)  # in the group
        number[rows] = np.arange(len(rows))
        on_laws = number[self.on_laws]
        on_laws = on_laws[(on_laws >= 0).all(axis=1)]
        on_equations = self.on_equations[number[self.on_equations[:, 0]] >= 0]
        pressed = np.concatenate([on_laws[:, 0], number[on_equations[:, 0]]])
        order, start = np.argsort(pressed, kind="stable"), np.append(0, np.cumsum(np.bincount(pressed, minlength=len(rows))))
        L = np.concatenate([np.eye(len(rows))[on_laws[:, 1]], np.zeros((len(on_equations), len(rows)))])[order]
        kind, entries = np.where(self.contact[rows], CONTACT, FRICTION), np.flatnonzero(order >= len(on_laws))
        cone = Cone(kind, np.zeros(len(rows)), self.mu[rows], np.zeros(len(rows)), start, np.zeros(len(order)), L)
        return Group(rows, self.rows[rows], kind == FRICTION, cone, entries, on_equations[order[entries] - len(on_laws), 1])

    def spread(self, group, values):
        """Values of the rows of a group at all rows with laws, 0 at the others."""
        result = np.zeros(len(self.rows), values.dtype)
        result[group.rows] = values
        return result

    def all_multipliers(self, lam, p, group=None):
        """lam (m,) of all rows of the model, from lam of the equations, and p of all rows with laws or of those of a group."""
        result = np.zeros(self.model.m)
        result[self.equations] = lam
        result[self.rows if group is None else group.of_model] = -p
        return result

    def at_rest(self, t, q, v):
        """True for the contacts that are closed and neither open nor approach; one that approaches is hit."""
        return self.contact & (self.gaps(t, q) <= TOUCH * self._size(q)) & (np.abs(self.rates(t, q, v)[self.rows]) <= self.still(v))

    def begin(self, state):
        """The start of a run from a consistent State of the equations: forces of the contacts that are closed and at rest, memory of `closed`.

        Raises InputError for contacts that are penetrated.
        """
        t, q, v = state.t, state.q, state.v
        gaps = self.gaps(t, q)
        if gaps.min(initial=0.0) < -OPENED * self._size(q):
            name = self.model.constraint_name(int(self.rows[np.argmin(gaps)]))
            raise InputError(f"the start: {name} is penetrated by {-gaps.min():.3g}; move the bodies apart, or let scene.assemble() do it")
        return self.with_forces(t, q, v, self.at_rest(t, q, v))

    def _size(self, q):
        """Length that a gap is compared with: the scene's extent, or |q| of an own model, at least 1."""
        return self.model.extent or max(1.0, float(np.abs(q).max(initial=0.0)))

    def with_forces(self, t, q, v, closed):
        """The State with consistent accelerations, and memory of `closed`.

        Where sliding friction has no force (Painleve), contacts do not act, and the next step closes them by an impact.
        """
        try:
            a, lam, p, _ = self.accelerations(t, q, v, closed)
        except StepFailure:
            closed = np.zeros(len(closed), bool)
            a, lam, p, _ = self.accelerations(t, q, v, closed)
        return State(t, q, v, a, self.all_multipliers(lam, p), {"closed": closed, "p": p, "a_alg": a})

    def with_known_forces(self, state, lam):
        """The State with consistent forces, from one of the equations; lam: forces nearby, of which contacts press and friction sticks or slips."""
        p = -lam[self.rows]
        bounds = np.array([law.constant + law.mu * np.linalg.norm(lam[list(law.on)]) for law in self.model.row_laws])
        status = np.where(~self.contact & (np.abs(p) < WITHIN * bounds), STICKS, OPEN)
        a, lam, p, _ = self.accelerations(state.t, state.q, state.v, self.contact & (p > 0.0), p, status=status)
        return State(state.t, state.q, state.v, a, self.all_multipliers(lam, p))

    def accelerations(self, t, q, v, closed, p=None, begins=0.0, status=None, dwells=()):
        """Accelerations that are consistent at a state, with their forces.

        closed: contacts that are closed and at rest. begins: 0, or the direction in which rows of friction at rest begin to slip. status: of
        the rows, if it is known which stick; their rates are round-off then. dwells: numbers of rows of friction that equations hold at rest;
        their accelerations are round-off, too, that of the second derivative of a motor's angle by differences for example.
        """
        model, group = self.model, self.group(self.active(closed))
        rows = group.rows
        force, bias = model.force(t, q, v), model.phi_bias(t, q, v) if model.m else np.zeros(0)
        a, lam = self.base.mass_system(t, q).solve(force, bias[self.equations])
        if not len(rows):
            return Accelerations(a, lam, np.zeros(len(self.rows)), np.zeros(len(self.rows), np.int64))
        slip = self.signs_of_slip(group, self.rates(t, q, v), self.still(v))
        if status is not None:
            slip[status[rows] == STICKS] = 0.0
        slip = np.where(slip == 0.0, np.broadcast_to(begins, len(self.rows))[rows], slip)
        dwelling = np.isin(rows, dwells)
        slip[dwelling] = 0.0
        B = self.slopes(t, q, rows)
        X, Y, G = self.mass_columns(t, q, B)
        free = B @ a + bias[group.of_model]  # accelerations of the rows without their forces
        round_off_scale = np.abs(B) @ (np.abs(a) + np.abs(force).max(initial=0.0) / self.inertia)
        # friction that accelerates without forces is not held, though its G_ii is zero at a dead point of the equations
        accelerates = group.friction & (np.abs(free) > MOVES * round_off_scale) & ~dwelling
        held_below = np.where(accelerates, -np.inf, FIXED * self.mobility(B))
        start = np.zeros(len(rows)) if p is None else p[rows]
        p, status = self.solve(t, group, Problem(G, free, start, lam, Y, held_below, slip), slips=True)
        return Accelerations(a + X @ p, lam + Y @ p, self.spread(group, p), self.spread(group, status))

    def impact(self, t, q, v, before, closed, p, lam, h, wanted=None, plastic=None):
        """The ImpactResult with the velocities at which all impulses satisfy the laws, after an impact or at a step's end.

        v: velocities with the impulses h p and h lam, N s or N m s. before (k,): rates of the rows with laws before the impact. closed: the contacts
        at which velocities must open. h: s; 0 for an impact at an instant. wanted (k,): rates at which friction would stick. plastic: True for contacts without
        restitution.

        With friction, Newton's law of restitution may add energy where slip reverses (Kane, Levinson, Dynamics, 1985). All coefficients are
        then multiplied by the number below 1 that keeps the energy; at the end of a step by its square, which loses some.
        """
        rate, group = self.rates(t, q, v), self.group(self.active(closed))
        if rate[self.equations].any():
            v = v + self.base.mass_system(t, q).solve(np.zeros(self.model.n), rate[self.equations])[0]
            rate = self.rates(t, q, v)
        rows = group.rows
        if not len(rows):
            none = np.zeros(len(self.rows))
            return ImpactResult(v, none, np.zeros(len(self.equations)), np.zeros(len(self.rows), np.int64))
        p_group, before_group = p[rows], before[rows]
        B = self.slopes(t, q, rows)
        X, Y, G = self.mass_columns(t, q, B)
        slip, rate = self.signs_of_slip(group, rate, self.still(v)), rate[group.of_model]
        free = rate - h * (G @ p_group)  # without the impulses of the rows
        back = self._rebounds(rows, before_group, free, h, plastic)
        bounces = back.any()
        shift = 0.0 if wanted is None else -wanted[rows]
        start, held_below = h * p_group, FIXED * self.mobility(B)

        def rebound(share):
            """(P, status, change, work of it) of the active rows with this share of the restitution."""
            problem = Problem(G, free + share * back + shift, start, h * (lam - Y @ p_group), Y, held_below, slip)
            P, status = self.solve(t, group, problem, h)
            change = P - start
            return P, status, change, 0.5 * (before_group + rate + G @ change) @ change

        P, status, change, work = rebound(1.0)
        if bounces and work > GAINED * float(np.abs(before_group * change).sum()):
            # in a step the work is known to the order of h only, and energy must not grow: the square leaves a margin for that
            share = _largest_without_gain(rebound) ** (2 if h else 1)
            P, status, change, _ = rebound(share)
            back = share * back
        if bounces:
            status[back != 0.0] = OPEN
        return ImpactResult(v + X @ change, self.spread(group, P), Y @ change, self.spread(group, status))

    def _rebounds(self, rows, before, free, h, plastic):
        """Rates of rows behind an impact by the law of restitution, times -1; before, free: their rates before it, and without impulses.

        0 for contacts that are plastic, and in a step for those whose rate its forces change by more than they would rebound.
        """
        back = self.restitution[rows] * np.minimum(before, 0.0)
        if not back.any():
            return back
        if plastic is not None:
            back = np.where(plastic[rows], 0.0, back)
        return np.where(np.abs(back) < np.abs(free - before), 0.0, back) if h else back

    def remaining(self, t, q, v, touching, status):
        """(rates (k,), True for the contacts that stay closed (k,)) of the rows with laws behind an impact, at (t, q, v), v behind it.

        touching (k,): contacts closed at the impact; those stay closed that do not open, rate <= `still(v)`, or that carry a force: where
        `status` (k,) is CLOSED the rate is round-off.
        """
        rate = self.rates(t, q, v)[self.rows]
        return rate, touching & ((rate <= self.still(v)) | (status == CLOSED))

    def reversals(self, state, t, q, v, before, closed, p):
        """Rates at t of rows of friction whose slip came to an end in the step from a state to t, if it goes on in reverse; 0 elsewhere.

        The force jumps within the step: a rate that begins at `before` is zero where it meets zero, and grows with its new acceleration. The
        impulse of friction that leads to it is between those of both forces. None if there are none.
        """
        rate = self.rates(t, q, v)[self.rows]
        slipped = ~self.contact & self.active(closed) & (np.abs(before) > self.still(v)) & (rate * before <= 0.0)
        if not slipped.any():
            return None

        def rows_of(t, q, v, a):
            """Accelerations of the rows that slipped, by the accelerations a (n,) at a state."""
            return self.slopes(t, q, slipped) @ a + self.model.phi_bias(t, q, v)[self.rows][slipped]

        before, ahead = before[slipped], rows_of(state.t, state.q, state.v, state.a)
        behind = rows_of(t, q, v, self.accelerations(t, q, v, closed, p).a)
        with np.errstate(divide="ignore"):
            left = (t - state.t) + before / ahead  # time that is left behind the reversal
        goes_on = (ahead * before < 0.0) & (left > 0.0) & (behind * before < 0.0)
        wanted = np.zeros(len(rate))
        wanted[slipped] = np.where(goes_on, behind * left, 0.0)
        return wanted if goes_on.any() else None

    def signs_of_slip(self, group, rates, still):
        """Signs of the rates of friction in a group, 0 for rows that stick, up to `still`, and for contacts. rates: of all rows of the model."""
        rate = rates[group.of_model]
        return np.where(group.friction & (np.abs(rate) > still), np.sign(rate), 0.0)

    def still(self, v):
        """Rate below which a row of friction sticks; that of the last v is kept."""
        if self._still[0] is not v:
            self._still = v, 1e-10 * max(float(np.abs(v).max(initial=0.0)), self.speed)
        return self._still[1]

    def place(self, t, q, pressed, size):
        """(q, contacts that touch): q moved in the metric of M, so that the equations and the pressed contacts hold and no gap is negative.

        size: of the model, m.
        """
        model, pushed = self.model, self.contact & pressed
        for _ in range(ROUNDS):
            phi = model.phi(t, q)
            gaps = np.where(self.contact, phi[self.rows], np.inf)
            touching = self.contact & (pressed | (gaps < ROUND_OFF * size))
            wrong = np.abs(phi[self.equations]).max(initial=0.0), np.abs(gaps[pressed]).max(initial=0.0), -gaps.min(initial=0.0)
            if max(wrong) <= ROUND_OFF * size:
                return q, pushed | (gaps <= TOUCH * size)
            zero = np.zeros(model.n)
            shift = self.base.mass_system(t, q).solve(zero, phi[self.equations])[0] if len(self.equations) else zero
            if touching.any():
                B = self.slopes(t, q, touching)
                X, _, G = self.mass_columns(t, q, B)
                push = self._pushes(t, touching, G, gaps[touching] + B @ shift, pressed[touching])
                shift = shift + X @ push
                pushed[touching] |= push > 0.0
            q = q + shift
        return q, pushed | (self.contact & (self.gaps(t, q) <= TOUCH * size))

    def _pushes(self, t, touching, G, b, pressed):
        """p of the contacts that touch: with `G p + b = 0` if pressed, of least norm, else `0 <= p`, `G p + b >= 0`, their product 0."""
        p, free = np.zeros(len(b)), ~pressed
        inverse = np.linalg.pinv(G[np.ix_(pressed, pressed)], rcond=1e-11, hermitian=True)
        onto = G[np.ix_(free, pressed)] @ inverse
        if free.any():  # the pressed ones are eliminated
            G_free = G[np.ix_(free, free)] - onto @ G[np.ix_(pressed, free)]
            b_free = b[free] - onto @ b[pressed]
            chosen = np.array(touching)
            chosen[touching] = free
            lam = np.zeros(len(self.equations))  # contacts need none: their laws have no bounds
            held_below = DEPENDENT * G.diagonal()[free]
            problem = Problem(G_free, b_free, p[free], lam, np.outer(lam, b_free), held_below, np.zeros(len(b_free)))
            p[free] = self.solve(t, self.group(chosen), problem)[0]
        p[pressed] = -inverse @ (b[pressed] + G[np.ix_(pressed, free)] @ p[free])
        return p


def _largest_without_gain(rebound):
    """The largest share of the restitution, by bisection, with which an impact, `rebound(share)`, adds no energy."""
    low, high = 0.0, 1.0
    for _ in range(HALVINGS if rebound(low)[3] < 0.0 else 0):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if rebound(middle)[3] <= 0.0 else (low, middle)
    return low
