"""Slopes of the entries of a Work in their own times, for times that move with a parameter."""

from dataclasses import replace

import numpy as np

from polyida.adjoint.parameters.driven.drives import drive_works
from polyida.adjoint.parameters.driven.times import ORDERS, element_work, over
from polyida.adjoint.parameters.parameter import total
from polyida.adjoint.parameters.rebuilt import holding_profile
from polyida.assembly.own.forces import OwnForce
from polyida.force.force_element import ForceElement, profiles_of
from polyida.model.differences import FIRST_ORDER_STEP, along
from polyida.profile import REACH, Profile

SCALE = REACH[1] / FIRST_ORDER_STEP  # s, over which functions of time of one's own vary


def in_time(model, work):
    """The slope of `w . r + mu . phi + kappa . rate + nu . bias` of each entry in its time, its state as it is, (k,).

    Of a scene by its profiles' derivatives; of models and force elements of one's own by differences.
    """
    if not model.is_scene:
        return np.array([_by_differences(model, entry) for entry in _each(work)])
    return _by_profiles(model, work) + sum(
        _of_element(OwnForce(name, part, model), part, work)
        for name, part in model.parts.items()
        if isinstance(part, ForceElement) and not _by_our_law(part)
    )


def _by_profiles(model, work):
    each, result = drive_works(model, work), np.zeros(len(work.t))
    for drive, profile in enumerate(model.profiles):
        for order in range(len(ORDERS)):
            used = np.flatnonzero(each[:, drive, order])
            result[used] += each[used, drive, order] * over(profile, work.t[used], order + 1)
    return result


def _by_our_law(element):
    """Whether time is in its forces by profiles alone."""
    functions = (value for value in vars(element).values() if callable(value) and not isinstance(value, Profile))
    return type(element).__module__.startswith("polyida.") and not any(functions)


def _of_element(own, element, work):
    """Of the time that forces of one's own are given, their profiles late by as much."""

    def later(s):
        held = element
        for profile in profiles_of(element):
            held = holding_profile(held, profile, _late(profile, s))
        return element_work(own, held, work._replace(t=work.t + s))

    return along(later, SCALE)


def _late(profile, s):
    functions = {order: getattr(profile, order) for order in ORDERS}
    return replace(profile, formula=(), **{order: lambda t, f=function: f(t - s) for order, function in functions.items()})


def _by_differences(model, entry):
    room = model._smooth(float(entry.t[0]))
    return float(along(lambda s: total(model, entry._replace(t=entry.t + s)), SCALE, room))


def _each(work):
    return (type(work)(*(x if x is None else x[k : k + 1] for x in work)) for k in range(len(work.t)))
