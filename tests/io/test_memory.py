"""Frames in memory: written once, where they stay, and in memory that is used again."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import polyida as pi
from polyida import environment
from polyida.problems import plates

FRAMES = ("t", "q", "v", "a", "lam")
METHODS = {
    "fixed": pi.GeneralizedAlpha(h=1e-3),
    "adaptive": pi.GeneralizedAlpha(h=4e-3, rtol=1e-5),
    "extrapolated": pi.GeneralizedAlpha(h=2e-3, extrapolate=True),
    "plain loop": pi.GeneralizedAlpha(h=4e-3, linear="kkt"),
    "stabilised": pi.GeneralizedAlpha(h=1e-3, form="stabilised"),
    "energy": pi.EnergyMomentum(h=2e-3),
    "ida": pi.IDA(rtol=1e-4),
    "radau": pi.RadauIIA(rtol=1e-4),
}


@pytest.fixture(scope="module")
def model():
    return plates.double_plate_motors(cells=6).build()


def equal(one, other, count=None):
    return all(np.array_equal(getattr(one, name)[:count], getattr(other, name)[:count]) for name in FRAMES)


@pytest.mark.parametrize("limit", [200_000, 10**12])
def test_the_limit_may_be_small_or_beyond_the_machine(model, limit):
    assert equal(pi.solve(model, 0.2, METHODS["fixed"], memory_limit=limit), pi.solve(model, 0.2, METHODS["fixed"]))


def test_a_run_that_stops_between_steps(model):
    run = pi.solve(model, 0.2, METHODS["fixed"], until=lambda t, q, v: t - 0.1234)
    whole = pi.solve(model, 0.2, METHODS["fixed"])
    assert run.status == "stopped" and len(run) == 125
    assert equal(_first(run, 124), whole, 124) and abs(run.t[-1] - 0.1234) < 1e-12


def _first(run, count):
    return replace(run, **{name: getattr(run, name)[:count] for name in FRAMES})


def test_the_state_to_go_on_from_is_not_in_the_frames(model):
    run = pi.solve(model, 0.3, METHODS["fixed"])
    run.q[:] = 0.0
    assert np.abs(run.state.q).max() > 1e-3


@pytest.mark.skipif(not environment.LAZY, reason="memory is the system's at once")
def test_where_the_system_grants_nothing_there_is_no_memory(monkeypatch):
    def refused(*given, **flags):
        raise OSError("no")

    monkeypatch.setattr(environment.mmap, "mmap", refused)
    monkeypatch.setattr(environment, "_unused", [])
    with pytest.raises(MemoryError):
        environment.allocate([(1 << 20,)], [np.dtype(float)], 2**30)


@pytest.mark.skipif(not environment.LAZY, reason="memory is the system's at once")
def test_runs_of_many_lengths_leave_the_memory_of_few(monkeypatch):
    """Frames of twelve runs, each twice as long as the one before, which nobody holds any more."""
    made = []
    monkeypatch.setattr(environment, "_unused", [])
    monkeypatch.setattr(
        environment, "_mapping", lambda size, least, mapping=environment._mapping: made.append(mapping(size, least)) or made[-1]
    )
    for count in range(1, 13):
        environment.allocate([(1000,)], [np.dtype(float)], 2 ** (20 + count))
    kept = [len(mapping) for mapping in environment._unused]
    assert len(made) == 12 and kept == [len(mapping) for mapping in made[-environment.UNUSED :]]


@pytest.mark.skipif(not environment.LAZY, reason="memory is the system's at once")
def test_a_run_takes_the_memory_of_one_as_long(monkeypatch):
    monkeypatch.setattr(environment, "_unused", [])
    places = []
    for _ in range(3):
        (frames,) = environment.allocate([(1000,)], [np.dtype(float)], 2**24)
        places.append(frames.ctypes.data)
        del frames
    assert len(set(places)) == 1 and len(environment._unused) == 1


def promised_to(address):
    """True if the system counts all pages of the mapping with this address as used (`ac` of its flags), whether written or not."""
    inside = False
    for line in Path("/proc/self/smaps").read_text().splitlines():
        head, *words = line.split()
        if "-" in head and not head.endswith(":"):
            first, end = (int(number, 16) for number in head.split("-"))
            inside = first <= address < end
        elif inside and head == "VmFlags:":
            return "ac" in words
    raise LookupError(address)


@pytest.mark.skipif(not environment.NO_RESERVE, reason="the flag is one of Linux")
def test_frames_that_are_not_written_count_for_nothing(monkeypatch):
    """Otherwise a process that holds forty short runs has 20 GB promised, and the system refuses to fork it."""
    monkeypatch.setattr(environment, "_unused", [])
    (frames,) = environment.allocate([(1000,)], [np.dtype(float)], 2**29)
    ordinary = np.empty(1 << 20)  # held, so that its mapping is there when the flags are read
    assert not promised_to(frames.ctypes.data) and promised_to(ordinary.ctypes.data)
