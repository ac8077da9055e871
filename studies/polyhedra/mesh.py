"""Meshes of polyhedra: bounded Voronoi cells of a box, and VTU files.

The seeds have mirror images outside the box, so that its faces are faces of cells. Lloyd's iteration moves seeds to the centroids of their
cells. Short edges, which would mean high frequencies, are collapsed. Source: Talischi et al., Struct. Multidisc. Optim. 45 (2012) 309-328.
"""

import base64
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.spatial import Voronoi

import polyida as pi


@dataclass(frozen=True, eq=False)
class Mesh:
    """points (nodes, 3), m; cells: for each a list of faces, each an array of node numbers in order, seen from outside anticlockwise."""

    points: np.ndarray
    cells: list

    @cached_property
    def outer(self):
        """The faces that belong to one cell only."""
        of = {}
        for face in (face for cell in self.cells for face in cell):
            of.setdefault(tuple(sorted(face)), []).append(face)
        return [faces[0] for faces in of.values() if len(faces) == 1]

    def side(self, axis, place, about=None):
        """{node: weight} of the outer faces in the plane x[axis] = place: sums of weight times value are means over the area.

        about: a point of the plane, (3,), at which the mean of x is to be; the mean is then weighted by a function that is linear in x.
        """
        weights = {}
        for face in self.outer:
            if np.abs(self.points[face, axis] - place).max() < 1e-9:
                for node, area in zip(face, np.linalg.norm(triangulated(self.points[face])[1], axis=1)):
                    weights[int(node)] = weights.get(int(node), 0.0) + float(area)
        if not weights or (about is not None and abs(about[axis] - place) > 1e-9):
            raise pi.InputError(f"side: x[{axis}] = {place} must be a plane with faces of the mesh, and about = {about} a point of it")
        areas, x = np.array(list(weights.values())) / sum(weights.values()), self.points[list(weights)]
        if about is not None:
            away = x - areas @ x
            areas = areas * (1.0 + away @ (np.linalg.pinv(areas * away.T @ away) @ (np.asarray(about, float) - areas @ x)))
        return dict(zip(weights, areas))


def triangulated(x):
    """(triangles (k, 3, 3), area vectors of the corners (k, 3)) of a face with corners x (k, 3), by its mean point.

    A function that is linear on each triangle and has the mean value there has the integral `sum values * areas` over the face.
    """
    corners = np.stack([x, np.roll(x, -1, axis=0), np.broadcast_to(x.mean(axis=0), x.shape)], axis=1)
    areas = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return corners, (areas + np.roll(areas, 1, axis=0) + areas.sum(axis=0) / len(x)) / 3.0


def box(size, cells, seed=1, lloyd=15, short=0.1):
    """The Mesh of a box [0, size] with so many Voronoi cells of random seeds after so many iterations of Lloyd; short: of the mean spacing."""
    size = np.asarray(size, float)
    if size.shape != (3,) or not (size > 0).all():
        raise pi.InputError(f"box: size = {size.tolist()} must be three positive lengths")
    seeds = np.random.default_rng(seed).random((cells, 3)) * size
    for _ in range(lloyd):
        seeds = centroids(seeds, *bounded(seeds, size))
    return collapsed(*bounded(seeds, size), size, short * np.cbrt(size.prod() / cells))


def bounded(seeds, size):
    """The Voronoi cells in the box: (points, corners of all faces, starts of the faces (faces + 1,), pairs).

    pairs (faces, 2): the cells of a face, -1 for none; it is anticlockwise seen from the second.
    """
    near, images = 3.0 * np.cbrt(size.prod() / len(seeds)) if len(seeds) > 200 else np.inf, [seeds]
    for axis in range(3):
        for wall in (0.0, size[axis]):
            images.append(seeds[np.abs(seeds[:, axis] - wall) < near])
            images[-1][:, axis] = 2.0 * wall - images[-1][:, axis]
    diagram = Voronoi(np.concatenate(images))
    inside = np.flatnonzero((diagram.ridge_points < len(seeds)).any(axis=1))
    pairs, rings = diagram.ridge_points[inside], [diagram.ridge_vertices[k] for k in inside]
    used, corners = np.unique(np.concatenate(rings), return_inverse=True)
    if used[0] < 0:
        raise pi.InputError("box: a cell reaches beyond the images of the seeds; take more seeds")
    points, start = diagram.vertices[used], np.append(0, np.cumsum([len(ring) for ring in rings]))
    out = np.add.reduceat(np.cross(points[corners], points[corners[following(start)]]), start[:-1])
    back = np.einsum("ij,ij->i", out, diagram.points[pairs[:, 1]] - diagram.points[pairs[:, 0]]) < 0.0
    pairs[back] = pairs[back, ::-1]
    return points, corners, start, np.where(pairs < len(seeds), pairs, -1)


def following(start):
    """The place of the next corner of the same face."""
    after = np.arange(1, start[-1] + 1)
    after[start[1:] - 1] = start[:-1]
    return after


def centroids(seeds, points, corners, start, pairs):
    """Centroids of the cells, (cells, 3), from tetrahedra between the seed and the triangles of the faces."""
    moments, count = np.zeros((len(seeds), 4)), np.diff(start)
    face, x, y = np.repeat(np.arange(len(count)), count), points[corners], points[corners[following(start)]]
    m = (np.add.reduceat(x, start[:-1]) / count[:, None])[face]
    for cell in pairs[face].T:
        s = seeds[cell]
        volume = np.where(cell < 0, 0.0, np.abs(np.einsum("ij,ij->i", np.cross(x - s, y - s), m - s)))
        for k, values in enumerate((volume, *(0.25 * volume * (x + y + m + s).T))):
            moments[:, k] += np.bincount(np.maximum(cell, 0), values, len(seeds))
    return moments[:, 1:] / moments[:, :1]


def collapsed(points, corners, start, pairs, size, short):
    """The Mesh without edges shorter than `short`; corners, edges and faces of the box stay."""
    points = np.where(np.abs(points) < 1e-9, 0.0, np.where(np.abs(points - size) < 1e-9, size, points))
    walls = ((points == 0.0) @ [1, 2, 4] + (points == size) @ [8, 16, 32]).astype(np.int64)
    into, after, merged = np.arange(len(points)), following(start), True
    while merged:
        edges = np.unique(np.sort(np.stack([into[corners], into[corners[after]]], axis=1), axis=1), axis=0)
        edges = edges[edges[:, 0] != edges[:, 1]]
        length, touched, merged = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1), np.zeros(len(points), bool), False
        for a, b in edges[np.argsort(length)[: np.count_nonzero(length < short)]]:
            shared = walls[a] & walls[b]
            if touched[a] or touched[b] or shared not in (walls[a], walls[b]):
                continue
            a, b = (a, b) if walls[b] == shared else (b, a)  # a is on all walls of b
            if walls[a] == shared:
                points[a] = 0.5 * (points[a] + points[b])
            touched[[a, b]], into[into == b], merged = True, a, True
    cells = [[] for _ in range(1 + pairs.max())]
    for ring, (a, b) in zip(np.split(into[corners], start[1:-1]), pairs):
        if len(ring := ring[ring != np.roll(ring, 1)]) > 2:
            for cell, face in ((a, ring), (b, ring[::-1])):
                if cell >= 0:
                    cells[cell].append(face)
    return compact(points, cells)


def compact(points, cells):
    """The Mesh without nodes that no cell has. Raises InputError for a cell that is no solid."""
    used, number = np.unique(np.concatenate([face for cell in cells for face in cell])), np.full(len(points), -1)
    number[used] = np.arange(len(used))
    for k, cell in enumerate(cells):
        volume = sum(np.linalg.det(triangulated(points[face])[0]).sum() for face in cell) / 6.0
        edges = {(a, b) for face in cell for a, b in zip(face, np.roll(face, -1))}
        if not volume > 0.0 or any((b, a) not in edges for a, b in edges):
            raise pi.InputError(f"mesh: cell {k}, volume {volume:.3g} m^3, must be a solid, its faces anticlockwise seen from outside")
    return Mesh(points[used], [[number[face] for face in cell] for cell in cells])


def write_vtu(path, mesh, points=None, cell_data=None):
    """Write a mesh, or its moved points, as a VTU file of polyhedra with numbers of its cells {name: (cells,)}."""

    def array(name, values, kind, parts=1):
        data = np.ascontiguousarray(values, kind.lower()).tobytes()
        text = base64.b64encode(np.uint64(len(data)).tobytes() + data).decode()
        return f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{parts}" format="binary">{text}</DataArray>'

    ids = [np.unique(np.concatenate(cell)) for cell in mesh.cells]
    stream = [np.concatenate([[len(cell)], *[[len(face), *face] for face in cell]]) for cell in mesh.cells]
    lists = {"connectivity": np.concatenate(ids), "offsets": np.cumsum([len(part) for part in ids])}
    lists |= {"faces": np.concatenate(stream), "faceoffsets": np.cumsum([len(part) for part in stream])}
    cells = "".join(array(name, values, "Int64") for name, values in lists.items()) + array("types", np.full(len(ids), 42), "UInt8")
    data = "".join(array(name, values, "Float64") for name, values in (cell_data or {}).items())
    Path(path).write_text(
        '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64"><UnstructuredGrid>'
        f'<Piece NumberOfPoints="{len(mesh.points)}" NumberOfCells="{len(ids)}"><Points>'
        f"{array('Points', mesh.points if points is None else points, 'Float64', 3)}</Points><Cells>{cells}</Cells>"
        f"<CellData>{data}</CellData></Piece></UnstructuredGrid></VTKFile>"
    )


def read_vtu(path):
    """The Mesh of a VTU file of polyhedra, its arrays as text or uncompressed base64; faces of any orientation, of cells that see their mean."""
    root = ElementTree.parse(path).getroot()
    arrays, points = {one.get("Name"): one for one in root.iter("DataArray")}, root.find(".//Points/DataArray")
    appended = any(one.get("format") == "appended" for one in root.iter("DataArray"))
    if root.get("compressor") or appended or points is None or not {"faces", "face_connectivity"} & set(arrays):
        raise pi.InputError(f"read_vtu: {path} must have polyhedra with faces, in text or base64, neither compressed nor appended")

    def numbers(array):
        if array.get("format") == "ascii":
            return np.array((array.text or "").split(), float)
        head = 8 if root.get("header_type") == "UInt64" else 4
        return np.frombuffer(base64.b64decode(array.text.strip())[head:], array.get("type").lower())

    def outward(faces):
        middle = x[np.unique(np.concatenate(faces))].mean(axis=0)
        return [face if np.linalg.det(triangulated(x[face] - middle)[0]).sum() > 0.0 else face[::-1] for face in faces]

    x = numbers(points).astype(float).reshape(-1, 3)
    if "faces" in arrays:
        stream = iter(numbers(arrays["faces"]).astype(int))
        cells = [[np.array(list(islice(stream, next(stream)))) for _ in range(count)] for count in stream]
    else:  # since VTK 9.4
        names = ("face_connectivity", "face_offsets"), ("polyhedron_to_faces", "polyhedron_offsets")
        faces, numbered = (np.split(*(numbers(arrays[name]).astype(int) for name in pair)) for pair in names)
        cells = [[faces[k] for k in some] for some in numbered[:-1]]
    return compact(x, [outward(cell) for cell in cells])
