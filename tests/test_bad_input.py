"""Wrong input is answered before any run, by a message that names the part and the value."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import polyida as pi
from polyida.adjoint.parameters import parameters_of
from polyida.mesh import Circle, Intersection, Rectangle, polygonize
from polyida.show import plates
from polyida.show.animations import animation
from polyida.study.comparison import compare
from polyida.study.ivp import load

MATERIAL = pi.Material(50e6, 0.3, 1100.0)
MESH = pi.mesh.rectangle(1.0, 0.1, cells=20, seed=1)
REST = {"q0": [-1.0, 0.0]}


def plate(name="board", **options):
    """A plate with one setting changed."""
    return pi.Plate(**({"mesh": MESH, "material": MATERIAL, "thickness": 0.01, "name": name} | options))


def scene(*parts, gravity=(0.0, -9.81)):
    """A built scene."""
    made = pi.Scene(gravity)
    for part in parts:
        made.add(part)
    return made.build()


def polygon(points):
    """A mesh of one cell."""
    return pi.mesh.PolygonMesh(points, np.arange(len(points)), [0, len(points)], {})


def hinge(body, name="hinge"):
    return pi.Revolute(pi.ground, body.section("left"), name=name)


def apart():
    one, other = plate("one"), plate("other", origin=(1.2, 0.0))
    return scene(one, other, pi.Revolute(one.section("right"), other.section("left"), name="elbow"))


def twice():
    board = plate()
    return pi.solve(scene(board, hinge(board), hinge(board, "again")), 0.1, pi.GeneralizedAlpha(h=1e-3))


def of_a_stranger():
    board, stranger = plate(), plate("stranger")
    return scene(board, hinge(stranger, "elbow"))


def swing(**options):
    return pi.solve(pi.problems.get("pendulum").model, 0.1, pi.GeneralizedAlpha(h=1e-3), **(REST | options))


def moved(where, size):
    board = plate()
    model = scene(board, hinge(board))
    return pi.solve(model, 0.1, pi.GeneralizedAlpha(h=1e-3), **{where: np.full(model.n, size)})


CASES = {
    "nu 0.5": (lambda: pi.Material(1.0, 0.5, 1.0), "Material", "nu = 0.5", "(-1, 0.5)"),
    "plane": (lambda: pi.Material(1.0, 0.3, 1.0, "both"), "Material", "'both'", "stress"),
    "gravity of one function": (lambda: pi.Scene(lambda t: (0.0, -t)), "gravity", "pair (gx, gy)", "functions of time"),
    "thickness as text": (lambda: plate(thickness="thin"), "board", "'thin'"),
    "element": (lambda: plate(element="magic"), "board", "'magic'", "wachspress"),
    "non-convex cell": (lambda: plate(mesh=polygon([[0, 0], [1, 0], [0.2, 0.2], [0, 1]])), "board", "cell 0", "convex"),
    "clockwise cell": (lambda: polygon([[0, 0], [0, 1], [1, 1], [1, 0]]), "cell 0", "area -1", "counter-clockwise"),
    "no such section": (lambda: plate().section("lid"), "board", "'lid'", "'left'"),
    "function selects no node": (lambda: plate().section(lambda points: points[:, 0] > 7.0), "board", "no boundary node"),
    "no hole": (lambda: plate().rim(0), "board", "hole 0"),
    "joint of a plate": (lambda: pi.Revolute(pi.ground, plate(), name="elbow"), "elbow", "board"),
    "joint of ground alone": (lambda: pi.Revolute(pi.ground, pi.ground, name="elbow"), "elbow", "ground"),
    "joint within a body": (lambda: (lambda b: pi.Clamp(b.section("left"), b.section("right"), name="weld"))(plate()), "weld", "board"),
    "joint of a stranger": (of_a_stranger, "elbow", "stranger"),
    "joint apart": (apart, "elbow", "0.2 m", "(1.2, 0)"),
    "motor on a node": (lambda: pi.AngleMotor(pi.ground, plate().node(0), 0.0, name="drive"), "drive", "node 0"),
    "weld on a node": (lambda: pi.Clamp(plate("a").node(0), plate("b").section("left"), name="weld"), "weld", "node 0"),
    "mass on nothing": (lambda: pi.PointMass(pi.ground, 1.0, name="tip"), "tip", "ground"),
    "load on a plate": (lambda: pi.PointLoad(plate(), (1.0, 0.0), name="push"), "push", "board"),
    "traction on a node": (lambda: pi.EdgeTraction(plate().node(0), (1.0, 0.0), name="wind"), "wind", "node 0"),
    "empty scene": (lambda: scene(), "no plate"),
    "two of one name": (lambda: scene(plate(), plate()), "'board'", "taken"),
    "redundant": (twice, "hinge", "again", "redundant"),
    "q0 off phi": (lambda: moved("q0", 0.1), "q0", "hinge x", "-0.1"),
    "v0 off phi": (lambda: moved("v0", 0.1), "v0", "hinge x", "-0.1"),
    "q0 of the wrong size": (lambda: swing(q0=[1.0, 2.0, 3.0]), "q0", "(3,)", "2 finite"),
    "profile that raises": (
        lambda: scene(
            plate(), *(lambda b: [b, hinge(b), pi.AngleMotor(pi.ground, b.section("left"), lambda t: None, name="drive")])(plate("b"))
        ).drives(0.0),
        "drive",
    ),
    "profile that is nan": (
        lambda: (
            lambda b: pi.solve(
                scene(b, hinge(b), pi.AngleMotor(pi.ground, b.section("left"), lambda t: np.nan, name="drive")),
                0.1,
                pi.GeneralizedAlpha(h=1e-3),
            )
        )(plate()),
        "drive",
        "nan",
    ),
    "rho_inf one": (lambda: pi.GeneralizedAlpha(h=1e-3, rho_inf=1.0), "GeneralizedAlpha", "rho_inf = 1.0", "[0, 1)"),
    "scaling": (lambda: pi.GeneralizedAlpha(h=1e-3, scaling="full"), "GeneralizedAlpha", "'full'", "bottasso"),
    "scene for a model": (lambda: pi.solve(pi.Scene(), 1.0, pi.GeneralizedAlpha(h=1e-3)), "Scene", "build()"),
    "no integrator": (lambda: pi.solve(pi.problems.get("pendulum").model, 1.0, "alpha"), "'alpha'", "GeneralizedAlpha"),
    "end before start": (lambda: swing(t0=1.0), "t_end = 0.1", "1.0"),
    "steps beyond count": (
        lambda: pi.solve(pi.problems.get("pendulum").model, 1e308, pi.GeneralizedAlpha(h=1e-3), **REST),
        "t_end = 1e+308",
        "steps",
    ),
    "q0 as objects of text": (lambda: swing(q0=np.array(["-1", "0"], object)), "q0", "2 finite"),
    "points as text": (lambda: polygon([["0", "0"], ["1", "0"], ["1", "1"]]), "points", "numbers"),
    "length as text": (lambda: pi.mesh.rectangle("1", 0.1, cells=4), "'1'"),
    "digits as text": (lambda: pi.problems.get("pendulum").errors(q=["0", "1"]), "pendulum", "numbers"),
    "profile later nan": (
        lambda: pi.solve(
            scene(
                *(
                    lambda b: [
                        b,
                        hinge(b),
                        pi.PointLoad(b.section("right"), (0.0, 1.0), lambda t: 1.0 if t < 0.05 else np.nan, name="push"),
                    ]
                )(plate())
            ),
            0.1,
            pi.GeneralizedAlpha(h=1e-2),
        ),
        "<lambda>",
        "nan",
        "t = 0.05",
    ),
    "profile complex": (lambda: pi.profile.from_function(lambda t: 1j)(0.3), "<lambda>", "1j", "t = 0.3"),
    "profile shortest": (lambda: pi.profile.from_function(np.sin, shortest=0.0), "shortest = 0.0"),
    "flag": (lambda: pi.GeneralizedAlpha(h=1e-3, incremental_phi=np.array([1, 2])), "incremental_phi"),
    "state for a condition number": (
        lambda: pi.condition_number(pi.problems.get("pendulum").model, pi.GeneralizedAlpha(h=1e-3), "start"),
        "condition_number",
        "'start'",
    ),
    "device as a file": (lambda: swing(out="/dev/null", overwrite=True), "/dev/null", "device"),
    "long name": (lambda: swing(out="n" * 300), "n" * 20, "long"),
    "steps lost in the round-off of t": (
        lambda: pi.solve(scene(plate()), 1e9 + 1e-5, pi.GeneralizedAlpha(h=1e-8), t0=1e9),
        "steps of 1e-08 s",
        "1.2e-07 s apart",
    ),
    "a run of a few round-offs": (
        lambda: pi.solve(scene(plate()), 1e9 + 1e-6, pi.IDA(), t0=1e9),
        "t_end = 1000000000.000001",
        "1.91e-06 s",
    ),
    "a run of no time": (lambda: pi.solve(scene(plate()), 1e-300, pi.GeneralizedAlpha(h=1e-3)), "t_end = 1e-300", "1e-15 s"),
    "no run to compare": (lambda: pi.problems.get("pendulum").compare(3), "'pendulum'", "int"),
    "unknown problem": (lambda: pi.problems.get("triple"), "'triple'", "double-plate"),
}


@pytest.mark.parametrize("case", CASES)
def test_message_names_part_and_value(case):
    make, *words = CASES[case]
    with pytest.raises(pi.InputError) as caught:
        make()
    message = str(caught.value)
    assert all(word in message for word in words), message
    assert len(message) < 300 and "\n" not in message


ALPHA, IDA, RADAU = pi.GeneralizedAlpha(h=1e-3), pi.IDA(), pi.RadauIIA(h=1e-3)
AWAY = pi.objective.Deviation("tip", (1.0, 0.0))
POINT = {"A": (0.0, 0.0)}


@cache
def run(until=0.01, **options):
    """A short run of a hinged plate with a tip mass and a load and a motor that follow profiles."""
    board = plate()
    end = board.section("right")
    parts = (
        board,
        hinge(board),
        pi.PointMass(end, 1.0, name="tip"),
        pi.PointLoad(end, (0.0, 1.0), pi.profile.polynomial([1.0, 1.0]), name="wind"),
    )
    drive = pi.AngleMotor(pi.ground, board.section("left"), lambda t: t * t, name="drive")
    return pi.solve(scene(*parts, drive), until, ALPHA)


def onward():
    return pi.solve(run().model, 0.02, ALPHA, state=run().state)


@cache
def welded():
    """A run of a bar on a weld, which has forces and a moment."""
    bar = pi.RigidBody.bar(1.0, 1.0, name="bar")
    return pi.solve(scene(bar, pi.Weld(bar.at("left"), pi.ground, name="wall")), 0.01, ALPHA)


class Own(pi.Model):
    """A pendulum of a user's own."""

    n, m = 2, 1

    def mass(self, q):
        return np.eye(2)

    def force(self, t, q, v):
        return np.array([0.0, 9.81])

    def phi(self, t, q):
        return np.array([q @ q - 1.0])

    def phi_q(self, t, q):
        return 2.0 * q[None]


def own(**functions):
    """A run of such a model with other functions or attributes."""
    return pi.solve(type("Own", (Own,), functions)(), 0.01, ALPHA, q0=[-1.0, 0.0])


def factors(**given):
    board, rod = plate(), pi.Rigid(plate("rod", origin=(0.0, 1.0)))
    return scene(board, rod, hinge(board)).with_factors(**given)


def condition(integrator, *choice, **more):
    return pi.condition_number(run().model, integrator, run().state, *choice, **more)


def precision(*about, **more):
    about = about or ("pendulum", 0.01)
    return pi.study.work_precision(*about, **({"integrators": {"IDA": IDA}} | more))


def step_sizes(**more):
    return pi.study.step_sizes("pendulum", 0.01, **({"integrators": {"alpha": lambda h: pi.GeneralizedAlpha(h=h)}} | more))


def digits(**more):
    return {"q": np.zeros(2), "v": np.zeros(2), "lam": np.zeros(1)} | more


def mounted_twice():
    """Two bodies of one plate, which has one place."""
    made, one = pi.Scene(), plate()
    for name, place in (("x", 0.01), ("y", 0.5)):
        made.add(pi.Revolute(pi.ground.at((place, 0.0)), made.add(pi.Rigid(one, name=name)).section("left")))
    return made.assemble()


def sprung():
    board = plate()
    spring = pi.SpringDamper(pi.ground.at((1.0, 1.0)), board.section("right"), 1.0, force=lambda e, rate: "much", name="spring")
    return pi.solve(scene(board, spring), 0.01, ALPHA)


@cache
def standing(number=1):
    """Modes of a clamped plate, or of a model of a user's own that hangs."""
    board = plate()
    return pi.modes(scene(board, pi.Clamp(board.section("left"))), count=number)


def held():
    """As many constraints as coordinates."""
    return type("Held", (Own,), {"m": 2, "phi": lambda self, t, q: q - [0.0, -1.0], "phi_q": lambda self, t, q: np.eye(2)})()


def free():
    return type("Free", (Own,), {"m": 0, "force": lambda self, t, q, v: 3.0 * q})()


def loose():
    return type("Loose", (Own,), {"m": 0, "mass": lambda self, q: np.diag([1.0, 0.0]), "force": lambda self, t, q, v: 3.0 * q})()


def named_kinks(self, t0, t1):
    return ["soon"]


def doubled():
    """A reaction that is shared by two joints at will."""
    board = plate()
    model = pi.Scene.build(_scene(board, pi.Clamp(board.section("left")), hinge(board, "double")), redundant="least-norm")
    still = pi.Trajectory(model, "by hand", np.zeros(1), *np.zeros((3, 1, model.n)), np.zeros((1, model.m)))
    return pi.objective.PeakReaction("double").slopes(still)


def _scene(*parts):
    made = pi.Scene()
    for part in parts:
        made.add(part)
    return made


def loose_body():
    """A clamped plate, and a bar that nothing holds."""
    board = plate()
    bar = pi.RigidBody.bar(1.0, 1.0, name="bar")
    return scene(board, pi.Clamp(board.section("left")), bar, pi.PointLoad(bar.at("left"), (1.0, 0.0)))


class Short(pi.Integrator):
    """An integrator whose steps take too few arguments."""

    def steps(self, model, state):
        yield state


class Empty(pi.Integrator):
    """An integrator without steps."""


MORE = [  # (what is wrong, what the message says)
    (lambda: swing(until=lambda t: t - 0.1), "solve: until = <function .* must be a function of t, q and v$"),
    (lambda: swing(until=3), "solve: until = 3 must be a function of t, q and v$"),
    (lambda: swing(sensors={"time": lambda t: t}), r"solve: sensors\['time'\] = <function .* must be a function of t, q and v$"),
    (lambda: pi.Event(lambda t, q, v: 0.0, name="hit"), "'hit': when = .* of one argument, a state"),
    (lambda: pi.Event(lambda s: 0.0, lambda t, q: None, name="hit"), "'hit': then = .* or a function of the state"),
    (lambda: pi.solve(Own(), 0.01, Short(), **REST), r"solve: steps of Short must take \(model, state, t_end, counts\)"),
    (lambda: pi.solve(Own(), 0.01, Empty(), **REST), "solve: Empty is no integrator, it has no method steps"),
    (lambda: pi.solve(Own, 0.01, ALPHA, **REST), r"solve: Own is a class: give an instance, Own\(\)$"),
    (lambda: pi.solve(Own(), ALPHA, 0.01, **REST), "solve: t_end and the integrator are exchanged: t_end = 0.01 "),
    (lambda: pi.GeneralizedAlpha(dt=1e-3), "no argument 'dt'; did you mean 'h'"),
    (lambda: welded().reaction("pin"), "no joint is called 'pin'; known: 'wall'$"),
    (lambda: factors(uper=(1.0, 1.0)), "'uper' is no part of the scene; plates: 'board'"),
    (lambda: factors(rod=(1.0, 1.0)), "'rod' is a Rigid: only the cells of full plates have factors"),
    (lambda: factors(board=0.5), "board = 0.5 must be a pair"),
    (lambda: factors(board=(np.ones(3), 1.0)), r"stiffness of 'board' .* of shape \(3,\), must be a positive number, or one for each"),
    (lambda: factors(board=(1.0, -0.5)), "mass of 'board' is -0.5: factors must be positive"),
    (lambda: condition(ALPHA, "none", "p"), "unknown = 'p' must be one of"),
    (lambda: condition(IDA, "none", "v", h=1e-3), "unknown = 'v' must be 'q'"),
    (lambda: condition(IDA, "none", h=-1), "h = -1 must be a positive number of seconds"),
    (lambda: condition(IDA), "h = None must be a positive step"),
    (lambda: condition(pi.GeneralizedAlpha()), "h = None must be a positive step in s: GeneralizedAlpha"),
    (lambda: condition(ALPHA, mode="real"), "must be None for GeneralizedAlpha"),
    (lambda: condition(RADAU, mode="both"), "mode = 'both' must be one of real, complex"),
    (lambda: condition(pi.RadauIIA(stages=2), h=1e-3, mode="real"), "must be 'complex' for RadauIIA of two stages"),
    (lambda: condition(pi.EnergyMomentum(h=1e-3)), "must be GeneralizedAlpha, IDA or RadauIIA"),
    (lambda: pi.gradient(run(), AWAY, 2), "list of names"),
    (lambda: pi.gradient(run(), len), "no objective"),
    (lambda: pi.gradient(3, AWAY), "no run"),
    (lambda: pi.gradient(replace(run(), integrator=pi.GeneralizedAlpha(3e-3)), AWAY), "not steps"),
    (lambda: pi.gradient(run(), AWAY)["board.colour"], "known"),
    (lambda: pi.gradient(onward(), AWAY), "goes on from a state of another one"),
    (lambda: pi.check_gradient(run(), AWAY, seed=-1), "seed = -1 must be"),
    (lambda: parameters_of(run().model)["wind.coefficients"].replaced((1.0,)), "wind.coefficients: .* must be 2 finite numbers"),
    (lambda: parameters_of(type("Own", (Own,), {"parameters": "weight"})()), r"must be a tuple of names, such as \(.weight.,\)"),
    (
        lambda: parameters_of(type("Own", (Own,), {"parameters": ("red",), "red": "x"})()),
        "its parameter 'red' must be an attribute that is a number",
    ),
    (
        lambda: pi.objective.UserObjective(lambda run: 1.0 / 0.0, dict)(run()),
        "UserObjective: value.run., the function <lambda>, raised ZeroDivisionError: ",
    ),
    (lambda: pi.objective.UserObjective(lambda run: "much", dict)(run()), "value.run. must return a finite number"),
    (lambda: (1.0 * pi.objective.Frequency(10**4))(run()), "number = 10000 is too large"),
    (lambda: pi.objective.PeakReaction("wall")(welded()), "the reaction of 'wall' is in N and N m; give one of these as unit"),
    (doubled, "'double' is not unique"),
    (lambda: pi.objective.StrainEnergy()(own()), "is no scene's model"),
    (lambda: pi.RigidBody(1.0, 1.0, {}), "points = {} must be a dictionary"),
    (lambda: pi.RigidBody(1.0, 1.0, POINT, name="crank").at("B"), "'crank': no attachment is called 'B'; known: 'A'"),
    (lambda: pi.RigidBody.from_mesh("square", MATERIAL, 0.01), "from_mesh takes a polyida mesh"),
    (lambda: pi.RigidBody.from_mesh(MESH, MATERIAL, 0.01, points=[(0.0, 0.0)]), "points = .* must be a dictionary"),
    (lambda: pi.Rigid("plate"), "Rigid.*is no plate"),
    (lambda: pi.Reduced(plate(), modes=-1), "'board': modes = -1 must be a whole number from 0 to 40"),
    (lambda: pi.Reduced(plate(), modes=0), "modes = 0 leaves no field; give modes, fields, or take Rigid"),
    (lambda: pi.Reduced(plate(), fields="all"), "fields of shape str"),
    (lambda: pi.GeneralizedAlpha.newmark(1e-3, 0.25, 0.5), "trapezoidal"),
    (lambda: pi.GeneralizedAlpha.newmark(1e-3, -0.1, 0.6), "beta > 0"),
    (lambda: pi.GeneralizedAlpha.newmark(None), "h = None must be a step in s for the member"),
    (lambda: pi.GeneralizedAlpha.hht(1e-3, 0.0), "alpha = 0.0"),
    (lambda: pi.GeneralizedAlpha.wbz(1e-3, "soft"), "alpha = 'soft'"),
    (lambda: pi.problems.get("pendulum").errors(foo=1.0), "'foo' is not in the reference, which knows q, v, lam"),
    (lambda: pi.problems.get("pendulum").errors(q=[1.0]), r"q has shape \(1,\), the reference has \(2,\)"),
    (lambda: pi.problems.get("plate-chain", link=3), "has no option 'link'; its options are links, cells, seed"),
    (lambda: pi.problems.get("slider-crank", level="soft"), "level 'soft' is unknown; known: full, reduced, rigid; its options are level"),
    (lambda: pi.problems.get("plate-chain").compare(run()), "the run ends at t = 0.01 s, the reference is known at t = 1 s"),
    (
        lambda: pi.Clamp(pi.ground.at((0.3, 0.0)), plate().section("left"), name="root"),
        "Clamp 'root'.*where that is at rest, not at ground",
    ),
    (lambda: plate().section("left").d.turned("fast"), "neither a number in rad nor a profile"),
    (lambda: pi.compiled(3.0), "must be a function, or a subclass of polyida.Model, ForceElement or Body"),
    (lambda: pi.threads(10**6), "the cores that this process may use"),
    (lambda: scene(*[plate()] * 2), "board.*already"),
    (mounted_twice, "'x' would have to move, but it is made of one plate with 'y'"),
    (sprung, "SpringDamper 'spring': .*must return a number, not much"),
    (lambda: run().model.force(0.0, np.zeros(2), np.zeros(2)), "has shape"),
    (lambda: pi.equilibrium_path(run().model, load="drive"), "moves constraints"),
    (lambda: pi.equilibrium_path(run().model, load=lambda q: 0.0 * q), "the load is zero"),
    (lambda: pi.linearise(run().model, modes=pi.modes(free(), count=1)), "of another model"),
    (lambda: pi.linearise(free(), modes=pi.modes(free(), count=1, damped=True)), "modes with damping are complex"),
    (lambda: pi.linearise(run().model, outputs=("tip", "reaction")), "no joint is called 'tip'; known: 'hinge', 'drive'"),
    (lambda: pi.modes(held(), pi.consistent_state(held(), q0=[0.0, -1.0])), "cannot move"),
    (lambda: pi.modes(loose(), count=1), "needs mass"),
    (lambda: standing().plot(number=3), "number = 3"),
    (lambda: standing().plot(scale=0.0), "scale = 0.0"),
    (lambda: own(force=pi.Model.force), r"Own: its class gives no force\(t, q, v\)"),
    (lambda: own(mass=pi.Model.mass), r"Own: its class gives no mass\(q\)"),
    (lambda: swing(q0=[-1.0, np.nan]), r"q0\[1\] = nan: q0 must be 2 finite numbers"),
    (lambda: swing(v0=["a", 0.0]), r"v0\[0\] = 'a': v0 must be 2 finite numbers"),
    (lambda: swing(q0=[[1.0], [2.0, 3.0]]), r"q0\[0\] = \[1.0\]: q0 must be"),
    (lambda: swing(every=2, output=[0.05]), "every = 2 and output are given; output has the times of all frames"),
    (lambda: swing(q0="rest"), "q0 = 'rest': q0 must be"),
    (lambda: pi.IDA(rtol=1e-17), "rtol 1e-17 must lie between 8.9e-16, which double precision resolves, and 1"),
    (lambda: pi.RadauIIA(rtol=1e-30), "RadauIIA: rtol = 1e-30 must be between 8.9e-16, which double precision resolves, and 1"),
    (lambda: own().plot.deformed(), "is no scene's model"),
    (lambda: own(kinks=named_kinks), "Own.kinks must return finite times"),
    (lambda: own(momenta=lambda self, q, v: 1.0).momentum, "Own.momenta must return three"),
    (lambda: own(powers=lambda self, t, q, v, lam: [1.0], dissipating=()).energy.work, "Own.powers must return"),
    (lambda: own().model.attachment("tip"), "Own has no named points"),
    (lambda: own().reaction("tip"), "no joint is called 'tip'"),
    (lambda: own().plot.reactions(), "has no joints"),
    (lambda: own().position("tip"), "is no scene's model|has no named points"),
    (lambda: pi.solve(Own(), 0.01, SimpleNamespace(steps=3), q0=[-1.0, 0.0]), "steps = 3 of SimpleNamespace must be a function"),
    (lambda: pi.solve(run().model, 1e17, IDA), "16 s apart"),
    (lambda: swing(precision="half"), "precision = 'half' must be one of double, single"),
    (lambda: run().save("run.h5", overwrite="no"), "overwrite = 'no' must be True or False"),
    (lambda: pi.export.vtu(run(), "frames", overwrite="no"), "overwrite = 'no' must be True or False"),
    (lambda: pi.export.vtu(run(), __file__, overwrite=True), "is a file"),
    (lambda: pi.export.vtu(welded(), "frames"), "no body of the scene has a mesh"),
    (lambda: plates.spread(run(), 0), "frames = 0"),
    (lambda: animation(run(), "run.avi"), "only .gif, .mp4, .svg, .html can be written"),
    (lambda: MESH.cell(99), r"mesh.cell: i = 99 must be a whole number; there are 20 cells"),
    (lambda: polygonize(Rectangle(1.0, 1.0, (1e9, 0.0)), 10), "move the plate by its origin="),
    (lambda: Intersection(Circle(1.0), Circle(1.0, (5, 5))), "their bounding boxes do not overlap"),
    (lambda: polygonize(Circle(1.0) - Circle(2.0), 50), "domain is empty"),
    (lambda: polygonize(Rectangle(2, 1) - Circle(0.02, (1, 0.5)), 10), "too few"),
    (lambda: pi.mesh.from_lists(MESH.points, [[0, 0, 0]]), "no cell has three different corners"),
    (lambda: pi.mesh.from_lists(MESH.points, [MESH.cell(0)], loads={int(MESH.cell(9)[0]): (1.0, 2.0)}), "which is no corner of a cell"),
    (lambda: precision(3, 1.0), "the model is int; a Model, a Scene, a Problem or the name of one"),
    (lambda: precision("pendulum", -1.0), "t_end = -1.0 must be a positive time"),
    (lambda: precision(integrators=None), "integrators = None must be a dictionary"),
    (lambda: precision(integrators={"alpha": []}), r"integrators\['alpha'\] = \[\] must be one or more integrators"),
    (lambda: precision(repeats=0), "repeats = 0 must be a whole number of at least 1"),
    (lambda: precision(reference={"q": [1.0]}), r"reference\['q'\] must be 2 finite numbers"),
    (lambda: precision(reference=digits(known_to={"q": "little"})), r"reference\['known_to'\]\['q'\]"),
    (lambda: precision(reference=swing()), "the reference ends at"),
    (lambda: precision(reference=digits()).plot("a"), "must be one of"),
    (lambda: step_sizes(h=(0.0,)), "h = .* must be positive steps"),
    (lambda: step_sizes(h=(0.005, 0.02)), "h = 0.02 s must not be longer than the run, t_end = 0.01 s"),
    (lambda: step_sizes(integrators={"own": IDA}), "must be a class or a function of h"),
    (lambda: step_sizes(integrators={"IDA": pi.IDA}), "IDA makes no integrator of a step h: the class takes no h"),
    (lambda: pi.study.energy("pendulum", 0.01, integrators={"alpha": [ALPHA] * 2}), "one integrator"),
    (lambda: compare(load("double-plate", cells=8, time=0.01), integrators=3), "integrators = 3 must be a dictionary"),
    (lambda: compare(load("double-plate", cells=8, time=0.01), integrators={"a/b": IDA}), "label 'a/b' must be the name of a file"),
    (lambda: pi.study.Result([{"number": 7}]).report(None), "folder = None must be the path"),
    (lambda: pi.study.Result([{"number": 7}]).report(Path(__file__) / "below"), "cannot be made: Not a directory"),
]


@pytest.mark.parametrize("make, told", MORE, ids=[told for _, told in MORE])
def test_message_tells_what_is_wrong(make, told):
    with pytest.raises(ValueError, match=told):
        make()


@pytest.mark.parametrize("linear", [False, True])
def test_static_names_the_body_that_nothing_holds(linear):
    with pytest.raises(pi.StepFailure, match="^'bar': the structure can move freely"):
        pi.static(loose_body(), linear=linear)


@pytest.mark.parametrize("content", [None, b"", b"garbage", b"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n"])
def test_unreadable_mesh(tmp_path, content):
    path = tmp_path / "part.msh"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(pi.InputError, match="part.msh"):
        pi.mesh.read(path)


def test_input_errors_are_value_errors():
    assert issubclass(pi.InputError, ValueError)


NAMED = {  # function of a name
    "points": lambda name: pi.RigidBody(1.0, 1.0, {name: (0.0, 0.0)}, name="crank"),
    "name of a body": lambda name: pi.RigidBody.bar(1.0, 1.0, name=name),
    "name of a plate": plate,
    "name of a mass": lambda name: pi.PointMass(plate().section("left"), 1.0, name=name),
    "name of a joint": lambda name: hinge(plate(), name),
    "name of a force": lambda name: pi.Torque(plate().section("left"), 1.0, name=name),
    "name of an event": lambda name: pi.Event(lambda s: s.t - 0.01, name=name),
    "sensors": lambda name: swing(sensors={name: lambda t, q, v: t}),
    "label of a study": lambda name: precision(integrators={name: [ALPHA]}),
    "label of a comparison": lambda name: compare(load("double-plate", cells=8, time=0.01), integrators={name: IDA}),
}


@pytest.mark.parametrize("what", NAMED)
@pytest.mark.parametrize("name", ["", 1], ids=repr)
def test_a_name_is_a_text_that_is_not_empty(what, name):
    with pytest.raises(pi.InputError) as refused:
        NAMED[what](name)
    assert repr(name) in str(refused.value)
