"""Redundant constraints: left out on request, the reactions of all shared by least norm, against statics by hand."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import polyida as pi

G = 9.81
INTEGRATORS = {
    "alpha": lambda: pi.GeneralizedAlpha(h=1e-3),
    "energy": lambda: pi.EnergyMomentum(h=1e-3),
    "IDA": lambda: pi.IDA(rtol=1e-9, atol=1e-11),
    "Radau": lambda: pi.RadauIIA(rtol=1e-9),
}
FEET, CRANK, BEGIN, BAR, EACH = (0.0, 0.8, 2.0), 1.2, 1.1, 3.0, 0.5  # m, m, rad, kg, kg


def door(scenes, hinges):
    """A plate on as many hinges, all on the one axis through its left edge."""
    scene = pi.Scene(gravity=(0.0, -G))
    panel = scene.add(scenes.plate("panel", 12))
    for name in ("upper", "lower")[:hinges]:
        scene.add(pi.Revolute(pi.ground, panel.section("left"), name=name))
    return scene


def parallelogram(angle=BEGIN, feet=FEET):
    """A bar on equal cranks, all rigid."""
    scene = pi.Scene(gravity=(0.0, -G))
    ahead = CRANK * np.array([np.cos(angle), np.sin(angle)])
    points = {f"{k}": (x, 0.0) for k, x in enumerate(feet)}
    bar = scene.add(pi.RigidBody(BAR, 1.0, points, origin=ahead, center=(np.mean(feet), 0.0), name="bar"))
    for k, x in enumerate(feet):
        crank = scene.add(pi.RigidBody.bar(CRANK, EACH, origin=(x, 0.0), angle=angle, name=f"crank {k}"))
        scene.add(pi.Revolute(pi.ground.at((x, 0.0)), crank.at("left"), name=f"foot {k}"))
        scene.add(pi.Revolute(crank.at("right"), bar.at(f"{k}"), name=f"head {k}"))
    return scene


def test_two_hinges_on_one_axis_share_what_one_bears(scenes):
    runs = [
        pi.solve(door(scenes, hinges).build(redundant=how), 0.05, pi.GeneralizedAlpha(h=1e-3))
        for hinges, how in ((1, "refuse"), (2, "least-norm"))
    ]
    one, two = runs
    assert np.allclose(one.q, two.q, atol=1e-15)
    for name in ("upper", "lower"):
        assert np.allclose(two.reaction(name), 0.5 * one.reaction("upper"), rtol=1e-12, atol=1e-12)
        assert not two.unique(name) and one.unique("upper")
    assert two.model.m == 2 and set(two.model.redundant.labels) <= {"upper x", "upper y", "lower x", "lower y"}
    assert "redundant rows left out: " in two.summary() and "reactions not unique: 'upper', 'lower'" in two.summary()
    assert "redundant" not in one.summary()


def test_without_leave_a_run_does_not_start_and_says_what_would_help(scenes):
    with pytest.raises(pi.InputError, match=r"upper x, lower x are redundant.*or let build\(redundant=\"least-norm\"\) leave it out"):
        pi.consistent_state(door(scenes, 2).build())


def two_decks():
    """Two decks on two pins each, with a bar that hangs from each of them."""
    scene = pi.Scene(gravity=(0.0, -G))
    for name, x in ("west", 0.0), ("east", 5.0):
        deck = scene.add(pi.RigidBody(10.0, 1.0, {"l": (0.0, 0.0), "m": (0.5, -0.1), "r": (1.0, 0.0)}, origin=(x, 0.0), name=name))
        bar = scene.add(pi.RigidBody.bar(1.0, 1.0, origin=(x + 0.5, -0.1), angle=-1.0))
        scene.add(pi.Revolute(pi.ground, deck.at("l"), name=f"{name} left"))
        scene.add(pi.Revolute(deck.at("m"), bar.at("left"), name=f"{name} hook"))
        scene.add(pi.Revolute(pi.ground, deck.at("r"), name=f"{name} right"))
    return scene


LOOPS = {
    "the first of two": (
        two_decks,
        "constraints west left x, west right x are redundant: .*; 'west right' closes the loop of 'west left'; remove",
    ),
    "through three cranks": (
        parallelogram,
        "head 2 y are redundant: .*; 'head 2' closes the loop of 'foot 0', 'head 0', 'foot 1', 'head 1', 'foot 2'; remove it",
    ),
}


@pytest.mark.parametrize("case", LOOPS)
def test_the_joint_that_closes_a_dependent_loop_is_named_with_its_other_joints(case):
    make, words = LOOPS[case]
    with pytest.raises(pi.InputError, match=words):
        pi.consistent_state(make().build())


@pytest.mark.parametrize("name", INTEGRATORS)
def test_three_equal_cranks_move_as_one_pendulum_and_share_by_statics(name):
    """Against the pendulum's equation; the bar does not turn, so the forces on its heads make no moment about its middle."""
    run = pi.solve(parallelogram().build(redundant="least-norm"), 0.4, INTEGRATORS[name]())
    assert run.success
    inertia, pull = len(FEET) * EACH * CRANK**2 / 3 + BAR * CRANK**2, G * CRANK * (len(FEET) * EACH / 2 + BAR)
    swing = solve_ivp(lambda _, y: [y[1], -pull * np.cos(y[0]) / inertia], (0, 0.4), [BEGIN, 0.0], rtol=1e-12, atol=1e-12).y[0, -1]
    end = CRANK * np.array([np.cos(swing), np.sin(swing)])
    assert np.allclose(run.position("head 0")[-1], end, atol=2e-6 if name in ("alpha", "energy") else 1e-8)
    model = run.model
    assert model.m == model.redundant.whole.m - 1 and len(model.redundant.labels) == 1
    left_out = [np.abs(model.redundant.phi(t, q)).max() for t, q in zip(run.t, run.q)]
    assert max(left_out) <= run.drift.max() < 1e-9
    heads = np.array([run.reaction(f"head {k}") for k in range(3)])
    middle = np.mean(FEET)
    moment = [(x - middle) * force[:, 1] for x, force in zip(FEET, heads)]
    begun = run.t > 1e-6  # s: in IDA's first steps, of nanoseconds, multipliers have the round-off of q over the step's square
    assert np.abs(np.sum(moment, axis=0)[begun]).max() < 1e-6
    bar = run.a.reshape(len(run), -1, 2)[:, 0]
    assert np.allclose(heads.sum(axis=0), BAR * (bar + [0.0, G]), atol=1e-4 if name == "energy" else 1e-6)
    assert not any(run.unique(f"head {k}") or run.unique(f"foot {k}") for k in range(3))


def free_part(model, q):
    """Multipliers of no force at all, (rows, dimension), from phi_q alone."""
    B = model.phi_q(0.0, q).toarray()
    sizes, axes = np.linalg.eigh(B @ B.T)
    return axes[:, sizes < 1e-10 * sizes[-1]]


def test_multipliers_give_the_same_forces_and_no_others_are_smaller_on_the_joints():
    model = parallelogram().build(redundant="least-norm")
    redundant = model.redundant
    q = pi.consistent_state(model).q
    kept = np.random.default_rng(1).standard_normal((1, model.m))
    lam = redundant.multipliers([0.0], [q], kept)[0]
    assert np.allclose(redundant.whole.phi_q(0.0, q).T @ lam, model.phi_q(0.0, q).T @ kept[0], atol=1e-12)
    joints = np.concatenate([np.arange(*redundant.rows[name].indices(len(lam))) for name in redundant.rows if name[0] in "fh"])
    free = free_part(redundant.whole, q)
    assert free.shape[1] == 1 and np.abs(free[joints].T @ lam[joints]).max() < 1e-12


def test_a_rigid_plate_on_three_nodes_bears_as_a_group_of_bolts(scenes):
    """Forces of least squares: `F_i = W/3 + w i (x_i - mean)`, their moment that of the weight."""
    scene = pi.Scene(gravity=(0.0, -G))
    plate = scene.add(pi.Rigid(scenes.plate("plate", 12)))
    bolts = [plate.node(at) for at in ((0.0, 0.0), (0.4, 0.1), (0.1, 0.1))]
    for k, bolt in enumerate(bolts):
        scene.add(pi.Revolute(pi.ground, bolt, name=f"bolt {k}"))
    model = scene.build(redundant="least-norm")
    run = pi.solve(model, 2e-3, pi.GeneralizedAlpha(h=1e-3))
    assert len(model.redundant.labels) == 3 and not run.v.any()
    weight, x = scenes.PLATE_MASS * G, np.array([complex(*bolt.point) for bolt in bolts])
    arms = x - x.mean()
    moment = (0.5 - x.mean().real) * -weight  # of the weight at the centre (0.5, 0.05) about the mean
    expected = 1j * weight / 3 - 1j * arms * moment / np.sum(np.abs(arms) ** 2)
    found = np.array([run.reaction(f"bolt {k}")[-1] @ (1, 1j) for k in range(3)])
    assert np.allclose(found, expected, atol=1e-9 * weight)
    assert not any(run.unique(f"bolt {k}") for k in range(3))


def test_a_hinge_on_a_clamped_edge_takes_a_share_of_each_node(scenes):
    """Node i bears `f_i = f'_i + w_i R`; least of `sum |f'_i|^2 + |R|^2`: `R = sum w_i f_i / (1 + sum w_i^2)`."""
    runs = []
    for how in ("refuse", "least-norm"):
        scene, beam = scenes.cantilever(gravity=(0.0, -G), cells=12)
        scene.add(pi.PointMass(beam.section("right"), 0.1, name="tip"))
        edge = beam.section("left")
        if how == "least-norm":
            scene.add(pi.Revolute(edge, pi.ground, name="pin"))
        model = scene.build(redundant=how)
        runs.append(pi.solve(model, 2e-3, pi.GeneralizedAlpha(h=1e-3), state=pi.static(model)))
    alone = runs[0].reaction("root")[0].reshape(-1, 2)
    pin = edge.weights @ alone / (1.0 + edge.weights @ edge.weights)
    scale = np.abs(alone).max()
    assert np.allclose(runs[1].reaction("pin")[0], pin, atol=1e-7 * scale)
    assert np.allclose(runs[1].reaction("root")[0].reshape(-1, 2), alone - np.outer(edge.weights, pin), atol=1e-7 * scale)


def test_constraints_that_depend_on_each_other_in_one_position_alone_are_refused():
    with pytest.raises(pi.InputError, match="follows from the other constraints in this position alone"):
        parallelogram(0.0, (0.0, 2.0)).build(redundant="least-norm")


def driven_twice(turn):
    """A bar that two motors turn, the second by `turn`."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = scene.add(pi.RigidBody.bar(1.0, 1.0, name="bar"))
    scene.add(pi.Revolute(pi.ground, bar.at("left"), name="pin"))
    for name, whole in (("motor", 1.0), ("second", turn)):
        scene.add(pi.AngleMotor(pi.ground, bar.at("left"), pi.profile.quintic(0.0, whole, duration=1.0), name=name))
    return scene.build(redundant="least-norm")


@pytest.mark.parametrize("integrator", [pi.GeneralizedAlpha(h=0.02), pi.RadauIIA(), pi.IDA(rtol=1e-4), pi.EnergyMomentum(h=0.02)])
def test_motors_that_contradict_each_other_later_end_the_run(integrator):
    """Both are at rest at first: one of them is left out, and its row opens as they part."""
    run = pi.solve(driven_twice(2.0), 0.5, integrator)
    assert run.status == "contradiction" and run.message.startswith("second angle contradicts motor angle")
    assert run.drift.max() < 1e-4
    assert pi.solve(driven_twice(1.0), 0.5, integrator).success


def test_statics_and_starts_refuse_motors_that_contradict_each_other():
    assert pi.static(driven_twice(2.0)).q.max() < 1e-12
    with pytest.raises(pi.StepFailure, match="contradicts"):
        pi.static(driven_twice(2.0), t=0.3)
    q = pi.static(driven_twice(1.0), t=0.3).q
    pi.consistent_state(driven_twice(1.0), t0=0.3, q0=q)
    with pytest.raises(pi.InputError, match="second angle contradicts motor angle"):
        pi.consistent_state(driven_twice(2.0), t0=0.3, q0=q)
