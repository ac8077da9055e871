"""Runs in threads and in processes at once give the answers of runs one after the other, and leave nothing behind."""

import multiprocessing
import os
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import polyida as pi
from polyida.environment import one_blas_thread
from polyida.problems import plates

FRAMES = ("t", "q", "v", "a", "lam")
METHODS = {
    "alpha": pi.GeneralizedAlpha(h=1e-3),
    "adaptive": pi.GeneralizedAlpha(h=2e-3, rtol=1e-5),
    "kkt": pi.GeneralizedAlpha(h=5e-3, linear="kkt"),
    "energy": pi.EnergyMomentum(h=1e-3),
    "ggl2": pi.IDA(rtol=1e-4),
    "ggl1": pi.IDA(rtol=1e-4, form="ggl1"),
    "radau": pi.RadauIIA(rtol=1e-4),
    "radau, fixed steps": pi.RadauIIA(h=5e-3),
}


def work(name, cells=6, out=None):
    """One run, as plain arrays."""
    run = pi.solve(plates.double_plate_motors(cells=cells).build(), 0.06, METHODS[name], out=out)
    return run.status, {key: np.array(getattr(run, key)) for key in FRAMES}


@pytest.fixture(scope="module")
def alone():
    """{name: the run on its own}."""
    return {name: work(name) for name in METHODS}


def same(one, other):
    return one[0] == other[0] == "done" and all(np.array_equal(one[1][key], other[1][key]) for key in FRAMES)


def test_runs_in_threads_at_once(alone):
    names = list(METHODS) * 2
    with ThreadPoolExecutor(6) as pool:
        for name, result in zip(names, pool.map(work, names)):
            assert same(result, alone[name]), name


@pytest.mark.parametrize("name", METHODS)
def test_one_model_in_many_threads_at_once(name):
    """The model is shared, and holds nothing of a run."""
    model = plates.double_plate_motors(cells=6).build()
    alone = pi.solve(model, 0.06, METHODS[name])
    with ThreadPoolExecutor(4) as pool:
        runs = [job.result() for job in [pool.submit(pi.solve, model, 0.06, METHODS[name]) for _ in range(4)]]
    assert all(np.array_equal(run.q, alone.q) and np.array_equal(run.lam, alone.lam) for run in runs)


def test_a_fresh_model_is_built_in_threads_at_once():
    """What a model makes when it is first asked for is made by several threads at the same moment."""
    model, gate = plates.double_plate_motors(cells=6).build(), threading.Barrier(6)

    def first():
        gate.wait()
        return pi.solve(model, 0.02, METHODS["alpha"]).q

    with ThreadPoolExecutor(6) as pool:
        results = [job.result() for job in [pool.submit(first) for _ in range(6)]]
    assert all(np.array_equal(q, results[0]) for q in results)


def test_files_written_in_threads_at_once(alone, tmp_path):
    names = ["alpha", "energy", "ggl2"] * 2
    with ThreadPoolExecutor(6) as pool:
        list(pool.map(lambda job: work(job[1], out=tmp_path / f"{job[0]}.h5"), enumerate(names)))
    for number, name in enumerate(names):
        run = pi.load(tmp_path / f"{number}.h5")
        assert same((run.status, {key: np.asarray(getattr(run, key)) for key in FRAMES}), alone[name])
    assert len(os.listdir(tmp_path)) == len(names)


def test_a_failing_run_beside_good_ones_tells_its_own_reason(alone):
    """What SUNDIALS says of one run is not taken for another's."""

    def failing(_):
        return pi.solve(plates.double_plate(cells=6).build(), 0.06, pi.IDA(rtol=1e-6, max_num_steps=5)).status

    names = ["ggl2", "ggl1"] * 3
    with ThreadPoolExecutor(6) as pool:
        bad = [pool.submit(failing, k) for k in range(6)]
        good = [pool.submit(work, name) for name in names]
        assert {job.result() for job in bad} == {"too many steps"}
        assert all(same(job.result(), alone[name]) for job, name in zip(good, names))


@pytest.mark.parametrize("start", ["spawn", "fork"])
def test_runs_in_processes_at_once(alone, start):
    if start not in multiprocessing.get_all_start_methods():
        pytest.skip(f"no {start} on this system")
    names = ["alpha", "energy", "ggl2"]
    with multiprocessing.get_context(start).Pool(2) as pool:
        for name, result in zip(names, pool.map(work, names, chunksize=1)):
            assert same(result, alone[name]), name


def blas():
    return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]


def test_blas_threads_are_given_back():
    with threadpool_limits(limits=2, user_api="blas"):
        before = blas()
        inside = []
        pi.solve(plates.double_plate(cells=4).build(), 0.01, METHODS["alpha"], progress=lambda t: inside.append(blas()))
        assert before and blas() == before and set(map(tuple, inside)) == {(1,) * len(before)}


def test_blas_threads_are_given_back_after_a_failure_and_a_mistake():
    def stop(t):
        raise KeyError("mine")

    model = plates.double_plate(cells=4).build()
    with threadpool_limits(limits=2, user_api="blas"):
        before = blas()
        with pytest.raises(KeyError):
            pi.solve(model, 0.01, METHODS["alpha"], progress=stop)
        with pytest.raises(pi.InputError):
            pi.solve(model, 0.01, METHODS["alpha"], q0=np.ones(model.n))
        assert blas() == before


def test_blas_threads_are_given_back_where_runs_overlap():
    """A run that begins within another's and ends after it leaves what there was before both."""
    with threadpool_limits(limits=2, user_api="blas"):
        before, first, second = blas(), one_blas_thread(), one_blas_thread()
        first.__enter__()
        second.__enter__()
        first.__exit__(None, None, None)
        assert set(blas()) == {1}
        second.__exit__(None, None, None)
        assert blas() == before


def test_blas_threads_are_given_back_where_one_run_is_within_another():
    model = plates.double_plate(cells=4).build()
    with threadpool_limits(limits=2, user_api="blas"):
        before, inside = blas(), []

        def progress(t):
            if not inside:
                pi.solve(model, 0.005, METHODS["energy"])
                inside.append(blas())

        pi.solve(model, 0.01, METHODS["alpha"], progress=progress)
        assert blas() == before and set(inside[0]) == {1}


def test_condition_numbers_take_one_blas_thread(monkeypatch):
    inside, inverse = [], np.linalg.inv
    monkeypatch.setattr(np.linalg, "inv", lambda matrix: inside.append(blas()) or inverse(matrix))
    model = pi.problems.get("pendulum").model
    with threadpool_limits(limits=2, user_api="blas"):
        before = blas()
        pi.condition_number(model, METHODS["alpha"], pi.consistent_state(model, 0.0, [-1.0, 0.0]))
        assert blas() == before and inside == [[1] * len(before)]


def test_libraries_are_looked_for_when_modules_have_been_imported(monkeypatch):
    """And not in every run: that takes longer than a short one."""
    import sys

    import threadpoolctl

    found, controller = [], threadpoolctl.ThreadpoolController
    monkeypatch.setattr(threadpoolctl, "ThreadpoolController", lambda: found.append(1) or controller())
    for modules in (0, 0, 1, 1):
        monkeypatch.setitem(sys.modules, f"made_up_{modules}", threading)
        with one_blas_thread():
            pass
    assert len(found) == 2


def test_no_state_is_left_between_runs(alone):
    """After all kinds of runs, failed ones too, each gives what it gave alone."""
    for name in METHODS:
        pi.solve(plates.double_plate(cells=4).build(), 0.01, METHODS[name])
    pi.solve(plates.double_plate(cells=6).build(), 0.06, pi.IDA(rtol=1e-6, max_num_steps=5))
    assert all(same(work(name), alone[name]) for name in METHODS)
