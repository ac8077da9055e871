"""Static equilibrium: reactions against weights, and published large deflections."""

import numpy as np
import pytest

import polyida as pi
from polyida.errors import StepFailure
from polyida.trajectory import Trajectory


def reaction(model, state, name):
    """What a joint does to its side b at rest."""
    frame = [np.array([x]) for x in (state.t, state.q, state.v, state.a, state.lam)]
    return Trajectory(model, None, *frame).reaction(name)[0]


def held(scenes, motor):
    """A plate on a hinge, held level by a motor: (model, state, weight, its moment about the hinge as it hangs)."""
    scene, upper = scenes.hinged(cells=40)
    scene.add(motor(upper.section("left")))
    model = scene.build()
    state = pi.static(model)
    weights = model.arrays.plates.weight[:, 1]
    hinge = upper.section("left").weights @ (model.reference + state.q.reshape(-1, 2))[upper.section("left").nodes]
    return model, state, weights, weights @ (model.reference + state.q.reshape(-1, 2) - hinge)[:, 0]


def test_hinge_carries_the_weight_and_the_motor_its_moment(scenes):
    model, state, weights, moment = held(scenes, lambda end: pi.AngleMotor(pi.ground, end, angle=0.0, name="drive"))
    assert np.allclose(reaction(model, state, "shoulder"), [0.0, -weights.sum()], atol=1e-8)
    assert reaction(model, state, "drive")[0] == pytest.approx(-moment, rel=1e-8)
    assert moment == pytest.approx(-scenes.PLATE_MASS * 9.81 * 0.5, rel=0.05)


@pytest.mark.parametrize("sides, sign", [(lambda end: (pi.ground, end), 1.0), (lambda end: (end, pi.ground), -1.0)])
def test_clamp_carries_the_weight(scenes, sides, sign):
    scene, upper = scenes.single()
    scene.add(pi.Clamp(*sides(upper.section("left")), name="root"))
    model = scene.build()
    total = reaction(model, pi.static(model), "root").reshape(-1, 2).sum(axis=0)
    assert np.allclose(total, [0.0, sign * scenes.PLATE_MASS * 9.81], atol=1e-8)


def cantilever_tip(mesh, material, thickness, gravity, load=(0.0, 0.0)):
    """Displacement of the mid node of the right edge, m."""
    scene = pi.Scene(gravity=gravity)
    plate = scene.add(pi.Plate(mesh, material, thickness))
    scene.add(pi.Clamp(plate.section("left")))
    scene.add(pi.PointLoad(plate.section("right"), load))
    length = mesh.points[:, 0].max()
    return pi.static(scene.build(), steps=3).q.reshape(-1, 2)[plate.node((length, 0.0)).nodes[0]]


def test_elastica():
    """Cantilever under a dead tip load, P L^2 / (E I) = 1: Bisshopp and Drucker 1945, elliptic integrals."""
    height, thickness, E = 0.02, 0.01, 1e9
    load = E * thickness * height**3 / 12
    mesh = pi.mesh.rectangle(1.0, height, cells=1000, seed=1)
    u, w = cantilever_tip(mesh, pi.Material(E, 0.0, 1000.0), thickness, (0.0, 0.0), (0.0, -load))
    assert -w == pytest.approx(0.3017207737998131, rel=1e-3)
    assert -u == pytest.approx(0.05643323628337693, rel=1e-3)


def test_csm1():
    """Turek and Hron's CSM1 with a straight clamp at x = 0.24899: a beam under its own weight.

    Reference: biquadratic elements, 280 x 16. Two meshes are extrapolated at order 2.
    """
    material = pi.Material(1.4e6, 0.4, 1000.0, plane="strain")
    coarse, fine = (
        1e3 * cantilever_tip(pi.mesh.quads(0.35101, 0.02, *cells), material, 1.0, (0.0, -2.0)) for cells in ((140, 8), (280, 16))
    )
    assert fine == pytest.approx([-7.2225, -66.280], rel=5e-3)
    assert (4 * fine - coarse) / 3 == pytest.approx([-7.2225, -66.280], rel=1e-3)


class Rod(pi.Model):
    """A mass of 1 kg on a rod of 1 m about the origin, held upright by a torsion spring or by nothing."""

    n, m = 2, 1

    def __init__(self, spring=0.0):
        self.spring = spring

    def mass(self, q):
        return np.eye(2)

    def force(self, t, q, v):
        return np.array([self.spring * q[0], 9.81])

    def phi(self, t, q):
        return np.array([q @ q - 1.0])

    def phi_q(self, t, q):
        return 2 * q[None]


@pytest.mark.parametrize("spring, start, stable", [(0.0, -1.0, True), (0.0, 1.0, False), (9.8, 1.0, False), (9.82, 1.0, True)])
@pytest.mark.filterwarnings("ignore:static")
def test_a_pendulum_hangs_stably_and_stands_where_its_spring_bears_the_weight(spring, start, stable):
    """On the constraint the stiffness is spring - g upright, spring + g hanging."""
    found = pi.static(Rod(spring), q0=[0.0, start])
    assert found.stable is stable and found.falling == (0 if stable else 1)


@pytest.mark.parametrize("angle", [0.0, 0.7])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_energy_of_a_plate_that_turns_freely_falls_nowhere(seed, angle):
    """No load and one hinge: the sign of its zero stiffness is round-off, and so may be the force that finds it."""
    scene = pi.Scene()
    plate = scene.add(pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=20, seed=seed), pi.Material(5e7, 0.3, 1100.0), 0.01, angle=angle))
    scene.add(pi.Revolute(pi.ground, plate.section("left")))
    try:
        assert pi.static(scene.build()).stable is None
    except StepFailure as failure:
        assert "move freely" in str(failure)


def test_an_upright_plate_on_a_hinge_is_unstable_and_said_so(scenes):
    model = scenes.hinged(angle=np.pi / 2)[0].build()
    with pytest.warns(UserWarning, match="static.*UNSTABLE.*falls in 1 direction;"):
        found = pi.static(model)
    assert not found.stable and "UNSTABLE" in found.summary()
    assert pi.solve(model, 2e-3, pi.GeneralizedAlpha(h=1e-3), state=found).success


@pytest.mark.filterwarnings("ignore:static")
def test_a_column_under_its_weight_is_stable_up_to_greenhill_s_height(scenes):
    """q L^3 = 7.837 E I (Greenhill 1881), of a slender cantilever; beyond the second, 55.98, energy falls in two directions."""
    height, length = 0.1, 1.0
    weight = scenes.RUBBER["rho"] * 9.81 * height
    for share, ways in ((0.9, 0), (1.1, 1), (55.98 / 7.837 * 1.15, 2)):
        E = weight * length**3 * 12 / height**3 / (7.837 * share)
        scene, plate = scenes.single(angle=np.pi / 2, cells=80, material={"E": E, "nu": 0.0})
        scene.add(pi.Clamp(pi.ground, plate.section("left")))
        assert pi.static(scene.build(), steps=2).falling == ways


class Follower(Rod):
    """A force that turns with the rod has no potential."""

    def force(self, t, q, v):
        return np.array([q[1], 9.81 - q[0] + q[1]])


def test_forces_without_potential_are_not_judged():
    found = pi.static(Follower(), q0=[0.0, -1.0])
    assert found.stable is None and "no potential" in found.summary()


def bent(load):
    """(model, state) of a cantilever, L / h = 50, under a dead tip load in units of E I / L^2, asked for in one part."""
    scene = pi.Scene()
    plate = scene.add(pi.Plate(pi.mesh.rectangle(1.0, 0.02, cells=150, seed=1), pi.Material(1e9, 0.0, 1000.0), 0.01))
    scene.add(pi.Clamp(plate.section("left")))
    scene.add(pi.PointLoad(plate.section("right"), (0.0, -load * 1e9 * 0.01 * 0.02**3 / 12), name="tip"))
    model = scene.build()
    return model, pi.static(model)


def test_the_load_is_put_on_in_parts_where_newton_s_method_fails():
    model, state = bent(30.0)
    assert state.halved > 0 and f"load in {state.parts} parts, halved {state.halved} times" in state.summary()
    steps = pi.static(model, steps=8)
    assert steps.halved == 0 and steps.parts == 8 and np.abs(steps.q - state.q).max() < 1e-9


def test_a_load_beyond_the_greatest_ends_with_what_was_borne(scenes):
    """St. Venant-Kirchhoff's material collapses in compression."""
    model = scenes.cantilever((0.0, -9.81), material={"E": 2e4})[0].build()
    with pytest.raises(StepFailure, match="of the load is borne: if that is the most, pi.equilibrium_path"):
        pi.static(model)


def test_what_can_move_freely_is_said(scenes):
    with pytest.raises(StepFailure, match="move freely"):
        pi.static(scenes.single()[0].build())


@pytest.mark.parametrize("body", [lambda plate: plate, lambda plate: pi.Reduced(plate, modes=2), pi.Rigid])
def test_what_hangs_is_found_though_nothing_holds_it_before_it_is_stretched(scenes, body):
    scene = pi.Scene(gravity=(0.0, -9.81))
    hung = scene.add(body(scenes.plate("hung", angle=-np.pi / 2)))
    scene.add(pi.Revolute(pi.ground, hung.section("left"), name="hook"))
    model = scene.build()
    found = pi.static(model)
    assert found.stable and reaction(model, found, "hook") == pytest.approx([0.0, scenes.PLATE_MASS * 9.81], abs=1e-8)


def hinged_with_a_controller():
    """A bar of 1 kg, on a hinge, with a spring, 3 N m/rad, and a controller, 40 N m/rad towards 0.3 rad; its stiffness in translation is zero."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = scene.add(pi.RigidBody.bar(1.0, 1.0, name="bar"))
    scene.add(pi.Revolute(pi.ground, bar.at("left"), name="hinge"))
    scene.add(pi.TorsionSpring(pi.ground, bar.at("left"), stiffness=3.0, name="spring"))
    scene.add(pi.PID(bar.at("left"), kp=40.0, kd=8.0, target=0.3, filter=0.01, name="pid"))
    scene.add(pi.PointMass(bar.at("right"), 1e-9, name="tip"))
    return scene.build()


def test_small_displacements_with_first_order_states():
    rest = pi.static(hinged_with_a_controller(), linear=True)
    assert rest.x[1] == pytest.approx((40.0 * 0.3 - 0.5 * 9.81) / 43.0, rel=1e-7)


def test_gradients_of_equilibria_with_first_order_states():
    """`40 (0.3 - angle) = 3 angle + m g cos(angle)/2` with the slope of the mean square distance `2 - 2 cos(angle)` in kp."""
    model = hinged_with_a_controller()
    rest, path = pi.static(model), pi.objective.Deviation("tip", lambda t: np.array([1.0, 0.0]))
    angle = rest.x[1]
    slope = 2.0 * np.sin(angle) * (0.3 - angle) / (43.0 - 0.5 * 9.81 * np.sin(angle))
    assert pi.gradient(rest, path, ["pid.kp"])["pid.kp"] == pytest.approx(slope, rel=1e-7)
    assert max(pi.check_gradient(rest, path, ["pid.kp", "pid.value", "spring.stiffness", "bar.mass"]).values()) < 1e-7
    with pytest.raises(pi.InputError, match="small displacements of models with first-order states"):
        pi.gradient(pi.static(model, linear=True), path)


@pytest.mark.parametrize("length", [1e-9, 1e-5, 1e6])
def test_an_equilibrium_does_not_depend_on_the_unit_of_length(length):
    def angle(length):
        scene = pi.Scene(gravity=(0.0, -9.81))
        bar = scene.add(pi.RigidBody.bar(length, 1.0, name="bar"))
        scene.add(pi.Revolute(pi.ground, bar.at("left"), name="hinge"))
        scene.add(pi.SpringDamper(pi.ground.at((0.0, -2.0 * length)), bar.at("right"), stiffness=9.81 / length, name="spring"))
        return pi.static(scene.build()).q / length

    assert np.abs(angle(length) - angle(1.0)).max() < 1e-9


def test_a_clamped_rigid_body_rests_where_it_is():
    """Nothing is elastic: K = 0."""
    scene = pi.Scene((0.0, -9.81))
    body = scene.add(pi.RigidBody.bar(1.0, 2.0, name="bar"))
    scene.add(pi.Clamp(body.at("left"), name="wall"))
    model = scene.build()
    state = pi.static(model)
    assert state.stable and not state.q.any()
    assert np.allclose(model.reactions("wall", state.q[None], state.lam[None, model.rows["wall"]]), [[0.0, -19.62, -9.81]])


@pytest.mark.parametrize(
    ("element", "told"),
    [
        (lambda bar: pi.PID(bar.at("left"), kp=50.0, ki=20.0, limit=2.0, name="control"), "'control', which is at its limit of 2 N m"),
        (lambda bar: pi.DCMotor(bar.at("left"), volts=3.0, k=0.5, L=0.05, R=1.0, name="motor"), "'motor'"),
    ],
)
def test_a_mechanism_names_the_element_that_does_not_hold_it(element, told):
    """Both act on the bar, but their torque does not change with its angle: that of a PID beyond its limit, and that of a motor at rest."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = scene.add(pi.RigidBody.bar(1.0, 1.0, name="bar"))
    scene.add(pi.Revolute(pi.ground, bar.at("left")))
    scene.add(pi.SpringDamper(pi.ground.at((1.0, 1.0)), bar.at("right"), damping=1.0, stiffness=0.0, name="damper"))
    scene.add(element(bar))
    with pytest.raises(StepFailure, match="move freely") as failure:
        pi.static(scene.build())
    assert told in str(failure.value)
    assert "'damper'" in str(failure.value)
