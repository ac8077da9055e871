"""Classification of a run: right, stopped with a reason, or wrong."""

import time
from dataclasses import dataclass

import numpy as np

from polyida.errors import InputError
from polyida.results.motion import unbalanced

OUTCOMES = ("right", "stated_stop", "unforeseen_stop", "wrong", "crash", "hang")
COLLAPSED = ("turned inside out", "has collapsed")  # words of a stop at the limit of St. Venant-Kirchhoff
INTEGRATORS = ("alpha", "adaptive", "stabilised", "energy", "ggl2", "ggl1", "radau")


@dataclass(frozen=True)
class Check:
    """A deviation, the bound below which the run is right, and a description of the check.

    at_stop: True if the check also applies to a run that stops as predicted.
    """

    name: str
    deviation: float
    bound: float
    at_stop: bool = False

    @property
    def share(self):
        """Deviation over bound; infinite if it is not finite."""
        share = self.deviation / self.bound if self.bound > 0 else float("nan")
        return float(share) if np.isfinite(share) else float("inf")


@dataclass(frozen=True)
class Stop:
    """The correct stop of a row: possible statuses ("refused" for an InputError) and words, one of which the message contains. only: True
    if a run that reaches its end is wrong.
    """

    statuses: tuple
    words: tuple
    only: bool = True

    def covers(self, status, message):
        """True if a status and a message agree with this Stop."""
        return status in self.statuses and any(word in message for word in self.words)


def integrator(name, h=1e-3, rtol=1e-5, **settings):
    """An integrator by its short name. rtol: of the error-controlled methods; generalized-alpha has atol = 0.01 m rtol."""
    from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
    from polyida.integrate.energy.energy_momentum import EnergyMomentum
    from polyida.integrate.ida.integrator import IDA
    from polyida.integrate.radau.radau_iia import RadauIIA

    if name == "radau":
        return RadauIIA(rtol=rtol, **settings)
    if name == "radau_fixed":
        return RadauIIA(h=h, **settings)
    if name == "energy":
        return EnergyMomentum(h=h, **settings)
    if name in ("ggl2", "ggl1"):
        return IDA(rtol=rtol, form=name, **settings)
    form = "stabilised" if name == "stabilised" else "index3"
    adapts = {"rtol": rtol, "atol": rtol / 100} if name == "adaptive" else {}
    return GeneralizedAlpha(h=h, form=form, **adapts, **settings)


def outcome_of(case, *arguments, foreseen=None):
    """The row of a case: case(*arguments) -> (Trajectory, checks). foreseen: the correct Stop, or None.

    "right": the run reaches its end with finite frames and passes all checks. "stated_stop": the run stops with finite frames, or the
    input is refused, as foreseen. "unforeseen_stop": another stop with a status, a message and finite frames, or another refusal.
    "wrong": all other runs, also those whose error is unknown.
    """
    begin = time.process_time()
    try:
        run, checks = case(*arguments)
    except InputError as error:
        row = {"outcome": _kind("refused", str(error), foreseen), "status": "refused", "reason": str(error)}
        return row | {"cpu_s": time.process_time() - begin}
    row = judged(run, checks, foreseen)
    if run is None:
        return row | {"cpu_s": time.process_time() - begin}
    counts = {"steps": run.counts.steps, "rejected": run.counts.rejected, "factorizations": run.counts.factorizations}
    return row | counts | {"t_end": float(run.t[-1]), "cpu_s": time.process_time() - begin}


def _kind(status, message, foreseen):
    return "stated_stop" if foreseen and foreseen.covers(status, message) else "unforeseen_stop"


def judged(run, checks, foreseen=None):
    """Outcome, status and reason of a run, and the check with the largest share. Without a run (None) the checks decide."""
    if run is None:
        return {"status": "done"} | _by_checks(checks)
    finite = all(np.isfinite(np.asarray(values)).all() for values in (run.t, run.q, run.v, run.a, run.lam))
    row = {"status": run.status, "reason": run.message}
    if not finite:
        return row | {"outcome": "wrong", "reason": "the frames hold values that are not finite"}
    if not run.success:
        return row | _stopped(run, [check for check in checks if check.at_stop], foreseen)
    if foreseen and foreseen.only:
        return row | {"outcome": "wrong", "reason": f"it came to its end; a stop was foreseen: {' or '.join(foreseen.words)}"}
    return row | _by_checks([check for check in checks if not check.at_stop])


def _stopped(run, checks, foreseen):
    """Outcome of a stopped run: frames must be finite, there must be a message, and the checks with `at_stop` must pass."""
    drift = Check("drift at the stop", run.drift.max(), 1e-6 * extent(run.model))
    result = _by_checks([drift, *checks])
    if result["outcome"] == "wrong" or not run.message:
        return result | {"outcome": "wrong"}
    return {"outcome": _kind(run.status, run.message, foreseen)}


def _by_checks(checks):
    worst = max(checks, key=lambda check: check.share)
    row = {"checked": worst.name, "deviation": float(worst.deviation), "bound": float(worst.bound)}
    if worst.share <= 1:
        return row | {"outcome": "right", "reason": ""}
    missed = ", ".join(f"{check.name} {check.deviation:.3g} > {check.bound:.3g}" for check in checks if check.share > 1)
    return row | {"outcome": "wrong", "reason": missed}


def extent(model):
    """Size of a scene, m; 1 for a model without plates."""
    return model.extent or 1.0


def drift_check(run, share=1e-9):
    """The Check that the drift of phi is below a fraction of the size of the scene."""
    return Check("drift", run.drift.max(), share * extent(run.model))


def balance(run, gain, loss):
    """Checks of the energy that motors and gravity do not explain, over the largest kinetic and strain energy or potential difference.

    gain, loss: bounds. Generalized-alpha and BDF dissipate unresolved motion, so a loss may be larger than a gain.
    """
    excess, energy = unbalanced(run), run.energy
    turned = max((energy.kinetic + energy.strain).max(), np.ptp(energy.potential), 1e-300)
    return [Check("energy gained", max(excess.max(), 0.0) / turned, gain), Check("energy lost", max(-excess.min(), 0.0) / turned, loss)]


def tip(run):
    """Path of the scene's point "tip", (frames, 2), m."""
    return run.position("tip")


def tip_check(run, place, bound, of="tip"):
    """The Check of the distance of the tip from its place at the end, over the size of the scene."""
    return Check(of, float(np.linalg.norm(tip(run)[-1] - place)) / extent(run.model), bound)


def figures(rows):
    """Counts of the outcomes, overall and by integrator."""
    counts = {name: 0 for name in OUTCOMES} | {f"{name}_{key}": 0 for key in INTEGRATORS for name in OUTCOMES}
    for row in rows:
        outcome = outcome_in(row)
        counts[outcome] += 1
        counts[f"{outcome}_{row['integrator']}"] = counts.get(f"{outcome}_{row['integrator']}", 0) + 1
    return counts


def outcome_in(row):
    """The outcome of a row; an exception without a clear message counts as a crash."""
    return row.get("outcome") or "crash"


def limits(rows):
    """Lines of text for each axis: the values with correct runs of each integrator, and the outcome at the first other value."""
    lines = []
    for axis in dict.fromkeys(row["axis"] for row in rows):
        of_axis, names_of = [row for row in rows if row["axis"] == axis], {}
        for name in dict.fromkeys(row["integrator"] for row in of_axis):
            names_of.setdefault(_limit([row for row in of_axis if row["integrator"] == name]), []).append(name)
        lines += [f"{axis}: {', '.join(names)}: {text}" for text, names in names_of.items()]
    return lines


def _limit(rows):
    good = [_short(row["value"]) for row in rows if outcome_in(row) == "right"]
    bad = [row for row in rows if outcome_in(row) != "right"]
    correct = f"right at {', '.join(good)}" if good else ""
    if not bad:
        return correct
    reason = (bad[0].get("reason") or bad[0].get("error") or "").split(";")[0].split("(least")[0][:120]
    return f"{correct}{'; ' if good else ''}{outcome_in(bad[0])} at {_short(bad[0]['value'])}: {reason}"


def _short(value):
    return f"{value:g}" if isinstance(value, float) else str(value)
