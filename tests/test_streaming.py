"""Frames on the disk: as in memory, whole up to the last flush whatever ends the run, a bounded part held."""

import gc
import os
import pickle
import signal
import subprocess
import sys
import textwrap

import numpy as np
import pytest

import polyida as pi
from polyida.errors import StepFailure
from polyida.integrate.state import State, between
from polyida.io.frames import StoredFrames
from polyida.problems import plates

FRAMES = ("t", "q", "v", "a", "lam")
ALPHA = pi.GeneralizedAlpha(h=1e-3)


@pytest.fixture(scope="module")
def model():
    return plates.double_plate_motors(cells=10).build()


@pytest.fixture(scope="module")
def whole(model):
    return pi.solve(model, 0.4, ALPHA)


@pytest.fixture
def pendulum():
    return pi.problems.get("pendulum").model


def equal(one, other, count=None):
    return all(np.array_equal(getattr(one, name)[:count], getattr(other, name)[:count]) for name in FRAMES)


def raising(error, after):
    def progress(t):
        if t > after:
            raise error

    return progress


def test_a_streamed_run_is_the_run_in_memory(model, whole, tmp_path):
    run = pi.solve(model, 0.4, ALPHA, out=tmp_path / "run.h5")
    again = pi.load(tmp_path / "run.h5")
    assert equal(run, whole) and equal(again, whole) and again.status == "done" and again.counts == run.counts
    assert os.listdir(tmp_path) == ["run.h5"]


@pytest.fixture(scope="module")
def stored(model, tmp_path_factory):
    """A run beyond its memory limit, and the folder where its file would be seen."""
    folder = tmp_path_factory.mktemp("temporary")
    import tempfile

    before, tempfile.tempdir = tempfile.tempdir, str(folder)
    yield pi.solve(model, 0.4, ALPHA, memory_limit=100_000), folder
    tempfile.tempdir = before


def test_beyond_the_limit_frames_go_to_a_file_without_a_name(stored, whole):
    run, folder = stored
    assert equal(run, whole) and os.listdir(folder) == []
    assert all(type(getattr(run, name)) is np.ndarray and getattr(run, name).base is not None for name in FRAMES)


@pytest.fixture(scope="module")
def filed(whole, tmp_path_factory):
    """The run in a file that is read when asked for."""
    path = tmp_path_factory.mktemp("filed") / "run.h5"
    whole.save(path)
    return pi.load(path, memory_limit=0)


KEYS = (
    0,
    -1,
    slice(None),
    slice(3, 9),
    slice(None, None, -50),
    slice(5, 300, 7),
    [1, 5, 3],
    np.array([2, 2]),
    (slice(None), 3),
    (5, 7),
    (slice(2, 300), slice(3, 5)),
    (slice(None, None, 2), [1, 4]),
    np.arange(401) % 3 == 0,
    slice(4, 4),
    (slice(4, 4), 3),
    (Ellipsis, 2),
    ([1, 5], 2),
    ([1, 5], [2, 3]),
    (slice(4, 9), [1, 2]),
    np.array([], int),
)


def test_stored_frames_index_like_arrays(filed, whole):
    assert isinstance(filed.q, StoredFrames)
    for key in KEYS:
        assert np.array_equal(filed.q[key], whole.q[key]), key


def test_stored_frames_iterate_and_calculate_like_arrays(filed, whole):
    q = filed.q
    assert len(q) == len(whole.q) and q.shape == whole.q.shape and q.ndim == 2
    assert np.array_equal(q + 1, whole.q + 1) and np.abs(q).max() == np.abs(whole.q).max()
    assert all(np.array_equal(a, b) for a, b in zip(q, whole.q, strict=True))
    assert np.array_equal(pickle.loads(pickle.dumps(q)), whole.q)
    assert np.array_equal(q.T, whole.q.T) and q.max() == whole.q.max() and np.array_equal(q.mean(axis=0), whole.q.mean(axis=0))
    assert np.array_equal(np.concatenate([q, q]), np.concatenate([whole.q, whole.q])) and (q.dtype, q.size) == (float, whole.q.size)
    assert np.array_equal(q - filed.v, whole.q - whole.v) and q.reshape(401, -1, 2).shape == (401, 36, 2) and not hasattr(q, "colour")
    with pytest.raises(IndexError):
        q[401]


def test_a_large_file_is_loaded_piece_by_piece_and_saved_again(stored, whole, tmp_path):
    stored[0].save(tmp_path / "run.h5")
    again = pi.load(tmp_path / "run.h5", memory_limit=0)
    assert isinstance(again.q, StoredFrames) and equal(again, whole)
    again.save(tmp_path / "run.h5", overwrite=True)
    assert equal(pi.load(tmp_path / "run.h5"), whole) and equal(again, whole)


class Wide(pi.Model):
    n, m, needs = 20_000, 0, pi.Needs(False, False, False, False)

    def mass(self, q):
        from scipy.sparse import eye_array

        return eye_array(self.n, format="csc")

    def force(self, t, q, v):
        return q


class Free:
    """States that cost nothing, to look at what keeping them costs."""

    def steps(self, model, state, t_end, counts):
        for k in range(1, 301):
            counts.steps += 1
            q = np.full(model.n, float(k))
            yield State(k * t_end / 300, q, q + 1, q + 2, state.lam)


@pytest.mark.parametrize("out", [None, "run.h5"])
def test_no_more_than_the_limit_is_held(tmp_path, monkeypatch, out):
    import tracemalloc

    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    tracemalloc.start()
    before = resident()
    run = pi.solve(Wide(), 1.0, Free(), memory_limit=20_000_000, out=out and tmp_path / out)
    assert 24 * run.q.size > 140_000_000 and run.q[150, 3] == 150 and run.a[-1, 0] == 302
    assert run.q[:, 7][-1] == 300 and len(run.energy.kinetic) == 301
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 45_000_000 and resident() - before < 70_000_000


def resident():
    """Bytes of this process that are in no file, 0 where the system does not tell."""
    try:
        with open("/proc/self/status", encoding="utf-8") as status:
            return next((1024 * int(line.split()[1]) for line in status if line.startswith("RssAnon")), 0)
    except OSError:
        return 0


@pytest.mark.parametrize("settings", [{}, {"memory_limit": 50_000}, {"out": "run.h5"}, {"out": "run.h5", "memory_limit": 0}], ids=str)
def test_frames_in_single_precision(model, whole, tmp_path, monkeypatch, settings):
    """What is looked at has 7 digits; the run, and the state to go on from, all of them."""
    monkeypatch.chdir(tmp_path)
    run = pi.solve(model, 0.4, ALPHA, precision="single", **settings)
    assert run.counts == whole.counts and np.array_equal(run.state.q, whole.state.q) and run.state.q.dtype == float
    run.save("again.h5")
    for one in (run, pi.load("again.h5"), pi.load("again.h5", memory_limit=0)):
        assert np.array_equal(one.t, whole.t) and one.q.dtype == np.float32
        assert all(np.array_equal(getattr(one, name), getattr(whole, name).astype("f4")) for name in FRAMES[1:])
        assert np.array_equal(one.state.v, whole.state.v) and one.energy.total.dtype == float
        assert np.abs(one.energy.total - whole.energy.total).max() < 1e-4 and np.abs(one.stress(9) - whole.stress(9)).max() < 100.0
        assert one.position("tip").dtype == one.reaction("elbow motor").dtype == float
    if "out" in settings:
        half = pi.solve(model, 0.4, ALPHA, precision="single", out="half.h5", progress=raising(KeyboardInterrupt, 0.3))
        assert half.status == "interrupted" and np.array_equal(pi.resume("half.h5").q, whole.q.astype("f4"))


def test_output_between_steps_is_of_fourth_order():
    """On q = sin t the cubic polynomial between two exact states errs by h^4/384 |q''''|."""

    def state(t):
        return State(t, np.array([np.sin(t)]), np.array([np.cos(t)]), np.array([-np.sin(t)]), np.zeros(0))

    errors = [abs(between(state(1.0), state(1.0 + h), 1 + h / 2).q[0] - np.sin(1 + h / 2)) for h in (0.2, 0.1)]
    assert errors[0] < 0.2**4 / 384 and 14 < errors[0] / errors[1] < 18
    s = 1e-6
    near = [between(state(1.0), state(1.2), 1.07 + d).q[0] for d in (-s, s)]
    assert abs((near[1] - near[0]) / (2 * s) - between(state(1.0), state(1.2), 1.07).v[0]) < 1e-9


QUARTER = 1.8540746773013719 / np.sqrt(9.81)  # K(1/2) / sqrt(g / L): a pendulum's fall from the horizontal


@pytest.mark.parametrize(
    "integrator, tolerance", [(pi.GeneralizedAlpha(h=2e-4), 1e-6), (pi.IDA(rtol=1e-9, atol=1e-10), 1e-6), (pi.RadauIIA(), 1e-6)]
)
def test_until_stops_where_the_function_changes_its_sign(pendulum, integrator, tolerance):
    run = pi.solve(pendulum, 5.0, integrator, q0=[-1.0, 0.0], until=lambda t, q, v: q[0])
    assert run.status == "stopped" and run.success and "until" in run.message
    assert abs(run.t[-1] - QUARTER) < tolerance and abs(run.q[-1, 0]) < 4e-15 and (run.q[:-1, 0] < 0).all()


def test_until_does_not_stop_at_a_zero_at_the_start(pendulum):
    run = pi.solve(pendulum, 3.0, ALPHA, q0=[-1.0, 0.0], until=lambda t, q, v: v[1])
    assert abs(run.t[-1] - QUARTER) < 1e-5  # y' is zero at the start and at the bottom


def test_a_real_ctrl_c_is_heeded_between_steps(model, whole, tmp_path, heeds_ctrl_c):
    def progress(t):
        if 0.2 < t < 0.2015:
            signal.raise_signal(signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    run = pi.solve(model, 0.4, ALPHA, progress=progress, out=tmp_path / "run.h5")
    assert run.status == "interrupted" and equal(run, whole, 202) and len(run) == 202
    assert signal.getsignal(signal.SIGINT) is before


def press(times=1):
    for _ in range(times):
        signal.raise_signal(signal.SIGINT)


class PressedAtTheEnd(pi.GeneralizedAlpha):
    """Ctrl-C comes when the last step is done, before the integrator returns."""

    def steps(self, *arguments, **more):
        yield from super().steps(*arguments, **more)
        press()


class PressedAndFailing(pi.GeneralizedAlpha):
    def steps(self, *arguments, **more):
        yield next(super().steps(*arguments, **more))
        press()
        raise StepFailure("failed", "no further", 1e-3)


class Crossing:
    pressed = False

    def __call__(self, t, q, v):
        if t > 0.0055 and not self.pressed:
            self.pressed = True
            press()
        return t - 0.0055


@pytest.mark.parametrize(
    "kind, until, status, count",
    [(PressedAtTheEnd, None, "done", 11), (PressedAndFailing, None, "failed", 2), (pi.GeneralizedAlpha, Crossing(), "stopped", 7)],
)
def test_ctrl_c_that_ended_no_run_is_raised_when_the_run_is_whole(pendulum, tmp_path, heeds_ctrl_c, kind, until, status, count):
    with pytest.raises(KeyboardInterrupt) as caught:
        pi.solve(pendulum, 0.01, kind(h=1e-3), q0=[-1.0, 0.0], until=until, out=tmp_path / "run.h5")
    run, stored = caught.value.trajectory, pi.load(tmp_path / "run.h5")
    assert run.status == stored.status == status and len(run) == count and equal(run, stored)
    assert "attribute `trajectory`" in caught.value.__notes__[0]


@pytest.mark.parametrize("times, inner_steps", [(1, 10), (2, 1)])
def test_ctrl_c_in_a_run_within_a_run(pendulum, heeds_ctrl_c, times, inner_steps):
    """The outer run may need the result of the inner one, so the first press waits; a second one ends both, and no wrong result is used."""
    inner, used = [], []

    def within(t):
        inner.append(t)
        if len(inner) == 1:
            press(times)

    def progress(t):
        used.append(pi.solve(pendulum, 0.01, ALPHA, q0=[-1.0, 0.0], progress=within).success)

    run = pi.solve(pendulum, 0.01, ALPHA, q0=[-1.0, 0.0], progress=progress)
    assert run.status == "interrupted" and len(run) == 2 and len(inner) == inner_steps and used == [True] * (2 - times)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.parametrize("out", [None, "run.h5"])
def test_an_exception_of_the_users_own_goes_on_with_the_run_so_far(model, whole, tmp_path, out):
    path = out and tmp_path / out
    with pytest.raises(ZeroDivisionError, match="of mine") as caught:
        pi.solve(model, 0.4, ALPHA, progress=raising(ZeroDivisionError("of mine"), 0.2), out=path)
    run = caught.value.trajectory
    assert run.status == "error" and "of mine" in run.message and equal(run, whole, len(run)) and len(run) == 202
    assert "202 frames" in caught.value.__notes__[0]
    assert not out or (pi.load(path).status == "error" and equal(pi.load(path), run))


class Falling(pi.Model):
    n, m = 1, 0

    def mass(self, q):
        return np.eye(1)

    def force(self, t, q, v):
        if t > 0.05:
            raise RuntimeError("no force today")
        return np.array([9.81])


@pytest.mark.parametrize("integrator", [ALPHA, pi.IDA(), pi.RadauIIA(max_step=0.01)])
def test_an_exception_in_a_force(tmp_path, integrator):
    with pytest.raises(RuntimeError, match="no force today") as caught:
        pi.solve(Falling(), 1.0, integrator, out=tmp_path / "run.h5")
    again = pi.load(tmp_path / "run.h5")
    assert again.status == "error" and len(again) == len(caught.value.trajectory) > 2 and "no force" in again.summary()


def test_an_existing_file_is_kept_unless_told(model, tmp_path):
    path = tmp_path / "run.h5"
    path.write_text("mine")
    with pytest.raises(pi.InputError, match="run.h5 exists"):
        pi.solve(model, 0.01, ALPHA, out=path)
    assert path.read_text() == "mine"
    assert pi.solve(model, 0.01, ALPHA, out=path, overwrite=True).success and len(pi.load(path)) == 11


def test_a_file_that_came_during_the_start_is_kept(model, tmp_path, monkeypatch):
    path = tmp_path / "run.h5"
    monkeypatch.setattr("polyida.run.solve.free", lambda path, overwrite: path.write_text("theirs") and path)
    with pytest.raises(pi.InputError, match="run.h5"):
        pi.solve(model, 0.01, ALPHA, out=path)
    assert path.read_text() == "theirs" and os.listdir(tmp_path) == ["run.h5"]


READER = """
    import sys
    import polyida as pi
    for _ in sys.stdin:
        run = pi.load(sys.argv[1])
        print(run.status, len(run), run.q[-1].sum().hex(), flush=True)
        del run
"""


def test_a_run_is_read_while_it_is_written(model, whole, tmp_path):
    seen, command = [], [sys.executable, "-c", textwrap.dedent(READER), tmp_path / "run.h5"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1) as reader:

        def progress(t):
            if len(seen) < 3 and t > 0.1 * (len(seen) + 1):
                reader.stdin.write("now\n")
                seen.append(reader.stdout.readline().split())

        pi.solve(model, 0.4, pi.GeneralizedAlpha(h=1e-3, linear="kkt"), out=tmp_path / "run.h5", flush_every=10, progress=progress)
    lengths = [int(count) for _, count, _ in seen]
    final = pi.load(tmp_path / "run.h5")
    assert [status for status, *_ in seen] == ["running"] * 3 and 85 < lengths[0] < lengths[1] < lengths[2] < 401
    assert all(float.fromhex(total) == final.q[count - 1].sum() for count, (*_, total) in zip(lengths, seen))


LIMITED = """
    import resource, sys
    import polyida as pi
    from polyida.problems import plates
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), int(sys.argv[2])))
    model = plates.double_plate_motors(cells=10).build()
    run = pi.solve(model, 2.0, pi.GeneralizedAlpha(h=1e-3), **eval(sys.argv[3]))
    print(run.status, len(run), run.message)
    again = pi.load(sys.argv[1]) if sys.argv[1] else run
    print(again.status, len(again), again.message)
"""


def test_a_full_disk_ends_the_run_and_keeps_the_frames(model, whole, tmp_path):
    path = tmp_path / "run.h5"
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", textwrap.dedent(LIMITED), path, "3000000", f"{{'out': {str(path)!r}}}"],
        capture_output=True,
        text=True,
        check=True,
    )
    first, second = done.stdout.strip().split("\n")
    assert first == second and first.startswith("disk full") and "run.h5: File too large" in first and done.stderr == ""
    again = pi.load(path)
    assert len(again) > 300 and equal(again, pi.solve(model, 2.0, ALPHA), len(again))
    longer = pi.resume(path)  # there is room now
    assert longer.success and len(longer) == 2001


@pytest.mark.parametrize(
    "integrator", [pi.EnergyMomentum(h=1e-3), pi.RadauIIA(h=1e-3), pi.RadauIIA(rtol=1e-10), pi.GeneralizedAlpha(h=1e-3)], ids=str
)
def test_states_that_nobody_holds_are_freed_at_once(integrator):
    """States that referred to each other would wait for Python's search for cycles, and memory would grow with the steps."""
    count, model = 0, plates.double_plate(cells=2).build()

    def look(t):
        nonlocal count
        count += 1
        if count == 20:
            gc.disable()
            gc.freeze()  # what there is before is not searched
        if count == 900:
            gc.set_debug(gc.DEBUG_SAVEALL)
            gc.collect()
            gc.set_debug(0)

    try:
        pi.solve(model, 1.0, integrator, progress=look)
        waiting = {type(item).__name__ for item in gc.garbage} & {"State", "Accepted", "End", "Ends", "Common", "Stretch"}
    finally:
        gc.set_debug(0)
        gc.garbage.clear()
        gc.unfreeze()
        gc.enable()
    assert count >= 900 and not waiting
