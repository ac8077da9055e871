"""Effect of the step on an integrator: order on smooth motion from the first step on, and round-off at tiny steps.

The reference is DOP853 on the index-1 equations (references.explicit), which shares no formula of a step with the integrator.
"""

from functools import lru_cache, partial

import numpy as np

from conditioning.systems import freed
from polyida import profile
from polyida.force.loads import PointLoad
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.integrate.start import consistent_state, start_values
from polyida.linear.saddle import KKT, scaling_size
from polyida.problems import plates
from polyida.run.solve import solve
from polyida.study.references import explicit

PARTS = ("q", "v", "a", "lam")
STEPS = 4  # of each h at tiny steps
BEGIN = 0.1  # s, where runs on smooth motion start
FINEST = 32  # steps of the finest grid in one of the coarsest, on smooth motion
TIGHT = 1e-11  # rtol of the reference on smooth motion
STARTS, SHORT = (9, 1e-5)  # errors at steps up to SHORT, s, are medians over so many starts: round-off may vanish at one of them
ALPHA = partial(GeneralizedAlpha, tolerance=1e-9)
APART = 1e-4  # s between these starts


def smooth(kind, cells):
    """Model of the double plate without gravity on a C^4 motion: "load", its tip drawn up, or "motors"."""
    if kind == "load":
        scene = plates.double_plate(cells)
        scene.add(PointLoad(scene.parts["tip"].at, (0.0, 2.0), profile.ramp(0.0, 1.0, duration=0.5), name="load"))
    else:
        scene = plates.double_plate_motors(cells, angle=profile.ramp(0.0, 0.4, duration=1.0))
    scene.gravity = (0.0, 0.0)
    return scene.build()


@lru_cache(maxsize=4)
def smooth_reference(kind, cells, coarsest, time):
    """(model, State at BEGIN, {part: values at the finest grid's later times}); the motion began at rest at t = 0."""
    model, count = smooth(kind, cells), round(time / coarsest) * FINEST
    times = BEGIN + np.arange(count + 1) * (time / count)
    states = explicit(model, times[-1], TIGHT, times=times)
    start = consistent_state(model, BEGIN, states[0][0], states[0][1])
    return model, start, {part: np.array([state[k] for state in states[1:]]) for k, part in enumerate(PARTS)}


@lru_cache(maxsize=4)
def reference_floor(kind, cells, coarsest, time):
    """{part: distance of Radau IIA in steps of the finest grid from the reference, relative to the largest value}."""
    model, start, exact = smooth_reference(kind, cells, coarsest, time)
    run = solve(model, BEGIN + time, RadauIIA(h=time / len(exact["q"])), state=start)
    return _farthest(run, exact, 1)


def order_errors(kind, cells, coarsest, halvings, time, method=ALPHA, **settings):
    """{part: largest error over all steps, relative to the largest value} for h = coarsest / 2^halvings, started on the
    way. method: integrator of h and the settings.
    """
    model, start, exact = smooth_reference(kind, cells, coarsest, time)
    count, stride = round(time / coarsest) * 2**halvings, FINEST // 2**halvings
    run = solve(model, BEGIN + time, method(h=time / count, **settings), state=start)
    return _farthest(run, exact, stride)


def _farthest(run, exact, stride):
    """{part: largest distance from every stride-th of the exact values, over all steps, relative to the largest value}."""
    if not run.success:
        raise RuntimeError(run.message)
    return {
        part: float(np.abs(getattr(run, part)[1:] - exact[part][stride - 1 :: stride]).max() / np.abs(exact[part]).max()) for part in PARTS
    }


@lru_cache(maxsize=4)
def moving_reference(scene, cells, smallest, largest):
    """(model, [(State in motion, {h: (q, v, a, lam) STEPS steps of h later})]) for h on the decades from smallest to
    largest from the first of STARTS states, to SHORT from the others.
    """
    model = plates.double_plate_motors(cells).build() if scene == "scene 2" else smooth("motors", cells)
    run = solve(model, 0.2 + (STARTS - 1) * APART, GeneralizedAlpha(h=APART))
    states = [freed(model, *frame) for frame in zip(run.t[-STARTS:], run.q[-STARTS:], run.v[-STARTS:])]
    starts = [(state, _later(model, state, decades(smallest, min(SHORT, largest)), 1e-13)) for state in states]
    if largest > SHORT:
        starts[0][1].update(_later(model, states[0], decades(10 * SHORT, largest), 1e-10))
    return model, starts


def _later(model, state, steps, rtol):
    times = state.t + STEPS * np.array(steps)
    return dict(zip(steps, explicit(model, times[-1], rtol, state.t, state.q, state.v, times)))


def decades(smallest, largest):
    """1e-9, 1e-8, ... as exact decimal numbers."""
    return [float(f"1e{k}") for k in range(round(np.log10(smallest)), round(np.log10(largest)) + 1)]


def tiny_steps(scene, cells, h, smallest, largest, **settings):
    """`after_steps` by generalized-alpha, and the stagnation level of its Newton iteration."""
    integrator = GeneralizedAlpha(h=h, tolerance=1e-9, max_halvings=0, **settings)
    result, model, states = after_steps(scene, cells, h, smallest, largest, integrator)
    return result | stall(model, states, integrator) if result["outcome"] == "done" else result


def after_steps(scene, cells, h, smallest, largest, integrator):
    """(row, model, states begun with): errors after STEPS steps of h from a consistent moving state, relative to the
    largest value: medians over the starts; Newton's work.
    """
    model, starts = moving_reference(scene, cells, smallest, largest)
    starts = [(state, ends[h]) for state, ends in starts if h in ends]
    runs = [solve(model, state.t + STEPS * h, integrator, state=state) for state, _ in starts]
    stopped = [run.message for run in runs if not run.success]
    result = {
        "outcome": stopped[0] if stopped else "done",
        "starts": len(runs),
        "iterations": sum(run.counts.newton_iterations for run in runs) / max(1, sum(run.counts.steps for run in runs)),
    }
    states = [state for state, _ in starts]
    if stopped:
        return result, model, states
    errors = [_relative(run, exact) for run, (_, exact) in zip(runs, starts)]
    return result | {f"error_{part}": float(value) for part, value in zip(PARTS, np.median(errors, axis=0))}, model, states


def _relative(run, exact):
    """Largest errors of q, v, a, lam at a run's end over the largest values."""
    return [np.abs(getattr(run, part)[-1] - value).max() / np.abs(value).max() for part, value in zip(PARTS, exact)]


def stall(model, states, settings):
    """Level at which Newton's iteration stagnates in one step: |dq| over beta h^2 |a| and |dlam| over |lam|.

    Medians over the states. NaN if the iteration with one matrix diverges.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        floor = np.median([_stall(model, state, settings) for state in states], axis=0)
    return {"stall_q": float(floor[0]), "stall_lam": float(floor[1])}


def _stall(model, state, settings, iterations=14):
    """(|dq| / beta h^2 |a|, |dlam| / |lam|), the largest of the last half of the iterations of one step with one fresh
    matrix.
    """
    c, h = settings.coefficients, settings.h
    to_a, to_v = c.rates(h)
    dd, v, a, lam, t = h * h / 2 * state.a, state.v + h * state.a, state.a.copy(), state.lam.copy(), state.t + h
    carried, start = model.increments(state.t, t, (state.t, t), h, state.q, state.v), start_values(model, state)
    matrix = model.tangent(t, state.q + h * v, v, a, lam, to_a, to_v, 1.0)
    system = KKT(matrix, model.phi_q(t, state.q + h * v), scaling_size(settings.scaling, c.beta * h * h, matrix))
    sizes = []
    for _ in range(iterations):
        q = state.q + (h * state.v + dd)
        phi = carried(dd, h * a, *start)[0] if settings.incremental_phi else model.phi(t, q)
        dq, dlam = system.solve(model.residual(t, q, v, a, lam), phi)
        dd, v, a, lam = dd + dq, v + to_v * dq, a + to_a * dq, lam + dlam
        sizes.append([np.abs(dq).max() * to_a / np.abs(state.a).max(), np.abs(dlam).max() / np.abs(state.lam).max()])
    return np.max(sizes[iterations // 2 :], axis=0)
