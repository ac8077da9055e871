"""References of the studies, with how well they are known.

Published digits, or the end of the motion by Radau IIA and by a method of another family, as well known as the two
agree: explicit runs on the index-1 equations; for the spin-up beam, too stiff for these, the energy-momentum method.
"""

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from polyida import problems, profile
from polyida.force.loads import PointLoad
from polyida.problems import plates
from polyida.study.families import PARTS, by_energy_momentum, by_explicit, by_radau, distance

EXPLICIT = 1e-9  # rtol of DOP853, whose steps are short enough for the fastest modes: of q it leaves less than 1e-12 m
RADAU = 1e-13  # rtol of Radau IIA: of the plates' q it leaves 1e-13 to 1e-11 m
STIFF = 1e-12  # the same where the other method is known to no more than 1e-9 m


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
    """The Case of a problem with digits of q, v and lam."""
    p = problems.get(name)
    reference = {part: p.reference[part] for part in PARTS}
    return Case(name, p.model, p.t_end, p.q0, p.v0, reference, p.known_to, sizes, p.source, 1e-9)


def agreed(name, model, t_end, sizes, reference, other):
    """A case whose reference is the motion's end by one family, known as well as another one agrees.

    reference, other: (what it is, {"q", "v", "lam"}).
    """
    how = f"{reference[0]}; {other[0]} is as far away as it is known to"
    known = distance(reference[1], other[1])
    return Case(name, model, t_end, None, None, reference[1], known, sizes, how)


def with_explicit(name, model, t_end, sizes, rtol=EXPLICIT):
    """A case whose reference is an explicit run, known as well as Radau IIA agrees."""
    exact = f"DOP853 on the index-1 equations, rtol {rtol:g}", by_explicit(model, t_end, rtol)
    return agreed(name, model, t_end, sizes, exact, (f"Radau IIA, rtol {RADAU:g},", by_radau(model, t_end, RADAU)))


def too_stiff_for_explicit(name, model, t_end, sizes, h):
    """A case whose reference is Radau IIA, known as well as the energy-momentum method with h and h/2, extrapolated, agrees."""
    other = f"the energy-momentum method with h = {h:g} s and half of it, extrapolated,", by_energy_momentum(model, t_end, h)
    return agreed(name, model, t_end, sizes, (f"Radau IIA, rtol {STIFF:g}", by_radau(model, t_end, STIFF)), other)


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


def damped_ramp():
    """The double plate of 8 cells, a little damped, without gravity; its tip is drawn by a force that grows smoothly within 20 ms, as
    fast as the plates ring: steps that resolve it resolve them.
    """
    rubber = plates.RUBBER
    scene = plates.double_plate(8, material=plates.Material(E=rubber.E, nu=rubber.nu, rho=rubber.rho, viscosity=1e-5))
    scene.gravity = (0.0, 0.0)
    scene.add(PointLoad(scene.parts["tip"].at, (0.0, 200.0), profile.ramp(0.0, 1.0, duration=0.02), name="draw"))
    return scene.build()


@lru_cache(maxsize=16)
def case(name, quick):
    """The Case of a name; `quick` ones have coarser meshes and shorter times."""
    cells, time = (8, 0.1) if quick else (12, 0.25)
    blown, of_blow = (8, 0.5) if quick else (20, 2.0)
    sizes = (1e-2, 10.0)
    makers = {
        "pendulum": lambda: published("pendulum", (1.0, 1.0)),
        "car-axis": lambda: published("car-axis", (1.0, 1.0)),
        "andrews": lambda: published("andrews", (0.1, 100.0)),
        "damped-ramp": lambda: with_explicit(name, damped_ramp(), 0.02, sizes, 1e-12),
        "double-plate": lambda: with_explicit(name, plates.double_plate(cells).build(), time, sizes),
        "double-plate-motors": lambda: with_explicit(name, plates.double_plate_motors(cells).build(), time, sizes),
        "plate-chain": lambda: with_explicit(name, plates.plate_chain(3, cells).build(), time, sizes),
        "rigid-limit": rigid_limit,
        "spin-up-beam": lambda: too_stiff_for_explicit(name, problems.get(name).model, 20.0, (1e-1, 1.0), 2e-3),
        "sudden-blow": lambda: with_explicit(name, sudden_blow(blown, of_blow), of_blow, sizes),
    }
    return makers[name]()
