"""Small scenes that many tests share: one or two rubber plates on a coarse mesh, held by every kind of joint."""

import gc
import math
import multiprocessing
import os
import signal
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from types import SimpleNamespace

os.environ.update(
    OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1"
)  # small matrices in two threads, beside another worker, take 100 times as long

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

import polyida as pi
from polyida.cli.output import prepare
from polyida.run import run as running

settings.register_profile("same every time", derandomize=True, deadline=None, database=None, suppress_health_check=list(HealthCheck))
settings.load_profile("same every time")
os.environ["PYTHONPATH"] = os.pathsep.join([str(Path(pi.__file__).parents[1]), os.environ.get("PYTHONPATH", "")])  # of other processes too
running.FLUSH_SECONDS = math.inf  # flushes by steps alone, so that the load of the machine adds none

RUBBER = dict(E=50e6, nu=0.3, rho=1100.0)
LENGTH, HEIGHT, THICKNESS, GRAVITY = 1.0, 0.1, 0.01, (0.0, -9.81)
PLATE_MASS = RUBBER["rho"] * LENGTH * HEIGHT * THICKNESS
_meshes = {}


def pytest_addoption(parser):
    parser.addoption("--all", action="store_true", help="run all tests, not only those of tests/core.txt")


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config):
    """Without a file, a folder or --all on the command line the tests of core.txt are run; pytest stops at a line that names no test."""
    if config.args_source is config.ArgsSource.TESTPATHS and not config.option.all:
        folder = Path(__file__).parent
        lines = (folder / "core.txt").read_text().splitlines()
        config.args = [str(folder / line) for line in lines if line and not line.startswith("#")]


@pytest.hookimpl(tryfirst=True)
def pytest_sessionstart(session):
    """Fill the kernels' cache in processes of their own, before there are workers.

    The process that compiles a kernel and those that load it may differ in the last bit (what is inlined decides how sums are
    reassociated), and some tests compare runs of two processes to the bit.
    """
    prepare()
    if not hasattr(session.config, "workerinput"):
        started = [subprocess.Popen([sys.executable, Path(__file__).parent / "warm_up.py", name]) for name in ("alpha", "radau", "own")]
        assert [process.wait() for process in started] == [0] * len(started)


def pytest_sessionfinish():
    """Keep pytest from looking for garbage at its end: among some millions of objects, most of them of the compiler, that takes seconds."""
    gc.freeze()


def mesh(cells=20):
    """One mesh per number of cells: plates on it share their operator."""
    if cells not in _meshes:
        _meshes[cells] = pi.mesh.rectangle(LENGTH, HEIGHT, cells=cells, seed=1)
    return _meshes[cells]


LEVELS = {"full": lambda plate: plate, "reduced": lambda plate: pi.Reduced(plate, modes=4), "rigid": pi.Rigid}


def plate(name, cells=20, level="full", **options):
    """A rubber plate, or what a level makes of it."""
    material = pi.Material(**(RUBBER | options.pop("material", {})))
    return LEVELS[level](pi.Plate(options.pop("mesh", None) or mesh(cells), material, THICKNESS, name=name, **options))


def single(gravity=GRAVITY, cells=20, **options):
    """(scene, plate "upper" without a joint)."""
    scene = pi.Scene(gravity=gravity)
    return scene, scene.add(plate("upper", cells, **options))


def hinged(gravity=GRAVITY, cells=20, **options):
    """(scene, plate "upper" on a revolute "shoulder" to the ground)."""
    scene, upper = single(gravity, cells, **options)
    scene.add(pi.Revolute(pi.ground, upper.section("left"), name="shoulder"))
    return scene, upper


def pair(gravity=GRAVITY, cells=20, bend=0.0, origin=(0.0, 0.0), **options):
    """(scene, upper, lower): two plates end to end from the origin, the lower one turned by `bend`; no joint."""
    scene, upper = single(gravity, cells, origin=origin, **options)
    end = (origin[0] + LENGTH, origin[1])
    return scene, upper, scene.add(plate("lower", cells, origin=end, angle=bend, **options))


def cantilever(gravity=(0.0, 0.0), cells=20, **options):
    """(scene, plate "upper" clamped at its left edge)."""
    scene, upper = single(gravity, cells, **options)
    scene.add(pi.Clamp(upper.section("left"), name="root"))
    return scene, upper


JOINTS = {  # kind: what holds the upper plate, what holds the lower one to it; the joint under test is called "joint"
    "revolute": lambda a, b, angle: [pi.Revolute(pi.ground, a[0]), pi.Revolute(a[1], b, name="joint")],
    "revolute, ground as b": lambda a, b, angle: [pi.Revolute(a[0], pi.ground, name="joint"), pi.Revolute(a[1], b)],
    "clamp to ground": lambda a, b, angle: [pi.Clamp(a[0], name="joint"), pi.Revolute(a[1], b)],
    "clamp, ground as a": lambda a, b, angle: [pi.Clamp(pi.ground, a[0], name="joint"), pi.Revolute(a[1], b)],
    "clamp between": lambda a, b, angle: [pi.Revolute(pi.ground, a[0]), pi.Clamp(a[1], b, name="joint")],
    "motor to ground": lambda a, b, angle: [
        pi.Revolute(pi.ground, a[0]),
        pi.AngleMotor(pi.ground, a[0], angle, name="joint"),
        pi.Revolute(a[1], b),
    ],
    "motor, ground as b": lambda a, b, angle: [
        pi.Revolute(pi.ground, a[0]),
        pi.AngleMotor(a[0], pi.ground, angle, name="joint"),
        pi.Revolute(a[1], b),
    ],
    "motor between": lambda a, b, angle: [pi.Revolute(pi.ground, a[0]), pi.Revolute(a[1], b), pi.AngleMotor(a[1], b, angle, name="joint")],
    "prismatic": lambda a, b, angle: [pi.Revolute(pi.ground, a[0]), pi.Prismatic(a[1], b, name="joint")],
    "prismatic to ground": lambda a, b, angle: [pi.Prismatic(guide(a[0]), a[0], name="joint"), pi.Revolute(a[1], b)],
    "slot": lambda a, b, angle: [pi.Revolute(pi.ground, a[0]), pi.Slot(a[1], b, name="joint")],
    "distance": lambda a, b, angle: [
        pi.Revolute(pi.ground, a[0]),
        pi.Revolute(a[1], b),
        pi.Distance(pi.ground.at(a[0].point + (1.0, 0.8)), b.body.section("right"), name="joint"),
    ],
    "weld": lambda a, b, angle: [pi.Revolute(pi.ground, a[0]), pi.Weld(a[1], b, name="joint")],
    "weld to ground": lambda a, b, angle: [pi.Weld(a[0], pi.ground, name="joint"), pi.Revolute(a[1], b)],
    "path": lambda a, b, angle: [pi.PrescribedPosition(a[0], *way(a[0], angle), name="joint"), pi.Revolute(a[1], b)],
}


def guide(side):
    """A place of the ground from which a straight line at 30 degrees leads through a side."""
    along = np.array([np.cos(np.pi / 6), 0.5])
    return pi.ground.at(side.point - 0.7 * along, along)


def way(side, profile, share=(0.1, -0.05)):
    """Profiles of the places that a side goes to from where it is drawn, following shares of a profile."""
    moves = [[lambda t, f=f, s=s: s * f(t) for f in (profile.value, profile.d1, profile.d2)] for s in share]
    places = [lambda t, x=x, move=move: x + move[0](t) for x, move in zip(side.point, moves)]
    return [pi.profile.from_function(place, *move[1:], profile.kinks, profile.shortest) for place, move in zip(places, moves)]


def jointed(kind, angle=None, bend=0.4, gravity=GRAVITY, cells=20, mass=0.5, **options):
    """A scene of two plates and a tip mass with the joint of a kind in it, called "joint"."""
    angle = pi.profile.quintic(0.0, 0.6, duration=0.5) if angle is None else angle
    scene, upper, lower = pair(gravity, cells, bend, **options)
    for joint in JOINTS[kind]((upper.section("left"), upper.section("right")), lower.section("left"), angle):
        scene.add(joint)
    scene.add(pi.PointMass(lower.section("right"), mass, name="tip"))
    return scene


def rotation(angle):
    """Rotation matrix."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def turned(model, q, angle, shift=(0.0, 0.0)):
    """Coordinates of the state q turned about the origin and shifted, as one rigid body."""
    placed, moves = model.reference + q.reshape(-1, 2), np.ones((len(model.reference), 1))
    for body in model.reduced_bodies:
        moves[body.pairs, 0] = body.translation.real
    return (placed @ rotation(angle).T + moves * shift - model.reference).ravel()


def slope(steps, errors):
    """Fitted order: the slope of log error over log step."""
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


@pytest.fixture(scope="session")
def scenes():
    """The functions that make scenes, and their numbers."""
    return SimpleNamespace(
        mesh=mesh,
        plate=plate,
        single=single,
        hinged=hinged,
        pair=pair,
        cantilever=cantilever,
        jointed=jointed,
        rotation=rotation,
        turned=turned,
        slope=slope,
        PLATE_MASS=PLATE_MASS,
        THICKNESS=THICKNESS,
        RUBBER=RUBBER,
    )


@pytest.fixture(autouse=True)
def closed_figures():
    """Pictures that a test leaves open are closed: too many of them are a warning in a later one."""
    yield
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")


@pytest.fixture
def pages_alone(monkeypatch):
    """One process draws, and for reports' pages alone: the PNG and PDF files beside them are empty, which saves two thirds of the time."""
    from polyida.show import figure_files

    rendered = figure_files.rendered
    monkeypatch.setattr(figure_files, "rendered", lambda figure, kind: rendered(figure, kind) if kind == "svg" else b"")
    monkeypatch.setattr(figure_files, "cores", lambda: 1)


@pytest.fixture
def heeds_ctrl_c():
    """Python's own handler in place, also where the shell that started the tests in the background had SIGINT ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(params=JOINTS)
def kind(request):
    """Every kind of joint in turn."""
    return request.param


@pytest.fixture
def run():
    """A short run with every kind of part in it, the lower plate turned in its place, one profile of the user's own."""
    scene = jointed("motor between", angle=lambda t: 0.3 * np.sin(2.0 * t) ** 3)
    lower, upper = scene.parts["lower"], scene.parts["upper"]
    scene.add(pi.PointLoad(lower.section("right"), (0.5, 0.0), pi.profile.sine(1.0, 3.0), name="push"))
    scene.add(pi.EdgeTraction(upper.section("top"), (0.0, 10.0), lambda t: t * t, name="wind"))
    return pi.solve(scene.build(), 0.03, pi.GeneralizedAlpha(h=1e-3))


@pytest.fixture
def file(run, tmp_path):
    """The run in a file."""
    path = tmp_path / "run.h5"
    run.save(path)
    return path


@pytest.fixture
def in_a_new_process():
    """A function that calls another one in a new process, and returns its result.

    What forks runs there: after some thousand tests a process has so much memory reserved that the system may refuse to fork it.
    """
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield lambda function, *args, **options: pool.submit(function, *args, **options).result()
