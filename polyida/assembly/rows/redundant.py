"""Redundant rows of phi: found, left out, and given back their share of the multipliers.

With the rows B_k that are kept, of full rank, those that are left out are `B_d = C B_k` on all states of the mechanism. All multipliers
with the same forces, `B^T lam = B_k^T lam_k`, are `(lam_k, 0) + N y`, `N = (-C^T, 1)`. Taken are those of least norm on the rows of joints;
rows that keep a body in shape hold what is within it, which has no part in how joints share a load.
"""

import numpy as np
from scipy.linalg import qr

from polyida.errors import InputError
from polyida.joint.joint import Joint
from polyida.linear.saddle import DEPENDENT, coordinate_sizes

AWAY = 1e-3  # of the scene's size: how far from the start it is looked at whether rows still follow from others
FIRST = 1e3  # so much longer are rows that keep a body in shape when it is chosen which to leave out
SAME = 1e-9  # of the scene's size: what is left of a row there that does
UNIQUE = 1e-8  # shares in a dependence that are none
ROUNDS = 20  # of Newton, back onto the rows that are kept
NAMED = 6  # rows that a message names


class Redundant:
    """The redundant rows of a model of all rows, `whole`: `left_out` and `kept` are their numbers, `labels` what those left out are called.

    Rows are compared at t = 0, q = 0 in the units of `coordinate_sizes`, by a rank-revealing QR of phi_q^T.
    Raises InputError where rows depend on others in this position alone, or contradict them nearby.
    """

    def __init__(self, whole):
        self.whole, self.rows = whole, whole.rows
        self._sizes = coordinate_sizes(whole, np.zeros(whole.n))
        self._of_joints = np.zeros(whole.m, bool)
        for name, part in whole.joints.items():
            self._of_joints[whole.rows[name]] = isinstance(part, Joint)
        B = self._slopes(0.0, np.zeros(whole.n))
        lengths = np.linalg.norm(B, axis=1)
        first = np.where(self._of_joints, 1.0, FIRST)
        R, order = qr((B * (first / np.where(lengths > 0, lengths, 1.0))[:, None]).T, mode="r", pivoting=True)
        self.left_out = np.sort(order[np.count_nonzero(np.abs(np.diag(R)) > DEPENDENT) :])
        self.kept = np.setdiff1d(np.arange(whole.m), self.left_out)
        self.labels = tuple(whole.constraint_name(int(row)) for row in self.left_out)
        places = (np.zeros(whole.n), self._nearby()) if len(self.left_out) else ()
        shares = [np.abs(self._free(0.0, q)).max(axis=1) for q in places]
        self._unique = np.max(shares, axis=0, initial=0.0) < UNIQUE if shares else np.ones(whole.m, bool)

    def phi(self, t, q):
        """phi of the rows that are left out."""
        return self.whole.phi(t, q)[self.left_out]

    def multipliers(self, t, q, lam):
        """Those of all rows, of least norm, (frames, rows), from those that are kept over frames t, q, lam."""
        found = np.zeros((len(lam), self.whole.m))
        found[:, self.kept] = lam
        needs, N = self.whole.needs, None
        for row, *at in zip(found, t, q):
            if N is None or needs.driven or needs.phi_q_varies:
                N = self._free(*at)
            row -= N @ np.linalg.lstsq(N[self._of_joints], row[self._of_joints], rcond=None)[0]
        return found

    def unique(self, name):
        """Whether the multipliers of a part's rows are the only ones."""
        return bool(self._unique[self.rows[name]].all())

    def remark(self):
        """What a summary says of it."""
        loose = [repr(name) for name, part in self.whole.joints.items() if isinstance(part, Joint) and not self.unique(name)]
        return f"redundant rows left out: {_some(self.labels)}; reactions not unique: {_some(loose)}" if self.labels else ""

    def _slopes(self, t, q):
        """phi_q in the sizes of the coordinates, (rows, columns that are not zero), dense."""
        from scipy.sparse import diags_array

        B = (self.whole.phi_q(t, q) @ diags_array(self._sizes)).tocsc()
        return B[:, np.flatnonzero(np.diff(B.indptr))].toarray()

    def _free(self, t, q):
        """N, (rows, left out)."""
        B, N = self._slopes(t, q), np.zeros((self.whole.m, len(self.left_out)))
        N[self.kept] = -np.linalg.lstsq(B[self.kept].T, B[self.left_out].T, rcond=None)[0]
        N[self.left_out] = np.eye(len(self.left_out))
        return N

    def _nearby(self):
        """A state some way from the start on the rows that are kept. Raises InputError unless the others hold there too."""
        whole, n = self.whole, self.whole.n
        way = self._sizes * np.random.default_rng(0).standard_normal(n)
        q = way - self._back(np.zeros(n), (whole.phi_q(0.0, np.zeros(n)) @ way)[self.kept])
        q *= AWAY * whole.extent / max(np.abs(q).max(), AWAY * np.abs(way).max())
        for _ in range(ROUNDS):
            q = q - self._back(q, whole.phi(0.0, q)[self.kept])
        left = np.abs(self.phi(0.0, q))
        if not left.max() <= SAME * whole.extent:
            raise InputError(
                f"Scene.build: {self.labels[int(np.argmax(left))]} follows from the other constraints in this position alone, or contradicts "
                f"them: nearby it is open by {left.max():.3g}; remove it, or start where it is independent"
            )
        return q

    def _back(self, q, phi):
        """The least move, in the sizes of the coordinates, by which the rows that are kept change by phi at q."""
        from scipy.sparse import csr_array, diags_array

        B = csr_array(self.whole.phi_q(0.0, q))[self.kept] @ diags_array(self._sizes)
        gram = (B @ B.T).toarray()
        return self._sizes * (B.T @ np.linalg.solve(gram, phi))


def _some(names):
    """The first of some names, and how many more there are."""
    return ", ".join(names[:NAMED]) + f" and {len(names) - NAMED} more" * (len(names) > NAMED)
