"""A solve in several threads gives, bit by bit, what one thread gives."""

import numpy as np
import pytest

import polyida as pi
from polyida import environment
from polyida.assembly import equilibrium
from polyida.jit import compilers, entry
from polyida.linear.dissection import symbolic_of
from polyida.linear.fronts import factorize, solve_fronts
from polyida.linear.team import at_work, solve_together, team
from polyida.problems import plates
from polyida.system import scene as compiled_loop


def same(a, b):
    """To the bit; to round-off where numba's own compilers inline the two differently, and so reassociate sums differently."""
    tolerance = 0.0 if compilers else 1e3 * np.finfo(np.float32).eps * abs(a).max()
    return abs(a - b).max() <= tolerance


@entry
def solved(s, panels, x, t):
    solve_together(s, panels, x, t)


class Made:
    """A factor as `at_work` takes it."""

    def __init__(self, fronts, panels):
        self.fronts, self.panels = fronts, panels


def factored(scene, c=1e4):
    model = scene.build()
    s, blocks = model.once(symbolic_of), np.empty((len(model.pattern[1]), 2, 2))
    equilibrium.tangent_blocks(model.arrays, np.zeros((model.n_nodes, 2)), None, abs(c), 0.0, 1.0, blocks)
    panels = factorize(s, c / abs(c) * blocks)
    return Made(s, panels), model.n


def one_plate():
    scene = pi.Scene()
    scene.add(pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=300, seed=1), plates.RUBBER, thickness=0.01))
    return scene


SCENES = {"one plate": one_plate, "two plates": lambda: plates.double_plate(150), "five plates": lambda: plates.plate_chain(5, cells=40)}


@pytest.mark.parametrize(
    "scene, count, c", [("one plate", 2, 1e4), ("two plates", 3, 1e4 + 1e3j), ("two plates", 3, 1e4), ("five plates", 4, 1e4)]
)
def test_a_solve_is_the_same_for_any_number_of_threads(scene, count, c):
    """Also of a right side that is zero on most fronts, which are passed over."""
    factor, n = factored(SCENES[scene](), c)
    t = team(factor.fronts, count, factor.panels.dtype)
    assert list(t.cuts) == sorted(t.cuts) and t.cuts[0] == 0 and t.cuts[-1] == len(factor.fronts.children)
    random = np.random.default_rng(0)
    sparse = np.zeros(n)
    sparse[random.integers(0, n, 3)] = 1.0
    for b in (random.standard_normal(n), sparse):
        alone, x = b.astype(factor.panels.dtype), b.astype(factor.panels.dtype)
        solve_fronts(factor.fronts, factor.panels, alone)
        with at_work(t, factor, x):
            solved(factor.fronts, factor.panels, x, t)
        assert same(alone, x) and np.abs(x).max() > 0


@pytest.fixture
def two_threads(monkeypatch):
    """Two threads whatever the machine has, for small scenes too."""
    monkeypatch.setattr(environment, "cores", lambda: 2)
    monkeypatch.setattr(compiled_loop, "SHARED", 1)
    yield lambda count: pi.threads(count)
    environment._threads[0] = 1


@pytest.mark.parametrize("scene", [plates.double_plate, plates.double_plate_motors])
def test_a_run_is_the_same_in_two_threads(scene, two_threads):
    runs = []
    for count in (1, 2):
        assert two_threads(count) == count
        runs.append(pi.solve(scene(40).build(), 0.05, pi.GeneralizedAlpha(h=1e-3)))
    assert all(same(getattr(runs[0], name), getattr(runs[1], name)) for name in ("q", "v", "a", "lam"))
    assert vars(runs[0].counts) == vars(runs[1].counts) and runs[0].success


def test_a_failing_run_sends_its_threads_home(two_threads):
    import threading

    two_threads(2)
    before = threading.active_count()
    run = pi.solve(plates.double_plate(20).build(), 0.05, pi.GeneralizedAlpha(h=5e-2, max_iterations=1, max_halvings=0))
    assert not run.success and threading.active_count() == before
