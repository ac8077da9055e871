"""The L-bracket: least mass at limited stress under a static load, the usual test of stress limits; a sharp inner corner must be rounded."""

import time
from functools import lru_cache

import numpy as np

import polyida as pi
from least_weight.arm import nearest

SIZE, ARM, TIP = 1.0, 0.4, 0.08  # m: of the bracket, width of its arms, length of the edge that carries the load
LOAD, RADIUS = 1e3, 0.05  # N, m
UPPER = 4.5e5  # Pa, 20 % below the stress in the corner of the whole bracket of 1500 polygons
STAGES = tuple(pi.design.Stage(*one) for one in ((25, 3.0), (20, 6.0, 2.0), (25, 10.0, 4.0), (25, 10.0, 8.0), (30, 10.0, 16.0)))
SHORT = (pi.design.Stage(10, 3.0), pi.design.Stage(8, 6.0, 2.0), pi.design.Stage(8, 10.0, 4.0))


@lru_cache(maxsize=4)
def mesh_of(cells):
    """The bracket with sections "top" and "tip"."""
    corners = [(0, 0), (SIZE, 0), (SIZE, ARM), (ARM, ARM), (ARM, SIZE), (0, SIZE)]
    mesh = pi.mesh.polygonize(pi.mesh.Outline(corners), cells, seed=1)
    x, y = mesh.points.T
    sections = {"top": np.flatnonzero(y > SIZE - 1e-9), "tip": np.flatnonzero((x > SIZE - 1e-9) & (y > ARM - TIP))}
    return pi.mesh.PolygonMesh(mesh.points, mesh.nodes, mesh.offsets, sections)


def build(bracket):
    """The model: held at its top, loaded at its tip."""
    scene = pi.Scene()
    plate = scene.add(pi.Plate(bracket, pi.Material(200e9, 0.3, 1000.0), thickness=0.1, name="bracket"))
    for node in bracket.sections["top"]:
        scene.add(pi.PrescribedPosition(plate.node(int(node)), *bracket.points[node].tolist(), name=f"support {node}"))
    scene.add(pi.PointLoad(plate.section("tip"), (0.0, -LOAD), name="load"))
    return scene.build()


def at_rest(model):
    """The equilibrium."""
    return pi.static(model, linear=True)


def row(cells, effort):
    """One row: the design by its stress, and what is solid."""
    begun, mesh = (time.perf_counter(), time.process_time()), mesh_of(cells)
    stress = pi.objective.PeakStress("bracket", p=12, power=0.2)
    variable = pi.design.Densities("bracket", RADIUS, ("top", "tip"), 0.9, void=1e-4)
    case, limit = pi.design.Case(build(mesh), at_rest), pi.objective.Limit(stress, UPPER)
    design = pi.design.minimise(pi.objective.Mass(), [limit], [variable], case, SHORT if effort == "short" else STAGES)
    solid = pi.design.solid(design, build, changes=10 if effort == "short" else 100)
    whole = pi.objective.Mass()(at_rest(build(mesh)))
    return {
        "start_stress": stress.largest(at_rest(build(mesh))),
        **{f"{name}_{column}": float(value) for column in solid.table for name, value in zip(("mass", "stress"), solid.table[column])},
        "share": float(solid.table.loc["objective", "solid"]) / whole,
        "excess": solid.excess,
        "at": solid.at,
        "rho": design.values["bracket"].tolist(),
        "solid": nearest(mesh, solid.meshes["bracket"]),
        "history": design.history["objective"].tolist(),
        "excesses": design.history["excess"].tolist(),
        "message": design.message,
        "wall_s": time.perf_counter() - begun[0],
        "cpu_s": time.process_time() - begun[1],
    }
