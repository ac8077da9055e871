"""References of the studies, with how well they are known.

Published digits, or the end of the motion by two methods of unlike families, as well known as they agree: explicit runs
on the index-1 equations beside generalized-alpha; for the spin-up beam, too stiff for the former, the energy-momentum
method beside it.
"""

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from polyida import problems, profile
from polyida.body.loads import PointLoad
from polyida.integrate.start import consistent_acceleration
from polyida.problems import plates
from polyida.study.families import by_alpha, by_energy_momentum, by_explicit, distance


@dataclass(frozen=True)
class Case:
    """A model, its start, and its state at t_end as far as known.

    reference: {"q", "v", "lam"}; known: {part: how far two families of methods are apart} or, of published digits,
    their error. sizes: typical (q, v) for absolute tolerances. how: where the reference comes from. newton: tolerance
    of generalized-alpha's Newton iteration where its own default would show in the errors studied.
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
    newton: float | None = None

    def errors(self, state):
        """{"error_q", "error_v", "error_lam"}: largest absolute deviations at t_end."""
        return {f"error_{part}": float(np.abs(getattr(state, part) - value).max()) for part, value in self.reference.items()}


def published(name, sizes):
    """A problem with published digits of q and v; lam follows from these and the equations of motion, which is better
    than digits of lam.
    """
    p = problems.get(name)
    q, v = p.reference["q"], p.reference["v"]
    lam = consistent_acceleration(p.model, p.t_end, q, v)[1]
    apart = float(np.abs(lam - p.reference["lam"]).max())
    how = f"{p.source}; lam from these q and v, the printed lam is {apart:.1e} away"
    known = p.known_to | {"lam": max(apart, p.known_to["lam"])}
    return Case(name, p.model, p.t_end, p.q0, p.v0, {"q": q, "v": v, "lam": lam}, known, sizes, how, 1e-9)


def agreed(name, model, t_end, sizes, reference, other):
    """A case whose reference is the motion's end by one family, known as well as another one agrees.

    reference, other: (what it is, {"q", "v", "lam"}).
    """
    how = f"{reference[0]}; {other[0]} is as far away as it is known to"
    known = distance(reference[1], other[1])
    return Case(name, model, t_end, None, None, reference[1], known, sizes, how)


def with_explicit(name, model, t_end, sizes, rtol=1e-9, h=5e-6):
    """A case whose reference is an explicit run, known as well as extrapolated generalized-alpha (h, h/2) agrees."""
    exact = f"DOP853 on the index-1 equations, rtol {rtol:g}", by_explicit(model, t_end, rtol)
    return agreed(name, model, t_end, sizes, exact, _alpha(model, t_end, h))


def too_stiff_for_explicit(name, model, t_end, sizes, h):
    """A case whose reference is the energy-momentum method with 4h and 2h, known as well as generalized-alpha with h
    and h/2 agrees, both extrapolated.
    """
    other = f"the energy-momentum method with h = {4 * h:g} s and half of it, extrapolated"
    exact = other, by_energy_momentum(model, t_end, 4 * h)
    return agreed(name, model, t_end, sizes, exact, _alpha(model, t_end, h))


def _alpha(model, t_end, h):
    return f"generalized-alpha with h = {h:g} s and half of it, extrapolated,", by_alpha(model, t_end, h)


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


def blown(name, cells, t_end, sizes, h):
    """The Case of `sudden_blow` against an explicit reference."""
    return with_explicit(name, sudden_blow(cells, t_end), t_end, sizes, 1e-8, h)


def damped_ramp():
    """The double plate of 8 cells, a little damped, without gravity; its tip is drawn by a force that grows smoothly within 20 ms, as
    fast as the plates ring: steps that resolve it resolve them.
    """
    rubber = plates.RUBBER
    scene = plates.double_plate(8, material=plates.Material(E=rubber.E, nu=rubber.nu, rho=rubber.rho, viscosity=1e-5))
    scene.gravity = (0.0, 0.0)
    scene.add(PointLoad(scene.parts["tip"].at, (0.0, 200.0), profile.ramp(0.0, 1.0, duration=0.02), name="draw"))
    return scene.build()


def andrews_by_explicit(sizes):
    """Andrews' mechanism against DOP853 at the limit of rounding: its published digits are off by more than what is judged."""
    p = problems.get("andrews")
    tight, loose = (by_explicit(p.model, p.t_end, rtol, p.q0, p.v0) for rtol in (2.3e-14, 1e-12))
    how = "DOP853 on the index-1 equations, rtol 2.3e-14; known as well as it is with 1e-12"
    return Case("andrews-by-explicit", p.model, p.t_end, p.q0, p.v0, tight, distance(tight, loose), sizes, how, 1e-9)


@lru_cache(maxsize=16)
def case(name, quick):
    """The Case of a name; `quick` ones have coarser meshes and shorter times."""
    cells, scene = (8, 0.1) if quick else (12, 0.25)
    sizes = (1e-2, 10.0)
    makers = {
        "pendulum": lambda: published("pendulum", (1.0, 1.0)),
        "car-axis": lambda: published("car-axis", (1.0, 1.0)),
        "andrews": lambda: published("andrews", (0.1, 100.0)),
        "andrews-by-explicit": lambda: andrews_by_explicit((0.1, 100.0)),
        "damped-ramp": lambda: with_explicit(name, damped_ramp(), 0.02, sizes, 1e-12, 2e-6),
        "double-plate": lambda: with_explicit(name, plates.double_plate(cells).build(), scene, sizes),
        "double-plate-motors": lambda: with_explicit(
            name, plates.double_plate_motors(cells).build(), scene, sizes, 1e-8 if quick else 1e-9
        ),
        "plate-chain": lambda: with_explicit(name, plates.plate_chain(3, cells).build(), scene, sizes),
        "rigid-limit": rigid_limit,
        "spin-up-beam": lambda: too_stiff_for_explicit(name, problems.get(name).model, 20.0, (1e-1, 1.0), 5e-4),
        "sudden-blow": lambda: blown(name, 8, 0.5, sizes, 1e-4) if quick else blown(name, 20, 2.0, sizes, 2e-5),
    }
    return makers[name]()
