"""Checks of random scenes by what must hold whatever they are: `python tests/combinations.py --seeds 1000 [--from N] [--kinds energy ...]`.

A check raises Finding if it does not hold. A refusal (InputError) and a stop (a run without success) are counted by their words; so is
an event's storm. `--shrink` removes parts of a recipe as long as the same check fails; what remains is printed and becomes a test.
"""

import argparse
import tempfile
import time
import warnings
from collections import Counter
from dataclasses import replace
from functools import cached_property
from itertools import count
from pathlib import Path

import numpy as np
from combinations_scenes import DURATION, PLAIN, RIGID, World, build, recipe

import polyida as pi
from polyida.integrate.start import on_velocity
from polyida.model.guarded import guard
from polyida.results.motion import unbalanced

STEPS = 60  # of runs with fixed steps
STOPS_IN_WORDS = "events", "half-turn", "singular", "jump", "objection", "inverted", "stopped"  # a reason of mechanics, with a part's name


class Finding(AssertionError):
    """What must hold does not."""


class Stop(Exception):
    """A run ended before its end, for a reason that mechanics gives."""


class Case:
    """A recipe with what several checks need."""

    def __init__(self, recipe):
        self.recipe = recipe
        self.rigid = all(kind in RIGID for kind, _ in recipe.bodies)
        self.random = np.random.default_rng(recipe.seed)

    @cached_property
    def made(self):
        """The scene as drawn."""
        return build(self.recipe)

    @cached_property
    def laws(self):
        """True if there are contacts or dry friction."""
        return bool(self.made.model.row_laws) or any(part for event in self.made.events for part in event.added if part_has_law(part))

    @property
    def stepped(self):
        """True if only time stepping takes the scene: events beside contact or friction."""
        return self.laws and bool(self.made.events)

    @property
    def times(self):
        """Times at which runs are compared."""
        return DURATION * np.array([0.2, 0.41, 0.63, 0.8, 1.0])

    def run(self, integrator, made=None, end=DURATION, **options):
        """A run of a Built to its end, with its events."""
        made = made or self.made
        second = 1.0 / made.world.units[2]
        if not options.pop("all_frames", False) and "output" not in options:
            options["output"] = (self.times * second)[self.times <= end]
        run = pi.solve(made.model, end * second, integrator, events=made.events, **options)
        return require_success(run)

    @cached_property
    def reference(self):
        """A run with tight tolerances."""
        if self.stepped:
            return self.run(pi.NonsmoothAlpha(h=0.25 * DURATION / STEPS))
        return self.run(pi.RadauIIA(rtol=1e-8 if self.rigid else 1e-6))

    @cached_property
    def by_fixed(self):
        """A run with fixed steps."""
        return self.run(self.fixed())

    @cached_property
    def size(self):
        """Largest way of an end, m, and a bit of the size of the scene."""
        paths = places(self.made, self.by_fixed)
        drawn = np.array([end.point for end in self.made.ends])
        return float(np.abs(paths - drawn).max()) + 0.01

    def require_near(self, paths, others, bound, what):
        """Raise Finding unless places (frames, ends, 2) agree to a share of the size."""
        apart = float(np.abs(paths - others).max()) / self.size
        if not apart <= bound:
            raise Finding(f"{what}: {apart:.2g} of the way apart, bound {bound:.2g}")

    def fixed(self, world=PLAIN):
        """An integrator of fixed steps by the seed, with a strict Newton tolerance."""
        h = DURATION / STEPS / world.units[2]
        kinds = [
            pi.GeneralizedAlpha(h=h, tolerance=1e-11),
            pi.RadauIIA(h=3 * h, tolerance=1e-13),
            pi.EnergyMomentum(h=h, tolerance=1e-11),
            pi.GeneralizedAlpha(h=h, tolerance=1e-11, form="stabilised"),
        ]
        if self.stepped or (self.laws and self.recipe.seed % 3 == 0):
            return pi.NonsmoothAlpha(h=h, tolerance=1e-11)
        return kinds[self.recipe.seed % len(kinds)]


def part_has_law(part):
    """True if a part of an event is a joint with a law."""
    return isinstance(part, (pi.Contact, pi.Clearance)) or bool(getattr(part, "friction", 0.0))


def require_success(run):
    """The run. Raises Stop or Finding if it did not reach its end."""
    if run.success:
        return run
    text = f"{type(run.integrator).__name__}: {run.status}: {run.message}"
    raise (Stop if run.status in STOPS_IN_WORDS else Finding)(text)


def places(made, run):
    """Places of all ends in the world as drawn, (frames, ends, 2), m."""
    return made.world.back(np.stack([run.position(end) for end in made.ends], axis=1))


# --- what must hold; each takes a Case ---


def integrators_agree(case):
    """IDA by its tolerance; methods of fixed steps by the difference of two step sizes."""
    expected, stops = places(case.made, case.reference), []
    rtol = 1e-7 if case.rigid else 1e-5
    if not case.stepped:
        case.require_near(places(case.made, case.run(pi.IDA(rtol=rtol))), expected, 2000 * rtol, "IDA")
    h = DURATION / STEPS
    fixed = [
        *([] if case.stepped else [pi.GeneralizedAlpha, pi.EnergyMomentum]),
        *([pi.NonsmoothAlpha, pi.MoreauJean] if case.laws else []),
    ]
    for kind in fixed:
        try:
            coarse, fine = (places(case.made, case.run(kind(h=step))) for step in (h, 0.5 * h))
        except (pi.InputError, Stop) as stop:
            stops.append(stop)
            continue
        changed = float(np.abs(coarse - fine).max()) / case.size
        case.require_near(fine, expected, 3.0 * changed + (1e-4 if case.rigid else 1e-3), f"{kind.__name__}, steps differ by {changed:.2g}")
    if stops:
        raise stops[0]


def energy_balances(case):
    """What the energy changes by is the work less what is dissipated."""
    h = DURATION / STEPS
    integrator = (pi.RadauIIA(rtol=1e-7, max_step=h), pi.GeneralizedAlpha(h=0.25 * h))[case.recipe.seed % 2]
    integrator = pi.NonsmoothAlpha(h=0.25 * h) if case.stepped else integrator
    run = case.run(integrator, all_frames=True)
    energy = run.energy
    flows = [np.abs(x).max() for x in (*energy.work.values(), *energy.dissipated.values())]
    size = max([float(np.ptp(energy.kinetic)), float(np.ptp(energy.potential)), *flows, 1e-6])
    left, bound = float(np.abs(unbalanced(run)).max()) / size, 2e-3 if case.rigid and not case.stepped else 2e-2
    if not left <= bound:
        raise Finding(f"{type(integrator).__name__}: {left:.2g} of the energy is missing, bound {bound:.2g}")


def split_runs_go_on(case):
    """A run to the middle, continued by its state, and by its file, is the whole run."""
    middle = 0.47 * DURATION
    adaptive = pi.RadauIIA(rtol=1e-8 if case.rigid else 1e-6), 1e-5 if case.rigid else 1e-3
    for integrator, bound in (*([] if case.stepped else [adaptive]), (case.fixed(), 1e-2)):
        whole = places(case.made, case.run(integrator, output=[DURATION]))
        begun = case.run(integrator, end=middle, all_frames=True)
        if not case.made.events:  # behind events `run.mode` goes on without them
            rest = case.run(integrator, state=begun.state, output=[DURATION])
            case.require_near(places(case.made, rest), whole, bound, f"{type(integrator).__name__} by state=")
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "run.h5"
            case.run(integrator, end=middle, all_frames=True, out=path)
            again = require_success(pi.resume(path, DURATION, model=case.made.model, events=case.made.events or None))
        case.require_near(places(case.made, again)[-1:], whole, bound, f"{type(integrator).__name__} by resume")


def moved_world(case):
    """The shifted, turned and mirrored world has the shifted, turned and mirrored motion."""
    same_motion(case, World((3.1, -2.3), float(case.random.uniform(-3.0, 3.0)), bool(case.random.integers(2))))


def other_units(case):
    """The scene in other units of length, mass and time has the same motion."""
    same_motion(case, World(units=tuple((10.0 ** case.random.uniform(-3, 3, 3)).tolist())))


def order_of_parts(case):
    """Parts that are added in another order have the same motion."""
    same_motion(case, World(order=1))


def same_motion(case, world):
    """Fixed steps in another world: the same steps, up to round-off that Newton's tolerance leaves."""
    made = build(case.recipe, world)
    moved = places(made, case.run(case.fixed(world), made))
    case.require_near(moved, places(case.made, case.by_fixed), 1e-5, f"{type(case.fixed()).__name__}, {world}")


def gradients(case):
    """The gradient is that of differences: of a run and its numbers without events, of the motion and its first velocities with them."""
    h = DURATION / 60
    integrator = (pi.GeneralizedAlpha(h=h, tolerance=1e-13), pi.RadauIIA(h=3 * h, tolerance=1e-15))[case.recipe.seed % 2]
    model = case.made.model
    w = np.random.default_rng(1).standard_normal(model.n)

    def slopes(run):
        found = np.zeros_like(np.asarray(run.q, float))
        found[-1] = w
        return {"q": found}

    J = pi.objective.UserObjective(lambda run: float(np.asarray(run.q[-1]) @ w), slopes)
    run = case.run(integrator, all_frames=True)
    if not case.made.events:
        names = [*pi.gradient(run, J)]
        some = case.random.choice(names, min(2, len(names)), replace=False).tolist()
        errors = {name: error for name, error in pi.check_gradient(run, J, some).items() if not error <= 1e-4}
        if errors:
            raise Finding(f"gradient of {type(integrator).__name__}: {errors}")
        return
    v0 = np.array(run.v[0], float)
    d = on_velocity(guard(model), 0.0, run.q[0], v0 + np.random.default_rng(2).standard_normal(model.n)) - v0
    exact, finer = (
        float(pi.gradient(case.run(replace(integrator, h=share * integrator.h), all_frames=True, v0=v0), J, ["v0"])["v0"] @ d)
        for share in (1.0, 0.5)
    )
    # the place of an event within its step changes a run by an error of its method, and so the differences: they are those of Radau IIA
    ends = [J(case.run(pi.RadauIIA(h=1.5 * h, tolerance=1e-15), all_frames=True, v0=v0 + s * d)) for s in (-2e-4, -1e-4, 1e-4, 2e-4)]
    narrow, wide = (ends[2] - ends[1]) / 2e-4, (ends[3] - ends[0]) / 4e-4
    if not abs(exact - narrow) <= 1e-4 * abs(narrow) + 1e-6 + 3.0 * (abs(narrow - wide) + abs(exact - finer)):
        raise Finding(
            f"gradient in v0 of {type(integrator).__name__}: {exact:.8g}, with half the steps {finer:.8g}, differences {narrow:.8g}"
        )


def files_keep_runs(case):
    """A saved and loaded file equals the run."""
    run = case.run(case.fixed(), all_frames=True)
    with tempfile.TemporaryDirectory() as folder:
        run.save(Path(folder) / "run.h5")
        again = pi.load(Path(folder) / "run.h5")
        for name in ("t", "q", "v", "a", "lam", "x"):
            if not np.array_equal(getattr(run, name), getattr(again, name)):
                raise Finding(f"{name} of the file differs")
        if again.counts != run.counts or again.status != run.status or again.events.summary() != run.events.summary():
            raise Finding("counts, status or events of the file differ")
        try:
            again.known_model("position")
        except pi.InputError:
            return
        for name in ("kinetic", "potential", "strain"):
            if not np.allclose(getattr(run.energy, name), getattr(again.energy, name), rtol=1e-12, atol=1e-12):
                raise Finding(f"{name} energy of the file differs")


CHECKS = {
    "integrators": integrators_agree,
    "energy": energy_balances,
    "split": split_runs_go_on,
    "world": moved_world,
    "units": other_units,
    "order": order_of_parts,
    "gradient": gradients,
    "file": files_keep_runs,
}


def outcome(case, kind):
    """("passed", "refused", "stopped" or "failed", why) of a check of a Case."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # that joints change the velocities of bodies; modes of reduced plates
        try:
            CHECKS[kind](case)
        except pi.InputError as refusal:
            return "refused", str(refusal)
        except Stop as stop:
            return "stopped", str(stop)
        except Finding as finding:
            return "failed", str(finding)
        except Exception as crash:  # noqa: BLE001  # a crash of any kind is what is looked for
            return "failed", f"{type(crash).__name__}: {crash}"
    return "passed", ""


def shrunk(recipe, kind):
    """The simplest recipe found whose check fails too."""
    for simpler in recipe.without():
        if outcome(Case(simpler), kind)[0] == "failed":
            return shrunk(simpler, kind)
    return recipe


def main():
    """Check recipes by their seeds and print what came out."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--from", dest="first", type=int, default=0)
    parser.add_argument("--kinds", nargs="+", choices=[*CHECKS], default=[*CHECKS])
    parser.add_argument("--shrink", action="store_true")
    parser.add_argument("--seconds", type=float, default=1e9, help="begin no further seed after this time")
    options = parser.parse_args()
    counted, begin = Counter(), time.monotonic()
    for seed in count(options.first):
        if seed >= options.first + options.seeds or time.monotonic() - begin > options.seconds:
            break
        case = Case(recipe(seed))
        for kind in options.kinds:
            start = time.process_time()
            found, why = outcome(case, kind)
            counted[kind, found] += 1
            if found == "failed":
                simple = shrunk(case.recipe, kind) if options.shrink else case.recipe
                print(f"{seed} {kind} failed: {outcome(Case(simple), kind)[1] if options.shrink else why}\n    {simple}", flush=True)
            elif why:
                print(f"{seed} {kind} {found}: {why}", flush=True)
            if time.process_time() - start > 10.0:
                print(f"{seed} {kind}: {time.process_time() - start:.1f} CPU s", flush=True)
    for kind in options.kinds:
        print(f"{kind:12}", *(f"{name} {counted[kind, name]}" for name in ("passed", "refused", "stopped", "failed")))


if __name__ == "__main__":
    main()
