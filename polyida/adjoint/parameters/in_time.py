"""Slopes of the entries of a Work in their own times, for times that move with a parameter."""

import numpy as np

from polyida.force.force_element import ForceElement
from polyida.adjoint.parameters.drives import drive_works
from polyida.adjoint.parameters.parameter import total
from polyida.adjoint.parameters.times import ORDERS, over
from polyida.adjoint.parameters.work import Work
from polyida.model.differences import along


def in_time(model, work):
    """The slope of `w . r + mu . phi + kappa . rate + nu . bias` of each entry in its time, its state as it is, (k,).

    Of a scene by its profiles' derivatives; of models and force elements of one's own by differences on one side of all kinks.
    """
    if model.is_scene and not any(isinstance(part, ForceElement) for part in model.parts.values()):
        return _by_profiles(model, work)
    return np.array([_by_differences(model, Work(*(x if x is None else x[k : k + 1] for x in work))) for k in range(len(work.t))])


def _by_profiles(model, work):
    each, result = drive_works(model, work), np.zeros(len(work.t))
    for drive, profile in enumerate(model.profiles):
        for order in range(len(ORDERS)):
            used = np.flatnonzero(each[:, drive, order])
            result[used] += each[used, drive, order] * over(profile, work.t[used], order + 1)
    return result


def _by_differences(model, entry):
    return float(along(lambda s: total(model, entry._replace(t=entry.t + s)), room=model._smooth(entry.t[0])))
