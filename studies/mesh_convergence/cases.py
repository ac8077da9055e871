"""Cases with known solutions on a plate of any mesh and element, for the error of the discretisation in space.

Each returns {"dof": n, "deviation": relative error, ...}: the largest error of the compared components relative to the reference.
"""

import numpy as np

from polyida import profile
from polyida.body.plate import Material, Plate
from polyida.body.rigid_body import PointMass
from polyida.force.loads import PointLoad
from polyida.integrate.static import static
from polyida.joint.attachment import ground
from polyida.joint.joints import AngleMotor, Clamp, Revolute
from polyida.linear.saddle import KKT
from polyida.mesh import PolygonMesh, quads, rectangle, triangles
from polyida.problems import plates
from polyida.scene import Scene

ELASTICA = {1: (0.05643323628337693, 0.3017207737998131), 10: (0.5549955977537513, 0.8106090248802965)}  # u / L, w / L
CSM1 = {"arc": (-7.18767e-3, -66.1023e-3), "straight": (-7.2225e-3, -66.280e-3)}  # m
BENDING = (1.87510407, 4.69409113, 7.85475744)  # beta_n L of a clamped beam
CYLINDER, BEAM_END, STRAIGHT_CLAMP = 0.05, 0.4, 0.04899  # radius, tip and clamp of CSM1 from the cylinder's centre, m


def mesh_of(kind, length, height, through):
    """About `through` cells across the plate, as long as wide: "quads", "triangles" (two a square) or "polygons"."""
    along = max(1, round(length / height * through))
    if kind == "polygons":
        return rectangle(length, height, cells=along * through, seed=1)
    return {"quads": quads, "triangles": triangles}[kind](length, height, along, through)


def element_of(name):
    """The arguments of a plate of the element "wachspress", "virtual" or "quadratic"."""
    return {"order": 2} if name == "quadratic" else {"element": name}


def clamped(mesh, material, element, gravity=(0.0, 0.0), thickness=1.0, load=None, at="right", clamp="left"):
    """(model, plate): one plate on `mesh`, clamped at a section, with a dead load (fx, fy), N, on an attachment named
    "load".
    """
    scene = Scene(gravity=gravity)
    plate = scene.add(Plate(mesh, material, thickness, name="plate", **element_of(element)))
    scene.add(Clamp(plate.section(clamp), name="clamp"))
    scene.add(PointLoad(plate.node(at) if isinstance(at, tuple) else plate.section(at), load or (0.0, 0.0), name="load"))
    return scene.build(), plate


def elastica(kind, element, through, load, slenderness=50):
    """Cantilever under a dead tip load P L^2 / (E I) = `load`, inextensible and shear-free in the reference; nu = 0."""
    modulus, height = 1e9, 1.0 / slenderness
    force = -load * modulus * height**3 / 12
    model, _ = clamped(mesh_of(kind, 1.0, height, through), Material(modulus, 0.0, 1000.0), element, load=(0.0, force))
    moved = -model.displacement("load", static(model, steps=8 if load > 2 else 2).q)
    return result(model, moved / ELASTICA[load] - 1)


def csm1(kind, element, through, clamp):
    """Turek and Hron's CSM1: a beam behind a cylinder under its own weight, clamped on its arc or straight."""
    mesh = mesh_of(kind, BEAM_END - STRAIGHT_CLAMP, 0.02, through)
    mesh = mesh.quadratic if element == "quadratic" else mesh  # so that its sides follow the arc
    mesh = bent_to_the_cylinder(mesh) if clamp == "arc" else mesh
    model, plate = clamped(mesh, Material(1.4e6, 0.4, 1000.0, plane="strain"), element, gravity=(0.0, -2.0))
    tip = plate.node((plate.mesh.points[:, 0].max(), 0.0)).nodes[0]
    moved = static(model, steps=2).q.reshape(-1, 2)[tip]
    return result(model, moved / CSM1[clamp] - 1) | {"moved": moved}


def bent_to_the_cylinder(mesh):
    """The mesh of 0 <= x <= l stretched along x to lie between the cylinder and the beam's tip."""
    x, y = mesh.points.T
    begin = np.sqrt(CYLINDER**2 - y**2)
    stretched = begin + (BEAM_END - begin) * x / x.max()
    return PolygonMesh(np.stack([stretched, y], axis=1), mesh.nodes, mesh.offsets, mesh.sections, order=mesh.order)


def extrapolated(coarse, fine, clamp, order=2):
    """Largest relative error of CSM1's tip displacement, extrapolated from two meshes, cells halved."""
    weight = 2.0**order
    moved = (weight * np.array(fine) - np.array(coarse)) / (weight - 1)
    return float(np.abs(moved / CSM1[clamp] - 1).max())


def cantilever(kind, element, through, known=None):
    """Deflection of a short cantilever, L/H = 10, nu = 0.3, small load; `known` is that of a fine mesh."""
    model, _ = clamped(mesh_of(kind, 1.0, 0.1, through), Material(1e9, 0.3, 1000.0), element, load=(0.0, -1.0))
    deflection = float(model.displacement("load", linear_response(model))[1])
    return result(model, np.array([deflection / (known or deflection) - 1])) | {"deflection": deflection}


def fine_cantilever(through=32):
    """The deflection that `cantilever` is measured against: quadrilaterals, extrapolated from two meshes at order 2."""
    coarse, fine = (cantilever("quads", "wachspress", n)["deflection"] for n in (through // 2, through))
    return (4 * fine - coarse) / 3


def compliance(kind, element, through, at):
    """Displacement under a pull of a bar, clamped at its other end, over that of the exact bar F L / (E A): at a "node"
    or a "section".
    """
    place = (0.0, 0.0) if at == "node" else "left"
    model, _ = clamped(mesh_of(kind, 1.0, 0.1, through), Material(1e9, 0.0, 1000.0), element, load=(-1.0, 0.0), at=place, clamp="right")
    ratio = float(-model.displacement("load", linear_response(model))[0] * 1e9 * 0.1)
    return result(model, np.array([ratio - 1])) | {"compliance": ratio}


def linear_response(model):
    """q of the small displacements under the loads at t = 0, (n,)."""
    rest, lam = np.zeros(model.n), np.zeros(model.m)
    stiffness = model.tangent(0.0, rest, rest, rest, lam, 0.0, 0.0, 1.0)
    system = KKT(stiffness, model.phi_q(0.0, rest))
    return system.solve(model.force(0.0, rest, rest), np.zeros(model.m))[0]


def frequencies(kind, element, through, slenderness=50):
    """Bending and axial frequencies of a clamped bar, nu = 0, against the slender limit and (2n - 1) c / (4 L).

    The first bending and the first two axial ones are compared; shear and rotary inertia lower the next bending ones by
    0.1 and 0.4 %.
    """
    modulus, density, height = 1e9, 1000.0, 1.0 / slenderness
    model, plate = clamped(mesh_of(kind, 1.0, height, through), Material(modulus, 0.0, density), element)
    squares, modes = in_plane_modes(model, 3 * slenderness // 5)
    speed, x = np.sqrt(modulus / density), plate.points[:, 0]
    found = np.sqrt(squares) / (2 * np.pi)
    bending = np.array(BENDING) ** 2 * speed * height / np.sqrt(12) / (2 * np.pi)
    axial = (2 * np.arange(1, 3) - 1) * speed / 4
    along = np.abs([np.sin(2 * np.pi * f / speed * x) @ modes[0::2] for f in axial])
    bent, stretched = found[:3] / bending - 1, found[along.argmax(axis=1)] / axial - 1
    return result(model, np.append(bent[:1], stretched)) | {"bending_errors": bent, "axial_errors": stretched}


def in_plane_modes(model, count):
    """(squared angular frequencies, modes (n, count)) of a model whose constraints hold single coordinates fast."""
    from scipy.sparse.linalg import eigsh

    rest = np.zeros(model.n)
    stiffness = model.tangent(0.0, rest, rest, rest, np.zeros(model.m), 0.0, 0.0, 1.0).tocsc()
    free = np.setdiff1d(np.arange(model.n), np.unique(model.phi_q(0.0, rest).tocsr().indices))
    reduced = [matrix[free][:, free] for matrix in (stiffness, model.mass().tocsc())]
    squares, vectors = eigsh(reduced[0], count, reduced[1], sigma=0.0, v0=np.ones(free.size))
    modes = np.zeros((model.n, count))
    modes[free] = vectors
    order = np.argsort(squares)
    return squares[order], modes[:, order]


def spin_up(nx, ny, h, rho_inf=0.9):
    """Steady extension of the spin-up beam, from 20 s of generalized-alpha."""
    from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
    from polyida.problems import literature
    from polyida.run.solve import solve

    p = literature.spin_up_beam_problem(nx, ny)
    run = solve(p.model, p.t_end, GeneralizedAlpha(h=h, rho_inf=rho_inf))
    if not run.success:
        raise RuntimeError(run.message)
    extension, deflection = literature.in_the_turning_frame(run.t, run.position("tip"))
    steady = literature.steady_extension(run)
    keep = slice(None, None, max(1, len(run.t) // 800))
    return result(p.model, np.array([steady / literature.EXTENSION - 1])) | {
        "extension": steady,
        "t": run.t[keep],
        "u": extension[keep],
        "w": deflection[keep],
        "cpu_s": run.cpu_seconds,
    }


H = 5e-4  # s, the step of the motions


def moving(case, element, cells):
    """Place of a tip and CPU time of a motion: "swing", the double plate, or "motor", a plate of 50:1 that a motor turns. n and steps."""
    from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
    from polyida.run.solve import solve

    scene, t_end = (swing(element, cells), 1.0) if case == "swing" else (motor(element, cells), 0.6)
    model = scene.build()
    runs = [solve(model, t_end, GeneralizedAlpha(h=H), output=[t_end]) for _ in range(2)]  # the first one may load kernels
    if not runs[1].success:
        raise RuntimeError(runs[1].message)
    cpu = min(run.cpu_seconds for run in runs)
    return {"dof": model.n, "tip": runs[1].position("tip")[-1].tolist(), "cpu_s": cpu, "step_cpu_s": cpu / round(t_end / H)}


def swing(element, cells):
    """The double plate."""
    scene = Scene(gravity=plates.GRAVITY)
    mesh, end = rectangle(plates.LENGTH, plates.HEIGHT, cells=cells, seed=1), ground
    for k, name in enumerate(("upper", "lower")):
        plate = scene.add(Plate(mesh, plates.RUBBER, plates.THICKNESS, origin=(k * plates.LENGTH, 0.0), name=name, **element_of(element)))
        scene.add(Revolute(end, plate.section("left"), name=f"joint of {name}"))
        end = plate.section("right")
    scene.add(PointMass(end, plates.TIP_MASS, name="tip"))
    return scene


def motor(element, cells):
    """A plate of 50:1 that a motor turns by 45 degrees within 1 s."""
    scene = Scene()
    plate = scene.add(
        Plate(rectangle(1.0, 0.02, cells=cells, seed=1), Material(1e9, 0.3, 1100.0), 0.01, name="plate", **element_of(element))
    )
    scene.add(Revolute(ground, plate.section("left"), name="joint"))
    scene.add(AngleMotor(ground, plate.section("left"), angle=profile.quintic(0.0, np.pi / 4, duration=1.0), name="motor"))
    scene.add(PointMass(plate.section("right"), 0.5, name="tip"))
    return scene


def result(model, errors):
    """The row of a case. above: True if the component with the largest deviation exceeds its reference."""
    return {"dof": model.n, "deviation": float(np.abs(errors).max()), "above": bool(errors[np.abs(errors).argmax()] > 0)}
