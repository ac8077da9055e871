"""A scene at rest costs one residual a step and no factor, and is not taken for one that only seems to rest."""

import numpy as np
import pytest

import polyida as pi
from polyida import profile
from polyida.problems import plates
from polyida.problems.pendulum import Pendulum

STEPS, H = 40, 5e-3
METHODS = {
    "alpha": pi.GeneralizedAlpha(h=H),
    "alpha, stabilised": pi.GeneralizedAlpha(h=H, form="stabilised"),
    "alpha, adaptive": pi.GeneralizedAlpha(h=H, rtol=1e-4),
    "alpha, plain": pi.GeneralizedAlpha(h=H, linear="kkt"),
    "energy": pi.EnergyMomentum(h=H),
    "radau": pi.RadauIIA(h=H),
    "radau, index 3": pi.RadauIIA(h=H, form="index3"),
}


def cantilever(load=None, gravity=-9.81, motor=None, cells=12):
    scene = pi.Scene(gravity=(0.0, gravity))
    plate = scene.add(pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=cells, seed=1), plates.RUBBER, thickness=0.01, name="plate"))
    if motor is None:
        scene.add(pi.Clamp(pi.ground, plate.section("left"), name="clamp"))
    else:
        scene.add(pi.Revolute(pi.ground, plate.section("left"), name="hinge"))
        scene.add(pi.AngleMotor(pi.ground, plate.section("left"), angle=motor, name="motor"))
    if load is not None:
        scene.add(pi.PointLoad(plate.section("right"), (0.0, 1.0), profile=load, name="load"))
    return scene.build()


def work(run):
    return {name: getattr(run.counts, name) for name in ("steps", "residuals", "solves", "factorizations", "newton_iterations")}


@pytest.mark.parametrize("name", METHODS)
def test_an_equilibrium_costs_one_residual_a_step(name):
    model = cantilever()
    still = pi.static(model)
    run = pi.solve(model, STEPS * H, METHODS[name], state=still)
    assert work(run) == {"steps": STEPS, "residuals": STEPS, "solves": 0, "factorizations": 0, "newton_iterations": 0}
    assert np.array_equal(run.q, np.tile(still.q, (STEPS + 1, 1))) and not run.v.any() and not run.a.any()
    assert np.array_equal(run.lam, np.tile(still.lam, (STEPS + 1, 1)))
    assert run.t == pytest.approx(H * np.arange(STEPS + 1), rel=1e-12)


@pytest.mark.parametrize("name", METHODS)
def test_coordinates_of_an_equilibrium_are_looked_at_once(name):
    """Two residuals more, a factor, and a solve beside those of its border."""
    model = cantilever()
    still = pi.static(model)
    run = pi.solve(model, STEPS * H, METHODS[name], q0=still.q)
    assert work(run) | {"solves": 0} == {"steps": STEPS, "residuals": STEPS + 2, "solves": 0, "factorizations": 1, "newton_iterations": 0}
    assert run.counts.solves == 2 * model.n_points + 1
    assert np.array_equal(run.q, np.tile(still.q, (STEPS + 1, 1)))


def test_a_scene_without_forces_is_not_factored():
    run = pi.solve(cantilever(gravity=0.0), STEPS * H, METHODS["alpha"])
    assert work(run) == {"steps": STEPS, "residuals": STEPS + 2, "solves": 0, "factorizations": 0, "newton_iterations": 0}


def test_a_model_of_ones_own_rests_too():
    run = pi.solve(Pendulum(), STEPS * H, METHODS["alpha"], q0=[0.0, -1.0])
    assert work(run) | {"solves": 0, "factorizations": 0} == dict.fromkeys(work(run), 0) | {"steps": STEPS, "residuals": STEPS + 2}
    assert np.array_equal(run.q[-1], [0.0, -1.0])


def test_the_work_of_a_start_in_motion_is_what_it_was():
    """The look costs nothing where it sees at once that there is no rest."""
    run = pi.solve(Pendulum(), 2 * H, METHODS["alpha"], q0=[1.0, 0.0])
    assert run.counts.residuals == run.counts.newton_iterations and run.counts.factorizations == 1


@pytest.mark.parametrize("off", [1e-6, 1e-9])
def test_a_pendulum_a_touch_away_from_rest_swings(off):
    """Less than what a step of it moves is no rest: the whole time counts."""
    run = pi.solve(Pendulum(), 1.0, pi.GeneralizedAlpha(h=1e-3), q0=[np.sin(off), -np.cos(off)])
    assert run.q[-1, 0] == pytest.approx(off * np.cos(np.sqrt(9.81)), abs=1e-3 * off)


def test_a_plate_a_touch_away_from_rest_swings():
    """As far as the same plate does that is a thousand times farther away, to scale."""
    model = cantilever()
    still = pi.static(model)
    shape = pi.static(cantilever(gravity=-9.80)).q - still.q

    def swing(share):
        return (pi.solve(model, 0.2, pi.GeneralizedAlpha(h=2e-3), q0=still.q + share * shape).q - still.q) / share

    near, far = swing(1e-7), swing(1e-4)
    assert np.abs(near - far).max() < 2e-2 * np.abs(far).max() and np.abs(far[-1]).max() > 0.1 * np.abs(shape).max()


def test_a_short_run_beside_an_equilibrium_gets_under_way():
    """What moves by less than round-off within the run still has its speed, q'' t."""
    model = cantilever()
    q = pi.static(model).q + 1e-5 * (pi.static(cantilever(gravity=-9.80)).q - pi.static(model).q)
    start = pi.solve(model, 1e-7, pi.GeneralizedAlpha(h=1e-8), q0=q)
    assert start.v[-1] == pytest.approx(1e-7 * start.a[0], rel=1e-2, abs=1e-9 * np.abs(start.a[0]).max())


def test_a_drift_that_is_slow_but_leads_somewhere_is_no_rest():
    """A free plate that moves by less than round-off in a step is not held."""
    scene = pi.Scene()
    scene.add(pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=6, seed=1), plates.RUBBER, thickness=0.01))
    model = scene.build()
    v = np.tile([1e-12, 0.0], model.n // 2)
    run = pi.solve(model, 0.5, pi.GeneralizedAlpha(h=1e-3), v0=v)
    assert run.q[-1, ::2] == pytest.approx(0.5e-12, rel=1e-3)


@pytest.mark.parametrize("name", METHODS)
def test_a_load_ends_the_rest(name):
    """Before the load's kink nothing is solved, and behind it all is as in a run that begins there."""
    begin = 8 * H
    load = profile.ramp(0.0, 0.5, duration=4 * H, begin=begin)
    model = cantilever(load)
    still = pi.static(model)
    run = pi.solve(model, 16 * H, METHODS[name], state=still)
    late = pi.solve(model, 16 * H, METHODS[name], q0=still.q, t0=begin)
    assert np.array_equal(run.q[run.t <= begin * (1 + 1e-9)], np.tile(still.q, (9, 1)))
    moved = np.abs(late.q[-1] - still.q).max()
    assert moved > 1e-6 and np.abs(run.q[-1] - late.q[-1]).max() < 1e-6 * moved


@pytest.mark.parametrize("name", METHODS)
def test_a_motor_ends_the_rest(name):
    """A motor that stands still lets its plate rest; phi holds as it does without."""
    turn = profile.quintic(0.0, 0.3, duration=8 * H, begin=8 * H)
    model = cantilever(gravity=0.0, motor=turn)
    run = pi.solve(model, 16 * H, METHODS[name])
    assert run.success and not run.q[run.t <= 8 * H * (1 - 1e-9)].any()
    assert run.drift.max() < (1e-8 if name == "alpha, plain" else 1e-12)  # its B is as old as its matrix
    assert np.abs(run.q[-1]).max() > 0.05


def test_another_model_does_not_rest_in_the_first_ones_equilibrium():
    """The state of a heavier scene, given to a lighter one, springs up."""
    still = pi.static(cantilever(gravity=-9.81))
    model = cantilever(gravity=-4.0)
    run = pi.solve(model, 20 * H, METHODS["alpha"], state=still)
    assert np.abs(run.q[-1] - still.q).max() > 1e-3


def test_a_loose_equilibrium_is_none():
    """What static leaves with a wide tolerance is seen, and moves."""
    model = cantilever()
    still = pi.static(model, tolerance=0.5)
    assert not still.memory
    run = pi.solve(model, 4 * H, METHODS["alpha"], state=still)
    assert run.counts.newton_iterations >= 4 and np.abs(run.q[-1] - still.q).max() > 1e-9


@pytest.mark.parametrize("name", ["alpha", "radau"])
def test_a_run_at_rest_is_resumed_bit_by_bit(name, tmp_path):
    load = profile.ramp(0.0, 0.5, duration=4 * H, begin=20 * H)
    model = cantilever(load)
    still = pi.static(model)
    whole = pi.solve(model, 30 * H, METHODS[name], state=still)
    pi.solve(model, 10 * H, METHODS[name], state=still, out=tmp_path / "run.h5")
    run = pi.resume(tmp_path / "run.h5", 30 * H)
    assert np.abs(run.q - whole.q).max() < 1e-12 * np.abs(whole.q).max()
    assert run.counts.residuals == whole.counts.residuals


@pytest.mark.parametrize("name", ["alpha", "radau"])
def test_a_state_off_its_constraint_is_not_at_rest(name):
    """That of a shorter pendulum, which hung still, with the same forces."""

    class Longer(Pendulum):
        def phi(self, t, q):
            return super().phi(t, q) - 0.5

    still = pi.solve(Pendulum(), 10 * H, METHODS[name], q0=[0.0, -1.0]).state
    assert "rest" in still.memory
    run = pi.solve(Longer(), 20 * H, METHODS[name], state=still)
    assert not run.success or run.drift[-1] < 1e-6
