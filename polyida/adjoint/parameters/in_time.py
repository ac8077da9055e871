"""Slopes of the entries of a Work in their own times, for times that move with a parameter."""

import numpy as np

from polyida.adjoint.parameters.drives import on_rows_and_loads
from polyida.adjoint.parameters.elements import element_work
from polyida.adjoint.parameters.parameter import total
from polyida.adjoint.parameters.rebuilt import profiles_of
from polyida.adjoint.parameters.times import ORDERS, over
from polyida.assembly.own.forces import OwnForce
from polyida.force.force_element import ForceElement
from polyida.model.differences import FIRST_ORDER_STEP, along


def in_time(model, work):
    """The slope of `w . r + mu . phi + kappa . rate + nu . bias` of each entry in its time, its state as it is, (k,).

    Of a scene by its profiles' derivatives; of models and force elements of one's own by differences on one side of all kinks.
    """
    if not model.is_scene:
        return _by_differences(model, work, lambda some: np.array([total(model, entry) for entry in _each(some)]))
    result = _by_profiles(model, work)
    for name, part in model.parts.items():
        if isinstance(part, ForceElement) and _in_time(part):
            own = OwnForce(name, part, model)
            result += _by_differences(model, work, lambda some, own=own, part=part: element_work(own, part, some))
    return result


def _by_profiles(model, work):
    each, result = on_rows_and_loads(model, work), np.zeros(len(work.t))
    for drive, profile in enumerate(model.profiles):
        for order in range(len(ORDERS)):
            used = np.flatnonzero(each[:, drive, order])
            result[used] += each[used, drive, order] * over(profile, work.t[used], order + 1)
    return result


def _in_time(element):
    """Whether an element's forces may depend on time: not where a law of ours has no profile."""
    law = element.compiled_law
    return not law or not law.py_func.__module__.startswith("polyida.") or bool(profiles_of(element))


def _by_differences(model, work, each):
    """The derivative in time of `each(work)` (k,): of entries near a kink one by one."""
    result, rooms = np.zeros(len(work.t)), np.array([model._smooth(t) for t in work.t.tolist()])
    near = (np.abs(rooms) < 2 * FIRST_ORDER_STEP).any(axis=1)
    for k, room in ((np.flatnonzero(~near), ()), *((np.array([k]), (1.0, rooms[k])) for k in np.flatnonzero(near))):
        if len(k):
            some = _taken(work, k)
            result[k] = along(lambda s, some=some: each(some._replace(t=some.t + s)), *room)
    return result


def _each(work):
    return (_taken(work, [k]) for k in range(len(work.t)))


def _taken(work, k):
    return type(work)(*(x if x is None else x[k] for x in work))
