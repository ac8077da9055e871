"""The collocation equations of any model and their Newton corrections: what `scene/` does in compiled code for a scene's.

For each mode of the tableau, with c = l/h, l its eigenvalue, the transformed stages solve

    |  S    B^T  (c M + C) G^T |  |dq  |     |r |     M v' + g + B^T lam           S = K + c C + c^2 M
    |  B                       |  |dlam| = - |r3|     phi                          G = B D^-1
    |  c B + H         B G^T   |  |dmu |     |r4|     phi' = B v + phi_t           H = d phi'/dq

v follows q and mu, dv = c dq + G^T dmu; B, H and G are those of the middle stage.
"""

import numpy as np

from polyida.errors import InputError
from polyida.integrate.kinks import inner_side
from polyida.integrate.radau.newton import Failed, trial
from polyida.integrate.sizes import ROUND_OFF, extent
from polyida.linear.lu import SingularSystem
from polyida.linear.matrix import dense
from polyida.model.differences import along, reach_along

NOTHING = 1e-12  # of the largest mass: none
MOVES = 3  # of q onto phi = 0, at most
AGAIN = 1e-9  # of the model's size: |phi| beyond which the constraints' system is made anew where q has moved to


class PlainSystem:
    """Of a model, for the stages of a tableau; tied: with mu, where the model has any.

    `begin` a step, fill `trial`, `take` matrices, `iterate`, `close`. asks: whether a step's end is to be asked for a and lam, and for an objection.
    """

    asks = True

    def __init__(self, model, tableau, tied, moves_v, counts, kind):
        needs, self.model, self.tableau, self.counts, self.kind = model.needs, model, tableau, counts, kind
        bent = model.m > 0 and (needs.phi_q_varies or needs.driven)
        self.tied, self.moves_v = tied and bent, moves_v and bent
        self.lift = self.shares = None
        self.trial = trial(tableau.stages, model.n, model.m, self.tied)

    def weigh(self, shares):
        """Take the coordinates' shares in the mass, of which the norm and D are made."""
        self.shares, self.lift = shares, lift(self.model, shares)

    def matrices(self, h, made_at):
        """Those of steps of h at made_at, not made yet."""
        return self.kind(self.model, self.tableau.modes, h, made_at)

    def expect(self, grid, clamp):
        """Nothing: a model of one's own is asked at the time of each step."""

    def begin(self, state, h, times, closed):
        """Go on from a state: h, the times of the stages, and (phi, rate) there as they are carried, or None."""
        self.state, self.h, self.times, self.closed, model = state, h, times, closed, self.model
        self.increments = None
        if closed is not None:
            ends = [(inner_side(model, state.t, -h), t) for t in times]
            steps = zip(times, ends, self.tableau.c * h)
            self.increments = [model.increments(state.t, t, end, step, state.q, state.v) for t, end, step in steps]

    def take(self, matrices):
        """Give the matrices the constraints' rows of the middle stage."""
        needs, k = self.model.needs, self.tableau.middle
        if matrices.borders is None or needs.phi_q_varies or needs.driven:
            self.trial.dv[:] = self.tableau.W @ self.trial.e / self.h  # mu is zero here
            q, v = self._at(k)
            rows = Rows(self.model, self.times[k], q, v, self.lift if self.tied else None)
            try:
                matrices.surround(rows, self.counts)
            except SingularSystem as error:
                raise Failed("singular", str(error)) from None

    def iterate(self, matrices):
        """One iteration; returns |dq|, |dv| h with it, root mean square by mass. Raises Failed."""
        x = self.trial
        residuals = self._residuals()
        self.counts.solves += len(matrices.modes)
        try:
            dq, dlam, dmu = matrices.stages(*residuals)
        except SingularSystem as error:
            raise Failed("singular", str(error)) from None
        for part, change in zip((x.e, x.lam, x.mu), (dq, dlam, dmu)):
            part += change
        return float(np.sqrt(np.mean((dq**2 + (self.tableau.W @ dq) ** 2) @ self.shares)))

    def close(self):
        """Bring v and v' up to the last correction, and the step's end onto its constraints: (phi, rate) there as they are carried, or None.

        Moves are along M^-1 B^T. Raises Failed where they are singular.
        """
        self._move()
        if not self.model.m:
            return None
        try:
            system = self._close_q(self.times[-1])
            if self.moves_v:
                self._close_v(self.times[-1], system)
        except (InputError, np.linalg.LinAlgError) as error:
            raise Failed("singular", str(error)) from None
        return None if self.increments is None else self._rows(len(self.times) - 1)

    def _close_q(self, t):
        """Move the end onto phi = 0; the system of M and B there, where it was needed."""
        system, size, none = None, extent(self.model, self.state.q), np.zeros(self.model.n)
        for _ in range(MOVES):
            phi = self._rows(len(self.times) - 1)[0]
            if np.abs(phi).max() <= ROUND_OFF * size:
                break
            system = system or self.model.mass_system(t, self._at(-1)[0])
            self.trial.e[-1] += system.solve(none, phi)[0]
            system = None if np.abs(phi).max() > AGAIN * size else system
        return system

    def _close_v(self, t, system):
        q, v = self._at(-1)
        rate = self.model.phi_rate(t, q, v) if self.increments is None else self._rows(len(self.times) - 1)[1]
        if rate.any():
            self.trial.dv[-1] += (system or self.model.mass_system(t, q)).solve(np.zeros(self.model.n), rate)[0]

    def error(self, matrices, a):
        """|q_ - q| of the step's end against a method of order s; a (n,): v' at the last step's end.

        It is what that and v_0 are off the stages' polynomial, freed by a solve of what no step resolves.
        """
        x, h, start = self.trial, self.h, self.tableau.start
        self.counts.solves += 1
        dq = matrices.smooth(start @ x.e / h, a + start @ x.dv / h)
        return float(np.sqrt(self.shares @ dq**2))

    def _at(self, i):
        x, state = self.trial, self.state
        return state.q + (self.tableau.c[i] * self.h * state.v + x.e[i]), state.v + x.dv[i]

    def _move(self):
        x, W, h = self.trial, self.tableau.W, self.h
        x.dv[:] = W @ x.e / h
        if self.tied:
            self.B = [dense(self.model.phi_q(t, self._at(i)[0])) for i, t in enumerate(self.times)]
            for i, B in enumerate(self.B):
                x.dv[i] += self.lift * (B.T @ x.mu[i])
        x.a[:] = W @ x.dv / h

    def _rows(self, i):
        """(phi, phi') of a stage."""
        model, x, (q, v) = self.model, self.trial, self._at(i)
        if self.increments is not None:
            return self.increments[i](x.e[i], x.dv[i], *self.closed)
        phi = model.phi(self.times[i], q) if model.m else np.zeros(0)
        return phi, self.B[i] @ v + model.phi_t(self.times[i], q) if self.tied else np.zeros(0)

    def _residuals(self):
        """(r, r3, r4) of all stages, each (s, ...)."""
        x = self.trial
        self._move()
        self.counts.residuals += len(self.times)
        self.counts.newton_iterations += 1
        r = np.array([self.model.residual(t, *self._at(i), x.a[i], x.lam[i]) for i, t in enumerate(self.times)])
        phi, rate = (np.array(rows) for rows in zip(*map(self._rows, range(len(self.times)))))
        residuals = r, phi, rate if self.tied else x.mu
        if not all(np.isfinite(part).all() for part in residuals):
            raise Failed("not finite", "the motion is not finite")
        return residuals


def lift(model, shares):
    """D^-1 (n,) from the coordinates' shares in the mass; those without mass count as any, and as all where all are alike."""
    heavy = shares > NOTHING * shares.max()
    masses = np.where(heavy, 1.0 / (len(shares) * np.where(heavy, shares, 1.0)), 1.0)
    return np.ones_like(shares) if model.alike else masses


class Rows:
    """The constraints' rows at (t, q, v): B (m, n), and H and G (m, n) where there is mu.

    lift: the diagonal of D^-1 (n,), or None where there is no mu.
    """

    def __init__(self, model, t, q, v, lift):
        self.B, self.tied = dense(model.phi_q(t, q)), lift is not None
        self.G = self.B * lift if self.tied else self.B[:0]
        self.H = _slope(model, t, q, v, self.B) if self.tied else np.zeros((0, model.n))
        self.both = np.vstack([self.B, self.H])

    def below(self, c, r3, r4):
        """The right-hand sides of the rows on dq."""
        return np.concatenate([-r3, c * r3 - r4]) if self.tied else -r3

    def corner(self):
        """What the multipliers add to the rows."""
        m = len(self.B)
        corner = np.zeros((len(self.both), len(self.both)))
        if self.tied:
            corner[m:, m:] = self.B @ self.G.T
        return corner


def _slope(model, t, q, v, B):
    """d(phi_q v + phi_t)/dq, which is the slope of phi_q along the motion."""
    return along(lambda s: dense(model.phi_q(t + s, q + s * v)), reach_along(q, v))
