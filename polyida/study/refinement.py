"""References: the end of a motion by two methods, refined until they agree.

A reference holds the values of Radau IIA of order 5; its accuracy is the distance to another method and what a finer run still changes. The
other method is the first of these that reaches the end and comes near enough: Radau IIA of order 3, which takes other steps at about the same
cost, DOP853 on the index-1 equations, the energy-momentum method and generalized-alpha with extrapolation, and BDF (IDA), mostly the
dearest. Runs begin with a loose tolerance; the tolerance is reduced until the accuracy is a tenth of the smallest measured error, or as long
as this improves the accuracy. Another method is asked only where Radau IIA itself no longer changes by more than that. Pulses that both
methods may have missed are added (study/missed_pulses.py).
"""

import time
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from polyida.errors import InputError
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.energy.energy_momentum import EnergyMomentum
from polyida.integrate.ida.integrator import IDA
from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.model.guarded import guard
from polyida.study.ivp import PARTS
from polyida.study.kept import End
from polyida.study.missed_pulses import SAMPLES, has_known_discontinuities, missed_impulse
from polyida.study.references import WorkLimit, by_explicit, by_radau, distance, end_of, end_state, extrapolated, full_run
from polyida.validation import is_number

RADAU_RTOL = (1e-7, 1e-9, 1e-11, 1e-13)  # of each level
LOW_ORDER_RTOL = (1e-8, 1e-9, 1e-11, 1e-12)  # of Radau IIA of order 3, whose error is larger at equal rtol
EXPLICIT_RTOL = (1e-9, 1e-11, 1e-13, 2.3e-14)  # finer than Radau's: two methods with errors of one size sometimes agree by chance
BDF_RTOL = (1e-7, 1e-8, 1e-10, 1e-12)
MAX_BDF_STEPS = 300_000
EXTRAPOLATION_STEPS = (250, 500, 2000, 8000)  # of each level
LOOSE_RTOL, LOOSE_LEVEL = 1e-5, -1  # of a Radau run before the first level
FIRST_WITH_PULSES = 1  # first level where forces may have pulses: longer steps miss them more often, and a missed impulse is an estimate


def _end_state(ivp, integrator, progress=None):
    return end_state(ivp.model, ivp.t_end, integrator, ivp.q0, ivp.v0, progress, ivp.quantity)


def _by_low_order_at(ivp, level):
    """Return (description, {part: value at t_end}) of Radau IIA of order 3 at the tolerance of a level."""
    rtol = LOW_ORDER_RTOL[level]
    return f"Radau IIA of order 3, rtol {rtol:g}", _end_state(ivp, RadauIIA(rtol=rtol, stages=2))


def _by_explicit_at(ivp, level):
    """Return (description, {part: value at t_end}) of DOP853 at the tolerance of a level. Raises TooStiff for long runs."""
    rtol = EXPLICIT_RTOL[level]
    values = by_explicit(ivp.model, ivp.t_end, rtol, ivp.q0, ivp.v0, limited=True, quantity=ivp.quantity)
    return f"DOP853 on the index-1 equations, rtol {rtol:g}", values


def _by_bdf_at(ivp, level):
    """Return (description, {part: value at t_end}) of IDA at the tolerance of a level. Raises TooStiff if it would take too many steps."""
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


# Other methods, functions (ivp, level) -> (description, {part: value at t_end}); kept ends have the names of these functions.
BY_LOW_ORDER = _by_low_order_at
BY_EXPLICIT = _by_explicit_at
BY_BDF = _by_bdf_at
BY_ENERGY_MOMENTUM = partial(_extrapolated_at, name="energy-momentum", method=EnergyMomentum)
BY_ALPHA = partial(_extrapolated_at, name="generalized-alpha", method=partial(GeneralizedAlpha, tolerance=1e-11))
OTHER_METHODS = (BY_LOW_ORDER, BY_EXPLICIT, BY_ENERGY_MOMENTUM, BY_ALPHA, BY_BDF)
WHERE_PULSES = (BY_EXPLICIT, BY_LOW_ORDER, BY_ENERGY_MOMENTUM, BY_ALPHA, BY_BDF)  # both orders of Radau IIA step over the same pulse


def _by_radau_at(ivp, level):
    """Return (description, {part: value at t_end}, {part: possible error from missed pulses}) of Radau IIA at the tolerance of a level."""
    rtol = LOOSE_RTOL if level == LOOSE_LEVEL else RADAU_RTOL[level]
    name, motion = f"Radau IIA, rtol {rtol:g}", (ivp.model, ivp.t_end)
    if level == LOOSE_LEVEL or has_known_discontinuities(ivp.model):
        return name, by_radau(*motion, rtol, ivp.q0, ivp.v0, ivp.quantity), {}
    run = full_run(*motion, RadauIIA(rtol=rtol), ivp.q0, ivp.v0)
    missed = missed_impulse(run)
    if ivp.quantity is None:
        return name, end_of(run), missed
    unknown = missed["q"] if ivp.quantity.lengths else np.inf if any(missed.values()) else 0.0  # of a user's function of the motion
    return name, _end_state(ivp, RadauIIA(rtol=rtol)), {part: missed.get(part, unknown) for part in ivp.parts}


GROWTH = 2.2  # of the cost of Radau IIA from a level to the next: rtol / 100 at order 5


class Ends:
    """The ends of reference runs of an InitialValueProblem, each computed once.

    kept: KeptEnds, or None. spent: CPU seconds of those computed here. progress(text): told what begins, and what it will take as far as this
    is known.
    """

    def __init__(self, ivp, kept=None, progress=lambda text: None):
        """Begin without runs of this study; ends that are kept are taken when they are asked for."""
        self.ivp = ivp
        self.kept = {} if kept is None else kept
        self.progress = progress
        self.spent = 0.0
        self.failed = []  # messages of runs that failed

    def radau(self, level):
        """The End of Radau IIA at a level; values is empty if it failed."""
        return self._end(f"radau {level}", _by_radau_at, level, self._forecast(level))

    def other(self, method, level):
        """The End of another method; values is empty if it failed."""
        known = getattr(method, "keywords", {}).get("name") or method.__name__
        return self._end(f"{known} {level}" if method in OTHER_METHODS else "", method, level, self._forecast(level))

    def _forecast(self, level):
        """CPU seconds of a run at a level, from that of Radau IIA at the level before; None if unknown."""
        before = self.kept.get(f"radau {level}") or self.kept.get(f"radau {level - 1}")
        return before.seconds * GROWTH if before and before.seconds else None

    def _end(self, name, method, level, seconds):
        """The End of a run. name: empty for a method that is not kept."""
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


WANTED_ACCURACY = 0.1  # of the smallest measured error
REQUIRED_ACCURACY = 1.0  # of the smallest measured error; otherwise the next method is tried
REMAINING_ERROR = 0.1  # after rtol / 100, relative to the change: holds also if the error falls only as the root of rtol
ROUND_OFF = 1e-14  # relative: round-off that two methods may share
SUFFICIENT = 1e-12  # relative: two methods need not agree better
IMPROVEMENT = 0.5  # a level must reduce the distance by this factor, otherwise refinement ends


@dataclass
class Pair:
    """What Radau IIA and another method agree on; each part is that of the level at which it is known best."""

    values: dict = field(default_factory=dict)  # {part: value at t_end of Radau IIA}
    known_to: dict = field(default_factory=dict)  # {part: accuracy}
    made_by: list = field(default_factory=list)  # the two methods, in words
    missed: dict = field(default_factory=dict)  # {part: possible error from pulses between the stages}


def make_reference(ivp, smallest_errors=lambda values: {}, progress=lambda text: None, others=None, first=0, kept=None):
    """Make the reference of an InitialValueProblem, the end of its motion by two methods.

    Parameters
    ----------
    ivp : InitialValueProblem
    smallest_errors : function
        smallest_errors(values) is {part: smallest measured error above zero against these values}. The accuracy is to be a tenth of it, or
        1e-12 relative.
    progress : function
        progress(text) is told what begins.
    others : sequence of functions, optional
        Methods beside Radau IIA of order 5 in the order of trial: by default OTHER_METHODS, or WHERE_PULSES if discontinuities of forces may
        be unknown.
    first : int
        First level of refinement.
    kept : KeptEnds, optional
        Runs of other studies.

    Returns
    -------
    dict
        {"q", "v", "lam", and "x" of a model with states: values at t_end, "made_by": [two methods], "known_to": {part: accuracy}, "failed":
        [messages], "cpu_s": seconds spent on it}. "sampling", s, is the time between two samples of forces without announced
        discontinuities. Without two methods that reach the end there are no values and no accuracy.
    """
    ends, best = Ends(ivp, kept, progress), None
    known = has_known_discontinuities(ivp.model)
    others = others or (OTHER_METHODS if known else WHERE_PULSES)
    first = first if known else max(first, FIRST_WITH_PULSES)
    for method in others:
        pair = _refine(ends, method, range(first, len(RADAU_RTOL)), smallest_errors)
        if pair and (not best or _relative_distance(pair, best) < 1):
            best = pair
        missed = best and any(best.missed.values())  # no other method improves these values
        if best and (missed or not _inaccurate(best, smallest_errors, REQUIRED_ACCURACY)):
            break
    found = best.values | {"made_by": best.made_by, "known_to": best.known_to} if best else {}
    if best and not known:
        found["sampling"] = ivp.t_end / SAMPLES
    return found | {"failed": ends.failed, "cpu_s": ends.spent}


def _refine(ends, method, levels, smallest_errors):
    """The best Pair of Radau IIA and another method over the levels; None if one of them fails at the first.

    For each level: 1. Radau's end. 2. Its error, estimated from the level before. 3. If that is too large for a measured error, the next
    level. 4. The other method's end. 5. The accuracy of each part, max(error of 2., distance of the two) + missed pulses. 6. The parts that
    improved are taken. 7. End if all are accurate, or if no inaccurate part improved by the factor IMPROVEMENT.
    """
    best = None
    for level in levels:
        radau = ends.radau(level)  # 1
        if not radau.values:
            return best
        remaining = _remaining(ends, level)  # 2
        own_error = {part: max(ROUND_OFF * _size(radau.values[part]), error) for part, error in remaining.items()}
        if not best and level < levels[-1] and not any(radau.missed.values()) and _changing(radau.values, own_error, smallest_errors):
            continue  # 3: the next level is more accurate than this one, whatever another method says of it
        other = ends.other(method, level)  # 4
        if not other.values:
            return best
        distances = _distances(ends.ivp, radau.values, other.values)  # 5
        accuracy = {part: max(own_error[part], apart) + radau.missed.get(part, 0.0) for part, apart in distances.items()}
        if best:
            improved = any(accuracy[part] < IMPROVEMENT * best.known_to[part] for part in _inaccurate(best, smallest_errors))
            better = [part for part in accuracy if accuracy[part] < best.known_to[part]]
        else:
            best, improved, better = Pair(), True, list(accuracy)
        if better:  # 6
            best.values |= {part: radau.values[part] for part in better}
            best.known_to |= {part: accuracy[part] for part in better}
            best.made_by = [radau.method, other.method]
            best.missed = radau.missed
        if not improved or not _inaccurate(best, smallest_errors):  # 7
            break
    return best


def _remaining(ends, level):
    """{part: estimated error of Radau IIA} from the level before: two methods may have equal errors, mainly behind kinks."""
    values = ends.radau(level).values
    if level <= FIRST_WITH_PULSES:  # the level before is computed only for the first levels; further up only a known one is used
        before = ends.radau(level - 1).values
    else:
        known = ends.kept.get(f"radau {level - 1}")
        before = known.values if known else {}
    if not before:  # a failed loose run gives no estimate
        return dict.fromkeys(values, 0.0)
    return {part: REMAINING_ERROR * change for part, change in _distances(ends.ivp, before, values).items()}


def _distances(ivp, one, other):
    """{part: difference in the norm of the study}."""
    return ivp.quantity.distance(one, other) if ivp.quantity else distance(one, other)


def _changing(values, remaining, smallest_errors):
    """True if Radau IIA alone is known not to be accurate enough for a part of which an error was measured."""
    measured = {part for part, error in smallest_errors(values).items() if error > 0}
    return not measured.isdisjoint(_inaccurate(Pair(values, remaining), smallest_errors))


def _size(values):
    return np.abs(values).max(initial=0.0)


def _relative_distance(pair, other):
    """Accuracy of a pair relative to another one, of the worst part; parts at round-off count as equal."""
    sizes = {part: SUFFICIENT * max(1e-300, _size(pair.values[part])) for part in pair.known_to}
    return max(max(pair.known_to[part], sizes[part]) / max(other.known_to[part], sizes[part]) for part in sizes)


def _inaccurate(pair, smallest_errors, share=WANTED_ACCURACY):
    """The parts whose accuracy is worse than this share of the smallest error."""
    smallest = smallest_errors(pair.values)
    limits = {part: max(share * smallest.get(part, 0.0), SUFFICIENT * _size(pair.values[part])) for part in pair.known_to}
    return [part for part, accuracy in pair.known_to.items() if accuracy > limits[part]]


def user_reference(study, ivp, reference):
    """The reference of a user in the form that `make_reference` returns.

    reference: {"q", "v", "lam"} at t_end, of a model with states also "x", with optional "made_by" and "known_to"; or a run or state at t_end.
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
