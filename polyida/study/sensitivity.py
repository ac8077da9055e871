"""What the step does to generalized-alpha: order on smooth motion from the first step on, and round-off at tiny steps.

The reference is DOP853 on the index-1 equations (references.explicit), which shares no code with the integrator.
"""

from functools import lru_cache

import numpy as np

from polyida import profile
from polyida.body.loads import PointLoad
from polyida.integrate.alpha_increment import Carried, start_values
from polyida.integrate.generalized_alpha import GeneralizedAlpha
from polyida.integrate.solve import solve
from polyida.integrate.start import consistent_state
from polyida.linear.kkt import KKT, scaling_factors
from polyida.problems import plates
from polyida.study.conditioning import freed
from polyida.study.references import explicit

PARTS = ("q", "v", "a", "lam")
STEPS = 4  # of each h at tiny steps
BEGIN = 0.1  # s, where runs on smooth motion start
FINEST = 32  # steps of the finest grid in one of the coarsest, on smooth motion


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
    states = explicit(model, times[-1], 1e-9, times=times)
    start = consistent_state(model, BEGIN, states[0][0], states[0][1])
    return model, start, {part: np.array([state[k] for state in states[1:]]) for k, part in enumerate(PARTS)}


def order_errors(kind, cells, coarsest, halvings, time, **settings):
    """{part: largest error over all steps, relative to the largest value} for h = coarsest / 2^halvings, started on the
    way.
    """
    model, start, exact = smooth_reference(kind, cells, coarsest, time)
    count, stride = round(time / coarsest) * 2**halvings, FINEST // 2**halvings
    run = solve(model, BEGIN + time, GeneralizedAlpha(h=time / count, tolerance=1e-9, **settings), state=start)
    return {
        part: float(
            np.abs(getattr(run, part)[1:] - exact[part][stride - 1 :: stride]).max() / np.abs(exact[part]).max()
        )
        for part in PARTS
    }


@lru_cache(maxsize=4)
def moving_reference(scene, cells, smallest, largest):
    """(model, State on its way, {h: (q, v, a, lam) STEPS steps of h later}) for h on the decades from smallest to
    largest.
    """
    model = plates.double_plate_motors(cells).build() if scene == "scene 2" else smooth("motors", cells)
    begin = 0.2
    run = solve(model, begin, GeneralizedAlpha(h=1e-4), every=10**9)
    state = freed(model, begin, run.q[-1], run.v[-1])
    steps = decades(smallest, largest)
    ends = explicit(model, begin, 1e-10, begin, state.q, state.v, begin + STEPS * np.array(steps))
    return model, state, dict(zip(steps, ends))


def decades(smallest, largest):
    """1e-9, 1e-8, ... as exact decimal numbers."""
    return [float(f"1e{k}") for k in range(round(np.log10(smallest)), round(np.log10(largest)) + 1)]


def tiny_steps(scene, cells, h, smallest, largest, **settings):
    """Errors after STEPS steps of h from a consistent moving state, relative to the largest value; Newton's work and
    where it stalls.
    """
    model, state, ends = moving_reference(scene, cells, smallest, largest)
    integrator = GeneralizedAlpha(h=h, tolerance=1e-9, max_halvings=0, **settings)
    run = solve(model, state.t + STEPS * h, integrator, state=consistent_state(model, state.t, state.q, state.v))
    found = {
        "outcome": "done" if run.success else run.message,
        "iterations": run.counts.newton_iterations / max(1, run.counts.steps),
    }
    if not run.success:
        return found
    errors = {
        part: float(np.abs(getattr(run, part)[-1] - exact).max() / np.abs(exact).max())
        for part, exact in zip(PARTS, ends[h])
    }
    return found | {f"error_{part}": value for part, value in errors.items()} | stall(model, state, integrator)


def stall(model, state, settings, places=5):
    """Where Newton's iteration stops falling in one step: |dq| over beta h^2 |a| and |dlam| over |lam|.

    Medians over `places` states a tenth of a millisecond apart: round-off may vanish at one of them.
    """
    beside = [freed(model, state.t + s, state.q + s * state.v, state.v) for s in 1e-4 * np.arange(places)]
    floor = np.median([_stall(model, place, settings) for place in beside], axis=0)
    return {"stall_q": float(floor[0]), "stall_lam": float(floor[1])}


def _stall(model, state, settings, iterations=14):
    """(|dq| / beta h^2 |a|, |dlam| / |lam|), the largest of the last half of the iterations of one step with one fresh
    matrix.
    """
    c, h = settings.coefficients, settings.h
    to_a, to_v = (1 - c.alpha_m) / (c.beta * h * h * (1 - c.alpha_f)), c.gamma / (c.beta * h)
    dd, v, a, lam, t = h * h / 2 * state.a, state.v + h * state.a, state.a.copy(), state.lam.copy(), state.t + h
    carried = Carried(model, state.t, t, h, state, *start_values(model, state)) if settings.incremental_phi else None
    matrix = model.tangent(t, state.q + h * v, v, a, lam, to_a, to_v, 1.0)
    system = KKT(matrix, model.phi_q(t, state.q + h * v), scaling_factors(settings.scaling, c.beta * h * h, matrix))
    sizes = []
    for _ in range(iterations):
        q = state.q + (h * state.v + dd)
        phi = carried(dd, h * a)[0] if carried else model.phi(t, q)
        dq, dlam = system.solve(model.residual(t, q, v, a, lam), phi)
        dd, v, a, lam = dd + dq, v + to_v * dq, a + to_a * dq, lam + dlam
        sizes.append([np.abs(dq).max() * to_a / np.abs(state.a).max(), np.abs(dlam).max() / np.abs(state.lam).max()])
    return np.max(sizes[iterations // 2 :], axis=0)
