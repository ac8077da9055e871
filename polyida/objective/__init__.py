"""Objectives: what a design is judged by, functions of a run with their slopes. `2.0 * one + other` is one too."""

from polyida.objective.compliance import Compliance
from polyida.objective.deviation import Deviation
from polyida.objective.objective import Objective
from polyida.objective.own import Own
from polyida.objective.peak_reaction import PeakReaction
from polyida.objective.peak_stress import PeakStress
from polyida.objective.slopes import Slopes
from polyida.objective.strain_energy import StrainEnergy

__all__ = ["Compliance", "Deviation", "Objective", "Own", "PeakReaction", "PeakStress", "Slopes", "StrainEnergy"]
