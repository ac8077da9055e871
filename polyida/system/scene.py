"""The table of a scene: its workspace, and the addresses of its functions as C functions, the same for every integrator.

The functions are those of scene_functions.py, the factors those of scene_factors.py. `Scene` fills the workspace; `OneFactorScene` serves methods
with one factor that Python makes, and `SceneTable` generalized-alpha. Radau IIA, IDA and the energy-momentum method have their own beside
their steps.
"""

from contextlib import contextmanager, nullcontext
from functools import cache

import numpy as np
from numba import int64, typeof

from polyida import system as table
from polyida.assembly.condensation import condensation
from polyida.assembly.increments import drive_table, gain_table, moves
from polyida.assembly.optional import DAMPING, LAW_FORCES, LAW_SLOPES, RELAXING, RENEW, optional_kernels
from polyida.assembly.projection import constraint_projection
from polyida.assembly.rate_multipliers import RateMultipliers
from polyida.environment import threads
from polyida.jit.user_functions import table_address
from polyida.linear.team import Helpers
from polyida.system import INSTANTS
from polyida.system.scene_factors import Factor, scene_factors
from polyida.system.scene_functions import FUNCTIONS, SceneWork, idle, new_slopes

SHARED = 20_000  # coordinates above which several threads share the solves
# factors that functions read: others are compiled for a workspace without any, once for all methods. RESIDUAL reads no factor and is compiled for
# (real, pair) = (None, None), SOLVE for (type of `real`, None)
BOTH = {"real": None, "pair": None}
READS = {table.SOLVE: ("real",), table.REAL: ("real",), table.PAIR: ("pair",), table.MATRICES: tuple(BOTH), table.SELECT: tuple(BOTH)}


def entries(*numbers):
    """{number: function} of some entries."""
    return {number: FUNCTIONS[number] for number in numbers}


@cache
def entry_address(function, kind):
    """The address of a function of a table as a C function for a type of workspaces."""
    return table_address(function, int64 if function is idle else kind)


class Scene:
    """A scene's workspace w and table. c: times of the stages; stage, begin: as of SceneWork; optional: numbers of the kernels that it calls.

    options: fields of the workspace in place of those that serve no method, and `pairs`, the number of the pairs of coordinates.

    Functions are compiled for the type of the workspace, which contains the types of the factors. To compile most of them once for all methods,
    each is compiled for the type with None in place of the factors that it does not read (`READS`): None takes one word of the block of a pack
    (jit/pack.py), as a factor does, so that all types find the other fields at the same places.
    """

    entries: dict = {}

    def __init__(self, model, c, stage, begin, optional, **options):
        """Make the fields of the workspace, without factors; functions are compiled when `set_factors` gives the factors."""
        self.model, self.work, self.workspace_type, self.raised = model, None, None, None
        self.workspace, self.functions = 0, np.zeros(table.ENTRIES, np.int64)
        s, m, nodes, points = len(c), model.m, (options.pop("pairs", model.n_nodes), 2), (model.n_points, 2)
        profiles, projection, (numbers, self.formulas) = (len(model.profiles), 3), constraint_projection(model), moves(model)
        nothing = np.zeros(0), *np.zeros((2, 0), np.int64), np.zeros((0, 2))
        self.w = {
            "scene": model.arrays,
            "stored": scene_factors(model, False),
            "projection": projection,
            "rates": RateMultipliers(projection.border, projection.workspace, *nothing),
            "condensed": options.get("condensed") or condensation(model, False),
            "optional": optional_kernels(model, *optional),
            "moves": numbers,
            "c": np.array(c, float),
            "h": np.zeros(1),
            "stage": stage,
            "begin": begin,
            "drives": np.zeros((len(stage) + 1, *profiles)),
            "gains": np.zeros((len(stage) + 1, *profiles)),
            "incremental": True,
            "tied": False,
            "keeps_middle": False,
            "strict": False,
            "anew": np.ones(3, np.int64),
            "cosine": np.ones(1),
            "rotation": np.zeros((s, model.n_factored, 2)),
            "dz": np.zeros((s, *points)),
            "turn": np.zeros((0, *nodes)),
            "points": np.zeros((4, *points)),
            "forces": np.zeros(points),
            "vz": np.zeros((0, 2)),
            "u": np.zeros((0, 2)),
            "damp": np.zeros((model.n_nodes if model.damped else 0, 2)),  # also where `pairs` are fewer: its kernel knows them all
            "nodal": np.zeros((2, *nodes)),
            "still": np.zeros(nodes),
            "level": np.zeros(m),
            "spare": np.zeros(m),
            "inverse": model.arrays.reduced,
            "inverse_matrix": np.zeros((0, 0), complex),
        } | options

    def set_factors(self, **used):
        """Use these factors, `real` or `pair` or both; functions are compiled for the type of the workspace."""
        self.work = SceneWork(**BOTH | used, **self.w)
        self.workspace, kind = self.work.address, typeof(self.work)
        if kind != self.workspace_type:
            self.workspace_type, self.types_by_factors = kind, {frozenset(BOTH): kind}
            for number, function in self.entries.items():
                self.functions[number] = entry_address(function, self.type_for(*READS.get(number, ())))

    def type_for(self, *read):
        """The type of the workspace for a function that reads these factors, by their names."""
        known = frozenset(read)
        if known not in self.types_by_factors:
            self.types_by_factors[known] = typeof(self.work._replace(**dict.fromkeys(BOTH.keys() - known)))
        return self.types_by_factors[known]

    def take_error(self):
        """The exception of a Python function that compiled code called, or None; it is forgotten here."""
        error, self.raised = self.raised or self.model.take_error(), None
        return error

    def raise_error(self):
        """Raise the exception of a Python function that compiled code called, if there is one."""
        if (error := self.take_error()) is not None:
            raise error


class OneFactorScene(Scene):
    """The table of a scene for methods with one real factor, which Python makes.

    Several threads share the solves of more than SHARED coordinates, if the user allows them.
    """

    longest = INSTANTS

    def __init__(self, model, *arguments, **options):
        """Make the table, and threads that share the solves if the scene is large and the user allows it."""
        super().__init__(model, *arguments, **options)
        self.helpers = Helpers(threads()) if 2 * model.n_factored >= SHARED and threads() > 1 else None
        self.c = np.zeros(2)

    def system(self, settings):
        """The model's step matrix as the settings choose it, not factored yet."""
        return settings.step_matrix(self.model)

    def factor(self, system, t, *at):
        """Factor the step matrix at (t, q, v, a, lam, c_m, c_v). Returns the number of residuals evaluated besides."""
        system.factor(t, *at)
        return 1

    @contextmanager
    def at_work(self, system):
        """(addresses of the functions, address of the workspace) with a factored step matrix, and with other threads for large scenes."""
        own = system.workspace
        with self.helpers.at_work(system.corotated, own) if self.helpers else nullcontext(own) as workspace:
            self.c[:] = system.c_m, system.c_v
            if self.work is None or self.work.real.workspace is not workspace:
                self.set_factors(real=Factor(self.c, system.corotated, workspace, np.zeros((0, 2, 2))))
                if self.w["optional"][LAW_SLOPES] and self.model.bodies:
                    self.w["optional"][RENEW] = entry_address(new_slopes, self.type_for("real"))
            yield self.functions, self.work.address
        self.raised = self.model.take_error()


class SceneTable(OneFactorScene):
    """The table of a scene for generalized-alpha, with the methods of PythonTable.

    projects: whether it needs rates and projections. condensed: True if the unknowns are the coordinates without strains.
    """

    def __init__(self, model, projects, incremental, condensed=False):
        """Choose the entries and the optional kernels that generalized-alpha asks for."""
        condensed = condensed and bool(model.strains)
        self.unknowns = 2 * model.n_factored if condensed else model.n
        begin, wanted = np.arange(INSTANTS) - 1, {LAW_FORCES, DAMPING} | ({RELAXING} if not condensed else set())
        # begin[k]: row of `drives` at the begin of the step that ends at instant k; that of the first step is the last row
        begin[0] = INSTANTS
        options = {"pairs": self.unknowns // 2, "incremental": bool(incremental), "condensed": condensation(model, condensed)}
        super().__init__(model, np.ones(1), np.zeros(INSTANTS, np.int64), begin, wanted, **options)
        calls = self.w["condensed"].calls[:2].copy()
        self.w["scene"] = model.arrays._replace(relaxation=model.arrays.relaxation._replace(condensed=calls))
        self.entries = entries(table.BEGIN, table.RESIDUAL, table.CONSTRAINTS, table.SOLVE, table.ACCEPT)
        self.entries |= entries(table.RATE, table.PROJECT) if projects else {table.RATE: idle, table.PROJECT: idle}
        if condensed:
            self.entries |= entries(table.STRAINS)

    def prepare(self, times, ends, h):
        """Evaluate loads and motors at the times (k + 1,) of k steps of h; ends: the first and the last time, or beside them inside at a kink."""
        w, count, drives = self.w, len(times) - 1, drive_table(self.model, times, ends)
        w["drives"][:count], w["drives"][INSTANTS] = drives[1:], drives[0]
        w["gains"][:count], w["h"][0] = gain_table(self.model, times, drives, h), h
