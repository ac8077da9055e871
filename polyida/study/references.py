"""References of the studies, with how well they are known.

Published digits; explicit runs on the index-1 equations, which share the model and its consistent accelerations with
the integrators and nothing else; for the spin-up beam alone, too stiff for them, generalized-alpha itself at two short
steps, extrapolated.
"""

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from polyida import problems, profile
from polyida.body.loads import PointLoad
from polyida.integrate.start import consistent_acceleration, consistent_state
from polyida.problems import plates
from polyida.threads import one_blas_thread

PARTS = ("q", "v", "lam")


@dataclass(frozen=True)
class Case:
    """A model, its start, and its state at t_end as far as known.

    reference: {"q", "v", "lam"}; known: {part: how far two references of their own are apart} or, of published digits,
    their error. sizes: typical (q, v) for absolute tolerances. how: where the reference comes from. newton: tolerance
    of generalized-alpha's Newton iteration that does not show in the errors studied.
    """

    name: str
    model: object
    t_end: float
    q0: object = None
    v0: object = None
    reference: dict = field(default_factory=dict)
    known: dict = field(default_factory=dict)
    sizes: tuple = (1.0, 1.0)
    how: str = ""
    newton: float = 1e-4

    def errors(self, state):
        """{"error_q", "error_v", "error_lam"}: largest absolute deviations at t_end."""
        return {
            f"error_{part}": float(np.abs(getattr(state, part) - value).max()) for part, value in self.reference.items()
        }


def published(name, sizes):
    """A problem with published digits of q and v; lam follows from these and the equations of motion, which is better
    than digits of lam.
    """
    p = problems.get(name)
    q, v = p.reference["q"], p.reference["v"]
    lam = consistent_acceleration(p.model, p.t_end, q, v)[1]
    apart = float(np.abs(lam - p.reference["lam"]).max())
    how = f"{p.source}; lam from these q and v, the printed lam is {apart:.1e} away"
    return Case(name, p.model, p.t_end, p.q0, p.v0, {"q": q, "v": v, "lam": lam}, {}, sizes, how, 1e-9)


def explicit(model, t_end, rtol, t0=0.0, q0=None, v0=None, times=None):
    """[(q, v, a, lam)] at the increasing `times` (default t_end alone), by DOP853 on (q, v)' = (v, a) with a of the
    index-1 equations.

    It shares the model's equations and the consistent start with the integrators, no formula of a step. Pieces end at
    the kinks of loads and motors.
    """
    state, wanted, found = consistent_state(model, t0, q0, v0), np.atleast_1d(t_end if times is None else times), []
    y, t = np.concatenate([state.q, state.v]), t0
    with one_blas_thread():
        for end in [*model.kinks(t0, wanted[-1]), wanted[-1]]:
            within = (wanted > t) & (wanted <= end) | (wanted == t0) & (t == t0)
            values, y = _piece(model, t, end, y, wanted[within], rtol)
            found, t = found + values, end
    return found


def _piece(model, t, end, y, wanted, rtol):
    """States at the wanted times in (t, end], and y at the end."""
    from scipy.integrate import solve_ivp

    n = model.n

    def rate(t, y):
        return np.concatenate([y[n:], consistent_acceleration(model, t, y[:n], y[n:])[0]])

    at = np.union1d(wanted, [end])
    run = solve_ivp(
        rate, (t, end), y, method="DOP853", t_eval=at, rtol=rtol, atol=rtol * 1e-3, first_step=min(1e-6, end - t)
    )
    known = dict(zip(at, run.y.T))
    return [
        (known[s][:n], known[s][n:], *consistent_acceleration(model, s, known[s][:n], known[s][n:])) for s in wanted
    ], run.y[:, -1]


def with_explicit(name, model, t_end, sizes, rtol=1e-9):
    """A case whose reference is an explicit run, known as well as two of them, at `rtol` and ten times that, agree."""
    fine, coarse = (explicit(model, t_end, tolerance)[0] for tolerance in (rtol, 10 * rtol))
    take = lambda state: dict(zip(("q", "v", "a", "lam"), state))  # noqa: E731
    known = {part: float(np.abs(take(fine)[part] - take(coarse)[part]).max()) for part in PARTS}
    return Case(
        name,
        model,
        t_end,
        None,
        None,
        {part: take(fine)[part] for part in PARTS},
        known,
        sizes,
        f"DOP853 on the index-1 equations, rtol {rtol:g}",
    )


def with_refined(name, model, t_end, sizes, h):
    """A case whose reference is generalized-alpha at h and h/2, extrapolated; known as well as that moves it.

    It is not independent of the integrators: errors far below `known` say only how well they agree with this one.
    """
    from polyida.integrate.generalized_alpha import GeneralizedAlpha
    from polyida.integrate.solve import solve

    coarse, fine = (solve(model, t_end, GeneralizedAlpha(h=step, tolerance=1e-8), every=10**9) for step in (h, h / 2))
    reference, known = {}, {}
    for part in PARTS:
        a, b = getattr(coarse, part)[-1], getattr(fine, part)[-1]
        reference[part] = (4 * b - a) / 3
        known[part] = float(np.abs(reference[part] - b).max())
    return Case(
        name,
        model,
        t_end,
        None,
        None,
        reference,
        known,
        sizes,
        f"generalized-alpha itself, at {h:g} s and half of it, extrapolated: not independent of the members",
    )


def rigid_limit():
    """The Case of the stiff double pendulum against its rigid bodies' equation."""
    p = problems.get("rigid-limit")
    return Case(p.name, p.model, p.t_end, None, None, p.reference, p.known_to, (1e-2, 10.0), p.source)


def sudden_blow(cells, t_end, duration=0.005, force=40.0):
    """The double plate without gravity, its tip drawn up by a force that grows slowly; near the end the tip is struck
    for 5 ms.
    """
    scene = plates.double_plate(cells)
    scene.gravity = (0.0, 0.0)
    tip, at, bump = scene.parts["tip"].at, 0.95 * t_end, np.polynomial.Polynomial([0, 0, 0, 64, -192, 192, -64])

    def blow(t):
        s = (t - at) / duration
        return float(bump(s)) if 0 < s < 1 else 0.0

    scene.add(PointLoad(tip, (0.0, 0.5), profile.ramp(0.0, 1.0, duration=t_end), name="draw"))
    scene.add(PointLoad(tip, (0.0, force), profile.from_function(blow, kinks=(at, at + duration)), name="blow"))
    return scene.build()


def blown(name, cells, t_end, sizes):
    """The Case of `sudden_blow` against an explicit reference."""
    return with_explicit(name, sudden_blow(cells, t_end), t_end, sizes, 1e-8)


@lru_cache(maxsize=16)
def case(name, quick):
    """The Case of a name; `quick` ones have coarser meshes and shorter times."""
    cells, scene = (8, 0.1) if quick else (12, 0.25)
    sizes = (1e-2, 10.0)
    makers = {
        "pendulum": lambda: published("pendulum", (1.0, 1.0)),
        "car-axis": lambda: published("car-axis", (1.0, 1.0)),
        "andrews": lambda: published("andrews", (0.1, 100.0)),
        "double-plate": lambda: with_explicit(name, plates.double_plate(cells).build(), scene, sizes),
        "double-plate-motors": lambda: with_explicit(
            name, plates.double_plate_motors(cells).build(), scene, sizes, 1e-8 if quick else 1e-9
        ),
        "plate-chain": lambda: with_explicit(name, plates.plate_chain(3, cells).build(), scene, sizes),
        "rigid-limit": rigid_limit,
        "spin-up-beam": lambda: with_refined(name, problems.get(name).model, 20.0, (1e-1, 1.0), 2e-3),
        "sudden-blow": lambda: blown(name, 8 if quick else 20, 0.5 if quick else 2.0, sizes),
    }
    return makers[name]()
