"""Outcome of a run with extreme values: right by a stated check, stopped with a reason, or wrong."""

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
        """Deviation over bound; infinite if it cannot be told."""
        share = self.deviation / self.bound if self.bound > 0 else float("nan")
        return float(share) if np.isfinite(share) else float("inf")


@dataclass(frozen=True)
class Stop:
    """The predicted stop of a row: its statuses ("refused": by InputError), and words of which its message contains one. only: a run that
    reaches its end is wrong.
    """

    statuses: tuple
    words: tuple
    only: bool = True

    def covers(self, status, message):
        """True if a stop is this one."""
        return status in self.statuses and any(word in message for word in self.words)


def integrator(name, h=1e-3, rtol=1e-5, **settings):
    """An integrator of the table by its short name; `rtol` is for those that choose their step, alpha with 0.01 m rtol for q."""
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
    """The row of a case: case(*arguments) -> (Trajectory, checks). foreseen: the predicted Stop, or None.

    "right": the run reached its end, its frames are finite and every check passes. "stated_stop": it ended earlier with finite frames, or
    the input was refused, as predicted. "unforeseen_stop": another stop with a status, a message and finite frames, or another refusal.
    "wrong" is everything else, also a run whose error cannot be determined.
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
    """Outcome, status and reason of a run, and the check that is closest to its bound; run None: only the checks."""
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
    """Outcome of a stopped run: its frames must be finite, its message must give the reason, and the checks of a stop must pass."""
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


def held(run, share=1e-9):
    """phi stays below a fraction of the scene's size."""
    return Check("drift", run.drift.max(), share * extent(run.model))


def balance(run, gain, loss):
    """Energy error that motors and gravity do not explain, relative to the largest kinetic and strain energy or motor work.

    Generalized-alpha and BDF dissipate unresolved motion: a loss beyond `loss` is wrong, a gain beyond `gain` is.
    """
    excess, energy = unbalanced(run), run.energy
    turned = max((energy.kinetic + energy.strain).max(), np.ptp(energy.potential), 1e-300)
    return [Check("energy gained", max(excess.max(), 0.0) / turned, gain), Check("energy lost", max(-excess.min(), 0.0) / turned, loss)]


def tip(run):
    """Path of the scene's point "tip", (frames, 2), m."""
    return run.position("tip")


def off_by(run, place, bound, of="tip"):
    """Distance of the tip at the end from its reference, relative to the size of the scene."""
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
    """A row's outcome: a crash or hang of the process; an exception without a clear message counts as a crash."""
    return row.get("outcome") or "crash"


def limits(rows):
    """Lines: for each axis, the limit up to which each integrator is right, and the outcome at the first value beyond it."""
    lines = []
    for axis in dict.fromkeys(row["axis"] for row in rows):
        of_axis, said = [row for row in rows if row["axis"] == axis], {}
        for name in dict.fromkeys(row["integrator"] for row in of_axis):
            said.setdefault(_limit([row for row in of_axis if row["integrator"] == name]), []).append(name)
        lines += [f"{axis}: {', '.join(names)}: {text}" for text, names in said.items()]
    return lines


def _limit(rows):
    good = [_short(row["value"]) for row in rows if outcome_in(row) == "right"]
    bad = [row for row in rows if outcome_in(row) != "right"]
    held_at = f"right at {', '.join(good)}" if good else ""
    if not bad:
        return held_at
    reason = (bad[0].get("reason") or bad[0].get("error") or "").split(";")[0].split("(least")[0][:120]
    return f"{held_at}{'; ' if good else ''}{outcome_in(bad[0])} at {_short(bad[0]['value'])}: {reason}"


def _short(value):
    return f"{value:g}" if isinstance(value, float) else str(value)
