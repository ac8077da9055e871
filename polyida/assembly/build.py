"""From the parts of a scene to its arrays."""

import warnings
from dataclasses import dataclass

import numpy as np

from polyida.assembly.arrays import Links, Plates, SceneArrays, concatenated, starts
from polyida.assembly.own.bodies import at_own, carried_by_own
from polyida.assembly.own.law_table import laws_of
from polyida.assembly.rows.points import Points
from polyida.assembly.rows.row_table import Drives, RowTable
from polyida.body.body import points_of
from polyida.body.plate import Plate
from polyida.body.point_mass import PointMass
from polyida.element import stabilisation
from polyida.element.wachspress import reference_operator
from polyida.errors import LockingWarning
from polyida.force.force_element import ForceElement
from polyida.force.loads import EdgeTraction, PointLoad
from polyida.joint.joint import Joint

LOCKING = 0.45  # Poisson's ratio in plane strain above which cells of full integration lock


@dataclass(frozen=True)
class Body:
    """A plate in its place among the scene's nodes: `nodes` is its slice of the node list, `operator` its reference operator."""

    name: str
    plate: object
    operator: object
    nodes: slice

    @property
    def mesh(self):
        """The plate's mesh, turned by its angle."""
        return self.plate.placed

    @property
    def points(self):
        """Reference positions, (N, 2), m."""
        return self.plate.points


def of_kind(parts, *kinds):
    """{name: part} of the given kinds, in order."""
    return {name: part for name, part in parts.items() if isinstance(part, kinds)}


def bodies_of(parts):
    """Bodies in order; plates on one mesh share one reference operator."""
    operators, bodies, first = {}, [], 0
    for name, plate in of_kind(parts, Plate).items():
        warn_of_locking(name, plate)
        key = (id(plate.placed), plate.element, plate.tau)
        if key not in operators:
            operators[key] = operator_of(plate)
        bodies.append(Body(name, plate, operators[key], slice(first, first + plate.mesh.n_nodes)))
        first += plate.mesh.n_nodes
    return bodies


def warn_of_locking(name, plate):
    """LockingWarning where cells keep their volume at the cost of bending: plane strain, nu near 1/2, too few corners a cell."""
    material, corners = plate.material, len(plate.mesh.nodes) / plate.mesh.n_cells
    if material.plane == "strain" and material.nu > LOCKING and (plate.element == "wachspress" or corners < 4):
        warnings.warn(
            f"{name}: nu = {material.nu:g} in plane strain with {plate.element} elements of {corners:.2g} corners: they lock, bending comes "
            'out much too stiff; use element="virtual" on quadrilaterals or polygons, which does not',
            LockingWarning,
            stacklevel=5,
        )


def operator_of(plate):
    """The reference operator of a plate's element on its mesh."""
    if plate.element == "virtual":
        from polyida.element import virtual

        return virtual.reference_operator(plate.placed, plate.tau)
    return reference_operator(plate.placed)


def first_nodes(bodies, own):
    """{id of a body: its first node in the scene}; pairs of bodies of one's own stand behind the plates' nodes."""
    return {id(body.plate): body.nodes.start for body in bodies} | {id(body.body): body.nodes.start for body in own}


def extent_of(bodies, own):
    """Size of the scene, m: of the places of nodes and of the points of bodies of one's own; 1 where they are in one place."""
    places = [body.points for body in bodies] + [point.point[None] for body in own for point in points_of(body.body)]
    return float(np.ptp(concatenated(places, float, (2,)), axis=0).max(initial=0.0)) or 1.0


def assemble(bodies, own, parts, gravity):
    """(SceneArrays, Points, RowTable, Drives, Laws or None) of the parts."""
    first_node = first_nodes(bodies, own)
    points, drives = Points(first_node), Drives()
    size = extent_of(bodies, own)
    table = RowTable(points, drives, size)
    for name, joint in of_kind(parts, Joint).items():
        table.add(name, joint.facing())
    for body in own:
        if body.body.rows():
            table.add(body.name, body.body)
    for mass in of_kind(parts, PointMass).values():
        if not at_own(mass):
            points.mass[points.add(mass.at)] += mass.mass
    loads = of_kind(parts, PointLoad, EdgeTraction)
    fields = operator_arrays(bodies) | body_arrays(bodies, gravity) | load_arrays(loads, drives, first_node)
    fields["weight"] = np.concatenate([fields["weight"], *(body.weight(gravity) for body in own)])
    for mass in carried_by_own(parts):
        first = first_node[id(mass.at.body)]
        fields["weight"][first : first + len(mass.at.nodes)] += mass.at.share(mass.mass * np.asarray(gravity))
    laws = None if own else laws_of(of_kind(parts, ForceElement), points, drives, size)
    links = Links(**points.arrays(), **table.arrays(), gravity=np.array(gravity, float))
    arrays = SceneArrays(Plates(**fields), links)
    return arrays, points, table, drives, laws


def operator_arrays(bodies):
    """Concatenated reference operators, each once."""
    operators = list({id(body.operator): body.operator for body in bodies}.values())
    parts = {
        "layout": (np.int64, (6,)),
        "corners": (np.int32, ()),
        "gradients": (float, ()),
        "weights": (float, ()),
        "pairs": (np.int32, ()),
        "indptr": (np.int32, ()),
        "indices": (np.int32, ()),
        "mass": (float, ()),
    }
    lists = {name: [getattr(operator, name) for operator in operators] for name in parts}
    fields = {name: concatenated(lists[name], dtype, tail) for name, (dtype, tail) in parts.items()}
    parts_of = [np.zeros_like(o.mass) if o.stabilisation is None else o.stabilisation for o in operators]
    fields["stabilisation"] = concatenated(parts_of, float)
    order = ("layout", "corners", "gradients", "weights", "pairs", "indptr", "indices")
    number = {id(operator): k for k, operator in enumerate(operators)}
    return fields | {
        "at": np.ascontiguousarray(np.stack([starts(lists[name]) for name in order], axis=1)),
        "body_operator": np.array([number[id(body.operator)] for body in bodies], np.int64),
    }


def body_arrays(bodies, gravity):
    """Per-body coefficients and the nodal weight."""
    c1, ratio, density, weight, factor = [], [], [], [], []
    for body in bodies:
        plate, operator = body.plate, body.operator
        modulus, nu = plate.material.in_plane
        c1.append(plate.thickness * modulus / (1 - nu**2))
        ratio.append(nu)
        factor.append(0.0 if operator.stabilisation is None else stabilisation.of_plate(plate))
        density.append(plate.material.rho * plate.thickness)
        lumped = np.add.reduceat(operator.mass, operator.indptr[:-1]) * density[-1]
        weight.append(np.outer(lumped, gravity))
    return {
        "body_node": starts([range(body.mesh.n_nodes) for body in bodies]),
        "body_block": starts([body.operator.indices for body in bodies]),
        "body_c1": np.array(c1),
        "body_nu": np.array(ratio),
        "body_density": np.array(density),
        "body_drag": np.array([body.plate.material.mass_damping for body in bodies]),
        "body_viscosity": np.array([body.plate.material.viscosity for body in bodies]),
        "body_stabilisation": np.array(factor),
        "weight": concatenated(weight, float, (2,)),
    }


def load_arrays(loads, drives, first_node):
    """Nodal forces of the loads and the number of the profile that scales each."""
    nodes = [load.at.nodes + first_node[id(load.at.body)] for load in loads.values()]
    return {
        "load_ptr": starts(nodes),
        "load_nodes": concatenated(nodes, np.int32),
        "load_values": concatenated([load.nodal() for load in loads.values()], float, (2,)),
        "load_drive": np.array([drives.add(load.profile, name) for name, load in loads.items()], np.int64),
    }
