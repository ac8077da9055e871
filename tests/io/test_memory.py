"""Frames in memory: written once, where they stay, and in memory that is used again."""

import gc
from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest

import polyida as pi
from polyida import memory
from polyida.errors import StepFailure
from polyida.integrate.start import consistent_state
from polyida.integrate.state import Counts, Stretch
from polyida.io.store import SMALL, FrameStore
from polyida.memory import room
from polyida.model.guarded import guard
from polyida.problems import plates
from polyida.run.accepted import accepted

FRAMES = ("t", "q", "v", "a", "lam")
DOUBLE = np.dtype(float)
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


def test_a_room_has_rows_of_every_shape():
    arrays = room([(), (7,), (0,), (2, 3)], [DOUBLE, np.dtype("f4"), DOUBLE, DOUBLE], 1000 * (8 + 28 + 48))
    assert [x.shape for x in arrays] == [(1000,), (1000, 7), (1000, 0), (1000, 2, 3)]
    for k, values in enumerate(arrays):
        values[...] = k
    assert all((values == k).all() and values.flags.c_contiguous for k, values in enumerate(arrays))


@pytest.mark.skipif(not memory.LAZY, reason="memory is the system's at once")
def test_memory_is_used_again_when_no_array_shows_it():
    def address(rows):
        return rows.__array_interface__["data"][0]

    (first,) = room([(100,)], [DOUBLE], 8e7)
    part = first[3:, 2]
    at = address(first)
    del first
    (other,) = room([(100,)], [DOUBLE], 8e7)
    assert address(other) != at and len(other) == 100_000
    del part
    (again,) = room([(100,)], [DOUBLE], 8e7)
    assert address(again) == at


@pytest.mark.skipif(not memory.LAZY, reason="memory is the system's at once")
def test_no_more_is_reserved_than_the_system_grants(monkeypatch):
    grants, given = memory.mmap.mmap, []

    def stingy(at, size, **flags):
        given.append(size)
        if size > 1 << 22:
            raise OSError("no")
        return grants(at, size, **flags)

    monkeypatch.setattr(memory.mmap, "mmap", stingy)
    monkeypatch.setattr(memory, "_unused", defaultdict(list))
    (rows,) = room([(100,)], [DOUBLE], 2**30 - 1000)
    assert 4000 < len(rows) <= (1 << 22) // 800 and len(given) == 9
    with pytest.raises(MemoryError):
        room([(1 << 20,)], [DOUBLE], 2**30)


def test_states_are_written_where_they_stay(model):
    """No copy: the rows of a run's frames are the stretches that the integrator yields."""
    begin, store = consistent_state(model, 0.0, None, None), FrameStore(model.n, model.m)
    store.extend(Stretch.of(begin))
    states = []
    for stretch in accepted(METHODS["fixed"], guard(model), begin, 0.02, Counts(), store.rows):
        rows = store.rows(len(stretch))
        assert all(np.shares_memory(getattr(stretch, name), row) for name, row in zip(FRAMES[1:], rows))
        store.extend(stretch)
        states += stretch
    frames = store.arrays()
    assert all(np.array_equal(frames["q"][1 + k], state.q) for k, state in enumerate(states)) and len(states) == 20


@pytest.mark.parametrize("name", METHODS)
def test_frames_in_their_place_are_those_that_are_copied(model, tmp_path, name):
    """A file gets copies of the states, in blocks of its own."""
    run, filed = pi.solve(model, 0.12, METHODS[name]), pi.solve(model, 0.12, METHODS[name], out=tmp_path / "run.h5")
    assert run.success and equal(run, filed) and run.counts == filed.counts and len(run) > 2
    every, last = pi.solve(model, 0.12, METHODS[name], every=10**6), run.state
    assert every.counts == run.counts and np.array_equal(every.q[-1], run.q[-1])
    assert last.t == filed.state.t and np.array_equal(last.q, filed.state.q) and np.array_equal(last.a, filed.state.a)


def test_steps_in_parts_leave_the_frames_alone(tmp_path):
    """The parts of a step lie where the next frames come."""
    model, method = plates.double_plate(cells=6).build(), pi.GeneralizedAlpha(h=0.2, tolerance=1e-6)
    run, filed = pi.solve(model, 1.0, method), pi.solve(model, 1.0, method, out=tmp_path / "run.h5")
    assert run.success and run.counts.rejected > 0 and equal(run, filed) and run.counts == filed.counts


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


def test_a_run_that_fails_keeps_the_frames_so_far(model):
    class Failing(pi.GeneralizedAlpha):
        """In the package's name, so that its states are not copied."""

        def steps(self, model, state, t_end, counts, rows=None):
            for state in super().steps(model, state, t_end, counts, rows):
                if counts.steps > 30:
                    raise StepFailure("newton", "no more", state.t)
                yield state

    Failing.__module__ = "polyida.test"
    run, whole = pi.solve(model, 0.2, Failing(h=1e-3)), pi.solve(model, 0.2, METHODS["fixed"])
    assert run.status == "newton" and len(run) == 31 and equal(run, _first(whole, 31))
    rest = pi.solve(model, 0.2, METHODS["fixed"], state=run.state)
    assert np.abs(rest.q[-1] - whole.q[-1]).max() < 1e-7


def test_the_state_to_go_on_from_is_not_in_the_frames(model):
    run = pi.solve(model, 0.3, METHODS["fixed"])
    run.q[:] = 0.0
    assert np.abs(run.state.q).max() > 1e-3


@pytest.mark.skipif(not memory.LAZY, reason="memory is the system's at once")
def test_small_runs_hold_no_piece(model):
    gc.collect()
    runs = [pi.solve(model, 0.05, METHODS["fixed"]) for _ in range(3)]
    assert sum(getattr(runs[0], name).nbytes for name in FRAMES) < SMALL
    assert all(run.q.base is None for run in runs) and sum(map(len, memory._unused.values())) > 0


@pytest.mark.skipif(not memory.LAZY, reason="memory is the system's at once")
def test_times_that_are_kept_do_not_keep_the_frames(model):
    """Nor do multipliers: both are a small part of what they were written with."""
    run = pi.solve(model, 2.0, METHODS["fixed"])
    assert sum(getattr(run, name).nbytes for name in FRAMES) > SMALL and run.q.base is not None
    assert run.t.base is None and run.lam.base is None
