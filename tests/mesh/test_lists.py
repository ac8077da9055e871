"""Meshes from arrays and lists: numbers stay, 0 or 1 first, repairs are said, wrong ones are named as the user counts."""

import warnings

import numpy as np
import pytest

from polyida.errors import InputError
from polyida.mesh import MeshWarning, from_lists

POINTS = [[0, 0], [1, 0], [2, 0], [0, 1], [1, 1], [2, 1]]
CELLS = [[0, 1, 4, 3], [1, 2, 5], [1, 5, 4]]


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


def test_a_corner_given_twice_is_said():
    with pytest.warns(MeshWarning, match="left out 2 corners equal to the corner before, the first in cell 0$"):
        mesh = from_lists(POINTS, [[0, 1, 4, 3, 0], [1, 2, 2, 5, 4]])
    assert np.diff(mesh.offsets).tolist() == [4, 4]


@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_a_node_within_the_edge_of_a_neighbour_is_said(angle):
    points = np.array([[0, 0], [1, 0], [1, 0.5], [1, 1], [0, 1], [2, 0], [2, 0.5], [2, 1]])
    points = points @ [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
    with pytest.warns(
        MeshWarning, match=r"node 2 at \[.*\] lies within the edge from node 1 to node 3, .* not joined there \(1 such node\)"
    ):
        from_lists(points, [[0, 1, 3, 4], [1, 5, 6, 2], [2, 6, 7, 3]])
    with warnings.catch_warnings(action="error"):
        from_lists(points, [[0, 1, 2, 3, 4], [1, 5, 6, 2], [2, 6, 7, 3]])


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
