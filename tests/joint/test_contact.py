"""Contact without stiffness: momentum, penetration, energy, opening of penetration, and what other functions say of models with laws."""

import numpy as np
import pytest

import polyida as pi
from polyida.io.scene_data import from_data, to_data
from polyida.study.comparison import compare
from polyida.study.ivp import InitialValueProblem

G = 9.81
EAST = pi.ground.at((0.0, 0.0), direction=(1.0, 0.0))
STEPS = pi.NonsmoothAlpha(h=5e-3)


def body(name, at, points=(), **motion):
    """A body of 1 kg with the point "c" at its centre."""
    return pi.RigidBody(mass=1.0, inertia=0.01, points={"c": (0.0, 0.0)} | dict(points), origin=at, name=name, **motion)


def block(y=0.1, gravity=(0.0, -G), **contact):
    """A scene with a block, 0.2 m wide and high, on two points of its lower edge."""
    scene = pi.Scene(gravity=gravity)
    moving = scene.add(body("block", (0.0, y), {"left": (-0.1, -0.1), "right": (0.1, -0.1)}))
    for name in ("left", "right"):
        scene.add(pi.Contact(moving.at(name), EAST, name=name, **contact))
    return scene


def momenta(model, run):
    """Momentum in x and y, and about the origin, (frames, 3), of rigid bodies."""
    M, result = model.mass(run.q[0]), []
    for q, v in zip(run.q, run.v):
        x, p = model.reference + q.reshape(-1, 2), (M @ v).reshape(-1, 2)
        p, turning = p * 1.0, float((x[:, 0] * p[:, 1] - x[:, 1] * p[:, 0]).sum())
        result.append([*sum(p[2 * k] for k in range(len(p) // 2)), turning])
    return np.array(result)


def test_plate_falls_flat():
    """All nodes land at once: the change of momentum is that of weight and reaction, nothing penetrates, and energy does not grow."""
    scene = pi.Scene(gravity=(0.0, -G))
    plate = pi.Plate(
        pi.mesh.quads(1.0, 0.5, 6, 3), pi.Material(1e7, 0.3, 1000.0), 0.01, origin=(0.0, 0.26), velocity=(0.2, -2.0), name="plate"
    )
    scene.add(plate)
    scene.add(pi.Contact(plate.section("bottom"), EAST, friction=0.3, name="floor"))
    model, weight = scene.build(), np.array([0.0, -5.0 * G])
    run = pi.solve(model, 0.05, pi.NonsmoothAlpha(h=5e-4, rho_inf=0.5))
    assert run.success, run.message
    assert len(model.labels) == 2 * 7 and run.events and run.events[0].name == "floor"
    p = np.array([(model.mass(q) @ v).reshape(-1, 2).sum(axis=0) for q, v in zip(run.q, run.v)])
    before = int(np.searchsorted(run.t, run.events[0].t))
    assert np.abs(p[before - 1] - p[0] - run.t[before - 1] * weight).max() < 1e-11
    assert np.abs(p[-1] - p[0] - 5e-4 * (weight - run.reaction("floor")[1:]).sum(axis=0)).max() < 5e-3 * np.ptp(p[:, 1])
    assert run.drift.max() < 1e-9 and run.velocity_drift.max() == 0.0
    assert np.diff(run.energy.total).max() < 1e-3 * run.energy.kinetic.max() and run.energy.total[1:].max() <= run.energy.total[0] * (
        1 + 1e-12
    )
    run = pi.solve(model, 0.05, pi.MoreauJean(h=1e-3))
    p = np.array([(model.mass(q) @ v).reshape(-1, 2).sum(axis=0) for q, v in zip(run.q, run.v)])
    assert np.abs(np.diff(p, axis=0) - 1e-3 * (weight - run.reaction("floor")[1:])).max() < 1e-10


def test_block_rests_on_two_points():
    """On an incline below the angle of friction; the normal forces balance weight and its moment."""
    a = 0.2
    run = pi.solve(block(gravity=(G * np.sin(a), -G * np.cos(a)), friction=0.3).build(), 0.5, STEPS)
    assert run.success, run.message
    assert np.abs(run.q).max() < 1e-12
    left, right = run.reaction("left")[-1], run.reaction("right")[-1]
    assert np.abs(left + right - [G * np.sin(a), -G * np.cos(a)]).max() < 1e-8
    assert abs(0.1 * (right[1] - left[1]) + 0.1 * G * np.sin(a)) < 1e-8
    assert run.drift.max() < 1e-12 and "grows" not in run.summary()


def test_line_of_a_moving_body():
    """A ball hits a beam in flight: momentum of both and angular momentum are conserved, with friction; without, also the energy if e = 1."""
    for e, mu in ((0.5, 0.3), (1.0, 0.0)):
        scene = pi.Scene(gravity=(0.0, 0.0))
        beam = scene.add(body("beam", (0.0, 0.0), velocity=(0.0, 0.5), spin=0.3))
        ball = scene.add(body("ball", (0.2, 0.3), velocity=(0.4, -2.0)))
        scene.add(pi.Contact(ball.at("c"), beam.at("c"), restitution=e, friction=mu, name="hit"))
        model = scene.build()
        for integrator in (STEPS, pi.RadauIIA(rtol=1e-10)):
            run = pi.solve(model, 0.3, integrator)
            assert run.success and [one.name for one in run.events] == ["hit"], run.message
            p = momenta(model, run)
            error = 1e-9 if integrator is not STEPS else 1e-3  # of first order at impacts, where the time is that of a step
            assert np.abs(p - p[0])[:, :2].max() < 1e-12 and np.abs(p - p[0])[:, 2].max() < error
            assert run.drift.max() < 1e-11
            lost = run.energy.total[0] - run.energy.total[-1]
            assert integrator is STEPS or abs(lost - run.events[0].energy_lost) < error
            assert e < 1.0 or abs(lost) < 10 * error


def test_circle():
    """A ball falls beside the top of a fixed circle, e = 1: it rebounds by the law of reflection."""
    scene = pi.Scene(gravity=(0.0, 0.0))
    ball = scene.add(body("ball", (0.3, 1.0), velocity=(0.0, -1.0)))
    scene.add(pi.Contact(ball.at("c"), pi.ground.at((0.0, 0.0)), restitution=1.0, radius=0.5, name="hoop"))
    run = pi.solve(scene.build(), 1.0, pi.RadauIIA(rtol=1e-9))
    assert run.success, run.message
    assert abs(run.events[0].t - 0.6) < 1e-9
    assert np.abs(run.v[-1, :2] - [2 * 0.8 * 0.6, 2 * 0.8 * 0.8 - 1.0]).max() < 1e-9 and run.drift.max() < 1e-9


@pytest.mark.parametrize("integrator", [pi.NonsmoothAlpha(h=2e-4), pi.MoreauJean(h=2e-4)], ids=lambda x: type(x).__name__)
def test_a_reduced_plate_rests_on_more_nodes_than_it_has_coordinates(integrator):
    scene = pi.Scene(gravity=(0.0, -G))
    plate = pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=20, seed=1), pi.Material(1e8, 0.3, 1000.0), 0.01, origin=(0.0, 0.05), name="plate")
    plate = scene.add(pi.Reduced(plate, 4))
    scene.add(pi.Contact(plate.section("bottom"), EAST, name="floor"))
    run = pi.solve(scene.build(), 4e-3, integrator)
    assert run.success, run.message
    assert run.lam.max() <= 0.0 and np.abs(run.position(plate.section("bottom"))[:, 1]).max() < 1e-6


def test_assemble_opens_penetration_alone():
    scene = block(y=0.05, friction=0.3)
    with pytest.raises(pi.InputError, match=r"left: its sides are 0\.05 m within each other"):
        scene.build()
    moved = scene.assemble()
    assert moved.shift["block"] == pytest.approx(0.05) and moved.turn["block"] == pytest.approx(0.0, abs=1e-12)
    assert pi.solve(scene.build(), 0.05, STEPS).success
    above = block(y=0.4, friction=0.3).assemble()
    assert above.largest == 0.0 and above.gap == 0.0


def test_open_gaps_and_slip_are_no_drift():
    """A ball falls, lands and slides; a comparison takes its reference by events too."""
    scene = pi.Scene(gravity=(0.0, -G))
    ball = scene.add(body("ball", (0.0, 0.1), velocity=(1.0, 0.0)))
    scene.add(pi.Contact(ball.at("c"), EAST, friction=0.1, name="floor"))
    model = scene.build()
    run = pi.solve(model, 0.3, STEPS)
    assert run.drift.max() < 1e-12 and run.velocity_drift.max() < 1e-12
    assert "|phi| <= 0.1" not in run.summary() and run.unique("floor")
    assert np.abs(run.reaction("floor")[-1] - [0.1 * G, -G]).max() < 1e-9
    speed = 1.0 - 0.1 * G * 0.3  # mu times the impulse of the impact, and of the weight behind it
    assert abs(run.v[-1, 0] - speed) < 1e-9
    found = compare(InitialValueProblem("ball", model, 0.3), integrators={"steps": STEPS, "alpha": pi.GeneralizedAlpha(h=1e-2)})
    assert found.success
    assert found.rows[1]["error_max"] < 1e-9 and found.rows[0]["error_end"] < 2e-2 and found.rows[1]["drift_max"] < 1e-9


def test_functions_of_equations_refuse_laws():
    scene = block()
    model, late = scene.build(), pi.Event(when=lambda s: s.t - 0.01, name="late")
    run = pi.solve(model, 0.01, STEPS)
    for call in (
        lambda: pi.static(model),
        lambda: pi.modes(model),
        lambda: pi.gradient(run, pi.objective.Deviation("block", (0.0, 0.0))),
        lambda: scene.build(redundant="least-norm"),
        lambda: pi.solve(model, 0.1, pi.RadauIIA(), events=[late]),
    ):
        with pytest.raises(pi.InputError, match="contact and friction of 'left', 'right' are no equations"):
            call()


def test_rigid_bodies_have_no_contact_mass():
    with pytest.raises(pi.InputError, match="not of a full plate"):
        pi.Contact(body("ball", (0.0, 1.0)).at("c"), EAST, contact_mass=0.1)


def test_a_disc_is_about_a_point_of_a_body():
    plate = pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=10, seed=1), pi.Material(E=1e7, nu=0.3, rho=1000.0), 0.01)
    for a, b, disc, message in (
        (plate.section("bottom"), EAST, 0.1, "a point of a body for a"),
        (body("ball", (0.0, 1.0)).at("c"), plate.section("top"), 0.1, "a line or a circle for b"),
        (body("ball", (0.0, 1.0)).at("c"), EAST, 0.0, "disc = 0.0"),
    ):
        with pytest.raises(pi.InputError, match=message):
            pi.Contact(a, b, disc=disc)


def test_files_keep_contacts_and_read_the_former_name_of_penalty_contacts():
    scene = block(friction=0.3)
    scene.add(pi.PenaltyContact(scene.parts["block"].at("c"), EAST, 1e3, name="soft"))
    description, arrays, _ = to_data(scene.build())
    kinds = [entry for entry in description["parts"] if entry["kind"] == "PenaltyContact"]
    assert len(kinds) == 1
    kinds[0]["kind"] = "Contact"
    parts, _ = from_data(description, arrays)
    assert isinstance(parts["soft"], pi.PenaltyContact) and parts["soft"].stiffness == 1e3
    assert isinstance(parts["left"], pi.Contact) and parts["left"].friction == 0.3


def test_clearance():
    """A pin that slides in its hole is a pendulum; two free bodies with friction keep their momenta."""
    c, along = 0.02, np.array([np.sin(0.5), -np.cos(0.5)])
    ends = []
    for joint in (lambda a, b: pi.Clearance(a, b, gap=c), pi.Distance):
        scene = pi.Scene(gravity=(0.0, -G))
        pin = scene.add(body("pin", tuple(c * along)))
        scene.add(joint(pi.ground.at((0.0, 0.0)), pin.at("c")))
        run = pi.solve(scene.build(), 0.2, pi.RadauIIA(rtol=1e-9))
        assert run.success, run.message
        ends.append(run.q[-1, :2])
    assert np.abs(ends[0] - ends[1]).max() < 1e-8
    scene = pi.Scene(gravity=(0.0, 0.0))
    hole, pin = scene.add(body("hole", (0.0, 0.0), spin=2.0)), scene.add(body("pin", (0.0, 0.0), velocity=(1.0, 0.5)))
    scene.add(pi.Clearance(hole.at("c"), pin.at("c"), gap=c, restitution=0.5, friction=0.3, pin_radius=0.1, name="bearing"))
    model = scene.build()
    run = pi.solve(model, 0.03, pi.RadauIIA(rtol=1e-10))
    assert run.success and run.events[0].name == "bearing", run.message
    p = momenta(model, run)
    assert np.abs(p - p[0]).max() < 1e-9 and np.abs(run.v[-1, 6:]).max() > 1e-3  # friction turns the pin
    for wrong, message in (({"gap": 0.0}, "gap = 0"), ({"gap": c, "friction": 0.1}, "pin_radius = None")):
        with pytest.raises(pi.InputError, match=message):
            pi.Clearance(hole.at("c"), pin.at("c"), **wrong)


def bouncing_bar(contact_mass, cells=20):
    """(run, its contact): an elastic bar of 10 m x 1 m, wave speed 30 m/s, falls 0.5 mm and bounces at t = 1 s; CFL number 0.5."""
    scene = pi.Scene(gravity=(0.0, -1e-3))
    bar = scene.add(pi.Plate(pi.mesh.quads(1.0, 10.0, 1, cells), pi.Material(900.0, 0.0, 1.0), 1.0, origin=(0.0, 5.0005), name="bar"))
    scene.add(pi.Contact(bar.section("bottom"), pi.ground.at((0.0, 0.0)), contact_mass=contact_mass, name="floor"))
    return pi.solve(scene.build(), 2.0, pi.NonsmoothAlpha(h=5.0 / 30.0 / cells, rho_inf=0.8))


def test_a_bar_keeps_its_energy_where_the_nodes_in_contact_have_little_mass():
    """While it touches the floor, 1 s < t < 5/3 s, the force is 300 t of 1e-4 N (Doyen, Ern, Piperno, SIAM J. Sci. Comput. 33 (2011) 223-249)."""
    light, whole = bouncing_bar(0.1), bouncing_bar(1.0)
    change = [run.energy.total[-1] / 5e-6 for run in (light, whole)]  # over m g times the height of fall
    assert abs(change[0]) < 0.006 and change[1] < -0.012, change
    middle = (light.t > 1.2) & (light.t < 1.5)
    assert -light.reaction("floor")[middle, 1] == pytest.approx(0.03 * light.t[middle], rel=0.02)
    mass = [run.model.mass(run.q[0]) for run in (light, whole)]
    assert mass[0].sum() == pytest.approx(mass[1].sum()) and np.linalg.eigvalsh(mass[0].toarray()).min() > 0.0
    assert light.model.mass(light.q[0])[0, 0] < 0.11 * whole.model.mass(whole.q[0])[0, 0]


def test_a_plate_thrown_on_its_corner():
    """All nodes of its rim may touch; the step matrix is factored once, steps in contact take few solves, and no impact adds energy."""
    scene = pi.Scene(gravity=(0.0, -G))
    rubber = pi.Material(E=50e6, nu=0.3, rho=1100.0)
    velocity, mesh = (1.0, -1.0), pi.mesh.rectangle(1.0, 0.5, cells=40, seed=1)
    plate = scene.add(pi.Plate(mesh, rubber, 0.01, origin=(0.0, 0.25), angle=0.3, velocity=velocity, spin=1.0, name="plate"))
    rim = sorted({int(node) for side in ("bottom", "right", "left", "top") for node in plate.section(side).nodes})
    scene.add(pi.Contact(plate.section(rim), pi.ground.at((0.0, 0.0)), friction=0.3, name="floor"))
    model = scene.build()
    run = pi.solve(model, 0.08, pi.NonsmoothAlpha(h=2e-4))
    assert run.success and run.events, run.message
    gaps, forces = np.array([model.phi(t, q)[::2] for t, q in zip(run.t, run.q)]), -np.asarray(run.lam)[:, ::2]
    assert gaps.min() > -1e-12 and forces.min() >= 0.0 and (gaps[forces > 0.0] < 1e-9).all()
    assert (np.abs(np.asarray(run.lam)[:, 1::2]) <= 0.3 * forces + 1e-9).all()
    assert np.diff(run.energy.total).max() < 2e-3 * run.energy.kinetic[0]
    assert run.counts.factorizations == 1 and run.counts.newton_iterations < 2.7 * run.counts.steps
    assert run.counts.solves < 3 * run.counts.steps


@pytest.mark.parametrize("integrator", [pi.NonsmoothAlpha(h=1e-3), pi.MoreauJean(h=1e-3), pi.RadauIIA(h=2e-3), pi.GeneralizedAlpha(h=1e-3)])
def test_friction_of_a_slide_that_a_motor_drives(integrator):
    """The equations hold the row of friction: its force is mu m g against the slip, and the motor gives it."""
    scene = pi.Scene(gravity=(0.0, -G))
    slider = scene.add(body("slider", (0.0, 0.0), velocity=(2.0, 0.0)))
    scene.add(pi.Prismatic(EAST, slider.at("c"), friction=0.3, name="guide"))
    scene.add(pi.PrescribedPosition(slider.at("c"), x=pi.profile.polynomial([0.0, 2.0, -10.0]), y=None, name="drive"))
    run = pi.solve(scene.build(), 0.15, integrator)
    assert run.success, run.message
    forces = np.asarray(run.lam)[:, run.model.rows["guide"].stop - 1]
    away = (np.abs(run.t - 0.1) > 2.5e-3) & (run.t > 0.0)  # the slip reverses
    assert forces[away] == pytest.approx(0.3 * G * np.sign(0.1 - run.t[away]), rel=1e-6)


@pytest.mark.parametrize("integrator", [pi.NonsmoothAlpha(h=1e-3), pi.GeneralizedAlpha(h=4e-3)])
def test_friction_on_a_driven_wall(integrator):
    """A wall drives a body with the acceleration A: it slides along the wall with the deceleration mu A until it sticks."""
    A, mu, v0 = 4.0, 0.25, 0.5
    scene = pi.Scene()
    slider = scene.add(body("slider", (0.0, 0.0), velocity=(0.0, v0)))
    scene.add(pi.PrescribedPosition(slider.at("c"), x=pi.profile.polynomial([0.0, 0.0, A / 2]), y=None, friction=mu, name="wall"))
    run = pi.solve(scene.build(), 0.8, integrator)
    assert run.success, run.message
    slides = np.minimum(run.t, v0 / (mu * A))
    assert run.position(slider.at("c"))[:, 1] == pytest.approx(v0 * slides - mu * A * slides**2 / 2, abs=1e-3)
    away = (np.abs(run.t - v0 / (mu * A)) > 2.5e-3) & (run.t > 0.0)
    force = np.array([np.full(len(run), A), np.where(run.t < v0 / (mu * A), -mu * A, 0.0)]).T
    assert run.reaction("wall")[away] == pytest.approx(force[away], abs=1e-6)
    gained = run.energy.total - run.energy.total[0]  # alpha has a frame at 0.5 s and one at the event, some 1e-14 s later
    assert sum(run.energy.work.values()) - sum(run.energy.dissipated.values()) == pytest.approx(gained, abs=1e-7)
    for wrong, message in (({"friction": -0.1}, "friction = -0.1"), ({"y": 0.0, "friction": 0.1}, "one of x and y must be None")):
        with pytest.raises(pi.InputError, match=message):
            pi.PrescribedPosition(slider.at("c"), **{"x": 0.0, "y": None} | wrong)


def test_two_nearly_parallel_floors():
    """A ball that penetrates both within a step is put back onto one of them: the other pushes, and does not pull."""
    scene = pi.Scene(gravity=(0.0, -G))
    ball = scene.add(body("ball", (0.3, 0.1)))
    for name, rise in (("level", 0.0), ("steep", 1e-3)):
        scene.add(pi.Contact(ball.at("c"), pi.ground.at((0.0, 0.0), direction=(1.0, rise)), name=name))
    run = pi.solve(scene.build(), 0.3, STEPS)
    assert run.success, run.message
    place = run.position(ball.at("c"))
    landed = int(np.searchsorted(run.t, run.events[0].t))
    assert place[landed] == pytest.approx([0.3, 3e-4], abs=1e-5) and place[:, 1].max() <= 0.1 + 1e-12
    assert run.energy.total.max() <= run.energy.total[0] + 1e-12


@pytest.mark.parametrize(
    "method", [pi.GeneralizedAlpha(h=1e-4), pi.EnergyMomentum(h=1e-4), pi.RadauIIA(rtol=1e-8), pi.IDA(rtol=1e-7)], ids=repr
)
def test_restitution_that_would_add_energy_keeps_it(method):
    """A rod without gravity falls onto its tip, where friction reverses the slip: Newton's law alone would double its energy (Kane, Levinson)."""
    angle = 1.2
    scene = pi.Scene(gravity=(0.0, 0.0))
    motion = dict(origin=(0.0, 0.5 * np.sin(angle) + 1e-3), angle=angle, velocity=(-0.3, -1.0), spin=4.5)
    rod = scene.add(pi.RigidBody(1.0, 0.0135, {"tip": (-0.5, 0.0)}, center=(0.0, 0.0), **motion))
    scene.add(pi.Contact(rod.at("tip"), EAST, friction=0.5, restitution=1.0))
    run = pi.solve(scene.build(), 5e-3, method)
    energy = run.energy.kinetic
    assert run.success and run.position(rod.at("tip"))[-1, 1] > 1e-4 and abs(energy[-1] - energy[0]) < 1e-6 * energy[0]
