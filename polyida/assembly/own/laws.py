"""Forces of one's own that are compiled: C functions, called by their addresses, so that no kernel is made anew for a user's formula."""

from functools import cache, update_wrapper
from types import FunctionType
from typing import NamedTuple

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from polyida.assembly.rows.joints import point_values, spread
from polyida.jit import cache as kernel_cache
from polyida.jit import entry, pack, part

NUMBERS = types.CPointer(types.float64)
CALLED = types.void(types.float64, NUMBERS, NUMBERS, NUMBERS, NUMBERS, types.int64, types.int64)  # t, x, v, data, f, sides, len(data)
NO_ENERGY = -1
NOISE = 32 * 2.0**-52  # of an energy: a difference of less is none
STEP = 1e-7  # of the size of what is varied, in central differences: short, for forces of contact change within little


@pack
class Laws(NamedTuple):
    """A scene's force elements by number: address, first side and first of its `numbers`, (laws + 1, 3), the last row the ends.

    points: the point of links of each side, -1 where it stays with the ground; rest: places of the sides, (sides, 2), m; sizes: of what
    each says, (sides,). energies: address of each law's energy, (laws,), 0 where it has none, NO_ENERGY where that is Python. driven: which of the numbers are a drive's value, and which drive, (values, 2). clock: the drive that is the time.
    """

    parts: np.ndarray
    points: np.ndarray
    rest: np.ndarray
    sizes: np.ndarray
    energies: np.ndarray
    numbers: np.ndarray
    driven: np.ndarray
    clock: int


@cache
def callback_of(law, template=None):
    """`law(t, x, v, data, f)`, a function of numba's, as a C function; kept, for its address is in use, polyida's own in files too."""
    own, at = law.py_func.__module__.startswith("polyida."), law.py_func.__code__
    code = (template or _called).__code__.replace(co_filename=at.co_filename, co_firstlineno=at.co_firstlineno)
    called = update_wrapper(FunctionType(code, {"law": law, "numba": numba, "np": np}), law.py_func)
    del called.__wrapped__
    with kernel_cache.kept() as cached:
        return numba.cfunc(CALLED, cache=own and cached)(called)


def _called(t, x, v, data, f, sides, count):
    shape = (sides, 2)
    forces = numba.carray(f, shape)
    try:
        law(t, numba.carray(x, shape).copy(), numba.carray(v, shape).copy(), numba.carray(data, (count,)).copy(), forces)  # noqa: F821
    except Exception:  # noqa: BLE001 which kernels cannot hand on: the motion is not finite
        forces[:] = np.nan


def energy_callback(energy):
    """`energy(x, data)` as a C function of the same signature, which fills the first of f."""
    return callback_of(energy, _called_energy)


def _called_energy(t, x, v, data, f, sides, count):
    shape = (sides, 2)
    found = numba.carray(f, (1,))
    try:
        found[0] = law(numba.carray(x, shape).copy(), numba.carray(data, (count,)).copy())  # noqa: F821
    except Exception:  # noqa: BLE001 as above
        found[0] = np.nan


@intrinsic
def call(typing, address, t, x, v, data, f, sides, count):
    """Call the C function at an address."""

    def emit(context, builder, _, given):
        where, t, *arrays = given[:6]
        data = [context.make_array(kind)(context, builder, array).data for kind, array in zip((x, v, numbers, f), arrays)]
        pointer = ir.DoubleType().as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [ir.DoubleType(), *[pointer] * 4, *[ir.IntType(64)] * 2])
        builder.call(builder.inttoptr(where, kind.as_pointer()), [t, *data, *given[6:]])
        return context.get_dummy_value()

    numbers = data
    return types.void(types.int64, types.float64, x, v, data, f, types.int64, types.int64), emit


@part
def numbers_at(laws, drives):
    """The numbers of all laws at a time."""
    numbers = laws.numbers.copy()
    for i in range(laws.driven.shape[0]):
        numbers[laws.driven[i, 0]] = drives[laws.driven[i, 1], 0]
    return numbers


@part
def evaluate(laws, k, t, numbers, x, v, f):
    """Fill f (sides, 2), N, with the forces of law k at the places x and velocities v; nan where it writes nothing."""
    f[:] = np.nan
    ask(laws, k, laws.parts[k, 0], t, numbers, x, v, f)


@part
def ask(laws, k, function, t, numbers, x, v, f):
    """Call a C function of law k."""
    first, end = laws.parts[k, 2], laws.parts[k + 1, 2]
    call(function, t, x, v, numbers[first:end], f, x.shape[0], end - first)


@part
def energy_at(laws, k, numbers, x, f):
    """The energy of law k at places x; f is scratch."""
    ask(laws, k, laws.energies[k], 0.0, numbers, x, x, f)
    return f[0, 0]


@part
def place(laws, k, dz, vz):
    """x and v of the sides of law k at displacements dz and velocities vz of the points, and room for its forces."""
    first, count = laws.parts[k, 1], laws.parts[k + 1, 1] - laws.parts[k, 1]
    x, v = laws.rest[first : first + count].copy(), np.zeros((count, 2))
    for i in range(count):
        p = laws.points[first + i]
        if p >= 0:
            for e in range(2):
                x[i, e] += dz[p, e]
                v[i, e] = vz[p, e]
    return x, v, np.empty((count, 2))


@entry
def add_own_forces(laws, links, drives, u, v, r):
    """r (nodes, 2) -= the forces of all laws at displacements u and velocities v, (nodes, 2)."""
    dz, vz, forces = np.zeros((3, links.point_mass.shape[0], 2))
    point_values(links, u, dz)
    point_values(links, v, vz)
    numbers = numbers_at(laws, drives)
    for k in range(laws.parts.shape[0] - 1):
        x, speeds, f = place(laws, k, dz, vz)
        evaluate(laws, k, drives[laws.clock, 0], numbers, x, speeds, f)
        take_sides(laws, k, f, forces)
    spread(links, forces, r)


@part
def take_missing(laws, k, t, numbers, x0, x1, middle, f):
    """f -= `[V_1 - V_0 - V'] dx / (dx^T dx)`, with which the work of f from x0 to x1 is that of law k's energy V (Gonzalez 1996).

    V' is what the forces at the middle do where nothing moves. What is no more than round-off of V is none.
    """
    dx, held = x1 - x0, np.empty_like(f)
    first, last = energy_at(laws, k, numbers, x0, held), energy_at(laws, k, numbers, x1, held)
    evaluate(laws, k, t, numbers, middle, np.zeros_like(f), held)
    size, bracket = np.sum(dx * dx), last - first + np.sum(held * dx)
    if size > 0.0 and abs(bracket) > NOISE * max(abs(first), abs(last)):
        f -= bracket / size * dx


@part
def take_midpoint_forces(laws, drives, dz0, dz1, vz, forces):
    """forces (points, 2) -= those of all laws at the middle of a step from displacements dz0 of the points to dz1, by the discrete derivative."""
    numbers, t = numbers_at(laws, drives), drives[laws.clock, 0]
    for k in range(laws.parts.shape[0] - 1):
        x0, v, f = place(laws, k, dz0, vz)
        x1, _, _ = place(laws, k, dz1, vz)
        middle = 0.5 * (x0 + x1)
        evaluate(laws, k, t, numbers, middle, v, f)
        if laws.energies[k] != 0:
            take_missing(laws, k, t, numbers, x0, x1, middle, f)
        take_sides(laws, k, f, forces)


@part
def take_sides(laws, k, f, forces):
    """forces -= f at the points of law k's sides."""
    for i in range(f.shape[0]):
        p = laws.points[laws.parts[k, 1] + i]
        if p >= 0:
            forces[p, 0] -= f[i, 0]
            forces[p, 1] -= f[i, 1]


@entry
def add_own_curvature(laws, coupling, drives, dz, vz, c_q, c_v, curvature):
    """Blocks of the coupling -= `c_q df/dx + c_v df/dv` of all laws; dz, vz (points, 2) move the points."""
    numbers = numbers_at(laws, drives)
    for k in range(laws.parts.shape[0] - 1):
        x, v, ahead = place(laws, k, dz, vz)
        behind, blocks = np.empty_like(ahead), coupling.laws[coupling.law_start[k] : coupling.law_start[k + 1]]
        if c_q != 0.0:
            add_slopes(laws, k, drives[laws.clock, 0], numbers, x, v, x, c_q, ahead, behind, blocks, curvature)
        if c_v != 0.0:
            add_slopes(laws, k, drives[laws.clock, 0], numbers, x, v, v, c_v, ahead, behind, blocks, curvature)


@part
def add_slopes(laws, k, t, numbers, x, v, varied, c, ahead, behind, blocks, curvature):
    """curvature -= c times the derivative of the forces of law k in `varied`, which is x or v, by central differences."""
    first, count = laws.parts[k, 1], x.shape[0]
    for j in range(count):
        step = STEP * laws.sizes[first + j]
        for e in range(2 if laws.points[first + j] >= 0 else 0):
            middle = varied[j, e]
            varied[j, e] = middle + step
            evaluate(laws, k, t, numbers, x, v, ahead)
            varied[j, e] = middle - step
            evaluate(laws, k, t, numbers, x, v, behind)
            varied[j, e] = middle
            for i in range(count):
                block = blocks[i * count + j]
                for a in range(2 if block >= 0 else 0):
                    curvature[block, a, e] -= c * (ahead[i, a] - behind[i, a]) / (2.0 * step)
