"""Forces of force elements and of users' bodies: C functions that kernels call by address, so that no kernel is compiled again.

A function that numba does not compile is called in Python by a callback (assembly/python_functions.py).
"""

from typing import NamedTuple

import numpy as np

from polyida.assembly import joints
from polyida.assembly.joints import point_value, spread_one
from polyida.errors import DONE
from polyida.jit import entry, pack, part
from polyida.jit.intrinsics import address, call
from polyida.model import differences
from polyida.model.states import FOUND, fill_algebraic

# constants of compiled code
STATIC, TIMELESS, ENERGIES = range(3)  # from what the discrete gradient of a law takes the slope of its energy, see `energy_along`
NOISE = 32 * 2.0**-52  # relative difference of energies that is round-off
STEP = 1e-7  # relative step of central differences: small, because contact forces change over small distances
ALONG = 2.0  # of the force: largest correction along the force itself
RESOLVED = 1e-6  # of force times size: smaller work of the force has too much round-off to divide by
# V' by a central difference of sixth order, (s of dq, weight of (V(s) - V(-s)) / (2 s)): nearer values have more round-off
POINTS = ((1 / 32, 64 / 45), (1 / 16, -20 / 45), (1 / 8, 1 / 45))
LATER = differences.LATER


@pack
class Laws(NamedTuple):
    """The force laws of a scene: one for each force element, and for each elastic body of a user."""

    # (laws + 1, 7) of each law: address of the forces, first side, first of its numbers, address of the rates, first state, how many rates it
    # has, and first algebraic state; the last row is the ends. s are its states, algebraic states, and outputs of a controller
    parts: np.ndarray
    states: np.ndarray  # (states, 2) `units` and `scale` of PlacedStates; the last sides of a law are its states, two each
    guesses: np.ndarray  # (algebraic states, 2) where Newton's method begins, and typical size
    points: np.ndarray  # point of each side; -1 on the ground
    rest: np.ndarray  # (sides, 2) places of the sides at rest, m
    sizes: np.ndarray  # (sides,) typical size of each side's coordinates
    energies: np.ndarray  # (laws,) address of the energy; 0 without
    slopes: np.ndarray  # (laws,) STATIC, TIMELESS or ENERGIES
    elements: int  # number of laws of force elements, which come first
    numbers: np.ndarray  # the time, then the words that the functions read as self
    driven: np.ndarray  # (values, 2) index among the numbers of a drive's value, and number of the drive
    clock: int  # number of the drive that is the time; -1 without laws


@part
def numbers_at(laws, drives):
    """The numbers of all laws at the time of the drives."""
    numbers = laws.numbers.copy()
    numbers[0] = drives[laws.clock, 0]
    for i in range(laws.driven.shape[0]):
        numbers[laws.driven[i, 0]] = drives[laws.driven[i, 1], 0]
    return numbers


@part
def call_law(laws, function, law, numbers, places, v, states, forces):
    """Fill forces by a C function of a law at places, velocities v and states; nan if it raises or returns another shape."""
    data = address(numbers) + 8 * laws.parts[law, 2]
    outputs = address(states) + 8 * laws.parts[law, 5]
    if call(function, (data, 0, numbers, places, v, states, outputs, forces)) != DONE:
        forces[:] = np.nan


@part
def states_of(laws, law, v, states):
    """Fill the states of a law, from the velocities v (sides, 2) of its sides, and guesses of the algebraic ones.

    Returns the number of its other sides.
    """
    first, count = laws.parts[law, 4], laws.parts[law + 1, 4] - laws.parts[law, 4]
    guess, free = laws.parts[law, 6], laws.parts[law + 1, 6] - laws.parts[law, 6]
    own, begin = v.shape[0] - (count + 1) // 2, laws.parts[law, 5] - free
    for j in range(count):
        states[j if j < begin else j + free] = laws.states[first + j, 0] * v[own + j // 2, j % 2]
    for j in range(free):
        states[begin + j] = laws.guesses[guess + j, 0]
    return own


@part
def evaluate(laws, law, numbers, places, v, states, forces):
    """Fill forces (sides, 2), N, with the forces of a law, on its states as of PlacedStates; states, like forces, is workspace."""
    own, free = states_of(laws, law, v, states), laws.parts[law + 1, 6] - laws.parts[law, 6]
    first, rated = laws.parts[law, 4], laws.parts[law, 5]
    if free > 0:
        rates, guess, outputs = np.zeros(states.shape[0]), laws.parts[law, 6], address(states) + 8 * rated
        data, sizes = address(numbers) + 8 * laws.parts[law, 2], laws.guesses[guess : guess + free, 1]
        given = address(numbers), address(places), address(v), outputs
        if fill_algebraic(laws.parts[law, 3], data, given[0], given[1], given[2], given[3], states, rated - free, sizes, rates) != FOUND:
            forces[:] = np.nan
            return
    call_law(laws, laws.parts[law, 0], law, numbers, places, v, states, forces)
    if own < v.shape[0]:
        forces[own:] = 0.0
        if free > 0:
            for j in range(rated - free):
                forces[own + j // 2, j % 2] = rates[j]
        elif laws.parts[law, 3] != 0:
            call_law(laws, laws.parts[law, 3], law, numbers, places, v, states, forces[own:])
        for j in range(rated - free):
            forces[own + j // 2, j % 2] *= laws.states[first + j, 1]


@part
def energy_at(laws, law, numbers, places, v, states, forces):
    """The energy of a law at places and velocities v; states and forces are workspace."""
    states_of(laws, law, v, states)
    call_law(laws, laws.energies[law], law, numbers, places, v, states, forces)
    return forces[0, 0]


@part
def point_of(links, moved, point):
    """A moved at a point; moved itself holds the values of points if links is None."""
    if links is None:
        return moved[point, 0], moved[point, 1]
    return point_value(links, moved, point)


@part
def place(laws, law, links, moved, speeds):
    """Places x and velocities v of the sides of a law, and workspaces for its states and forces; from displacements and velocities of nodes,
    or of points if links is None."""
    first, count = laws.parts[law, 1], laws.parts[law + 1, 1] - laws.parts[law, 1]
    sides = np.empty((3, count, 2))  # one array: making three would cost more than a force
    x, v = sides[0], sides[1]
    for i in range(count):
        p = laws.points[first + i]
        x[i, 0], x[i, 1], v[i, 0], v[i, 1] = laws.rest[first + i, 0], laws.rest[first + i, 1], 0.0, 0.0
        if p >= 0:
            dx, dy = point_of(links, moved, p)
            x[i, 0] += dx
            x[i, 1] += dy
            v[i, 0], v[i, 1] = point_of(links, speeds, p)
    return x, v, np.empty(laws.parts[law + 1, 4] - laws.parts[law, 4] + laws.parts[law + 1, 6] - laws.parts[law, 6]), sides[2]


@entry
def add_own_forces(laws, links, drives, moved, v, residual):
    """residual (nodes, 2) -= the forces of all laws at the displacements `moved` and velocities v, (nodes, 2). Returns True if they are finite."""
    numbers, finite = numbers_at(laws, drives), True
    for k in range(laws.parts.shape[0] - 1):
        x, speeds, s, f = place(laws, k, links, moved, v)
        evaluate(laws, k, numbers, x, speeds, s, f)
        for i in range(f.shape[0]):
            p = laws.points[laws.parts[k, 1] + i]
            finite = finite and abs(f[i, 0]) + abs(f[i, 1]) < np.inf
            if p >= 0:
                spread_one(links, p, -f[i, 0], -f[i, 1], residual)
    return finite


@entry
def energies_and_powers(laws, links, drives, moved, v, step, out):
    """out (laws, 2): energy, J, and work beyond it, `f . v + dE/dt`, W, of each law at the displacements `moved` and velocities v of nodes.

    dE/dt is a central difference of fourth order, `step` times the size of the sides' coordinates along the motion.
    """
    numbers = numbers_at(laws, drives)
    for k in range(laws.parts.shape[0] - 1):
        x, speeds, s, rates = place(laws, k, links, moved, v)
        evaluate(laws, k, numbers, x, speeds, s, rates)
        side, first, states = laws.parts[k, 1], laws.parts[k, 4], laws.parts[k + 1, 4] - laws.parts[k, 4]
        own, power, pace, there, then, f = x.shape[0] - (states + 1) // 2, 0.0, 0.0, x.copy(), speeds.copy(), rates.copy()
        for i in range(x.shape[0]):
            for j in range(2):
                state = 2 * (i - own) + j
                if i < own:
                    power += rates[i, j] * speeds[i, j]
                    rates[i, j] = 0.0
                    pace = max(pace, abs(speeds[i, j]) / laws.sizes[side + i])
                elif state < states:
                    rates[i, j] /= laws.states[first + state, 0] * laws.states[first + state, 1]
                    pace = max(pace, abs(rates[i, j]) / laws.sizes[side + i])
        out[k, 0], out[k, 1] = 0.0, power
        if laws.energies[k] == 0:
            continue
        out[k, 0] = energy_at(laws, k, numbers, x, speeds, s, f)
        for e in range(4 if pace > 0.0 else 0):
            d = e - 2 if e < 2 else e - 1
            for i in range(x.shape[0]):
                for j in range(2):
                    there[i, j], then[i, j] = x[i, j] + d * step / pace * speeds[i, j], speeds[i, j] + d * step / pace * rates[i, j]
            weight = 2.0 / 3.0 * d if d * d == 1 else -d / 24.0
            out[k, 1] += weight * pace / step * energy_at(laws, k, numbers, there, then, s, f)


@part
def take_midpoint_forces(laws, drives, dz0, dz1, vz, half, forces):
    """forces (points, 2) -= forces of all laws at the middle of a step of the points from dz0 to dz1, by a discrete gradient (Gonzalez 1996).

    vz: velocities in the middle; half: half their change in the step. The work of a force from x0 to x1 is that of the law's energy V
    (`correct_work`). Returns True if they are finite.
    """
    numbers, finite = numbers_at(laws, drives), True
    for k in range(laws.parts.shape[0] - 1):
        x0, v, s, f = place(laws, k, None, dz0, vz)
        x1, change, _, static = place(laws, k, None, dz1, half)
        middle, v0, v1 = np.empty(x0.shape), np.empty(x0.shape), np.empty(x0.shape)
        for i in range(x0.shape[0]):
            for j in range(2):
                middle[i, j] = 0.5 * (x0[i, j] + x1[i, j])
                v0[i, j], v1[i, j] = v[i, j] - change[i, j], v[i, j] + change[i, j]
        evaluate(laws, k, numbers, middle, v, s, f)
        if laws.energies[k] != 0:
            correct_work(laws, k, numbers, x0, x1, middle, v0, v1, v, s, static, f)
        finite = subtract_sides(laws, k, f, forces) and finite
    return finite


@part
def correct_work(laws, law, numbers, x0, x1, middle, v0, v1, v, states, static, force):
    """Subtract `[V_1 - V_0 - V'] d / (d^T dx)` from the force of a law at the middle of a step: its work is then that of the energy V.

    V' is as of `energy_along`, d as of `is_along`. A bracket within round-off of V counts as zero. With states, V_i = V(x_i, s_i) - V(x, s_i),
    x in the middle: the states change V by V(x, s_1) - V(x, s_0). v is set to zero, static to the force there.
    """
    own = x0.shape[0] - (laws.parts[law + 1, 4] - laws.parts[law, 4] + 1) // 2
    first, last = energy_at(laws, law, numbers, x0, v0, states, static), energy_at(laws, law, numbers, x1, v1, states, static)
    if own < x0.shape[0]:
        first -= energy_at(laws, law, numbers, middle, v0, states, static)
        last -= energy_at(laws, law, numbers, middle, v1, states, static)
    for i in range(own):
        v[i, 0] = v[i, 1] = 0.0
    evaluate(laws, law, numbers, middle, v, states, static)
    size = work = most = 0.0
    for i in range(own):
        for j in range(2):
            dx = x1[i, j] - x0[i, j]
            size += dx * dx
            work += static[i, j] * dx
            most += abs(static[i, j] * middle[i, j])
    bracket = last - first - energy_along(laws, law, numbers, x0, x1, middle, v, states, static, work)
    if size > 0.0 and not abs(bracket) <= NOISE * max(abs(first), abs(last)):  # also if it is not a number
        along = law < laws.elements and is_along(bracket, work, most)
        for i in range(own):
            for j in range(2):
                force[i, j] -= bracket / work * static[i, j] if along else bracket / size * (x1[i, j] - x0[i, j])


@entry
def add_midpoint_forces(laws, links, drives, h, states, residual):
    """Add the forces of `take_midpoint_forces` to residual; states: as of the middle of a step, energy/tables.py."""
    points = np.zeros((5, links.point_mass.shape[0], 2))
    joints.point_values(links, states[0], points[0])
    joints.point_values(links, states[1], points[1])
    joints.point_values(links, states[3], points[2])
    joints.point_values(links, states[4], points[3])
    for p in range(points.shape[1]):
        for k in range(2):
            points[3, p, k] *= 0.5 * h
    take_midpoint_forces(laws, drives, points[0], points[1], points[2], points[3], points[4])
    joints.spread(links, points[4], residual)


@part
def energy_along(laws, law, numbers, x0, x1, middle, v, states, static, work):
    """V' of a law: the slope of its energy in the middle times x1 - x0.

    STATIC: minus the work of the static forces, those in the middle at zero velocity v. TIMELESS: the same if they are no others at another time,
    else differences of V. ENERGIES: these always, because the static forces do work beyond V, or depend on states.
    """
    if laws.slopes[law] == STATIC:
        return -work
    if laws.slopes[law] == TIMELESS:
        now, later, same = numbers[0], np.empty_like(static), True
        numbers[0] = now + LATER
        evaluate(laws, law, numbers, middle, v, states, later)
        numbers[0] = now
        for i in range(static.shape[0]):
            same = same and static[i, 0] == later[i, 0] and static[i, 1] == later[i, 1]
        if same:
            return -work
    total, x, f = 0.0, np.empty_like(middle), np.empty_like(static)
    for e in range(len(POINTS)):
        for side in range(2):
            share = (1.0 - 2.0 * side) * POINTS[e][0]
            for i in range(x.shape[0]):
                for j in range(2):
                    x[i, j] = middle[i, j] + share * (x1[i, j] - x0[i, j])
            total += POINTS[e][1] / (2.0 * share) * energy_at(laws, law, numbers, x, v, states, f)
    return total


@part
def is_along(bracket, work, most):
    """True if a force element's discrete force corrects the work of its force at the middle along this force, and not along dx.

    Then it has the symmetries of that force: forces of a pair are opposite, on the line at the middle, and a contact has no force along its
    line; so momenta are conserved. The bracket is of third order in dx. work: f . dx; most: that of a motion as large as the coordinates.
    """
    return abs(bracket) <= ALONG * abs(work) and abs(work) > RESOLVED * most


@part
def subtract_sides(laws, law, force, forces):
    """forces -= force at the points of law k's sides. Returns True if they are finite."""
    finite = True
    for i in range(force.shape[0]):
        p = laws.points[laws.parts[law, 1] + i]
        finite = finite and abs(force[i, 0]) + abs(force[i, 1]) < np.inf
        if p >= 0:
            forces[p, 0] -= force[i, 0]
            forces[p, 1] -= force[i, 1]
    return finite


@part
def take_damping_forces(laws, drives, dz, vz, moved, forces):
    """forces (points, 2) += C moved, C the derivative of -f in the velocities of the points at displacements dz and velocities vz."""
    numbers = numbers_at(laws, drives)
    for k in range(laws.parts.shape[0] - 1):
        x, v, s, ahead = place(laws, k, None, dz, vz)
        _, d, _, behind = place(laws, k, None, dz, moved)
        size = 0.0
        for i in range(d.shape[0]):
            size = max(size, (abs(d[i, 0]) + abs(d[i, 1])) / laws.sizes[laws.parts[k, 1] + i])
        if size > 0.0:
            step = STEP / size
            shift(v, step, d)
            evaluate(laws, k, numbers, x, v, s, ahead)
            shift(v, -2.0 * step, d)
            evaluate(laws, k, numbers, x, v, s, behind)
            for i in range(ahead.shape[0]):
                for j in range(2):
                    ahead[i, j] = (ahead[i, j] - behind[i, j]) / (2.0 * step)
            subtract_sides(laws, k, ahead, forces)


@part
def shift(places, factor, direction):
    """places += factor direction, (sides, 2)."""
    for i in range(places.shape[0]):
        for j in range(2):
            places[i, j] += factor * direction[i, j]


@entry
def add_own_curvature(laws, coupling, drives, dz, vz, c_q, c_v, curvature):
    """Blocks of the coupling -= `c_q df/dx + c_v df/dv` of all laws, c_q real; dz, vz (points, 2): displacements and velocities of the points."""
    numbers = numbers_at(laws, drives)
    for k in range(laws.parts.shape[0] - 1):
        sides, blocks = place(laws, k, None, dz, vz), coupling.laws[coupling.law_start[k] : coupling.law_start[k + 1]]
        add_slopes(laws, k, numbers, sides, c_q, c_v.real, 1.0, blocks, curvature)
        if c_v.imag != 0.0:
            add_slopes(laws, k, numbers, sides, 0.0, c_v.imag, (c_v - c_v.real) / c_v.imag, blocks, curvature)


@part
def add_slopes(laws, law, numbers, sides, c_q, c_v, unit, blocks, curvature):
    """curvature -= unit times the derivative of the forces of a law along (c_q, c_v) in (x, v) of each side, by central differences."""
    x, v, s, ahead = sides
    first, count, behind, most = laws.parts[law, 1], x.shape[0], np.empty_like(ahead), max(abs(c_q), abs(c_v), 1.0)
    own = 2 * count - (laws.parts[law + 1, 4] - laws.parts[law, 4]) % 2  # an odd number of states leaves a component unused
    for j in range(count):
        step = STEP * laws.sizes[first + j] / most
        for e in range(min(2, own - 2 * j) if laws.points[first + j] >= 0 else 0):
            place, speed = x[j, e], v[j, e]
            x[j, e], v[j, e] = place + c_q * step, speed + c_v * step
            evaluate(laws, law, numbers, x, v, s, ahead)
            x[j, e], v[j, e] = place - c_q * step, speed - c_v * step
            evaluate(laws, law, numbers, x, v, s, behind)
            x[j, e], v[j, e] = place, speed
            for i in range(count):
                block = blocks[i * count + j]
                for a in range(2 if block >= 0 else 0):
                    curvature[block, a, e] -= unit * ((ahead[i, a] - behind[i, a]) / (2.0 * step))
