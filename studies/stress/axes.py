"""The axes of the stress study: which parameter varies, over which values, and with which integrators."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stress import cases, contacts, identities, nonsmooth, own, scenes, states
from stress.cases import against_refined
from stress.kills import killed_runs, killed_sweeps
from stress.long import many_steps
from stress.outcome import INTEGRATORS, outcome_of

CHOOSING = ("adaptive", "ggl2", "ggl1", "radau")
STIFFLY = ("ggl2", "ggl1", "radau")


@dataclass(frozen=True)
class Axis:
    """One varied parameter.

    case(value, name of an integrator) returns (Trajectory, checks). values, quick: all values from mild to extreme, and those of the
    quick selection. foreseen(value, name) is the Stop that is correct for a row, or None if the run must reach its end. slow: integrators
    that the quick selection skips.
    """

    case: Callable
    values: tuple
    quick: tuple
    integrators: tuple = INTEGRATORS
    slow: tuple = ()
    foreseen: Callable = lambda value, name: None

    def tasks(self, quick):
        """(value, name of an integrator) of a selection."""
        names = [name for name in self.integrators if not (quick and name in self.slow)]
        return [(value, name) for value in (self.quick if quick else self.values) for name in names]


AXES = {
    "modulus, Pa": Axis(
        against_refined(lambda value: scenes.swing(scenes.rubber(value)), 0.5),
        (50e6, 20e6, 10e6, 5e6, 2e6, 1e6, 3e5, 1e5),
        (50e6, 5e6, 1e5),
    ),
    "rigid limit, Pa": Axis(cases.stiff_limit, (1e9, 1e10, 1e11, 2e11), (1e9, 2e11)),
    "tip over plate mass": Axis(
        against_refined(lambda value: scenes.swing(tip_mass=value * scenes.PLATE_MASS), 0.1),
        (1e-6, 1e-3, 1.0, 10.0, 100.0, 1e3, 1e4, 1e5, 1e6),
        (1e-6, 1.0, 1e3, 1e6),
        slow=("ggl1",),
    ),
    "slenderness": Axis(against_refined(scenes.slender, 0.3), (10.0, 20.0, 50.0, 100.0, 200.0), (10.0, 50.0, 200.0)),
    "links": Axis(against_refined(scenes.chain, 0.3), (2, 3, 5, 10, 20, 35, 50), (2, 20)),
    "gravity factor": Axis(
        against_refined(scenes.heavy, lambda factor: 0.3 / np.sqrt(factor), h=lambda factor: 1e-3 / np.sqrt(factor)),
        (1.0, 3.0, 10.0, 30.0, 100.0),
        (1.0, 10.0, 100.0),
    ),
    "long step, s": Axis(
        identities.large_steps,
        (0.003, 0.01, 0.03, 0.1, 0.3, 1.0),
        (0.01, 0.1, 1.0),
        (*cases.FIXED, "radau_fixed"),
        foreseen=identities.cannot_be_predicted,
    ),
    "short step, s": Axis(cases.small_steps, (1e-6, 1e-7, 1e-8, 1e-9, 1e-10), (1e-6, 1e-8, 1e-10), cases.FIXED + STIFFLY),
    "rho_inf": Axis(cases.spectral_radius, (0.9, 0.8, 0.5, 0.0, 0.95, 0.99), (0.9, 0.0, 0.99), ("alpha", "adaptive", "stabilised")),
    "Newton tolerance": Axis(cases.newton_tolerance, (1e-4, 1e-3, 1e-2, 1e-6, 1e-8, 1e-10, 1e-12), (1e-4, 1e-2, 1e-12), cases.FIXED),
    "error tolerance": Axis(cases.error_tolerance, (1e-5, 1e-4, 1e-3, 1e-2, 1e-6, 1e-7, 1e-8, 1e-10, 1e-12), (1e-5, 1e-2, 1e-8), CHOOSING),
    "turns": Axis(identities.many_turns, (1, 3, 10, 30, 100), (1, 10), slow=("ggl1",)),
    "reversal, rad/s": Axis(identities.reversal, (1.0, 3.0, 10.0, 30.0, 100.0), (1.0, 100.0), slow=("ggl1",)),
    "jump in a step, rad": Axis(
        identities.half_turn,
        (0.5, 1.0, 1.5, 2.0, 2.5, 3.1, 3.2, 4.7, 6.28),
        (0.5, 1.5, 3.1),
        slow=("ggl1",),
        foreseen=identities.bends_too_far,
    ),
    "width of a sliver, m": Axis(
        against_refined(scenes.sliver, 0.3, benign=1e-2),
        (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-10, 1e-12),
        (1e-2, 1e-4, 1e-8),
        foreseen=cases.too_thin,
    ),
    "short edge, m": Axis(
        against_refined(scenes.short_edge, 0.3, benign=1e-2), (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-10, 1e-12), (1e-2, 1e-6, 1e-12)
    ),
    "corners of one element": Axis(cases.one_element, (3, 4, 5, 6, 8, 12, 20, 30), (3, 8, 30), foreseen=cases.too_many_corners),
    "corners of one virtual element": Axis(cases.one_virtual_element, (3, 4, 5, 6, 8, 12, 20, 30), (3, 8, 30)),
    "plates of one element": Axis(against_refined(scenes.blocks, 0.3), (1, 2, 3, 5, 10, 20), (1, 2, 5)),
    "four-bar from, rad": Axis(cases.through_flat, (1.5, 1.0, 0.5, 0.1, 0.0), (1.0, 0.0)),
    "held twice": Axis(
        cases.redundant_joints, cases.REDUNDANT, cases.REDUNDANT, ("alpha", "energy", "ggl2", "radau"), foreseen=cases.refused_as_redundant
    ),
    "pulse, s": Axis(cases.blow, (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8), (1e-2, 1e-4, 1e-8)),
    "driven collapse, Pa": Axis(
        against_refined(scenes.collapsing, 1.1), (50e6, 20e6, 10e6, 5e6, 2e6, 1e6), (50e6, 1e6), foreseen=cases.too_soft
    ),
    "pressure over modulus": Axis(
        cases.pressing, (0.05, 0.1, 0.15, 0.18, 0.2, 0.25, 0.5, 1.0), (0.1, 0.18, 0.25), foreseen=cases.beyond_the_material
    ),
    "viscosity, s": Axis(against_refined(scenes.damped, 0.3), (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1), (1e-6, 1e-3, 1e-1), slow=("ggl1",)),
    "own body beside": Axis(own.own_body_beside, own.BESIDE, own.BESIDE),
    "damping of modes": Axis(own.damped_oscillator, (0.1, 1.9, 2.5, 10.0, 1e3), (0.1, 10.0), ("any",)),
    "speed of a bicycle, m/s": Axis(own.bicycle, (5.0, 0.0), (5.0, 0.0), ("any",)),
    "reaction of": Axis(own.reaction_of, tuple(own.HOLDS), tuple(own.HOLDS)),
    "broken promise": Axis(own.promised, own.PROMISES, own.PROMISES, own.WITHOUT_POTENTIAL, foreseen=own.broken_promise),
    "no derivative": Axis(own.circled, own.DERIVATIVES, own.DERIVATIVES, own.WITHOUT_POTENTIAL, foreseen=own.no_derivative),
    "energy over potential": Axis(own.own_energy, (1.0, 1.001, 0.5, -1.0), (1.0, 0.5), foreseen=own.no_potential),
    "beside a ball, m": Axis(contacts.thrown_at_a_ball, (0.0, 0.004, 0.008, 0.0099), (0.0, 0.008)),
    "exponent of a contact": Axis(contacts.bouncing, (1.5, 1.0, 2.0), (1.5,)),
    "stiffness of a stop, N/m^1.5": Axis(contacts.pendulum_at_a_stop, (1e4, 1e5, 1e6, 1e7), (1e5,)),
    "plate at a stop, m/s": Axis(contacts.plate_at_a_stop, (1.0, 3.0), (1.0,)),
    "contacts at once": Axis(nonsmooth.many_contacts, (1, 5, 20, 50), (1, 20), nonsmooth.WAYS),
    "redundant contacts": Axis(nonsmooth.redundant_contacts, (1, 2, 5, 20), (1, 5), nonsmooth.WAYS, foreseen=nonsmooth.two_feet_stick),
    "friction": Axis(nonsmooth.friction, (0.3, 0.0, 1e-9, 1.0, 1e3, 1e9), (0.3, 0.0, 1e3), nonsmooth.WAYS),
    "restitution": Axis(nonsmooth.restitution, (0.5, 0.0, 1e-9, 0.99, 1.0), (0.0, 1.0), nonsmooth.WAYS),
    "bounces that end, e": Axis(nonsmooth.bounces_that_end, (0.5, 0.8, 0.1, 0.95), (0.5, 0.8), nonsmooth.WAYS),
    "mass of a ball that is hit": Axis(nonsmooth.masses, (1.0, 1e3, 1e-3, 1e6, 1e-6), (1.0, 1e6, 1e-6), nonsmooth.WAYS),
    "mass on a stack": Axis(nonsmooth.stacked, (1.0, 1e3, 1e-3, 1e6, 1e-6), (1.0, 1e6, 1e-6), nonsmooth.WAYS),
    "relaxation, s": Axis(states.relaxation, (1.0, 1e-2, 1e-4, 1e-6, 1e-9), (1e-2, 1e-6)),
    "sample period, s": Axis(states.samples, (0.1, 0.05, 1e-2, 1e-3, 3e-4, 0.3), (0.05, 3e-4)),
    "speed of a rolling disc, m/s": Axis(states.rolling, (1.0, 0.0, 1e-6, 30.0), (1.0, 0.0)),
    "steps": Axis(many_steps, (20_000, 100_000, 1_000_000), (20_000,), ("alpha", "energy")),
    "steps of those that choose them": Axis(many_steps, (2_000, 100_000), (2_000,), ("ggl2", "radau")),
    "kills of a run": Axis(killed_runs, (50,), (3,), ("alpha", "energy", "ggl2", "radau"), slow=("energy", "radau")),
    "kills of a sweep": Axis(killed_sweeps, (50,), (5,), ("any",)),
}


def tasks(quick):
    """One task for each value and integrator."""
    return [{"axis": title, "value": value, "integrator": name} for title, axis in AXES.items() for value, name in axis.tasks(quick)]


def run(axis, value, integrator):
    """The row of a task."""
    return outcome_of(AXES[axis].case, value, integrator, foreseen=AXES[axis].foreseen(value, integrator))


def meanings(titles):
    """Lines of text: what a correct run is on each axis."""
    return [f"{title}: {' '.join(AXES[title].case.__doc__.split())}" for title in titles]
