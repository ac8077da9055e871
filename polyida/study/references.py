"""The end of a motion by two families of methods that agree, refined until they agree well enough for what is measured against it.

The values are those of Radau IIA; they are known as well as a method of another family agrees with them. A pair is refined until it is
known to a tenth of the smallest error that is measured, or as long as that brings the two nearer to each other. The other method is the
first that comes below that error: DOP853 on the index-1 equations, and BDF by IDA, where they do not take too many steps; the
energy-momentum method and generalized-alpha, extrapolated.

What the steps of a run did not see of forces that no kink announces is looked for between the steps:
a method sees a force at the stages of its steps alone. Here the forces are taken at many times of each step, on the quintic through q, v
and a of its ends. Where they leave the cubic through the values at the stages of Radau IIA, the impulse that a step missed is `J = int g dt
- h sum b_i g_i`, which changes v by that of `M dv + B^T mu = -J`, `B dv = 0`.
"""

from contextlib import suppress
from functools import partial

import numpy as np

from polyida.errors import InputError
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.energy.energy_momentum import EnergyMomentum
from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.linear.lu import SingularSystem
from polyida.linear.saddle import KKT
from polyida.model.guarded import guard
from polyida.study.families import PARTS, by_bdf, by_explicit, by_radau, distance, extrapolated, last_state, whole
from polyida.validation import is_number

TIMES = 4000  # of a run at which forces are looked at, or more
LEAST = 2  # of a step
AWAY = 1e-3  # of the largest force: what it leaves the cubic by in a step that did not see all of it
FINE = 400  # times of such a step at which the impulse is integrated
STAGES = np.array([0.0, 0.4 - np.sqrt(0.06), 0.4 + np.sqrt(0.06), 1.0])
WEIGHTS = np.array([0.0, (16 - np.sqrt(6)) / 36, (16 + np.sqrt(6)) / 36, 1 / 9])
CUBIC = np.linalg.inv(np.vander(STAGES, increasing=True))


def announces(model):
    """Whether all forces of a model are smooth between its kinks and switches, as far as is known: where all force elements give gaps, or an own
    model does."""
    return all(own.switches for own in model.own_forces.each) if model.is_scene else model.switching


def missed(run):
    """{"q", "v", "lam": by how much the end of a run, all of whose steps are frames, may be off by what its steps did not see}."""
    model, found = guard(run.model), {"q": 0.0, "v": 0.0, "lam": 0.0}
    steps = [_Step(model, run, k) for k in range(len(run) - 1) if run.t[k + 1] > run.t[k]]
    seen = [(step, *step.look(max(LEAST, int(np.ceil(TIMES * step.h / (run.t[-1] - run.t[0])))))) for step in steps]
    largest = max((size for _, size, _ in seen), default=0.0)
    fastest = max(np.abs(run.v).max(initial=0.0), 1e-300)
    for step, _, away in seen:
        if away > AWAY * largest:
            dv, mu = step.blow()
            found["v"] += dv
            found["q"] += dv * max(step.h, run.t[-1] - step.t)
            found["lam"] += max(mu / step.h, np.abs(run.lam[-1]).max(initial=0.0) * dv / fastest)
    return found


class _Step:
    """Step k of a run: its forces over s in [0, 1]."""

    def __init__(self, model, run, k):
        self.model, self.t, self.h = model, float(run.t[k]), float(run.t[k + 1] - run.t[k])
        self.ends = [np.array([x[k], x[k + 1]], float) for x in (run.q, run.v, run.a)]
        self.seed = k

    def look(self, count):
        """(size of the force, by how much it leaves the cubic), at a random time in each of `count` parts."""
        at = (np.arange(count) + np.random.default_rng(self.seed).random(count)) / count
        stages = CUBIC @ self.forces(STAGES)
        values = self.forces(at)
        away = np.abs(values - np.vander(at, 4, increasing=True) @ stages)
        return max(float(np.abs(x).max(initial=0.0)) for x in (values, stages)), float(away.max(initial=0.0))

    def blow(self):
        """(largest |dv|, largest |mu|) of the impulse that the step missed."""
        at = np.linspace(0.0, 1.0, FINE + 1)
        J = self.h * (np.trapezoid(self.forces(at), at, axis=0) - WEIGHTS @ self.forces(STAGES))
        q = self.ends[0][1]
        try:
            dv, mu = KKT(self.model.mass(q), self.model.phi_q(self.t + self.h, q), 1.0).solve(J, np.zeros(self.model.m))
        except SingularSystem:
            return np.inf, np.inf
        return float(np.abs(dv).max(initial=0.0)), float(np.abs(mu).max(initial=0.0))

    def forces(self, at):
        """g of what no kink announces at s = at (k,), (k, n)."""
        found = np.empty((len(at), self.model.n))
        for row, s in zip(found, at.tolist()):
            t, (q, v) = self.t + s * self.h, self._state(s)
            if self.model.is_scene:
                row[:] = 0.0
                self.model.own_forces.take_from(row, t, q, v)
            else:
                row[:] = self.model.force(t, q, v)
        return found

    def _state(self, s):
        """q and v of the quintic through q, v and a of both ends."""
        (q0, q1), (v0, v1), (a0, a1) = self.ends
        h = self.h
        c0, c1, c2 = (q1 - q0) / h**2 - v0 / h - a0 / 2, (v1 - v0) / h - a0, a1 - a0
        b3, b4, b5 = 10 * c0 - 4 * c1 + c2 / 2, -15 * c0 + 7 * c1 - c2, 6 * c0 - 3 * c1 + c2 / 2
        gain = s**2 * (a0 / 2 + s * (b3 + s * (b4 + s * b5)))
        rate = s * (a0 + s * (3 * b3 + s * (4 * b4 + s * 5 * b5)))
        return q0 + h * (s * v0 + h * gain), v0 + h * rate


RADAU = (1e-9, 1e-11, 1e-13)  # rtol, level by level
EXPLICIT = (1e-11, 1e-13, 2.3e-14)  # finer: two of one size err in one direction now and then, and would seem to agree
LOOSE, COARSE = 1e-7, -1  # rtol of a run before the first level, and its number
LEFT = 0.1  # of what a run moved by with an rtol a hundredth: what it may still be off by, where the error falls as the root of rtol
FINEST = 2
SHARE = 0.1  # of the smallest error that is measured: what a reference should be off by
BELOW = 1.0  # the same: more than that, and another family is asked
ROUND = 1e-14  # of a part's size: round-off of a run, which two that agree may share
ENOUGH = 1e-12  # of a part's size: nearer than that two methods need not come
BETTER = 0.5  # of the distance before: what a level must come to for the next to be tried
STEPS = (500, 2000, 8000)  # of extrapolated methods, level by level


def _explicit(subject, level):
    rtol = EXPLICIT[level]
    found = by_explicit(subject.model, subject.t_end, rtol, subject.q0, subject.v0, spare=True)
    return f"DOP853 on the index-1 equations, rtol {rtol:g}", found


def _bdf(subject, level):
    rtol = (1e-8, 1e-10, 1e-12)[level]
    return f"IDA (BDF), rtol {rtol:g}", by_bdf(subject.model, subject.t_end, rtol, subject.q0, subject.v0)


def _extrapolated(subject, level, name, method):
    if subject.model.switching:  # steps are cut there, and the error is no power of h
        raise RuntimeError(f"{name} cannot be extrapolated: its steps end where forces of the model switch")
    h = subject.t_end / STEPS[level]
    found = extrapolated(subject.model, subject.t_end, method, h, subject.q0, subject.v0)
    return f"{name}, h = {h:g} s and half of it, extrapolated", found


BY_EXPLICIT, BY_BDF = _explicit, _bdf
BY_ENERGY_MOMENTUM = partial(_extrapolated, name="energy-momentum", method=EnergyMomentum)
BY_ALPHA = partial(_extrapolated, name="generalized-alpha", method=partial(GeneralizedAlpha, tolerance=1e-11))
OTHERS = (BY_EXPLICIT, BY_BDF, BY_ENERGY_MOMENTUM, BY_ALPHA)


def _radau(subject, level):
    """(what it is, {part: value at the end}, {part: how far that may be off by what its steps did not see})."""
    made, motion = f"Radau IIA, rtol {RADAU[level]:g}", (subject.model, subject.t_end)
    if announces(subject.model):
        return made, by_radau(*motion, RADAU[level], subject.q0, subject.v0), {}
    run = whole(*motion, RadauIIA(rtol=RADAU[level]), subject.q0, subject.v0)
    return made, vars(last_state(run)), missed(run)


def agreed(subject, errors=lambda values: {}, tell=lambda what: None, others=OTHERS, first=0):
    """A reference {"q", "v", "lam", "made_by": [two methods], "known_to": {part: their distance}, "failed": [what did not come there]}.

    "looked_at", s, of a model with forces that no kink announces: from one time to the next at which these were looked at between the
    steps. errors(values): {part: the smallest error, above zero, that is measured against these values}; the reference is refined until it
    is known to a tenth of that, or to 1e-12 of the part's size, or as long as the two come nearer to each other. others: the families
    beside Radau IIA, in the order in which they are tried; first: the level to begin with. Without two that come there it has "failed"
    alone.
    """
    mine, failed, best = {}, [], {}
    for make in others:
        pair = _refined(subject, make, range(first, len(RADAU)), mine, failed, errors, tell)
        best = pair if pair and (not best or _off(pair, best) < 1) else best
        stepped_over = any(any(unseen.values()) for _, _, unseen in mine.values())  # no other family would make these values better known
        if best and (stepped_over or _enough(best, errors, BELOW)):
            break
    seen = {} if announces(subject.model) else {"looked_at": subject.t_end / TIMES}
    return best | (seen if best else {}) | {"failed": failed}


def _refined(subject, make, levels, mine, failed, errors, tell):
    """The best pair of Radau IIA and another family over the levels, {} where one of both does not come there."""
    best = {}
    for level in levels:
        try:
            tell(f"reference, level {level + 1}")
            if level not in mine:
                mine[level] = _radau(subject, level)
            other = make(subject, level)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # noqa: BLE001, whatever a user's functions answer where nobody led them: what was measured must come out
            failed.append(str(error) or type(error).__name__)
            return best
        made, values, unseen = mine[level]
        least = {part: max(ROUND * np.abs(values[part]).max(initial=0.0), far) for part, far in _left(subject, level, mine).items()}
        known = {part: max(least[part], far) + unseen.get(part, 0.0) for part, far in distance(values, other[1]).items()}
        pair, lacking = values | {"made_by": [made, other[0]], "known_to": known}, _lacking(best, errors) if best else PARTS
        nearer = not best or any(known[part] < BETTER * best["known_to"][part] for part in lacking)
        best = _better(best, pair)
        if not nearer or _enough(best, errors):
            break
    return best


def _left(subject, level, mine):
    """{part: what Radau IIA may still be off by, from how far the level before was}: two methods may err alike, behind kinks above all."""
    with suppress(Exception):  # a looser run that does not come there says nothing
        if level == 0 and COARSE not in mine:
            mine[COARSE] = ("", by_radau(subject.model, subject.t_end, LOOSE, subject.q0, subject.v0), {})
    before = mine.get(level - 1)
    return {part: LEFT * far for part, far in distance(before[1], mine[level][1]).items()} if before else dict.fromkeys(PARTS, 0.0)


def _better(best, pair):
    """The best pair with those parts of another one that are known better there."""
    parts = [part for part in PARTS if not best or pair["known_to"][part] < best["known_to"][part]]
    if not parts:
        return best
    known = best.get("known_to", {}) | {part: pair["known_to"][part] for part in parts}
    return best | {part: pair[part] for part in parts} | {"made_by": pair["made_by"], "known_to": known}


def _off(pair, other):
    """How much farther apart a pair is than another one, at the part where it is worst off of those that are not at round-off."""
    sizes = {part: ENOUGH * max(1e-300, np.abs(pair[part]).max(initial=0)) for part in PARTS}
    return max(max(pair["known_to"][part], sizes[part]) / max(other["known_to"][part], sizes[part]) for part in PARTS)


def _enough(pair, errors, share=SHARE):
    return not _lacking(pair, errors, share)


def _lacking(pair, errors, share=SHARE):
    """The parts that are not known well enough."""
    smallest = errors(pair)
    return [
        part
        for part, known in pair["known_to"].items()
        if known > max(share * smallest.get(part, 0.0), ENOUGH * np.abs(pair[part]).max(initial=0))
    ]


def given(study, subject, reference):
    """The reference that a user gives: {"q", "v", "lam"} at t_end, with "made_by" and "known_to" where these are known (as the
    `reference` of another study is), or a run or state there. Raises InputError for another form, time or shape.
    """
    if not isinstance(reference, dict):
        state = getattr(reference, "state", reference)
        if not all(hasattr(state, part) for part in ("t", *PARTS)):
            wanted = "must be a dictionary of q, v and lam, a run, a State, or None"
            raise InputError(f"{study}: reference = {type(reference).__name__} {wanted}")
        if abs(state.t - subject.t_end) > 1e-9 * subject.t_end:
            raise InputError(f"{study}: the reference ends at t = {state.t:g} s, the study at t_end = {subject.t_end:g} s")
        reference = {part: getattr(state, part) for part in PARTS} | {"made_by": [repr(getattr(reference, "integrator", "a state"))]}
    n, m = subject.model.n, subject.model.m
    found = dict(reference)
    for part, size in zip(PARTS, (n, n, m)):
        value = np.asarray(found.get(part, np.nan), float)
        if value.shape != (size,) or not np.isfinite(value).all():
            raise InputError(f"{study}: reference[{part!r}] must be {size} finite numbers, at t = {subject.t_end:g} s")
        found[part] = value
    made_by = found.get("made_by", "given")
    known = found.get("known_to", {})
    if not isinstance(known, dict):
        raise InputError(f"{study}: reference['known_to'] = {known!r} must be a dictionary {{'q': ..., 'v': ..., 'lam': ...}}")
    for part, value in known.items():
        if part in PARTS and not (is_number(value) and value >= 0):
            raise InputError(f"{study}: reference['known_to'][{part!r}] = {value!r} must be a number of at least 0")
    return found | {"made_by": [made_by] if isinstance(made_by, str) else list(made_by), "known_to": dict(known), "failed": []}
