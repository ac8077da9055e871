"""Sums of slopes in the parameters of a run whose model changes: each part counts in the motions in which it acts.

A joint that an event adds holds on to the position of that moment. Its rows depend on this position as on a parameter, whose adjoint goes
to the state at the event.

`TotalsOfModes.of` gives what a sweep adds slopes to in one motion. It has the methods of Totals that a sweep calls: `prepare(works)` before
`add(multipliers)`, which takes AdjointMultipliers of the mode, and `add_own(slopes)`, for slopes of the objective itself.
"""

from typing import Any, NamedTuple

import numpy as np

from polyida.adjoint.parameter import stacked, total
from polyida.adjoint.parameters import parameters_of
from polyida.adjoint.run import constraints_at, exclude_moving
from polyida.integrate.sizes import extent
from polyida.model.differences import central
from polyida.model.functions import writes
from polyida.model.guarded import unguarded
from polyida.model.row_laws import Slips

RANK = 1e-10  # of the largest singular value: directions of a position that places do not depend on


class KnownMode(NamedTuple):
    """What has slopes in a mode."""

    mode: Any  # kept, so that its id stays its own
    parameters: dict  # {name: Parameter} of those that act in it
    holds: list  # Hold of each of its joints that events added


class TotalsOfModes:
    """Which parameters get slopes in which motion of a run: all that act in its mode.

    motions: the run's modes and jumps; m: number of columns of its lam. laws: True if the modes are those of rows with laws. Raises InputError
    for requested parameters that models of users have with different values, and for parameters of one's own that events do not know.
    """

    def __init__(self, totals, motions, m):
        """Leave out the parameters that have no slope in this run."""
        self.totals = totals  # Totals of the run
        self.m = m
        self.parameters = totals.parameters  # {name: Parameter} of the run
        self.own = totals.own  # those of them that are the user's own
        self._known = {}  # {id of a mode: KnownMode}
        self.laws = bool(motions.whole.row_laws)
        if not self.laws:
            self._leave_out_changing_values(motions)
            self._leave_out_own(motions)

    def _leave_out_changing_values(self, motions):
        """Leave out the parameters that models of users have with different values."""
        for known in [parameters_of(unguarded(mode)) for mode in motions.modes if not mode.is_scene]:
            for name, parameter in list(self.parameters.items()):
                if name in known and not np.array_equal(known[name].value, parameter.value):
                    self.totals.leave_out(name, "models of the run have different values of it")

    def _leave_out_own(self, motions):
        """Leave out the user's own parameters that events do not know."""
        for name, parameter in list(self.own.items()):
            if motions.changes_model:
                self.totals.leave_out(name, "it is one of the whole model, and events change the model; use differences of runs")
            elif parameter.changes_coordinates and motions.jumps:
                self.totals.leave_out(name, "it may move the places that events read or push; use differences of runs")

    def exclude_at_start(self, mode, state, given):
        """Exclude parameters that move the constraints of the mode at the start of the run. given: True if it begins with a given state."""
        slopes = self.totals.empty()
        self.of(mode, slopes, {}).add(constraints_at(mode, state))
        moving = {name: slopes.sums[name] for name, one in self.parameters.items() if given or one.changes_coordinates}
        exclude_moving(self.totals, moving, extent(mode, state.q))

    def of(self, mode, totals, held):
        """What adds the slopes of AdjointMultipliers of a mode to the totals of an objective. held: of `_ModeTotals`."""
        if self.laws:
            return _LawTotals(totals, mode, self.m)
        return _ModeTotals(totals, held, self.known(mode))

    def add_of_places(self, mode, totals, function):
        """Add the slopes of a function of the mode in the parameters with which the same q is another position, in all of a user's model."""
        own = not mode.is_scene and (writes(mode, "position") or hasattr(mode, "reactions"))
        for name, parameter in self.known(mode).parameters.items():
            if parameter.changes_coordinates or own:
                totals.sums[name] = totals.sums[name] + parameter.of_model(function)

    def in_places(self, entries, held):
        """{key: slope in the position that a joint holds on to, (n,), or 0 if no entry has one}.

        entries: [(mode, its entries for parameters)]. held: {key: slope} known so far, for the keys.
        """
        result = dict.fromkeys(held, 0.0)
        for mode, of_mode in entries:
            for hold in self.known(mode).holds if of_mode else ():
                result[hold.key] = result.get(hold.key, 0.0) + hold.slope(stacked(of_mode))
        return result

    def known(self, mode):
        """The KnownMode of a mode: what acts in it."""
        if id(mode) not in self._known:
            of_mode, parameters = parameters_of(unguarded(mode)), {}
            for name, parameter in self.parameters.items():
                if name in self.own:
                    parameters[name] = _OfWhole(parameter, mode, self.m)
                elif name in of_mode:
                    parameters[name] = of_mode[name]
            added = mode.since if mode.is_scene and mode.whole is not None else ()
            self._known[id(mode)] = KnownMode(mode, parameters, [Hold(mode, name) for name in added])
        return self._known[id(mode)]


class _LawTotals:
    """The Totals of the whole model, for a mode of its rows with laws."""

    def __init__(self, totals, mode, m):
        """Take the Totals of the whole model, which has m rows, and one of its modes."""
        self.totals, self.mode, self.m = totals, mode, m
        self.add_own = totals.add_own

    def prepare(self, works):
        """No effect: `add` passes on other entries, with multipliers of all rows."""

    def add(self, multipliers):
        """Add the slopes of AdjointMultipliers of the mode, as those of all rows."""
        multipliers_of_all = entries_of_all_rows([multipliers], self.mode.columns, self.m)[0]
        if isinstance(self.mode, Slips):
            lam = np.array([self.mode.spread(lam, self.m) for lam in multipliers.lam])
            multipliers_of_all = multipliers_of_all._replace(lam=lam)
        self.totals.add(multipliers_of_all)


class _ModeTotals:
    """The Totals of a run, for one of its modes.

    held: {(joint, time at which it was added): adjoint of the position that it holds on to, (n,)}.
    """

    def __init__(self, totals, held, known):
        """Take the Totals of the run, and the KnownMode."""
        self.totals = totals
        self.held = held
        self.parameters = known.parameters
        self.holds = known.holds
        self.add_own = totals.add_own

    def prepare(self, works):
        """Compute together what the parameters of the mode share."""
        for parameter in self.parameters.values():
            parameter.prepare(works)

    def add(self, multipliers):
        """Add the slopes of the parts that act, and those in the positions that joints hold on to."""
        for name, parameter in self.parameters.items():
            self.totals.sums[name] = self.totals.sums[name] + parameter.slope(multipliers)
        for hold in self.holds:
            self.held[hold.key] = self.held.get(hold.key, 0.0) + hold.slope(multipliers)


class Hold:
    """The position that a joint of a mode holds on to. key: (its name, the time).

    The rows depend on it by the places of the joint's sides alone. ways (k, n): an orthonormal basis of the directions of q that move these
    (singular vectors of d(places)/dq, up to RANK). modes: those with the position moved along each of them, with their weights in a difference.
    """

    def __init__(self, mode, name):
        """Find the directions of q that move the places of the joint."""
        at, joint, whole = mode.since[name], mode.parts[name], mode.whole
        self.key = name, float(at[0])
        sides = [side for side in (joint.a, joint.b) if side.body is not None]
        places = [(side, part) for side in sides for part in ("point", "direction")[: 1 + side.has_direction]]
        rows = np.concatenate([whole.pulled(place, np.array([1.0, 1.0j])) for place in places])
        _, sizes, ways = np.linalg.svd(rows, full_matrices=False)
        self.ways = ways[sizes > RANK * sizes[0]]
        self.modes = [[(weight, self._moved(mode, name, s * way)) for s, weight in central()] for way in self.ways]

    @staticmethod
    def _moved(mode, name, by):
        """The mode with another position of the joint."""
        at = mode.since[name]
        return mode.whole.mode_like(mode, {**mode.since, name: np.append(at[0], at[1:] + by)})

    def slope(self, multipliers):
        """The slope in q of the sum over the entries of AdjointMultipliers, (n,)."""
        each = [sum(weight * total(mode, multipliers) for weight, mode in modes) for modes in self.modes]
        return np.array(each) @ self.ways


class _OfWhole:
    """A user's own Parameter of the whole model, for a mode: its slope is taken with the multipliers of all rows."""

    changes_coordinates = False  # else a run with events has refused it

    def __init__(self, parameter, mode, m):
        """Take a parameter of the whole model, which has m rows, and one of its modes."""
        self.parameter, self.mode, self.m = parameter, mode, m

    def prepare(self, works):
        """No effect: `slope` passes on other entries, with multipliers of all rows."""

    def slope(self, multipliers):
        """The slope of the whole model's parameter, for multipliers of the mode spread to all rows."""
        return self.parameter.slope(entries_of_all_rows([multipliers], self.mode.columns, self.m)[0])


def entries_of_all_rows(entries, columns, m):
    """AdjointMultipliers with multipliers of all m rows, from those of some."""
    names = "lam", "mu", "kappa", "nu"
    return [one._replace(**{name: of_all_rows(getattr(one, name), columns, m) for name in names}) for one in entries]


def of_all_rows(x, columns, m):
    """Multipliers (..., m) of all rows, from those of some (..., columns), zero elsewhere; None stays None."""
    if x is None:
        return None
    result = np.zeros((*np.shape(x)[:-1], m))
    result[..., columns] = x
    return result
