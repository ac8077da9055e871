"""One case, run where the executor puts it: its row of plain values, with what it cost."""

import os
import sys
import time
from contextlib import suppress
from copy import deepcopy

from polyida.errors import InputError
from polyida.study.sweeps.isolation import attempt

COSTS = ("cpu_s", "wall_s", "memory_mb")
RESERVED = ("error", *COSTS)
KIB, MIB = 2.0**10, 2.0**20


def measured(function, arguments, sweep_id):
    """The row of `function(**arguments)`: what it gave, "error", cpu_s of this process, wall_s and memory_mb, see `sweep`.

    sweep_id: another one in every sweep: a scheduler that has seen a call before (Dask) would give its old row.
    """
    fresh = _forget_peak()
    wall, cpu = time.perf_counter(), time.process_time()
    row = attempt(_checked, {"function": function, "arguments": deepcopy(arguments)})  # what it does to its case is its own
    costs = {"cpu_s": time.process_time() - cpu, "wall_s": time.perf_counter() - wall, "memory_mb": _peak(fresh)}
    return {name: value for name, value in row.items() if name != "error"} | {"error": row["error"]} | costs


def _checked(function, arguments):
    """What a case gave, as plain values under names of their own."""
    found = function(**arguments)
    if not isinstance(found, dict):
        raise InputError(f"the function gave {_short(found)}; it must give a dictionary {{name: number, text or list of them}}")
    found = plain("what the function gave", found)
    for name, value in found.items():
        if name in RESERVED:
            raise InputError(f"the function gave {name!r}, which is the row's own; call it otherwise")
        if name in arguments and value != plain(name, arguments[name]):
            raise InputError(f"the function gave {name!r}, which is the case's own, with another value; call it otherwise")
    return found


def plain(what, value):
    """A value as JSON holds it: numpy's numbers and arrays as numbers and lists, paths as texts. Raises InputError for anything else."""
    if value is None or isinstance(value, (bool, str)) or type(value) in (int, float):
        return value
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if hasattr(value, "dtype") and hasattr(value, "tolist"):
        return plain(what, value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(f"{what}[{k}]", entry) for k, entry in enumerate(value)]
    if isinstance(value, dict) and all(isinstance(name, str) for name in value):
        return {name: plain(f"{what}[{name!r}]", entry) for name, entry in value.items()}
    raise InputError(
        f"{what} = {_short(value)} is no plain value; those are numbers, texts, True, False, None, and lists and dictionaries of them"
    )


def _short(value):
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:60]}... (a {type(value).__name__})"


def _forget_peak():
    """Let the system measure this process's largest memory from now on; whether it does (Linux alone)."""
    with suppress(OSError), open("/proc/self/clear_refs", "w") as file:
        file.write("5")
        return True
    return False


def _peak(fresh):
    """Largest resident memory of this process since it was forgotten, MB, or since the process began where it was not; None if unknown."""
    if fresh:
        with suppress(OSError, ValueError, StopIteration), open("/proc/self/status") as lines:
            return float(next(line for line in lines if line.startswith("VmHWM")).split()[1]) * KIB / MIB
    with suppress(ImportError):
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (MIB if sys.platform == "darwin" else KIB)
    return None
