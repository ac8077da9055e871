"""The numbers of a scene's profiles as parameters: those that their makers take, and a factor on the whole."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property
from inspect import signature
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from polyida.adjoint.parameters.drives import kink_speeds, over, slope_over
from polyida.adjoint.parameters.parameter import AdjointMultipliers, Parameter, with_profile
from polyida.assembly.loads import GRAVITY
from polyida.errors import InputError
from polyida.force.loads import EdgeTraction, PointLoad
from polyida.given import floats, is_number
from polyida.profile import MAKERS, Profile, polynomial, scaled

DEFAULTS = tuple(kind.profile for kind in (PointLoad, EdgeTraction))  # of loads that were given none


@dataclass(frozen=True, eq=False)
class OfProfile(Parameter):
    """A number of a profile, wherever the scene has that.

    drive: which of the model's profiles. made: the profile of another number. scale: over which it varies with that. works: of AdjointMultipliers,
    what the drives are multiplied by. slopes: of (t, q, bar), the MotionSlopes of the start. asked: where the profile's own numbers say
    the same.
    """

    drive: int
    made: Callable[[Any], Profile]
    scale: Callable[[Any], float]
    works: Callable
    slopes: Callable
    asked: bool = False
    why = "the numbers of the profile have slopes of their own"

    @property
    def profile(self):
        """The profile as it is."""
        return self.model.profiles[self.drive]

    def slope(self, work):
        """`sum (w . dr/dp + mu . dphi/dp + ...)` by the profile's slopes in value, rate and second derivative."""
        each = self.works(work)[:, self.drive]
        used, orders = np.flatnonzero(each.any(axis=1)), np.flatnonzero(each.any(axis=0))
        if not len(used):
            return 0.0 * self.value
        return np.tensordot(each[np.ix_(used, orders)], self._slopes(orders, work.t[used]), 2)

    def start(self, t, q, bar):
        """Where driven joints change the motions that bodies were given."""
        found = self.slopes(t, q, bar)
        if found is None:
            return None
        none = np.zeros_like(found.lam)
        entries = (found.v, found.lam, found.left, none, found.kappa), (found.v, none, -found.left, none, none)  # but for loads
        v, lam, w, mu, kappa = map(np.stack, zip(*entries))
        return self.slope(AdjointMultipliers(np.full(2, t), np.stack((q, q)), v, np.zeros_like(v), lam, w, mu, kappa))

    def _slopes(self, orders, t):
        return slope_over(self.profile, self._near, self.scale(t), self._speeds, orders, t)

    @cached_property
    def _speeds(self):
        """By how much the profile's kinks move, (kinks,)."""
        return kink_speeds(self._near, self.scale(np.zeros(0)))

    def _near(self, s):
        return self.made(self.value + s)

    def replaced(self, value):
        """The scene with the profile of another number."""
        if not is_number(value):
            raise InputError(f"{self.name}: {value!r} must be a finite number")
        return with_profile(self.model, self.profile, self.made(float(value)))

    def kinks(self, t0, t1):
        """Those of the profile that move with its begin and duration."""
        moving = zip(self.profile.kinks, self._speeds.tolist())
        return {kink: speed for kink, speed in moving if speed and t0 < kink < t1}


class Coefficients(OfProfile):
    """The coefficients of a polynomial, (k,)."""

    def _slopes(self, orders, t):
        units = [polynomial(unit) for unit in np.eye(len(self.value))]
        return np.stack([np.stack([over(unit, t, order) for order in orders], axis=1) for unit in units], axis=2)

    def replaced(self, value: ArrayLike):
        """The scene with other coefficients, as many."""
        given = floats(value)
        if given is None or given.shape != self.value.shape:
            raise InputError(f"{self.name}: {value!r} must be {len(self.value)} finite numbers")
        return with_profile(self.model, self.profile, polynomial(given))

    def kinks(self, t0, t1):
        """There are none."""
        return {}


def of_profiles(model, works, slopes):
    """The parameters of all profiles that parts of a scene, or its gravity, were given."""
    for drive, name in named_drives(model).items():
        if not any(model.profiles[drive] is default for default in DEFAULTS):
            yield from _of_drive(model, drive, name, works, slopes)


def named_drives(model):
    """{number of a profile: its name}: that of the first part that has it, with the field, or axis, where the part has several.

    Not those of a joint of one's own that turns two vectors of one row by two of them: the row then has their difference.
    """
    given = [(name, _fields(part)) for name, part in model.parts.items()] + [(GRAVITY, zip("xy", model.gravity))]
    named = [(name, _named(name, values)) for name, values in given]
    known = {key for _, profiles in named for key in profiles}
    mixed = {name for name, profile in model.named_profiles if name and id(profile) not in known}
    found = {key: called for name, profiles in reversed(named) if name not in mixed for key, called in profiles.items()}
    return {drive: found[id(profile)] for drive, profile in enumerate(model.profiles) if id(profile) in found}


def _fields(part):
    """(name, value) of the fields of a part; of a pair of profiles each axis."""
    for field in fields(part):
        value = getattr(part, field.name)
        pair = isinstance(value, tuple) and len(value) == 2
        yield from zip("xy", value) if pair else [(field.name, value)]


def _named(name, given):
    """{id of a profile: name} of what a part is given."""
    held = [(key, value) for key, value in given if isinstance(value, Profile)]
    return {id(value): name if len(held) == 1 else f"{name}.{key}" for key, value in held}


def _of_drive(model, drive, name, *shared):
    profile = model.profiles[drive]
    kind, *given = profile.formula or ("",)
    if kind == "polynomial" and len(given) > 1:
        yield Coefficients(f"{name}.coefficients", np.array(given), model, drive, polynomial, lambda t: 1.0, *shared)
    elif kind:
        keys = ["value"] if kind == "polynomial" else list(signature(MAKERS[kind]).parameters)
        for i, key in enumerate(keys):
            made = lambda value, i=i: MAKERS[kind](*given[:i], value, *given[i + 1 :])  # noqa: E731
            yield OfProfile(f"{name}.{key}", given[i], model, drive, made, _scale_of(key, dict(zip(keys, given))), *shared)
    yield OfProfile(f"{name}.scale", 1.0, model, drive, lambda value: scaled(profile, value), lambda t: 1.0, *shared, bool(kind))


def _scale_of(key, given):
    """Of times t, the size over which a profile varies with one of its numbers."""
    if key in ("begin", "duration"):
        return lambda t: given["duration"]
    if key == "frequency":
        return lambda t: 1.0 / (2 * np.pi * max(1.0, np.abs(t).max(initial=0.0)))
    return lambda t: max(1.0, abs(given[key]))
