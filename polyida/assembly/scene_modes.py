"""Modes of a scene: models of the same coordinates in which some parts do not act, or only some rows of phi are equations."""

from functools import cached_property
from typing import Any

import numpy as np

from polyida.assembly.arrays import concatenated
from polyida.assembly.build import coupling_of
from polyida.assembly.factors import OF_FACTORS
from polyida.assembly.kept_rows import kept_rows
from polyida.assembly.projection import point_columns
from polyida.assembly.redundant import Redundant
from polyida.assembly.row_table import CLOSED
from polyida.assembly.scene_bodies import SceneBodies
from polyida.body.rigid_body import PointMass
from polyida.errors import InputError
from polyida.joint.joint import Joint, held_at
from polyida.model import NONE
from polyida.model.row_laws import violation

KEPT = 64  # modes that a model with events keeps


class SceneModes(SceneBodies):
    """The model of a scene as the whole of its modes.

    A mode is a copy that is assembled anew (`_use_parts`, `_assemble` of SceneModel), or has only some of the rows (`keep_rows`). It shares
    with the whole model all that does not depend on rows, and is stored in `_modes` of the whole model.
    """

    whole: Any = None  # of a mode: the model that has all parts
    since: Any = NONE  # of a mode: {name: (1 + n,), t and q} of joints that were added there

    def mode(self, absent, since):
        """The model of the same coordinates without the parts named in `absent`, of a model that has the rows of all parts.

        Its `columns` are the numbers of its rows of phi among all. since: {name: (1 + n,), t and q} of joints that were added there. The rows
        of these joints take from this position what other joints take from the reference configuration. Rows that depend on others at the
        last position are left out.
        """
        key = absent, tuple((name, at.tobytes()) for name, at in since.items())
        if not (absent or since or self.treats_redundant == "least-norm"):
            return self
        if key not in self._modes:
            if len(self._modes) >= KEPT:
                self._modes.clear()
            self._modes[key] = self._mode(absent, since)
        return self._modes[key]

    def _mode(self, absent, since):
        """The model of this scene without the absent parts, with joints that hold places of a state."""
        left_out = concatenated([np.arange(self.m)[self.rows[name]] for name in absent if name in self.rows], np.int64)
        other = self._acting(absent, since, left_out)
        held, _ = other._assembled
        other.columns = np.setdiff1d(np.arange(self.m), left_out)
        for name, at in since.items():
            off = violation(other, other.phi(float(at[0]), at[1:]))[other.rows[name]]
            if np.abs(off).max(initial=0.0) > CLOSED * self.extent:
                how = "penetrated" if any(law.name == name and law.is_contact for law in other.row_laws) else "open"
                raise InputError(f"{name!r} does not fit where it is added: it is {how} by {np.abs(off).max():.3g} m")
        if since or self.treats_redundant == "least-norm":
            at = list(since.values())[-1] if since else np.zeros(1 + self.n)
            other.columns = other._leave_out_redundant(float(at[0]), at[1:], held, left_out)
        return other

    def _acting(self, absent, since, left_out):
        """A copy without the parts named in `absent`, and without the rows with the numbers `left_out`; since: as of `mode`."""
        heavy = any(isinstance(self.parts[name], PointMass) for name in {*absent, *(self.late or ())})
        other = self._copy({"pattern", "first_pairs", *(() if heavy else OF_FACTORS)})
        other.whole = self
        other.absent = absent
        other.since = since
        other.parts = {name: part for name, part in self.parts.items() if isinstance(part, Joint) or name not in absent}
        held = self._late_joints()
        held |= {name: held_at(self.parts[name], lambda place, at=at: self.place(place, at[None, 1:])[0]) for name, at in since.items()}
        other._use_parts(held, left_out)
        return other

    def mode_like(self, mode, since=None):
        """The mode of this model with the parts and rows of a mode of a model that is near it, also if its joints do not fit by as much.

        since: other positions at which joints were added.
        """
        other = self._acting(mode.absent, mode.since if since is None else since, mode._assembled[1])
        other.columns = mode.columns
        return other

    def with_rows(self, rows):
        """This model with only these rows of phi, (k,) int, all of them equations; stored."""
        key = tuple(np.asarray(rows).tolist())
        if key not in self._modes:
            if len(self._modes) >= KEPT:
                self._modes.clear()
            self._modes[key] = self._copy({"pattern", "first_pairs", *OF_FACTORS})
            self._modes[key].keep_rows(key)
        return self._modes[key]

    def keep_rows(self, rows, slips=None):
        """Make this copy of a model one with only these rows of phi, (k,) int in rising order, all of them equations; slips: Slips or None."""
        rows = np.array(rows, np.int64)
        links = self.arrays.links
        self.columns = rows
        self.m = len(rows)
        self.row_laws = ()
        self.labels = [self.labels[row] for row in rows]
        self.units = [self.units[row] for row in rows]
        self.rows = {name: slice(*np.searchsorted(rows, (of.start, of.stop)).tolist()) for name, of in self.rows.items()}
        kept = [edges for edges in self.edge_rows if edges.first in rows]
        self.edge_rows = [edges.at(int(np.searchsorted(rows, edges.first))) for edges in kept]
        links = links._replace(**kept_rows(links, rows), slips=slips or links.slips)
        columns = self.once(point_columns)
        self._use_links(links._replace(coupling=coupling_of(links, self.laws)))
        self._derived[(point_columns,)] = columns  # of points, which are the same

    def _copy(self, kept):
        """A copy without what is derived, but for the cached properties with these names."""
        cached = {name for kind in type(self).__mro__ for name, value in vars(kind).items() if isinstance(value, cached_property)}
        return self.altered(cached - kept, _modes={})

    def _late_joints(self):
        """{name: joint} of those that events add, in the form in which they hold where they are added."""
        return {name: self.parts[name].facing() for name in self.late or () if isinstance(self.parts[name], Joint)}

    def _leave_out_redundant(self, t, q, held=NONE, left_out=()):
        """Leave out rows that depend on others at (t, q), besides those with the numbers `left_out`.

        Returns the numbers of those that stay.
        """
        redundant, columns = Redundant(self.altered(), t, q), np.setdiff1d(np.arange(self.m + len(left_out)), left_out)
        if redundant.labels or self.treats_redundant == "least-norm":
            self.redundant = redundant
            self._assemble(held, [*left_out, *columns[redundant.left_out]])
            self.remark = " and ".join(filter(None, (self.remark, redundant.remark())))
        return columns[redundant.independent]
