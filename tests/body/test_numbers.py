"""Numbers of every kind that users give, whole, of numpy, in single precision: each is the float it stands for."""

from fractions import Fraction

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

import polyida as pi

KINDS = (int, float, np.int32, np.int64, np.uint32, np.float32, np.float64, Fraction)
WHOLE = {
    "E": 50_000_000,
    "nu": 0,
    "rho": 1100,
    "viscosity": 0,
    "mass_damping": 1,
    "thickness": 1,
    "angle": 0,
    "tau": 1,
    "x": 2,
    "y": 1,
    "mass": 2,
    "fx": 3,
    "fy": 2,
    "tx": 100,
    "ty": 0,
    "gx": 0,
    "gy": 10,
    "turn": 1,
    "factor": 2,
    "length": 1,
}
VALUES = {"viscosity": (0, 1), "mass_damping": (0, 1), "angle": (0, 1)}


def scene_of(n, element):
    """A plate with everything a number can be given for."""
    mesh = pi.mesh.quads(n["length"], n["length"], 3, 2)
    material = pi.Material(n["E"], n["nu"], n["rho"], viscosity=n["viscosity"], mass_damping=n["mass_damping"])
    scene = pi.Scene(gravity=(n["gx"], n["gy"]))
    origin = (n["x"], n["y"])
    plate = scene.add(pi.Plate(mesh, material, n["thickness"], origin, n["angle"], element=element, tau=n["tau"]))
    end = plate.section("right")
    scene.add(pi.Revolute(pi.ground, plate.section("left")))
    scene.add(pi.AngleMotor(pi.ground, plate.section("left"), pi.profile.ramp(0, n["turn"], duration=100)))
    scene.add(pi.PointMass(end, n["mass"]))
    scene.add(pi.PointLoad(end, (n["fx"], n["fy"]), n["factor"]))
    scene.add(pi.EdgeTraction(plate.section("top"), [n["tx"], n["ty"]], n["factor"]))
    return scene


def three_steps(scene):
    """(final q, residual at a state that moves) of the scene."""
    model = scene.build()
    run = pi.solve(model, 3e-3, pi.GeneralizedAlpha(h=1e-3))
    assert run.success and run.counts.steps == 3
    random = np.random.default_rng(0)
    q, v, a = (1e-3 * random.standard_normal(model.n) for _ in range(3))
    return run.q[-1], model.residual(0.1, q, v, a, random.standard_normal(model.m))


@settings(max_examples=15)
@given(st.data(), st.sampled_from(("wachspress", "virtual")))
def test_every_kind_of_number_gives_the_run_of_its_float(data, element):
    whole = {name: data.draw(st.sampled_from(VALUES.get(name, (value,))), name) for name, value in WHOLE.items()}
    kinds = data.draw(st.lists(st.sampled_from(KINDS), min_size=len(whole), max_size=len(whole)), "kinds")
    mixed = {name: kind(value) for (name, value), kind in zip(whole.items(), kinds)}
    floats = {name: float(value) for name, value in whole.items()}
    for found, exact in zip(three_steps(scene_of(mixed, element)), three_steps(scene_of(floats, element))):
        assert np.array_equal(found, exact)
