"""Whatever is wrong in what a user gives, the answer is an InputError of one line that names it, and nothing from inside numpy or numba."""

import re
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

import polyida as pi
from polyida.integrate.state import State
from polyida.problems import plates

MATERIAL = pi.Material(50e6, 0.3, 1100.0)
MESH = pi.mesh.quads(1.0, 0.1, 4, 2)
BOARD = pi.Plate(MESH, MATERIAL, 0.01, name="board")
OTHER = pi.Plate(MESH, MATERIAL, 0.01, origin=(1.0, 0.0), name="other")
PLACE = pi.ground.at((0.0, 0.0))
LEFT, RIGHT, NEXT = BOARD.section("left"), BOARD.section("right"), OTHER.section("left")
ALPHA = pi.GeneralizedAlpha(h=1e-3)
MODEL = pi.problems.get("pendulum").model
REST = {"q0": [-1.0, 0.0]}


class Odd:
    """Something that is nothing of use."""

    def __repr__(self):
        return "an odd thing"


NOTHING = [
    None,
    "text",
    "",
    b"bytes",
    Odd(),
    {},
    {"a": 1},
    1j,
    float("nan"),
    float("inf"),
    -float("inf"),
    lambda *_: None,
    Odd,
    len,
    [[1.0], [2.0, 3.0]],
    np.array(["a"]),
    np.array([None, 1]),
    10**400,
    [10**400],
    range(0),
    Ellipsis,
    slice(3),
]
LISTS = [
    [],
    [1.0],
    [1.0, 2.0, 3.0],
    np.zeros((2, 2)),
    np.zeros(0),
    [[1.0, 2.0]],
    [np.nan, 0.0],
    (np.inf, 1.0),
    ["1", "b"],
    [None, None],
    [1j, 0.0],
    "ab",
]
SCALARS = [True, Fraction(-1, 2), np.float32("nan"), np.array(2.0) * np.nan, np.datetime64("2020-01-01")]


def without(values, *kinds):
    return [value for value in values if not isinstance(value, kinds)]


POSITIVE = NOTHING + LISTS + SCALARS + [0, 0.0, -1.0, -0.0, -5]
NUMBER = NOTHING + LISTS + SCALARS[2:]
SHARE = POSITIVE + [1.0, 2.0, 1e300]
COUNT = POSITIVE + [0.5, 1.5, 2.0, np.float64(3.0), "3"]
PAIR = NOTHING + LISTS + SCALARS + [1.0]
DENSITY = without(NOTHING, range) + [[0.5, 1.5], [-0.1], [np.nan], ["a"], [None], [1j]]
TEXT = without(NOTHING[2:] + LISTS, str) + [""] + SCALARS + [1.0]
CHOICE = NOTHING + LISTS + SCALARS + [1.0, "Stress", "no such thing"]
PROFILE = (
    [value for value in NOTHING if not callable(value)]
    + LISTS
    + SCALARS[2:]
    + [lambda t: None, lambda t: "a", lambda t: [t], lambda t: np.inf]
)
PART = NOTHING + LISTS + SCALARS + [BOARD, MESH, MATERIAL, 1.0, pi.Plate]
SIDE = PART
MESHES = NOTHING + LISTS + SCALARS + ["plate.msh", BOARD, MESH.points]
FILE = ["", "nowhere/at/all.h5", ".", "/", "a\0b", None, 1.0, Odd(), [], {}, "x" * 5000, "no such file.h5", b"\xff"]
ARRAY = [value for value in NOTHING if value is not None] + [[], [1.0], np.zeros((2, 2)), [np.nan, 0.0], ["1", "b"], [1j, 0.0], "ab", 1.0]


def made(kind, **good):
    """A part with one argument to be changed."""
    return lambda **changed: kind(**(good | changed))


def made_scene(*parts, gravity=(0.0, 0.0)):
    scene = pi.Scene(gravity)
    for part in (BOARD, *parts):
        scene.add(part)
    return scene


def build(*parts, gravity=(0.0, 0.0)):
    return made_scene(*parts, gravity=gravity).build()


def run(**changed):
    return pi.solve(**({"model": MODEL, "t_end": 0.01, "integrator": ALPHA} | REST | changed))


def state(**changed):
    good = {"t": 0.0, "q": np.array([-1.0, 0.0]), "v": np.zeros(2), "a": np.zeros(2), "lam": np.zeros(1)}
    return pi.solve(MODEL, 0.01, ALPHA, state=State(**(good | changed)))


INDEX = NOTHING[1:] + [0.5, 1, -2, True, [0]]  # of a run with one frame
STANDING = pi.Trajectory(build(), "by hand", np.zeros(1), *np.zeros((3, 1, 2 * MESH.n_nodes)), np.zeros((1, 0)))

NO_TYPES, SOMETHING = without(NOTHING, type), without(NOTHING, type(None))
NO_FUNCTION = [value for value in NOTHING if not callable(value)]
NOT_NEGATIVE, LENGTH = NUMBER + [-1.0], NUMBER[:-1] + [0, -1.0]
MODELS, BODY_SIDE = NOTHING + LISTS + [BOARD, pi.Scene()], SIDE + [pi.ground]

GIVEN = {  # name: (function of keywords, {keywords: values that are wrong for each of them})
    "Material": (
        made(pi.Material, E=1.0, nu=0.3, rho=1.0),
        {
            "E rho": POSITIVE,
            "nu": NUMBER + [0.5, -1.0, 2.0, True],
            "plane": CHOICE,
            "viscosity": NUMBER + [-1.0, True],
            "mass_damping": NOT_NEGATIVE,
            "prony": [
                "fast",
                None,
                [0.5, 0.1],
                [(0.5, 0.1), (0.5, 1.0)],
                *([(g, tau)] for g, tau in ((0.0, 0.1), (-0.1, 0.1), (0.5, 0.0), (0.5, np.nan))),
            ],
        },
    ),
    "Plate": (
        made(pi.Plate, mesh=MESH, material=MATERIAL, thickness=0.01),
        {
            "mesh": MESHES,
            "material": PART[:-3] + [1.0, MESH],
            "thickness tau": POSITIVE,
            "origin velocity": PAIR,
            "angle spin": NUMBER + [True],
            "name": TEXT,
            "element": CHOICE,
        },
    ),
    "Plate.section": (
        BOARD.section,
        {"selector": NO_TYPES + without(LISTS, str)[3:] + [1.5, [1.5], [-1], [99], "middle", lambda p: p, lambda p: [True]]},
    ),
    "Plate.node": (BOARD.node, {"where": NOTHING + [[1.0], np.zeros((2, 2)), -1, 10**6, 1.5, (np.nan, 0.0)]}),
    "Plate.rim": (BOARD.rim, {"hole": NO_TYPES + LISTS + [-1, 7, 1.5]}),
    "Revolute": (made(pi.Revolute, a=pi.ground, b=LEFT), {"a": SIDE, "b": BODY_SIDE, "name": TEXT}),
    "Clamp": (made(pi.Clamp, a=LEFT), {"a": BODY_SIDE, "b": SIDE + [RIGHT, LEFT], "name": TEXT}),
    "AngleMotor": (
        made(pi.AngleMotor, a=pi.ground, b=LEFT, angle=0.0),
        {"a": SIDE, "b": SIDE + [BOARD.node(0)], "angle": PROFILE, "offset": without(NUMBER, type(None)) + [True], "name": TEXT},
    ),
    "Prismatic": (made(pi.Prismatic, a=PLACE, b=LEFT), {"a": SIDE, "b": SIDE + [BOARD.node(0)], "name": TEXT}),
    "Slot": (made(pi.Slot, a=PLACE, b=LEFT), {"a": SIDE + [BOARD.node(0)], "b": BODY_SIDE, "name": TEXT}),
    "Distance": (made(pi.Distance, a=PLACE, b=RIGHT), {"a b": BODY_SIDE, "length": without(POSITIVE, type(None)), "name": TEXT}),
    "Weld": (made(pi.Weld, a=RIGHT, b=NEXT), {"a": SIDE + [OTHER.node(0)], "b": SIDE + [LEFT, OTHER.node(0)], "name": TEXT}),
    "PrescribedPosition": (
        made(pi.PrescribedPosition, at=LEFT, x=0.0, y=None),
        {"at": BODY_SIDE, "x": PROFILE, "y": without(PROFILE, type(None)), "friction": NOT_NEGATIVE, "name": TEXT},
    ),
    "SpringDamper": (
        made(pi.SpringDamper, a=PLACE, b=RIGHT, stiffness=1.0),
        {
            "a b": BODY_SIDE,
            "stiffness": NUMBER + [-1.0, True],
            "damping": NOT_NEGATIVE,
            "length": without(NUMBER, type(None)) + [-1.0],
            "preload": NUMBER,
            "force": ["text", 1.0, [], Odd()],
            "name": TEXT,
        },
    ),
    "TorsionSpring": (
        made(pi.TorsionSpring, a=pi.ground, b=LEFT, stiffness=1.0),
        {"a": SIDE + [OTHER.node(0)], "b": SIDE + [BOARD.node(0)], "stiffness damping": NOT_NEGATIVE, "angle": NUMBER, "name": TEXT},
    ),
    "Torque": (
        made(pi.Torque, at=LEFT, moment=0.0),
        {"at": SIDE + [pi.ground, BOARD.node(0)], "moment": PROFILE, "against": without(SIDE, type(None)) + [RIGHT], "name": TEXT},
    ),
    "Force": (
        made(pi.Force, at=LEFT, force=(1.0, 0.0)),
        {"at": BODY_SIDE, "force": PAIR, "follower": NOTHING + LISTS + [1.0], "name": TEXT},
    ),
    "Force, follower": (made(pi.Force, force=(1.0, 0.0), follower=True), {"at": SIDE + [BOARD.node(0)]}),
    "PenaltyContact": (
        made(pi.PenaltyContact, a=RIGHT, b=PLACE, stiffness=1.0),
        {
            "a": SIDE + [pi.ground, PLACE],
            "b": SIDE + [pi.ground, OTHER.node(0), LEFT],
            "stiffness": POSITIVE,
            "damping": NOT_NEGATIVE,
            "exponent": NUMBER + [0.5],
            "radius": without(POSITIVE, type(None)),
            "name": TEXT,
        },
    ),
    "Contact": (
        made(pi.Contact, a=RIGHT, b=pi.ground.at((0.0, 0.0), (1.0, 0.0))),
        {
            "a": SIDE + [pi.ground, PLACE],
            "b": SIDE + [pi.ground, OTHER.node(0)],
            "restitution": NUMBER + [1.1, -0.1],
            "friction": NOT_NEGATIVE,
            "radius": without(POSITIVE, type(None)),
            "contact_mass": NUMBER + [0.0, 1.5],
            "name": TEXT,
        },
    ),
    "RollingDisc": (
        made(pi.RollingDisc, a=pi.ground.at((0.0, 0.0), (1.0, 0.0)), b=RIGHT, radius=1.0),
        {
            "a": SIDE + [pi.ground],
            "b": SIDE + [BOARD.node(0)],
            "radius": POSITIVE,
            "circle": without(NUMBER, type(None)) + [-1.0],
            "name": TEXT,
        },
    ),
    "Skate": (made(pi.Skate, at=RIGHT), {"at": SIDE + [pi.ground, BOARD.node(0)], "angle": PROFILE, "name": TEXT}),
    "PID": (
        made(pi.PID, at=RIGHT, kp=1.0),
        {"kp ki kd": NUMBER, "filter": NOT_NEGATIVE, "limit": POSITIVE, "target": PROFILE, "at": SIDE + [BOARD.node(0)], "name": TEXT},
    ),
    "DCMotor": (
        made(pi.DCMotor, at=RIGHT, volts=1.0, k=1.0, L=1.0, R=1.0),
        {"k gear": NUMBER, "L R": NOT_NEGATIVE, "volts": PROFILE, "at": SIDE + [BOARD.node(0)], "name": TEXT},
    ),
    "Maxwell": (
        made(pi.Maxwell, a=PLACE, b=RIGHT, stiffness=1.0, damping=1.0),
        {"a b": BODY_SIDE, "stiffness damping": POSITIVE, "length": without(NUMBER, type(None)) + [-1.0], "name": TEXT},
    ),
    "PointMass": (made(pi.PointMass, at=LEFT, mass=1.0), {"at": BODY_SIDE, "mass": POSITIVE, "name": TEXT}),
    "PointLoad": (made(pi.PointLoad, at=LEFT, force=(1.0, 0.0)), {"at": BODY_SIDE, "force": PAIR, "profile": PROFILE, "name": TEXT}),
    "EdgeTraction": (
        made(pi.EdgeTraction, at=LEFT, traction=(1.0, 0.0)),
        {"at": SIDE + [pi.ground, BOARD.node(0)], "traction": PAIR, "profile": PROFILE},
    ),
    "Scene": (pi.Scene, {"gravity": PAIR}),
    "Scene.build": (made_scene().build, {"redundant": CHOICE}),
    "Scene.add": (lambda part: pi.Scene().add(part), {"part": NOTHING + LISTS + SCALARS + [LEFT, MESH, pi.ground, pi.Plate, MATERIAL]}),
    "mesh.rectangle": (
        made(pi.mesh.rectangle, length=1.0, height=0.1, cells=4),
        {"length height": LENGTH, "cells iterations": COUNT, "seed": [-1, 0.5, None, "1", True], "origin": PAIR},
    ),
    "mesh.quads": (made(pi.mesh.quads, length=1.0, height=0.1, nx=2, ny=2), {"length": LENGTH, "nx ny": COUNT, "origin": PAIR}),
    "mesh.triangles": (made(pi.mesh.triangles, length=1.0, height=0.1, nx=2, ny=2), {"height": LENGTH, "nx ny": COUNT, "origin": PAIR}),
    "mesh.polygonize": (
        made(pi.mesh.polygonize, domain=pi.mesh.Rectangle(1.0, 1.0), cells=4),
        {"domain": NOTHING + LISTS + [MESH], "cells iterations": COUNT, "seed": [-1, 0.5, None, "1"]},
    ),
    "mesh.density_filter": (made(pi.mesh.density_filter, mesh=MESH, radius=0.1), {"mesh": MESHES, "radius": POSITIVE}),
    "design.ramp": (made(pi.design.ramp, rho=0.5), {"rho": DENSITY, "q": NUMBER + [-1.0, True], "void": NUMBER + [0, 1.0]}),
    "design.simp": (made(pi.design.simp, rho=0.5), {"rho": DENSITY, "p": NUMBER + [0.5, True], "void": NUMBER + [0, 1.0]}),
    "design.mass": (made(pi.design.mass, rho=0.5), {"rho": DENSITY, "low": NUMBER + [-0.1, 1.0], "void": NUMBER + [0, 1.0]}),
    "design.project": (made(pi.design.project, rho=0.5, beta=2.0), {"rho": DENSITY, "beta": POSITIVE, "eta": NUMBER + [0, 1.0]}),
    "design.threshold": (
        made(pi.design.threshold, mesh=MESH, rho=np.ones(8)),
        {
            "mesh": MESHES,
            "rho": NOTHING + LISTS + SCALARS + [np.zeros(8), np.ones(7)],
            "at": NUMBER + [2.0],
            "keep": without(NOTHING, range, dict) + [["left", "tip"], [None], {"a": 1}],
            "hanging": CHOICE,
        },
    ),
    "mesh.Rectangle": (made(pi.mesh.Rectangle, length=1.0, height=1.0), {"length": LENGTH, "height": NUMBER[:-1] + [0], "origin": PAIR}),
    "mesh.Circle": (made(pi.mesh.Circle, radius=1.0), {"radius": LENGTH, "center": PAIR}),
    "mesh.Link": (
        made(pi.mesh.Link, length=1.0, height=0.2, pin_radius=0.02),
        {"length": NUMBER[:-1] + [0], "height": NUMBER[:-1], "pin_radius": NUMBER[:-1] + [0.1, 5.0]},
    ),
    "mesh.Union": (made(pi.mesh.Union, first=pi.mesh.Circle(1.0), second=pi.mesh.Circle(2.0)), {"first second": NOTHING}),
    "mesh.Difference": (made(pi.mesh.Difference, first=pi.mesh.Circle(1.0), second=pi.mesh.Circle(2.0)), {"first second": NOTHING}),
    "PolygonMesh": (
        made(pi.mesh.PolygonMesh, points=MESH.points, nodes=MESH.nodes, offsets=MESH.offsets),
        {
            "points": NOTHING + LISTS + SCALARS,
            "nodes": NOTHING + LISTS + [MESH.nodes + 1000, -MESH.nodes, MESH.nodes[::-1]],
            "offsets": NOTHING + LISTS + [MESH.offsets[::-1], [0]],
            "sections": without(NOTHING[2:], dict) + LISTS[1:] + [{"left": [99]}, {"left": "a"}, {"left": [0.5]}, {"left": None}],
        },
    ),
    "mesh.Outline": (
        made(pi.mesh.Outline, points=[(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]),
        {
            "points": NOTHING + LISTS + SCALARS,
            "holes": without(NOTHING, dict, range) + SCALARS[:3],
            "corner": NUMBER[:-1] + [0, -1.0, 180.0],
        },
    ),
    "mesh.from_lists": (
        made(pi.mesh.from_lists, points=MESH.points, cells=[MESH.cell(i) for i in range(8)]),
        {
            "points": NOTHING + LISTS + SCALARS,
            "cells": NOTHING + LISTS + SCALARS + [[[0, 1, 99]], [[0, -1, 2]], [[0.5, 1, 2]], [["a", "b", "c"]]],
            "first": [-1, 2, 0.5, None, "1", True],
            "sections": without(NOTHING[2:], dict) + LISTS[1:] + [{"left": [99]}, {"left": "a"}, {"left": [0.5]}, {"left": None}],
            "supports": without(NOTHING[2:], dict) + LISTS[1:] + [{0: 1.0}, {99: (True, True)}, {0: ("a", 1)}],
            "loads": without(NOTHING[2:], dict) + LISTS[1:] + [{0: 1.0}, {99: (1.0, 1.0)}, {0: ("a", 1)}, {0: (np.nan, 1.0)}],
            "unit": NUMBER[1:-1] + [0, -1.0, "inch"],
            "tolerance": NUMBER[:-1] + [-1.0, 1.0],
        },
    ),
    "mesh.read": (pi.mesh.read, {"path": FILE + ["a.msh", "a.xyz"]}),
    "mesh.read_outline": (pi.mesh.read_outline, {"path": FILE + ["a.svg", "a.xyz"]}),
    "mesh.svg_path": (pi.mesh.svg_path, {"path": NOTHING + LISTS + SCALARS + ["M 0 0 h 1"]}),
    "mesh.write": (
        made(pi.mesh.write, mesh=MESH, path="a.vtu"),
        {"mesh": MESHES, "path": FILE + ["a.xyz", "noext"], "overwrite": [None, 1.0, "yes"], "unit": NUMBER[:-1] + [0, -1.0, "inch"]},
    ),
    "profile.constant": (pi.profile.constant, {"value": NUMBER}),
    "profile.polynomial": (
        pi.profile.polynomial,
        {"coefficients": NOTHING + [[], np.zeros((2, 2)), [np.nan, 0.0], ["1", "b"], [None, None], [1j, 0.0], "ab", 1.0]},
    ),
    "profile.sine": (made(pi.profile.sine, amplitude=1.0, frequency=1.0), {"amplitude frequency phase": NUMBER}),
    "profile.quintic": (made(pi.profile.quintic, start=0.0, end=1.0, duration=1.0), {"start end begin": NUMBER, "duration": POSITIVE[:-1]}),
    "profile.ramp": (made(pi.profile.ramp, start=0.0, end=1.0, duration=1.0), {"start": NUMBER, "duration": POSITIVE[:-1]}),
    "profile.linear": (made(pi.profile.linear, start=0.0, end=1.0, duration=1.0), {"end begin": NUMBER}),
    "profile.from_function": (
        made(pi.profile.from_function, value=abs),
        {
            "value": without(NOTHING, type(len), type)[:-12] + [1.0],
            "d1": ["text", 1.0, Odd()],
            "kinks": [1.0, "ab", [None], [np.nan], Odd()],
        },
    ),
    "GeneralizedAlpha": (
        made(pi.GeneralizedAlpha, h=1e-3),
        {
            "h": without(POSITIVE, type(None)),
            "rho_inf": NUMBER + [1.0, -0.1],
            "tolerance": without(SHARE, type(None)),
            "scaling start linear": CHOICE,
            "max_iterations": COUNT,
        },
    ),
    "EnergyMomentum": (made(pi.EnergyMomentum, h=1e-3), {"h": POSITIVE, "tolerance": SHARE, "max_iterations": COUNT}),
    "IDA": (
        pi.IDA,
        {
            "rtol": without(SHARE, type(None)),
            "atol": NOTHING[1:] + [[], np.zeros((2, 2)), [np.nan, 0.0], ["1", "b"], [1j, 0.0], "ab", 0, -1.0, [1e-6, 0.0]],
            "max_order": [value for value in COUNT if value is not None] + [6],
            "form linear": CHOICE,
            "max_step first_step rate": NOT_NEGATIVE,
            "max_num_steps": COUNT,
        },
    ),
    "RadauIIA": (
        pi.RadauIIA,
        {
            "rtol": without(SHARE, type(None)),
            "atol h tolerance": without(POSITIVE, type(None)),
            "stages": COUNT + [1, 4],
            "form": CHOICE,
            "max_iterations max_num_steps": COUNT,
            "max_step first_step": NOT_NEGATIVE,
        },
    ),
    "solve": (
        run,
        {
            "model": NOTHING + LISTS + [BOARD, pi.Scene(), pi.Model],
            "t_end": NUMBER + [0.0, -1.0, True],
            "integrator": NOTHING + LISTS + [pi.IDA, "alpha", BOARD],
            "q0 v0": ARRAY + [[1.0, 2.0, 3.0], [5.0, 5.0]],
            "t0": NUMBER + [1.0],
            "every flush_every": COUNT,
            "output": ARRAY + [[0.0, 0.0], [-1.0], [5.0]],
            "until": ["text", 1.0, [], Odd(), lambda t, q, v: "a", lambda t, q, v: np.nan, lambda t, q, v: q],
            "memory_limit": NUMBER + [-1],
            "state": SOMETHING + LISTS,
            "out": FILE[1:5] + FILE[6:8] + FILE[9:10],
            "progress": ["text", 1.0, [], Odd()],
            "sensors": without(NOTHING[1:], dict) + [{"x": value} for value in without(NOTHING, type, type(len))] + [{1: abs}],
        },
    ),
    "solve from a state": (state, {"t": NUMBER, "q v a": NOTHING + LISTS, "lam": NOTHING + LISTS[:1] + LISTS[2:]}),
    "static": (
        made(pi.static, model=build(pi.Clamp(LEFT))),
        {
            "model": MODELS,
            "t": NUMBER,
            "q0": ARRAY,
            "steps max_iterations": COUNT,
            "tolerance": SHARE,
            "linear": NOTHING + LISTS + [1, "yes"],
        },
    ),
    "equilibrium_path": (
        made(pi.equilibrium_path, model=build(pi.Clamp(LEFT)), load=[1e-3] * 30, count=2),
        {
            "model": MODELS,
            "load": [value for value in ARRAY if not isinstance(value, type)] + ["push"],
            "t start": NUMBER,
            "q0": ARRAY,
            "first": POSITIVE,
            "until": NOT_NEGATIVE,
            "count": COUNT[:-3],
            "tolerance": SHARE,
            "max_iterations": COUNT,
        },
    ),
    "modes": (
        made(pi.modes, model=build(pi.Clamp(LEFT))),
        {"model": MODELS, "state": SOMETHING + LISTS, "count": COUNT[:-3], "damped": NOTHING + LISTS + [1, "yes"]},
    ),
    "linearise": (
        made(pi.linearise, model=build(pi.Clamp(LEFT)), modes=1),
        {
            "model": MODELS,
            "state": SOMETHING + LISTS,
            "inputs": [value for value in ARRAY if not isinstance(value, type) and not isinstance(value, (dict, list))],
            "outputs": [value for value in ARRAY if not isinstance(value, (dict, list))],
            "modes": [value for value in COUNT[:-3] if value is not None] + [10**6],
        },
    ),
    "frequency_response": (
        made(pi.frequency_response, model=build(pi.Clamp(LEFT)), state=None, input=np.ones(30), output=np.ones(30), frequencies=[1.0]),
        {
            "model": MODELS,
            "state": SOMETHING + LISTS,
            "input": [value for value in ARRAY if not isinstance(value, type)] + [None],
            "output": [value for value in ARRAY if not isinstance(value, (dict, list))] + [{}, []],
            "frequencies": NOTHING + [[], np.zeros((2, 2)), [np.nan, 0.0], ["1", "b"], [1j, 0.0], "ab"],
            "modes": [value for value in COUNT[:-3] if value is not None] + [10**6],
        },
    ),
    "consistent_state": (
        made(pi.consistent_state, model=MODEL, q0=[-1.0, 0.0]),
        {"model": NOTHING + [BOARD], "t0": NUMBER, "q0 v0": ARRAY},
    ),
    "check_derivatives": (
        made(pi.check_derivatives, model=MODEL),
        {"model": NOTHING + [BOARD], "t": NUMBER, "q v a": ARRAY, "seed": ["a", -1, 0.5, Odd()]},
    ),
    "load": (pi.load, {"path": FILE}),
    "resume": (pi.resume, {"path": FILE}),
    "sensor.position": (lambda of: run(sensors={"x": pi.sensor.position(of)}), {"of": PART}),
    "sensor.reaction": (lambda joint: run(sensors={"x": pi.sensor.reaction(joint)}), {"joint": PART}),
    "sensor.state": (pi.sensor.state, {"function": NO_FUNCTION}),
    "Trajectory.angle": (STANDING.angle, {"joint": PART}),
    "Trajectory.strain": (STANDING.strain, {"frame": INDEX + [None]}),
    "Trajectory.section_forces": (
        made(STANDING.section_forces, plate="board", at=(0.5, 0.0)),
        {"plate": [part for part in PART if part is not BOARD], "at": PAIR + [(5.0, 0.0)], "normal": PAIR + [(0.0, 0.0)], "frame": INDEX},
    ),
    "objective.Deviation": (
        made(pi.objective.Deviation, point="hinge", path=(1.0, 0.0)),
        {"path": [value for value in PAIR if not callable(value)]},
    ),
    "objective.PeakReaction": (made(pi.objective.PeakReaction, joint="hinge"), {"p": POSITIVE + [0.5], "unit": CHOICE[1:]}),
    "objective.PeakStress": (pi.objective.PeakStress, {"p": POSITIVE + [0.5]}),
    "objective.Frequency": (pi.objective.Frequency, {"number": NOTHING + LISTS + SCALARS + [-1, 0.5]}),
    "objective.UserObjective": (
        made(pi.objective.UserObjective, value=float, slopes=dict),
        {name: NO_FUNCTION for name in ("value", "slopes")},
    ),
    "objective of a run": (
        lambda **given: [kind(**given)(STANDING) for kind in (pi.objective.StrainEnergy, pi.objective.PeakStress)],
        {"plate": [part for part in PART if part is not None and part is not BOARD]},
    ),
    "reaction of a run": (lambda joint: pi.objective.PeakReaction(joint)(STANDING), {"joint": PART}),
    "deviation of a run": (lambda point: pi.objective.Deviation(point, (0.0, 0.0))(STANDING), {"point": PART}),
    "objective of what is no run": (pi.objective.StrainEnergy(), {"run": NOTHING + LISTS + [BOARD, MODEL]}),
    "sum of objectives": (lambda other: pi.objective.StrainEnergy() + other, {"other": PART}),
    "objective times a number": (lambda number: pi.objective.StrainEnergy() * number, {"number": NUMBER}),
    "problems.get": (pi.problems.get, {"name": CHOICE}),
    "double_plate": (
        made(plates.double_plate, cells=4),
        {"cells": COUNT, "seed": [-1, "a", 0.5], "material": PART[:-4], "tip_mass": POSITIVE},
    ),
    "plate_chain": (plates.plate_chain, {"links": COUNT}),
    "von_mises": (
        made(pi.von_mises, stress=[1.0, 0.0, 0.0]),
        {"stress": NOTHING + [1.0, [1.0], np.zeros((3, 2))], "zz": NUMBER + [[1.0, 2.0]]},
    ),
}
CALLS = {name: (call, {key: values for keys, values in wrong.items() for key in keys.split()}) for name, (call, wrong) in GIVEN.items()}


SEEN_LATER = {  # arguments that messages call by what they hold, or by what does not fit them
    "selector": "section",
    "hole": "section",
    "nodes": ("offsets", "cell 0"),
    "points": ("cell 0", "corners"),
    "cells": "mesh of lists: holds no",
    "path": "file",
    "rho": "density",
    "point": "no mass, load or joint",
    "against": ("no attachment", "two bodies"),
    "of": "attachment",
}


def names(text, key, value):
    """True if a message names the argument, or its value or an entry of it."""
    entries = [value, *value] if isinstance(value, list | tuple | dict) or getattr(value, "ndim", 0) else [value]
    shown = [getattr(value, "__name__", None), *(" ".join(form(x).split())[:20] for x in entries for form in (repr, str))]
    return bool(re.search(rf"\b{key.removesuffix('s')}", text)) or any(
        word in text for word in np.hstack([SEEN_LATER.get(key, "\0"), *filter(None, shown)])
    )


def complaint(name, key, value):
    """None where the answer is as it should be, or what came instead."""
    function = CALLS[name][0]
    try:
        result = function(**{key: value})
    except pi.InputError as error:
        text = str(error)
        good = text and len(text) < 1000 and "\n" not in text and names(text, key, value)
        return None if good else f"a message of {len(text)} characters: {text[:100]!r}"
    except Exception as error:  # noqa: BLE001, what else may come is what is looked for
        return f"{type(error).__name__}: {str(error)[:120]}"
    return f"accepted: {str(result)[:80]}"


@pytest.mark.parametrize("name", CALLS)
def test_every_wrong_value_is_answered_by_a_clear_message(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    wrong = CALLS[name][1]
    answers = {(key, repr(value)[:40]): complaint(name, key, value) for key, values in wrong.items() for value in values}
    assert not {case: answer for case, answer in answers.items() if answer}


WORDS = st.text(min_size=3, max_size=40)
RUBBISH = st.one_of(
    WORDS,
    st.binary(max_size=9),
    st.complex_numbers(),
    st.dictionaries(WORDS, st.floats(), max_size=2),
    st.sets(st.integers(), max_size=3),
    st.lists(WORDS, min_size=1, max_size=3),
    st.lists(st.dictionaries(WORDS, st.none(), min_size=1), min_size=1, max_size=2),
    st.tuples(st.complex_numbers(), st.none()),
)
NOT_FOR_RUBBISH = [
    (name, key)
    for name, (_, wrong) in CALLS.items()
    for key, values in wrong.items()
    if all(any(value is known for value in values) for known in ("text", NOTHING[4]))
]


@settings(max_examples=60, phases=(Phase.generate,))
@given(place=st.sampled_from(NOT_FOR_RUBBISH), value=RUBBISH)
def test_random_wrong_values_get_clear_messages(place, value):
    assert complaint(*place, value) is None
