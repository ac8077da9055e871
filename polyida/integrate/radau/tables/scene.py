"""The table of a scene for Radau IIA: loads and motors of the steps, factors of the modes, results of a stretch (system/scene.py)."""

import ctypes
from contextlib import contextmanager

import numpy as np

from polyida import system as of
from polyida.assembly.increments import stage_tables
from polyida.assembly.optional import DAMPING, LAW_DAMPING, LAW_FORCES, RELAXING
from polyida.assembly.rate_multipliers import rate_multipliers
from polyida.assembly.scene_step_matrix import SceneStepMatrix
from polyida.errors import DONE, HALF_TURN, INVERTED, RAISED, REASONS, SINGULAR
from polyida.integrate.discontinuities import inner_side
from polyida.integrate.radau.loop import STEP, TIME
from polyida.integrate.radau.step_arrays import compiled_tableau
from polyida.jit.user_functions import CALLBACK
from polyida.linear.lu import SingularSystem
from polyida.system.scene import Scene, entries, entry_address
from polyida.system.scene_factors import empty_factor, factors_of_modes, makes_factors, matrices, scene_factors
from polyida.system.scene_functions import FUNCTIONS

RENEWAL = 20.0  # iterations that cost as much as new factors of both modes, of large scenes
PYTHON_RENEWAL = 4000.0  # the same for the Python code around a new factor, times the number of coordinates
FEW_NODES = 40  # nodes of a scene whose M^-1 is a full matrix
NEVER = 1e8  # iterations
OF_STEPS = of.BEGIN, of.REACTION, of.RESIDUAL, of.CONSTRAINTS, of.RATE, of.PROJECT, of.ROWS, of.TURN, of.REAL, of.PAIR, of.INERTIA


def inverse_mass(model):
    """M^-1 of a scene, (nodes, nodes), complex."""
    real = np.stack([np.eye(model.n_nodes), np.zeros((model.n_nodes, model.n_nodes))], axis=1)
    inverse = model.mass_inverse(real.reshape(model.n, model.n_nodes)).reshape(model.n_nodes, 2, model.n_nodes)
    return np.ascontiguousarray(inverse[:, 0] + 1j * inverse[:, 1])


class SceneStages(Scene):
    """The table of a scene: `begin` prepares a stretch, `make` the factors of a slot.

    An instant is the begin of a step or one of its s stages, numbered one after the other over the steps of a stretch. single: Python makes the factors, so that those of one slot only are at hand. prepared: the loads of the whole stretch are in `drives`; else
    PREPARE evaluates them in each step, in Python until there is a workspace, then compiled if all profiles have formulas.
    """

    longest, lifts = of.STEPS, False

    def __init__(self, model, tableau, tied):
        """Choose the arrays, kernels and entries that the stages of a step need; tied: True if there is mu."""
        self.tableau, self.tied, s, apart = tableau, tied, tableau.stages, tableau.stages + 1
        small, instants = model.n_nodes <= FEW_NODES and not model.slipping, np.arange(of.STEPS * apart)
        self.single = s == 1 or not makes_factors(model)
        options = {
            "stored": scene_factors(model, not self.single),
            "rates": rate_multipliers(model),
            "tied": tied,
            "strict": True,
            "keeps_middle": True,
            "turn": np.zeros((s, model.n_nodes, 2)),
            "vz": np.zeros((model.n_points, 2)),
            "u": np.zeros((model.n_nodes if model.strains else 0, 2)),
        }
        if small:
            options["inverse_matrix"] = inverse_mass(model)
        kernels = LAW_FORCES, LAW_DAMPING, RELAXING, DAMPING
        super().__init__(model, tableau.c, (instants - 1) % apart, instants // apart * apart, kernels, **options)
        self.entries, self.slots = entries(*OF_STEPS, *[of.ACCELERATION] * small), {}
        self.renewal = self._renewal()
        self.callback, self.prepared = CALLBACK(self._prepare), False

    def _renewal(self):
        """Iterations that cost as much as new factors."""
        if self.single:  # Python makes the factors
            return RENEWAL + PYTHON_RENEWAL / self.model.n
        if self.model.flexible:
            return RENEWAL
        return NEVER  # rigid: a new factor for the same step is the old one

    def evaluate_constants(self, t, q):
        """No effect: a scene has no constants to evaluate before a run."""

    def begin(self, engine, state, control, ends):
        """Prepare a stretch: the loads and motors of equal steps are evaluated before it, those of adaptive ones in each step.

        The first call makes empty factors and compiles the functions for their type. ends: times of the ends of equal steps. Returns the first
        instant, 0.
        """
        if self.work is None and not self.single:
            self.entries |= entries(of.MATRICES, of.SELECT)
            self.set_factors(**{"pair" if mode.paired else "real": empty_factor(self.model, mode) for mode in self.tableau.modes})
            engine.counts.backend = SceneStepMatrix.backend
        if not self.model.profiles:
            return 0
        self.prepared, self.clamp = not control.adaptive, engine.clamp
        self.functions[of.PREPARE] = 0 if self.prepared else ctypes.cast(self.callback, ctypes.c_void_p).value
        self._compile_prepare()
        if self.prepared:
            starts = np.concatenate([[state.t], ends[:-1]])
            times = np.clip(np.column_stack([starts[:, None] + self.tableau.c[:-1] * control.h, ends]), *engine.limits)
            self._take_loads(starts, times, control.h)
        return 0

    def _compile_prepare(self):
        """Use the compiled PREPARE if steps need it, all profiles have formulas, and there is a workspace."""
        if self.functions[of.PREPARE] and self.formulas and self.workspace_type:
            self.functions[of.PREPARE] = entry_address(FUNCTIONS[of.PREPARE], self.type_for())

    def _prepare(self, model, first, times, *_):
        """Evaluate loads and motors of one step, as the callback PREPARE; an exception is stored.

        times: address of (3 + s,) floats: h, t, and the times of the s + 1 instants.
        """
        try:
            h, t, _, *at = (ctypes.c_double * (3 + self.tableau.stages)).from_address(times)
            self._take_loads(np.array([t]), np.array([at]), h)
        except BaseException as error:  # noqa: BLE001 it is raised when the loop has returned
            self.raised = error
            return RAISED
        return DONE

    def _take_loads(self, starts, times, h):
        """Store loads and motors of steps of h that begin at `starts` (k,), with stages at `times` (k, s)."""
        drives, gains = stage_tables(self.model, starts, times, inner_side(self.model, starts[0], -h), self.tableau.c * h)
        shape = drives.shape
        self.w["drives"][: shape[0] * shape[1]].reshape(shape)[:] = drives
        self.w["gains"][: shape[0] * shape[1]].reshape(shape)[:, 1:] = gains

    def make(self, slot, h, made_at, counts):
        """Make the factors of a slot, unless they exist for this state, and use them. Raises SingularSystem."""
        if not self.single:
            c = compiled_tableau(self.tableau).values / h
            u = np.ascontiguousarray(made_at[1 : 1 + self.model.n]).reshape(-1, 2)
            if matrices(self.work, 0, u, 0, 0, 0, slot, c) != DONE:
                raise SingularSystem(REASONS[SINGULAR][1])
            return
        known = self.slots.get(slot)
        if known is None or known[0] != h or not np.array_equal(known[1], made_at):
            known = self.slots[slot] = h, made_at, *factors_of_modes(self.model, self.tableau.modes, h, made_at)
        *_, factors, counts.backend = known
        self.set_factors(**factors)
        self._compile_prepare()

    def end_reason(self, ended, engine, control):
        """(status, reason) for a status of the driver. For an invalid deformation, the model's reason at the first stage that it rejects."""
        status, reason = REASONS[ended]
        if ended not in (INVERTED, HALF_TURN):
            return status, reason
        q, v = engine.memory.q, engine.memory.v
        steps, t = self.tableau.c * control.now[STEP], control.now[TIME]
        stages = ((engine.clamp(t + step), q + (step * v + e)) for step, e in zip(steps, engine.trial.e))
        return status, next(filter(None, (self.model.rejection_reason(*at) for at in stages)), None) or reason

    @contextmanager
    def timed(self):
        """The time of a call of the driver, behind which an exception of a Python function is kept here."""
        yield
        self.raised = self.raised or self.model.take_error()
