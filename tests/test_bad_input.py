"""Wrong input is answered before any run, by a message that names the part and the value."""

import numpy as np
import pytest

import polyida as pi

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
    "negative modulus": (lambda: pi.Material(-5.0, 0.3, 1.0), "Material", "E = -5.0"),
    "zero modulus": (lambda: pi.Material(0, 0.3, 1.0), "Material", "E = 0"),
    "modulus as text": (lambda: pi.Material("soft", 0.3, 1.0), "Material", "'soft'"),
    "nu 0.5": (lambda: pi.Material(1.0, 0.5, 1.0), "Material", "nu = 0.5", "(-1, 0.5)"),
    "nu -1": (lambda: pi.Material(1.0, -1.0, 1.0), "Material", "nu = -1.0"),
    "nu nan": (lambda: pi.Material(1.0, float("nan"), 1.0), "Material", "nu = nan"),
    "zero density": (lambda: pi.Material(1.0, 0.3, 0.0), "Material", "rho = 0.0"),
    "plane": (lambda: pi.Material(1.0, 0.3, 1.0, "both"), "Material", "'both'", "stress"),
    "zero thickness": (lambda: plate(thickness=0.0), "board", "thickness = 0.0"),
    "thickness as text": (lambda: plate(thickness="thin"), "board", "'thin'"),
    "no mesh": (lambda: plate(mesh="plate.msh"), "board", "str"),
    "no material": (lambda: plate(material=50e6), "board", "50000000.0"),
    "origin": (lambda: plate(origin=(0.0, 0.0, 0.0)), "board", "(0.0, 0.0, 0.0)"),
    "angle": (lambda: plate(angle=np.inf), "board", "angle = inf"),
    "element": (lambda: plate(element="magic"), "board", "'magic'", "wachspress"),
    "non-convex cell": (lambda: plate(mesh=polygon([[0, 0], [1, 0], [0.2, 0.2], [0, 1]])), "board", "cell 0", "convex"),
    "clockwise cell": (lambda: polygon([[0, 0], [0, 1], [1, 1], [1, 0]]), "cell 0", "area -1", "counter-clockwise"),
    "no such section": (lambda: plate().section("lid"), "board", "'lid'", "'left'"),
    "function selects no node": (lambda: plate().section(lambda points: points[:, 0] > 7.0), "board", "no boundary node"),
    "function of no mask": (lambda: plate().section(lambda points: points[:, 0]), "board", "mask"),
    "no indices": (lambda: plate().section([]), "board", "no node"),
    "index out of range": (lambda: plate().section([10**6]), "board", "1000000"),
    "no such node": (lambda: plate().node(10**6), "board", "1000000"),
    "no such place": (lambda: plate().node((0.0, np.nan)), "board", "nan"),
    "no hole": (lambda: plate().rim(0), "board", "hole 0"),
    "joint of no attachment": (lambda: pi.Revolute(pi.ground, "left", name="elbow"), "elbow", "'left'"),
    "joint of a plate": (lambda: pi.Revolute(pi.ground, plate(), name="elbow"), "elbow", "board"),
    "joint of ground alone": (lambda: pi.Revolute(pi.ground, pi.ground, name="elbow"), "elbow", "ground"),
    "joint within a body": (lambda: (lambda b: pi.Clamp(b.section("left"), b.section("right"), name="weld"))(plate()), "weld", "board"),
    "joint of a stranger": (of_a_stranger, "elbow", "stranger"),
    "joint apart": (apart, "elbow", "0.2 m", "(1.2, 0)"),
    "motor on a node": (lambda: pi.AngleMotor(pi.ground, plate().node(0), 0.0, name="drive"), "drive", "node 0"),
    "motor without angle": (lambda: pi.AngleMotor(pi.ground, plate().section("left"), "fast", name="drive"), "drive", "'fast'"),
    "weld on a node": (lambda: pi.Clamp(plate("a").node(0), plate("b").section("left"), name="weld"), "weld", "node 0"),
    "zero mass": (lambda: pi.PointMass(plate().section("left"), 0.0, name="tip"), "tip", "mass = 0.0"),
    "negative mass": (lambda: pi.PointMass(plate().section("left"), -1.0, name="tip"), "tip", "mass = -1.0"),
    "mass on nothing": (lambda: pi.PointMass(pi.ground, 1.0, name="tip"), "tip", "ground"),
    "force": (lambda: pi.PointLoad(plate().section("left"), (1.0,), name="push"), "push", "(1.0,)"),
    "load profile": (lambda: pi.PointLoad(plate().section("left"), (1.0, 0.0), "ramp", name="push"), "push", "'ramp'"),
    "load on a plate": (lambda: pi.PointLoad(plate(), (1.0, 0.0), name="push"), "push", "board"),
    "traction": (lambda: pi.EdgeTraction(plate().section("left"), (np.nan, 0.0), name="wind"), "wind", "nan"),
    "traction on a node": (lambda: pi.EdgeTraction(plate().node(0), (1.0, 0.0), name="wind"), "wind", "node 0"),
    "profile time": (lambda: pi.profile.quintic(0, 1, duration=0), "quintic", "duration 0"),
    "gravity": (lambda: pi.Scene(gravity=9.81), "gravity = 9.81"),
    "empty scene": (lambda: scene(), "no plate"),
    "two of one name": (lambda: scene(plate(), plate()), "'board'", "taken"),
    "redundant": (twice, "hinge", "again", "redundant"),
    "q0 off phi": (lambda: moved("q0", 0.1), "q0", "hinge x", "-0.1"),
    "v0 off phi": (lambda: moved("v0", 0.1), "v0", "hinge x", "-0.1"),
    "q0 of the wrong size": (lambda: swing(q0=[1.0, 2.0, 3.0]), "q0", "(3,)", "2 finite"),
    "v0 not finite": (lambda: swing(v0=[0.0, np.inf]), "v0", "finite"),
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
    "h zero": (lambda: pi.GeneralizedAlpha(h=0.0), "GeneralizedAlpha", "h = 0.0"),
    "h negative": (lambda: pi.GeneralizedAlpha(h=-1e-3), "GeneralizedAlpha", "h = -0.001"),
    "h nan": (lambda: pi.GeneralizedAlpha(h=float("nan")), "GeneralizedAlpha", "h = nan"),
    "h as text": (lambda: pi.GeneralizedAlpha(h="1e-3"), "GeneralizedAlpha", "'1e-3'"),
    "h true": (lambda: pi.GeneralizedAlpha(h=True), "GeneralizedAlpha", "h = True"),
    "rho_inf one": (lambda: pi.GeneralizedAlpha(h=1e-3, rho_inf=1.0), "GeneralizedAlpha", "rho_inf = 1.0", "[0, 1)"),
    "rho_inf negative": (lambda: pi.GeneralizedAlpha(h=1e-3, rho_inf=-0.1), "GeneralizedAlpha", "rho_inf = -0.1"),
    "scaling": (lambda: pi.GeneralizedAlpha(h=1e-3, scaling="full"), "GeneralizedAlpha", "'full'", "bottasso"),
    "tolerance": (lambda: pi.GeneralizedAlpha(h=1e-3, tolerance=0.0), "GeneralizedAlpha", "tolerance = 0.0"),
    "start": (lambda: pi.GeneralizedAlpha(h=1e-3, start="cold"), "GeneralizedAlpha", "'cold'"),
    "linear": (lambda: pi.GeneralizedAlpha(h=1e-3, linear="magic"), "GeneralizedAlpha", "'magic'"),
    "iterations": (lambda: pi.GeneralizedAlpha(h=1e-3, max_iterations=0), "GeneralizedAlpha", "max_iterations = 0"),
    "scene for a model": (lambda: pi.solve(pi.Scene(), 1.0, pi.GeneralizedAlpha(h=1e-3)), "Scene", "build()"),
    "no integrator": (lambda: pi.solve(pi.problems.get("pendulum").model, 1.0, "alpha"), "'alpha'", "GeneralizedAlpha"),
    "class for an integrator": (lambda: pi.solve(pi.problems.get("pendulum").model, 1.0, pi.GeneralizedAlpha), "GeneralizedAlpha"),
    "end before start": (lambda: swing(t0=1.0), "t_end = 0.1", "1.0"),
    "end not finite": (lambda: pi.solve(pi.problems.get("pendulum").model, np.inf, pi.GeneralizedAlpha(h=1e-3)), "t_end = inf"),
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
    "start as text": (lambda: swing(t0="now"), "t0", "'now'"),
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
    "every": (lambda: swing(every=0), "every = 0"),
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


@pytest.mark.parametrize("content", [None, b"", b"garbage", b"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n"])
def test_unreadable_mesh(tmp_path, content):
    path = tmp_path / "part.msh"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(pi.InputError, match="part.msh"):
        pi.mesh.read(path)


def test_input_errors_are_value_errors():
    assert issubclass(pi.InputError, ValueError)
