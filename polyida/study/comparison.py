"""`polyida compare`: integrators on one initial value problem against a reference run, and the report with runs, pictures and movie."""

import math
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from polyida.adjoint.error_bars import error_of
from polyida.clock import clock
from polyida.environment import one_blas_thread
from polyida.errors import InputError, StepFailure, text_of
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.state import Counts, States, between, declared
from polyida.model.guarded import guard
from polyida.objective.objective import UserObjective
from polyida.reprs import used_text
from polyida.results.motion import motor_work, unbalanced
from polyida.run.accepted import accepted
from polyida.run.solve import require_run
from polyida.show import html, plates, plots
from polyida.study.result import Result
from polyida.study.user_files import COMPARED, KNOWN, choose_integrators, create_integrators
from polyida.validation import is_number

REFERENCE = "refined run"  # label of the reference run
MAX_RTOL, RTOL_RATIO, MIN_RTOL = 1e-9, 1000, 1e-13  # rtol of the reference: a thousandth of the runs' rtol within these limits
NEGLIGIBLE = 0.1  # of an estimated distance: a direction with less is not asked whether it is trusted
MAX_LABEL = 60  # characters; labels are file names
MAX_VTU_FRAMES = 50
FEW_FRAMES = 200  # runs with fewer frames are drawn through the polynomials between their steps
MAX_EVENTS = 50  # rows of the table of a run's events
EVENT_COLUMNS = {  # attribute of an event: (heading, format)
    "t": ("t, s", "{:.6g}"),
    "name": ("event", "{}"),
    "impulse": ("impulse, N s", "{:.4g}"),
    "energy_lost": ("energy lost, J", "{:.4g}"),
}
ERRORS = (
    "Errors are distances from the refined run: Radau IIA on the same mesh with rtol 1e-9, or with a thousandth of the runs' rtol. They are "
    "errors of time integration, not of the mesh. CPU seconds do not contain the compilation of kernels. The energy change is that of "
    "kinetic, strain and gravity energy, less the work of the motors."
)


class Comparison(Result):
    """Result of `compare`: a row for each run, the last one of the reference run.

    runs: {label: Trajectory}. distances: {label: (t, distance from the reference run)} of `quantity` in `unit`. notes: failures.
    estimates: why runs have no estimated error.
    """

    columns = {
        "run": ("run", "{}"),
        "error_max": ("error, largest", "{:.2e}"),
        "error_end": ("error, at the end", "{:.2e}"),
        "estimated_error": ("error, at the end, estimated", "{:.2e}"),
        "published_error": ("from published", "{:.2e}"),
        "states_max": ("error of states, largest", "{:.2e}"),
        "states_end": ("error of states, at the end", "{:.2e}"),
        "cpu_s": ("CPU s", "{:.2f}"),
        "steps": ("steps", "{}"),
        "newton_iterations": ("iterations", "{}"),
        "factorizations": ("factorizations", "{}"),
        "drift_max": ("drift of phi", "{:.1e}"),
        "energy_change": ("energy change, J", "{:.2e}"),
    }

    def __init__(self, ivp, runs, distances, rows, notes, estimates=()):
        """Take the parts of the class's description; compute title, lead and `gap`, the largest distance between two runs at the end."""
        super().__init__(rows, notes)
        self.estimates = list(estimates)
        self.ivp = ivp
        self.runs = runs
        self.distances = distances
        self._drawn = {}
        self.pictured: dict = {}  # {label: Trajectory} that the pictures show, with frames between few steps
        self.quantity, self.unit = (ivp.point, "m") if ivp.point else ("coordinates", "")
        *others, last = runs
        self.title = f"{ivp.name}: {' and '.join(filter(None, [', '.join(others), last]))}"
        plural = "s" * (ivp.model.m != 1)
        self.lead = f"{ivp.model.n} coordinates, {ivp.model.m} constraint{plural}, {ivp.t_end:g} s simulated."
        ends = [watched_quantity(ivp)(run.q[-1]) for run in runs.values() if run.success]
        complete = len(ends) == len(runs) > 1
        self.gap = max(float(_size(one - other)) for one, other in combinations(ends, 2)) if complete else math.nan

    @property
    def success(self):
        """True if every run reached its end, the reference run included."""
        return not self.notes

    @property
    def figures(self):
        """{name: number} of the finite numbers, with names such as `alpha_error_max`."""
        names = {label: name for name, (_, label, _) in KNOWN.items()} | {REFERENCE: "refined"}
        numbers = {f"{names.get(row['run'], row['run'])}_{key}": value for row in self.rows for key, value in row.items()}
        return {key: value for key, value in (numbers | {"gap_end": self.gap}).items() if is_number(value)}

    def shown_columns(self):
        """{name: (heading, format)} of the columns that a row has; errors are headed by the compared quantity and its unit."""
        unit = f", {self.unit}" if self.unit else ""
        return {
            key: (f"{self.quantity} {heading}{unit}" if "error" in key else heading, form)
            for key, (heading, form) in self.columns.items()
            if any(key in row for row in self.rows)
        }

    def gap_text(self):
        """A sentence on the distance between the integrators at the end; empty if one of them failed."""
        if not math.isfinite(self.gap):
            return ""
        subject = "the two integrators are" if len(self.runs) == 2 else "two of the integrators are at most"
        return " ".join(f"At the end {subject} {self.gap:.2e} {self.unit} apart.".split())

    def write(self, folder, command, writer=None, progress=lambda text: None, keep=False):
        """Write figures.json and the page; keep: also the runs and VTU frames. writer: a FigureWriter that may already have some pictures."""
        for label, run in self.runs.items() if keep else ():  # first what takes longest to compute again
            progress(f"{label}.h5")
            run.save(folder / f"{label}.h5", overwrite=True)
        if keep and (run := _drawable(self.runs)) and run.model.drawn:
            from polyida.show.vtu import vtu

            progress("frames")
            vtu(run, folder / "frames", overwrite=True, frames=MAX_VTU_FRAMES)
        progress("pictures")
        self._drawn = dict(writer.figures) if writer else {}
        return super().write(folder, command, writer)

    def page(self):
        """The blocks of the report: results, settings, events, the movie of the first run that can be drawn, and figures."""
        run = _drawable(self.runs)
        label = next((label for label, other in self.runs.items() if other is run), "")
        movie = [html.Heading("Motion"), html.Movie(run, f"The motion by {label}.")] if run else []
        blocks = [html.Heading("Result"), html.Table(self.shown_columns(), self.rows), html.Notes(self.notes)]
        settings = html.Table({"run": ("run", "{}"), "settings": ("settings", "code")}, self.rows)
        blocks += [html.Text(" ".join([ERRORS, self.gap_text(), *self.estimates])), html.Heading("Settings"), settings]
        return [*blocks, *event_tables(self.runs), *movie, html.Heading("Figures"), *self.report_pictures()]

    def report_pictures(self):
        """The figures of the runs as blocks of the page; those that a FigureWriter already has are not drawn again."""
        figures = run_figures(self.ivp, self.runs, self, self.pictured or with_frames_between(self.ivp, self.runs))
        return [html.Picture(name, caption, self._drawn.get(name) or draw()) for name, (draw, caption) in figures.items()]


def with_frames_between(ivp, runs):
    """{label: Trajectory} for pictures: those with few frames are computed again, with frames of the polynomials between their steps."""
    result = {}
    for label, run in runs.items():
        result[label] = run
        if run.success and 1 < len(run) < FEW_FRAMES:
            times = np.union1d(run.t, np.linspace(run.t[0], run.t[-1], FEW_FRAMES))
            with suppress(InputError), ivp.user_errors():  # of an integrator that gives its steps alone
                finer = ivp.run(run.integrator, output=times)
                result[label] = finer if finer.success else run
    return result


def event_tables(runs):
    """Blocks of a page with the events of {label: Trajectory}, at most MAX_EVENTS of each run; none without events."""
    blocks = []
    for label, run in runs.items():
        rows = [{key: getattr(event, key) for key in EVENT_COLUMNS} for event in run.events[:MAX_EVENTS]]
        blocks += [html.Table(EVENT_COLUMNS, rows, label)] if rows else []
        blocks += [html.Text(f"and {len(run.events) - len(rows)} more")] if len(run.events) > len(rows) else []
    return [html.Heading("Events"), *blocks] if blocks else []


def run_figures(ivp, runs, comparison=None, pictured=None):
    """{file name: (function that draws the figure, caption)} of {label: Trajectory}; with a Comparison also the errors.

    pictured: the runs with frames between few steps, for motion and forces. Energies and violations are those of the steps.
    """
    runs_with_frames, drawable, figures = {label: run for label, run in runs.items() if len(run.t) > 1}, _drawable(runs), {}
    smooth = {label: (pictured or runs)[label] for label in runs_with_frames}
    if drawable and drawable.model.drawn:
        figures["mesh"] = lambda: plots.mesh(ivp.model), "The polygon mesh of one body at rest; colours show the number of corners."
    if drawable:
        meshed = "The plates at several times, coloured by the von Mises stress of every element."
        sticks = "The bodies at several times, each drawn between its points."
        figures["deformed"] = lambda: plots.deformed(drawable), meshed if drawable.model.drawn else sticks
    if not runs_with_frames:
        return figures
    if ivp.point:
        figures["tip"] = (lambda: plots.tip(smooth, ivp.point), f"Path of {ivp.point}, and the differences of the other runs from it.")
    else:
        figures["coordinates"] = lambda: plots.coordinates(smooth), "The first coordinates."
    if comparison:
        distances = {label: comparison.distances[label] for label in runs_with_frames}
        caption = f"Distance of {comparison.quantity} from the refined run."
        figures["error"] = lambda: plots.errors(distances, comparison.unit), caption
    if ivp.model.rows:
        figures["reactions"] = lambda: plots.reactions(smooth, list(ivp.model.rows)), "Reaction of each joint on its body b."
    caption = "Energies of the first run, and the change of each run's energy less external work plus dissipation."
    figures["energy"] = lambda: plots.energy(runs_with_frames), caption
    if ivp.model.m:
        caption = (
            f"Violation of the constraints: its maximum in each of {plots.INTERVALS} intervals, {plots.SMALLEST_DRIFT:g} if it is less."
        )
        figures["drift"] = lambda: plots.drift(runs_with_frames), caption
    return figures


def _drawable(runs):
    """The first run whose bodies can be drawn, or None."""
    return next((run for run in runs.values() if len(run.t) > 1 and plates.drawable(run.model)), None)


def named_integrators(ivp, names=COMPARED, **settings):
    """{label: integrator} of names on the command line; settings (step, rtol) go to the integrators that accept them."""
    return create_integrators(choose_integrators(names), ivp, **settings)


def compare(ivp, rtol=None, progress=lambda label, fraction: None, integrators=None, errors=False, writer=None):
    """Run integrators and the reference run of an InitialValueProblem; returns a Comparison.

    integrators: {label: integrator}; None: generalized-alpha with the problem's step, IDA and Radau IIA. rtol: of IDA and Radau IIA.
    progress(label, fraction), fraction None while kernels compile. An error is the distance of the problem's point, or of all coordinates,
    from the reference run. errors: True estimates the error at the end of runs of generalized-alpha too. writer: a FigureWriter, which renders
    the figures of the runs while the reference run is computed. Failed runs are notes. Raises InputError before the first run.
    """
    integrators = named_integrators(ivp, rtol=rtol) if integrators is None else integrators
    prepare(ivp, integrators, progress)
    if writer is None:
        return measure(ivp, run_timed(ivp, integrators, progress), progress, errors)
    writer.wait_until_ready()
    runs = run_timed(ivp, integrators, progress)
    pictured = with_frames_between(ivp, runs)
    for name, (draw, _) in run_figures(ivp, runs, pictured=pictured).items():
        with suppress(Exception):  # a figure that fails is drawn later
            writer.add(name, draw())
    result = measure(ivp, runs, progress, errors)
    result.pictured = pictured
    return result


def prepare(ivp, integrators, progress=lambda label, fraction: None):
    """Check {label: integrator} for a problem and load the kernels that their runs need. Raises InputError."""
    if not isinstance(integrators, dict) or not integrators:
        raise InputError(f"compare: integrators = {integrators!r} must be a dictionary {{label: integrator}}")
    for label in integrators:
        if not isinstance(label, str) or not label or set(label) & set("/\\\0") or label == REFERENCE or len(label) > MAX_LABEL:
            expected = f"must be the name of a file, no longer than {MAX_LABEL} characters, and not {REFERENCE!r}"
            raise InputError(f"compare: label {label!r} {expected}")
    for integrator in integrators.values():
        require_run(ivp.model, ivp.t_end, 0.0, integrator)
    progress("preparing kernels", None)
    for integrator in integrators.values():
        with ivp.user_errors():
            ivp.warm_up(integrator)


def run_timed(ivp, integrators, progress=lambda label, fraction: None):
    """{label: Trajectory}, one run after the other, because their CPU times are compared."""
    runs = {}
    for label, integrator in integrators.items():
        with ivp.user_errors():
            runs[label] = ivp.run(integrator, progress=lambda t, label=label: progress(label, t / ivp.t_end))
    return runs


def measure(ivp, runs, progress=lambda label, fraction: None, errors=False):
    """The Comparison of {label: Trajectory} with the reference run, computed here. errors: True estimates those of generalized-alpha."""
    rtol = min(filter(is_number, (declared(run.integrator).relative_tolerance() for run in runs.values())), default=None)
    reference = reference_run(ivp, rtol, np.unique(np.concatenate([run.t for run in runs.values()])), progress)
    distances = {label: (run.t, reference.distance(run)) for label, run in runs.items()}
    rows, estimates, published = [], [], ivp.published.get("q") if ivp.point is None else None
    for label, run in runs.items():
        row = {"run": label} | _row_of(run, distances[label][1])
        if errors and isinstance(run.integrator, GeneralizedAlpha) and run.success and np.isfinite(row["error_end"]):
            try:
                row["estimated_error"] = estimated_error(ivp, run, reference.watched[-1])
            except (InputError, StepFailure) as error:
                estimates.append(f"{label} has no estimated error: {str(error).removeprefix('error_of: ')}.")
        if guard(ivp.model).k:
            off = reference.distance_of_states(run)
            row |= {"states_max": _largest(off), "states_end": float(off[-1])}
        row |= _counts_and_balance(run)
        if published is not None and run.success:
            row["published_error"] = float(np.abs(run.q[-1] - published).max())
        rows.append(row)
    rows.append({"run": REFERENCE} | reference.row())
    if published is not None and not reference.message:
        rows[-1]["published_error"] = float(np.abs(reference.watched[-1] - published).max())
    notes = [f"{label}: {run.message.removeprefix(f'{label}: ')}" for label, run in runs.items() if not run.success]
    notes += [f"{REFERENCE}: {reference.message}"] if reference.message else []
    return Comparison(ivp, runs, distances, rows, notes, estimates)


def _row_of(run, distance):
    """{name: value} of a run: settings, end, largest and last distance from the reference run, times."""
    row = {"settings": used_text(run.integrator, run.settings_used), "settings_used": run.settings_used}
    row |= {"success": bool(run.success), "t_end": float(run.t[-1]), "error_max": _largest(distance), "error_end": float(distance[-1])}
    return row | {"cpu_s": float(run.cpu_seconds), "wall_s": float(run.wall_seconds)}


def _largest(distance):
    """The largest finite distance; NaN if there is none."""
    return float(np.nanmax(distance, initial=0.0)) if np.isfinite(distance).any() else math.nan


def _counts_and_balance(run):
    """{name: value} of a run: counts, violations of the constraints, energy change and work of motors."""
    drifts = {"drift_max": float(np.max(run.drift, initial=0.0)), "velocity_drift_max": float(np.max(run.velocity_drift, initial=0.0))}
    return run.counts.as_dict() | drifts | {"energy_change": float(unbalanced(run)[-1]), "motor_work": float(motor_work(run)[-1])}


def estimated_error(ivp, run, last):
    """Estimate of the distance of a run from the exact motion at its end, by `error_of`; last: what the reference run comes to.

    Without a point it is that of the coordinate that differs most. Raises InputError if there is no estimate, or if it is not trusted,
    and StepFailure.
    """
    if ivp.point:
        model = guard(ivp.model)
        weights = model.pulled((model.side(ivp.point), "point"), np.array([1.0, 1.0j]))
    else:
        weights = np.eye(1, run.q.shape[1], int(np.abs(watched_quantity(ivp)(run.q[-1]) - last).argmax()))
    with ivp.user_errors():
        parts = [error_of(run, _at_end(row)) for row in weights]
    errors = np.array([bars.time + bars.newton for bars in parts])
    size = float(np.linalg.norm(errors))
    for bars, error in zip(parts, errors):
        if abs(error) > NEGLIGIBLE * size and not bars.trusted:
            raise InputError("; ".join(bars.reasons["time"]))
    return size


def _at_end(weights):
    """The objective `weights . q` at the end of a run, as a UserObjective with its derivative."""

    def slopes(run):
        """Derivatives of the objective at the frames of a run: {"q": (frames, n)}, zero but for `weights` in the last frame."""
        result = np.zeros(run.q.shape)
        result[-1] = weights
        return {"q": result}

    return UserObjective(lambda run: float(weights @ run.q[-1]), slopes)


def watched_quantity(ivp):
    """Function q (n,) -> what is compared: the position (2,), m, of the problem's point, or q with zeros for states."""
    if ivp.point is None:
        model = guard(ivp.model)
        return lambda q: np.array(model.without_states(q))
    rest = ivp.model.attachment(ivp.point).point
    return lambda q: rest + ivp.model.displacement(ivp.point, q)


def _size(difference):
    """Length of plane vectors (..., 2), otherwise the largest entry."""
    difference = np.asarray(difference, float)
    if difference.shape[-1] == 2:
        return np.linalg.norm(difference, axis=-1)
    return np.abs(difference).max(axis=-1, initial=0.0)


@dataclass
class ReferenceRun:
    """The reference run: only the compared quantity, and the states x, at the requested times.

    memory: of its last state. message: of a failure, or empty.
    """

    integrator: object
    t: np.ndarray
    watched: np.ndarray
    x: np.ndarray
    function: object
    counts: Counts
    cpu_seconds: float
    memory: dict
    message: str

    def distance(self, run):
        """Distance of a run from this one at the run's times; NaN after the end of this one."""
        return self._compared(run, lambda known: np.array([self.function(q) for q in run.q[known]]), self.watched, _size)

    def distance_of_states(self, run):
        """Largest distance of the states x of a run from those of this one at its times; NaN after the end of this one."""
        return self._compared(run, lambda known: run.x[known], self.x, lambda x: np.abs(x).max(axis=-1))

    def row(self):
        """{name: value} of the row of this run: settings, end, CPU time and counts."""
        used = self.integrator.settings_used(self.memory)
        row = {"settings": used_text(self.integrator, used), "settings_used": used, "success": not self.message}
        return row | {"t_end": float(self.t[-1]), "cpu_s": self.cpu_seconds} | self.counts.as_dict()

    def _compared(self, run, values, own, size):
        """Distances (frames,) of a run from this one by `size(difference)`, NaN after the end of this one.

        values(mask): the run's values in those frames; own: the reference's at its times.
        """
        distance, known = np.full(len(run.t), np.nan), run.t <= self.t[-1]
        distance[known] = size(values(known) - own[np.searchsorted(self.t, run.t[known])])
        return distance


def reference_run(ivp, rtol, times, progress=lambda label, fraction: None):
    """The ReferenceRun at increasing times, the first of which is its start. rtol: of the runs, None if unknown."""
    from polyida.integrate.radau.radau_iia import RadauIIA
    from polyida.integrate.start import consistent_state, on_drives

    integrator = RadauIIA(rtol=MAX_RTOL if rtol is None else max(MIN_RTOL, min(MAX_RTOL, rtol / RTOL_RATIO)))
    counts, function, begin, message = Counts(), watched_quantity(ivp), clock()[0], ""
    model = guard(ivp.model)
    if model.row_laws:  # by events
        with ivp.user_errors():
            run = ivp.run(integrator, output=times)
        watched, message = np.array([function(q) for q in run.q]), "" if run.success else run.message
        return ReferenceRun(integrator, run.t, watched, run.x, function, run.counts, run.cpu_seconds, run.memory, message)
    with ivp.user_errors(), one_blas_thread():
        before = consistent_state(model, 0.0, ivp.q0, ivp.v0)
        watched, x = [function(before.q)], [before.x]
        try:
            for state in States(accepted(integrator, model, before, ivp.t_end, counts), counts):
                while len(watched) < len(times) and times[len(watched)] <= state.t:
                    t = times[len(watched)]
                    seen = state if state.t == t else on_drives(model, between(before, state, t))
                    watched.append(function(seen.q))
                    x.append(model.states_of(seen.v))
                before = state
                progress(REFERENCE, state.t / ivp.t_end)
        except StepFailure as failure:
            message = str(failure)
        except (Exception, SystemExit) as error:  # noqa: BLE001 of a user's function
            message = f"{type(error).__name__}: {text_of(error)}"
    seen, cpu = times[: len(watched)], clock()[0] - begin
    return ReferenceRun(integrator, seen, np.array(watched), np.array(x), function, counts, cpu, before.memory, message)
