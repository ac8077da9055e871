"""The integrators on one model, measured against a refined run: the numbers of the comparison as plain data."""

import time
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from polyida.environment import one_blas_thread
from polyida.errors import InputError, StepFailure
from polyida.integrate.state import Counts, States, between
from polyida.model.guarded import guard
from polyida.results.motion import motor_work, unbalanced
from polyida.run.accepted import accepted
from polyida.study import chosen
from polyida.validation import is_number

FINE, FINER = 1e-9, 1000  # rtol of the refined run: the one, or that of the runs over the other where that is less
FINEST = 1e-13  # but no less: round-off is as large
REFINED = "refined run"
LONGEST = 60  # characters of a label: four bytes each are below the 255 of a file's name


@dataclass(frozen=True)
class Comparison:
    """What `compare` found.

    runs: {label: Trajectory}. distances: {label: (t, distance from the refined run)}. rows: one dictionary a run, the
    refined run last. figures: {name: number} of the same. notes: what failed, in words. quantity, unit: what the
    distance is of.
    """

    job: object
    runs: dict
    distances: dict
    rows: list
    notes: list = field(default_factory=list)
    quantity: str = "tip"
    unit: str = "m"

    @property
    def success(self):
        """Whether every run, the refined one included, came to its end."""
        return not self.notes

    @property
    def figures(self):
        """{name: number}, names as `alpha_error_max`; only what is a finite number."""
        short = {label: name for name, (_, label, _) in chosen.KNOWN.items()} | {REFINED: "refined"}
        numbers = {f"{short.get(row['run'], row['run'])}_{key}": value for row in self.rows for key, value in row.items()}
        numbers["gap_end"] = self.gap
        return {
            key: value
            for key, value in numbers.items()
            if isinstance(value, int | float) and not isinstance(value, bool) and np.isfinite(value)
        }

    @property
    def gap(self):
        """Largest distance between two integrators at the end, or NaN where one of them did not get there."""
        ends = [watch(self.job)(run.q[-1]) for run in self.runs.values() if run.success]
        if len(ends) < max(2, len(self.runs)):
            return float("nan")
        return max(float(_size(one - other)) for one, other in combinations(ends, 2))


def heeded(run):
    """The run, unless Ctrl-C ended it: that ends the whole comparison."""
    if run.status == "interrupted":
        raise KeyboardInterrupt
    return run


def integrators(job, names=chosen.COMPARED, **settings):
    """{label: integrator} of names that a command takes, made for a job; settings (step, rtol) go to those that take them."""
    return chosen.compared(chosen.choices(names), job, **settings)


def compare(job, rtol=None, progress=None, members=None):
    """Run integrators and the refined run of a Job; returns a Comparison.

    members: {label: integrator}, a user's own among them; generalized-alpha with the job's step, IDA and Radau IIA where None.
    The refined run is Radau IIA with rtol 1e-9, or a thousandth of the runs'; an error is the distance of the watched point
    (or of all coordinates, for a model without points) from it. rtol: of IDA and Radau IIA. progress: callable(label, fraction done),
    fraction None while kernels compile. Failures of a run do not raise: they are in `notes`. InputError is raised
    before the first run.
    """
    tell = progress or (lambda label, fraction: None)
    members = integrators(job, rtol=rtol) if members is None else members
    return measured(job, timed(job, prepared(job, members, tell), tell), tell)


def prepared(job, members, tell=lambda label, fraction: None):
    """{label: integrator} of what `compare` runs, looked at, their kernels loaded: nothing is left to do but the runs."""
    from polyida.run.solve import require_run

    if not isinstance(members, dict) or not members:
        raise InputError(f"compare: members = {members!r} must be a dictionary {{label: integrator}}")
    for label in members:  # a name of files in the report, too
        if not isinstance(label, str) or not label or set(label) & set("/\\\0") or label == REFINED or len(label) > LONGEST:
            raise InputError(
                f"compare: label {label!r} must be the name of a file, no longer than {LONGEST} characters, and not {REFINED!r}"
            )
    for member in members.values():
        require_run(job.model, job.time, 0.0, member)
    tell("preparing kernels", None)
    for member in members.values():
        warm_up(job, member)
    return members


def timed(job, members, tell=lambda label, fraction: None):
    """{label: Trajectory} of {label: integrator}; their CPU times are compared, so nothing else should go on."""
    return {label: _run(job, member, label, tell) for label, member in members.items()}


def measured(job, runs, tell=lambda label, fraction: None):
    """The Comparison of {label: Trajectory} with the refined run, which is made here."""
    tightest = min(filter(is_number, (getattr(run.integrator, "rtol", None) for run in runs.values())), default=None)
    refined = refine(job, tightest, np.unique(np.concatenate([run.t for run in runs.values()])), tell)
    distances = {label: (run.t, refined.distance(run)) for label, run in runs.items()}
    rows = [_row(label, run, distances[label][1]) | published(job, run.q[-1], run.success) for label, run in runs.items()]
    rows.append(refined.row() | published(job, refined.watched[-1], not refined.message))
    notes = [f"{label}: {run.message.removeprefix(f'{label}: ')}" for label, run in runs.items() if not run.success]
    notes += [f"{REFINED}: {refined.message}"] if refined.message else []
    quantity, unit = (job.point, "m") if job.point else ("coordinates", "")
    return Comparison(job, runs, distances, rows, notes, quantity, unit)


def watch(job):
    """Function q (n,) -> what is looked at: the place of the job's point, (2,), m, or q itself."""
    if job.point is None:
        return np.array
    rest = job.model.attachment(job.point).point
    return lambda q: rest + job.model.displacement(job.point, q)


def warm_up(job, member):
    """Two steps with an integrator, so that compiling or loading kernels counts as nobody's time."""
    from polyida.run.solve import solve

    with job.code():
        heeded(solve(job.model, min(job.time, 2 * job.step), member, q0=job.q0, v0=job.v0))


def _run(job, member, label, tell):
    from polyida.run.solve import solve

    with job.code():
        return heeded(solve(job.model, job.time, member, q0=job.q0, v0=job.v0, progress=lambda t: tell(label, t / job.time)))


@dataclass
class Refined:
    """The refined run: what was watched at the times asked for, and nothing else kept."""

    integrator: object
    t: np.ndarray
    watched: np.ndarray
    look: object
    counts: Counts
    cpu_seconds: float
    message: str

    def distance(self, run):
        """Distance of a run from this one at the run's times, NaN beyond the end of this one."""
        found, known = np.full(len(run.t), np.nan), run.t <= self.t[-1]
        seen = np.array([self.look(q) for q in run.q[known]])
        found[known] = _size(seen - self.watched[np.searchsorted(self.t, run.t[known])])
        return found

    def row(self):
        """What is known of it, in the form of the other rows."""
        return {
            "run": REFINED,
            "settings": repr(self.integrator),
            "success": not self.message,
            "t_end": float(self.t[-1]),
            "cpu_s": self.cpu_seconds,
        } | self.counts.as_dict()


def refine(job, rtol, times, tell):
    """The refined run, keeping only what is watched at the times, the first of which is its start."""
    from polyida.integrate.radau.radau_iia import RadauIIA
    from polyida.integrate.start import consistent_state

    fine, counts, look = RadauIIA(rtol=FINE if rtol is None else max(FINEST, min(FINE, rtol / FINER))), Counts(), watch(job)
    begin, message = time.process_time(), ""
    with job.code(), one_blas_thread():
        before = consistent_state(job.model, 0.0, job.q0, job.v0)
        watched = [look(before.q)]
        try:
            for state in States(accepted(fine, guard(job.model), before, job.time, counts), counts):
                while len(watched) < len(times) and times[len(watched)] <= state.t:
                    watched.append(look(between(before, state, times[len(watched)]).q))
                before = state
                tell(REFINED, state.t / job.time)
        except StepFailure as failure:
            message = str(failure)
    return Refined(fine, times[: len(watched)], np.array(watched), look, counts, time.process_time() - begin, message)


def _row(label, run, distance):
    return {
        "run": label,
        "settings": repr(run.integrator),
        "success": bool(run.success),
        "t_end": float(run.t[-1]),
        "error_max": float(np.nanmax(distance, initial=0.0)) if np.isfinite(distance).any() else float("nan"),
        "error_end": float(distance[-1]),
        "cpu_s": float(run.cpu_seconds),
        "wall_s": float(run.wall_seconds),
        **run.counts.as_dict(),
        "drift_max": float(np.max(run.drift, initial=0.0)),
        "velocity_drift_max": float(np.max(run.velocity_drift, initial=0.0)),
        "energy_change": float(unbalanced(run)[-1]),
        "motor_work": float(motor_work(run)[-1]),
    }


def published(job, q, finished):
    """{"published_error": largest deviation of q at the end from the published one}, empty where there is none."""
    known = job.published.get("q") if finished and job.point is None else None
    return {} if known is None else {"published_error": float(np.abs(q - known).max())}


def _size(difference):
    """Length of plane vectors (..., 2), largest entry otherwise."""
    difference = np.asarray(difference, float)
    if difference.shape[-1] == 2:
        return np.linalg.norm(difference, axis=-1)
    return np.abs(difference).max(axis=-1, initial=0.0)
