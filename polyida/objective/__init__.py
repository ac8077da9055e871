"""Objectives of a design: functions of a run with their derivatives. `2.0 * one + other` is an objective too."""

from polyida.objective.objective import Limit, Objective, Slopes, UserObjective
from polyida.objective.peak_reaction import PeakPower, PeakReaction, PeakTorque
from polyida.objective.peak_stress import PeakStress, StrainEnergy
from polyida.objective.structure import Frequency, Mass
from polyida.objective.time_mean import Compliance, Deviation

__all__ = [
    "Compliance",
    "Deviation",
    "Frequency",
    "Limit",
    "Mass",
    "Objective",
    "PeakPower",
    "PeakReaction",
    "PeakStress",
    "PeakTorque",
    "Slopes",
    "StrainEnergy",
    "UserObjective",
]


def __dir__():
    """Return the public names of the package."""
    return __all__
