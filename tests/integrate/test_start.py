"""What a run starts from: constraints and equations of motion hold to round-off; what cannot start is refused."""

import dataclasses

import numpy as np
import pytest

import polyida as pi
from polyida.integrate.alpha.start import jerk

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


@pytest.mark.filterwarnings("ignore::scipy.linalg.LinAlgWarning")
def test_a_coordinate_without_mass_or_constraint_is_refused():
    class Massless(type(pi.problems.get("pendulum").model)):
        m = 0

        def mass(self, q):
            return np.zeros((2, 2))

    with pytest.raises(pi.InputError, match="mass matrix is singular"):
        pi.consistent_state(Massless(), q0=[1.0, 0.0])


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
    scene.add(pi.PrescribedPosition(body.at("left"), pi.profile.polynomial([0.1, 1.0]), 0.0, name="rail"))
    with pytest.raises(pi.InputError, match=r"the drawing violates .*rail.*phi = -0.1 .*scene.assemble\(\)"):
        pi.consistent_state(scene.build())
    scene = pi.Scene()
    body = scene.add(pi.RigidBody.bar(1.0, 1.0))
    scene.add(pi.PrescribedPosition(body.at("left"), pi.profile.polynomial([0.1, 1.0]), 0.0))
    scene.assemble()
    assert np.allclose(pi.consistent_state(scene.build()).v[::2].max(), 1.0)


def test_a_start_without_q0_that_cannot_be_says_that_q0_is_zero():
    with pytest.raises(pi.InputError, match="q0 was not given and is zero"):
        pi.consistent_state(pi.problems.get("pendulum").model)


class Pendulum(pi.Model):
    """A mass on a rod of length L, in Cartesian coordinates."""

    n, m = 2, 1
    needs = pi.Needs(mass_varies=False, velocity_forces=False)

    def __init__(self, L):
        self.L = L

    def mass(self, q):
        return np.eye(2)

    def force(self, t, q, v):
        return np.array([0.0, 9.81])

    def phi(self, t, q):
        return np.array([0.5 * (q @ q - self.L**2)])

    def phi_q(self, t, q):
        return q[None, :].copy()


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_a_start_off_its_constraints_is_refused_in_any_unit_of_length(size):
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = scene.add(pi.RigidBody.bar(size, 1.0, name="bar"))
    scene.add(pi.Revolute(pi.ground, bar.at("left"), name="pin"))
    model, own = scene.build(), Pendulum(size)
    moved = np.zeros(model.n)
    moved[0::2] = 1.0
    for share, refused in ((0.3, True), (1e-4, True), (1e-9, False)):
        starts = (
            lambda share=share: pi.consistent_state(model, q0=share * size * moved),
            lambda share=share: pi.consistent_state(model, v0=share * np.sqrt(9.81 * size) * moved),
            lambda share=share: pi.consistent_state(own, q0=[size * (1.0 + share), 0.0]),
            lambda share=share: pi.consistent_state(own, q0=[size, 0.0], v0=[share * size, size]),
            lambda share=share: pi.modes(model, dataclasses.replace(pi.consistent_state(model), q=share * size * moved), count=1),
        )
        for start in starts:
            if refused:
                with pytest.raises(pi.InputError, match="violates the constraint"):
                    start()
            else:
                start()
