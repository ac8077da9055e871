"""What a run starts from: constraints and equations of motion hold to round-off; what cannot start is refused."""

import numpy as np
import pytest

import polyida as pi
from polyida.integrate.kinks import segments
from polyida.integrate.start import jerk
from polyida.integrate.state import State

STEP = pi.GeneralizedAlpha(h=1e-3)
MOVING = pi.profile.sine(0.5, 0.4)


def holds(model, state, size=1e-10):
    """The three constraint levels and the residual at a state, each below `size` of its terms."""
    B = model.phi_q(state.t, state.q)
    assert np.abs(model.phi(state.t, state.q)).max() < size
    assert np.abs(B @ state.v + model.phi_t(state.t, state.q)).max() < size * max(1.0, np.abs(state.v).max())
    assert np.abs(B @ state.a + model.phi_bias(state.t, state.q, state.v)).max() < size * max(1.0, np.abs(state.a).max())
    r = model.residual(state.t, state.q, state.v, state.a, state.lam)
    assert np.abs(r).max() < size * max(1.0, np.abs(B.T @ state.lam).max())


def test_scene_starts_from_rest(scenes, kind):
    model = scenes.jointed(kind).build()
    state = pi.consistent_state(model)
    holds(model, state)
    assert not state.q.any() and not state.v.any()


def test_a_moving_motor_sets_the_velocity(scenes):
    model = scenes.jointed("motor to ground", MOVING).build()
    state = pi.consistent_state(model)
    holds(model, state)
    assert np.abs(state.v).max() > 0.05


def test_user_model_with_all_terms():
    from polyida.problems import get

    for name in ("pendulum", "car-axis", "andrews"):
        given = get(name)
        state = pi.consistent_state(given.model, 0.0, given.q0, given.v0)
        holds(given.model, state, 1e-8)
        assert np.abs(state.q - given.q0).max() < 1e-6 and np.abs(state.v - given.v0).max() < 1e-6


def test_round_off_is_projected_away():
    model = pi.problems.get("pendulum").model
    state = pi.consistent_state(model, 0.0, [-1.0 + 3e-7, 0.0], [2e-7, 1.0])
    holds(model, state, 1e-14)


def test_given_velocity_is_kept_where_it_is_consistent(scenes):
    """A rigid spin of the hinged plate is consistent: v stays, the spin's centripetal acceleration comes out."""
    scene, _ = scenes.hinged((0.0, 0.0), material={"E": 1e12})
    model = scene.build()
    spin = 3.0 * np.column_stack([-model.reference[:, 1], model.reference[:, 0]]).ravel()
    state = pi.consistent_state(model, v0=spin)
    assert np.allclose(state.v, spin, atol=1e-12)
    holds(model, state)


def test_jerk_is_the_slope_of_the_acceleration():
    model = pi.problems.get("pendulum").model
    state = pi.consistent_state(model, 0.0, [-1.0, 0.0], [0.0, 1.3])
    q, v = state.q, state.v
    tension = lambda q, v: v @ v + 9.81 * -q[1]  # noqa: E731
    slope = 2 * v @ state.a + 9.81 * -v[1]
    exact = -slope * q - tension(q, v) * v
    assert np.allclose(jerk(model, state, 1e-3), exact, rtol=1e-5)


@pytest.mark.parametrize(
    "name, value, match",
    [
        ("q0", [-0.9, 0.0], r"q0 violates the constraint phi\[0\]: phi = -0.095"),
        ("v0", [0.5, 0.0], r"v0 violates the constraint phi\[0\]: .* = -0.5"),
        ("q0", [1.0], r"q0: shape \(1,\), it must be 2 finite numbers"),
        ("v0", [np.nan, 0.0], "v0: .*finite"),
        ("q0", "here", "q0"),
        ("t0", np.inf, "t0 = inf"),
    ],
)
def test_wrong_starts(name, value, match):
    given = {"q0": [-1.0, 0.0], "v0": [0.0, 0.0]} | {name: value}
    with pytest.raises(pi.InputError, match=match):
        pi.consistent_state(pi.problems.get("pendulum").model, **given)


@pytest.mark.parametrize("second", ["revolute", "clamp"])
def test_redundant_joints_are_named(scenes, second):
    scene, upper = scenes.hinged()
    joint = {"revolute": pi.Revolute, "clamp": pi.Clamp}[second]
    scene.add(joint(pi.ground, upper.section("left"), name="hinge again"))
    with pytest.raises(pi.InputError, match="(?=.*shoulder)(?=.*hinge again)(?=.*redundant)"):
        pi.consistent_state(scene.build())


def test_a_motor_that_contradicts_a_clamp_is_named(scenes):
    scene, upper = scenes.cantilever()
    scene.add(pi.AngleMotor(pi.ground, upper.section("left"), angle=MOVING, name="drive"))
    with pytest.raises(pi.InputError, match="(?=.*root)(?=.*drive)"):
        pi.consistent_state(scene.build())


@pytest.mark.parametrize("angle", [0.5, np.pi, -2.0])
def test_a_motor_that_does_not_start_at_the_angle_of_the_scene_is_named(scenes, angle):
    """The section alone would be turned to the angle, and the plate torn; the scene must be drawn in its start."""
    scene, upper = scenes.hinged()
    scene.add(pi.AngleMotor(pi.ground, upper.section("left"), angle=angle, name="drive"))
    with pytest.raises(pi.InputError, match="drive"):
        pi.solve(scene.build(), 0.01, pi.GeneralizedAlpha(h=1e-3))


def test_constraints_that_cannot_be_met_are_named():
    class Apart(type(pi.problems.get("pendulum").model)):
        def phi(self, t, q):
            return np.array([q @ q + 1.0])

        def phi_q(self, t, q):
            return 2 * q[None]

    with pytest.raises(pi.InputError, match=r"phi\[0\]"):
        pi.consistent_state(Apart(), q0=[1.0, 0.0])


@pytest.mark.parametrize("unit", [1.0, 1e-3, 1e6])
def test_a_start_with_round_off_about_zero_is_taken_as_it_is(unit):
    """The cosine of a right angle is 6e-17: where phi_q is a little off, Newton would halve that for ever."""

    class Crank(type(pi.problems.get("pendulum").model)):
        def phi(self, t, q):
            return q[:1]

        def phi_q(self, t, q):
            return np.array([[1.25, 0.0]])

    start = unit * np.array([np.cos(np.pi / 2), 1.0])
    assert (pi.consistent_state(Crank(), q0=start).q == start).all()


@pytest.mark.filterwarnings("ignore::scipy.linalg.LinAlgWarning")
def test_a_coordinate_without_mass_or_constraint_is_refused():
    class Massless(type(pi.problems.get("pendulum").model)):
        m = 0

        def mass(self, q):
            return np.zeros((2, 2))

    with pytest.raises(pi.InputError, match="mass matrix is singular"):
        pi.consistent_state(Massless(), q0=[1.0, 0.0])


@pytest.mark.parametrize(
    "kinks, pieces",
    [
        ((), [(0.0, 1.0)]),
        ((0.0, 1.0), [(0.0, 1.0)]),
        ((0.25, 0.5), [(0.0, 0.25), (0.25, 0.5), (0.5, 1.0)]),
        ((-1.0, 1e-15, 2.0), [(0.0, 1.0)]),
    ],
)
def test_runs_are_parted_at_kinks(kinks, pieces):
    model = type("Kinked", (pi.Model,), {"kinks": lambda self, t0, t1: [t for t in kinks if t0 < t < t1]})()
    assert segments(model, 0.0, 1.0) == pieces


def test_going_on_from_a_state(scenes):
    model = scenes.jointed("motor between").build()
    whole, first = (pi.solve(model, end, pi.GeneralizedAlpha(h=1e-3, tolerance=1e-8)) for end in (0.1, 0.06))
    last = State(first.t[-1], first.q[-1], first.v[-1], first.a[-1], first.lam[-1], first.memory)
    rest = pi.solve(model, 0.1, pi.GeneralizedAlpha(h=1e-3, tolerance=1e-8), state=last)
    assert rest.t[0] == first.t[-1] and np.abs(rest.q[-1] - whole.q[-1]).max() < 1e-10
    assert np.abs(rest.lam[-1] - whole.lam[-1]).max() < 1e-5


def test_a_state_of_another_model_is_refused(scenes):
    other = pi.consistent_state(pi.problems.get("pendulum").model, 0.0, [-1.0, 0.0])
    with pytest.raises(pi.InputError, match="state"):
        pi.solve(scenes.hinged()[0].build(), 0.1, STEP, state=other)


def test_initial_values_beside_a_state_are_refused(scenes):
    model = scenes.hinged()[0].build()
    with pytest.raises(pi.InputError, match="q0"):
        pi.solve(model, 0.1, STEP, state=pi.consistent_state(model), q0=np.zeros(model.n))


@pytest.mark.parametrize("held", [False, True], ids=["free", "held"])
def test_a_start_with_a_cell_turned_inside_out_is_refused_by_name(held, scenes):
    scene, upper = scenes.single()
    if held:
        scene.add(pi.Revolute(pi.ground, upper.section("left")))
    model, cell = scene.build(), 7
    q = np.zeros((model.n_nodes, 2))
    corners = upper.mesh.cell(cell)
    inner = next(node for node in corners if node not in upper.mesh.boundary_nodes)
    middle = upper.points[corners].mean(axis=0)
    q[inner] = 3.0 * (middle - upper.points[inner])
    with pytest.raises(pi.InputError, match=r"start cannot be accepted: cell \d+ of 'upper' at .* is turned inside out"):
        pi.consistent_state(model, q0=q.ravel())


def test_a_drawing_off_its_path_is_named_with_what_helps():
    scene = pi.Scene()
    body = scene.add(pi.RigidBody.bar(1.0, 1.0))
    scene.add(pi.Path(body.at("left"), pi.profile.polynomial([0.1, 1.0]), 0.0, name="rail"))
    with pytest.raises(pi.InputError, match=r"the drawing violates .*rail.*phi = -0.1 .*scene.assemble\(\)"):
        pi.consistent_state(scene.build())
    scene = pi.Scene()
    body = scene.add(pi.RigidBody.bar(1.0, 1.0))
    scene.add(pi.Path(body.at("left"), pi.profile.polynomial([0.1, 1.0]), 0.0))
    scene.assemble()
    assert np.allclose(pi.consistent_state(scene.build()).v[::2].max(), 1.0)


def test_a_place_of_the_ground_is_told_once():
    scene = pi.Scene()
    body = scene.add(pi.RigidBody.bar(1.0, 1.0, name="bar"))
    scene.add(pi.Revolute(pi.ground.at((0.0, 1.0)), body.at("left"), name="pin"))
    with pytest.raises(pi.InputError, match=r"its sides are ground at \(0, 1\) and .*bar.* at \(0, 0\), 1 m apart"):
        scene.build()
