"""Bad values for every argument of every public function, class and method, and a good call of each of them.

A good call is made of `GOOD`, good values by the names of arguments, and of `CALLS`, what a callable takes besides. A public callable
with an argument that neither of them knows is named by `test_fuzz.py`.
"""

import inspect
import signal
import warnings
from contextlib import contextmanager
from fractions import Fraction
from functools import cache

import numpy as np
from sympy.physics.mechanics import LagrangesMethod, dynamicsymbols

import polyida as pi

MESH = pi.mesh.quads(1.0, 0.1, 4, 2)
MATERIAL = pi.Material(50e6, 0.3, 1100.0)
PLATE = pi.Plate(MESH, MATERIAL, 0.01, name="board")
BAR = pi.RigidBody.bar(1.0, 1.0, name="bar")
END = BAR.at("right")
PLACE = pi.ground.at((0.0, 0.0))
LINE = pi.ground.at((0.0, 0.0), (1.0, 0.0))
ALPHA = pi.GeneralizedAlpha(h=1e-3)


class NoArray:
    """An array that refuses to become one of numpy, as a tensor with a gradient does."""

    def __array__(self, *_, **__):
        raise RuntimeError("this array stays where it is")


CIRCLE: list = []
CIRCLE.append(CIRCLE)
BAD = {
    "nan": np.nan,
    "inf": np.inf,
    "1e308": 1e308,
    "5e-324": 5e-324,
    "-1": -1,
    "complex": 1j,
    "text": "no such thing",
    "None": None,
    "True": True,
    "ragged": [[1.0], [2.0, 3.0]],
    "empty": [],
    "0-d": np.array(1.0),
    "0-d nan": np.array(np.nan),
    "Fraction": Fraction(1, 3),
    "surrogate": "\ud800",
    "NUL": "a\0b",
    "long": "x" * 5000,
    "no array": NoArray(),
    "huge": 10**400,
    "2**62": 2**62,
    "list of nan": [np.nan, np.nan],
    "list of 1e308": [1e308, 1e308],
    "list of texts": ["a", "b"],
    "list of None": [None],
    "cube": np.zeros((2, 2, 2)),
    "circle": CIRCLE,
    "dict": {"a": 1},
    "object": object(),
}


@cache
def model():
    """A bar on a pin that falls."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    scene.add(BAR)
    scene.add(pi.Revolute(pi.ground, BAR.at("left"), name="pin"))
    scene.add(pi.PointMass(END, 0.1, name="load"))
    return scene.build()


def scene_of_a_bar():
    """A scene with a body."""
    scene = pi.Scene()
    scene.add(BAR)
    return scene


@cache
def plate_model():
    """A plate on a clamp."""
    scene = pi.Scene(gravity=(0.0, -1.0))
    scene.add(PLATE)
    scene.add(pi.Clamp(PLATE.section("left"), name="root"))
    scene.add(pi.PointMass(PLATE.section("right"), 0.1, name="tip"))
    return scene.build()


def line(slope):
    """Values of a line."""
    return slope * np.arange(1.0, 4.0)


@cache
def rotor():
    """A plate on a motor."""
    scene = pi.Scene()
    scene.add(PLATE)
    root = PLATE.section("left")
    scene.add(pi.Revolute(pi.ground.at(root.point), root, name="bearing"))
    scene.add(pi.AngleMotor(pi.ground, root, 0.0, name="motor"))
    return scene.build()


@cache
def run():
    """A short run of the bar."""
    return pi.solve(model(), 3e-3, ALPHA)


@cache
def plate_run():
    """A run of the plate that consists of two frames, made by hand."""
    built = plate_model()
    frames = np.zeros((3, 2, built.n))
    return pi.Trajectory(built, ALPHA, np.array([0.0, 1e-3]), *frames, np.zeros((2, built.m)))


def moved_run():
    """A run of the plate that bends by hand."""
    built = plate_model()
    q = np.linspace(0.0, 1e-3, 3 * built.n).reshape(3, built.n) ** 2
    return pi.Trajectory(built, ALPHA, np.array([0.0, 1e-3, 2e-3]), q, q, q, np.zeros((3, built.m)))


@cache
def reduced_run():
    """A run of the reduced plate in three frames, made by hand."""
    scene = pi.Scene()
    scene.add(pi.Reduced(PLATE, modes=1, name="board"))
    scene.add(pi.Clamp(scene.parts["board"].section("left"), name="root"))
    built = scene.build()
    q = np.linspace(0.0, 1e-3, 3 * built.n).reshape(3, built.n) ** 2
    return pi.Trajectory(built, ALPHA, np.array([0.0, 1e-3, 2e-3]), q, q, q, np.zeros((3, built.m)))


@cache
def state():
    """The plate at rest."""
    return pi.static(plate_model())


def saved():
    """A file of the run of the bar, in the current folder."""
    run().save("run.h5", overwrite=True)
    return "run.h5"


def mesh_file():
    """A file of the mesh, in the current folder."""
    return pi.mesh.write(MESH, "mesh.inp", overwrite=True)


def drawing():
    """A drawing of the mesh, in the current folder."""
    pi.mesh.write_outline(MESH, "drawing.svg", overwrite=True)
    return "drawing.svg"


def size(number):
    """A measure of a sweep."""
    return {"y": 2.0 * number}


def sweep():
    """A sweep of two cases."""
    return pi.study.sweep(size, [{"number": 1.0}, {"number": 2.0}])


def weight(model):
    """A run of a design: the plate at rest."""
    return pi.static(model)


def problem():
    """A design of one density for each cell of the plate."""
    return pi.design.Problem(
        pi.objective.Compliance(), [], [pi.design.Densities("board", radius=0.05)], pi.design.Case(plate_model(), weight)
    )


GOOD = {  # what an argument without a default is, by its name: functions are called
    "mesh": MESH,
    "material": MATERIAL,
    "model": model,
    "run": run,
    "state": state,
    "integrator": ALPHA,
    "at": END,
    "a": PLACE,
    "b": END,
    "path": saved,
    "t_end": 2e-3,
    "rho": 0.5,
    "objective": pi.objective.Deviation("load", (0.0, 0.0)),
    "frame": 0,
    "plate": PLATE,
    "joint": "pin",
    "name": "bar",
    "of": "load",
    "x": None,
    "y": None,
    "cells": 4,
    "first": pi.mesh.Circle(1.0),
    "second": pi.mesh.Circle(2.0),
    "variables": [],
    "folder": "folder",
    "points": MESH.points,
    "selector": "left",
}
GOOD |= dict.fromkeys(
    ("thickness", "mass", "inertia", "length", "height", "stiffness", "damping", "radius", "k", "L", "R", "kp", "volts", "moment", "gap"),
    1.0,
)
GOOD |= dict.fromkeys(("start", "end", "duration", "amplitude", "frequency", "value", "factor", "beta", "E", "pin_radius", "upper"), 1.0)
GOOD |= dict.fromkeys(("h", "nu", "lower", "aim"), 1e-3)
GOOD |= dict.fromkeys(("nx", "ny"), 2)
GOOD |= dict.fromkeys(("force", "traction", "impulse"), (1.0, 0.0))

PLATES = {"model": plate_model}
ANGLE = dynamicsymbols("angle")
CALLS = {  # what else a good call takes
    "RigidBody": {"points": {"left": (0.0, 0.0)}},
    "AngleMotor": {"angle": 0.0},
    "Clamp": {"a": END},
    "PrescribedPosition": {"x": 0.0, "y": 0.0},
    "RollingDisc": {"a": LINE, "radius": 0.1},
    "Contact": {"a": END, "b": LINE},
    "Clearance": {"gap": 1e-3},
    "EdgeTraction": {"at": lambda: PLATE.section("right")},
    "Force": {"force": (1.0, 0.0)},
    "compiled": {"given": lambda: size},
    "LinearController": {"A": np.zeros((1, 1)), "B": np.ones((1, 1)), "C": np.ones((1, 1)), "D": np.ones((1, 1))},
    "cross": {name: lambda: END.d for name in "ab"},
    "dot": {name: lambda: END.d for name in "ab"},
    "Remove": {"parts": ("pin",)},
    "RigidBody.edges": {"names": ("left", "right")},
    "SceneModel.with_factors": {"factors": {"board": (np.ones(8), None)}},
    "RowLaw": {"row": 0},
    "Events.index": {"value": 0},
    "Event": {"when": lambda: len},
    "Impulse": {"at": END},
    "pod_modes": {"run": moved_run, "name": "board", "count": 1},
    "missing_fields": {"run": reduced_run, "name": "board", "count": 1},
    "von_mises": {"stress": [1.0, 0.0, 0.0]},
    "condition_number": PLATES,
    "fit": {"function": lambda: line, "measured": [1.0, 2.0, 3.0], "start": {"slope": 1.0}},
    "modes": PLATES,
    "buckling": PLATES,
    "steady": {"model": rotor, "spin": 1.0},
    "Steady.campbell": {"speeds": [0.0, 1.0], "count": 1},
    "linearise": PLATES | {"modes": 1},
    "frequency_response": PLATES
    | {"input": lambda: np.ones(plate_model().n), "output": lambda: np.ones(plate_model().n), "frequencies": [1.0]},
    "static": PLATES,
    "equilibrium_path": PLATES | {"count": 2},
    "State": {"t": 0.0} | {name: lambda: np.zeros(2) for name in ("q", "v", "a", "lam")},
    "resume": {"t_end": 4e-3},
    "mesh.Link": {"height": 0.2, "pin_radius": 0.02},
    "mesh.Outline": {"points": [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]},
    "mesh.PolygonMesh": {"nodes": MESH.nodes, "offsets": MESH.offsets},
    "mesh.RawMesh": {"cells": [MESH.cell(i) for i in range(8)]},
    "mesh.from_lists": {"cells": [MESH.cell(i) for i in range(8)]},
    "mesh.polygonize": {"domain": pi.mesh.Rectangle(1.0, 1.0)},
    "mesh.read": {"path": mesh_file},
    "mesh.read_outline": {"path": drawing},
    "mesh.svg_path": {"path": "M 0 0 h 1 v 1 z", "unit": "m"},
    "mesh.write": {"path": "a.inp", "overwrite": True},
    "mesh.write_outline": {"path": "a.svg", "overwrite": True},
    "mesh.refine": {"cells": [0]},
    "design.Case": PLATES | {"run": lambda: weight},
    "design.Densities": {"plate": "board"},
    "design.Size": {"name": "tip.mass", "upper": 1.0},
    "design.Problem": {
        "limits": [],
        "variables": lambda: [pi.design.Densities("board", 0.05)],
        "cases": lambda: pi.design.Case(plate_model(), weight),
    },
    "design.minimise": {
        "objective": pi.objective.Compliance(),
        "limits": [],
        "variables": lambda: [pi.design.Densities("board", 0.05)],
        "cases": lambda: pi.design.Case(plate_model(), weight),
        "stages": lambda: [pi.design.Stage(1)],
    },
    "design.threshold": {"rho": np.ones(8)},
    "profile.Profile": {"value": lambda: float, "d1": lambda: float, "d2": lambda: float},
    "profile.difference": dict.fromkeys(("first", "second"), pi.profile.constant(1.0)),
    "profile.from_function": {"value": lambda: abs},
    "profile.from_samples": {"t": [0.0, 1.0, 2.0], "y": [0.0, 1.0, 1.0]},
    "profile.scaled": {"profile": pi.profile.constant(1.0)},
    "profile.polynomial": {"coefficients": [1.0]},
    "sensor.state": {"function": lambda: abs},
    "objective.Deviation": {"point": "load", "path": (1.0, 0.0)},
    "objective.UserObjective": {"value": lambda: float, "slopes": lambda: dict},
    "registry.find": {"book": pi.registry.problems, "name": "pendulum"},
    "registry.name_of": {"kind": pi.Revolute},
    "problems.get": {"name": "pendulum"},
    "study.work_precision": {"t_end": 2e-3, "integrators": {"alpha": ALPHA}},
    "study.step_sizes": {"t_end": 2e-3, "integrators": {"alpha": lambda h: pi.GeneralizedAlpha(h=h)}, "h": [1e-3]},
    "study.conditioning": PLATES | {"states": state, "integrators": {"alpha": ALPHA}, "h": [1e-3]},
    "study.energy": {"t_end": 2e-3, "integrators": {"alpha": ALPHA}},
    "study.drift": {"t_end": 2e-3, "integrators": {"alpha": ALPHA}},
    "study.sweep": {"function": lambda: size, "cases": [{"number": 1.0}]},
    "study.Result": {"rows": [{"a": 1.0}]},
    "study.Study": {"name": "mine", "title": "Mine", "tasks": lambda: list, "run": lambda: dict, "figures": lambda: dict},
    "show.RunPlots": {},
    "symbolic.lagrangian": {"L": ANGLE.diff() ** 2 / 2 - ANGLE**2, "q": [ANGLE], "compiled": False},
    "symbolic.equations": {"M": [[2.0]], "g": [3 * ANGLE], "q": [ANGLE], "compiled": False},
    "symbolic.mechanics": {"method": lambda: LagrangesMethod(ANGLE.diff() ** 2 / 2 - ANGLE**2, [ANGLE]), "compiled": False},
    "show.animation": {"path": "a.gif", "frames": 2, "overwrite": True},
    "show.Animation": {},
    "Animation.save": {"path": "a.gif", "frames": 2, "overwrite": True},
    "show.save": {"figure": lambda: pi.show.figure()[0], "path": "a.png"},
    "export.vtu": {"overwrite": True, "run": plate_run},
    "Plate.node": {"where": 0},
    "Rigid.node": {"where": 0},
    "Reduced.node": {"where": 0},
    "Plate.rim": {"hole": "left"},
    "Rigid.rim": {"hole": "left"},
    "Reduced.rim": {"hole": "left"},
    "Rigid.at": {"name": "center"},
    "Reduced.at": {"name": "center"},
    "RigidBody.point_of": {"weights": [1.0, 0.0]},
    "Rigid.point_of": {"weights": [1.0, 0.0]},
    "Reduced.point_of": {"weights": lambda: [1.0, *np.zeros(3)]},
    "RigidBody.at": {"name": "right"},
    "Trajectory.position": {"name": "tip"},
    "Trajectory.wrench": {"name": "root"},
    "Trajectory.unique": {"name": "root"},
    "Trajectory.save": {"path": "saved.h5", "overwrite": True},
    "Trajectory.reaction": {"name": "root"},
    "Trajectory.section_forces": {"plate": "board", "at": (0.5, 0.0)},
    "StateSpace.displacements": {"x": [0.0, 0.0]},
    "StateSpace.response": {"frequencies": [1.0]},
    "EquilibriumPath.position": {"name": "tip"},
    "Scene.add": {"part": PLATE},
    "PolygonMesh.cell": {"i": 0},
    "Profile.at": {"t": 0.0},
    "Profile.over": {"t": np.zeros(1)},
    "Densities.bound": PLATES,
    "Problem.evaluate": {"x": np.full(8, 0.5)},
    "Problem.setting": {"x": np.full(8, 0.5)},
    "Problem.values": {"x": np.full(8, 0.5)},
    "Size.rate": {"x": 0.5},
    "Size.value": {"x": 0.5},
    "Modes.title": {"number": 0},
    "Buckling.title": {"number": 0},
    "Domain.distance": {"points": MESH.points},
    "Result.report": {"folder": "report", "overwrite": True},
    "Result.to_latex": {"columns": ["number"]},
}

INSTANCES = {  # an object of each class whose methods users call
    "Plate": PLATE,
    "RigidBody": BAR,
    "Rigid": pi.Rigid(PLATE),
    "Reduced": pi.Reduced(PLATE, modes=2),
    "Material": MATERIAL,
    "Scene": scene_of_a_bar,
    "SceneModel": plate_model,
    "Trajectory": plate_run,
    "Modes": lambda: pi.modes(plate_model(), count=2),
    "Buckling": lambda: pi.buckling(plate_model(), count=1),
    "Fit": lambda: pi.fit(line, [1.0, 2.0, 3.1], {"slope": 1.0}),
    "Steady": lambda: pi.steady(rotor(), spin=1.0),
    "Campbell": lambda: pi.steady(rotor(), spin=1.0).campbell([0.0, 1.0], count=1),
    "StateSpace": lambda: pi.linearise(plate_model(), modes=1),
    "FrequencyResponse": lambda: pi.frequency_response(
        plate_model(), None, np.ones(plate_model().n), np.ones(plate_model().n), [1.0, 2.0], modes=1
    ),
    "ErrorBars": lambda: pi.error_of(run(), pi.objective.Deviation("load", (0.0, 0.0))),
    "EquilibriumPath": lambda: pi.equilibrium_path(plate_model(), count=2),
    "Event": lambda: pi.Event(len),
    "Events": lambda: run().events,
    "PolygonMesh": MESH,
    "Domain": pi.mesh.Circle(1.0),
    "Profile": pi.profile.constant(1.0),
    "Size": pi.design.Size("tip.mass", 0.1, 1.0),
    "Densities": pi.design.Densities("board", 0.05),
    "Problem": problem,
    "Limit": pi.objective.Limit(pi.objective.Compliance(), 1.0),
    "Objective": pi.objective.StrainEnergy(),
    "Result": sweep,
    "Sweep": sweep,
    "RunPlots": lambda: pi.show.RunPlots(plate_run()),
    "Animation": lambda: pi.show.Animation(plate_run()),
    "Gradient": lambda: pi.gradient(run(), pi.objective.Deviation("load", (0.0, 0.0))),
}

NOT_CALLED = {  # handed out, made in every step, or to be derived from
    *("Model", "Integrator", "Joint", "ForceElement", "Controller", "Body", "StepMatrix", "objective.Objective", "mesh.Domain"),
    *(
        "Trajectory",
        "Events",
        "Counts",
        "Needs",
        "Modes",
        "Buckling",
        "Fit",
        "Steady",
        "Campbell",
        "StateSpace",
        "FrequencyResponse",
        "ErrorBars",
        "EquilibriumPath",
        "Gradient",
    ),
    *("objective.Slopes", "study.Sweep", "design.Design", "design.Evaluation", "design.SolidDesign", "problems.Problem"),
    *("mesh.MeshQuality", "mesh.Section", "mesh.Format"),
    "threads",  # of the whole process
    "RunPlots.expressions",  # of models of sympy
    "Events.index",  # of every sequence: it raises for what is not there
    "Profile.at",  # in every step
    "ErrorBars.plot_cells",  # takes estimates of the mesh
    *("Rigid.edges", "Reduced.edges"),  # a plate has one named point
    "design.solid",  # takes a design that minimise found
}
BY_USERS = {"at", "edges", "node", "rim", "section", "with_factors"}
BY_POLYIDA = {  # methods that polyida calls, with values of its own: those of the classes to be derived from, and these
    name
    for kind in (pi.Model, pi.Body, pi.Joint, pi.ForceElement, pi.Controller, pi.Integrator, pi.objective.Objective, pi.mesh.Domain)
    for name in dir(kind)
    if name not in BY_USERS and not name.startswith("_")
} | {
    "over",
    "write",
    "page",
    "pictures",
    "report_pictures",
    "report_tables",
    "assemble",
    "require_sides",
    "pieces",
    "modes",
    "summary_of_laws",
    "known_model",
    "angle",
    "from_data",
}
SLOW = ("report", "minimise", "animation", "work_precision", "step_sizes", "conditioning", "energy", "drift", "error_of", "check_gradient")
FEW = ("nan", "-1", "text", "ragged", "surrogate", "long", "no array", "cube")  # values for what takes long where it accepts them
TOO_LONG = 300  # s: it hangs


def callables(module=pi, before=""):
    """{name: function or class} of the public names of a module and its modules."""
    found = {}
    for name in module.__all__:
        value = getattr(module, name)
        if inspect.ismodule(value):
            found |= callables(value, f"{before}{name}.")
        elif callable(value) and not (inspect.isclass(value) and issubclass(value, BaseException)):
            found[before + name] = value
    return {name: value for name, value in found.items() if name not in NOT_CALLED}


def methods():
    """{class.method: how to get it} of the methods that users call."""
    found = {}
    for kind, instance in INSTANCES.items():
        for name, value in inspect.getmembers_static(classes()[kind]):
            is_method = inspect.isfunction(value) or isinstance(value, (classmethod, staticmethod))
            if (
                is_method
                and f"{kind}.{name}" not in NOT_CALLED
                and not name.startswith("_")
                and name not in BY_POLYIDA
                and (kind != "SceneModel" or name in BY_USERS)
            ):
                found[f"{kind}.{name}"] = instance
    return found


@cache
def classes():
    """{name: class} of the public classes, and of models of scenes."""
    found, modules = {"SceneModel": type(plate_model())}, [pi]
    while modules:
        module = modules.pop()
        for name in module.__all__:
            value = getattr(module, name)
            if inspect.ismodule(value):
                modules.append(value)
            elif inspect.isclass(value):
                found[name] = value
    return found


def made(value):
    """The value, or what it makes: functions, and classes without a call in sight, are called."""
    return value() if inspect.isfunction(value) or hasattr(value, "cache_info") or value is pi.Scene else value


def function_of(name):
    """The function, class or bound method of a name."""
    known = callables()
    if name in known:
        return known[name]
    kind, _, method = name.rpartition(".")
    return getattr(made(INSTANCES[kind]), method)


def good_call(name, function):
    """{argument: good value}. Raises LookupError for an argument that has none."""
    given, values = CALLS.get(name, {}), {}
    for key, parameter in inspect.signature(function).parameters.items():
        if key in given:
            values[key] = made(given[key])
        elif parameter.default is parameter.empty and parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            if key not in GOOD:
                raise LookupError(f"{name}: no good value of {key!r} is known; give one in CALLS")
            values[key] = made(GOOD[key])
    return values


def call(function, values):
    """Call a function with {argument: value}; those of *arguments and **keywords are a tuple and a dictionary."""
    values, parameters = dict(values), inspect.signature(function).parameters.values()
    several = [p.name for p in parameters if p.kind == p.VAR_POSITIONAL and p.name in values]
    named = [p.name for p in parameters if p.kind == p.VAR_KEYWORD and p.name in values]
    positional = [value for name in several for value in values.pop(name)]
    keywords = {key: value for name in named for key, value in values.pop(name).items()}
    return function(*positional, **values, **keywords)


def changes(name, function, good):
    """(argument, name of the bad value, {argument: value}) of each call with one bad value."""
    bad = {key: BAD[key] for key in FEW} if name.rpartition(".")[2] in SLOW else BAD
    for key, parameter in inspect.signature(function).parameters.items():
        for label, value in bad.items():
            if parameter.kind == parameter.VAR_POSITIONAL:
                value = (value,)
            elif parameter.kind == parameter.VAR_KEYWORD:
                value = {name: value for name in good.get(key, ())}
            yield key, label, good | {key: value}


class Hangs(BaseException):
    """A call that does not end."""


@contextmanager
def limited():
    """Context in which a warning of numpy is an error, and in which a call that hangs is stopped."""

    def stop(*_):
        raise Hangs

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(TOO_LONG)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            warnings.filterwarnings("error", "(overflow|invalid value|divide by zero) encountered", RuntimeWarning)
            yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def is_nan(result, depth=3):
    """True if numbers of a result are nan; of a run, if it says that it is done."""
    if isinstance(result, pi.Trajectory):
        return result.success and not np.isfinite(result.q).all()
    if isinstance(result, (float, complex)):
        return result != result
    if isinstance(result, np.ndarray):
        return result.dtype.kind in "fc" and bool(np.isnan(result).any())
    entries = result.values() if isinstance(result, dict) else result if isinstance(result, (list, tuple)) else ()
    return depth > 0 and any(is_nan(entry, depth - 1) for entry in entries)


def answer(function, values):
    """None for a result without nan, an InputError, or a StepFailure that the function promises; else what came instead."""
    try:
        with limited():
            return "nan" if is_nan(call(function, values)) else None
    except pi.InputError:
        return None
    except pi.StepFailure as failure:
        return None if "StepFailure" in (function.__doc__ or "") else f"StepFailure: {failure}"
    except (Exception, Hangs) as error:  # noqa: BLE001, what else may come is what is looked for
        return f"{type(error).__name__}: {str(error)[:120]}"
