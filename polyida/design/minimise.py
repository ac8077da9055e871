"""`minimise`: the method of moving asymptotes of nlopt in stages, for an objective within limits."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from polyida.design.problem import Case, Evaluation, Problem
from polyida.design.variables import Densities, Sharpness, Size
from polyida.errors import InputError
from polyida.files import replacing
from polyida.objective.objective import Limit, Objective
from polyida.progress import teller
from polyida.validation import is_number, library, listed, named_keywords, path_of, whole

if TYPE_CHECKING:
    import pandas as pd

FLOOR = 1e-6  # of the first value: below it the logarithm of the objective goes on as a line
MET = 5e-3  # relative excess of a limit that still counts as kept
KEEPING = 1e-6  # scaled excess of a limit that the optimiser takes as kept
LOST = 10.0  # added to the objective and to the limits where a run fails, so that the optimiser turns back
SETTLED = 1e-4  # of the variables' range: a stage ends if no variable changes by more
NAME = "evaluation-{:05d}.npz"


@named_keywords
@dataclass(frozen=True)
class Stage:
    """A stage of `minimise`.

    Parameters
    ----------
    evaluations : int
        At most.
    q : float
        Of RAMP.
    beta : float or None
        Of the projection of densities; None for none.
    move : float in (0, 1]
        Largest change of a variable in the stage; where the limits are exceeded after that, it may change by as much again.

    Raises
    ------
    InputError
        For anything else.
    """

    evaluations: int = 20
    q: float = 20.0
    beta: float | None = None
    move: float = 1.0

    def __post_init__(self):
        """Check the ranges of all numbers."""
        whole("Stage", "evaluations", self.evaluations)
        if not (is_number(self.q) and self.q >= 0):
            raise InputError(f"Stage: q = {self.q!r:.40} must be a number of at least 0")
        if not (self.beta is None or (is_number(self.beta) and self.beta > 0)):
            raise InputError(f"Stage: beta = {self.beta!r:.40} must be a positive number, or None")
        if not (is_number(self.move) and 0 < self.move <= 1):
            raise InputError(f"Stage: move = {self.move!r:.40} must be above 0 and at most 1")

    @property
    def sharp(self) -> Sharpness:
        """The Sharpness of the densities in this stage: q and beta."""
        return Sharpness(float(self.q), self.beta)


OF_DENSITIES = (  # with a sharp projection stages are short and moves small: larger ones exceed the limits and end with heavier designs
    Stage(20, 5.0),
    Stage(16, 10.0, 4.0),
    *[Stage(8, 20.0, 8.0, 0.2)] * 2,
    *[Stage(10, 20.0, 16.0, 0.2)] * 2,
    *[Stage(8, 20.0, 32.0, 0.1)] * 3,
)
OF_SIZES = (Stage(30),)


@named_keywords
@dataclass(frozen=True, eq=False)
class Design:
    """Result of `minimise`.

    Parameters
    ----------
    problem : Problem
    x : (variables,) float, 0 to 1
    sharp : Sharpness
        Of the stage that it comes from.
    objective : float
        Value of the objective.
    limits : dict of str to (float, float)
        {limit: (value, upper)}; the value is the maximum itself where the objective stands for one.
    met : bool
        True if all limits are kept, up to half a per cent.
    message : str
        How the search ended.
    history : pandas.DataFrame
        A row for each evaluation: stage, objective, values of the limits, largest relative excess, error, seconds.
    """

    problem: Problem
    x: NDArray
    sharp: Sharpness
    objective: float
    limits: dict[str, tuple[float, float]]
    met: bool
    message: str
    history: pd.DataFrame

    @property
    def values(self) -> dict[str, Any]:
        """{variable: its densities (cells,) or number}."""
        return self.problem.values(self.x, self.sharp)

    def model(self, case: int = 0) -> Any:
        """Return the model of a load case with this design."""
        return self.problem.setting(self.x, self.sharp).model(self.problem.cases[case])

    def run(self, case: int = 0) -> Any:
        """Return the run of a load case with this design."""
        return self.problem.cases[case].ran(self.model(case))

    def __repr__(self):
        """Return the objective, the limits and the message, in one line."""
        limits = "".join(f"; {name} {value:.4g} <= {upper:.4g}" for name, (value, upper) in self.limits.items())
        return f"Design(objective={self.objective:.6g}{limits}; {self.message})"


@named_keywords
def minimise(
    objective: Objective,
    limits: Sequence[Limit],
    variables: Sequence[Densities | Size],
    cases: Case | Sequence[Case],
    stages: Sequence[Stage] | None = None,
    folder: str | Path | None = None,
    executor: Executor | None = None,
    progress: Callable[[int, int, str], object] | bool | None = None,
) -> Design:
    """Search the variables with the least value of an objective within limits, by the method of moving asymptotes.

    Parameters
    ----------
    objective : Objective
        Of several cases the mean.
    limits : sequence of Limit
    variables : sequence of Densities or Size
    cases : Case or sequence of Case
    stages : sequence of Stage, optional
        Each begins with the best design of the one before. Default: nine stages of sharper projection and smaller moves if there are
        densities, else one.
    folder : str or Path, optional
        Folder with a file for each evaluation. A later call with the same arguments, for example after a kill, reads them and goes on as if
        it had never ended.
    executor : concurrent.futures.Executor, optional
        As for `Problem`.
    progress : callable or bool, optional
        Function of (done, total, text) after each evaluation; the text has the time left. By default a bar of tqdm at a terminal
        and in a notebook; False: none.

    Returns
    -------
    Design

    Raises
    ------
    InputError
        If nlopt is not installed, for wrong arguments, if a value of the start is not finite or its run fails, and for the folder of
        another problem.

    Warns
    -----
    UserWarning
        For limits that the start exceeds, and for a variable without influence.

    Notes
    -----
    Objective and limits are scaled, `log(J / J_0)` and `log(J / upper)`, a line where that has no slope: J / upper - 1 of a limit that is
    kept. A design whose run fails gets values that turn the optimiser back, and a row in the history with the reason.

    Svanberg, SIAM J. Optim. 12 (2002); nlopt's LD_MMA. The best design of a stage is the one with the least objective that keeps the
    limits, or else the one that exceeds them least.
    """
    problem = Problem(objective, limits, variables, cases, executor)
    densities = any(isinstance(one, Densities) for one in problem.variables)
    stages = listed("minimise", "stages", stages) if stages is not None else [*(OF_DENSITIES if densities else OF_SIZES)]
    if not stages or not all(isinstance(stage, Stage) for stage in stages):
        raise InputError(f"minimise: stages = {stages!r:.100} must be a list of at least one pi.design.Stage")
    nlopt = library("nlopt", "minimise: the optimiser is missing; pip install 'polyida[design]'")
    with teller("minimise", progress) as report:
        search = _Search(problem, _Store(folder), sum(stage.evaluations for stage in stages), report)
        design = None
        for number, stage in enumerate(stages, 1):
            design, ended = search.stage(nlopt, number, stage, design)
            if ended:
                break
    assert design is not None
    return design


def limits_in_words(excess):
    """'limits kept' for a largest relative excess that still counts as kept, or by how much they are exceeded."""
    return "limits kept" if excess <= MET else f"limits exceeded by {100 * excess:.2g} %"


class _Search:
    """Evaluations of a problem for nlopt, with their history."""

    def __init__(self, problem, store, total, report):
        """Begin a history of at most `total` evaluations; report: function of (done, total, text)."""
        self.problem, self.store, self.total, self.report = problem, store, total, report
        self.rows = []
        self.begun = time.perf_counter()
        self.fresh = 0
        self.uppers = np.array([limit.upper for limit, _ in problem.held])
        self.first = 1.0
        self.positive = True

    def evaluated(self, x, stage):
        """The Evaluation at x, from the store if it is there."""
        found = self.store.get(x, stage.sharp)
        if found is None:
            found = self.problem.evaluate(x, stage.sharp)
            self.store.keep(x, stage.sharp, found)
            self.fresh += 1
        return found

    def stage(self, nlopt, number, stage, before):
        """(Design, True if the search ends) after a stage that begins with the Design `before`, or with the start."""
        x = self.problem.start if before is None else before.x
        start = self._begin(x, stage) if before is None else self.evaluated(x, stage)
        if start.error:
            return replace(before, message=f"{before.message}; stage {number} was not begun: its first run failed ({start.error})"), True
        stage_search = _StageSearch(self, number, stage, start)
        stage_search.run(nlopt, x)
        return self._best(stage_search.trials, stage), False

    def _begin(self, x, stage):
        """The Evaluation of the start, with words on what is wrong with it."""
        problem = self.problem
        self.store.require_same(x, stage.sharp, problem)
        found = self.evaluated(x, stage)
        if found.error:
            raise InputError(f"minimise: the run of the start fails ({found.error}); begin with a stiffer design or a smaller q")
        if not (np.isfinite(found.values).all() and np.isfinite(found.slopes).all()):
            names = ["the objective", *problem.labels]
            wrong = [names[k] for k in range(len(names)) if not np.isfinite([found.values[k], *found.slopes[k]]).all()]
            raise InputError(f"minimise: {wrong[0]} or its slope is no finite number for the start: {found.values.tolist()}")
        self.first = abs(float(found.values[0])) or 1.0
        self.positive = found.values[0] > 0
        for label, value, upper in zip(problem.labels, found.largest[1:], self.uppers):
            if value > upper + MET * abs(upper):
                warnings.warn(f"minimise: the start exceeds a limit: {label} is {value:.4g}, upper {upper:.4g}", stacklevel=5)
        for one, slopes in zip(problem.maps, np.split(found.slopes, problem.splits, axis=1)):
            if not slopes.any():
                warnings.warn(
                    f"minimise: the variable {one.name!r} has no influence on the objective or a limit at the start", stacklevel=5
                )
        return found

    def scaled(self, found, scale, trials):
        """Scaled values and slopes for the optimiser; `scale`: of the limits' objectives to the maxima that they stand for."""
        if found.error:
            known = [trial[2][0] for trial in trials] or [0.0]
            return max(known) + LOST, found.slopes[0], np.full(len(self.uppers), LOST), found.slopes[1:]
        ratio = float(found.values[0]) / self.first
        if not self.positive:
            f, rate = ratio, 1.0
        elif ratio > FLOOR:
            f, rate = math.log(ratio), 1.0 / ratio
        else:
            f, rate = math.log(FLOOR) + ratio / FLOOR - 1.0, 1.0 / FLOOR
        ratios, size = scale * found.values[1:] / np.abs(self.uppers), np.sign(self.uppers)
        over = (size > 0) & (ratios > 1.0)
        c = np.where(over, np.log(np.where(over, ratios, 1.0)), ratios - size)
        rates = scale / np.abs(self.uppers) / np.where(over, ratios, 1.0)
        return f, rate / self.first * found.slopes[0], c, rates[:, None] * found.slopes[1:]

    def excess(self, found):
        """Largest relative excess of a limit, at least 0."""
        return float(np.max((found.largest[1:] - self.uppers) / np.abs(self.uppers), initial=0.0))

    def note(self, number, stage, found):
        """Add an evaluation to the history and report it."""
        done, spent = len(self.rows) + 1, time.perf_counter() - self.begun
        values = dict(zip(self.problem.labels, found.largest[1:].tolist()))
        row = {"stage": number, "q": stage.q, "beta": stage.beta, "objective": float(found.values[0])} | values
        row |= {"excess": self.excess(found), "error": found.error, "seconds": spent}
        self.rows.append(row)
        left = f"{spent / self.fresh * (self.total - done):.0f} s left" if self.fresh else "read"
        what = f"run failed: {found.error}" if found.error else f"{row['objective']:.4g}, {limits_in_words(row['excess'])}"
        self.report(done, self.total, f"stage {number}: {what}; {left}")

    def _best(self, trials, stage):
        """The Design of the best trial of a stage."""
        from pandas import DataFrame

        whole = [(x, found) for x, found, _ in trials if not found.error]
        kept = [(x, found) for x, found in whole if self.excess(found) <= MET]
        x, found = min(kept, key=lambda one: one[1].values[0]) if kept else min(whole, key=lambda one: self.excess(one[1]))
        limits = {label: (float(v), float(u)) for label, v, u in zip(self.problem.labels, found.largest[1:], self.uppers)}
        failed = sum(bool(row["error"]) for row in self.rows)
        message = limits_in_words(self.excess(found))
        message += f"; {failed} of {len(self.rows)} runs failed, and the search stepped back" if failed else ""
        return Design(self.problem, x, stage.sharp, float(found.values[0]), limits, bool(kept), message, DataFrame(self.rows))


class _StageSearch:
    """The search of a stage with nlopt. trials: (x, Evaluation, result of `at`) of each x, in their order.

    nlopt gives limits that cannot be kept in one step multipliers of 1e40. These never become small again, so that the design would go
    away from the limits. A search from outside therefore ends at the first design that keeps them, and another one begins there.
    """

    def __init__(self, search, number, stage, start):
        """Take the units of the objective and the limits from the Evaluation of the start."""
        self.search, self.number, self.stage = search, number, stage
        self.scale = np.divide(start.largest, start.values, out=np.ones_like(start.values), where=start.values != 0)[1:]
        _, steepest, _, each = search.scaled(start, self.scale, [])
        self.unit = 1.0 / (np.abs(steepest).max() or 1.0)  # the optimiser's first step is right for slopes of about 1
        self.units = 1.0 / np.maximum(np.abs(each).max(axis=1, initial=0.0), FLOOR)
        self.trials = []
        self.known = {}

    def at(self, x):
        """(f, its slope, c, their slopes) of the scaled objective and limits; evaluated, noted and stored in `trials` once for each x."""
        key = x.tobytes()
        if key not in self.known:
            found = self.search.evaluated(x, self.stage)
            self.known[key] = self.search.scaled(found, self.scale, self.trials)
            self.search.note(self.number, self.stage, found)
            self.trials.append((x.copy(), found, self.known[key]))
        return self.known[key]

    def keeps(self, x):
        """True if x keeps all limits."""
        return bool((self.units * self.at(x)[2] <= KEEPING).all())

    def run(self, nlopt, x):
        """Search from x until it ends inside the limits, or until no more evaluations are allowed."""
        centre, outside = x, not self.keeps(x)
        while True:
            self._optimise(nlopt, x, centre, outside)
            if not outside or len(self.trials) >= self.stage.evaluations:
                return
            whole = [(trial, found) for trial, found, _ in self.trials if not found.error]
            inside = [trial for trial, _ in whole if self.keeps(trial)]
            nearest = inside[0] if inside else min(whole, key=lambda one: self.search.excess(one[1]))[0]
            if not inside and np.abs(nearest - x).max() <= SETTLED:
                return
            x, outside, centre = nearest, not inside, centre if inside else nearest

    def _optimise(self, nlopt, x, centre, outside):
        """One search of nlopt from x within the move around `centre`; one from outside ends at the first design that keeps the limits."""
        mma, count, stage = nlopt.opt(nlopt.LD_MMA, len(x)), len(self.search.uppers), self.stage

        def objective(x, slope):
            """The scaled objective, in nlopt's form: `slope` is filled unless it is empty."""
            f, by_x, *_ = self.at(x)
            if slope.size:
                slope[:] = self.unit * by_x
            return self.unit * f

        def limits(result, x, slope):
            """Fill the scaled limits and, unless it is empty, `slope`, in nlopt's form."""
            _, _, c, by_x = self.at(x)
            result[:] = self.units * c
            if slope.size:
                slope[:] = self.units[:, None] * by_x
            if outside and self.keeps(x):
                mma.force_stop()

        mma.set_lower_bounds(np.maximum(centre - stage.move, 0.0))
        mma.set_upper_bounds(np.minimum(centre + stage.move, 1.0))
        mma.set_maxeval(stage.evaluations - len(self.trials) + 1)  # nlopt counts its start, which is known
        mma.set_xtol_abs(SETTLED)
        mma.set_min_objective(objective)
        if count:
            mma.add_inequality_mconstraint(limits, np.full(count, KEEPING))
        with suppress(nlopt.RoundoffLimited, nlopt.ForcedStop):
            mma.optimize(x)


class _Store:
    """A folder with a file for each evaluation, or nothing. read: number of evaluations that were there."""

    def __init__(self, folder):
        """Read the evaluations that the folder holds."""
        self.folder = None if folder is None else path_of("minimise", "folder", folder)
        self.known = {}
        if self.folder is not None:
            try:
                self.folder.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise InputError(f"minimise: folder = {str(folder)!r} is none and cannot be made one: {error.strerror}") from None
            for path in sorted(self.folder.glob("evaluation-*.npz")):
                with np.load(path) as data:
                    found = Evaluation(data["values"], data["slopes"], data["largest"], str(data["error"]))
                    self.known[data["x"].tobytes(), tuple(data["sharp"].tolist())] = found
        self.read = len(self.known)

    def _key(self, x, sharp):
        """What identifies an evaluation: x and the numbers of the densities."""
        return np.asarray(x, float).tobytes(), (float(sharp.q), float(sharp.beta or 0.0))

    def get(self, x, sharp):
        """The stored Evaluation at variables x with Sharpness `sharp`, or None if there is none."""
        return self.known.get(self._key(x, sharp))

    def keep(self, x, sharp, found):
        """Store an Evaluation: a file is whole or not there."""
        self.known[self._key(x, sharp)] = found
        if self.folder is None:
            return
        path = self.folder / NAME.format(len(self.known))
        with replacing(path) as part, open(part, "wb") as file:
            np.savez(file, x=x, sharp=self._key(x, sharp)[1], **vars(found))

    def require_same(self, x, sharp, problem):
        """Raise InputError if the folder's evaluation of the start is not that of the problem."""
        if not self.read:
            return
        known = self.get(x, sharp)
        same = known is not None and len(known.values) == 1 + len(problem.held)
        if not same or not np.allclose(known.values, problem.evaluate(x, sharp).values, rtol=1e-6, atol=0.0, equal_nan=True):
            raise InputError(f"minimise: folder = {str(self.folder)!r} holds the evaluations of another problem; choose a new one")
