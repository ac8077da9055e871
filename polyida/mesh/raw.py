"""What readers of mesh files share: RawMesh before anything of it is checked, its unit, and a guard for untrusted files."""

import contextlib
import io
import threading
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from polyida.errors import InputError
from polyida.validation import is_number, is_one_of, named_keywords

METRES = {"m": 1.0, "dm": 0.1, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "ft": 0.3048}
WIDE = 20.0  # metres: a plate of a mechanism is hardly wider, one drawn in millimetres mostly is


@named_keywords
@dataclass(frozen=True, eq=False)
class RawMesh:
    """Points, cells and names as a file has them; `pi.mesh.read` repairs and checks them.

    points (n, 2) or (n, 3) in the file's unit; cells: lists of points by number, or arrays (m, k) of m cells of k corners;
    sections: name -> points; supports: point -> (x fixed, y fixed); loads: point -> (Fx, Fy), N; notes: what to tell the user;
    metres: of one unit, where the file says it; first: the number of the first point.
    """

    points: np.ndarray
    cells: Iterable
    sections: Mapping = field(default_factory=dict)
    supports: Mapping = field(default_factory=dict)
    loads: Mapping = field(default_factory=dict)
    notes: tuple = ()
    metres: float | None = None
    first: int = 0


def joined(cells):
    """(corners of all cells, offsets (m + 1)) of lists of points and of arrays of cells with the same number of corners."""
    blocks, number = [], 0
    for given in cells:
        table = _block(given, number)
        number += len(table)
        if table.size:
            blocks.append(table)
    if not blocks:
        raise InputError("holds no triangles, quads or polygons")
    sizes = np.concatenate([np.full(len(block), block.shape[1]) for block in blocks])
    nodes = np.concatenate([block.ravel() for block in blocks])
    return nodes, np.concatenate([[0], np.cumsum(sizes)])


def _block(given, number):
    try:
        array = np.atleast_2d(np.asarray(given))
    except ValueError:
        array = np.empty((0, 0, 0))
    whole = array.dtype.kind in "iu" or (array.dtype.kind == "f" and np.array_equal(array, np.round(array)))
    if array.ndim != 2 or not whole or (len(array) and array.shape[1] < 3) or np.abs(array).max(initial=0) > 2**31:
        raise InputError(f"cell {number} is {repr(given)[:80]}; it must be a list of at least 3 nodes by number")
    return array.astype(np.int64)


def require_range(nodes, offsets, n_points, first):
    """InputError for the first cell with a point that there is not; nodes from 0, first: the number of the first point."""
    outside = np.flatnonzero((nodes < 0) | (nodes >= n_points))
    if not outside.size:
        return
    cell = int(np.searchsorted(offsets, outside[0], side="right")) - 1
    from_one = first == 0 and nodes.min() == 1 and nodes.max() == n_points
    raise InputError(
        f"cell {cell} names point {nodes[outside[0]] + first}; there are points {first}..{n_points - 1 + first}"
        + ("; these cells count from 1, as first=1 of pi.mesh.from_lists takes them" if from_one else "")
    )


class MeshWarning(UserWarning):
    """What was changed in a mesh from elsewhere, or looks wrong in it."""


def metres(unit):
    """Metres of one unit, given by its name or as that number; InputError for anything else."""
    if is_one_of(unit, METRES):
        return METRES[unit]
    if is_number(unit) and unit > 0:
        return float(unit)
    raise InputError(f"unit is {unit!r}; it must be one of {', '.join(METRES)}, or the metres in one unit of the file")


def scale_of(unit, said):
    """Metres of one unit: as the user says, else as the file does (`said`), else one."""
    return metres(unit) if unit is not None else said or 1.0


def hint(points, unit, said):
    """[what to ask the user] where nobody said the unit and the points span so much that they may be millimetres."""
    width = float(np.ptp(points, axis=0).max())
    if unit is not None or said is not None or width <= WIDE:
        return []
    return [f"it is {width:.6g} m wide; if its numbers are millimetres pass unit='mm', if they are metres unit='m'"]


_ONE_AT_A_TIME = threading.Lock()  # what is redirected and limited below belongs to the whole process


@contextlib.contextmanager
def quiet():
    """Everything printed inside goes to the yielded StringIO, warnings are dropped."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield said


@contextlib.contextmanager
def bounded_memory(extra):
    """MemoryError for allocations beyond `extra` bytes above what the process uses now; nothing where unsupported."""
    try:
        import resource

        with open("/proc/self/statm", encoding="ascii") as statm:
            used = int(statm.read().split()[0]) * resource.getpagesize()
        soft, hard = resource.getrlimit(resource.RLIMIT_AS)
        bounds = [bound for bound in (used + extra, soft, hard) if bound != resource.RLIM_INFINITY]
        resource.setrlimit(resource.RLIMIT_AS, (min(bounds), hard))
    except (ImportError, OSError, ValueError):
        yield
        return
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


@contextlib.contextmanager
def guarded(file_size):
    """quiet() and bounded_memory() of 2 GiB and 200 times the file, under a lock."""
    with _ONE_AT_A_TIME, bounded_memory(2**31 + 200 * file_size), quiet() as said:
        yield said
