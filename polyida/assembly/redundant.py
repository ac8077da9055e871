"""Rows of phi of a scene that depend on others at the start, and which of them are left out.

B_k are the independent rows; the others are `B_d = C B_k` in all states of the mechanism. Multipliers with equal forces,
`B^T lam = B_k^T lam_k`, are `(lam_k, 0) + N y`, `N = (-C^T, 1)`. The ones of least norm on the rows of joints are taken; multipliers of rows
that keep a body rigid do not enter the norm.
"""

import numpy as np
from scipy.linalg import qr

from polyida.errors import InputError
from polyida.joint.joint import Joint
from polyida.linear.saddle import DEPENDENT, coordinate_sizes

AWAY = 1e-3  # of the scene's size: distance from the start at which redundancy is checked again
PREFERRED = 1e3  # factor on the length of rows that keep a body rigid: these are chosen first as independent rows
SAME = 1e-9  # of the scene's size: largest |phi| of a redundant row there
UNIQUE = 1e-8  # coefficients of a dependence that count as zero
ROUNDS = 20  # Newton steps back onto the independent rows
NAMED = 6  # rows that a message names


class Redundant:
    """The redundant rows of a model with all rows, `whole`. left_out, independent: numbers of rows; labels: of the rows left out.

    Rows are compared at (t, q) in units of `coordinate_sizes`, by a rank-revealing QR of phi_q^T. Raises InputError if rows depend on
    others in this position only, or contradict them nearby.
    """

    def __init__(self, whole, t, q):
        """Find the rows of a scene at (t, q) that depend on others, by a pivoted QR factorisation of its scaled rows."""
        self.whole, self.rows, self._t, self._q = whole, whole.rows, t, q
        self._sizes = coordinate_sizes(whole, q)
        self._of_joints = np.zeros(whole.m, bool)
        for name, joint in whole.joints.items():
            self._of_joints[whole.rows[name]] = isinstance(joint, Joint)
        B = self._slopes(t, q)
        lengths = np.linalg.norm(B, axis=1)
        scale = np.where(self._of_joints, 1.0, PREFERRED) / np.where(lengths > 0, lengths, 1.0)
        equations = np.setdiff1d(np.arange(whole.m), [law.row for law in whole.row_laws])
        R, order = qr((B * scale[:, None])[equations].T, mode="r", pivoting=True)
        self.left_out = np.sort(equations[order[np.count_nonzero(np.abs(np.diag(R)) > DEPENDENT) :]])
        self.independent, self._basis = (np.setdiff1d(rows, self.left_out) for rows in (np.arange(whole.m), equations))
        self.labels = tuple(whole.constraint_name(int(row)) for row in self.left_out)
        states = (q, self._nearby()) if len(self.left_out) else ()
        shares = [np.abs(self._null_space(t, q)).max(axis=1) for q in states]
        self._unique = np.max(shares, axis=0, initial=0.0) < UNIQUE if shares else np.ones(whole.m, bool)

    def phi(self, t, q):
        """The values of phi in the rows that are left out."""
        return self.whole.phi(t, q)[self.left_out]

    def multipliers(self, t, q, lam):
        """Multipliers of all rows, of least norm, (frames, rows), from those of the independent rows over frames t, q, lam."""
        result = np.zeros((len(lam), self.whole.m))
        result[:, self.independent] = lam
        needs, N = self.whole.needs, None
        for row, *at in zip(result, t, q):
            if N is None or needs.driven or needs.phi_q_varies:
                N = self._null_space(*at)
            row -= N @ np.linalg.lstsq(N[self._of_joints], row[self._of_joints], rcond=None)[0]
        return result

    def unique(self, name):
        """True if the multipliers of a part's rows are unique."""
        return bool(self._unique[self.rows[name]].all())

    def remark(self):
        """A note for the summary of a run."""
        several = [repr(name) for name, joint in self.whole.joints.items() if isinstance(joint, Joint) and not self.unique(name)]
        return f"redundant rows left out: {_some(self.labels)}; reactions not unique: {_some(several)}" if self.labels else ""

    def _slopes(self, t, q):
        """phi_q in units of the coordinates' sizes, (rows, nonzero columns), dense."""
        from scipy.sparse import diags_array

        B = (self.whole.phi_q(t, q) @ diags_array(self._sizes)).tocsc()
        return B[:, np.flatnonzero(np.diff(B.indptr))].toarray()

    def _null_space(self, t, q):
        """N, (rows, rows left out): multipliers of all rows whose forces cancel."""
        B, N = self._slopes(t, q), np.zeros((self.whole.m, len(self.left_out)))
        N[self._basis] = -np.linalg.lstsq(B[self._basis].T, B[self.left_out].T, rcond=None)[0]
        N[self.left_out] = np.eye(len(self.left_out))
        return N

    def _nearby(self):
        """A state near the start on the independent rows. Raises InputError unless the other rows hold there too."""
        whole, t = self.whole, self._t
        way = self._sizes * np.random.default_rng(0).standard_normal(whole.n)
        move = way - self._back(self._q, (whole.phi_q(t, self._q) @ way)[self._basis])
        q = self._q + AWAY * whole.extent / max(np.abs(move).max(), AWAY * np.abs(way).max()) * move
        for _ in range(ROUNDS):
            q = q - self._back(q, whole.phi(t, q)[self._basis])
        gaps = np.abs(self.phi(t, q))
        if not gaps.max() <= SAME * whole.extent:
            raise InputError(
                f"Scene.build: {self.labels[int(np.argmax(gaps))]} follows from the other constraints in this position alone, or contradicts "
                f"them: nearby it is open by {gaps.max():.3g}; remove it, or start where it is independent"
            )
        return q

    def _back(self, q, phi):
        """The least move, in units of the coordinates' sizes, that changes the independent rows by phi at q."""
        from scipy.sparse import csr_array, diags_array

        B = csr_array(self.whole.phi_q(self._t, q))[self._basis] @ diags_array(self._sizes)
        gram = (B @ B.T).toarray()
        return self._sizes * (B.T @ np.linalg.solve(gram, phi))


def _some(names):
    """The first NAMED names, and how many more there are."""
    return ", ".join(names[:NAMED]) + f" and {len(names) - NAMED} more" * (len(names) > NAMED)
