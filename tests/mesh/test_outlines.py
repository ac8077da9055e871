"""Outlines from coordinates and drawings: areas, exact corners, round holes, units, and every bad one with its place."""

import numpy as np
import pytest

from polyida.errors import InputError
from polyida.mesh import MeshWarning, Outline, polygonize, read_outline, svg_path

ELL = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]


def circle(count, radius, center):
    angle = 2 * np.pi * np.arange(count) / count
    return radius * np.column_stack([np.cos(angle), np.sin(angle)]) + center


def star(points, outer=1.0, inner=0.45):
    angle = np.pi * np.arange(2 * points) / points + 0.3
    return np.where(np.arange(2 * points) % 2, inner, outer)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


def area(points):
    x, y = np.transpose(points)
    return 0.5 * abs(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


SLOT = np.concatenate([circle(64, 0.5, (0, 0))[16:49], circle(64, 0.5, (0, 0))[48:] + [2, 0], circle(64, 0.5, (0, 0))[:17] + [2, 0]])
SHAPES = {  # outline, holes, cells
    "L": (ELL, [], 60),
    "clockwise and closed": ([*ELL[::-1], ELL[-1]], [], 60),
    "star": (star(5), [], 100),
    "square ring": (circle(4, 1.0, (0, 0)), [circle(4, 0.4, (0.05, 0))], 100),
    "acute": ([(0, 0), (2, 0), (0.3, 0.4)], [], 50),
    "flat bends": ([(0, 0), (1, 0.01), (2, 0), (2, 1), (1, 1.02), (0, 1)], [], 60),
    "triangle hole": ([(0, 0), (1, 0), (1, 1), (0, 1)], [[(0.4, 0.4), (0.5, 0.7), (0.6, 0.4)]], 150),
    "notch": ([(0, 0), (1, 0), (1, 0.5), (0.55, 0.5), (0.5, 0.3), (0.45, 0.5), (0, 0.5)], [], 100),
    "far away": (np.add(ELL, 1e5), [], 60),
}


class TestOutline:
    @pytest.mark.parametrize("name", SHAPES)
    def test_straight_sides_are_meshed_exactly(self, name):
        points, holes, cells = SHAPES[name]
        mesh = polygonize(Outline(points, holes), cells, seed=1)
        assert mesh.area == pytest.approx(area(np.subtract(points, points[0])) - sum(area(hole) for hole in holes), rel=1e-9)
        quality = mesh.quality()
        assert (quality.holes, quality.pieces, quality.convex) == (len(holes), 1, True) and quality.shortest_edge > 0.05
        for corner in np.concatenate([points, *holes]):
            assert np.linalg.norm(mesh.points - corner, axis=1).min() < 1e-9

    def test_curves_of_chords_are_followed_and_rings_of_them_are_circles(self):
        domain = Outline(SLOT, holes=[circle(32, 0.2, (0, 0)), circle(48, 0.2, (2, 0))])
        mesh = polygonize(domain, 120)
        assert len(domain.corners()) == 0 and mesh.area == pytest.approx(2 + np.pi / 4 - 2 * np.pi * 0.04, rel=5e-3)
        assert np.abs(domain.distance(mesh.points[mesh.boundary_nodes])).max() < 1e-12
        for name, center in (("hole 0", (0.0, 0.0)), ("hole 1", (2.0, 0.0))):
            rim = mesh.section(name)
            assert np.allclose(np.linalg.norm(mesh.points[rim.nodes] - center, axis=1), 0.2, rtol=1e-12)
            assert np.allclose(rim.weights @ mesh.points[rim.nodes], center, atol=1e-12)

    def test_the_distance_is_that_to_the_nearest_edge_negative_inside(self):
        ring = Outline([(0, 0), (3, 0), (3, 3), (0, 3)], holes=[[(1, 1), (2, 1), (2, 2), (1, 2)]])
        assert np.allclose(ring.distance(np.array([[0.5, 0.5], [1.5, 1.4], [4.0, 4.0], [0.5, 1.5]])), [-0.5, 0.4, np.sqrt(2), -0.5])

    def test_corners_are_as_told(self):
        octagon = circle(8, 1.0, (0, 0))
        assert len(Outline(octagon).corners()) == 8
        assert len(Outline(circle(32, 1.0, (0, 0))).corners()) == 0
        assert len(Outline(circle(32, 1.0, (0, 0)), corner=5.0).corners()) == 32

    @pytest.mark.parametrize(
        "make, message",
        [
            (lambda: Outline([(0, 0), (2, 1), (2, 0), (0, 1.5)]), "crosses or touches itself near"),
            (lambda: Outline([(0, 0), (2, 0), (1, 0), (1, 1)]), "folds back on itself at|crosses"),
            (lambda: Outline([(0, 0), (1, 0)]), "2 different corners"),
            (lambda: Outline([(0, 0), (1, 0), (2, 0)]), "area"),
            (lambda: Outline([(0, 0), (1, 0), (np.nan, 1)]), "finite"),
            (lambda: Outline([(0, 0, 0), (1, 0, 0), (1, 1, 0)]), r"\(n, 2\)"),
            (lambda: Outline(ELL, holes=[circle(8, 0.1, (5, 5))]), "hole 0 at .* not within the outline"),
            (lambda: Outline(ELL, holes=[circle(8, 0.3, (0.5, 0.5)), circle(8, 0.1, (0.5, 0.5))]), "hole 1 at .* within outline hole 0"),
            (lambda: Outline(ELL, holes=[circle(8, 0.6, (0.5, 0.5))]), "touches outline hole 0"),
            (
                lambda: Outline(ELL, holes=[[(0.5, 0.2), (0.5, 0.8), (0.6, 0.2)]]),
                r"hole 0 cuts into .* corner of 9.46 degrees at \[0.5, 0.8\]",
            ),
            (lambda: Outline(ELL, holes=3.0), "holes = 3.0"),
            (lambda: Outline(ELL, corner=0.0), "corner is 0.0"),
            (lambda: polygonize(Outline(ELL, holes=[circle(32, 0.02, (0.5, 0.5))]), 8), "use more cells"),
        ],
    )
    def test_bad_ones(self, make, message):
        with pytest.raises(InputError, match=message):
            make()


def wavy(count, turn=0.0):
    angle = 2 * np.pi * np.arange(count) / count + turn
    radius = 1.0 + 0.2 * np.cos(7 * angle)
    return radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


def comb(teeth, turn):
    x, y = np.repeat(np.arange(teeth), 2), np.tile([0, teeth, teeth, 0], teeth)[: 2 * teeth]
    cos, sin = np.cos(turn), np.sin(turn)
    return np.concatenate([np.column_stack([x, y]), [[teeth - 0.5, -1.0], [0.0, -1.0]]]) @ [[cos, sin], [-sin, cos]]


class TestManyPoints:
    """A tree of boxes finds what comparing all edges finds."""

    @pytest.mark.parametrize(
        "points, holes",
        [
            (wavy(3000), []),
            (comb(150, 0.4), []),
            (wavy(200), [0.05 * wavy(40) + [0.3 * i, 0.3 * j] for i in (-1, 0, 1) for j in (-1, 0, 1)]),
        ],
    )
    def test_distances_are_those_of_all_edges(self, points, holes):
        outline = Outline(points, holes)
        rng = np.random.default_rng(1)
        places = outline.lower + rng.random((300, 2)) * (outline.upper - outline.lower)
        rings = [points, *holes]
        start, end = np.concatenate(rings), np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])
        to, along = places[:, None] - start, end - start
        share = np.clip((to * along).sum(axis=2) / (along**2).sum(axis=1), 0.0, 1.0)
        away = np.linalg.norm(to - share[..., None] * along, axis=2).min(axis=1)
        above = places[:, None, 1] >= start[:, 1], places[:, None, 1] >= end[:, 1]
        left = along[:, 0] * to[..., 1] > along[:, 1] * to[..., 0]
        inside = ((above[0] != above[1]) & (left == above[0])).sum(axis=1) % 2 == 1
        assert outline.distance(places) == pytest.approx(np.where(inside, -away, away), abs=1e-12)

    def test_the_first_crossing_is_named(self):
        points = wavy(20_000)
        points[5000:5300] *= 0.3  # back and forth, through nothing
        points[15000:15300] *= -0.5  # through the part of the other side
        with pytest.raises(InputError, match=r"outline crosses or touches itself near"):
            Outline(points)

    def test_the_place_of_holes_among_many(self):
        holes = [circle(32, 0.3, (i + 0.5, j + 0.5)) for i in range(20) for j in range(20)]
        square = [(0, 0), (20, 0), (20, 20), (0, 20)]
        assert len(Outline(square, holes).walls) == 404
        with pytest.raises(InputError, match=r"hole 400 at \[7.*\] is within outline hole 147"):
            Outline(square, [*holes, circle(16, 0.1, (7.5, 7.5))])
        with pytest.raises(InputError, match="hole 400 at .* is not within the outline"):
            Outline(square, [*holes, circle(16, 0.1, (22, 7.5))])
        with pytest.raises(InputError, match="hole 0 crosses or touches outline hole 400"):
            Outline(square, [*holes, circle(16, 0.3, (0.6, 0.5))])


SVG = """<svg xmlns="http://www.w3.org/2000/svg" {size} viewBox="0 0 200 100">
<g id="plate" transform="translate(10,0)"><path id="rim" d="M0,0 H180 V80 H0 Z M20,20 a10,10 0 1 0 20,0 a10,10 0 1 0 -20,0 z"/></g>
<circle id="eye" cx="100" cy="40" r="10"/><path d="M 0 0 L 5 5"/></svg>"""


@pytest.fixture
def svg(tmp_path):
    def written(size='width="100mm" height="50mm"'):
        (tmp_path / "plate.svg").write_text(SVG.format(size=size))
        return tmp_path / "plate.svg"

    return written


class TestSvg:
    def test_the_page_says_the_unit_and_y_is_turned_up(self, svg):
        with pytest.warns(MeshWarning, match="plate.svg: left out 1 open curve$"):
            outline = read_outline(svg())
        assert np.allclose([outline.lower, outline.upper], [[0.005, 0.01], [0.095, 0.05]], atol=1e-15)
        assert np.allclose([wall.start for wall in outline.walls[4:]], [[0.02, 0.04], [0.05, 0.03]])

    def test_a_part_by_its_id_and_a_unit_of_ones_own(self, svg):
        for part in ("rim", "plate"):
            outline = read_outline(svg(), part=part, unit="mm")
            assert len(outline.walls) == 5 and np.allclose(outline.upper, [0.19, 0.1])
        with pytest.raises(InputError, match="plate.svg: has no element with the id 'wing'; there are 'plate', 'rim', 'eye'"):
            read_outline(svg(), part="wing")

    def test_without_a_unit_it_is_metres_and_asked(self, svg):
        with pytest.warns(MeshWarning, match="it is 180 m wide; if its numbers are millimetres pass unit='mm'"):
            assert np.allclose(read_outline(svg(""), part="plate").upper, [190.0, 100.0])

    def test_the_text_of_a_path(self):
        outline = svg_path("M 0 0 h 2 v -1 h -2 z m .5 -.3 v -.2 h .3 v .2 z")
        assert polygonize(outline, 60).area == pytest.approx(2.0 - 0.06, rel=1e-12) and np.allclose(outline.upper, [2, 1])

    def test_bad_files(self, tmp_path):
        (tmp_path / "noise.svg").write_bytes(bytes(range(256)))
        (tmp_path / "plate.png").write_bytes(b"")
        for name, message in (("noise.svg", "noise.svg cannot be read"), ("plate.png", "known are .svg, .dxf"), ("none.svg", "not exist")):
            with pytest.raises(InputError, match=message):
                read_outline(tmp_path / name)


def drawing(path, units, draw):
    import ezdxf

    document = ezdxf.new(units=units)
    draw(document.modelspace())
    document.saveas(path)
    return path


class TestDxf:
    def test_curves_of_all_kinds_join_to_rings(self, tmp_path):
        def draw(space):
            space.add_lwpolyline([(0, 0), (100, 0), (100, 50, 0, 0, 1.0), (0, 50)], close=True)
            space.add_circle((20, 20), 5)
            for start, end in (((50, 10), (60, 10)), ((60, 20), (60, 10)), ((60, 20), (50, 10))):
                space.add_line(start, end)
            space.add_ellipse((80, 25), (8, 0), 0.5)
            space.add_text("a title")
            space.add_line((70, 70), (71, 71))

        with pytest.warns(MeshWarning, match="left out 1 TEXT; left out 1 open curve"):
            outline = read_outline(drawing(tmp_path / "plate.dxf", 4, draw))
        mesh = polygonize(outline, 250)
        whole = 0.1 * 0.05 + np.pi * 0.05**2 / 2 - np.pi * 0.005**2 - 0.5e-4 - np.pi * 0.008 * 0.004
        assert mesh.quality().holes == 3 and mesh.area == pytest.approx(whole, rel=5e-3)
        assert [wall.radius for wall in outline.walls if hasattr(wall, "radius")] == pytest.approx([0.005])

    def test_no_drawing(self, tmp_path):
        (tmp_path / "noise.dxf").write_bytes(bytes(range(256)))
        with pytest.raises(InputError, match="noise.dxf cannot be read"):
            read_outline(tmp_path / "noise.dxf")

    def test_a_layer_and_no_unit(self, tmp_path):
        def draw(space):
            space.add_circle((0, 0), 2, dxfattribs={"layer": "rim"})
            space.add_circle((9, 0), 2)

        path = drawing(tmp_path / "plate.dxf", 0, draw)
        assert np.allclose(read_outline(path, part="rim").upper, 2.0)
        with pytest.raises(InputError, match="not within the outline; part= takes one"):
            read_outline(path)
        with pytest.raises(InputError, match="nothing on the layer 'eye'; there are '0', 'rim'$"):
            read_outline(path, part="eye")


@pytest.mark.filterwarnings("ignore::polyida.mesh.MeshWarning")
@pytest.mark.parametrize("suffix", [".svg", ".dxf"])
def test_damaged_drawings_end_in_one_message(svg, tmp_path, suffix):
    path = svg() if suffix == ".svg" else drawing(tmp_path / "plate.dxf", 4, lambda space: space.add_circle((0, 0), 2))
    data, rng = path.read_bytes(), np.random.default_rng(1)
    for place in rng.integers(0, len(data), 6):
        damaged = bytearray(data)
        damaged[place] = int(rng.integers(256))
        for content in (data[:place], bytes(damaged)):
            path.write_bytes(content)
            try:
                read_outline(path)
            except InputError as error:
                assert path.name in str(error)


def test_a_library_that_is_missing_is_named_with_the_extra(svg, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "svgelements", None)
    with pytest.raises(InputError, match=r"it needs svgelements: pip install 'polyida\[mesh\]'"):
        read_outline(svg())
