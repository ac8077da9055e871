"""Objectives: what a design is judged by, functions of a run with their slopes. `2.0 * one + other` is one too."""

from polyida.objective.frequency import Frequency
from polyida.objective.means.compliance import Compliance
from polyida.objective.means.deviation import Deviation
from polyida.objective.means.peak_reaction import PeakReaction
from polyida.objective.means.peak_stress import PeakStress, StrainEnergy
from polyida.objective.objective import Objective
from polyida.objective.own import Own
from polyida.objective.slopes import Slopes

__all__ = ["Compliance", "Deviation", "Frequency", "Objective", "Own", "PeakReaction", "PeakStress", "Slopes", "StrainEnergy"]
