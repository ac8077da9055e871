"""PID, LinearController, DCMotor and Maxwell: closed forms, limits, gradients in gains, refusals."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import StateSpace, TransferFunction

import polyida as pi
from polyida.problems.plates import double_plate

INERTIA, END = 0.5, 1.0
DRIVE = {"volts": 12.0, "k": 0.8, "L": 0.05, "R": 1.5, "gear": 2.0}


def rotor(part, **settings):
    """A rotor of 0.5 kg m2 about its centre of mass, with a part on its direction."""
    scene = pi.Scene()
    body = scene.add(pi.RigidBody(mass=1.0, inertia=INERTIA, points={"c": (0.0, 0.0), "rim": (1.0, 0.0)}, name="rotor"))
    scene.add(pi.Revolute(pi.ground.at((0.0, 0.0)), body.at("c"), name="axle"))
    scene.add(pi.PointMass(body.at("rim"), 1e-12, name="rim"))
    scene.add(part(body.at("c"), **settings, name="drive"))
    return scene.build()


def angle(run):
    return float(np.arctan2(*run.position("rim")[-1][::-1]))


@pytest.mark.parametrize("integrator, tolerance", [(pi.RadauIIA(rtol=1e-10), 1e-9), (pi.IDA(rtol=1e-9), 1e-7)])
def test_dc_motor_meets_its_closed_form(integrator, tolerance):
    V, k, L, R = DRIVE["volts"], DRIVE["k"] * DRIVE["gear"], DRIVE["L"], DRIVE["R"]
    A = np.array([[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, k / INERTIA, 0.0], [0.0, -k / L, -R / L, V / L], np.zeros(4)])
    turned, _, current, _ = expm(0.3 * A) @ [0.0, 0.0, 0.0, 1.0]
    run = pi.solve(rotor(pi.DCMotor, **DRIVE), 0.3, integrator)
    assert angle(run) == pytest.approx(turned, abs=tolerance)
    assert run.states("drive")[-1, 0] == pytest.approx(current, abs=10 * tolerance)


def closed_loop(kp, ki, kd):
    """(angle, I) of the rotor at the end, under a PID with the target 0.5 rad."""
    A = np.array(
        [[0.0, 1.0, 0.0, 0.0], [-kp / INERTIA, -kd / INERTIA, 1.0 / INERTIA, 0.5 * kp / INERTIA], [-ki, 0.0, 0.0, 0.5 * ki], np.zeros(4)]
    )
    return (expm(END * A) @ [0.0, 0.0, 0.0, 1.0])[[0, 2]]


@pytest.mark.parametrize("integrator, tolerance", [(pi.RadauIIA(rtol=1e-10), 1e-9), (pi.IDA(rtol=1e-9), 1e-7)])
def test_pid_meets_its_closed_form(integrator, tolerance):
    run = pi.solve(rotor(pi.PID, kp=20.0, ki=30.0, kd=4.0, target=0.5), END, integrator)
    turned, integral = closed_loop(20.0, 30.0, 4.0)
    assert angle(run) == pytest.approx(turned, abs=tolerance)
    assert run.states("drive")[-1] == pytest.approx([integral, 0.0], abs=30 * tolerance)


@pytest.mark.parametrize("integrator, tolerance", [(pi.RadauIIA(rtol=1e-10), 1e-9), (pi.IDA(rtol=1e-9), 1e-7)])
def test_a_pid_turns_a_flexible_arm_as_its_closed_form(integrator, tolerance):
    """Hub and arm are two rotors on one axle with a spring between them: the equations of their angles are linear."""
    kp, ki, kd, spring, arm = 20.0, 30.0, 4.0, 60.0, 0.2
    scene, points = pi.Scene(), {"c": (0.0, 0.0), "rim": (1.0, 0.0)}
    bodies = [scene.add(pi.RigidBody(1.0, inertia, points, name=name)) for inertia, name in ((INERTIA, "hub"), (arm, "arm"))]
    for body in bodies:
        scene.add(pi.Revolute(pi.ground.at((0.0, 0.0)), body.at("c"), name=f"axle of the {body.name}"))
    scene.add(pi.TorsionSpring(bodies[0].at("c"), bodies[1].at("c"), stiffness=spring, name="flexibility"))
    scene.add(pi.PID(bodies[0].at("c"), kp=kp, ki=ki, kd=kd, target=0.5, name="pid"))
    scene.add(pi.PointMass(bodies[1].at("rim"), 1e-12, name="rim"))
    run = pi.solve(scene.build(), END, integrator)
    A = np.zeros((6, 6))  # of the angles, their rates, the integral and 1
    A[0, 2] = A[1, 3] = 1.0
    A[2] = np.array([-kp - spring, spring, -kd, 0.0, 1.0, 0.5 * kp]) / INERTIA
    A[3, :2] = spring / arm, -spring / arm
    A[4, 0], A[4, 5] = -ki, 0.5 * ki
    _, turned, _, _, integral, _ = expm(END * A) @ [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    assert angle(run) == pytest.approx(turned, abs=tolerance)
    assert run.states("pid")[-1, 0] == pytest.approx(integral, abs=30 * tolerance)


@pytest.mark.parametrize("integrator, tolerance", [(pi.RadauIIA(rtol=1e-10), 1e-9), (pi.IDA(rtol=1e-9), 1e-7)])
def test_maxwell_meets_its_closed_form(integrator, tolerance):
    """A body on a rail along the element, `e'' = -k (e - s) / m`, `s' = k (e - s) / c`."""
    k, c = 50.0, 10.0
    scene = pi.Scene()
    body = scene.add(pi.RigidBody(mass=1.0, inertia=0.1, points={"c": (0.0, 0.0)}, velocity=(1.0, 0.0), name="body"))
    scene.add(pi.Prismatic(pi.ground.at((0.0, 0.0), direction=(1.0, 0.0)), body.at("c"), name="rail"))
    scene.add(pi.PointMass(body.at("c"), 1e-12, name="c"))
    scene.add(pi.Maxwell(pi.ground.at((-2.0, 0.0)), body.at("c"), stiffness=k, damping=c, name="element"))
    run = pi.solve(scene.build(), END, integrator)
    e, _, s = expm(END * np.array([[0.0, 1.0, 0.0], [-k, 0.0, k], [k / c, 0.0, -k / c]])) @ [0.0, 1.0, 0.0]
    assert run.position("c")[-1, 0] == pytest.approx(e, abs=tolerance)
    assert run.states("element")[-1, 0] == pytest.approx(s, abs=tolerance)


def test_a_linear_controller_of_scipy_is_the_pid_with_a_filter():
    kp, ki, kd, lag = 20.0, 30.0, 4.0, 0.05
    K = StateSpace([[0.0, 0.0], [0.0, -1.0 / lag]], [[1.0], [1.0]], [[ki, -kd / lag**2]], [[kp + kd / lag]])
    pushed = []  # with the target 0 the derivatives of error and angle agree
    for part, settings in ((pi.LinearController, dict(A=K.A, B=K.B, C=K.C, D=K.D)), (pi.PID, dict(kp=kp, ki=ki, kd=kd, filter=lag))):
        model = rotor(part, **settings)
        v0 = np.zeros(model.n)
        v0[3] = 1.0
        pushed.append(angle(pi.solve(model, END, pi.RadauIIA(rtol=1e-9), v0=v0)))
    assert pushed[0] == pytest.approx(pushed[1], abs=1e-8) and abs(pushed[0]) > 1e-3


def test_a_limit_keeps_the_torque_and_the_integral_bounded():
    run = pi.solve(rotor(pi.PID, kp=20.0, ki=200.0, kd=4.0, target=2.0, limit=1.0), END, pi.RadauIIA(rtol=1e-7))
    free = pi.solve(rotor(pi.PID, kp=20.0, ki=200.0, kd=4.0, target=2.0), END, pi.RadauIIA(rtol=1e-7))
    assert run.success
    assert angle(run) == pytest.approx(0.5 * 1.0 / INERTIA * END**2, rel=1e-3)  # the limit all the time
    assert abs(run.states("drive")[:, 0]).max() < abs(free.states("drive")[:, 0]).max()


def test_maxwell_dissipates_what_it_loses():
    scene = pi.Scene()
    body = scene.add(pi.RigidBody(mass=1.0, inertia=0.1, points={"c": (0.0, 0.0)}, origin=(1.0, 0.0), velocity=(0.0, 1.0), name="body"))
    scene.add(pi.Maxwell(pi.ground.at((0.0, 0.0)), body.at("c"), stiffness=50.0, damping=10.0, name="element"))
    run = pi.solve(scene.build(), 2.0, pi.RadauIIA(rtol=1e-10), output=np.linspace(0.0, 2.0, 401))
    lost = run.energy.total[0] - run.energy.total
    assert lost[-1] > 0.01
    assert run.energy.dissipated["element"] == pytest.approx(lost, abs=1e-7)


@pytest.mark.parametrize("integrator", [pi.GeneralizedAlpha(h=0.005, tolerance=1e-12), pi.RadauIIA(h=0.02, tolerance=1e-13)])
def test_gradients_in_gains(integrator):
    gains, names = {"kp": 20.0, "ki": 30.0, "kd": 4.0}, ["drive.kp", "drive.ki", "drive.kd"]
    goal = pi.objective.Deviation("rim", lambda t: (np.cos(0.5), np.sin(0.5)))

    def run(**changes):
        return pi.solve(rotor(pi.PID, target=0.5, filter=0.02, **(gains | changes)), 0.4, integrator)

    result = pi.gradient(run(), goal, parameters=names)
    for name, value in gains.items():
        step = 1e-4 * value
        near = [goal(run(**{name: value + s * step})) for s in (1.0, -1.0)]
        assert result[f"drive.{name}"] == pytest.approx((near[0] - near[1]) / (2 * step), rel=1e-6)


def held_arm(*parts):
    """A bar of 2 kg on a hinge under gravity, with parts on its end."""
    scene = pi.Scene(gravity=(0.0, -10.0))
    bar = scene.add(pi.RigidBody.bar(1.0, 2.0, name="bar"))
    scene.add(pi.Revolute(pi.ground.at((0.0, 0.0)), bar.at("left"), name="pin"))
    scene.add(pi.PointMass(bar.at("right"), 1e-12, name="tip"))
    for part in parts:
        scene.add(part(bar))
    return scene.build()


def test_tables_have_states_and_outputs():
    run = pi.solve(held_arm(lambda bar: pi.PID(bar.at("right"), kp=60.0, filter=0.01, name="pid")), 0.1, pi.GeneralizedAlpha(h=0.01))
    data = run.to_xarray()
    assert list(data.state.values) == ["pid.integral", "pid.filtered"] and np.array_equal(data.x, run.x)
    assert np.array_equal(run.to_dataframe()["pid.filtered"], run.x[:, 1])


def test_the_integral_state_carries_the_weight_in_static_equilibrium():
    model = held_arm(lambda bar: pi.PID(bar.at("right"), kp=60.0, ki=80.0, kd=8.0, target=0.4, filter=0.01, name="pid"))
    rest = pi.static(model)
    tip = model.position("tip", rest.q[None])[0]
    assert tip == pytest.approx([np.cos(0.4), np.sin(0.4)], abs=1e-9)
    assert rest.x == pytest.approx([10.0 * np.cos(0.4), 0.4], abs=1e-8)
    run = pi.solve(model, 0.5, pi.RadauIIA(rtol=1e-8), state=rest)
    assert run.states("pid")[0] == pytest.approx([10.0 * np.cos(0.4), 0.4], abs=1e-8)
    assert np.ptp(run.position("tip"), axis=0) == pytest.approx([0.0, 0.0], abs=1e-9)  # it stays


def test_statics_of_maxwell_leaves_its_force_zero():
    model = held_arm(
        lambda bar: pi.TorsionSpring(pi.ground.at((0.0, 0.0)), bar.at("left"), stiffness=30.0, name="spring"),
        lambda bar: pi.Maxwell(pi.ground.at((1.0, 1.0)), bar.at("right"), stiffness=50.0, damping=10.0, name="element"),
    )
    without = held_arm(lambda bar: pi.TorsionSpring(pi.ground.at((0.0, 0.0)), bar.at("left"), stiffness=30.0, name="spring"))
    assert pi.static(model).q[: without.n] == pytest.approx(pi.static(without).q, abs=1e-9)


def test_gradients_refuse_sampled_controllers():
    from dataclasses import dataclass

    @dataclass(frozen=True, eq=False)
    class Held(pi.Controller):
        at: object
        period: float = 0.1
        name: str | None = None

        def sides(self):
            return (self.at.d,)

        def sample(self, t, x, v, s, u):
            return u

        def forces(self, t, x, v, s, u):
            return np.zeros((1, 2))

    run = pi.solve(rotor(Held), 0.2, pi.GeneralizedAlpha(h=0.01))
    with pytest.raises(pi.InputError, match="sampled Controller"):
        pi.gradient(run, pi.objective.Deviation("rim", lambda t: (1.0, 0.0)))


def test_a_matrix_of_a_controller_of_another_size_is_refused_by_name():
    with pytest.raises(pi.InputError, match="drive.*B = "):
        rotor(pi.LinearController, A=[[1.0]], B=[1.0, 2.0], C=[1.0], D=0.0)


def test_systems_of_scipy_and_python_control_go_in_as_they_are():
    K, at = StateSpace([[-2.0]], [[1.0]], [[3.0]], [[4.0]]), pi.RigidBody.bar(1.0, 1.0, name="bar").at("left")
    for system in (K, SimpleNamespace(A=K.A, B=K.B, C=K.C, D=K.D, dt=0)):  # of python-control
        part = pi.LinearController(at, system)
        assert (part.A, part.B, part.C, part.D) == (-2.0, 1.0, 3.0, 4.0)
    for system in (K.to_discrete(0.01), SimpleNamespace(A=K.A, B=K.B, C=K.C, D=K.D, dt=True)):
        with pytest.raises(pi.InputError, match="drive.*in discrete time.*polyida.Controller"):
            pi.LinearController(at, system, name="drive")
    with pytest.raises(pi.InputError, match="A is a TransferFunctionContinuous; give its to_ss"):
        pi.LinearController(at, TransferFunction([1.0], [1.0, 2.0]))


@pytest.mark.parametrize("integrator, most", [(pi.GeneralizedAlpha(h=1e-3), 2.2), (pi.EnergyMomentum(h=1e-3), 5.0)])
def test_newton_does_not_slow_down_where_a_plate_turns_with_an_element(integrator, most):
    scene = pi.Scene(gravity=(0.0, -9.81))
    plate = scene.add(pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=60, seed=1), pi.Material(E=2e8, nu=0.3, rho=1000.0), 0.01, name="plate"))
    scene.add(pi.Revolute(pi.ground.at((0.0, 0.0)), plate.section("left"), name="pin"))
    scene.add(pi.TorsionSpring(pi.ground.at((0.0, 0.0)), plate.section("left"), stiffness=60.0, damping=8.0, name="spring"))
    run = pi.solve(scene.build(), 0.5, integrator)
    assert run.counts.newton_iterations <= most * run.steps and run.counts.factorizations <= 2


def controlled_bars():
    """A motor and a PID on a double pendulum."""
    first, second = pi.RigidBody.bar(1.0, 1.0, name="first"), pi.RigidBody.bar(1.0, 1.0, (1.0, 0.0), name="second")
    scene = pi.Scene(gravity=(0.0, -9.81))
    for part in (
        *(first, second, pi.Revolute(pi.ground, first.at("left")), pi.Revolute(first.at("right"), second.at("left"))),
        pi.DCMotor(first.at("right"), pi.profile.sine(6.0, 1.0), k=0.05, L=1e-3, R=1.0, gear=20.0),
        pi.PID(second.at("left"), kp=5.0, ki=2.0, kd=0.2, target=0.3, against=first.at("right"), filter=0.01),
    ):
        scene.add(part)
    return scene.build()


def test_slopes_of_a_controller_turn_with_rigid_bodies():
    assert pi.solve(controlled_bars(), 1.2, pi.GeneralizedAlpha(h=1e-3)).counts.factorizations == 1


def test_a_jump_of_a_controller_takes_few_factors():
    scene = double_plate(160)
    elbow = scene.parts["elbow"]
    scene.add(pi.PID(elbow.b, kp=5.0, ki=2.0, kd=0.2, target=0.3, against=elbow.a, filter=0.01))
    run = pi.solve(scene.build(), 0.004, pi.GeneralizedAlpha(h=1e-3))
    assert run.success and run.counts.rejected == 0 and run.counts.factorizations <= 8


@pytest.mark.parametrize("transposed", [False, True])
@pytest.mark.parametrize("c", [2e3, (1.0 + 2.0j) * 1e3])
def test_eliminated_states_solve_the_whole_matrix(c, transposed):
    model, random = controlled_bars(), np.random.default_rng(1)
    q, zero, right = pi.consistent_state(model).q, np.zeros(model.m), random.normal(size=model.n)
    v = np.zeros(model.n)
    v[model.state_columns] = random.normal(size=model.k)
    step = model.step_matrix()
    step.factor(0.0, q, v, 0.0 * q, zero, c * c, c)
    whole = model.tangent(0.0, q, v, 0.0 * q, zero, c * c, c, 1.0).toarray()
    expected = np.linalg.solve(whole.T if transposed else whole, right)
    assert step.solve(q, right + 0.0 * c, transposed=transposed) == pytest.approx(expected, abs=1e-6 * abs(expected).max())
    assert len(step.corotated.border.active) == 4  # the components of two directions: none of a state
