"""The systems of joints along the graph of bodies: chains, loops, stars and plates against numpy, real and complex."""

import numpy as np
import pytest

import polyida as pi
from polyida.assembly.border import solve_border, solve_in_order
from polyida.assembly.rate_multipliers import rate_multipliers
from polyida.assembly.scene_step_matrix import SceneStepMatrix
from polyida.jit import entry
from polyida.problems.literature import n_four_bar

C = {"real": 2e3, "complex": 2e3 * (0.66 + 0.75j)}


def bar(scene, k, x, y=0.0, angle=0.0, length=1.0):
    return scene.add(pi.RigidBody.bar(length, 1.0 + 0.1 * k, (x, y), angle, name=f"bar {k}"))


def chain(count=5):
    scene = pi.Scene(gravity=(0.0, -9.81))
    bars = [bar(scene, k, k) for k in range(count)]
    scene.add(pi.Revolute(pi.ground, bars[0].at("left")))
    for one, other in zip(bars, bars[1:]):
        scene.add(pi.Revolute(one.at("right"), other.at("left")))
    return scene, bars


def loop():
    """A chain that is closed by a slot, with a mass and a spring between its bodies."""
    scene, bars = chain(4)
    scene.add(pi.Slot(pi.ground.at((4.0, 0.0), direction=(0.0, 1.0)), bars[-1].at("right")))
    scene.add(pi.PointMass(bars[1].at("center"), 2.0))
    scene.add(pi.SpringDamper(bars[0].at("center"), bars[2].at("center"), stiffness=1e3, damping=10.0))
    return scene


def star():
    """Bars around one in the middle, one of them on rails that turn with it."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    ends = {f"end {k}": (np.cos(k), np.sin(k)) for k in range(6)}
    middle = scene.add(pi.RigidBody(2.0, 0.3, ends, name="middle"))
    for k, (name, (x, y)) in enumerate(ends.items()):
        other = bar(scene, k, x, y, angle=k)
        joint = pi.Prismatic if k == 3 else pi.Revolute
        scene.add(joint(middle.at(name, direction=(np.cos(k), np.sin(k))), other.at("left"), name=f"joint {k}"))
    return scene


def mixed():
    """A plate between rigid bars, and a motor."""
    scene, bars = chain(2)
    plate = scene.add(pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=12, seed=1), pi.Material(5e7, 0.3, 1100.0), 0.01, origin=(2.0, 0.0)))
    scene.add(pi.Revolute(bars[1].at("right"), plate.section("left")))
    scene.add(pi.AngleMotor(bars[0].at("right"), bars[1].at("left"), angle=lambda t: t**3))
    return scene


SCENES = {"chain": lambda: chain()[0], "four-bars": lambda: n_four_bar(4), "loop": loop, "star": star, "plate": mixed}


@entry
def solved(b, w):
    return solve_border(b, w)


@entry
def fixed_order_solves(b, w):
    return solve_in_order(b, w)


def step_of(model, c, lam, q):
    step, zero = SceneStepMatrix(model), np.zeros(model.n)
    step.factor(0.1, q, zero, zero, lam, c * c, c)
    return step


def state(model, seed=0):
    random = np.random.default_rng(seed)
    return 1e-3 * random.standard_normal(model.n), random.standard_normal(model.m), random


@pytest.mark.parametrize("c", C.values(), ids=C)
@pytest.mark.parametrize("name", SCENES)
def test_the_saddle_is_that_of_the_whole_matrix(name, c):
    """The factor is in single precision; the rows hold to round-off all the same."""
    model = SCENES[name]().build()
    q, lam, random = state(model)
    step, zero = step_of(model, c, lam, q), np.zeros(model.n)
    r, phi = (random.standard_normal(k) * size * type(c)(c / abs(c)) for k, size in ((model.n, 1.0), (model.m, 1e-6)))
    S, B = model.tangent(0.1, q, zero, zero, lam, c * c, c, 1.0).toarray(), model.phi_q(0.1, q).toarray()
    whole = np.block([[S, B.T], [B, np.zeros((model.m, model.m))]])
    exact, (dq, dlam) = np.linalg.solve(whole, -np.concatenate([r, phi])), step.saddle(0.1, q, lam, r, phi)
    assert np.abs(B @ dq + phi).max() < 1e-11 * np.abs(dq).max()
    assert np.abs(dq - exact[: model.n]).max() < 2e-4 * np.abs(dq).max()
    assert np.abs(dlam - exact[model.n :]).max() < 2e-4 * np.abs(dlam).max()


@pytest.mark.parametrize("c", C.values(), ids=C)
@pytest.mark.parametrize("name", SCENES)
def test_the_unknowns_are_those_of_a_dense_solve(name, c):
    """With w and lam, and with mu: the numbers that the state left, and random ones in their places."""
    model = SCENES[name]().build()
    q, lam, random = state(model)
    step = step_of(model, c, lam, q)
    step.saddle(0.1, q, lam, random.standard_normal(model.n), np.zeros(model.m))
    other = rate_multipliers(model)
    other.workspace.slots[:] = random.standard_normal(len(other.workspace.slots))
    other.workspace.blocks[:] += random.standard_normal(len(other.workspace.blocks))
    for b, w in ((step.corotated.border, step.workspace.border), (other.border, other.workspace)):
        w.right[:] = random.standard_normal(len(w.right))
        assert solved(b, w)
        x, matrix = w.x.copy(), assembled(b, w)
        assert np.abs(matrix @ x - w.right).max() < 1e-10 * (np.abs(matrix) @ np.abs(x)).max()
        assert np.allclose(x, np.linalg.solve(matrix, w.right), rtol=1e-6, atol=1e-6 * np.abs(x).max())


def assembled(b, w):
    """`I_w + F G E` by numpy, from the lists of the pattern."""
    matrix = np.zeros((len(w.x), len(w.x)), w.x.dtype)
    for n, (begin, end) in enumerate(zip(b.block, b.block[1:])):
        wide = round((end - begin) ** 0.5)
        rows, columns = range(b.row_start[n], b.row_start[n + 1]), range(b.column_start[n], b.column_start[n + 1])
        F, E = np.zeros((len(w.x), wide), w.x.dtype), np.zeros((wide, len(w.x)), w.x.dtype)
        for r in rows:
            at = slice(b.row_entry[r], b.row_entry[r + 1])
            np.add.at(F, (b.rows[r], b.row_component[at]), w.slots[b.row_slot[at]])
        for k in columns:
            at = slice(b.column_entry[k], b.column_entry[k + 1])
            np.add.at(E, (b.column_component[at], b.columns[k]), w.slots[b.column_slot[at]])
        matrix += F @ w.blocks[begin:end].reshape(wide, wide) @ E
    matrix[np.arange(len(b.active)), np.arange(len(b.active))] += 1.0
    return matrix


def test_pivoting_takes_over_where_the_fixed_order_has_no_pivot():
    """A multiplier that takes all inertia of a bar's turn away: the whole system is regular, the first pivots of the order are zero."""
    scene, bars = chain(3)
    model, c = scene.build(), 2e3
    q, lam, random = np.zeros(model.n), np.zeros(model.m), np.random.default_rng(1)
    lam[model.rows["bar 1"]] = -bars[1].gyration * c * c * bars[1].mass
    step, zero = step_of(model, c, lam, q), np.zeros(model.n)
    r = random.standard_normal(model.n)
    S, B = model.tangent(0.1, q, zero, zero, lam, c * c, c, 1.0).toarray(), model.phi_q(0.1, q).toarray()
    whole = np.block([[S, B.T], [B, np.zeros((model.m, model.m))]])
    dq, dlam = step.saddle(0.1, q, lam, r, np.zeros(model.m))
    assert not fixed_order_solves(step.corotated.border, step.workspace.border)
    exact = np.linalg.solve(whole, -np.concatenate([r, np.zeros(model.m)]))
    assert (
        np.abs(dq - exact[: model.n]).max() < 1e-4 * np.abs(dq).max() and np.abs(dlam - exact[model.n :]).max() < 1e-4 * np.abs(dlam).max()
    )


def test_dependent_rows_are_singular():
    """Twice the same pin: also pivoting finds no solution."""
    scene, bars = chain(2)
    model = scene.build()
    links = model.arrays.links
    assert np.isfinite(model.mass_system(0.0, np.zeros(model.n)).solve(np.ones(model.n), np.ones(model.m))[1]).all()
    links.row_slopes[links.row_start[2] : links.row_start[4]] = 0.0  # the second pin holds nothing
    with pytest.raises(np.linalg.LinAlgError):
        model.mass_system(0.0, np.zeros(model.n)).solve(np.ones(model.n), np.ones(model.m))
