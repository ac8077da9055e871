"""Events that change a run: closed forms in every integrator, momentum, roots within a step, files, and wrong inputs."""

import numpy as np
import pytest

import polyida as pi
from nonsmooth.random_laws import Switched

G, E = 9.81, 0.8
LINEAR = pi.Needs(mass_varies=False, velocity_forces=False, driven=False, phi_q_varies=False)


class Ball(pi.Model):
    """A point that falls along y."""

    n, m, needs = 1, 0, LINEAR

    def mass(self, q):
        return np.eye(1)

    def force(self, t, q, v):
        return np.array([G])

    def potential(self, q):
        return G * q[0]


class Held(Ball):
    """The same, held where y = 0."""

    m = 1

    def phi(self, t, q):
        return q.copy()

    def phi_q(self, t, q):
        return np.eye(1)


class Taylor:
    """An integrator of a user, exact for constant accelerations."""

    h = 0.05

    def steps(self, model, state, t_end, counts):
        t, q, v = state.t, state.q, state.v
        count = int(np.ceil((t_end - t) / self.h))
        for t in np.linspace(t, t_end, count + 1)[1:]:
            h, a = t - state.t, -model.force(t, q, v)
            q, v = q + h * v + h * h / 2 * a, v + h * a
            counts.steps += 1
            state = pi.State(float(t), q, v, a, state.lam)
            yield state


def bounces(t_end, e=E):
    """Times of the impacts of a ball that falls from 1 m, and its place at t_end."""
    times, t, v = [], np.sqrt(2 / G), np.sqrt(2 * G)
    while t < t_end:
        times, v = [*times, t], e * v
        t += 2 * v / G
    tau = t_end - times[-1]
    return np.array(times), v * tau - G * tau**2 / 2


FLOOR = pi.Event(when=lambda s: s.q[0], then=pi.Impact(restitution=E), name="floor")
METHODS = [
    (pi.RadauIIA(rtol=1e-9), 1e-13),
    (pi.RadauIIA(h=0.5), 1e-13),
    (pi.GeneralizedAlpha(h=0.1), 1e-12),
    (pi.EnergyMomentum(h=0.05), 1e-10),
    (pi.IDA(rtol=1e-9), 1e-7),
    (Taylor(), 1e-12),
]


@pytest.mark.parametrize(("method", "error"), METHODS, ids=lambda x: type(x).__name__)
def test_bouncing_ball(method, error):
    times, y = bounces(1.5)
    run = pi.solve(Ball(), 1.5, method, q0=[1.0], events=FLOOR)
    assert run.success and len(run.events) == len(times)
    assert abs(run.events.t - times).max() < error and abs(run.q[-1, 0] - y) < error
    assert run.q.min() > -error
    first, speed = run.events[0], np.sqrt(2 * G)
    assert first.impulse == pytest.approx((1 + E) * speed, abs=10 * error)
    assert first.energy_lost == pytest.approx(0.5 * speed**2 * (1 - E**2), abs=100 * error)
    before, after = np.flatnonzero(run.t == first.t)
    assert first.frame == after and run.v[after, 0] == pytest.approx(-E * run.v[before, 0], rel=1e-9)
    balance = run.energy.total + run.energy.dissipated["floor"] - run.energy.total[0]
    assert abs(balance).max() < 100 * error


def test_two_roots_within_one_step():
    there = pi.Event(when=lambda s: s.q[0] - 0.99, then="stop", direction="rising")
    run = pi.solve(Ball(), 0.5, pi.RadauIIA(h=0.5), q0=[0.98], v0=[0.6], events=there)
    assert run.status == "stopped"
    rise = (0.6 - np.sqrt(0.36 - 2 * G * 0.01)) / G
    assert run.t[-1] == pytest.approx(rise, abs=1e-14)


def test_start_at_a_zero_does_not_count():
    up = pi.Event(when=lambda s: s.q[0])
    run = pi.solve(Ball(), 1.0, pi.RadauIIA(rtol=1e-9), v0=[3.0], events=[up])
    assert run.events.t == pytest.approx([6.0 / G], abs=1e-13)
    for side in (1e-17, -1e-17):
        run = pi.solve(Ball(), 1.0, pi.RadauIIA(rtol=1e-9), q0=[side], v0=[3.0], events=[up])
        assert run.events.t == pytest.approx([6.0 / G], abs=1e-13)


def test_direction():
    for direction, t in (("rising", 0.2 - 0.1 * np.sqrt(2)), ("falling", 0.2 + 0.1 * np.sqrt(2))):
        level = pi.Event(when=lambda s: s.q[0] - 0.01 * G, direction=direction)  # y / G = 0.2 t - t^2 / 2
        run = pi.solve(Ball(), 1.0, pi.GeneralizedAlpha(h=0.4), v0=[0.2 * G], events=[level])
        assert run.t[-1] == pytest.approx(t, abs=1e-12)


def test_zeno_ends_at_rest_or_with_a_name():
    run = pi.solve(Ball(), 5.0, pi.RadauIIA(rtol=1e-9), q0=[1.0], events=FLOOR)
    rest = np.sqrt(2 / G) * (1 + 2 * E / (1 - E))
    assert run.status == "stopped" and "came to rest" in run.message and rest - 2e-3 < run.t[-1] < rest
    without_end = pi.Event(when=lambda s: s.q[0], then=pi.Impact(E, least_speed=0.0), name="floor", most=60)
    run = pi.solve(Ball(), 5.0, pi.RadauIIA(rtol=1e-9), q0=[1.0], events=without_end)
    assert not run.success and "'floor' happened 60 times" in run.message and run.q.min() > -1e-12


class Bouncing(Held):
    """The same on a floor at y = 0."""

    row_laws = (pi.RowLaw(0, "floor", restitution=E),)


def test_results_of_an_own_model_with_contact_and_from_its_file(tmp_path):
    run = pi.solve(Bouncing(), 0.6, pi.RadauIIA(rtol=1e-9), q0=[1.0], out=tmp_path / "run.h5")
    for one in (run, pi.load(tmp_path / "run.h5", model=Bouncing())):
        assert one.energy.total[[0, -1]] == pytest.approx([G, E**2 * G]) and one.drift.max() < 1e-9
        assert isinstance(one.mode, Bouncing) and one.state.q == pytest.approx(run.q[-1])


def test_own_model_goes_on_with_another_model(tmp_path):
    path = tmp_path / "run.h5"
    held = Held()
    land = pi.Event(when=lambda s: s.q[0], then=held, name="land", direction="falling")
    let_go = pi.Event(when=lambda s: s.t - 1.0, then=lambda s: np.array([2.0]), name="push")
    for method in (pi.RadauIIA(rtol=1e-9), pi.IDA(rtol=1e-9), pi.GeneralizedAlpha(h=0.01)):
        model = Ball()
        free = pi.Event(when=lambda s: s.t - 0.9, then=model, name="free")
        run = pi.solve(model, 1.1, method, q0=[1.0], events=[land, free, let_go])
        assert [one.name for one in run.events] == ["land", "free", "push"]
        assert run.events[0].impulse == pytest.approx(np.sqrt(2 * G), abs=1e-7)
        t = run.t
        rests = (t > t[run.events[0].frame]) & (np.arange(len(t)) < run.events[1].frame)
        assert abs(run.q[rests]).max() < 1e-12 and run.lam[rests] == pytest.approx(-G, abs=1e-6)
        assert run.lam.shape == (len(t), 1) and run.lam[-1] == 0.0
        assert run.q[-1, 0] == pytest.approx(0.2 - G * 0.1**2 / 2 - G * 0.1**2 / 2, abs=1e-6)
    run.save(path)
    with pytest.raises(pi.InputError, match="change to other models, which no file holds"):
        pi.load(path, model=Ball())
    pi.solve(Ball(), 0.1, method, q0=[1.0], events=[land]).save(path, overwrite=True)
    loaded = pi.load(path, model=Ball())  # with a column of lam for the model that did not come
    assert loaded.lam.shape[1] == 1 and loaded.energy.total == pytest.approx(G)


def pendulum(**options):
    """A rod of 1 m on a pin, drawn horizontal."""
    scene = pi.Scene(gravity=(0.0, -G))
    rod = scene.add(
        pi.RigidBody(mass=1.0, inertia=1 / 12, points={"A": (-0.5, 0.0), "B": (0.5, 0.0)}, origin=(0.5, 0.0), name="rod", **options)
    )
    scene.add(pi.Revolute(pi.ground, rod.at("A"), name="pin"))
    scene.add(pi.PointMass(rod.at("B"), 1e-9, name="tip"))
    return scene, rod


QUARTER = 1.8540746773013719 / np.sqrt(1.5 * G)  # K(sin 45 degrees) / omega


@pytest.mark.parametrize(
    ("method", "error"), [(pi.RadauIIA(rtol=1e-9), 3e-8), (pi.GeneralizedAlpha(h=2e-3), 2e-5), (pi.IDA(rtol=1e-9), 1e-6)]
)
def test_pendulum_is_caught(method, error):
    scene, rod = pendulum()
    caught = pi.Event(when=lambda s: s.position("tip")[0], then=pi.Clamp(rod.at("A"), name="clamp"), name="caught")
    run = pi.solve(scene.build(), 1.0, method, events=[caught])
    assert run.success and len(run.events) == 1
    one, w = run.events[0], np.sqrt(3 * G)
    assert one.t == pytest.approx(QUARTER, abs=error)
    assert run.position("tip")[-1] == pytest.approx([0.0, -1.0], abs=2 * error)
    assert one.energy_lost == pytest.approx(w**2 / 6, rel=10 * error)
    assert abs(run.energy.total + run.energy.dissipated["caught"] - run.energy.total[0]).max() < 30 * error
    assert not run.reaction("clamp")[: one.frame].any()
    assert run.reaction("pin")[-1] - run.reaction("clamp")[-1, :2] == pytest.approx([0.0, G], abs=1e-8)
    assert not run.unique("pin") and run.drift.max() < 1e-6
    # the clamp stops the spin: its moment impulse is the angular momentum about A, which the pin's share does not change
    assert abs(one.impulses["clamp"][2]) == pytest.approx(w / 3, rel=10 * error)


def test_order_of_alpha():
    errors = []
    for h in (4e-3, 2e-3):
        scene, _ = pendulum()
        stop = pi.Event(when=lambda s: s.position("tip")[0])
        run = pi.solve(scene.build(), 1.0, pi.GeneralizedAlpha(h=h, rho_inf=0.8), events=[stop])
        errors.append(run.t[-1] - QUARTER)
    assert 1.8 < np.log2(errors[0] / errors[1]) < 2.2


def test_weld_of_two_bodies_keeps_momentum_and_the_present_angle():
    scene = pi.Scene()
    points = {"c": (0.0, 0.0), "r": (0.1, 0.0)}
    one = scene.add(pi.RigidBody(mass=2.0, inertia=0.1, points=points, velocity=(1.0, 0.0), spin=2.0, name="one"))
    two = scene.add(pi.RigidBody(mass=1.0, inertia=0.2, points=points, origin=(1.0, 0.0), velocity=(0.0, 0.0), name="two"))
    meet = pi.Event(
        when=lambda s: s.position(two.at("c"))[0] - s.position(one.at("c"))[0], then=pi.Weld(one.at("c"), two.at("c"), name="weld")
    )
    run = pi.solve(scene.build(), 1.5, pi.RadauIIA(rtol=1e-9), events=[meet])
    assert run.success and run.events.t == pytest.approx([1.0], abs=1e-9)
    assert run.momentum[-1] == pytest.approx([2.0, 0.0], abs=1e-9) and run.angular_momentum[-1] == pytest.approx(0.2, abs=1e-8)
    turns = [run.position(body.at("r"))[-1] - run.position(body.at("c"))[-1] for body in (one, two)]
    angles = [np.arctan2(turn[1], turn[0]) for turn in turns]
    assert angles[0] == pytest.approx(2.0 + 0.5 * 0.2 / 0.3, abs=1e-8) and angles[1] == pytest.approx(0.5 * 0.2 / 0.3, abs=1e-8)
    assert run.events[0].impulses["weld"][:2] == pytest.approx((4 / 6, 0.0), abs=1e-9)


def test_joint_that_does_not_fit_stops_the_run():
    scene, rod = pendulum()
    far = pi.Event(
        when=lambda s: s.position("tip")[0], then=pi.Revolute(pi.ground.at((0.0, -1.1)), rod.at("B"), name="hook"), name="caught"
    )
    run = pi.solve(scene.build(), 1.0, pi.RadauIIA(rtol=1e-8), events=[far])
    assert (
        run.status == "events" and "'caught'" in run.message and "'hook' does not fit where it is added: it is open by 0.1 m" in run.message
    )
    assert run.t[-1] == pytest.approx(QUARTER, abs=1e-6)


@pytest.mark.parametrize("height, message", [(0.3, ""), (0.1, "'late' does not fit where it is added: it is penetrated by 0.1 m")])
def test_a_contact_that_is_open_is_added_in_the_motion(height, message):
    scene, r = pi.Scene(gravity=(0.0, -G)), 0.2
    disc = scene.add(pi.RigidBody(1.0, 0.02, points={"c": (0.0, 0.0)}, origin=(0.0, 0.5), name="disc"))
    late = pi.Contact(disc.at("c"), pi.ground.at((0.0, 0.0), direction=(1.0, 0.0)), disc=r, name="late")
    add = pi.Event(when=lambda s: 0.5 + s.q[1] - height, then=late, name="add")
    run = pi.solve(scene.build(), 0.6, pi.NonsmoothAlpha(h=1e-3), events=[add])
    assert message in run.message and run.success == (not message)
    if run.success:
        assert [one.name for one in run.events] == ["add", "late"] and abs(run.q[-1, 1] + 0.5 - r) < 1e-12


def test_removed_pin_and_impulse():
    scene, rod = pendulum()
    push = pi.Impulse(rod.at("B"), (1.0, 2.0))
    loose = pi.Event(when=lambda s: s.t - 0.2, then=[pi.Remove("pin"), push], name="loose")
    run = pi.solve(scene.build(), 0.5, pi.RadauIIA(rtol=1e-9), events=[loose])
    before, after = np.flatnonzero(run.t == run.events[0].t)
    assert run.momentum[after] - run.momentum[before] == pytest.approx([1.0, 2.0], abs=1e-12)
    x, y = run.position("tip")[after]
    assert run.angular_momentum[after] - run.angular_momentum[before] == pytest.approx(2.0 * x - y, abs=1e-12)
    assert run.momentum[-1] - run.momentum[after] == pytest.approx([0.0, -G * 0.3], abs=1e-8)
    assert not run.reaction("pin")[after:].any() and run.reaction("pin")[before].any()
    assert "pin x" not in run.mode.labels


def test_impulse_on_a_held_body():
    scene, rod = pendulum()
    hit = pi.Event(when=lambda s: s.t - 0.1, then=pi.Impulse(rod.at("B"), (0.0, 1.0)), name="hit")
    run = pi.solve(scene.build(), 0.2, pi.RadauIIA(rtol=1e-9), events=[hit])
    before, after = np.flatnonzero(run.t == run.events[0].t)
    x = run.position("tip")[after, 0]
    assert run.angular_momentum[after] - run.angular_momentum[before] == pytest.approx(x, abs=1e-9)  # about the pin, L = J w


def test_force_is_added_and_removed():
    scene, rod = pendulum()
    spring = pi.SpringDamper(pi.ground.at((1.0, 1.0)), rod.at("B"), stiffness=50.0, name="spring")
    on = pi.Event(when=lambda s: s.t - 0.1, then=spring, name="on")
    off = pi.Event(when=lambda s: s.t - 0.3, then=pi.Remove("spring"), name="off")
    run = pi.solve(scene.build(), 0.4, pi.RadauIIA(rtol=1e-10), events=[on, off])
    lost = sum(run.energy.dissipated[name] for name in ("on", "off"))
    assert abs(run.energy.total + lost - run.energy.total[0]).max() < 1e-8
    energy = run.energy.elements["spring"]
    first, end = (one.frame for one in run.events)
    assert not energy[:first].any() and energy[first:end].all() and not energy[end:].any()


def test_impact_of_a_scene_and_rest():
    scene = pi.Scene(gravity=(0.0, -G))
    ball = scene.add(pi.RigidBody(mass=2.0, inertia=0.01, points={"c": (0.0, 0.0)}, origin=(0.0, 1.0), velocity=(1.0, 0.0), name="ball"))
    slot = pi.Slot(pi.ground.at((0.0, 0.0)), ball.at("c"), name="floor")
    floor = pi.Event(
        when=lambda s: s.position(ball.at("c"))[1], then=pi.Impact(0.3, least_speed=0.05, rest=slot), name="hit", direction="falling"
    )
    run = pi.solve(scene.build(), 1.5, pi.RadauIIA(rtol=1e-9), events=[floor])
    assert run.success
    place = run.position(ball.at("c"))
    assert place[:, 1].min() > -1e-9 and place[-1] == pytest.approx([1.5, 0.0], abs=1e-9)
    assert run.reaction("floor")[-1] == pytest.approx([0.0, 2.0 * G], abs=1e-8)
    count = 1 + int(np.ceil(np.log(0.05 / np.sqrt(2 * G)) / np.log(0.3)))
    assert len(run.events) == count


@pytest.mark.parametrize("columns", [slice(None), slice(4)])
def test_new_velocities_leave_states_as_they_are(columns):
    """The current of a motor does not jump where its rotor turns back, unless a State says so."""
    scene = pi.Scene()
    rotor = scene.add(pi.RigidBody(mass=1.0, inertia=0.5, points={"c": (0.0, 0.0)}, spin=2.0, name="rotor"))
    scene.add(pi.Revolute(pi.ground, rotor.at("c"), name="axle"))
    scene.add(pi.DCMotor(rotor.at("c"), volts=12.0, k=0.8, L=0.05, R=1.5, name="motor"))

    def back(state):
        return -0.5 * state.v[columns]

    def reset(state):
        v = state.v.copy()
        v[4] = 0.0  # the rotor's pairs come first
        return pi.State(state.t, state.q, v, state.a, state.lam)

    events = [pi.Event(when=lambda state: state.t - 0.1, then=back), pi.Event(when=lambda state: state.t - 0.2, then=reset)]
    run = pi.solve(scene.build(), 0.3, pi.RadauIIA(rtol=1e-8), events=events)
    (one, other), current = np.flatnonzero(np.diff(run.t) == 0.0), run.states("motor")[:, 0]
    assert run.v[one + 1, :4] == pytest.approx(-0.5 * run.v[one, :4], abs=1e-9) and np.abs(run.v[one]).max() > 0.1
    assert current[one + 1] == current[one] > 1.0 and current[other] > 1.0 and current[other + 1] == 0.0


def test_events_at_one_time_that_undo_each_other():
    back = pi.Event(when=lambda s: s.t - 0.1, then=lambda s: -s.v, name="back")
    forth = pi.Event(when=lambda s: s.v[0], then=lambda s: -s.v, name="forth")
    again = pi.Event(when=lambda s: s.v[0] + 1e-3, then=lambda s: -s.v, name="again")
    run = pi.solve(Ball(), 0.2, pi.RadauIIA(rtol=1e-9), v0=[-3.0], events=[back, forth, again])
    assert not run.success and "'forth'" in run.message and "'again'" in run.message and "undo each other" in run.message


def test_output_sensors_and_every():
    times, _ = bounces(1.5)
    output = np.linspace(0.0, 1.5, 16)
    run = pi.solve(Ball(), 1.5, pi.RadauIIA(rtol=1e-9), q0=[1.0], events=FLOOR, output=output, sensors={"y": lambda t, q, v: q[0]})
    assert np.array_equal(run.t, output) and len(run.events) == len(times)
    assert [one.frame for one in run.events] == np.searchsorted(output, times).tolist()
    assert np.count_nonzero(np.isin(run.sensors.t, run.events.t)) == 2 * len(times)
    run = pi.solve(Ball(), 1.5, pi.GeneralizedAlpha(h=0.01), q0=[1.0], events=FLOOR, every=7)
    assert all(np.count_nonzero(run.t == t) == 2 for t in run.events.t)


@pytest.mark.parametrize("method, stops", [(pi.RadauIIA(rtol=1e-7), (0.3, 0.75)), (pi.GeneralizedAlpha(h=5e-3), (0.6,))])
def test_file_and_resume(tmp_path, method, stops):
    def events(rod):
        caught = pi.Event(when=lambda s: s.position("tip")[0], then=pi.Clamp(rod.at("A"), name="clamp"), name="caught")
        loose = pi.Event(when=lambda s: s.t - 0.7, then=pi.Remove("pin", "clamp"), name="loose")
        late = pi.Event(when=lambda s: s.position("tip")[1] + 1.2, then=lambda s: 0.5 * s.v, name="slow")
        return [caught, loose, late]

    scene, rod = pendulum()
    whole = pi.solve(scene.build(), 1.0, method, events=events(rod), sensors={"pin": pi.sensor.reaction("pin")})
    assert [one.name for one in whole.events] == ["caught", "loose", "slow"]
    whole.save(tmp_path / "saved.h5")
    loaded = pi.load(tmp_path / "saved.h5")
    assert loaded.events.to_dataframe().equals(whole.events.to_dataframe()) and loaded.events[0].impulses.keys() == {"clamp"}
    for name in ("pin", "clamp"):
        assert np.array_equal(loaded.reaction(name), whole.reaction(name))
    assert np.array_equal(loaded.energy.total, whole.energy.total) and np.array_equal(loaded.drift, whole.drift)
    assert np.array_equal(loaded.energy.dissipated["caught"], whole.energy.dissipated["caught"])
    for stop in stops:  # before, between and behind events
        path, (scene, rod) = tmp_path / f"{stop}.h5", pendulum()
        model, sensors = scene.build(), {"pin": pi.sensor.reaction("pin")}

        def interrupt(t, stop=stop):
            if t > stop:
                raise KeyboardInterrupt

        part = pi.solve(model, 1.0, method, events=events(rod), out=path, progress=interrupt, sensors=sensors, flush_every=10)
        assert part.status == "interrupted"
        with pytest.raises(pi.InputError, match="the run had events"):
            pi.resume(path, sensors=sensors, model=model)
        run = pi.resume(path, model=model, events=events(rod), sensors=sensors)
        for name in ("t", "q", "v", "a", "lam"):
            assert np.array_equal(getattr(run, name), getattr(whole, name)), name
        assert np.array_equal(run.sensors["pin"], whole.sensors["pin"]) and np.array_equal(run.reaction("clamp"), whole.reaction("clamp"))
        assert run.events.to_dataframe().equals(whole.events.to_dataframe())


def test_run_goes_on_from_its_mode():
    scene, rod = pendulum()
    events = [pi.Event(when=lambda s: s.t - 0.2, then=pi.Remove("pin"), name="loose")]
    model = scene.build()
    run = pi.solve(model, 0.3, pi.RadauIIA(rtol=1e-10), events=events)
    more = pi.solve(run.mode, 0.4, pi.RadauIIA(rtol=1e-10), state=run.state)
    whole = pi.solve(model, 0.4, pi.RadauIIA(rtol=1e-10), events=events)
    assert more.position("tip")[-1] == pytest.approx(whole.position("tip")[-1], abs=1e-9)


def test_plate_is_caught_in_its_present_shape():
    mesh = pi.mesh.rectangle(1.0, 0.1, 8, 1)
    scene = pi.Scene(gravity=(0.0, -G))
    plate = scene.add(pi.Plate(mesh, pi.Material(E=5e7, nu=0.3, rho=1100.0), 0.01, name="arm"))
    scene.add(pi.Revolute(pi.ground, plate.section("left"), name="pin"))
    scene.add(pi.PointMass(plate.section("right"), 1e-6, name="tip"))
    caught = pi.Event(when=lambda s: s.t - 0.3, then=pi.Clamp(plate.section("left"), name="clamp"), name="caught")
    run = pi.solve(scene.build(), 0.4, pi.GeneralizedAlpha(h=2e-3), events=[caught])
    assert run.success, run.message
    nodes, k = plate.section("left").nodes, run.events[0].frame
    places = np.array([run.node_positions(frame)[nodes] for frame in (k, len(run) - 1)])
    assert abs(places[1] - places[0]).max() < 1e-12 and abs(places[0] - plate.points[nodes]).max() > 1e-3
    assert run.events[0].energy_lost > 0 and run.reaction("clamp").shape[1] == 2 * len(nodes)


def test_wrong_inputs():
    scene, rod = pendulum()
    model, method = scene.build(), pi.RadauIIA(rtol=1e-8)
    other = pi.RigidBody(mass=1.0, inertia=1.0, points={"c": (0.0, 0.0)}, name="other")
    up = lambda s: s.t - 0.1  # noqa: E731
    for make, words in (
        (lambda: pi.Event(when=3.0), "when = 3.0 must be a function"),
        (lambda: pi.Event(when=up, then=[other]), "bodies must be in the scene from the start"),
        (lambda: pi.Event(when=up, direction="up"), "direction = 'up'"),
        (lambda: pi.Event(when=up, most=0), "most = 0"),
        (lambda: pi.Event(when=up, then="halt"), "then = 'halt'"),
        (lambda: pi.Impact(restitution=1.5), "restitution = 1.5"),
        (lambda: pi.Remove(), "at least one"),
        (lambda: pi.solve(model, 1.0, method, events=["stop"]), "must be a list of pi.Event"),
        (lambda: pi.solve(model, 1.0, method, events=[pi.Event(when=up, then=pi.Remove("pim"))]), "'pim' is no part of the scene"),
        (lambda: pi.solve(model, 1.0, method, events=[pi.Event(when=up, then=pi.Remove("rod"))]), "bodies cannot be removed"),
        (lambda: pi.solve(model, 1.0, method, events=[pi.Event(when=up, then=Ball())]), "only a user's model by another model"),
        (lambda: pi.solve(model, 1.0, method, events=[pi.Event(when=up, then=pi.Clamp(other.at("c")))]), "not in the scene"),
        (lambda: pi.solve(model, 1.0, method, events=[pi.Event(when=lambda s: "x")]), "when gave 'x'"),
        (
            lambda: pi.solve(model, 1.0, method, events=[pi.Event(when=lambda s: s.position("tipp")[0], name="catch")]),
            "catch: when: 'tipp' is the name of no mass, load or joint",
        ),
        (lambda: pi.solve(model, 1.0, method, events=[pi.Event(when=up, name="a"), pi.Event(when=up, name="a")]), "must differ"),
        (lambda: pi.solve(Ball(), 1.0, method, events=[pi.Event(when=up, then=pi.Remove("pin"))]), "is for scenes; Ball has no parts"),
        (lambda: pi.solve(Ball(), 1.0, method, events=[pi.Event(when=up, then=pi.Clamp(rod.at("B")))]), "is for scenes"),
        (lambda: pi.solve(Ball(), 1.0, method, events=[pi.Event(when=up, then=pi.Impulse(rod.at("B"), (1.0, 0.0)))]), "is for scenes"),
    ):
        with pytest.raises(pi.InputError, match=words.replace("(", r"\(")):
            make()


@pytest.mark.parametrize("integrator", [*(pi.GeneralizedAlpha(h=h) for h in (1e-2, 3e-3, 1e-3)), pi.RadauIIA(rtol=1e-6), pi.IDA(rtol=1e-6)])
def test_a_mechanism_crosses_once(integrator):
    """The root is that of a state on the constraints, where the polynomial of the step is beside them."""
    scene = pi.Scene(gravity=(0.0, -G))
    rod = scene.add(pi.RigidBody.bar(1.0, 1.0, name="rod"))
    scene.add(pi.Revolute(pi.ground, rod.at("left"), name="pin"))
    scene.add(pi.PointMass(rod.at("right"), 0.1, name="end"))
    push = pi.Event(when=lambda s: s.position("end")[1] + 0.4, then=pi.Impulse(rod.at("right"), (0.0, 0.01)), name="push")
    run = pi.solve(scene.build(), 0.6, integrator, events=[push])
    assert len(run.events) == 1
    assert np.abs(run.position("end")[np.argmin(np.abs(run.t - run.events[0].t))][1] + 0.4) < 1e-10


@pytest.mark.parametrize("integrator", [pi.EnergyMomentum(h=5e-3), pi.GeneralizedAlpha(h=5e-3)])
def test_a_driven_mechanism_bounces_off_nothing(integrator):
    """Motors hold all of it: what is left of dg/dq is round-off, of either sign, and no number to divide by."""
    for share in (0.3, 0.5, 0.8):
        scene = pi.Scene()
        bar = scene.add(pi.RigidBody.bar(1.0, 1.0 + share, name="bar"))
        tail = scene.add(pi.RigidBody.bar(0.7, 1.0, origin=(1.0, 0.0), name="tail"))
        scene.add(pi.Revolute(pi.ground, bar.at("left")))
        scene.add(pi.Revolute(bar.at("right"), tail.at("left")))
        scene.add(pi.AngleMotor(pi.ground, bar.at("left"), pi.profile.sine(0.5, 1.0)))
        scene.add(pi.AngleMotor(bar.at("right"), tail.at("left"), pi.profile.sine(share, 2.0)))
        end = tail.at("right")
        wall = pi.Event(lambda s, end=end: s.position(end)[1] - 0.2, pi.Impact(0.6), name="wall")
        run = pi.solve(scene.build(), 0.1, integrator, events=[wall])
        assert run.status == "events" and "the joints do not let `when` change" in run.message and len(run.events) == 0


def test_a_ball_is_reflected_by_a_round_wall():
    """It leaves (0.6, 0) along y and meets the circle of radius 1 m at (0.6, 0.8), where it has 0.8 m/s along the normal (0.6, 0.8)."""
    scene = pi.Scene()
    ball = scene.add(pi.RigidBody(1.0, 0.1, {"c": (0.0, 0.0)}, origin=(0.6, 0.0), velocity=(0.0, 1.0), name="ball"))
    wall = pi.Event(lambda s: 1.0 - s.position(ball.at("c")) @ s.position(ball.at("c")), pi.Impact(1.0), name="wall")
    run = pi.solve(scene.build(), 0.9, pi.GeneralizedAlpha(h=0.01), events=wall)
    np.testing.assert_allclose(run.v[-1][:2], [-0.96, -0.28], atol=1e-6)


@pytest.mark.parametrize(
    "method", [pi.GeneralizedAlpha(h=0.05), pi.RadauIIA(h=0.05), pi.EnergyMomentum(h=0.05)], ids=lambda one: one.class_name()
)
def test_an_event_within_a_step_behind_a_sample_sees_the_output_of_the_sample(method):
    """The output jumps from 1 to -1 N at 0.1 s; the event is within the step that begins there."""
    scene = pi.Scene()
    body = scene.add(pi.RigidBody(mass=1.0, inertia=1.0, points={"c": (0.0, 0.0)}, velocity=(1.0, 0.0), name="body"))
    scene.add(pi.Prismatic(pi.ground.at((0.0, 0.0), direction=(1.0, 0.0)), body.at("c"), name="rail"))
    scene.add(Switched(body.at("c"), 1.0, period=0.1, name="drive"))
    there = pi.Event(when=lambda moment: moment.q[0] - 0.125, then="stop")
    run = pi.solve(scene.build(), 0.2, method, events=[there])
    assert run.status == "stopped" and 0.1 < run.t[-1] < 0.15
    assert np.abs(run.x[-1] + 1.0).max() < 1e-12
    assert abs(run.a[-1, 0] + 1.0) < 1e-9
