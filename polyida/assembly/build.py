"""From the parts of a scene to the arrays that the compiled kernels read."""

import warnings

import numpy as np

from polyida.assembly.arrays import Coupling, Links, Plates, Relaxation, SceneArrays, concatenated, starts
from polyida.assembly.gather_laws import laws_of
from polyida.assembly.kept_rows import no_slips
from polyida.assembly.own_laws import FIRST_SIDE, FIRST_STATE
from polyida.assembly.placement import PlacedBody, PlacedPlate, PlacedStates, PlacedStrains, dead_loads, steady
from polyida.assembly.reduced_kernels import BLOCKS, FORCE, ReducedArrays, provide
from polyida.assembly.row_table import Drives, Points, RowTable, given_rows
from polyida.body.body import Body
from polyida.body.plate import Plate
from polyida.body.rigid_body import PointMass
from polyida.element.choice import operator_of
from polyida.element.elements import stabilisation_factor
from polyida.element.locking import SOFT, STIFF, bending_stiffness
from polyida.errors import LockingWarning
from polyida.force.controllers import Controller
from polyida.force.force_element import ForceElement, sides_of
from polyida.joint.attachment import Attachment, Ground
from polyida.joint.contact import Contact
from polyida.joint.joint import Joint
from polyida.model import NONE
from polyida.validation import pairs_of

SAME_PLACE = 1e-14  # relative difference of coordinates of points at one place
TYPICAL_STRAIN = 1e-2  # its state has the typical speed of the scene
LOCKING = 0.45  # Poisson's ratio in plane strain above which cells with full integration lock


def of_kind(parts, *kinds):
    """{name: part} of the parts of these kinds, in order."""
    return {name: part for name, part in parts.items() if isinstance(part, kinds)}


def own_sides(part):
    """The attachments and places of the ground in the fields a, b and at of a part."""
    return [side for side in (getattr(part, key, None) for key in ("a", "b", "at")) if isinstance(side, Attachment | Ground)]


def attached_sides(name, part):
    """The attachments that a part holds on to."""
    sides = [side.at for side in sides_of(name, part)] if isinstance(part, ForceElement) else own_sides(part)
    return [side for side in sides if isinstance(side, Attachment)]


def place_bodies(parts):
    """The bodies of a scene in the order of q, [PlacedPlate or PlacedBody]: the plates, and behind them the bodies of few coordinates."""
    sides = [side for name, part in parts.items() for side in attached_sides(name, part)]
    placed, operators, first = [], {}, 0
    for name, plate in of_kind(parts, Plate).items():
        _warn_of_locking(name, plate)
        placed.append(PlacedPlate(name, plate, _shared_operator(plate, parts, operators), slice(first, first + plate.mesh.n_nodes)))
        first = placed[-1].pairs.stop
    for name, body in of_kind(parts, Body).items():
        placed.append(PlacedBody(name, body, first, [side for side in sides if side.body is body]))
        if body.plate is not None and placed[-1].deforms:
            _warn_of_locking(name, body.plate)
        first = placed[-1].pairs.stop
    return placed


def _shared_operator(plate, parts, operators):
    """The reference operator of a plate, one for all plates on one mesh with the same mass; operators: {key: operator} of those made so far."""
    kept = None
    for contact in of_kind(parts, Contact).values():
        if contact.contact_mass < 1.0 and contact.a.body is plate:
            kept = np.ones(plate.mesh.n_nodes) if kept is None else kept
            kept[contact.a.nodes] = np.minimum(kept[contact.a.nodes], contact.contact_mass)
    key = (id(plate.placed), plate.element, plate.tau, None if kept is None else kept.tobytes())
    if key not in operators:
        operators[key] = operator_of(plate, kept)
    return operators[key]


def place_states(parts, bodies, speed, without_strains):
    """({name: PlacedStates} of the force elements with states, behind the bodies, {name: PlacedStrains} of viscoelastic plates behind these).

    without_strains: True if these count as elastic. For norms, the states of an element have the mean mass of a pair, all strains together
    that of all bodies.
    """
    whole, first = sum(placed.trace_of_mass for placed in bodies), bodies[-1].pairs.stop
    mass, states, strains = whole / first or 1.0, {}, {}
    for name, element in of_kind(parts, ForceElement).items():
        if element.states or isinstance(element, Controller):
            states[name] = PlacedStates(name, element, first, mass, speed)
            first = states[name].pairs.stop
    relaxing = [body for body in bodies if body.prony and not without_strains]
    pairs = sum(body.strains * len(body.prony) for body in relaxing) / 2
    for body in relaxing:
        strains[body.name] = PlacedStrains(body, first, whole / pairs, TYPICAL_STRAIN * body.strain_size / speed)
        first = strains[body.name].pairs.stop
    return states, strains


def _warn_of_locking(name, plate):
    """Warn, by a LockingWarning with the name of the plate, if its cells bend far too stiffly or too softly.

    Linear cells lock in plane strain with nu near 1/2 if they are Wachspress elements or have few corners. Other plates are judged by the
    ratio `bending_stiffness`.
    """
    material, corners = plate.material, len(plate.mesh.nodes) / plate.mesh.n_cells
    if plate.order == 1 and material.plane == "strain" and material.nu > LOCKING and (plate.element == "wachspress" or corners < 4):
        warnings.warn(
            f"{name}: nu = {material.nu:g} in plane strain with {plate.element} elements of {corners:.2g} corners: they lock, bending comes "
            'out much too stiff; use element="virtual" on quadrilaterals or polygons, or order=2, which do not',
            LockingWarning,
            stacklevel=6,  # the line that calls Scene.build
        )
        return
    stiffness = bending_stiffness(plate)
    if not SOFT < stiffness < STIFF:
        remedy = f"so few linear {plate.element} cells across; use order=2, or more cells"
        if plate.order == 2:
            remedy = "so long curved sides; use more cells along it, or straight sides: mesh.linear with order=2"
        so = f"{stiffness:.2g} times as stiff" if stiffness > 1.0 else f"{1.0 / stiffness:.2g} times as soft"
        warnings.warn(f"{name}: this thin plate bends about {so} as it should with {remedy}", LockingWarning, stacklevel=6)


def extent_of(bodies):
    """Size of the scene, m: of all nodes, named points, and centres of mass plus and minus radii of gyration; 1 if all are at one place."""
    places = concatenated([placed.extreme_points for placed in bodies], float, (2,))
    size = float(np.ptp(places, axis=0).max(initial=0.0))
    return size if size > SAME_PLACE * (1.0 + np.abs(places).max(initial=0.0)) else 1.0


def assemble(bodies, states, strains, places, parts, gravity, size, left_out=(), held=NONE):
    """(SceneArrays, Points, RowTable, Drives, Laws, [Callbacks of each law]) of the parts, without the rows of phi with the numbers `left_out`.

    bodies, states, strains: as of `place_bodies` and `place_states`; places: {id of a body: its place}. gravity: two numbers or profiles,
    m/s^2. held: {name: joint} of joints that need not hold in the reference configuration, in the form in which they hold.
    """
    plates, reduced = [placed for placed in bodies if placed.is_full], [placed for placed in bodies if not placed.is_full]
    points, drives = Points(places), Drives()
    table = RowTable(points, drives, size, left_out)
    for name, joint in of_kind(parts, Joint).items():
        table.add(name, held[name], held=True) if name in held else table.add(name, joint.facing())
    for placed in reduced:
        if given_rows(placed.name, placed.body):
            table.add(placed.name, placed.body)
    for mass in of_kind(parts, PointMass).values():
        points.mass[points.add(mass.at)] += mass.mass
    loads = dead_loads(parts, gravity, places)
    weight = np.concatenate([placed.weight(steady(gravity)) for placed in (*bodies, *states.values(), *strains.values())])
    plate_arrays = plates_of(plates, weight, loads, [drives.add(load.profile, load.name) for load in loads])
    laws, callbacks = laws_of(of_kind(parts, ForceElement), states, [placed for placed in reduced if placed.elastic], points, drives, size)
    links = Links(
        point_ptr=starts(points.nodes),
        point_nodes=concatenated(points.nodes, np.int32),
        point_weights=pairs_of(concatenated(points.weights, complex)),
        point_mass=np.array(points.mass, float),
        point_turns=np.array(points.turns, bool),
        gravity=np.array(steady(gravity)),
        **table.arrays(),
    )
    links = links._replace(coupling=coupling_of(links, laws), slips=no_slips(links))
    first = plates[-1].nodes.stop if plates else 0
    reduced = reduced_arrays([*reduced, *states.values()], first, int(plate_arrays.body_block[-1]))
    relaxation = relaxation_of(bodies, strains, (*bodies, *states.values())[-1].pairs.stop)
    return SceneArrays(plate_arrays, links, reduced, relaxation), points, table, drives, laws, callbacks


def plates_of(plates, weight, loads, load_drives):
    """The Plates of PlacedPlates. weight (pairs, 2): steady gravity on all pairs. loads: Dead, with the numbers of their drives."""
    materials = [body.plate.material for body in plates]
    modulus, nu = np.array([material.in_plane for material in materials]).reshape(-1, 2).T
    thickness = np.array([body.plate.thickness for body in plates], float)
    return Plates(
        **operator_arrays(plates),
        body_node=starts([range(body.mesh.n_nodes) for body in plates]),
        body_block=starts([body.operator.indices for body in plates]),
        membrane_stiffness=thickness * modulus / (1 - nu**2),
        body_nu=nu.copy(),
        body_density=thickness * [material.rho for material in materials],
        body_drag=np.array([material.mass_damping for material in materials], float),
        body_viscosity=np.array([material.viscosity for material in materials], float),
        body_stabilisation=np.array([stabilisation_factor(body.plate, body.operator) for body in plates], float),
        weight=weight,
        load_ptr=starts([load.pairs for load in loads]),
        load_nodes=concatenated([load.pairs for load in loads], np.int32),
        load_values=concatenated([load.forces for load in loads], float, (2,)),
        load_drive=np.array(load_drives, np.int64),
    )


def coupling_of(links, laws):
    """The Coupling of links and force elements, Laws."""
    vectors = np.split(links.vector_points, links.vector_start[1:-1])
    products = [(a, b) for e, f in zip(links.product_first, links.product_second) for a in vectors[e] for b in vectors[f]]
    sides = [laws.points[a:b] for a, b in zip(laws.parts[:-1, FIRST_SIDE], laws.parts[1:, FIRST_SIDE])]
    # the last sides of a law stand for its states, two on each
    state_points = [group[len(group) - (k + 1) // 2 :] for group, k in zip(sides, np.diff(laws.parts[:, FIRST_STATE]))]
    forced = [(a, b) for group in sides for a in group for b in group]
    heavy = [(p, p) for p in np.flatnonzero(links.point_mass)]
    known = {pair for pair in products + forced + heavy if min(pair) >= 0}
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
        laws=np.array([number.get(pair, -1) for pair in forced], np.int64),
        law_start=starts([range(len(group) ** 2) for group in sides]),
        states=concatenated(state_points, np.int64),
    )


def relaxation_of(bodies, strains, pairs):
    """The Relaxation of the bodies with strains {name: PlacedStrains}, behind `pairs` pairs of q."""
    each = [strains.get(body.name) for body in bodies]
    terms = [one.terms if one else () for one in each]
    mass, unit = next((one.mass for one in strains.values()), 1.0), np.array([one.units[0] if one else 1.0 for one in each])
    share, time = np.array([term for one in terms for term in one], float).reshape(-1, 2).T
    sizes = [range(one.padded * len(one.terms) if one else 0) for one in each]
    return Relaxation(pairs, starts(sizes), starts(terms), share.copy(), time.copy(), mass, unit, np.zeros(2, np.int64))


def reduced_arrays(bodies, first, block):
    """The ReducedArrays of the bodies of few coordinates, after `first` pairs and `block` blocks of plates."""
    pairs = [len(placed.rest) for placed in bodies]
    masses = [np.zeros((len(placed.rest),) * 2, complex) if placed.mass is None else placed.mass for placed in bodies]
    forms, shifts = zip(*(placed.form or (np.zeros((0, 0)), np.zeros(0)) for placed in bodies)) if bodies else ((), ())
    damping = np.array([placed.damping() for placed in bodies], float).reshape(-1, 2)
    result = ReducedArrays(
        pair=first + starts([range(count) for count in pairs]),
        block=block + starts([range(count**2) for count in pairs]),
        rest=pairs_of(concatenated([placed.rest for placed in bodies], complex)),
        mass_start=starts([mass.ravel() for mass in masses]),
        mass=pairs_of(concatenated([mass.ravel() for mass in masses], complex)),
        axis=pairs_of(concatenated([placed.axis for placed in bodies], complex)),
        form_start=starts([form.ravel() for form in forms]),
        form=concatenated([form.ravel() for form in forms], float),
        shift_start=starts(shifts),
        shift=concatenated(shifts, float),
        drag=damping[:, 0].copy(),
        viscosity=damping[:, 1].copy(),
        calls=np.zeros(3, np.int64),
    )
    provide(result, FORCE, BLOCKS)
    return result


def operator_arrays(bodies):
    """The fields of Plates that concatenate the reference operators, each once."""
    operators = list({id(body.operator): body.operator for body in bodies}.values())
    number = {id(operator): k for k, operator in enumerate(operators)}
    dtypes = {"layout": np.int64, "corners": np.int32, "gradients": float, "weights": float, "pairs": np.int32, "indptr": np.int32}
    lists = {name: [getattr(operator, name) for operator in operators] for name in (*dtypes, "indices")}
    return {name: concatenated(lists[name], dtype, (6,) if name == "layout" else ()) for name, dtype in dtypes.items()} | {
        "indices": concatenated(lists["indices"], np.int32),
        "mass": concatenated([o.mass for o in operators], float),
        "stabilisation": concatenated([np.zeros_like(o.mass) if o.stabilisation is None else o.stabilisation for o in operators], float),
        "at": np.ascontiguousarray(np.stack([starts(each) for each in lists.values()], axis=1)),
        "body_operator": np.array([number[id(body.operator)] for body in bodies], np.int64),
    }
