"""Forces of force elements and of users' bodies: C functions that kernels call by address, so that no kernel is compiled again.

A function that numba does not compile is called in Python by a callback (assembly/python_functions.py).
"""

from typing import NamedTuple

import numpy as np

from polyida.assembly import joints
from polyida.assembly.joints import point_value, spread_one
from polyida.errors import DONE
from polyida.jit import entry, leaf, pack, part
from polyida.jit.intrinsics import address, call
from polyida.model import differences
from polyida.model.states import FOUND, fill_algebraic

# columns of Laws.parts
FORCES = 0  # address of the C function of the forces
FIRST_SIDE = 1  # first side of the law
FIRST_NUMBER = 2  # first of its numbers
RATES = 3  # address of the C function of the rates of its states; 0 without
FIRST_STATE = 4  # first of its states with a rate and outputs of a controller
RATED = 5  # number of its states with a rate and of its algebraic states
FIRST_ALGEBRAIC = 6  # first of its algebraic states

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

    parts: np.ndarray  # (laws + 1, 7) columns FORCES to FIRST_ALGEBRAIC of each law; the last row holds only ends
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


@leaf
def count_of(laws, law, column):
    """Number of sides, states or algebraic states of a law: the difference of two entries in a column of first numbers."""
    return laws.parts[law + 1, column] - laws.parts[law, column]


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
    data = address(numbers) + 8 * laws.parts[law, FIRST_NUMBER]
    outputs = address(states) + 8 * laws.parts[law, RATED]
    if call(function, (data, 0, numbers, places, v, states, outputs, forces)) != DONE:
        forces[:] = np.nan


@part
def fill_states_of_law(laws, law, v, states):
    """Fill states in the order of the user's function: states with a rate, guesses of the algebraic states, outputs of a controller.

    The first and the last are read from v (sides, 2): the velocities of the last sides are the states over their units, two on each side.
    Returns the number of the sides before these.
    """
    first = laws.parts[law, FIRST_STATE]
    count = count_of(laws, law, FIRST_STATE)
    first_guess = laws.parts[law, FIRST_ALGEBRAIC]
    algebraic = count_of(laws, law, FIRST_ALGEBRAIC)
    differential = laws.parts[law, RATED] - algebraic
    own_sides = v.shape[0] - (count + 1) // 2
    for j in range(differential):
        states[j] = laws.states[first + j, 0] * v[own_sides + j // 2, j % 2]
    for j in range(algebraic):
        states[differential + j] = laws.guesses[first_guess + j, 0]
    for j in range(differential, count):
        states[algebraic + j] = laws.states[first + j, 0] * v[own_sides + j // 2, j % 2]
    return own_sides


@part
def solve_algebraic(laws, law, numbers, places, v, states, rates):
    """Solve for the algebraic states among `states`, which holds guesses of them, and fill rates with those at the solution.

    Returns True if a solution is found.
    """
    first_guess = laws.parts[law, FIRST_ALGEBRAIC]
    algebraic = count_of(laws, law, FIRST_ALGEBRAIC)
    sizes = laws.guesses[first_guess : first_guess + algebraic, 1]
    rated = laws.parts[law, RATED]
    function = laws.parts[law, RATES]
    data = address(numbers) + 8 * laws.parts[law, FIRST_NUMBER]
    outputs = address(states) + 8 * rated
    places_at, v_at = address(places), address(v)
    return fill_algebraic(function, data, address(numbers), places_at, v_at, outputs, states, rated - algebraic, sizes, rates) == FOUND


@part
def evaluate(laws, law, numbers, places, v, states, forces):
    """Fill forces (sides, 2), N, of a law at places and velocities v of its sides, (sides, 2).

    Sides that stand for states get `scale` times the rate of their states. Algebraic states are solved for first, and the rates are
    those of that solution; all forces are nan if there is none. states: workspace, as of `fill_states_of_law`.
    """
    own_sides = fill_states_of_law(laws, law, v, states)
    algebraic = count_of(laws, law, FIRST_ALGEBRAIC)
    differential = laws.parts[law, RATED] - algebraic
    first = laws.parts[law, FIRST_STATE]
    if algebraic > 0:
        rates = np.zeros(states.shape[0])
        if not solve_algebraic(laws, law, numbers, places, v, states, rates):
            forces[:] = np.nan
            return
    call_law(laws, laws.parts[law, FORCES], law, numbers, places, v, states, forces)
    if own_sides < v.shape[0]:
        forces[own_sides:] = 0.0
        if algebraic > 0:
            for j in range(differential):
                forces[own_sides + j // 2, j % 2] = rates[j]
        elif laws.parts[law, RATES] != 0:
            call_law(laws, laws.parts[law, RATES], law, numbers, places, v, states, forces[own_sides:])
        for j in range(differential):
            forces[own_sides + j // 2, j % 2] *= laws.states[first + j, 1]


@part
def energy_at(laws, law, numbers, places, v, states, forces):
    """The energy of a law, J, at places and velocities v of its sides; states and forces are workspace."""
    fill_states_of_law(laws, law, v, states)
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
    """Return (places x, velocities v, states, forces) of a law: x, v and forces (sides, 2); states and forces are workspace without values.

    moved, speeds: displacements and velocities of nodes, or of points if links is None.
    """
    first = laws.parts[law, FIRST_SIDE]
    count = count_of(laws, law, FIRST_SIDE)
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
    states = np.empty(count_of(laws, law, FIRST_STATE) + count_of(laws, law, FIRST_ALGEBRAIC))
    return x, v, states, sides[2]


@entry
def add_own_forces(laws, links, drives, moved, v, residual):
    """residual (nodes, 2) -= the forces of all laws at the displacements `moved` and velocities v, (nodes, 2).

    Returns True if the forces are finite.
    """
    numbers, finite = numbers_at(laws, drives), True
    for k in range(laws.parts.shape[0] - 1):
        x, speeds, states, force = place(laws, k, links, moved, v)
        evaluate(laws, k, numbers, x, speeds, states, force)
        for i in range(force.shape[0]):
            p = laws.points[laws.parts[k, FIRST_SIDE] + i]
            finite = finite and abs(force[i, 0]) + abs(force[i, 1]) < np.inf
            if p >= 0:
                spread_one(links, p, -force[i, 0], -force[i, 1], residual)
    return finite


@entry
def energies_and_powers(laws, links, drives, moved, v, step, out):
    """out (laws, 2): energy V, J, and power beyond it, `f . v + dV/dt`, W, of each law.

    moved, v: displacements and velocities of nodes. dV/dt is a central difference of fourth order, `step` times the size of the sides'
    coordinates along the motion.
    """
    numbers = numbers_at(laws, drives)
    for k in range(laws.parts.shape[0] - 1):
        x, speeds, states, rates = place(laws, k, links, moved, v)
        evaluate(laws, k, numbers, x, speeds, states, rates)
        power, pace = forces_to_rates(laws, k, speeds, rates)
        out[k, 0] = 0.0
        out[k, 1] = power
        if laws.energies[k] == 0:
            continue
        forces = rates.copy()
        out[k, 0] = energy_at(laws, k, numbers, x, speeds, states, forces)
        if pace > 0.0:
            out[k, 1] = add_energy_rate(laws, k, numbers, x, speeds, rates, step, pace, states, forces, power)


@part
def forces_to_rates(laws, law, v, forces):
    """Turn forces of `evaluate` into v', (sides, 2): 0 on the own sides of the law, and the rates of its states over `units`.

    Returns (power, pace): the sum of f . v over the own sides, W, and the largest rate of a side over its typical size, 1/s.
    """
    side = laws.parts[law, FIRST_SIDE]
    first = laws.parts[law, FIRST_STATE]
    count = count_of(laws, law, FIRST_STATE)
    own_sides = v.shape[0] - (count + 1) // 2
    power = pace = 0.0
    for i in range(v.shape[0]):
        for j in range(2):
            state = 2 * (i - own_sides) + j
            if i < own_sides:
                power += forces[i, j] * v[i, j]
                forces[i, j] = 0.0
                pace = max(pace, abs(v[i, j]) / laws.sizes[side + i])
            elif state < count:
                forces[i, j] /= laws.states[first + state, 0] * laws.states[first + state, 1]
                pace = max(pace, abs(forces[i, j]) / laws.sizes[side + i])
    return power, pace


@part
def add_energy_rate(laws, law, numbers, x, v, rates, step, pace, states, forces, total):
    """Return total + dV/dt of a law with x' = v and v' = rates, (sides, 2), by values of V at -2, -1, 1 and 2 times h = step / pace, s.

    The central difference of fourth order: `(8 (V(h) - V(-h)) - (V(2 h) - V(-2 h))) / (12 h)`. states, forces: workspace.
    """
    x_moved, v_moved = np.empty_like(x), np.empty_like(v)
    for e in range(4):
        d = e - 2 if e < 2 else e - 1  # -2, -1, 1, 2
        for i in range(x.shape[0]):
            for j in range(2):
                x_moved[i, j] = x[i, j] + d * step / pace * v[i, j]
                v_moved[i, j] = v[i, j] + d * step / pace * rates[i, j]
        weight = 2.0 / 3.0 * d if d * d == 1 else -d / 24.0
        total += weight * pace / step * energy_at(laws, law, numbers, x_moved, v_moved, states, forces)
    return total


@part
def take_midpoint_forces(laws, drives, dz0, dz1, vz, half, forces):
    """forces (points, 2) -= forces of all laws at the middle of a step, by a discrete gradient (Gonzalez 1996).

    dz0, dz1 (points, 2): displacements at both ends of the step; vz: velocities in the middle; half: half their change
    in the step. The work of a force from x0 to x1 is that of the law's energy V (`correct_work`). Returns True if they are finite.
    """
    numbers, finite = numbers_at(laws, drives), True
    for k in range(laws.parts.shape[0] - 1):
        x0, v, states, force = place(laws, k, None, dz0, vz)
        x1, change, _, static = place(laws, k, None, dz1, half)
        middle = np.empty(x0.shape)
        v0 = np.empty(x0.shape)
        v1 = np.empty(x0.shape)
        for i in range(x0.shape[0]):
            for j in range(2):
                middle[i, j] = 0.5 * (x0[i, j] + x1[i, j])
                v0[i, j] = v[i, j] - change[i, j]
                v1[i, j] = v[i, j] + change[i, j]
        evaluate(laws, k, numbers, middle, v, states, force)
        if laws.energies[k] != 0:
            correct_work(laws, k, numbers, x0, x1, middle, v0, v1, v, states, static, force)
        finite = subtract_sides(laws, k, force, forces) and finite
    return finite


@part
def correct_work(laws, law, numbers, x0, x1, middle, v0, v1, v, states, static, force):
    """Correct the force (sides, 2) of a law at the middle of a step, so that its work over the step is that of the law's energy V.

    The work of f over a step is f . dx, and V_0 - V_1 is wanted. So `f -= (V_1 - V_0 - V') d / (d . dx)`. V' of `energy_along` is the slope
    of V in the middle times dx, and d is the static force or dx (`corrects_along_force`). A difference V_1 - V_0 - V' within round-off of V
    counts as zero. With states s, V_i = V(x_i, s_i) - V(x, s_i), x in the middle: the states change V by V(x, s_1) - V(x, s_0).

    x0, x1, middle: places of the sides at both ends and in the middle; v0, v1, v: velocities there; all (sides, 2). v is set to zero on the
    own sides, and static is filled with the force in the middle at that velocity.
    """
    own_sides = x0.shape[0] - (count_of(laws, law, FIRST_STATE) + 1) // 2
    first = energy_at(laws, law, numbers, x0, v0, states, static)
    last = energy_at(laws, law, numbers, x1, v1, states, static)
    if own_sides < x0.shape[0]:
        first -= energy_at(laws, law, numbers, middle, v0, states, static)
        last -= energy_at(laws, law, numbers, middle, v1, states, static)
    for i in range(own_sides):
        v[i, 0] = v[i, 1] = 0.0
    evaluate(laws, law, numbers, middle, v, states, static)
    square = work = largest_work = 0.0  # dx . dx, f . dx, and the work over a motion as large as the coordinates
    for i in range(own_sides):
        for j in range(2):
            dx = x1[i, j] - x0[i, j]
            square += dx * dx
            work += static[i, j] * dx
            largest_work += abs(static[i, j] * middle[i, j])
    missing_work = last - first - energy_along(laws, law, numbers, x0, x1, middle, v, states, static, work)
    if square > 0.0 and not abs(missing_work) <= NOISE * max(abs(first), abs(last)):  # also if it is not a number
        along_force = law < laws.elements and corrects_along_force(missing_work, work, largest_work)
        for i in range(own_sides):
            for j in range(2):
                force[i, j] -= missing_work / work * static[i, j] if along_force else missing_work / square * (x1[i, j] - x0[i, j])


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
    """Return V' of a law, J: the slope of its energy in the middle times dx = x1 - x0.

    STATIC: minus the work of the static forces, those in the middle at zero velocity v. TIMELESS: the same if they are no others at another
    time, else central differences of V along dx (POINTS). ENERGIES: these always, because the static forces do work beyond V, or depend on
    states.
    """
    if laws.slopes[law] == STATIC:
        return -work
    if laws.slopes[law] == TIMELESS:
        later = np.empty_like(static)
        same = True
        now = numbers[0]
        numbers[0] = now + LATER
        evaluate(laws, law, numbers, middle, v, states, later)
        numbers[0] = now
        for i in range(static.shape[0]):
            same = same and static[i, 0] == later[i, 0] and static[i, 1] == later[i, 1]
        if same:
            return -work
    total = 0.0
    x = np.empty_like(middle)
    forces = np.empty_like(static)
    for e in range(len(POINTS)):
        for side in range(2):
            share = (1.0 - 2.0 * side) * POINTS[e][0]
            for i in range(x.shape[0]):
                for j in range(2):
                    x[i, j] = middle[i, j] + share * (x1[i, j] - x0[i, j])
            total += POINTS[e][1] / (2.0 * share) * energy_at(laws, law, numbers, x, v, states, forces)
    return total


@part
def corrects_along_force(missing_work, work, largest_work):
    """Return True if the correction of the work of a force element has the direction of its static force f; else it has that of dx.

    It has that of f only if it is at most ALONG f and the work is not round-off. Then it has the symmetries of f: forces of a pair are
    opposite, on the line at the middle, and a contact has no force along its line; so momenta are conserved. missing_work: of third order
    in dx. work: f . dx. largest_work: that of a motion as large as the coordinates.
    """
    return abs(missing_work) <= ALONG * abs(work) and abs(work) > RESOLVED * largest_work


@part
def subtract_sides(laws, law, force, forces):
    """forces[p] -= force[i] for the point p of each side i of a law; sides on the ground (p = -1) are left out.

    Returns True if force is finite.
    """
    finite = True
    for i in range(force.shape[0]):
        p = laws.points[laws.parts[law, FIRST_SIDE] + i]
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
        x, v, states, ahead = place(laws, k, None, dz, vz)
        _, direction, _, behind = place(laws, k, None, dz, moved)
        size = 0.0
        for i in range(direction.shape[0]):
            size = max(size, (abs(direction[i, 0]) + abs(direction[i, 1])) / laws.sizes[laws.parts[k, FIRST_SIDE] + i])
        if size > 0.0:
            step = STEP / size
            shift(v, step, direction)
            evaluate(laws, k, numbers, x, v, states, ahead)
            shift(v, -2.0 * step, direction)
            evaluate(laws, k, numbers, x, v, states, behind)
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
    """Blocks of the coupling -= `c_q df/dx + c_v df/dv` of all laws, c_q real.

    dz, vz (points, 2): displacements and velocities of the points.
    """
    numbers = numbers_at(laws, drives)
    for k in range(laws.parts.shape[0] - 1):
        sides = place(laws, k, None, dz, vz)
        blocks = coupling.laws[coupling.law_start[k] : coupling.law_start[k + 1]]
        add_slopes(laws, k, numbers, sides, c_q, c_v.real, 1.0, blocks, curvature)
        if c_v.imag != 0.0:
            add_slopes(laws, k, numbers, sides, 0.0, c_v.imag, (c_v - c_v.real) / c_v.imag, blocks, curvature)


@part
def add_slopes(laws, law, numbers, sides, c_q, c_v, unit, blocks, curvature):
    """curvature -= unit times the derivative of the forces of a law along (c_q, c_v) in (x, v) of each side, by central differences.

    sides: of `place`. blocks (sides^2,): block of the coupling of each pair of sides, row by row; -1 for a side on the ground.
    """
    x, v, states, ahead = sides
    behind = np.empty_like(ahead)
    first = laws.parts[law, FIRST_SIDE]
    count = x.shape[0]
    largest = max(abs(c_q), abs(c_v), 1.0)
    components = 2 * count - count_of(laws, law, FIRST_STATE) % 2  # an odd number of states leaves the last one unused
    for j in range(count):
        step = STEP * laws.sizes[first + j] / largest
        for e in range(min(2, components - 2 * j) if laws.points[first + j] >= 0 else 0):
            place, speed = x[j, e], v[j, e]
            x[j, e], v[j, e] = place + c_q * step, speed + c_v * step
            evaluate(laws, law, numbers, x, v, states, ahead)
            x[j, e], v[j, e] = place - c_q * step, speed - c_v * step
            evaluate(laws, law, numbers, x, v, states, behind)
            x[j, e], v[j, e] = place, speed
            for i in range(count):
                block = blocks[i * count + j]
                for k in range(2 if block >= 0 else 0):
                    curvature[block, k, e] -= unit * ((ahead[i, k] - behind[i, k]) / (2.0 * step))
