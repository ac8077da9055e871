"""Trajectories: what is derived from them, and that a file brings back the same, or says why it cannot."""

import h5py
import numpy as np
import pytest

import polyida as pi

STEP = pi.GeneralizedAlpha(h=1e-3)
FRAMES = ("t", "q", "v", "a", "lam")


@pytest.fixture
def run(scenes):
    """A short run with every kind of part in it, the lower plate turned in its place, one profile of the user's own."""
    scene = scenes.jointed("motor between", angle=lambda t: 0.3 * np.sin(2.0 * t) ** 3)
    lower, upper = scene.parts["lower"], scene.parts["upper"]
    scene.add(pi.PointLoad(lower.section("right"), (0.5, 0.0), pi.profile.sine(1.0, 3.0), name="push"))
    scene.add(pi.EdgeTraction(upper.section("top"), (0.0, 10.0), lambda t: t * t, name="wind"))
    return pi.solve(scene.build(), 0.03, STEP)


@pytest.fixture
def file(run, tmp_path):
    """The run in a file."""
    path = tmp_path / "run.h5"
    run.save(path)
    return path


def test_frames_come_back_to_the_bit(run, file):
    again = pi.load(file)
    for name in FRAMES:
        assert np.array_equal(getattr(again, name), getattr(run, name)), name
    assert (again.status, again.message, again.counts, again.machine) == (
        run.status,
        run.message,
        run.counts,
        run.machine,
    )
    assert (again.cpu_seconds, again.wall_seconds, again.integrator) == (
        run.cpu_seconds,
        run.wall_seconds,
        run.integrator,
    )
    assert set(again.memory) == set(run.memory) and np.array_equal(again.memory["a_alg"], run.memory["a_alg"])
    assert again.success and again.summary() == run.summary()


def test_what_is_derived_comes_back_too(run, file):
    again = pi.load(file)
    for name in ("tip", "joint", "push"):
        assert np.array_equal(again.position(name), run.position(name))
    for name in ("joint", "revolute 1", "revolute 2"):
        assert np.allclose(again.reaction(name), run.reaction(name), rtol=1e-14)
    for name in ("kinetic", "potential", "strain", "total"):
        assert np.allclose(getattr(again.energy, name), getattr(run.energy, name), rtol=1e-12, atol=1e-14)
    assert np.array_equal(again.stress(-1), run.stress(-1)) and np.array_equal(
        again.node_positions(-1), run.node_positions(-1)
    )
    assert list(again.model.parts) == list(run.model.parts)


def test_a_profile_of_the_user_s_own_is_followed_by_its_values(run, file):
    again = pi.load(file)
    for t in run.t:
        assert np.allclose(again.model.drives(t)[:, :2], run.model.drives(t)[:, :2], atol=1e-9)
    assert again.drift.max() < 1e-9 and again.velocity_drift.max() == pytest.approx(run.velocity_drift.max(), rel=1e-3)


def test_a_loaded_run_goes_on(run, file):
    from polyida.integrate.state import State

    again = pi.load(file)
    last = State(again.t[-1], again.q[-1], again.v[-1], again.a[-1], again.lam[-1], again.memory)
    rest = pi.solve(run.model, 0.04, STEP, state=last)
    assert rest.success and rest.t[0] == run.t[-1] and len(rest) == 11


def test_a_file_is_not_overwritten_unasked(run, file):
    before = file.read_bytes()
    with pytest.raises(pi.InputError, match="run.h5 exists"):
        run.save(file)
    assert file.read_bytes() == before
    run.save(file, overwrite=True)
    assert list(file.parent.iterdir()) == [file]


def test_saving_into_no_folder(run, tmp_path):
    with pytest.raises(pi.InputError, match="nowhere"):
        run.save(tmp_path / "nowhere" / "run.h5")


def test_a_failed_run_is_kept_too(scenes, tmp_path):
    scene, upper = scenes.hinged((0.0, 0.0))
    jump = pi.profile.from_function(lambda t: 0.0 if t < 0.0095 else np.pi, lambda t: 0.0, lambda t: 0.0)
    scene.add(pi.AngleMotor(pi.ground, upper.section("left"), angle=jump, name="drive"))
    run = pi.solve(scene.build(), 0.02, STEP)
    run.save(tmp_path / "failed.h5")
    again = pi.load(tmp_path / "failed.h5")
    assert not again.success and again.message == run.message and len(again) == 10


def test_a_run_of_a_user_s_model(tmp_path):
    run = pi.solve(pi.problems.get("pendulum").model, 0.1, STEP, q0=[-1.0, 0.0])
    run.save(tmp_path / "pendulum.h5")
    again = pi.load(tmp_path / "pendulum.h5")
    assert np.array_equal(again.q, run.q) and "done" in again.summary()
    with pytest.raises(pi.InputError, match="model"):
        again.energy


def test_an_ida_run(scenes, tmp_path):
    run = pi.solve(scenes.hinged()[0].build(), 0.02, pi.IDA(rtol=1e-5, atol=(1e-7, 1e-4)))
    run.save(tmp_path / "ida.h5")
    again = pi.load(tmp_path / "ida.h5")
    assert again.integrator == run.integrator and np.array_equal(again.lam, run.lam)


@pytest.mark.parametrize("fraction", [0.0, 0.05, 0.5, 0.9, 0.999])
def test_truncated(file, fraction):
    content = file.read_bytes()
    file.write_bytes(content[: int(fraction * len(content))])
    with pytest.raises(pi.InputError, match="run.h5"):
        pi.load(file)


@pytest.mark.parametrize("content", [b"", b"garbage", b"\x89HDF\r\n\x1a\n" + bytes(200), bytes(range(256)) * 20])
def test_garbage(tmp_path, content):
    path = tmp_path / "other.h5"
    path.write_bytes(content)
    with pytest.raises(pi.InputError, match="other.h5"):
        pi.load(path)


def test_missing_and_foreign(tmp_path):
    with pytest.raises(pi.InputError, match="none.h5"):
        pi.load(tmp_path / "none.h5")
    with pytest.raises(pi.InputError):
        pi.load(tmp_path)
    with h5py.File(tmp_path / "foreign.h5", "w") as other:
        other["t"] = np.arange(3.0)
    with pytest.raises(pi.InputError, match="not a polyida trajectory"):
        pi.load(tmp_path / "foreign.h5")


def damaged(file, where, change):
    """Every copy of the file in which one dataset whose name contains `where` is changed; yields its name."""
    content, names = file.read_bytes(), []
    with h5py.File(file, "r") as opened:
        opened.visititems(lambda name, node: names.append(name) if hasattr(node, "dtype") and where in name else None)
    for name in names:
        file.write_bytes(content)
        with h5py.File(file, "r+") as opened:
            value = change(opened[name][()])
            if value is not None:
                del opened[name]
                opened[name] = value
        yield name


def usable(file):
    """Load and use a file: either all of it works or there is one InputError that names it."""
    try:
        run = pi.load(file)
    except pi.InputError as error:
        assert file.name in str(error)
        return False
    run.energy, run.drift, run.summary(), run.stress(-1), run.position("tip"), run.reaction("joint")
    return True


CHANGES = {
    "shorter": lambda x: x[:-1] if np.ndim(x) and len(x) > 1 else None,
    "narrower": lambda x: x[:, :-1] if np.ndim(x) > 1 else None,
    "empty": lambda x: x[:0] if np.ndim(x) else None,
    "a number": lambda x: 1.0,
    "text": lambda x: "hello",
    "large": lambda x: x + 10**6 if np.asarray(x).dtype.kind in "if" else None,
    "negative": lambda x: -1 - x if np.asarray(x).dtype.kind == "i" else None,
    "not finite": lambda x: x * np.nan if np.asarray(x).dtype.kind == "f" else None,
}


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_damaged_scene_is_refused_or_harmless(file, change):
    """Kernels do not check bounds, so what they are given must have been checked."""
    assert [usable(file) for _ in damaged(file, "scene", CHANGES[change])]


@pytest.mark.parametrize("name", ["t", "q", "v", "a", "lam"])
@pytest.mark.parametrize("change", ["empty", "narrower", "a number", "text"])
def test_damaged_frames_are_refused(file, name, change):
    content = file.read_bytes()
    with h5py.File(file, "r+") as opened:
        value = CHANGES[change](opened[name][()])
        if value is None:
            return
        del opened[name]
        opened[name] = value
    assert not usable(file)
    file.write_bytes(content)
    assert usable(file)


@pytest.mark.parametrize(
    "text", ["{", "[" * 100_000, "{}", "null", '{"gravity": [0, 0], "parts": [{"kind": "os.system"}]}']
)
def test_damaged_descriptions_are_refused(file, text):
    with h5py.File(file, "r+") as opened:
        names = [name for name, value in opened.attrs.items() if isinstance(value, str) and value.startswith("{")]
        for name in names:
            opened.attrs[name] = text
        texts = [
            name
            for name, node in opened.items()
            if getattr(node, "dtype", None) is not None and node.dtype.kind in "SO"
        ]
        for name in texts:
            del opened[name]
            opened[name] = text
    if names or texts:
        assert not usable(file)


def test_random_bytes_are_refused_or_harmless(file):
    random, content = np.random.default_rng(0), file.read_bytes()
    for _ in range(40):
        changed = bytearray(content)
        for at in random.integers(0, len(content), 8):
            changed[at] = random.integers(256)
        file.write_bytes(changed)
        usable(file)


@pytest.mark.parametrize("name", ["a/b", "/a", ".", "..", "x/../y", "tip mass (2 kg), left", "Gelenk ä", "5"])
def test_any_name_survives(scenes, tmp_path, name):
    scene, upper = scenes.hinged()
    scene.add(pi.AngleMotor(pi.ground, upper.section("left"), angle=lambda t: 0.1 * t * t, name=name))
    run = pi.solve(scene.build(), 0.005, STEP)
    run.save(tmp_path / "named.h5")
    again = pi.load(tmp_path / "named.h5")
    assert np.allclose(again.reaction(name), run.reaction(name))


@pytest.mark.parametrize(
    "ask, match",
    [
        (lambda run: run.position("nobody"), "nobody.*tip"),
        (lambda run: run.reaction("tip"), "tip.*joint"),
        (lambda run: run.reaction("nobody"), "nobody"),
    ],
)
def test_unknown_names_are_answered_by_the_known(run, ask, match):
    with pytest.raises(pi.InputError, match=match):
        ask(run)


def test_position_of_an_attachment(run):
    lower = run.model.parts["lower"]
    assert np.allclose(run.position(lower.section("right")), run.position("tip"), atol=1e-15)
    assert np.allclose(run.position(lower.node((1.0, 0.0)))[0], run.position("tip")[0])


def test_position_of_what_is_not_in_the_scene(run, file, scenes):
    strange = scenes.plate("strange").section("right")
    with pytest.raises(pi.InputError, match="strange"):
        run.position(strange)
    with pytest.raises(pi.InputError):
        pi.load(file).position(run.model.parts["lower"].section("right"))


def test_position_of_a_part(run):
    """The part itself does as well as its name."""
    assert np.array_equal(run.position(run.model.parts["tip"]), run.position("tip"))


def test_energies_are_those_of_the_model(run):
    frame = 20
    model, q, v = run.model, run.q[frame], run.v[frame]
    assert run.energy.kinetic[frame] == pytest.approx(0.5 * v @ (model.mass() @ v))
    assert run.energy.potential[frame] + run.energy.strain[frame] == pytest.approx(model.potential(q))
    assert np.array_equal(run.energy.total, run.energy.kinetic + run.energy.potential + run.energy.strain)
    assert len(run) == len(run.drift) == len(run.velocity_drift) == len(run.energy.total) == 31


def test_a_model_without_potential_has_no_energy():
    run = pi.solve(pi.problems.get("car-axis").model, 0.01, STEP, q0=[0, 0.5, 1, 0.5], v0=[-0.5, 0, -0.5, 0])
    assert np.isnan(run.energy.potential).all() and np.isfinite(run.energy.kinetic).all()
    with pytest.raises(pi.InputError, match="CarAxis"):
        run.position("tip")
