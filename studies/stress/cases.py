"""Cases of the stress study: each runs a scene at one value and returns the checks of the run."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.run.solve import solve
from stress import scenes
from stress.outcome import COLLAPSED, Check, Stop, balance, drift_check, extent, integrator, tip, tip_check

FIXED = ("alpha", "stabilised", "energy")
FEW_FRAMES = 10**9
GAIN = 1e-3  # energy gained beyond this share of what is turned over is wrong in any run
REDUNDANT = ("hinge twice", "hinge and clamp", "motor and clamp", "two motors", "weld and motor")
SETTLED = 1e-9  # of the scene's size: drift of phi


def against_refined(make, t_end, h=1e-3, within=2e-3, loss=0.05, benign=None):
    """A case that compares the tip at t_end with runs of two methods with an eighth of the step.

    t_end, h: numbers or functions of the value. within: allowed error over the size of the scene. benign: value of the reference runs if
    the motion does not depend on the value. Error-controlled methods may have an error of 500 rtol, rtol = 1e-5, a usual ratio of global
    to local error. The bound is increased by three times the distance of the references, which must be below a third of the bound. If the
    material collapses in both reference runs, the run must stop at that time. Energy must not grow; the energy-momentum method must
    conserve it to 1e-7.
    """
    span, step = (x if callable(x) else (lambda value, x=x: x) for x in (t_end, h))
    reference = lru_cache(maxsize=4)(lambda value: refined(make(value), span(value), step(value)))

    def case(value, name):
        run = solve(make(value), span(value), integrator(name, step(value)))
        known = reference(value if benign is None else benign)
        if known.collapse:
            time = Check("time of the collapse, s", abs(run.t[-1] - known.collapse), 2 * step(value) + 3 * known.apart, at_stop=True)
            return run, [time]
        return run, [refined_check(run, known, within if name in FIXED else 5e-3), drift_check(run, SETTLED), *_energies(run, name, loss)]

    case.__doc__ = (
        f"The tip within {within:g} of the scene's size, {500 * 1e-5:g} for the integrators that choose their step, of "
        f"runs of generalized-alpha and of the energy-momentum method with an eighth of the step; phi holds, energy does "
        f"not grow. Where both of these collapse, the run does, at the same time."
    )
    return case


@dataclass(frozen=True)
class Refined:
    """Result of two refined runs: the place of the tip at t_end, or the time of a collapse, s.

    apart: distance of the two results, over the size of the scene or in s. failed: reason if there is no result.
    """

    place: object = None
    apart: float = float("nan")
    collapse: float = 0.0
    failed: str = ""


def refined(model, t_end, h):
    """The Refined of generalized-alpha and the energy-momentum method with step h/8."""
    runs = [solve(model, t_end, integrator(name, h / 8), every=FEW_FRAMES) for name in ("alpha", "energy")]
    if all(any(word in run.message for word in COLLAPSED) for run in runs):
        ends = [float(run.t[-1]) for run in runs]
        return Refined(collapse=float(np.mean(ends)), apart=abs(ends[1] - ends[0]))
    failed = next((run.message for run in runs if not run.success), "")
    one, other = (tip(run)[-1] for run in runs)
    return Refined((one + other) / 2, float(np.linalg.norm(one - other)) / extent(model), failed=failed)


def refined_check(run, known, bound):
    """The Check of the place of the tip; NaN if a reference run failed or the references differ too much."""
    if known.failed:
        return Check(f"tip; a refined run stops: {known.failed[:80]}", float("nan"), 1.0)
    allowed_error = bound + 3 * known.apart if 3 * known.apart < bound else float("nan")
    return tip_check(run, known.place, allowed_error, "tip against refined runs")


def _energies(run, name, loss):
    needs = run.model.needs
    if needs.velocity_forces:
        return balance(run, GAIN, 1.01)
    exact = name == "energy"
    if exact and not needs.driven:
        return balance(run, 1e-7, 1e-7)
    return balance(run, GAIN, GAIN if exact else loss)


def stiff_limit(modulus, name):
    """Two nearly rigid plates swing: the tip agrees with the solution for rigid bodies.

    The elastic sag is about 0.3 m at E = 50 MPa and is proportional to 1/E; the sag and 2e-3 of the length are allowed.
    """
    model = scenes.swing(scenes.rubber(modulus))
    run = solve(model, 0.5, integrator(name))
    return run, [
        tip_check(run, rigid_tip(model, 0.5), 2e-3 + 0.3 * 50e6 / modulus / 2, "tip against rigid bodies"),
        drift_check(run, SETTLED),
        *_energies(run, name, 0.1),
    ]


def rigid_tip(model, t_end):
    """Place of the tip if both plates are rigid and fall from rest; masses and moments of inertia are those of the mass matrix."""
    from scipy.integrate import solve_ivp

    mass, first = model._even_mass, model.bodies[0].nodes
    x = model.reference[:, 0]
    upper = (np.arange(len(x)) < first.stop).astype(float)
    lower, y = 1 - upper, model.reference[:, 1]
    shape_1 = np.stack([x * upper + lower, y * upper])  # what turns with the upper plate: itself, and the joint that carries the lower
    shape_2 = np.stack([(x - 1) * lower, y * lower])
    inner = [[sum(a[k] @ (mass @ b[k]) for k in (0, 1)) for b in (shape_1, shape_2)] for a in (shape_1, shape_2)]
    cross = shape_1[0] @ (mass @ shape_2[1]) - shape_1[1] @ (mass @ shape_2[0])
    ones = np.ones(len(x))
    pull = [[ones @ (mass @ shape[k]) for k in (0, 1)] for shape in (shape_1, shape_2)]

    def rate(t, state):
        (p1, p2), (w1, w2) = state[:2], state[2:]
        c, s = np.cos(p2 - p1), np.sin(p2 - p1)
        coupling, slope = inner[0][1] * c - cross * s, -inner[0][1] * s - cross * c
        load = [-9.81 * (pull[k][0] * np.cos(p) - pull[k][1] * np.sin(p)) for k, p in enumerate((p1, p2))]
        matrix = [[inner[0][0], coupling], [coupling, inner[1][1]]]
        return [w1, w2, *np.linalg.solve(matrix, [load[0] - slope * w2**2, load[1] + slope * w1**2])]

    p1, p2 = solve_ivp(rate, (0.0, t_end), np.zeros(4), rtol=1e-10, atol=1e-12).y[:2, -1]
    return np.array([np.cos(p1) + np.cos(p2), np.sin(p1) + np.sin(p2)])


def one_virtual_element(corners, name):
    """A single virtual element swings about a corner: the tip agrees with a compound pendulum of the same mass matrix."""
    return one_element(corners, name, "virtual")


def one_element(corners, name, element="wachspress"):
    """A single polygonal element swings about a corner: the tip agrees with a compound pendulum of the same mass matrix."""
    from scipy.integrate import solve_ivp

    model = scenes.one_polygon(corners, element)
    run = solve(model, 0.5, integrator(name))
    arm = model.reference - model.reference[np.argmin(model.reference[:, 0])]
    mass = model._even_mass
    inertia = sum(arm[:, k] @ (mass @ arm[:, k]) for k in (0, 1))
    pull = np.ones(len(arm)) @ (mass @ arm)
    angle = solve_ivp(
        lambda t, y: [y[1], -9.81 * (pull[0] * np.cos(y[0]) - pull[1] * np.sin(y[0])) / inertia],
        (0.0, 0.5),
        [0.0, 0.0],
        rtol=1e-10,
        atol=1e-12,
    ).y[0, -1]
    to_tip = tip(run)[0] + [0.5, 0.0]
    place = [to_tip[0] * np.cos(angle) - to_tip[1] * np.sin(angle) - 0.5, to_tip[0] * np.sin(angle) + to_tip[1] * np.cos(angle)]
    return run, [tip_check(run, place, 5e-3, "tip against a rigid pendulum"), drift_check(run, SETTLED), *_energies(run, name, 0.05)]


def small_steps(h, name):
    """40 steps of the motor-driven plates: q and v agree with Taylor's series at the start, a and lam with the equations of motion.

    The check of a and lam applies to generalized-alpha: their relative distance from the solution of M a + g + B^T lam = 0, phi'' = 0 at
    the same q and v. IDA does not control the error of a and lam; the energy-momentum method and Radau IIA compute them from these
    equations. h is the first and largest step of IDA, whose q and v may have an error of 500 (rtol |q| + atol). Radau IIA takes equal
    steps.
    """
    from polyida.integrate.alpha.start import jerk
    from polyida.integrate.start import consistent_acceleration, consistent_state

    model = scenes.plates.double_plate_motors(scenes.CELLS).build()
    start, t, chooses = consistent_state(model), 40 * h, name in ("ggl2", "ggl1")
    settings = {"max_step": h, "first_step": h} if chooses else {}
    run = solve(model, t, RadauIIA(h=h) if name == "radau" else integrator(name, h, **settings))
    third = jerk(model, start, 1e-4)
    q, v, pull = start.a * t**2 / 2 + third * t**3 / 6, start.a * t + third * t**2 / 2, np.abs(start.a).max()
    extra = 500 * 1e-7 if chooses else 0.0
    checks = [
        Check("q against Taylor", np.abs(run.q[-1] - q).max(), 2e-3 * pull * t**2 + extra),
        Check("v against Taylor", np.abs(run.v[-1] - v).max(), 2e-3 * pull * t + 1e3 * extra),
        drift_check(run, SETTLED),
    ]
    if name in ("alpha", "stabilised"):
        a, lam = consistent_acceleration(model, float(run.t[-1]), run.q[-1], run.v[-1])
        checks += [
            Check("a against the equations", np.abs(run.a[-1] - a).max() / np.abs(a).max(), 1e-4),
            Check("lam against the equations", np.abs(run.lam[-1] - lam).max() / np.abs(lam).max(), 1e-4),
        ]
    return run, checks


def newton_tolerance(tolerance, name):
    """Swinging plates with another Newton tolerance: the error stays below 2e-3 of the size, the error of the time integration."""
    return _toleranced(name, tolerance=tolerance)


def error_tolerance(rtol, name):
    """Swinging plates with another rtol: the error stays below 500 rtol plus the error of the reference."""
    return _toleranced(name, rtol=rtol, allowed=500 * rtol, t_end=0.3 if rtol > 1e-7 else 0.01)


@lru_cache(maxsize=4)
def _swing_reference(t_end):
    return refined(scenes.swing(), t_end, 2e-4)


def _toleranced(name, allowed=2e-3, t_end=0.3, **settings):
    run = solve(scenes.swing(), t_end, integrator(name, **settings))
    known = _swing_reference(t_end)
    allowed_error = allowed + 3 * known.apart
    checks = [tip_check(run, known.place, allowed_error, "tip against refined runs"), drift_check(run, max(SETTLED, 1e-2 * allowed_error))]
    return run, [*checks, *balance(run, max(GAIN, allowed_error), 1.01)]


def spectral_radius(rho_inf, name):
    """Swinging plates with another rho_inf: the tip agrees with refined runs."""
    run = solve(scenes.swing(), 0.5, integrator(name, rho_inf=rho_inf))
    return run, [refined_check(run, _swing_reference(0.5), 2e-3), drift_check(run, SETTLED), *balance(run, GAIN, 0.05)]


def through_flat(start, name):
    """A parallelogram of plates falls from crank angle `start` through its flat position, or rests there: phi and energy stay accurate."""
    run = solve(scenes.four_bar(start), 0.8, integrator(name))
    return run, [drift_check(run, SETTLED), *_energies(run, name, 0.05)]


def redundant_joints(kind, name):
    """Joints repeat or contradict each other: the scene is refused."""
    return solve(scenes.redundant(kind), 0.02, integrator(name)), []


def refused_as_redundant(kind, name):
    """The scene with motors at 0 rad and 0.5 rad is refused as contradictory, the other scenes as redundant."""
    return Stop(("refused",), ("violates the constraint", "redundant") if kind == "two motors" else ("redundant",))


def blow(duration, name):
    """A pulse of 1 N s acts on a free plate: linear and angular momentum agree with the pulse.

    Steps end at the corners of the pulse, so a short pulse takes one step up and one step down. Generalized-alpha, which has two
    different accelerations there, and the error-controlled methods may deviate by 0.5 %. The energy-momentum method must be exact.
    """
    model = scenes.struck(duration)
    run = solve(model, 0.013 + duration, integrator(name))
    ones, x = np.ones(model.n_nodes), model.reference + run.q[-1].reshape(-1, 2)
    v = run.v[-1].reshape(-1, 2)
    momentum = ones @ (model._even_mass @ v)
    spin = np.sum(x[:, 0] * (model._even_mass @ v[:, 1]) - x[:, 1] * (model._even_mass @ v[:, 0]))
    exact = 1e-8 if name == "energy" else 5e-3
    return run, [
        Check("linear momentum", float(np.hypot(momentum[0], momentum[1] - 1.0)), exact),
        Check("angular momentum", abs(spin - 1.0), 0.02),
        drift_check(run),
    ]


def pressing(pressure, name):
    """A block is pressed slowly: the stretch agrees with the material law up to 0.19245 E. Under a higher pressure the run stops with a
    message about the collapse. The time of the stop agrees with the delay by viscosity.
    """
    run = solve(scenes.pressed(pressure), 0.6, integrator(name))
    if beyond_the_material(pressure, name):
        time, delay = _collapse_of_the_pressed(pressure)
        return run, [Check("time of the collapse, s", abs(run.t[-1] - time), 0.3 * delay, at_stop=True)]
    stretch = max(root.real for root in np.roots([1.0, 0.0, -1.0, 2 * pressure]) if abs(root.imag) < 1e-9)
    return run, [Check("stretch", abs(tip(run)[-1, 0] / 0.05 - stretch), 2e-3), drift_check(run, SETTLED)]


def _collapse_of_the_pressed(pressure):
    """(time of the collapse, its delay after the largest load), s.

    Near the stretch s = 1/sqrt 3 + d of the largest load, `(tau / 3) d' = -(p'/E) (t - t_c) - (sqrt 3 / 2) d^2` with the viscosity tau.
    The solution d goes to minus infinity at `t_c + 2.338 ((tau / 3)^2 / (p'/E sqrt 3 / 2))^(1/3)`; -2.338 is the first zero of the Airy
    function Ai.
    """
    from scipy.optimize import brentq

    most = brentq(lambda t: pressure * scenes.PRESSING(t) - 1 / np.sqrt(27), 0.0, 0.5)
    grows = pressure * scenes.PRESSING.d1(most) * np.sqrt(3) / 2
    delay = 2.338 * float(np.cbrt((scenes.SLOW / 3) ** 2 / grows))
    return most + delay, delay


def beyond_the_material(pressure, name):
    """A St. Venant-Kirchhoff material has an equilibrium up to a pressure of E / sqrt 27."""
    return Stop(("inverted", "objection"), COLLAPSED) if pressure > 1 / np.sqrt(27) else None


def too_soft(modulus, name):
    """The weight of the driven plates causes a bending moment of 31 N m, `6 M / (t H^2)` = 1.9 MPa. They collapse if that exceeds 0.9 E."""
    return Stop(("inverted", "objection"), COLLAPSED) if 0.9 * modulus < 1.9e6 else None


def too_thin(width, name):
    """Cells with a width of at most 1e-8 of the mesh are refused."""
    return Stop(("refused",), ("is a sliver",)) if width <= 1e-8 else None


def too_many_corners(corners, name):
    """Wachspress elements with more than 16 corners are refused."""
    return Stop(("refused",), ("corners",)) if corners > 16 else None
