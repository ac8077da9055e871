"""Meshes from arrays and lists: numbers stay, 0 or 1 first, repairs are said, wrong ones are named as the user counts."""

import warnings

import numpy as np
import pytest

from polyida.errors import InputError
from polyida.mesh import MeshWarning, PolygonMesh, from_lists, rectangle

POINTS = [[0, 0], [1, 0], [2, 0], [0, 1], [1, 1], [2, 1]]
CELLS = [[0, 1, 4, 3], [1, 2, 5], [1, 5, 4]]


def test_numbers_stay_as_they_are():
    mesh = rectangle(1.0, 0.1, 40)
    shuffle = np.random.default_rng(0).permutation(mesh.n_nodes)
    points, cells = mesh.points[np.argsort(shuffle)], [shuffle[mesh.cell(i)].tolist() for i in range(mesh.n_cells)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = from_lists(points, cells, sections={"grip": [3, 1]})
    assert np.array_equal(again.points, points) and [again.cell(i).tolist() for i in range(again.n_cells)] == cells
    assert again.sections["grip"].tolist() == [1, 3] and again.section("left").length == pytest.approx(0.1)


def test_counted_from_one():
    more = dict(sections={"grip": [1, 4]}, supports={1: (True, False)}, loads={6: (0.0, -0.5)})
    one = from_lists(POINTS, [np.add(cell, 1) for cell in CELLS], first=1, **more)
    assert dict(one.supports) == {0: (True, False)} and dict(one.loads) == {5: (0.0, -0.5)} and one.sections["load"].tolist() == [5]
    assert np.array_equal(one.nodes, from_lists(POINTS, CELLS).nodes) and one.sections["grip"].tolist() == [0, 3]
    with pytest.raises(InputError, match="cell 1 names point 6; there are points 0..5; these cells count from 1, as first=1"):
        from_lists(POINTS, [np.add(cell, 1) for cell in CELLS])
    with pytest.raises(InputError, match=r"cell 0 names point 0; there are points 1..6$"):
        from_lists(POINTS, CELLS, first=1)


def test_all_that_is_repaired_is_said():
    points = [*POINTS, [1, 1e-12], [9, 9]]
    with pytest.warns(MeshWarning) as said:
        mesh = from_lists(points, [[3, 4, 6, 0], [1, 2, 5], [6, 5, 4], [1, 6, 1]])
    assert mesh.area == 2.0 and mesh.n_nodes == 6 and len(said) == 1 and said[0].filename == __file__
    for words in (
        "merged 1 point with others within 1e-09 of the mesh's size, the first at [1.0, 1e-12]",
        "left out 1 cell with fewer than three different corners",
        "turned 1 clockwise cell of 3",
        "left out 1 point of no cell, the first at [9.0, 9.0]",
    ):
        assert words in str(said[0].message)


def test_merging_by_tolerance():
    apart = [[0, 0], [1, 0], [1, 1], [0, 1], [1.001, 0], [2, 0], [2, 1], [1.001, 1]]
    cells = [[0, 1, 2, 3], [4, 5, 6, 7]]
    assert from_lists(apart, cells).quality().pieces == 2
    with pytest.warns(MeshWarning, match="merged 2 points"):
        assert from_lists(apart, cells, tolerance=1e-3).quality().pieces == 1
    assert from_lists(np.round(apart), cells, tolerance=0).quality().pieces == 2


def test_one_height_is_left_out_and_two_are_no_plane():
    with pytest.warns(MeshWarning, match="left out z, which is 3 everywhere"):
        assert from_lists(np.column_stack([POINTS, np.full(6, 3.0)]), CELLS).area == 2.0
    with pytest.raises(InputError, match=r"is not plane: point 5 is \[2.0, 1.0, 0.5\], z runs from 0 to 0.5; it must be 0"):
        from_lists(np.column_stack([POINTS, [0, 0, 0, 0, 0, 0.5]]), CELLS)


def test_units():
    assert from_lists(np.multiply(POINTS, 100), CELLS, unit="mm").area == pytest.approx(0.02)
    with pytest.warns(MeshWarning, match="mesh of lists: it is 200 m wide"):
        from_lists(np.multiply(POINTS, 100), CELLS)


@pytest.mark.parametrize(
    "change, message",
    [
        (dict(cells=[[0, 1]]), r"cell 0 is \[0, 1\]; it must be a list of at least 3 nodes"),
        (dict(cells=[[0, 1, 4, 3], [1, 2, 5.5]]), "cell 1 is"),
        (dict(cells=[]), "no triangles, quads or polygons"),
        (dict(cells=[[0, 0, 0]]), "no cell has three different corners"),
        (dict(cells=[[0, 1, 3, 4]]), "crosses|area"),
        (dict(cells="many"), "cells are 'many'"),
        (dict(points=[[0, 0], [1, 0], [1, np.nan]], cells=[[0, 1, 2]]), r"point 2 is \[1.0, nan, 0.0\]; all coordinates must be finite"),
        (dict(points=[1.0, 2.0]), "points have shape"),
        (dict(first=2), "first is 2; it must be 0 or 1"),
        (dict(unit="inch"), "unit is 'inch'; it must be one of m, dm, cm, mm, um, in, ft"),
        (dict(unit=-1.0), "unit is -1.0"),
        (dict(tolerance=2.0), "merge tolerance is 2.0"),
        (dict(sections={"grip": [6]}), "section 'grip' names points 6..6; there are points 0..5"),
        (dict(sections=[1]), "sections are"),
        (dict(first=1, cells=[[1, 2, 5]], loads={0: (1.0, 2.0)}), "loads name point 0, which is no corner of a cell"),
        (dict(cells=CELLS[:1], loads={5: (1.0, 2.0)}), "loads name point 5, which is no corner of a cell"),
    ],
)
def test_wrong_ones(change, message):
    with pytest.raises(InputError, match=message):
        from_lists(**(dict(points=POINTS, cells=CELLS) | change))


@pytest.mark.parametrize(
    "change, message",
    [
        (dict(supports={9: (True, True)}), "supports name node 9; the mesh has 0..5"),
        (dict(supports={0: (True, 0.5)}), "supports at node 0 are .*must be two of True or False"),
        (dict(supports=[1]), "supports are .*must be a dictionary"),
        (dict(loads={0: (1.0, np.inf)}), "loads at node 0 are .*must be two finite numbers"),
        (dict(loads={0: 3.0}), "loads at node 0 are 3.0"),
        (dict(loads={"a": (1.0, 2.0)}), "loads name node 'a'"),
    ],
)
def test_wrong_supports_and_loads(change, message):
    mesh = from_lists(POINTS, CELLS)
    with pytest.raises(InputError, match=message):
        from_lists(POINTS, CELLS, **change)
    with pytest.raises(InputError, match=message):
        PolygonMesh(mesh.points, mesh.nodes, mesh.offsets, **change)
