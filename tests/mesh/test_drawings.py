"""Drawings against areas and places by formula: shapes, transforms, viewports, lengths, blocks and layers."""

import numpy as np
import pytest

from polyida.errors import InputError
from polyida.mesh import MeshWarning, read_outline
from polyida.mesh.sections import signed_area

PIXEL = 0.0254 / 96


def chords(count):
    """Area of a regular polygon in a circle, over that of the circle."""
    return np.sin(2 * np.pi / count) / (2 * np.pi / count)


SHAPES = {  # element, its area with curves of 24 chords for each piece
    "rect": ('<rect x="3" y="-2" width="20" height="10"/>', 200.0),
    "round rect": ('<rect x="3" y="-2" width="20" height="10" rx="4" ry="3"/>', 200.0 - 48.0 + np.pi * 12.0 * chords(96)),
    "rect of one radius": ('<rect width="20" height="10" ry="3"/>', 200.0 - 36.0 + np.pi * 9.0 * chords(96)),
    "circle": ('<circle cx="7" cy="5" r="6"/>', np.pi * 36.0 * chords(96)),
    "ellipse": ('<ellipse cx="7" cy="5" rx="6" ry="2"/>', np.pi * 12.0 * chords(96)),
    "polygon": ('<polygon points="0,0 20,0 20,10"/>', 100.0),
    "path": ('<path d="M 0 0 h 20 v 10 z"/>', 100.0),
    "arcs": ('<path d="M -6 0 a 6 3 0 0 0 12 0 a 6 3 0 0 0 -12 0 z"/>', np.pi * 18.0 * chords(48)),
}
MOVES = {  # transform, its matrix
    "": (1, 0, 0, 1),
    "rotate(30)": (np.cos(np.pi / 6), -0.5, 0.5, np.cos(np.pi / 6)),
    "rotate(180)": (-1, 0, 0, -1),
    "rotate(90 5 7)": (0, -1, 1, 0),
    "skewX(40)": (1, np.tan(np.radians(40)), 0, 1),
    "skewY(-20)": (1, 0, np.tan(np.radians(-20)), 1),
    "scale(-2 0.5)": (-2, 0, 0, 0.5),
    "matrix(1 2 -3 0.5 7 8)": (1, -3, 2, 0.5),
}
SVG = '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" {page}>{content}</svg>'


@pytest.fixture
def svg(tmp_path):
    def read(content, page='width="300mm" height="300mm" viewBox="0 0 300 300"', **options):
        path = tmp_path / "plate.svg"
        path.write_text(SVG.format(page=page, content=content))
        return read_outline(path, **options)

    return read


def area(outline):
    return sum(signed_area(ring.points) for ring in outline._rings)


@pytest.mark.parametrize("shape", SHAPES)
def test_shapes_keep_their_transforms_in_nested_groups(svg, shape):
    element, size = SHAPES[shape]
    moves = list(MOVES.items())
    for (outer, around), (inner, within) in zip(moves, moves[3:] + moves[:3], strict=True):
        matrix = np.reshape(around, (2, 2)) @ np.reshape(within, (2, 2))
        moved = svg(f'<g transform="{outer}"><g transform="{inner}">{element}</g></g>')
        own = svg(f"<g>{element.replace('/>', f' transform={chr(34)}{outer} {inner}{chr(34)}/>')}</g>")
        expected = size * abs(np.linalg.det(matrix)) * 1e-6
        assert area(moved) == pytest.approx(expected, rel=1e-9) and area(own) == pytest.approx(expected, rel=1e-9)
        if shape == "rect":
            corners = np.array([(3, -2), (23, -2), (23, 8), (3, 8)]) @ matrix.T
            assert np.ptp(moved._rings[0].points, axis=0) == pytest.approx(1e-3 * np.ptp(corners, axis=0), rel=1e-9)


PAGES = {  # page, metres in one unit along x and y, of the drawing's lower left corner
    'width="100mm" height="50mm" viewBox="0 0 200 100"': (5e-4, 5e-4),
    'height="50mm" viewBox="0 0 200 100"': (5e-4, 5e-4),
    'width="1e2mm" viewBox="0 0 200 100"': (5e-4, 5e-4),
    'width="+100mm" height="auto" viewBox="0,0,200,100"': (5e-4, 5e-4),
    'width="100%" height="50mm" viewBox="0 0 200 100"': (5e-4, 5e-4),
    'style="width:100mm;height:50mm" viewBox="0 0 200 100"': (5e-4, 5e-4),
    'width="10cm" height="5CM" viewBox="0 0 200 100"': (5e-4, 5e-4),
    'width="4in" height="2in" viewBox="0 0 200 100"': (0.0254 / 50, 0.0254 / 50),
    'width="144pt" height="72pt" viewBox="0 0 200 100"': (0.0254 / 100, 0.0254 / 100),
    'width="12pc" height="6pc" viewBox="0 0 200 100"': (0.0254 / 100, 0.0254 / 100),
    'width="400Q" height="200Q" viewBox="0 0 200 100"': (5e-4, 5e-4),
    'width="100mm" height="100mm" viewBox="0 0 200 100"': (5e-4, 5e-4),
    'width="100mm" height="100mm" viewBox="0 0 200 100" preserveAspectRatio="xMinYMax slice"': (1e-3, 1e-3),
    'width="100mm" height="100mm" viewBox="0 0 200 100" preserveAspectRatio="none"': (5e-4, 1e-3),
    'width="300mm" height="100mm"': (PIXEL, PIXEL),
}


@pytest.mark.parametrize("page", PAGES)
def test_the_page_gives_the_unit(svg, page):
    x, y = PAGES[page]
    outline = svg('<rect x="20" y="30" width="100" height="40" transform="rotate(90 70 50)"/>', page)
    assert outline.upper - outline.lower == pytest.approx([40 * x, 100 * y], rel=1e-9)


@pytest.mark.parametrize(
    "aspect, lower",
    [
        ("xMinYMin", (0.0, 0.05)),
        ("xMidYMid meet", (0.0, 0.025)),
        ("xMaxYMax", (0.0, 0.0)),
        ("xMinYMid slice", (0.0, 0.0)),
        ("xMaxYMid slice", (-0.1, 0.0)),
    ],
)
def test_the_place_on_the_page_is_that_of_preserve_aspect_ratio(svg, aspect, lower):
    outline = svg('<rect width="200" height="100"/>', f'width="100mm" height="100mm" viewBox="0 0 200 100" preserveAspectRatio="{aspect}"')
    assert outline.lower == pytest.approx(lower, abs=1e-12)


@pytest.mark.parametrize("page", ['width="1em" viewBox="0 0 9 9"', 'width="50vw" height="50%" viewBox="0 0 9 9"', 'viewBox="0 0 9 9"', ""])
def test_a_page_without_a_size_of_its_own_leaves_the_unit_to_the_user(svg, page):
    assert area(svg('<rect x="1" width="8" height="4"/>', page, unit="mm")) == pytest.approx(32e-6, rel=1e-12)
    assert area(svg('<rect x="1" width="8" height="4"/>', page)) == pytest.approx(32.0, rel=1e-12)


@pytest.mark.parametrize(
    "content, size",
    [
        ('<rect width="50%" height="10%"/>', 150 * 30),
        ('<circle cx="50%" cy="50%" r="10%"/>', np.pi * 900 * chords(96)),
        ('<rect width="2in" height="2.54e1mm"/>', 192 * 96),
        ('<rect style="width:+20px;height:1e1"/>', 200),
        ('<svg x="7" y="9" width="40" height="20"><rect width="50%" height="100%"/></svg>', 400),
        ('<svg x="7" width="40" height="20" viewBox="0 0 4 4"><rect width="4" height="4"/></svg>', 400),
        ('<svg width="40" height="20" viewBox="0 0 4 4" preserveAspectRatio="none"><circle r="2"/></svg>', np.pi * 200 * chords(96)),
        ('<symbol id="s"><rect width="4" height="4"/></symbol><use xlink:href="#s" x="9" transform="scale(3)"/>', 144),
        ('<symbol id="s" viewBox="0 0 4 4"><rect width="4" height="4"/></symbol><use href="#s" width="40" height="20"/>', 400),
        ('<defs><g id="s"><rect width="4" height="4"/></g></defs><use href="#s" x="9"/>', 16),
        ('<marker id="m"><rect width="99" height="99"/></marker><rect width="4" height="4"/>', 16),
        ('<rect width="9"/><circle/><rect width="4" height="4"/>', 16),
    ],
)
def test_lengths_and_viewports_within_the_page(svg, content, size):
    assert area(svg(content)) == pytest.approx(size * 1e-6, rel=1e-9)


def test_hidden_shapes_are_left_out_and_named(svg):
    frame = '<rect width="300" height="300" {}/><g style="display:none"><path style="display:inline" d="M0 0h99v99z"/></g>'
    with pytest.warns(MeshWarning, match="left out 1 shape with display none; left out 1 hidden shape"):
        outline = svg(frame.format('visibility="hidden"') + '<rect width="4" height="4"/>')
    assert area(outline) == pytest.approx(16e-6)


@pytest.mark.parametrize(
    "content, message",
    [
        ('<rect width="2em" height="3"/>', "<rect> has width = '2em'; it must be a number alone or with one of the units in, cm"),
        ('<g id="a"><use href="#a"/></g>', "a <use> repeats an element around itself"),
        (
            "".join(f'<g id="a{i}">' + f'<use href="#a{i + 1}"/>' * 10 + "</g>" for i in range(9)) + '<g id="a9"/>',
            "elements with those that <use> repeats",
        ),
        ('<svg width="0" height="3" viewBox="0 0 1 1"/>', "viewport without width or height"),
    ],
)
def test_what_cannot_be_drawn(svg, content, message):
    with pytest.raises(InputError, match=message):
        svg(content)


@pytest.fixture
def dxf(tmp_path):
    import ezdxf

    def read(draw, **options):
        document = ezdxf.new(units=4)
        draw(document, document.modelspace())
        document.saveas(tmp_path / "plate.dxf")
        return read_outline(tmp_path / "plate.dxf", **options)

    return read


SQUARE = [(0, 0), (10, 0), (10, 10), (0, 10)]


@pytest.mark.parametrize("hide", ["freeze", "off"])
def test_hidden_layers_of_a_drawing_are_left_out_unless_asked_for(dxf, hide):
    def draw(document, space):
        getattr(document.layers.add("sheet"), hide)()
        space.add_lwpolyline(np.multiply(SQUARE, 50).tolist(), close=True, dxfattribs={"layer": "sheet"})
        space.add_lwpolyline(SQUARE, close=True)
        space.add_circle((5, 5), 1, dxfattribs={"invisible": 1})

    with pytest.warns(MeshWarning, match="left out what is frozen, switched off or invisible: 1 on '0', 1 on 'sheet'"):
        assert area(dxf(draw)) == pytest.approx(1e-4)
    with pytest.warns(MeshWarning, match="invisible: 1 on '0'$"):
        assert area(dxf(draw, part="sheet")) == pytest.approx(0.25)


def test_a_block_takes_the_layer_of_its_place(dxf):
    def draw(document, space):
        document.layers.add("off").off()
        document.layers.add("frozen").freeze()
        block = document.blocks.new("plate")
        block.add_lwpolyline(SQUARE, close=True)
        block.add_circle((5, 5), 2, dxfattribs={"layer": "holes"})
        space.add_blockref("plate", (0, 0), dxfattribs={"layer": "rim", "rotation": 30, "xscale": 2, "yscale": 3})
        space.add_blockref("plate", (90, 0), dxfattribs={"layer": "frozen"})
        space.add_blockref("plate", (5, 5), dxfattribs={"layer": "off", "xscale": 0.1, "yscale": 0.1})

    assert area(dxf(draw, part="rim")) == pytest.approx(6e-4, rel=1e-9)
    with pytest.warns(MeshWarning, match="1 on 'frozen', 1 on 'off'"):
        assert len(dxf(draw)._rings) == 3


def test_copies_without_end_are_refused_before_they_are_made(dxf):
    def grid(document, space):
        document.blocks.new("hole").add_circle((0, 0), 1)
        space.add_blockref("hole", (0, 0), dxfattribs={"row_count": 20000, "column_count": 20000, "row_spacing": 3, "column_spacing": 3})

    def nested(document, space):
        for level in range(10):
            block = document.blocks.new(f"b{level}")
            block.add_circle((0, 0), 1)
            for place in range(10 if level else 0):
                block.add_blockref(f"b{level - 1}", (3.0 * place, 10.0**level))
        space.add_blockref("b9", (0, 0))

    def circular(document, space):
        document.blocks.new("a").add_blockref("b", (0, 0))
        document.blocks.new("b").add_blockref("A", (0, 0))
        space.add_blockref("b", (0, 0))

    for draw, message in ((grid, "8e.08 entities"), (nested, "entities with those of its blocks in all"), (circular, "holds itself")):
        with pytest.raises(InputError, match=message):
            dxf(draw)
