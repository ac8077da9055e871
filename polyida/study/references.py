"""References: the end of a motion by two methods, refined until they agree.

A reference holds the values of Radau IIA of order 5; its accuracy is the distance to another method and what a finer run still changes. The
other method is the first of these that reaches the end and comes near enough: Radau IIA of order 3, which takes other steps at about the same
cost, DOP853 on the index-1 equations, the energy-momentum method and generalized-alpha with extrapolation, and BDF (IDA), mostly the
dearest. Runs begin with a loose tolerance; the tolerance is reduced until the accuracy is a tenth of the smallest measured error, or as long
as this improves the accuracy. Another method is asked only where Radau IIA itself no longer changes by more than that.

A method sees a force only at the stages of its steps, so that both methods may miss a short pulse. For forces without announced
discontinuities, `missed_impulse` samples the force at many times of each step, on the quintic through q, v and a of its ends, and compares
it with the cubic through the stages of Radau IIA. The missed impulse `J = int g dt - h sum b_i g_i` changes v by dv from `M dv + B^T mu =
-J`, `B dv = 0`.
"""

import time
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np

from polyida.assembly.own_forces import take_from
from polyida.environment import one_blas_thread
from polyida.errors import InputError
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.energy.energy_momentum import EnergyMomentum
from polyida.integrate.ida.integrator import IDA
from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.integrate.start import consistent_acceleration, consistent_state, restarted
from polyida.linear.lu import SingularSystem
from polyida.linear.saddle import KKT
from polyida.model.guarded import guard
from polyida.run.solve import solve
from polyida.study.ivp import PARTS, values_of
from polyida.study.kept import End
from polyida.trajectory import Trajectory
from polyida.validation import is_number

LEGS = 32  # parts of an explicit run; without projection between them, angle motors drift by 2e-10 rad in 1 s
MAX_EVALUATIONS = 3e7  # times (coordinates + SMALL_MODEL): limit of an explicit run, about fifteen seconds
SMALL_MODEL = 200
MAX_BDF_STEPS = 300_000
COUNTS_BEFORE_PROJECTION = 2000  # evaluations or steps before the total is estimated


class TooStiff(Exception):
    """A run would take too many steps or evaluations."""


class WorkLimit:
    """Counts steps or evaluations at increasing t and raises TooStiff if the projected total exceeds `limit`."""

    def __init__(self, name, what, limit, t_end, t0=0.0):
        """Begin to count at t0; name and what: the method and the counted things, for the message."""
        self.name = name
        self.what = what
        self.limit = limit
        self.t_end = t_end
        self.t0 = t0
        self.count = 0  # steps or evaluations so far

    def __call__(self, t):
        """Count a step or evaluation at t. Raises TooStiff if the total, projected from the time covered so far, is too large."""
        self.count += 1
        if self.count % COUNTS_BEFORE_PROJECTION == 0 and t > self.t0:
            total = self.count * (self.t_end - self.t0) / (t - self.t0)
            if total > self.limit:
                raise TooStiff(f"{self.name}: it would take {total:.1g} {self.what}, for the motion is stiff")


def explicit(model, t_end, rtol, t0=0.0, q0=None, v0=None, times=None, legs=1, limited=False):
    """[(q, v, a, lam)] just before increasing `times` (default: t_end) by DOP853 on (q, v)' = (v, a), with a from the index-1 equations.

    Integration restarts at the kinks of loads and motors. legs: equal parts of the time, after which q and v are projected onto the
    constraints. limited: raise TooStiff for long runs.
    """
    from scipy.integrate import solve_ivp

    model, end_times, states = guard(model), np.atleast_1d(t_end if times is None else times), []
    state = consistent_state(model, t0, q0, v0)
    n, y, t = model.n, np.concatenate([state.q, state.v]), t0
    projections = np.linspace(t0, end_times[-1], legs + 1)[1:-1]
    count = WorkLimit("DOP853", "evaluations", MAX_EVALUATIONS / (n + SMALL_MODEL) if limited else np.inf, end_times[-1], t0)

    def rate(t, y):
        """`(q, v)' = (v, a)`, (2n,), at y = (q, v), with a from the index-1 equations."""
        count(t)
        return np.concatenate([y[n:], consistent_acceleration(model, t, y[:n], y[n:])[0]])

    with one_blas_thread():
        for end in sorted({*model.kinks(t0, end_times[-1]), *projections, end_times[-1]}):
            within = end_times[(end_times > t) & (end_times <= end) | (end_times == t0) & (t == t0)]
            at, options = np.union1d(within, [end]), {"rtol": rtol, "atol": rtol * 1e-3, "first_step": min(1e-6, end - t)}
            run = solve_ivp(rate, (t, end), y, method="DOP853", t_eval=at, **options)
            if not run.success:
                raise RuntimeError(f"DOP853: {run.message}")
            known = dict(zip(at, run.y.T))
            states += [
                (known[s][:n], known[s][n:], *consistent_acceleration(model, np.nextafter(s, t0), known[s][:n], known[s][n:]))
                for s in within
            ]
            y, t = run.y[:, -1], end
            if end in projections:
                state = restarted(model, SimpleNamespace(t=end, q=y[:n], v=y[n:]))
                y = np.concatenate([state.q, state.v])
    return states


def by_explicit(model, t_end, rtol, q0=None, v0=None, limited=False, quantity=None):
    """{part: value} at t_end by `explicit`, or those of a Quantity."""
    times = quantity.times if quantity else None
    states = explicit(model, t_end, rtol, q0=q0, v0=v0, times=times, legs=LEGS, limited=limited)
    if quantity:
        return quantity.of_run(Trajectory(model, "DOP853", times, *map(np.array, zip(*states))))
    q, v, _, lam = states[0]
    return values_of(guard(model), q, v, lam)


def by_radau(model, t_end, rtol, q0=None, v0=None, quantity=None):
    """{part: value} at t_end by Radau IIA of order 5 with error control. Raises RuntimeError if the run fails."""
    return end_state(model, t_end, RadauIIA(rtol=rtol), q0, v0, quantity=quantity)


def extrapolated(model, t_end, method, h, q0=None, v0=None, quantity=None):
    """{part: value} at t_end by `(4 y(h/2) - y(h)) / 3` of a method of order 2. Raises RuntimeError if a run fails."""
    coarse, fine = (end_state(model, t_end, method(h=step), q0, v0, quantity=quantity) for step in (h, h / 2))
    return {part: (4 * fine[part] - value) / 3 for part, value in coarse.items()}


def end_state(model, t_end, integrator, q0=None, v0=None, progress=None, quantity=None):
    """{part: value} at t_end by an integrator, or those of a Quantity. Raises RuntimeError if the run fails."""
    if quantity:
        return quantity.of_run(_consistent(_full_run(model, t_end, integrator, q0, v0, progress, output=quantity.times)))
    return end_of(_full_run(model, t_end, integrator, q0, v0, progress, every=10**9))


def _full_run(model, t_end, integrator, q0=None, v0=None, progress=None, **frames):
    """The Trajectory from (q0, v0) to t_end with these frames. Raises RuntimeError if the run fails, KeyboardInterrupt after Ctrl-C."""
    run = solve(model, t_end, integrator, q0=q0, v0=v0, progress=progress, **frames)
    if run.status == "interrupted":
        raise KeyboardInterrupt
    if not run.success:
        raise RuntimeError(f"reference by {integrator}: {run.message}")
    return run


def _consistent(run):
    """A copy of a run whose a and lam are computed from the equations of motion at t, q and v of each frame but the last.

    The run's own are only linear over a step in frames within steps. The equations are evaluated just before the time of the frame, for
    steps end where loads jump. The last frame keeps the run's own.
    """
    model, a, lam = guard(run.model), np.array(run.a), np.array(run.lam)
    for k in range(len(run) - 1):
        a[k], lam[k] = consistent_acceleration(model, np.nextafter(run.t[k], -np.inf), run.q[k], run.v[k])
    return replace(run, a=a, lam=lam)


def end_of(run):
    """{part: value} of the motion, such as q, v and lam, at the end of a run."""
    return values_of(guard(run.model), run.q[-1], run.v[-1], run.lam[-1])


def distance(one, other):
    """{part: largest absolute difference} of the parts that both have."""
    return {part: float(np.abs(one[part] - other[part]).max(initial=0.0)) for part in one if part in other}


SAMPLES, SAMPLES_PER_STEP = 4000, 2  # times of a run, and at least of each step, at which forces are sampled
DEVIATION = 1e-3  # of the largest force: deviation from the cubic of a step that missed a pulse
IMPULSE_SAMPLES = 400  # times of such a step at which the impulse is integrated
STAGES = np.array([0.0, 0.4 - np.sqrt(0.06), 0.4 + np.sqrt(0.06), 1.0])
WEIGHTS = np.array([0.0, (16 - np.sqrt(6)) / 36, (16 + np.sqrt(6)) / 36, 1 / 9])
CUBIC = np.linalg.inv(np.vander(STAGES, increasing=True))


def has_known_discontinuities(model):
    """True if all discontinuities of the forces are announced: all own force elements give gaps, or an own model does."""
    return all(force.switches for force in model.own_forces) if model.is_scene else model.switching


def missed_impulse(run):
    """{part: possible error at the end from pulses between the stages}; all steps of the run must be frames."""
    model = guard(run.model)
    error = dict.fromkeys(values_of(model, run.q[-1], run.v[-1], run.lam[-1]), 0.0)
    steps = [_StepForces(model, run, k) for k in range(len(run) - 1) if run.t[k + 1] > run.t[k]]
    sampled = [(step, *step.deviation(max(SAMPLES_PER_STEP, int(np.ceil(SAMPLES * step.h / (run.t[-1] - run.t[0])))))) for step in steps]
    largest_force = max((size for _, size, _ in sampled), default=0.0)
    fastest = max(np.abs(run.v).max(initial=0.0), 1e-300)
    for step, _, deviation in sampled:
        if deviation > DEVIATION * largest_force:
            change, mu = step.impulse()
            values = values_of(model, change, change, mu)
            dv = float(np.abs(values["v"]).max(initial=0.0))
            error["v"] += dv
            error["q"] += dv * max(step.h, run.t[-1] - step.t)
            error["lam"] += max(float(np.abs(mu).max(initial=0.0)) / step.h, np.abs(run.lam[-1]).max(initial=0.0) * dv / fastest)
            if model.k:
                error["x"] += float(np.abs(values["x"]).max())
    return error


class _StepForces:
    """The forces of step k of a run as a function of s in [0, 1], on the quintic through q, v and a of both ends."""

    def __init__(self, model, run, k):
        """Take the states at both ends of step k of a run."""
        self.model = model
        self.t = float(run.t[k])
        self.h = float(run.t[k + 1] - run.t[k])
        self.ends = np.array([[x[i] for x in (run.q, run.v, run.a)] for i in (k, k + 1)], float)  # q, v and a at both ends
        self.seed = k

    def deviation(self, count):
        """(largest force, largest deviation from the cubic), at a random time in each of `count` parts."""
        s = (np.arange(count) + np.random.default_rng(self.seed).random(count)) / count
        coefficients = CUBIC @ self.forces(STAGES)
        values = self.forces(s)
        deviation = np.abs(values - np.vander(s, 4, increasing=True) @ coefficients)
        return max(float(np.abs(x).max(initial=0.0)) for x in (values, coefficients)), float(deviation.max(initial=0.0))

    def impulse(self):
        """(dv (n,), mu (m,)): jumps of velocities and multipliers by the impulse that the step's quadrature has missed."""
        s = np.linspace(0.0, 1.0, IMPULSE_SAMPLES + 1)
        J = self.h * (np.trapezoid(self.forces(s), s, axis=0) - WEIGHTS @ self.forces(STAGES))
        q = self.ends[1, 0]
        try:
            return KKT(self.model.mass(q), self.model.phi_q(self.t + self.h, q), 1.0).solve(J, np.zeros(self.model.m))
        except SingularSystem:
            return np.full(self.model.n, np.inf), np.full(self.model.m, np.inf)

    def forces(self, points):
        """g of the forces without announced discontinuities at s = points (k,), (k, n)."""
        from scipy.interpolate import BPoly

        quintic = BPoly.from_derivatives([0.0, self.h], self.ends)
        forces, states = np.zeros((len(points), self.model.n)), (quintic(points * self.h), quintic.derivative()(points * self.h))
        for row, s, q, v in zip(forces, points.tolist(), *states):
            if self.model.is_scene:
                take_from(row, self.model.own_forces, self.t + s * self.h, q, v)
            else:
                row[:] = self.model.force(self.t + s * self.h, q, v)
        return forces


RADAU_RTOL = (1e-7, 1e-9, 1e-11, 1e-13)  # of each level
LOW_ORDER_RTOL = (1e-8, 1e-9, 1e-11, 1e-12)  # of Radau IIA of order 3, whose error is larger at equal rtol
EXPLICIT_RTOL = (1e-9, 1e-11, 1e-13, 2.3e-14)  # finer than Radau's: two methods with errors of one size sometimes agree by chance
BDF_RTOL = (1e-7, 1e-8, 1e-10, 1e-12)
FINEST = 3
FIRST_WITH_PULSES = 1  # first level where forces may have pulses: longer steps miss them more often, and a missed impulse is an estimate
LOOSE_RTOL, LOOSE_LEVEL = 1e-5, -1  # of a Radau run before the first level
GROWTH = 2.2  # of the cost of Radau IIA from a level to the next: rtol / 100 at order 5
REMAINING = 0.1  # remaining error after rtol / 100, relative to the change: holds also if the error falls only as the root of rtol
WANTED_ACCURACY = 0.1  # of the smallest measured error
REQUIRED_ACCURACY = 1.0  # of the smallest measured error; otherwise the next family is tried
ROUND_OFF = 1e-14  # relative: round-off that two methods may share
SUFFICIENT = 1e-12  # relative: two methods need not agree better
IMPROVEMENT = 0.5  # a level must reduce the distance by this factor, otherwise refinement ends
EXTRAPOLATION_STEPS = (250, 500, 2000, 8000)  # of each level


def _end_state(ivp, integrator, progress=None):
    """{part: value} at the end of a run of the problem with an integrator, from its initial state."""
    return end_state(ivp.model, ivp.t_end, integrator, ivp.q0, ivp.v0, progress, ivp.quantity)


def _by_low_order_at(ivp, level):
    """(name of the method, {part: value} at t_end) by Radau IIA of order 3 with the tolerance of a level of refinement."""
    rtol = LOW_ORDER_RTOL[level]
    return f"Radau IIA of order 3, rtol {rtol:g}", _end_state(ivp, RadauIIA(rtol=rtol, stages=2))


def _by_explicit_at(ivp, level):
    """(name of the method, {part: value} at t_end) by DOP853 with the tolerance of a level of refinement."""
    rtol = EXPLICIT_RTOL[level]
    values = by_explicit(ivp.model, ivp.t_end, rtol, ivp.q0, ivp.v0, limited=True, quantity=ivp.quantity)
    return f"DOP853 on the index-1 equations, rtol {rtol:g}", values


def _by_bdf_at(ivp, level):
    """(name of the method, {part: value} at t_end) by IDA with the tolerance of a level. Raises TooStiff after too many steps."""
    rtol, limit = BDF_RTOL[level], WorkLimit("IDA", "steps", MAX_BDF_STEPS, ivp.t_end)
    integrator = IDA(rtol=rtol, max_num_steps=2 * MAX_BDF_STEPS)
    return f"IDA (BDF), rtol {rtol:g}", _end_state(ivp, integrator, limit)


def _extrapolated_at(ivp, level, name, method):
    """(description, {part: value at the end}) of a method of order 2 with the steps of a level, extrapolated to h = 0."""
    if ivp.model.switching:  # steps end at the switches, so that the error is no power of h
        raise RuntimeError(f"{name} cannot be extrapolated: its steps end where forces of the model switch")
    h = ivp.t_end / EXTRAPOLATION_STEPS[level]
    values = extrapolated(ivp.model, ivp.t_end, method, h, ivp.q0, ivp.v0, ivp.quantity)
    return f"{name}, h = {h:g} s and half of it, extrapolated", values


BY_LOW_ORDER, BY_EXPLICIT, BY_BDF = _by_low_order_at, _by_explicit_at, _by_bdf_at
BY_ENERGY_MOMENTUM = partial(_extrapolated_at, name="energy-momentum", method=EnergyMomentum)
BY_ALPHA = partial(_extrapolated_at, name="generalized-alpha", method=partial(GeneralizedAlpha, tolerance=1e-11))
OTHER_METHODS = (BY_LOW_ORDER, BY_EXPLICIT, BY_ENERGY_MOMENTUM, BY_ALPHA, BY_BDF)
WHERE_PULSES = (BY_EXPLICIT, BY_LOW_ORDER, BY_ENERGY_MOMENTUM, BY_ALPHA, BY_BDF)  # both orders of Radau IIA step over the same pulse


def _by_radau_at(ivp, level):
    """(description, {part: value at the end}, {part: possible error from missed pulses})."""
    rtol = LOOSE_RTOL if level == LOOSE_LEVEL else RADAU_RTOL[level]
    name, motion = f"Radau IIA, rtol {rtol:g}", (ivp.model, ivp.t_end)
    if level == LOOSE_LEVEL or has_known_discontinuities(ivp.model):
        return name, by_radau(*motion, rtol, ivp.q0, ivp.v0, ivp.quantity), {}
    run = _full_run(*motion, RadauIIA(rtol=rtol), ivp.q0, ivp.v0)
    missed = missed_impulse(run)
    if ivp.quantity is None:
        return name, end_of(run), missed
    unknown = missed["q"] if ivp.quantity.lengths else np.inf if any(missed.values()) else 0.0  # of a user's function of the motion
    return name, _end_state(ivp, RadauIIA(rtol=rtol)), {part: missed.get(part, unknown) for part in ivp.parts}


class Ends:
    """The ends of reference runs of an InitialValueProblem, each computed once. kept: KeptEnds, or None. spent: CPU seconds of those computed here.

    progress(text): told what begins, and what it will take as far as this is known.
    """

    def __init__(self, ivp, kept=None, progress=lambda text: None):
        """Begin without runs of this study; ends that are kept are taken when they are asked for."""
        self.ivp = ivp
        self.kept = {} if kept is None else kept
        self.progress = progress
        self.spent = 0.0
        self.failed = []  # messages of runs that failed

    def radau(self, level):
        """The End of the reference run by Radau IIA at a level of accuracy; its values are empty if the run failed."""
        return self._end(f"radau {level}", _by_radau_at, level, self._forecast(level))

    def other(self, method, level):
        """The End of the reference run by the function `method` at a level of accuracy; its values are empty if the run failed."""
        known = getattr(method, "keywords", {}).get("name") or method.__name__
        return self._end(f"{known} {level}" if method in OTHER_METHODS else "", method, level, self._forecast(level))

    def _forecast(self, level):
        """CPU seconds of a run at a level, from that of Radau IIA at the level before; None if unknown."""
        before = self.kept.get(f"radau {level}") or self.kept.get(f"radau {level - 1}")
        return before.seconds * GROWTH if before and before.seconds else None

    def _end(self, name, method, level, seconds):
        """The End of the run by `method` at a level: the kept one of this name, or computed now and kept.

        name: empty for a run that is not kept. seconds: forecast of CPU time, for the text of progress, or None.
        """
        end = self.kept.get(name) if name else None
        if end is None:
            self.progress(f"reference, level {level - LOOSE_LEVEL}" + (f", about {seconds:.2g} CPU s" if seconds else ""))
            end = self._computed(method, level)
            if name:
                self.kept[name] = end
        if end.failed and end.failed not in self.failed:
            self.failed.append(end.failed)
        return end

    def _computed(self, method, level):
        """The End of a run by a method at a level; every exception but Ctrl-C becomes its `failed`."""
        begun = time.process_time()
        try:
            end = End(*method(self.ivp, level))
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # noqa: BLE001, a user's functions may raise anything; the measured rows must survive
            end = End(failed=str(error) or type(error).__name__)
        end.seconds = time.process_time() - begun
        self.spent += end.seconds
        return end


def make_reference(ivp, smallest_errors=lambda values: {}, progress=lambda text: None, others=None, first=0, kept=None):
    """The reference {"q", "v", "lam" and "x" of a model with states, "made_by": [two methods], "known_to": {part: accuracy}, "failed": [messages],
    "cpu_s": seconds spent on it}.

    "sampling", s, is the time between two samples of forces without announced discontinuities. smallest_errors(values): {part: smallest
    measured error above zero against these values}; the accuracy is to be a tenth of it, or 1e-12 relative. others: methods beside Radau
    IIA of order 5 in the order of trial; None: OTHER_METHODS, or WHERE_PULSES if discontinuities of forces may be unknown. first: first level of refinement. kept: KeptEnds of runs of other studies. Without two methods that
    reach the end there are no values and no accuracy.
    """
    ends, best = Ends(ivp, kept, progress), {}
    known = has_known_discontinuities(ivp.model)
    others = others or (OTHER_METHODS if known else WHERE_PULSES)
    first = first if known else max(first, FIRST_WITH_PULSES)
    for method in others:
        pair = _refine(ends, method, range(first, len(RADAU_RTOL)), smallest_errors)
        best = pair if pair and (not best or _relative_distance(pair, best) < 1) else best
        missed = best and any(best["missed"].values())  # no other method improves these values
        if best and (missed or not _inaccurate(best, smallest_errors, REQUIRED_ACCURACY)):
            break
    best = {name: value for name, value in best.items() if name != "missed"}
    sampling = {} if known or not best else {"sampling": ivp.t_end / SAMPLES}
    return best | sampling | {"failed": ends.failed, "cpu_s": ends.spent}


def _refine(ends, method, levels, smallest_errors):
    """The best pair of Radau IIA and another method over the levels; {} if one of them fails."""
    best = {}
    for level in levels:
        radau = ends.radau(level)
        if not radau.values:
            return best
        least = {part: max(ROUND_OFF * _size(radau.values[part]), far) for part, far in _remaining(ends, level).items()}
        if not best and level < levels[-1] and not any(radau.missed.values()) and _changing(radau.values, least, smallest_errors):
            continue  # the next level is more accurate than this one, whatever another method says of it
        other = ends.other(method, level)
        if not other.values:
            return best
        apart = _apart(ends.ivp, radau.values, other.values)
        known = {part: max(least[part], far) + radau.missed.get(part, 0.0) for part, far in apart.items()}
        inaccurate = _inaccurate(best, smallest_errors) if best else known
        improved = not best or any(known[part] < IMPROVEMENT * best["known_to"][part] for part in inaccurate)
        if better := [part for part in known if not best or known[part] < best["known_to"][part]]:
            known_to = best.get("known_to", {}) | {part: known[part] for part in better}
            made_by = [radau.method, other.method]
            best = best | {part: radau.values[part] for part in better} | {"made_by": made_by, "known_to": known_to, "missed": radau.missed}
        if not improved or not _inaccurate(best, smallest_errors):
            break
    return best


def _remaining(ends, level):
    """{part: estimated error of Radau IIA} from the level before: two methods may have equal errors, mainly behind kinks."""
    values = ends.radau(level).values
    known = ends.kept.get(f"radau {level - 1}")
    before = ends.radau(level - 1).values if level <= FIRST_WITH_PULSES else known.values if known else {}
    if not before:  # a failed loose run gives no estimate
        return dict.fromkeys(values, 0.0)
    return {part: REMAINING * far for part, far in _apart(ends.ivp, before, values).items()}


def _apart(ivp, one, other):
    """{part: difference of two ends in the norm of the study}."""
    return ivp.quantity.distance(one, other) if ivp.quantity else distance(one, other)


def _changing(values, remaining, smallest_errors):
    """True if Radau IIA alone is known not to be accurate enough for a part of which an error was measured."""
    measured = {part for part, error in smallest_errors(values).items() if error > 0}
    return not measured.isdisjoint(_inaccurate({"known_to": remaining} | values, smallest_errors))


def _size(values):
    """Largest absolute value of an array; 0 if it is empty."""
    return np.abs(values).max(initial=0.0)


def _relative_distance(pair, other):
    """Accuracy of a pair relative to another one, of the worst part; parts at round-off count as equal."""
    sizes = {part: SUFFICIENT * max(1e-300, _size(pair[part])) for part in pair["known_to"]}
    return max(max(pair["known_to"][part], sizes[part]) / max(other["known_to"][part], sizes[part]) for part in sizes)


def _inaccurate(pair, smallest_errors, share=WANTED_ACCURACY):
    """The parts whose accuracy is worse than this share of the smallest error."""
    smallest = smallest_errors(pair)
    return [
        part for part, known in pair["known_to"].items() if known > max(share * smallest.get(part, 0.0), SUFFICIENT * _size(pair[part]))
    ]


def user_reference(study, ivp, reference):
    """The reference of a user: {"q", "v", "lam"} at t_end, of a model with states also "x", with optional "made_by" and "known_to", or a run or state at t_end.

    Raises InputError for another form, time or shape.
    """
    if ivp.quantity:
        raise InputError(f"{study}: reference = {type(reference).__name__} has no place beside of= or norm=, whose reference is made here")
    if not isinstance(reference, dict):
        state = getattr(reference, "state", reference)
        if not all(hasattr(state, part) for part in ("t", *PARTS)):
            expected = "must be a dictionary of q, v and lam, a run, a State, or None"
            raise InputError(f"{study}: reference = {type(reference).__name__} {expected}")
        if abs(state.t - ivp.t_end) > 1e-9 * ivp.t_end:
            raise InputError(f"{study}: the reference ends at t = {state.t:g} s, the study at t_end = {ivp.t_end:g} s")
        reference = {part: getattr(state, part) for part in PARTS} | {"made_by": [repr(getattr(reference, "integrator", "a state"))]}
    model, result = guard(ivp.model), dict(reference)
    if model.k and "x" not in result and np.shape(result.get("v")) == (model.n,):
        result |= {"x": model.states_of(np.asarray(result["v"], float))}
    for part, size in zip(ivp.parts, (model.n, model.n, model.m, model.k)):
        value = np.asarray(result.get(part, np.nan), float)
        own = size - len(model.hidden) * (part in "qv")  # a user may leave out what is behind the coordinates of the model
        if value.shape not in ((size,), (own,)) or not np.isfinite(value).all():
            raise InputError(f"{study}: reference[{part!r}] must be {own} finite numbers, at t = {ivp.t_end:g} s")
        result[part] = np.append(value, np.zeros(size - len(value)))
    if model.k:
        result |= {part: model.without_states(result[part]) for part in ("q", "v")}
    made_by, known = result.get("made_by", "the user's values"), result.get("known_to", {})
    if not isinstance(known, dict):
        raise InputError(f"{study}: reference['known_to'] = {known!r} must be a dictionary {{'q': ..., 'v': ..., 'lam': ...}}")
    for part, value in known.items():
        if part in ivp.parts and not (is_number(value) and value >= 0):
            raise InputError(f"{study}: reference['known_to'][{part!r}] = {value!r} must be a number of at least 0")
    return result | {"made_by": [made_by] if isinstance(made_by, str) else list(made_by), "known_to": dict(known), "failed": []}
