"""The driver of designs: known optima, slopes of all kinds of variables, restart, load cases, and what it says when something is wrong."""

import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import NonlinearConstraint, minimize

import polyida as pi

MATERIAL = pi.Material(3e7, 0.3, 1100.0)
MESH = pi.mesh.quads(1.0, 0.25, 4, 2)


def arm(length=1.0, height=1.0, thickness=0.01, load=0.1, mesh=MESH):
    """A clamped plate with a load on its end."""
    scene = pi.Scene()
    plate = scene.add(pi.Plate(pi.mesh.moved(mesh, mesh.points * (length, height)), MATERIAL, thickness=thickness, name="arm"))
    scene.add(pi.Clamp(pi.ground, plate.section("left"), name="wall"))
    scene.add(pi.PointLoad(plate.section("right"), (0.0, -load), name="load"))
    return scene.build()


def turning(length=1.0, height=1.0):
    """A plate that a motor turns by a stiff spring of one coordinate, with a mass at its tip."""
    scene = pi.Scene()
    plate = scene.add(pi.Plate(pi.mesh.moved(MESH, MESH.points * (length, height)), MATERIAL, thickness=0.01, name="arm"))
    scene.add(pi.Revolute(pi.ground, plate.section("left"), name="hub"))
    scene.add(pi.AngleMotor(pi.ground, plate.section("left"), angle=pi.profile.quintic(0.0, 0.5, 0.05), name="motor"))
    scene.add(pi.PointMass(plate.section("right"), 0.05, name="tip"))
    scene.add(pi.SpringDamper(pi.ground.at((0.5, 1.0)), plate.section("right"), stiffness=30.0, damping=0.1, name="spring"))
    return scene.build()


def at_rest(model):
    return pi.static(model, linear=True)


def in_motion(model):
    return pi.solve(model, 0.02, pi.GeneralizedAlpha(1e-3, tolerance=1e-11))


THICKNESS = pi.design.Size("arm.thickness", 2e-3, 2e-2)
COMPLIANCE, MASS = pi.objective.Compliance(), pi.objective.Mass()
START = COMPLIANCE(at_rest(arm()))


def test_the_least_thickness_that_is_stiff_enough():
    said = []
    case = pi.design.Case(arm(), at_rest)
    design = pi.design.minimise(
        MASS, [pi.objective.Limit(COMPLIANCE, 2.0 * START)], [THICKNESS], case, progress=lambda *words: said.append(words)
    )
    assert design.met and design.values["arm.thickness"] == pytest.approx(0.005, rel=6e-3)
    assert design.objective == pytest.approx(MASS(design.run()), rel=1e-12)
    assert design.limits["Compliance"] == (pytest.approx(2.0 * START, rel=6e-3), 2.0 * START)
    assert list(design.history.columns) == ["stage", "q", "beta", "objective", "Compliance", "excess", "error", "seconds"]
    assert len(said) == len(design.history) and said[0][:2] == (1, 30) and "s left" in said[-1][2]
    assert "limits kept" in repr(design)


@pytest.mark.parametrize(
    ("start", "log", "moves"), [(3e-2, True, (1.0,)), (5e-3, True, (1.0,)), (5e-3, False, (1.0,)), (1e-2, True, (0.3, 0.1))]
)
def test_a_start_outside_of_the_limits_leads_to_the_same_optimum(start, log, moves):
    thickness = pi.design.Size("arm.thickness", 2e-3, 5e-2, start=start, log=log)
    stages = [pi.design.Stage(20, move=move) for move in moves]
    with pytest.warns(UserWarning, match="the start exceeds a limit"):
        design = pi.design.minimise(
            MASS, [pi.objective.Limit(COMPLIANCE, 0.25 * START)], [thickness], pi.design.Case(arm(), at_rest), stages
        )
    assert design.met and design.values["arm.thickness"] == pytest.approx(0.04, rel=1e-4)


def test_the_harder_of_two_load_cases_decides():
    cases = [pi.design.Case(arm(load=load), at_rest, name) for name, load in (("light", 0.1), ("heavy", 0.2))]
    limit = pi.objective.Limit(COMPLIANCE, 4.0 * START)
    with ThreadPoolExecutor(2) as executor:
        design = pi.design.minimise(MASS, [limit], [THICKNESS], cases, executor=executor)
    assert design.values["arm.thickness"] == pytest.approx(0.01, rel=6e-3)
    assert set(design.limits) == {"Compliance, light", "Compliance, heavy"} and design.objective == pytest.approx(
        0.01 * 0.25 * 1100, rel=6e-3
    )
    only = pi.design.minimise(MASS, [pi.objective.Limit(COMPLIANCE, 4.0 * START, case="light")], [THICKNESS], cases)
    assert only.values["arm.thickness"] == pytest.approx(0.0025, rel=2e-2)


def test_slopes_of_densities_sizes_and_built_models():
    case = pi.design.Case(turning, in_motion)
    variables = [
        pi.design.Size("length", 0.9, 1.1),
        pi.design.Size("height", 0.5, 2.0, log=True),
        pi.design.Size("arm.thickness", 5e-3, 2e-2),
        pi.design.Size("spring.stiffness", 10.0, 1000.0, log=True),
        pi.design.Size("motor.end", 0.3, 0.6),
        pi.design.Densities("arm", 0.3, keep="left", start=0.7),
    ]
    limits = [pi.objective.PeakTorque("motor", p=4), pi.objective.PeakStress("arm"), MASS, pi.objective.PeakPower("motor", p=4)]
    objective = pi.objective.Deviation("tip", (1.0, 0.3))
    problem = pi.design.Problem(objective, [pi.objective.Limit(one, 1.0) for one in limits], variables, case)
    sharp, x = pi.design.Sharpness(8.0, 4.0), np.clip(problem.start + 0.01 * np.arange(len(problem.start)), 0.0, 1.0)
    found, step = problem.evaluate(x, sharp), 2e-4

    def values(x):
        run = case.ran(problem.setting(x, sharp).model(case))
        return np.array([one(run) for one in (objective, *limits)])

    assert found.values == pytest.approx(values(x), rel=1e-12)
    for k in (0, 1, 2, 3, 4, 7, 10):
        way = np.eye(len(x))[k] * step
        near, far = (values(x + s * way) - values(x - s * way) for s in (1, 2))
        difference = (8 * near - far) / (12 * step)
        assert np.allclose(found.slopes[:, k], difference, rtol=1e-6, atol=1e-6 * np.abs(found.slopes).max(axis=1)), k
    assert found.largest[1] == pi.objective.PeakTorque("motor").largest(case.ran(problem.setting(x, sharp).model(case)))


def cranked(radius=0.2, rail=0.0):
    """A rigid crank that drives a plate to a slider: its radius places the hub, and the rail may be inclined."""
    scene = pi.Scene()
    crank = scene.add(pi.RigidBody(0.2, 1e-3, {"hub": (-radius, 0.0), "pin": (0.0, 0.0)}, center=(-0.5 * radius, 0.0), name="crank"))
    rod = scene.add(pi.Plate(MESH, pi.Material(3e8, 0.3, 1100.0), thickness=0.01, name="rod"))
    scene.add(pi.AngleMotor(pi.ground, crank.at("hub"), angle=pi.profile.quintic(0.0, 0.5, 0.05), name="motor"))
    scene.add(pi.Revolute(pi.ground, crank.at("hub"), name="hub"))
    scene.add(pi.Revolute(crank.at("pin"), rod.section("left"), name="pin"))
    scene.add(pi.Slot(pi.ground.at((1.0, 0.0), direction=(1.0, rail)), rod.section("right"), name="rail"))
    return scene.build()


def test_slopes_of_positions_of_joints():
    case = pi.design.Case(cranked, in_motion)
    variables = [pi.design.Size("radius", 0.1, 0.3), pi.design.Size("rail", -0.05, 0.05)]
    objectives = [pi.objective.PeakReaction("pin", p=4, unit="N"), pi.objective.StrainEnergy("rod"), pi.objective.PeakTorque("motor", p=4)]
    problem = pi.design.Problem(objectives[0], [pi.objective.Limit(one, 1.0) for one in objectives[1:]], variables, case)
    found, step = problem.evaluate(problem.start), 1e-3

    def values(x):
        run = case.ran(problem.setting(x).model(case))
        return np.array([one(run) for one in objectives])

    for k, way in enumerate(step * np.eye(2)):
        near, far = (values(problem.start + s * way) - values(problem.start - s * way) for s in (1, 2))
        difference = (8 * near - far) / (12 * step)
        assert np.allclose(found.slopes[:, k], difference, rtol=1e-6, atol=1e-6 * np.abs(found.slopes).max(axis=1)), k


def test_a_search_that_was_ended_goes_on_as_if_it_had_not(tmp_path):
    runs = []
    case = pi.design.Case(arm(), lambda model: runs.append(1) or at_rest(model))
    limits, variables = [pi.objective.Limit(COMPLIANCE, 2.0 * START)], [pi.design.Densities("arm", 0.3), THICKNESS]
    stages = [pi.design.Stage(6, q=3.0), pi.design.Stage(6, q=3.0, beta=4.0, move=0.3)]
    whole = pi.design.minimise(MASS, limits, variables, case, stages)
    count = len(runs)

    def end(done, total, text):
        if done == 8:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pi.design.minimise(MASS, limits, variables, case, stages, tmp_path, progress=end)
    runs.clear()
    again = pi.design.minimise(MASS, limits, variables, case, stages, tmp_path)
    assert np.array_equal(again.x, whole.x) and len(runs) == count - 8 + 1
    assert again.history["objective"].tolist() == whole.history["objective"].tolist()
    with pytest.raises(pi.InputError, match="holds the evaluations of another problem"):
        pi.design.minimise(COMPLIANCE, limits, variables, case, stages, tmp_path)


def test_the_search_steps_back_from_runs_that_fail():
    def careful(model):
        if model.parts["arm"].thickness < 6e-3:
            raise pi.StepFailure("weak", "the plate is too thin")
        return at_rest(model)

    design = pi.design.minimise(MASS, [pi.objective.Limit(COMPLIANCE, 4.0 * START)], [THICKNESS], pi.design.Case(arm(), careful))
    failed = design.history["error"] != ""
    assert failed.any() and "too thin" in design.history["error"][failed].iloc[0] and "the search stepped back" in design.message
    assert 6e-3 <= design.values["arm.thickness"] < 7e-3
    with pytest.raises(pi.InputError, match="the run of the start fails .run: the plate is too thin"):
        thin = pi.design.Size("arm.thickness", 2e-3, 2e-2, start=3e-3)
        pi.design.minimise(MASS, [], [thin], pi.design.Case(arm(), careful))


def test_words_on_limits_that_cannot_be_met_and_variables_without_influence():
    limit, idle = pi.objective.Limit(COMPLIANCE, 0.1 * START), pi.design.Size("wall.offset", 0.0, 1.0)
    with pytest.raises(pi.InputError, match="Size 'wall.offset': neither an argument"):
        pi.design.minimise(MASS, [limit], [idle], pi.design.Case(arm(), at_rest))
    idle = pi.design.Densities("arm", 0.3, keep=("left", "right", "top", "bottom"))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        design = pi.design.minimise(MASS, [limit], [THICKNESS, idle], pi.design.Case(arm(), at_rest), [pi.design.Stage(8)])
    words = " | ".join(str(one.message) for one in told)
    assert "the start exceeds a limit: Compliance is" in words and "the variable 'arm' has no influence" in words
    assert not design.met and design.values["arm.thickness"] == pytest.approx(0.02) and "limits exceeded by 4" in design.message


def test_another_optimiser_takes_values_and_slopes():
    problem = pi.design.Problem(MASS, [pi.objective.Limit(COMPLIANCE, 2.0 * START)], [THICKNESS], pi.design.Case(arm(), at_rest))
    value = lambda x: (problem.evaluate(x).values[0], problem.evaluate(x).slopes[0])  # noqa: E731
    limit = NonlinearConstraint(
        lambda x: problem.evaluate(x).values[1] / START, -np.inf, 2.0, jac=lambda x: problem.evaluate(x).slopes[1:] / START
    )
    found = minimize(value, problem.start, jac=True, method="trust-constr", bounds=[(0.0, 1.0)], constraints=[limit])
    assert problem.values(found.x)["arm.thickness"] == pytest.approx(0.005, rel=1e-3)


NAN = pi.objective.UserObjective(lambda run: 1.0, lambda run: {"q": np.zeros_like(run.q)})
CASE = pi.design.Case(arm(), at_rest)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: pi.design.Size("arm.thickness", 2.0, 1.0), "lower = 2.0 must be less than upper = 1.0"),
        (lambda: pi.design.Size("arm.thickness", 0.0, 1.0, log=True), "True only with lower > 0"),
        (lambda: pi.design.Size("arm.thickness", 0.5, 1.0, start=2.0), "start = 2.0 must be a number from 0.5 to 1"),
        (lambda: pi.design.Densities("arm", 0.1, start=1.5), "start = 1.5 must be a number from 0 to 1"),
        (lambda: pi.design.Stage(0), "evaluations = 0 must be a whole number"),
        (lambda: pi.design.Stage(move=0.0), "move = 0.0 must be above 0"),
        (lambda: pi.design.Case(arm(), 3.0), "run = 3.0 must be a function of a model"),
        (lambda: pi.design.Problem(MASS, [], [], CASE), "variables and cases must have at least one entry"),
        (lambda: pi.design.Problem(MASS, [COMPLIANCE], [THICKNESS], CASE), "limits = .* must be a list of pi.objective.Limit"),
        (lambda: pi.design.Problem(MASS, [], [THICKNESS, THICKNESS], CASE), "variables has 'arm.thickness' twice"),
        (lambda: pi.design.Problem(MASS, [], [pi.design.Densities("leg", 0.1)], CASE), "no full plate is called 'leg'; known: 'arm'"),
        (lambda: pi.design.Problem(MASS, [], [pi.design.Densities("arm", 0.1, keep="tip")], CASE), "keep names 'tip'"),
        (lambda: pi.design.Problem(MASS, [pi.objective.Limit(MASS, 1.0, case="x")], [THICKNESS], CASE), "no case is called 'x'"),
        (lambda: pi.design.minimise(MASS, [], [THICKNESS], CASE, stages=[3]), "stages = .3. must be a list"),
    ],
)
def test_bad_input(call, words):
    with pytest.raises(pi.InputError, match=words):
        call()


def test_a_solid_design_is_run_again():
    mesh = pi.mesh.quads(1.0, 0.25, 12, 6)
    case = pi.design.Case(arm(mesh=mesh), at_rest)
    limits, variables = [pi.objective.Limit(COMPLIANCE, 2.0 * START)], [pi.design.Densities("arm", 0.1, keep=("left", "right")), THICKNESS]
    stages = [pi.design.Stage(10, q=3.0), pi.design.Stage(10, q=6.0, beta=8.0)]
    design = pi.design.minimise(MASS, limits, variables, case, stages)
    again = pi.design.solid(design, lambda arm: globals()["arm"](mesh=arm), others={"nonlinear": pi.static})
    mass, compliance = again.table["solid"]
    plate = again.models["run"].parts["arm"]
    assert plate.thickness == design.values["arm.thickness"] and again.meshes["arm"].n_cells < mesh.n_cells
    assert mass == pytest.approx(again.meshes["arm"].area * plate.thickness * 1100.0, rel=1e-12)
    assert compliance == pytest.approx(COMPLIANCE(again.runs["run"]), rel=1e-12) and again.excess == pytest.approx(
        compliance / (2 * START) - 1
    )
    assert again.table.loc["objective", "optimiser"] == design.objective and set(again.table) == {
        "upper",
        "optimiser",
        "solid",
        "nonlinear",
    }
    assert str(again.at) in repr(again)
    assert ", limits kept)" in repr(replace(again, excess=-0.0054)) and ", limits exceeded by 1.2 %)" in repr(replace(again, excess=0.012))
    with pytest.raises(pi.InputError, match="no level gives a design that runs"):
        pi.design.solid(design, lambda arm: globals()["arm"](mesh=arm), levels=[2.0])


def test_a_solid_design_moves_its_edges_to_its_limits():
    mesh = pi.mesh.rectangle(1.0, 0.25, cells=120, seed=1)
    limit = pi.objective.Limit(pi.objective.PeakStress("arm", p=12), 8.0 * pi.objective.PeakStress("arm").largest(at_rest(arm())))
    limits = [pi.objective.Limit(COMPLIANCE, 2.0 * START), limit]
    densities = pi.design.Densities("arm", 0.05, keep=("left", "right"), start=0.9)
    case, stages = pi.design.Case(arm(mesh=mesh), at_rest), [pi.design.Stage(10, q=3.0), pi.design.Stage(6, q=6.0, beta=8.0)]
    design = pi.design.minimise(MASS, limits, [densities], case, stages)
    by_level, moved = (pi.design.solid(design, lambda arm: globals()["arm"](mesh=arm), changes=n) for n in (0, 60))
    slack = np.array([one.table["solid"] / one.table["upper"] for one in (by_level, moved)])[:, 1:]
    assert slack[0].max() < 0.97 and 0.97 < slack[1].max() <= 1.005  # levels leave some of the limits, the search uses it
    assert moved.table.loc["objective", "solid"] < 0.95 * by_level.table.loc["objective", "solid"]
    assert moved.meshes["arm"].quality().pieces == 1 and moved.meshes["arm"].section("right").length == pytest.approx(0.25)
    assert moved.table.loc["Compliance", "solid"] == pytest.approx(COMPLIANCE(moved.runs["run"]), rel=1e-12)
    with pytest.raises(pi.InputError, match="changes = -1 must be a whole number of at least 0"):
        pi.design.solid(design, lambda arm: globals()["arm"](mesh=arm), changes=-1)


def test_a_solid_design_is_not_heavier_than_meshes_to_begin_with():
    mesh = pi.mesh.rectangle(1.0, 0.25, cells=120, seed=1)
    x, y = mesh.cell_centroids.T
    limits, densities = [pi.objective.Limit(COMPLIANCE, 4.0 * START)], pi.design.Densities("arm", 1e-3, keep=("left", "right"))
    problem = pi.design.Problem(MASS, limits, [densities], pi.design.Case(arm(mesh=mesh), at_rest))
    design = pi.design.Design(problem, np.ones(mesh.n_cells), pi.design.Sharpness(), 0.0, {"Compliance": (0.0, 0.0)}, True, "", None)
    hole = (np.abs(y) < 0.04) & (x > 0.2) & (x < 0.8)
    lighter = pi.design.threshold(mesh, 1.0 - hole, keep=("left", "right"))
    build = lambda arm: globals()["arm"](mesh=arm)  # noqa: E731
    whole, begun, moved = (
        pi.design.solid(design, build, **more) for more in ({}, {"start": {"arm": lighter}}, {"start": {"arm": lighter}, "changes": 4})
    )
    mass = [one.table.loc["objective", "solid"] for one in (whole, begun, moved)]
    assert mass[0] == pytest.approx(0.25 * 0.01 * 1100) and mass[1] == pytest.approx(lighter.area * 0.01 * 1100) and mass[2] < mass[1]
    assert begun.excess <= 0.0 and "from given meshes" in repr(begun)
    with pytest.raises(pi.InputError, match="start has no mesh for the plate 'arm'"):
        pi.design.solid(design, build, start={"leg": lighter})
    with pytest.raises(pi.InputError, match="cells that the mesh of the design does not have"):
        pi.design.solid(design, build, start={"arm": pi.mesh.rectangle(1.0, 0.25, cells=100, seed=2)})


def test_a_solid_design_that_exceeds_its_limits_is_mended():
    mesh = pi.mesh.rectangle(1.0, 0.25, cells=120, seed=1)
    x, y = mesh.cell_centroids.T
    hole = (np.abs(y) < 0.08) & (x > 0.1) & (x < 0.7)
    limits, densities = [pi.objective.Limit(COMPLIANCE, 1.3 * START)], pi.design.Densities("arm", 1e-3, keep=("left", "right"))
    problem = pi.design.Problem(MASS, limits, [densities], pi.design.Case(arm(mesh=mesh), at_rest))
    design = pi.design.Design(problem, 1.0 - hole, pi.design.Sharpness(), 0.0, {"Compliance": (0.0, 1.3 * START)}, True, "", None)
    with pytest.warns(UserWarning, match="the design exceeds limits: Compliance is .*, upper .*; try `changes`"):
        by_level = pi.design.solid(design, lambda arm: globals()["arm"](mesh=arm))
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        mended = pi.design.solid(design, lambda arm: globals()["arm"](mesh=arm), changes=150)
    assert by_level.excess > 0.1 and mended.excess <= 0.005
