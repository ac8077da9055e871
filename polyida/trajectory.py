"""Trajectory: the frames of a run, its counts, how it ended, and values derived from the frames on request."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida import registry
from polyida.assembly.motion import hint_of_left_out, hint_of_rigid
from polyida.assembly.scene_bodies import nodal_stress
from polyida.errors import InputError, printable
from polyida.event import Events
from polyida.integrate.state import Counts, Restart, State, declared
from polyida.io.frames import blocks, each
from polyida.io.save import save
from polyida.model.guarded import guard, unguarded
from polyida.model.row_laws import violation
from polyida.reprs import CELL, LONGEST, cut, short, table, used_text
from polyida.results.energy import Energy, energy_of, grown
from polyida.results.motion import Motion, angle_of, dataframe, dataset, momenta_of, names_of_joints, reaction_of, strains, von_mises
from polyida.results.section_forces import SectionForces, section_forces
from polyida.sensor import Sensors
from polyida.validation import is_one_of, is_whole, named_keywords

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset

    from polyida.show.animations import Animation
    from polyida.show.plots import RunPlots


def _across(model, counts):
    """Stress across the plane over xx + yy, of counts values for each drawn plate."""
    return np.repeat([body.plate.material.across for body in model.drawn], counts)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The frames of a run and how it ended.

    Frames that exceed the memory limit stay in a file: they index, slice and iterate like arrays and are read when needed; with
    precision="single" they are float32. Energies, drift, positions, reactions and stresses are computed from the frames on request.

    Parameters
    ----------
    model : Model or None
        None if a loaded run has none.
    integrator : Integrator or str
        The name of a class that is not known, of a loaded run.
    t : (frames,) float, s
    q, v, a : (frames, n) float
    lam : (frames, m) float
    status : str
        "done", "stopped" (by `until` or an event), "interrupted", "running" (a file that is still written), "damaged" (a file; the frames before the
        damage), "error" (in a user's function), "disk full", or the kind of failure.
    message : str
        Place and reason of a failure.
    counts : Counts
        Exact counts of the work.
    cpu_seconds, wall_seconds : float, s
        Of the run, without compiling and loading kernels.
    compile_seconds : float, s
        CPU seconds that the run took to compile and load kernels and libraries; about zero in later runs of the process.
    machine : dict
        Versions, processor and threads.
    restart : Restart or None
        The state from which the run can be continued.
    plan : dict
        The arguments of `solve`.
    missing : str
        Why there is no model.
    sensors : Sensors
        {name: values at every step}, with their times `sensors.t`.
    events : Events
        Those that happened: time, name, impulse and energy lost of each.
    settings_used : dict
        {setting: value} of the integrator as the run used them: tolerances that the run chose stand in place of None. Of IDA "ida_rtol" and "atol"
        (of q, of v) are what SUNDIALS got. None: chosen anew in each step, or not known, if the run failed before its first step.
    """

    model: Any
    integrator: Any
    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray
    status: str = "done"
    message: str = ""
    counts: Counts = field(default_factory=Counts)
    cpu_seconds: float = 0.0
    wall_seconds: float = 0.0
    compile_seconds: float = 0.0
    machine: dict = field(default_factory=dict)
    restart: Restart | None = None
    plan: dict = field(default_factory=dict)
    missing: str = "no file holds a model of a user's own"
    sensors: Sensors = field(default_factory=Sensors)
    events: Events = field(default_factory=Events)
    settings_used: dict = field(default_factory=dict)

    @property
    def state(self) -> State:
        """The final state; `solve(model, t_end, integrator, state=run.state)` continues from it.

        It has the integrator's memory, so that generalized-alpha with constant steps continues as if it had not stopped. A state that
        `until` located between two steps has none: solve then starts again from it, projected onto the constraints.
        """
        columns = self.mode.columns if self.events.given else slice(None)
        if self.restart and not (len(self) and self.t[-1] > self.restart.state.t):
            state = self.restart.state
            state = replace(state, lam=state.lam[columns]) if self.events.given else state
        else:
            q, v, a, lam = (np.asarray(x[-1], float) for x in (self.q, self.v, self.a, self.lam))
            state = State(float(self.t[-1]), q, v, a, lam[columns], restart=False)
        return state if self.model is None else state.of(self.known_model("state"))

    @property
    def mode(self) -> Any:
        """The model at the end: `model` without events; with events that of the parts that act then, for `solve(run.mode, state=run.state)`."""
        model = self.known_model("mode")
        return unguarded(self.events.modes(model)[-1]) if self.events.given else self.model

    @property
    def memory(self) -> dict:
        """What the integrator needs to continue from the last frame as if it had not stopped; empty if unknown."""
        return self.state.memory if len(self) and self.state.t == self.t[-1] else {}

    @property
    def success(self) -> bool:
        """True if the run reached its end."""
        return self.status in ("done", "stopped")

    @property
    def steps(self) -> int:
        """Number of accepted steps of the run."""
        return self.counts.steps

    def __len__(self):
        """The number of frames of the run."""
        return len(self.t)

    @property
    def x(self) -> NDArray:
        """First-order states of every frame, (frames, k); last the relaxed strains of viscoelastic plates."""
        model = self.known_model("x")
        return np.concatenate([model.states_of(v) for v in blocks(self.v)]) if len(self) else np.zeros((0, model.k))

    def states(self, name: Any = None) -> NDArray:
        """States of a force element, (frames, states), by its name or itself, followed by algebraic ones and by the outputs of a controller.

        Without a name those of a user's model, (frames, k + algebraic). Raises InputError if it has none.
        """
        model = self.known_model("states")
        if name is None and (own_states := model.own_states):
            return np.array([own_states.states(*frame) for frame in zip(self.t.tolist(), each(self.q), each(self.v))]).reshape(
                -1, own_states.total
            )
        known = name if isinstance(name, str) else next((key for key, part in model.parts.items() if part is name), None)
        elements = {own.name: own for own in model.own_forces if own.names} if model.is_scene else {}
        if known not in elements:
            named = ", ".join(map(repr, elements)) or "none"
            raise InputError(f"states: no force element with states is called {name!r:.100}; known: {named}")
        if (own := elements[known]).element.algebraic:
            return np.array([own.states_at(*frame) for frame in zip(self.t, each(self.q), each(self.v))]).reshape(-1, len(own.names))
        placed = own.placed
        return np.concatenate([v[:, placed.columns] * placed.units for v in blocks(self.v)])

    @cached_property
    def drift(self) -> NDArray:
        """Largest |phi| of every frame, (frames,), in phi's unit (m for joints), with the rows that were left out as redundant.

        Of a contact it is the penetration.
        """
        pieces = ((one.model.redundant.whole if one.model.redundant else one.model, one) for one in self._pieces("drift"))
        return np.array([_largest(violation(model, model.phi(t, q))) for model, one in pieces for t, q in zip(one.t, each(one.q))])

    @cached_property
    def velocity_drift(self) -> NDArray:
        """Largest |phi_q v + phi_t| of every frame, (frames,), of the rows that are equations: without contact and friction."""
        frames = ((one.model, *frame) for one in self._pieces("velocity_drift") for frame in zip(one.t, each(one.q), each(one.v)))
        return np.array([_largest(np.delete(model.phi_rate(t, q, v), [law.row for law in model.row_laws])) for model, t, q, v in frames])

    @cached_property
    def energy(self) -> Energy:
        """Kinetic, potential (gravity, force elements) and strain energy of every frame; on request work of parts and dissipation."""
        pieces = self._pieces("energy")
        if len(self.events) and not self.events.given:  # the energy lost in impacts has the work of the friction in them
            pieces = [pieces[0]._replace(lam=self._without_impacts(pieces[0].model))]
        thinned = bool(self.plan) and (self.plan.get("every", 1) > 1 or self.plan.get("output") is not None)
        return energy_of(pieces, self.events, _settled, thinned)

    def _without_impacts(self, model):
        """lam without the friction that the energy lost in an impact contains, in the frames of such steps."""
        lam = np.array(self.lam, float)
        for one in (one for one in self.events if self.t[one.frame] == one.t):
            lam[one.frame, [law.row for law in model.row_laws if law.name == one.name and not law.is_contact]] = 0.0
        return lam

    @property
    def momentum(self) -> NDArray:
        """Momentum of all bodies, (frames, 2), N s. Raises InputError if a user's model has no `momenta`."""
        return self._momenta[:, :2]

    @property
    def angular_momentum(self) -> NDArray:
        """Angular momentum of all bodies about the origin, (frames,), N m s. Raises InputError as `momentum` does."""
        return self._momenta[:, 2]

    @cached_property
    def _momenta(self):
        """Momenta of all frames, (frames, 3): px and py, N s, and the angular momentum about the origin, N m s."""
        return np.concatenate([momenta_of(one) for one in self._pieces("momentum")])

    def _motion(self, what):
        """The Motion of all frames with the known model; what: name of the method, for the message if there is no model."""
        return Motion(self.known_model(what), self.t, self.q, self.v, self.a, self.lam)

    def _pieces(self, what):
        """The Motions between events, in order, that have frames."""
        if not (self.events.given):
            return [self._motion(what)]
        frames, result = (self.q, self.v, self.a), []
        for first, end, model in self.events.pieces(self.known_model(what), len(self)):
            if first == end and (len(self) or result):
                continue
            lam = np.asarray(self.lam[first:end], float)[:, model.columns]
            result.append(Motion(guard(model), self.t[first:end], *(x[first:end] for x in frames), lam))
        return result

    def known_model(self, what: str) -> Any:
        """Return the guarded model; InputError, in the name of `what`, for a loaded run without one."""
        if self.model is None:
            raise InputError(
                f"{what}: {self.missing}; the run that was loaded has frames only. Give its model: polyida.load(path, model=...)"
            )
        return guard(self.model)

    def position(self, name: object) -> NDArray:
        """Return the path of a point: its place in every frame.

        Parameters
        ----------
        name : str, part or attachment
            A mass, load or joint, by name or itself, or an attachment.

        Returns
        -------
        (frames, 2) float, m
            Its places in the coordinates of the scene, not its displacements.

        Raises
        ------
        InputError
            If it is not in the scene.
        """
        model = self.known_model("position")
        return np.concatenate([model.position(name, q) for q in blocks(self.q)])

    def reaction(self, name: str) -> NDArray:
        """Return the reaction of a joint on its side b.

        By virtual work it is the force `-phi_q^T lam` of the joint's rows on the body of b, or on the ground. Components that
        the rows never have are left out: a revolute joint has (fx, fy), a weld (fx, fy, m), a motor (m,), a prescribed position those that
        it prescribes, the clamp of a plate to ground the force on each node, a user's joint with one row on the point of b the force along
        d phi/dx_b. `wrench` gives (fx, fy, m) of any joint. Of redundant constraints it is the reaction with the least sum of squares of
        all multipliers; see `unique`.

        Parameters
        ----------
        name : str
            Of a joint.

        Returns
        -------
        (frames, k) float
            Forces, N, in the axes of the scene; a moment, N m, about the point of b, counter-clockwise.
        """
        return self._reaction("reaction", name, False)

    def wrench(self, name: str) -> NDArray:
        """Return force and moment of any joint on its side b, also if `reaction` has fewer components, or more.

        Parameters
        ----------
        name : str
            Of a joint of a scene.

        Returns
        -------
        (frames, 3) float
            fx, fy, N, in the axes of the scene, and m, N m, about the point of b.
        """
        return self._reaction("wrench", name, True)

    def _reaction(self, call, name, whole):
        """Reactions (frames, k) of a joint, in the name of `call`; whole: all of (fx, fy, m)."""
        model, reactions = self._of_joint(call, name), []
        if whole and not (model.is_scene and model.reaction_of(name)):
            raise InputError(f"{call}: {name!r} is no joint of a scene")
        for one in self._pieces(call):
            first = 0
            for q in blocks(one.q):
                part = slice(first, first + len(q))
                reactions.append(reaction_of(one.model, name, np.asarray(one.t[part]), q, np.asarray(one.lam[part], float), whole))
                first += len(q)
        return np.concatenate(reactions)

    def angle(self, joint: object) -> NDArray:
        """Return the rotation of side b of a joint relative to side a since the reference configuration.

        Parameters
        ----------
        joint : str or Joint
            Both sides need a direction.

        Returns
        -------
        (frames,) float, rad
            Counter-clockwise; unwrapped, so that frames must be less than half a turn apart; the first is between -pi and pi.
        """
        return angle_of(self._motion("angle"), joint)

    def unique(self, name: str) -> bool:
        """Return True if the reaction of a joint is unique, as it is without redundant constraints."""
        self._of_joint("unique", name)
        return all(one.model.redundant is None or one.model.redundant.unique(name) for one in self._pieces("unique"))

    def _of_joint(self, what, name):
        """The guarded model, which has a joint of that name. Raises InputError, in the name of `what`."""
        model = self.known_model(what)
        if not is_one_of(name, model.rows):
            raise InputError(f"no joint is called {name!r}; known: {names_of_joints(model)}")
        return model

    def node_positions(self, frame: int) -> NDArray:
        """Return the places of the nodes of all plates in a frame, with reduced and rigid ones, (nodes, 2), m."""
        q, model = self._frame("node_positions", frame), self._scene("node_positions")
        return model.drawn_points + model.nodal(q)

    def stress(self, frame: int, at: str = "cells") -> NDArray:
        """Return the Cauchy stress in a frame: xx, yy, xy in Pa, plate after plate.

        It includes the viscous stress of `viscosity`, and the relaxation of viscoelastic plates.

        Parameters
        ----------
        frame : int
        at : "cells" or "nodes"
            Means over the elements; or at the nodes, averaged over their cells. The stress of quadratic cells is linear in each.

        Returns
        -------
        (cells, 3) or (nodes, 3) float, Pa
        """
        q, model = self._frame("stress", frame), self._scene("stress")
        if not is_one_of(at, ("cells", "nodes")):
            raise InputError(f'stress: at = {at!r} must be "cells" or "nodes"')
        v = np.asarray(self.v[frame], float)
        return model.stress(q, v) if at == "cells" else nodal_stress(model, q, v)

    def strain(self, frame: int) -> NDArray:
        """Return Green's strain `E = (F^T F - I) / 2` of every element in a frame, (cells, 3): Exx, Eyy, 2 Exy, means over the element.

        In the axes of the scene at rest, plate after plate; zero under any rigid motion.
        """
        return strains(self._scene("strain"), self._frame("strain", frame))

    def section_forces(self, plate: object, at: ArrayLike, normal: ArrayLike = (1.0, 0.0), frame: int | None = None) -> SectionForces:
        """Return normal force, shear force and bending moment through a straight cut across a full plate.

        They are the forces of the part ahead on the part behind: nodal forces of cells with inertia, damping and weight, in exact
        equilibrium with loads, joints and inertia, not stresses at points. Loads and joints on nodes of both parts act behind.

        Parameters
        ----------
        plate : str or Plate
        at : (2,) float, m
            A point of the cut, in the axes of the plate's mesh, where the plate is at rest.
        normal : (2,) float
            The direction from the part behind to the part ahead, in the same axes.
        frame : int, optional
            One frame; by default all.

        Returns
        -------
        SectionForces
            Over the frames.

        Raises
        ------
        InputError
            For another plate, a reduced or rigid one, and a cut that does not divide it.
        """
        self._scene("section_forces")
        if frame is not None:
            self._frame("section_forces", frame)
        return section_forces(self._motion("section_forces"), plate, at, normal, frame)

    def von_mises(self, frame: int, at: str = "cells") -> NDArray:
        """Return the von Mises stress in a frame, Pa, with the stress across the plane in plane strain.

        Parameters
        ----------
        frame : int
        at : "cells" or "nodes"
            Of the mean stress of each element, of quadratic cells the largest at their three points; or of the stress at the nodes.

        Returns
        -------
        (cells,) or (nodes,) float, Pa
        """
        q, model = self._frame("von_mises", frame), self._scene("von_mises")
        if not is_one_of(at, ("cells",)):
            stress = self.stress(frame, at)
            return von_mises(stress, _across(model, [body.mesh.n_nodes for body in model.drawn]) * (stress[:, 0] + stress[:, 1]))
        stress = model.stress(q, np.asarray(self.v[frame], float), at_points=True)
        points = [3 if body.plate.order == 2 else 1 for body in model.drawn]
        values = von_mises(
            stress, _across(model, [k * body.mesh.n_cells for k, body in zip(points, model.drawn)]) * (stress[:, 0] + stress[:, 1])
        )
        of_cells = np.repeat(points, [body.mesh.n_cells for body in model.drawn]).astype(int)
        return np.maximum.reduceat(values, np.cumsum(of_cells) - of_cells) if len(of_cells) else values

    def _frame(self, what, frame):
        """q (n,) of a frame, as floats. Raises InputError for an index that the run does not have; what: the method that asks."""
        if not is_whole(frame, -len(self), len(self) - 1):
            raise InputError(f"{what}: frame = {frame!r} must be the index of one of the run's {len(self)} frames")
        return np.asarray(self.q[frame], float)

    def _scene(self, what):
        """Return `self.model` if it is the model of a scene, else raise InputError; what: name of the method that asks, for the message."""
        if not self.known_model(what).is_scene:
            raise InputError(f"{what}: {type(self.model).__name__} is no scene's model; read q")
        return self.model

    def summary(self) -> str:
        """Return one line: how the run ended, its cost, and its drift."""
        c = self.counts
        worst = f", |phi| <= {self.drift.max():.1e}" if self.model is not None and self.model.m and len(self) else ""
        end = f"t = {self.t[-1]:.6g} s" if len(self) else "no frame"
        work = f"{c.newton_iterations} iterations, {c.factorizations} factorizations, {self.cpu_seconds:.2f} CPU s"
        notes, model = [], self.model
        method = None if isinstance(self.integrator, str) else declared(self.integrator)
        if method and len(self):
            notes.append(method.summary_of_steps(self.state.memory))
        if model is not None:
            notes += [model.remark, hint_of_rigid(model, self.q, method and method.relative_tolerance())]
            notes += [hint_of_left_out(model, self.t, self.q, self.a) if model.reduced_bodies else ""]
            notes += [self.events.summary_of_laws(self.cpu_seconds) if model.row_laws else ""]
            notes += [f"events: {self.events.summary()}" if len(self.events) else ""]
            notes += ["" if self.events.given else grown(self._motion("summary"))]
        elif self.missing != Trajectory.missing:
            notes.append(self.missing)
        name = method.class_name() if method else self.integrator
        text = "".join(f", {note}" for note in notes if note) + (f"; {self.message}" if self.message else "")
        return printable(f"{self.status}: {name} to {end}, {c.steps} steps ({c.rejected} rejected), {work}{worst}{text}")

    def __repr__(self):
        """One line with how the run ended, its integrator, times and sizes."""
        return f"<Trajectory: {self._headline()}>"

    def _headline(self):
        """A line of text: status, integrator, first and last time, number of frames and steps, n and m."""
        name = self.integrator if isinstance(self.integrator, str) else type(self.integrator).__name__
        end = f"t = {self.t[0]:.6g} to {self.t[-1]:.6g} s" if len(self) else "no frame"
        n, m = (np.shape(x)[-1] for x in (self.q, self.lam))
        return f"{self.status}, {cut(name, LONGEST)}, {end}, {len(self)} frames, {self.steps} steps, n = {n}, m = {m}"

    def _integrator_text(self):
        """The integrator with the settings that were used."""
        return cut(self.integrator if isinstance(self.integrator, str) else used_text(self.integrator, self.settings_used), CELL)

    def _repr_html_(self):
        """HTML for notebooks: status, counts and the last frame."""
        model = "not known" if self.model is None else short(self.model)
        seconds = f"{self.cpu_seconds:.3g} CPU s, {self.wall_seconds:.3g} s by the clock; compiling {self.compile_seconds:.3g} CPU s"
        rows = [("message", self.message)] * bool(self.message) + [("model", model), ("integrator", self._integrator_text())]
        rows += [("time taken", seconds), ("counts", ", ".join(f"{name} {count}" for name, count in self.counts.as_dict().items()))]
        rows += [("events", cut(self.events.summary(), CELL))] * bool(self.events)
        return table(f"Trajectory: {self._headline()}", (), rows) + registry.find(registry.views, "drawing")(self)

    @property
    def plot(self) -> RunPlots:
        """Plots on matplotlib axes: `run.plot.energy()`, `position("tip")`, `tip()`, `reactions("shoulder")`, `drift()`, `deformed()`."""
        return registry.find(registry.views, "plot")(self)

    @named_keywords
    def animate(self, seconds: float | None = None) -> Animation:
        """Return the motion: a notebook shows it with a slider, `.save("motion.gif")` writes it, also as .mp4, .svg and .html.

        Parameters
        ----------
        seconds : float, s, optional
            Duration. Default: the simulated time, between 4 and 12 s.

        Returns
        -------
        animation : Animation

        Raises
        ------
        InputError
            For a run without anything to draw.
        """
        return registry.find(registry.views, "animate")(self, seconds)

    def to_dataframe(self) -> DataFrame:
        """Return a pandas.DataFrame with a row for each frame.

        Columns of a scene: `t`; places `NAME.x`, `NAME.y`, m, of masses, loads and joints; states `NAME.STATE` of force elements; reactions on
        side b, `NAME.force_x`, N, `NAME.torque`, N m; `energy.kinetic`, `.potential`, `.strain`, `.total`, J; `drift`. Of other models: `t`,
        `q[0]`, ..., `v[0]`, ..., `lam[0]`, ..., and first-order and algebraic states `x[0]`, ...
        """
        return dataframe(self)

    def to_xarray(self) -> Dataset:
        """Return an xarray.Dataset over t: q, v, a (t, coordinate), lam (t, constraint), and values of sensors over step, at t_step.

        With states also x (t, state), named as in `to_dataframe`; q, v and a have the columns of states too. Of a scene also position
        (t, point, axis), reaction (t, component), the energies and drift. Raises InputError if xarray is missing.
        """
        return dataset(self)

    @named_keywords
    def save(self, path: str | Path, overwrite: bool = False) -> None:
        """Write to an HDF5 file. Raises InputError if it exists and overwrite is False."""
        save(self, path, overwrite)


def _largest(values):
    """Largest absolute value of an array, a float; 0 if it is empty."""
    return float(np.abs(values).max(initial=0.0))


def _settled(model, t, q, v, lam, gap=1e-8):
    """(q, v, lam) of an interpolated state, on driven constraints if |phi| is larger than the gap over the size of q; else as they are."""
    from polyida.integrate.start import on_drives

    state = on_drives(guard(model), State(t, q, v, v, lam), gap)
    return state.q, state.v, state.lam
