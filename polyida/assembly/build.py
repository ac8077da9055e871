"""From the parts of a scene to its arrays."""

import warnings

import numpy as np

from polyida.assembly.arrays import Coupling, Links, Plates, SceneArrays, concatenated, starts
from polyida.assembly.compact import Compact
from polyida.assembly.loads import dead_loads, steady
from polyida.assembly.own_laws import laws_of
from polyida.assembly.places import PlacedBody, PlacedPlate
from polyida.assembly.rows.row_table import Drives, Points, RowTable, given_rows
from polyida.body.body import Body, points_of
from polyida.body.plate import Plate
from polyida.body.rigid_body import PointMass
from polyida.element.choose import operator_of, stabilisation_factor
from polyida.errors import LockingWarning
from polyida.force.force_element import ForceElement, sides_of
from polyida.joint.attachment import Attachment
from polyida.joint.joint import Joint
from polyida.validation import pairs_of

ROUND = 1e-14  # of places, by which those of points that are in one place may differ
LOCKING = 0.45  # Poisson's ratio in plane strain above which cells of full integration lock


def of_kind(parts, *kinds):
    """{name: part} of the given kinds, in order."""
    return {name: part for name, part in parts.items() if isinstance(part, kinds)}


def plates_of(parts):
    """The plates in order; those on one mesh share one reference operator."""
    operators, placed, first = {}, [], 0
    for name, plate in of_kind(parts, Plate).items():
        warn_of_locking(name, plate)
        key = (id(plate.placed), plate.element, plate.tau)
        if key not in operators:
            operators[key] = operator_of(plate)
        placed.append(PlacedPlate(name, plate, operators[key], slice(first, first + plate.mesh.n_nodes)))
        first = placed[-1].nodes.stop
    return placed


def few_of(parts, first):
    """The bodies of few coordinates in order, their pairs numbered from `first`."""
    sides, placed = [side for name, part in parts.items() for side in sides_held(name, part)], []
    for name, body in of_kind(parts, Body).items():
        placed.append(PlacedBody(name, body, first, [side for side in sides if side.body is body]))
        if body.plate is not None and placed[-1].deforms:
            warn_of_locking(name, body.plate)
        first = placed[-1].pairs.stop
    return placed


def sides_held(name, part):
    """The attachments that a part holds on to."""
    sides = (
        [side.at for side in sides_of(name, part)]
        if isinstance(part, ForceElement)
        else [getattr(part, key, None) for key in ("a", "b", "at")]
    )
    return [side for side in sides if isinstance(side, Attachment)]


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


def extent_of(plates, few):
    """Size of the scene, m: of the places of nodes, and of the points and the spread of mass of other bodies; 1 where all are in one place."""
    places = [body.points for body in plates]
    for placed in few:
        whole = placed.body.plate is not None
        places += [placed.body.plate.points] if whole else [point.point[None] for point in points_of(placed.body)] + [placed.spread]
    places = concatenated(places, float, (2,))
    size = float(np.ptp(places, axis=0).max(initial=0.0))
    return size if size > ROUND * (1.0 + np.abs(places).max(initial=0.0)) else 1.0


def assemble(plates, few, places, parts, gravity, size, left_out=()):
    """(SceneArrays, Points, RowTable, Drives, Laws or None) of the parts, without the rows of phi `left_out`, by number; gravity: numbers
    and profiles.
    """
    points, drives = Points(places), Drives()
    table = RowTable(points, drives, size, left_out)
    for name, joint in of_kind(parts, Joint).items():
        table.add(name, joint.facing())
    for placed in few:
        if given_rows(placed.name, placed.body):
            table.add(placed.name, placed.body)
    for mass in of_kind(parts, PointMass).values():
        points.mass[points.add(mass.at)] += mass.mass
    fields = operator_arrays(plates) | body_arrays(plates) | load_arrays(dead_loads(parts, gravity, places), drives)
    fields["weight"] = np.concatenate([placed.weight(steady(gravity)) for placed in (*plates, *few)])
    laws = laws_of(of_kind(parts, ForceElement), [placed for placed in few if placed.elastic], points, drives, size)
    links = Links(**points.arrays(), **table.arrays(), gravity=np.array(steady(gravity)))
    links = links._replace(coupling=coupling_of(links, laws))
    first = plates[-1].nodes.stop if plates else 0
    arrays = SceneArrays(Plates(**fields), links, compact_of(few, first, int(fields["body_block"][-1])))
    return arrays, points, table, drives, laws


def coupling_of(links, laws):
    """The Coupling of a scene's links, without their own one, and force elements, Laws or None."""
    vectors = np.split(links.vector_points, links.vector_start[1:-1])
    products = [(a, b) for e, f in zip(links.product_first, links.product_second) for a in vectors[e] for b in vectors[f]]
    sides = [] if laws is None else [laws.points[a:b] for a, b in zip(laws.parts[:-1, 1], laws.parts[1:, 1])]
    pushed = [(a, b) for group in sides for a in group for b in group]
    heavy = [(p, p) for p in np.flatnonzero(links.point_mass)]
    known = {pair for pair in products + pushed + heavy if min(pair) >= 0}
    blocks = sorted(known | {(b, a) for a, b in known})
    number = {pair: block for block, pair in enumerate(blocks)}
    rows, columns = np.array(blocks, np.int64).reshape(-1, 2).T
    count = len(links.point_mass)
    mass = np.full(count, -1, np.int64)
    mass[[p for p, _ in heavy]] = [number[pair] for pair in heavy]
    return Coupling(
        start=np.searchsorted(rows, np.arange(count + 1)).astype(np.int64),
        columns=columns.copy(),
        mirror=np.array([number[b, a] for a, b in blocks], np.int64),
        mass=mass,
        products=np.array([number[pair] for pair in products], np.int64),
        laws=np.array([number.get(pair, -1) for pair in pushed], np.int64),
        law_start=np.concatenate([[0], np.cumsum([len(group) ** 2 for group in sides])]).astype(np.int64),
    )


def compact_of(few, first, block):
    """The Compact of the bodies of few coordinates, behind `first` pairs and `block` blocks of plates."""
    pairs = [len(placed.rest) for placed in few]
    masses = [np.zeros((len(placed.rest),) * 2, complex) if placed.mass is None else placed.mass for placed in few]
    forms, shifts = zip(*(placed.form or (np.zeros((0, 0)), np.zeros(0)) for placed in few)) if few else ((), ())
    damping = np.array([placed.body.damping() for placed in few], float).reshape(-1, 2)
    return Compact(
        pair=first + starts([range(count) for count in pairs]),
        block=block + starts([range(count**2) for count in pairs]),
        rest=pairs_of(concatenated([placed.rest for placed in few], complex)),
        mass_start=starts([mass.ravel() for mass in masses]),
        mass=pairs_of(concatenated([mass.ravel() for mass in masses], complex)),
        axis=pairs_of(concatenated([placed.axis for placed in few], complex)),
        form_start=starts([form.ravel() for form in forms]),
        form=concatenated([form.ravel() for form in forms], float),
        shift_start=starts(shifts),
        shift=concatenated(shifts, float),
        drag=damping[:, 0].copy(),
        viscosity=damping[:, 1].copy(),
    )


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


def body_arrays(bodies):
    """Per-body coefficients."""
    c1, ratio, density, factor = [], [], [], []
    for body in bodies:
        plate, operator = body.plate, body.operator
        modulus, nu = plate.material.in_plane
        c1.append(plate.thickness * modulus / (1 - nu**2))
        ratio.append(nu)
        factor.append(stabilisation_factor(plate, operator))
        density.append(plate.material.rho * plate.thickness)
    return {
        "body_node": starts([range(body.mesh.n_nodes) for body in bodies]),
        "body_block": starts([body.operator.indices for body in bodies]),
        "body_c1": np.array(c1),
        "body_nu": np.array(ratio),
        "body_density": np.array(density),
        "body_drag": np.array([body.plate.material.mass_damping for body in bodies]),
        "body_viscosity": np.array([body.plate.material.viscosity for body in bodies]),
        "body_stabilisation": np.array(factor),
    }


def load_arrays(loads, drives):
    """Forces of the loads, Dead ones, on pairs of q, and the number of the profile that scales each."""
    return {
        "load_ptr": starts([load.pairs for load in loads]),
        "load_nodes": concatenated([load.pairs for load in loads], np.int32),
        "load_values": concatenated([load.forces for load in loads], float, (2,)),
        "load_drive": np.array([drives.add(load.profile, load.name) for load in loads], np.int64),
    }
