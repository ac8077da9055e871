"""Peak reaction of a joint, torque and power of a motor as objectives."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from polyida.errors import InputError
from polyida.joint.joint import Joint
from polyida.model.differences import along
from polyida.objective.objective import Slopes, run_of
from polyida.objective.time_mean import TimeMean, named, power
from polyida.results.motion import components
from polyida.validation import complex_of_pairs, is_one_of, named_keywords, pairs_of, settle

UNITS = ("N", "N m")


@named_keywords
@dataclass(frozen=True, eq=False)
class PeakReaction(TimeMean):
    """`(time mean of |R|^p)^(1/p)`, R the reaction of a joint on its side b, N or N m, as `run.reaction`.

    It is below the largest |R| and approaches it as p grows: `largest(run)` is at most `(T / w)^(1/p)` times J, w being the trapezoidal
    weight of the frame that has it and T the sum of the weights.

    Parameters
    ----------
    joint : str or Joint
    p : float
        Order of the mean, 1 or more.
    unit : "N" or "N m", optional
        The components of a joint that has forces and a moment.

    Raises
    ------
    InputError
        For wrong parameters; of a run if the joint is not in its scene, has both units and no `unit` is given, or has no unique reaction.
    """

    joint: Any
    p: float = 8.0
    unit: str | None = None
    _of_material = True

    def __post_init__(self):
        """Check p and unit. Raises InputError for wrong ones."""
        settle(self, p=power(type(self).__name__, self.p))
        if not (self.unit is None or is_one_of(self.unit, UNITS)):
            raise InputError(f'{type(self).__name__}: unit = {self.unit!r:.100} must be "N" or "N m", or None')

    def _along_v(self, run):
        """False: reactions depend on lam, not on t and q alone."""
        return False  # forces depend on lam

    def largest(self, run: Any) -> float:
        """Return the largest value of all frames, without the mean: |R|, torque or power, in the unit of J."""
        run = run_of(type(self).__name__, run)
        return float(np.max(self._sizes(run, self._of(run))))

    def _chosen(self, model):
        """(name of the joint, its rows, the chosen components)."""
        name = self._name(model)
        units = [unit for _, unit in components(model, name)]
        chosen = [k for k, unit in enumerate(units) if self.unit in (None, unit)]
        if not chosen or len({units[k] for k in chosen}) > 1:
            what = f"the reaction of {name!r} is in {' and '.join(sorted(set(units)))}"
            advice = "give one of these as unit" if self.unit is None else f"it has no {self.unit}"
            raise InputError(f"{type(self).__name__}: {what}; {advice}")
        return name, model.rows[name], chosen

    def _evaluator(self, model, span):
        """A function of Frames that returns two functions: one without arguments gives |R| of the joint, (frames,), the other Slopes.

        The latter takes dJ/d|R| (frames,) and returns the Slopes of J in q, lam and t. span is not used.
        """
        name, columns, chosen = self._chosen(model)

        def evaluate(frames):
            """(function () -> sizes |R| of the reaction (frames,), `to_slopes`) in these Frames."""
            reaction = Reaction(model, name, frames.t, frames.q, frames.lam[:, columns], chosen)
            size = np.linalg.norm(reaction.reaction, axis=1)

            def to_slopes(factor):
                """The Slopes of J from dJ/d|R| of the frames."""
                with np.errstate(divide="ignore", invalid="ignore"):
                    toward = np.where(size[:, None] > 0, (factor / size)[:, None] * reaction.reaction, 0.0)
                lam = np.zeros_like(frames.lam)
                lam[:, columns] = reaction.by_multipliers(toward)
                return Slopes(q=reaction.by_coordinates(toward), lam=lam, t=lambda: reaction.by_time(toward))

            return lambda: size, to_slopes

        return evaluate

    def _name(self, model):
        """The name of the joint. Raises InputError if the model has none, or a reaction that is not unique."""
        joints = {name: joint for name, joint in model.joints.items() if isinstance(joint, Joint)}
        name = named(model, self.joint)
        if not is_one_of(name, joints):
            raise InputError(
                f"{type(self).__name__}: no joint is called {self.joint!r:.100}; known: {', '.join(map(repr, joints)) or 'none'}"
            )
        if model.redundant is not None and not model.redundant.unique(name):
            raise InputError(f"{type(self).__name__}: the reaction of {name!r} is not unique, constraints are redundant; it has no slopes")
        return name

    def named(self, model: Any) -> PeakReaction:
        """Return the objective with the name of its joint. Raises InputError if the model has no such joint."""
        return replace(self, joint=self._name(model))


@named_keywords
@dataclass(frozen=True, eq=False)
class PeakTorque(PeakReaction):
    """`(time mean of |M|^p)^(1/p)`, N m, M the torque of a motor, or the moment of another joint. Bound and parameters as of PeakReaction.

    Parameters
    ----------
    joint : str or Joint
    p : float
        Order of the mean, 1 or more.
    unit : "N m"

    Raises
    ------
    InputError
        As for PeakReaction, and for a joint without a moment.
    """

    unit: str | None = "N m"


@named_keywords
@dataclass(frozen=True, eq=False)
class PeakPower(PeakTorque):
    """`(time mean of |M omega|^p)^(1/p)`, W, M the torque of a motor and omega the rate of turn of its side b against side a.

    Bound and parameters as of PeakReaction. omega is that of the frames, not that of the motor's profile.

    Parameters
    ----------
    joint : str or Joint
        Its sides have directions.
    p : float
        Order of the mean, 1 or more.
    unit : "N m"

    Raises
    ------
    InputError
        As for PeakTorque, and for a side without a direction.
    """

    def _evaluator(self, model, span):
        """The function of Frames that gives |M omega| of the joint and the way back to Slopes."""
        name, columns, chosen = self._chosen(model)
        joint = model.joints[name]
        joint.require_directions()
        sides = [(sign, (side, "direction")) for sign, side in ((-1.0, joint.a), (1.0, joint.b)) if side.body is not None]

        def evaluate(frames):
            """Sizes of the power in the frames, and the function to Slopes."""
            reaction = Reaction(model, name, frames.t, frames.q, frames.lam[:, columns], chosen)
            turning = [(sign, place, model.place(place, frames.q), model.rate_of(place, frames.v)) for sign, place in sides]
            omega = sum(sign * (d.conj() * e).imag / np.abs(d) ** 2 for sign, _, d, e in turning)
            work = reaction.reaction[:, 0] * omega

            def to_slopes(factor):
                """The Slopes of J from dJ/d|M omega| of the frames."""
                signed = factor * np.sign(work)
                toward, along = (signed * omega)[:, None], signed * reaction.reaction[:, 0]
                lam, q, v = np.zeros_like(frames.lam), reaction.by_coordinates(toward), np.zeros_like(frames.v)
                lam[:, columns] = reaction.by_multipliers(toward)
                for sign, place, d, e in turning:  # omega = Im(conj(d) e) / |d|^2
                    own = (d.conj() * e).imag / np.abs(d) ** 2
                    v += model.pulled(place, sign * along * 1j * d / np.abs(d) ** 2)
                    q += model.pulled(place, sign * along * (-1j * e - 2.0 * own * d) / np.abs(d) ** 2)
                return Slopes(q=q, v=v, lam=lam, t=lambda: reaction.by_time(toward))

            return lambda: np.abs(work), to_slopes

        return evaluate


class Reaction:
    """The reaction of a joint over frames, (frames, chosen components), and products with the transposes of its derivatives, by
    differences.

    It is a function of the multipliers, of the places of the sides in the joint's rows, and of the angles by which profiles turn these.
    """

    def __init__(self, model, name, t, q, lam, chosen):
        """Take the places of the sides, and compute the reaction in the frames."""
        self.model, self.t, self.lam, self.chosen = model, t, lam, chosen
        self.of = model.reaction_of(name)
        self.places = [(place, model.place(place, q)) for place in self.of.needed]
        self.reaction = self._at()

    def by_multipliers(self, toward):
        """The product `dR/dlam^T toward`, (frames, rows), of vectors toward (frames, components)."""
        return _against(lambda way: self._at(lam=self.lam + way), self.lam, toward)

    def by_coordinates(self, toward):
        """The product `dR/dq^T toward` at fixed multipliers, (frames, n)."""
        slope = np.zeros((len(toward), self.model.n))
        for place, at in self.places:
            moved = lambda way, place=place: self._at(moved=(place, complex_of_pairs(way)))  # noqa: E731
            slope += self.model.pulled(place, complex_of_pairs(_against(moved, pairs_of(at), toward)))
        return slope

    def by_time(self, toward):
        """`dR/dt^T toward` at fixed coordinates and multipliers, (frames,)."""
        turned = lambda profile: along(lambda s: self._at(ahead=(profile, s)))  # noqa: E731
        rates = [(turned(profile), profile.over(self.t, 1)) for profile in self.of.profiles]
        return sum((np.sum(slope * toward, axis=1) * rate for slope, rate in rates), np.zeros(len(toward)))

    def _at(self, lam=None, moved=(None, 0.0), ahead=(None, 0.0)):
        """The reaction with other multipliers, with a place moved, or with a profile ahead of its value."""
        places = {(id(side), part): at + moved[1] * ((side, part) == moved[0]) for (side, part), at in self.places}
        lam = self.lam if lam is None else lam
        return self.of(self.t, lam, lambda place: places[id(place[0]), place[1]], ahead)[:, self.chosen]


def _against(moved, x, toward):
    """`df/dx^T toward`, (frames, k), of f = moved(change of x (frames, k))."""
    ways = np.abs(x).max(axis=0, initial=0.0)
    ways = np.diag(np.where(ways > 0, ways, 1.0))
    return np.stack([np.sum(along(lambda s, way=way: moved(s * way)) * toward, axis=1) / way.max() for way in ways], axis=1)
