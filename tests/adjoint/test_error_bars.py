"""Estimated errors of quantities of runs beside those against extrapolated runs."""

import dataclasses

import numpy as np
import pytest

import polyida as pi
from polyida import profile
from polyida.problems.mechanisms import slider_crank
from polyida.problems.plates import double_plate

P = pi.objective
TIGHT = 1e-10  # Newton's tolerance


def at_end(model, name="q", row=None):
    """x of "tip" at the end, or one entry of q, v or lam."""
    place = slice(None) if row is None else [row]
    weights = np.ones(1) if row is not None else np.array([model.displacement("tip", unit)[0] for unit in np.eye(model.n)])

    def slopes(run):
        result = np.zeros(getattr(run, name).shape)
        result[-1, place] = weights
        return {name: result}

    return P.UserObjective(lambda run: float(weights @ getattr(run, name)[-1, place]), slopes)


def rigid_crank():
    """A slider crank of rigid links whose torque has kinks, and its objectives."""
    drawn, scene = slider_crank("rigid"), pi.Scene(gravity=(0.0, -9.81))
    for name, part in drawn.parts.items():
        if name != "drive":
            scene.add(part)
    scene.add(pi.Torque(scene.parts["crank"].section("left"), profile.linear(0.0, 0.3, duration=0.2, begin=0.1), name="drive"))
    scene.add(pi.PointMass(scene.parts["rod"].section("right"), 0.01, name="tip"))
    model = scene.build()
    means = [P.Deviation("slider", (0.3, -0.1)), P.PeakReaction("crank pin", p=2), P.PeakReaction("bearing", p=8)]
    return model, [*means, at_end(model), 2.0 * means[0] - 1e-4 * means[1]]


def damped_scene(plane="stress", element="wachspress", cells=20, height=0.1, mesh=None):
    """A plate with viscosity that a motor turns."""
    scene, material = pi.Scene(gravity=(0.0, -9.81)), pi.Material(E=50e6, nu=0.3, rho=1100.0, viscosity=2e-3, plane=plane)
    mesh = pi.mesh.rectangle(1.0, height, cells=cells, seed=1) if mesh is None else mesh
    arm = scene.add(pi.Plate(mesh, material, thickness=0.01, element=element, name="arm"))
    scene.add(pi.Revolute(pi.ground, arm.section("left"), name="shoulder"))
    scene.add(pi.AngleMotor(pi.ground, arm.section("left"), profile.quintic(0.0, np.pi / 2, duration=0.5), name="motor"))
    scene.add(pi.PointMass(arm.section("right"), 0.3, name="tip"))
    return scene


def damped_arm(**options):
    """The model of `damped_scene`, and its objectives."""
    model = damped_scene(**options).build()
    means = [P.Deviation("tip", (0.3, -0.1)), P.StrainEnergy("arm"), P.PeakReaction("shoulder", p=2), P.PeakReaction("motor", p=2)]
    return model, [*means, at_end(model), at_end(model, "lam", 0)]


def references(model, t_end, objectives, h, **settings):
    """Values of the objectives, extrapolated from steps of h and h/2."""
    coarse, fine = (pi.solve(model, t_end, pi.GeneralizedAlpha(h=step, tolerance=TIGHT, **settings)) for step in (h, h / 2))
    return [(4 * one(fine) - one(coarse)) / 3 for one in objectives]


def ratios(run, objectives, values):
    """Estimates of the error of time over the errors; all are trusted, and corrected values are nearer."""
    result = []
    for objective, value in zip(objectives, values):
        bars = pi.error_of(run, objective)
        assert bars.trusted, bars
        assert bars.steps.sum() == pytest.approx(bars.time, rel=1e-9)
        assert abs(bars.value + bars.time - value) < abs(bars.value - value)
        result.append(bars.time / (value - bars.value))
    return np.array(result)


def test_errors_of_a_rigid_mechanism_are_estimated_to_one_percent():
    model, objectives = rigid_crank()
    run = pi.solve(model, 0.4, pi.GeneralizedAlpha(h=1e-3, tolerance=TIGHT))
    assert np.abs(ratios(run, objectives, references(model, 0.4, objectives, 1.25e-4)) - 1).max() < 0.01


@pytest.mark.parametrize("h", [4e-3, 1e-3])
def test_a_force_at_the_end_of_a_run_without_vibrations_is_trusted(h):
    """Its multipliers grow as h^-2 in the last steps and cancel: what is shifted beyond the end must not be left out of their sum."""
    model, _ = rigid_crank()
    force, run = at_end(model, "lam", 0), pi.solve(model, 0.4, pi.GeneralizedAlpha(h=h, tolerance=TIGHT))
    assert 0.9 < ratios(run, [force], references(model, 0.4, [force], 1.25e-4))[0] < 1.1


@pytest.mark.parametrize(("h", "rho_inf", "trusted"), [(0.04, 0.9, False), (0.02, 0.9, False), (0.005, 0.9, True), (0.04, 0.5, True)])
def test_what_a_start_leaves_in_a_force_at_the_end(h, rho_inf, trusted):
    """A pendulum that falls for 1 s: with rho_inf = 0.9 the force is wrong by what the start leaves for 300 steps."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = scene.add(pi.RigidBody.bar(1.0, 1.0, name="bar"))
    scene.add(pi.Revolute(pi.ground, bar.at("left"), name="pin"))
    scene.add(pi.PointMass(bar.at("right"), 0.5, name="tip"))
    model = scene.build()
    force, run = at_end(model, "lam", 0), pi.solve(model, 1.0, pi.GeneralizedAlpha(h=h, tolerance=TIGHT, rho_inf=rho_inf))
    bars, value = pi.error_of(run, force), references(model, 1.0, [force], h / 8, rho_inf=rho_inf)[0]
    assert bars.trusted == trusted and (abs(bars.time / (value - bars.value) - 1) < 0.1) == trusted


@pytest.mark.parametrize("h, aim", [(2.5e-3, 0.1), (1.25e-3, 0.05)])
def test_errors_of_a_damped_plate(h, aim):
    model, objectives = damped_arm()
    run = pi.solve(model, 0.8, pi.GeneralizedAlpha(h=h, tolerance=TIGHT))
    assert np.abs(ratios(run, objectives, references(model, 0.8, objectives, h / 8)) - 1).max() < aim


def test_errors_of_an_undamped_plate_with_lost_phases():
    model = double_plate(cells=20).build()
    tip, lam = P.Deviation("tip", (30.0, 0.0)), at_end(model, "lam", 0)
    value = references(model, 1.0, [tip], 1.25e-4)[0]
    for h in (4e-3, 2e-3, 1e-3, 5e-4):
        run = pi.solve(model, 1.0, pi.GeneralizedAlpha(h=h, tolerance=TIGHT))
        assert 0.9 < ratios(run, [tip], [value])[0] < 1.1
        if h > 1e-3:
            bars = pi.error_of(run, lam)
            assert not bars.trusted and "phase is lost" in repr(bars) and bars.corrected == bars.value + bars.newton + bars.mesh


def test_errors_of_steps_that_cancel_are_not_trusted():
    """A driven bar that comes to rest: q is exact, and the errors of the trapezoidal rule cancel but for terms of higher order."""
    scene = pi.Scene()
    bar = scene.add(pi.RigidBody.bar(0.7, 1.0, name="bar"))
    scene.add(pi.Revolute(pi.ground, bar.at("left")))
    scene.add(pi.AngleMotor(pi.ground, bar.at("left"), profile.quintic(0.0, 1.0, duration=0.3)))
    scene.add(pi.PointMass(bar.at("right"), 0.5, name="tip"))
    model, place = scene.build(), P.Deviation("tip", (3.0, 0.0))
    coarse, fine = (pi.solve(model, 0.6, pi.GeneralizedAlpha(h=h, tolerance=TIGHT)) for h in (4e-3, 5e-4))
    bars = pi.error_of(coarse, place)
    assert not 0.5 < bars.time / (place(coarse) - place(fine)) < 2.0
    assert not bars.trusted and "cancel" in bars.reasons["time"][0]


def test_vibrations_that_have_no_effect_in_the_phase_of_the_run():
    """A plate that falls from rest: the error of the mean of lam^2 is half of its estimate; vibrations seem to make a quarter of that."""
    scene, material = pi.Scene(gravity=(0.0, -9.81)), pi.Material(E=7e7, nu=0.3, rho=1100.0, viscosity=1.7e-3)
    plate = scene.add(pi.Plate(pi.mesh.rectangle(0.625, 0.1, cells=20, seed=1), material, thickness=0.01, name="arm"))
    scene.add(pi.Revolute(pi.ground, plate.section("left"), name="pin"))
    scene.add(pi.PointMass(plate.section("right"), 0.35, name="tip"))
    model, force = scene.build(), P.PeakReaction("pin", p=2)
    bars = pi.error_of(pi.solve(model, 0.6, pi.GeneralizedAlpha(h=2e-3, tolerance=TIGHT)), force)
    assert not bars.trusted and "phase is lost" in repr(bars)
    assert bars.time / (references(model, 0.6, [force], 2.5e-4)[0] - bars.value) > 1.9


@pytest.mark.parametrize(
    "settings", [{"rtol": 1e-5}, {"h": 5e-3, "rtol": 1e-5}, {"h": 2e-3, "form": "stabilised"}, {"h": 2e-3, "rho_inf": 0.2}]
)
def test_adaptive_steps_and_other_settings(settings):
    model, objectives = rigid_crank()
    run = pi.solve(model, 0.4, pi.GeneralizedAlpha(tolerance=TIGHT, **settings))
    assert (
        np.abs(ratios(run, objectives[:1] + objectives[3:4], references(model, 0.4, objectives[:1] + objectives[3:4], 2.5e-4)) - 1).max()
        < 0.01
    )


class Oscillator(pi.Model):
    """A mass on a spring beside a spring and a damper in series: `x' = (q - x)/tau`, x the second velocity."""

    n, m, k = 1, 0, 1
    needs = pi.Needs(mass_varies=False)
    tau = 0.1

    def mass(self, q):
        return np.eye(1)

    def force(self, t, q, v, x):
        return 13.0 * q - 9.0 * x

    def rates(self, t, q, v, x):
        return (q - x) / self.tau


class Skate(pi.Model):
    """A skate on a belt that shakes."""

    n, m, p = 3, 0, 1
    needs = pi.Needs(mass_varies=False, velocity_forces=False)

    def mass(self, q):
        return np.diag(np.array([1.0, 1.0, 0.4]))

    def force(self, t, q, v):
        return np.array([-2.0, 0.0, -0.2 * np.cos(q[0])])

    def psi(self, t, q, v):
        return np.array([v[1] * np.cos(q[2]) - v[0] * np.sin(q[2]) - 0.2 * np.sin(3.0 * t)])


def rolling_disc():
    """A disc on a slope that a spring holds."""
    scene, along = pi.Scene(gravity=(0.0, -9.81)), np.array([np.cos(0.4), -np.sin(0.4)])
    origin = 0.1 * np.array([-along[1], along[0]])
    points, start = {"c": (0.0, 0.0), "rim": (0.1, 0.0)}, {"spin": -3.0, "velocity": tuple(0.3 * along)}
    body = scene.add(pi.RigidBody(mass=2.0, inertia=0.013, points=points, origin=tuple(origin), **start, name="disc"))
    scene.add(pi.RollingDisc(pi.ground.at((0.0, 0.0), direction=along), body.at("c"), radius=0.1, name="contact"))
    scene.add(pi.SpringDamper(pi.ground.at((0.5, 0.0)), body.at("rim"), stiffness=200.0, name="spring"))
    return scene.build()


def geared_bar():
    """A bar with a motor and a Maxwell element, which have states."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = scene.add(pi.RigidBody.bar(1.0, 0.5, name="bar"))
    scene.add(pi.Revolute(pi.ground, bar.at("left"), name="pin"))
    scene.add(pi.DCMotor(bar.at("left"), volts=profile.sine(12.0, 1.0), k=0.5, L=0.05, R=1.0, name="motor"))
    scene.add(pi.Maxwell(pi.ground.at((0.5, 0.5)), bar.at("right"), stiffness=40.0, damping=4.0, name="element"))
    return scene.build()


@pytest.mark.parametrize(
    ("made", "start", "ends"),
    [
        (Oscillator, {"v0": [1.0]}, [("q", 0), ("v", 0), ("v", 1)]),
        (pi.compiled(type("CompiledOscillator", (Oscillator,), {})), {"v0": [1.0]}, [("q", 0), ("v", 1)]),
        (Skate, {"v0": [0.0, 0.0, 1.5]}, [("q", 0), ("v", 1)]),
        (rolling_disc, {}, [("q", 0), ("v", 1)]),
        (geared_bar, {}, [("q", 2), ("v", 4), ("v", 6)]),
    ],
    ids=["states", "compiled states", "velocity row", "rolling disc", "states of a scene"],
)
def test_models_with_states_and_velocity_rows(made, start, ends):
    model = made()
    objectives = [at_end(model, name, row) for name, row in ends]
    coarse, half, fine = (pi.solve(model, 0.4, pi.GeneralizedAlpha(h=h, tolerance=TIGHT), **start) for h in (5e-3, 1.25e-3, 6.25e-4))
    values = [(4 * one(fine) - one(half)) / 3 for one in objectives]
    assert np.abs(ratios(coarse, objectives, values) - 1).max() < 0.1


@pytest.mark.parametrize(("h", "exponent", "damping", "stiffness"), [(1e-3, 1.5, 0.2, 2e4), (2e-3, 1.0, 0.0, 1e3)])
def test_a_penalty_contact_whose_steps_are_shortened(h, exponent, damping, stiffness):
    model = bar_on_a_floor(stiffness, damping, exponent)
    objectives, fine = [at_end(model, "q", 3), at_end(model, "v", 3)], pi.solve(model, 0.35, pi.RadauIIA(rtol=1e-8))
    run = pi.solve(model, 0.35, pi.GeneralizedAlpha(h=h, tolerance=TIGHT))
    assert np.diff(run.t).min() < 0.6 * h
    assert np.abs(ratios(run, objectives, [one(fine) for one in objectives]) - 1).max() < 0.1


def bar_on_a_floor(stiffness, damping, exponent):
    scene, start = pi.Scene(gravity=(0.0, -9.81)), {"velocity": (0.6, 0.0), "spin": 3.0}
    bar = scene.add(pi.RigidBody.bar(0.4, 0.5, origin=(0.0, 0.3), angle=0.5, **start, name="bar"))
    scene.add(pi.PenaltyContact(bar.at("left"), pi.ground.at((0.0, 0.0)), stiffness, damping, exponent, name="floor"))
    return scene.build()


@pytest.mark.parametrize(("stiffness", "low"), [(2e4, 0.9), (1e5, None)])
def test_a_penalty_contact_that_opens_into_a_long_step(stiffness, low):
    """The estimate takes the force of the open contact for that step; with the other slope it has another value, so that it is not trusted."""
    model = bar_on_a_floor(stiffness, 0.0, 1.0)
    angle, fine = at_end(model, "q", 3), pi.solve(model, 0.35, pi.RadauIIA(rtol=1e-8))
    run = pi.solve(model, 0.35, pi.GeneralizedAlpha(h=1e-3, tolerance=TIGHT))
    bars = pi.error_of(run, angle)
    assert not bars.trusted and "contacts open" in repr(bars)
    assert low is None or low < bars.time / (angle(fine) - bars.value) < 1.1


def test_stretches_and_checkpoints_do_not_change_the_estimate(monkeypatch):
    model, objectives = damped_arm(cells=8)
    run = pi.solve(model, 0.8, pi.GeneralizedAlpha(h=2.5e-3))
    whole = pi.error_of(run, objectives[2])
    monkeypatch.setattr("polyida.adjoint.alpha.LONGEST", 7)
    parts = pi.error_of(run, objectives[2])
    every = pi.error_of(pi.solve(model, 0.8, pi.GeneralizedAlpha(h=2.5e-3), every=4), objectives[2], memory_limit=2e5)
    assert parts.time == pytest.approx(whole.time, rel=1e-9) and parts.fast_share == pytest.approx(whole.fast_share, rel=1e-6)
    assert parts.newton == pytest.approx(whole.newton, rel=1e-6)
    assert every.value + every.time == pytest.approx(whole.value + whole.time, rel=1e-4)


def test_step_for_an_aim():
    model, objectives = rigid_crank()
    bars = pi.error_of(pi.solve(model, 0.4, pi.GeneralizedAlpha(h=2e-3, tolerance=TIGHT)), objectives[0])
    h = bars.h_for(1e-8)
    other = pi.error_of(pi.solve(model, 0.4, pi.GeneralizedAlpha(h=h, tolerance=TIGHT)), objectives[0])
    assert abs(other.time) == pytest.approx(1e-8, rel=0.05)
    axes = bars.plot_steps()
    assert axes.lines[0].get_ydata()[-1] == pytest.approx(bars.time)
    with pytest.raises(pi.InputError, match="aim"):
        bars.h_for(0.0)


def test_bad_input_is_refused():
    model, objectives = rigid_crank()
    run = pi.solve(model, 0.02, pi.GeneralizedAlpha(h=2e-3))
    for arguments, text in (((run, "tip"), "objective"), ((model, objectives[0]), "no run")):
        with pytest.raises(pi.InputError, match=text):
            pi.error_of(*arguments)
    with pytest.raises(pi.InputError, match="EnergyMomentum"):
        pi.error_of(pi.solve(model, 0.02, pi.EnergyMomentum(h=2e-3)), objectives[0])
    with pytest.raises(pi.InputError, match="error_of: .* is a velocity row"):
        pi.error_of(pi.solve(Skate(), 0.02, pi.GeneralizedAlpha(h=1e-2, form="stabilised")), at_end(None, "q", 0))
    with pytest.raises(pi.InputError, match="no constant step"):
        pi.error_of(pi.solve(model, 0.02, pi.GeneralizedAlpha()), objectives[0]).h_for(1e-6)


@pytest.mark.parametrize("form", ["index3", "stabilised"])
def test_error_of_newtons_tolerance(form):
    model, objectives = damped_arm(cells=12)
    loose, tight = (pi.solve(model, 0.6, pi.GeneralizedAlpha(h=5e-3, tolerance=tolerance, form=form)) for tolerance in (1e-3, 1e-9))
    for objective in objectives[:4]:
        bars = pi.error_of(loose, objective)
        assert bars.newton == pytest.approx(objective(tight) - objective(loose), rel=0.1)


def mesh_ratios(make, t_end, objectives, cells):
    """Estimates of the error of the mesh over the errors, by a mesh of 480 cells and one of 960."""
    settings, half, fine = pi.GeneralizedAlpha(h=4e-3, tolerance=1e-8), *(make(count).build() for count in (480, 960))
    half, fine = (pi.solve(model, t_end, settings) for model in (half, fine))
    result = []
    for count in cells:
        run = pi.solve(make(count).build(), t_end, settings)
        for objective in objectives:
            bars, value = pi.error_of(run, objective), 2 * objective(fine) - objective(half)
            assert not bars.reasons["mesh"] and sum(shares.sum() for shares in bars.cells.values()) == pytest.approx(bars.mesh, rel=1e-6)
            result.append(bars.mesh / (value - bars.value))
    return np.array(result)


def test_error_of_the_meshes_of_two_plates():
    ratios = mesh_ratios(double_plate, 0.3, [P.Deviation("tip", (30.0, 0.0)), P.StrainEnergy()], (60, 120))
    assert ((ratios > 0.85) & (ratios < 1.3)).all()


@pytest.mark.parametrize("plane", ["stress", "strain"])
def test_error_of_the_mesh_of_a_driven_arm_with_viscosity(plane):
    scene = lambda cells: damped_scene(plane, cells=cells, height=0.25)  # noqa: E731
    ratios = mesh_ratios(scene, 0.3, [P.Deviation("tip", (0.3, -0.1)), P.StrainEnergy("arm")], (60, 120))
    assert ((ratios > 0.85) & (ratios < 1.3)).all()


def test_parts_of_the_error_of_a_mesh_that_cancel_are_not_trusted():
    model, objectives = damped_arm(cells=60)
    bars = pi.error_of(pi.solve(model, 0.3, pi.GeneralizedAlpha(h=4e-3, tolerance=1e-8)), objectives[0])
    assert bars.trusted and "cancel" in repr(bars) and bars.corrected == bars.value + (bars.time + bars.newton)


def test_meshes_without_an_estimate_give_the_reason():
    model, objectives = damped_arm(element="virtual", cells=8)
    bars = pi.error_of(pi.solve(model, 0.02, pi.GeneralizedAlpha(h=5e-3)), objectives[0])
    assert bars.mesh is None and not bars.cells and "virtual" in repr(bars)
    model, objectives = damped_arm(cells=8)
    run = pi.solve(model.with_factors(arm=(np.linspace(1.0, 2.0, model.bodies[0].mesh.n_cells), None)), 0.02, pi.GeneralizedAlpha(h=5e-3))
    assert "different stiffness" in repr(pi.error_of(run, objectives[0]))
    assert "PeakStress" in repr(pi.error_of(pi.solve(model, 0.02, pi.GeneralizedAlpha(h=5e-3)), P.PeakStress("arm")))
    with pytest.raises(pi.InputError, match="known: none"):
        bars.plot_cells("arm", model.bodies[0].mesh)


def test_cells_are_drawn():
    model, objectives = damped_arm(cells=8)
    bars = pi.error_of(pi.solve(model, 0.1, pi.GeneralizedAlpha(h=5e-3)), objectives[0])
    axes = bars.plot_cells("arm", model.bodies[0].mesh)
    assert np.array_equal(axes.collections[0].get_array(), bars.cells["arm"])


def test_error_of_the_mesh_by_half_the_cells():
    scene, goal = damped_scene(cells=60, height=0.25), P.Deviation("tip", (0.3, -0.1))
    run = pi.solve(scene.build(), 0.1, pi.GeneralizedAlpha(h=4e-3, tolerance=1e-8))
    bars = pi.error_of(run, goal, again=True)
    half = pi.mesh.polygonize(pi.mesh.Outline([(0.0, -0.125), (1.0, -0.125), (1.0, 0.125), (0.0, 0.125)]), 30)
    coarse = damped_scene(mesh=half).build()
    assert bars.mesh_again == pytest.approx(bars.value - goal(pi.solve(coarse, 0.1, run.integrator)), rel=1e-6)
    assert bars.trusted and "mesh" in repr(bars)
    other = pi.solve(coarse.with_factors(arm=(2.0, None)), 0.02, run.integrator)
    assert "cells have factors" in repr(pi.error_of(other, goal, again=True))


def reduced_arm(modes, **fields):
    """A plate in few modes, or the full one for modes = 0, that a motor turns by 90 degrees."""
    scene, material = pi.Scene(gravity=(0.0, -9.81)), pi.Material(E=50e6, nu=0.3, rho=1100.0, viscosity=1e-3)
    plate = pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=60, seed=1), material, thickness=0.01, name="arm")
    arm = scene.add(pi.Reduced(plate, modes=modes, **fields) if modes else plate)
    scene.add(pi.Revolute(pi.ground, arm.section("left"), name="shoulder"))
    scene.add(pi.AngleMotor(pi.ground, arm.section("left"), profile.quintic(0.0, np.pi / 2, duration=0.5), name="motor"))
    scene.add(pi.PointMass(arm.section("right"), 0.05, name="tip"))
    return scene.build()


def test_error_of_modes_by_the_fields_that_are_missing():
    settings, tip = pi.GeneralizedAlpha(h=2.5e-3, tolerance=1e-8), P.Deviation("tip", (30.0, 0.0))
    value = tip(pi.solve(reduced_arm(0), 0.5, settings))
    for modes in (3, 5):
        run = pi.solve(reduced_arm(modes), 0.5, settings)
        bars = pi.error_of(run, tip, again=True)
        assert 0.8 < bars.modes / (value - bars.value) < 1.05
        assert abs(bars.again / bars.time - 1) < 0.2
        enriched = pi.solve(reduced_arm(modes, fields=pi.missing_fields(run, "arm")), 0.5, settings)
        assert tip(enriched) == pytest.approx(bars.value + bars.modes, rel=1e-12)
    with pytest.raises(pi.InputError, match="arm"):
        pi.missing_fields(run, "rod")


@pytest.mark.parametrize(
    "settings",
    [
        pi.EnergyMomentum(h=2e-3),
        pi.NonsmoothAlpha(h=1e-3),
        pi.MoreauJean(h=1e-3),
        pi.IDA(rtol=1e-6),
        pi.RadauIIA(rtol=1e-4),
        pi.RadauIIA(h=1e-2),
    ],
)
def test_errors_by_another_run(settings):
    model, objectives = rigid_crank()
    value, run = references(model, 0.3, [objectives[3]], 2.5e-4)[0], pi.solve(model, 0.3, settings)
    bars = pi.error_of(run, objectives[3], again=True)
    assert bars.trusted and bars.mesh is None
    assert abs(bars.corrected - value) <= 0.5 * abs(bars.value - value)


def test_another_run_needs_a_known_order():
    @dataclasses.dataclass(frozen=True)
    class Own:
        h: float

        def steps(self, model, state, t_end, counts):
            return pi.GeneralizedAlpha(h=self.h).steps(model, state, t_end, counts)

    model, objectives = rigid_crank()
    with pytest.raises(pi.InputError, match="the order of Own is not known"):
        pi.error_of(pi.solve(model, 0.01, Own(1e-3)), objectives[3], again=True)

    class Plain:
        order = 2

        def __init__(self, h):
            self.h = h

        steps = Own.steps

    known = pi.error_of(pi.solve(model, 0.02, pi.GeneralizedAlpha(h=1e-3)), objectives[3], again=True)
    for kind in (dataclasses.dataclass(frozen=True)(type("Declared", (Own,), {"order": 2})), Plain):
        bars = pi.error_of(pi.solve(model, 0.02, kind(1e-3)), objectives[3], again=True)
        assert bars.again == pytest.approx(known.again, rel=1e-9)
